//! Ctrl-C for commands that compute for a long time.
//!
//! In: the flag that the computation polls. Out: the flag is raised at the first Ctrl-C, so that what is
//! done can be kept; the second one ends the process at once with exit code 130.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use tokio::signal::unix::{SignalKind, signal};

/// Raises `stop` when the process is to end in any of the usual ways: the screen is then given back first.
pub fn watch_every(stop: &Arc<AtomicBool>) {
    let stop = stop.clone();
    std::thread::spawn(move || {
        let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() else { return };
        runtime.block_on(async {
            let signals = [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()];
            let arrivals = signals.into_iter().filter_map(|kind| signal(kind).ok());
            let mut arrivals: Vec<_> = arrivals.collect();
            // Without signals on this system the process ends as ever.
            if arrivals.is_empty() {
                return;
            }
            let first = arrivals.iter_mut().map(|arrival| Box::pin(arrival.recv()));
            futures_util::future::select_all(first).await;
            stop.store(true, Ordering::Relaxed);
        });
    });
}

/// Raises `stop` at Ctrl-C from now on: a signal that comes after this call has returned is not missed.
/// Without signals on this system Ctrl-C ends the process as ever.
pub fn watch(stop: &Arc<AtomicBool>) {
    let stop = stop.clone();
    let (listens, listening) = channel();
    std::thread::spawn(move || {
        let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() else { return };
        runtime.block_on(async {
            let Ok(mut interrupts) = signal(SignalKind::interrupt()) else { return };
            // Nobody waits for this any more if the command has ended.
            let _ = listens.send(());
            if interrupts.recv().await.is_some() {
                stop.store(true, Ordering::Relaxed);
                if interrupts.recv().await.is_some() {
                    std::process::exit(130);
                }
            }
        });
    });
    // The thread that could not listen has dropped its end.
    let _ = listening.recv();
}
