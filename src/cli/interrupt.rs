//! Ctrl-C for commands that compute for a long time.
//!
//! In: the flag that the computation polls. Out: the flag is raised at the first Ctrl-C, so that what is
//! done can be kept; the second one ends the process at once with exit code 130.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
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

/// Raises `stop` at Ctrl-C from now on. Without signals on this system Ctrl-C ends the process as ever.
pub fn watch(stop: &Arc<AtomicBool>) {
    let stop = stop.clone();
    std::thread::spawn(move || {
        let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() else { return };
        runtime.block_on(async {
            if tokio::signal::ctrl_c().await.is_ok() {
                stop.store(true, Ordering::Relaxed);
                if tokio::signal::ctrl_c().await.is_ok() {
                    std::process::exit(130);
                }
            }
        });
    });
}
