//! Scheduling priority of the calling thread: those that talk to the robot go first, pictures and plans last.
//!
//! On Linux `nice` belongs to the thread, so nothing but the caller changes. Going up needs a privilege that
//! the daemon may not have; without it the threads that do the slow work go down instead, which is enough on
//! a computer that does nothing else.

/// Lets other threads go first.
pub fn lower() {
    change(10);
}

/// Goes before other threads, where that is allowed.
pub fn raise() {
    change(-10);
}

/// Process 0 is the calling thread here.
fn change(to: i32) {
    if let Err(error) = rustix::process::setpriority_process(None, to) {
        tracing::debug!(%error, to, "thread keeps its priority");
    }
}
