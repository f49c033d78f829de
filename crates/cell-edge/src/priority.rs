//! Scheduling priority of the calling thread: robot communication goes first, pictures and plans last.
//!
//! On Linux `nice` belongs to the thread, so nothing but the caller changes. Going up needs a privilege that
//! the daemon may not have; without it the threads that do the slow work go down instead, which is enough on
//! a computer that does nothing else. Real time (the system's first-in first-out class) is for a thread that
//! does little and is judged by when it does it: the system runs it before anything ordinary.

use thread_priority::{
    NormalThreadSchedulePolicy, RealtimeThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id, thread_schedule_policy,
};

/// Above ordinary threads, below those of the system itself, which sit at half of the range.
const REAL_TIME: u8 = 10;

/// Lets other threads go first.
pub fn lower() {
    change(10);
}

/// Goes before other threads, where that is allowed.
pub fn raise() {
    change(-10);
}

/// Goes before all ordinary threads, where that is allowed; else as far up as it may. Threads it starts
/// inherit it, and a thread that holds a lock it waits for does not. It has to sleep: nothing ordinary runs
/// on its core before it does.
pub fn real_time() {
    if !schedule(ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo), REAL_TIME.try_into()) {
        tracing::debug!("no real-time scheduling for this thread");
        raise();
    }
}

/// Back among ordinary threads, as they are by default. Without the privilege to go up, a lowered thread
/// stays where it is.
pub fn ordinary() {
    let other = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other);
    // Setting the class also sets a niceness of its own, from which no ordinary user gets back.
    if thread_schedule_policy() != Ok(other) && !schedule(other, REAL_TIME.try_into()) {
        tracing::debug!("thread keeps its scheduling");
    }
    change(0);
}

/// Takes what all others leave (the system's idle class), and so do the threads it starts: for work that
/// nothing waits for.
pub fn idle() {
    if !schedule(ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Idle), Ok(ThreadPriority::Min)) {
        tracing::debug!("no idle scheduling for this thread");
        lower();
    }
}

fn schedule(policy: ThreadSchedulePolicy, priority: Result<ThreadPriority, &'static str>) -> bool {
    let set = priority.map(|priority| set_thread_priority_and_policy(thread_native_id(), priority, policy));
    matches!(set, Ok(Ok(())))
}

/// Process 0 is the calling thread here.
fn change(to: i32) {
    if let Err(error) = rustix::process::setpriority_process(None, to) {
        tracing::debug!(%error, to, "thread keeps its priority");
    }
}

#[cfg(test)]
mod tests {
    /// A field of the calling thread's stat file (proc(5)), counted from 3, the first after the name.
    fn field(number: usize) -> i32 {
        let stat = std::fs::read_to_string("/proc/thread-self/stat").unwrap();
        let (_, after) = stat.rsplit_once(") ").unwrap();
        after.split(' ').nth(number - 3).unwrap().parse().unwrap()
    }

    /// The kernel's number of the thread's class (sched(7)).
    fn class() -> i32 {
        field(41)
    }

    fn niceness() -> i32 {
        field(19)
    }

    /// Root gets back from any niceness, so this can fail for other users alone.
    #[test]
    fn an_ordinary_thread_goes_no_further_down() {
        let before = niceness();
        let after = std::thread::spawn(|| {
            super::ordinary();
            niceness()
        });
        assert!(after.join().unwrap() <= before);
    }

    #[test]
    fn an_idle_thread_and_those_it_starts_are_in_the_idle_class() {
        let before = class();
        let classes = std::thread::spawn(|| {
            super::idle();
            [class(), std::thread::spawn(class).join().unwrap()]
        });
        assert_eq!(classes.join().unwrap(), [5, 5]);
        assert_eq!(class(), before, "others keep theirs");
    }
}
