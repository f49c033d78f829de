//! The signals that end a process, for commands and for the daemon.
//!
//! In: a flag that the work checks. Out: the first signal sets the flag, so the work can still save its
//! results. In commands that compute for a long time, a second Ctrl-C ends the process at once with exit
//! code 130.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use tokio::signal::unix::{SignalKind, signal};

/// Sets `stop` at the first signal that would end the process, so it can restore the screen first.
pub fn watch_every(stop: &Arc<AtomicBool>) {
    let stop = stop.clone();
    at_end(move || stop.store(true, Ordering::Relaxed));
}

/// Calls `then` at Ctrl-C, at SIGTERM, which `kill` and service managers send, or at SIGHUP, which a
/// terminal sends when it is closed. The thread that waits for them also notices one that comes while the
/// process ends.
pub fn at_end(then: impl FnOnce() + Send + 'static) {
    let wait = move || {
        let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() else { return };
        let first = async {
            let kinds = [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()];
            // Without one of the signals the others still count; without any the process ends as ever.
            let mut arrivals: Vec<_> = kinds.into_iter().filter_map(|kind| signal(kind).ok()).collect();
            if arrivals.is_empty() {
                return std::future::pending().await;
            }
            let arrivals = arrivals.iter_mut().map(|arrival| Box::pin(arrival.recv()));
            futures_util::future::select_all(arrivals).await;
        };
        runtime.block_on(first);
        then();
    };
    // Without a thread for it the process ends as ever.
    let _ = std::thread::Builder::new().name("signals".into()).spawn(wait);
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
