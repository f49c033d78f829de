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

/// The value that `thread-priority` maps to niceness 0 in the default class.
const USUAL: u8 = 48;

/// Lets other threads go first.
pub fn lower() {
    leave_real_time();
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
    leave_real_time();
    change(0);
}

/// A thread inherits real time from the one that started it. Other classes stay as they are.
fn leave_real_time() {
    let other = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other);
    let in_real_time = matches!(thread_schedule_policy(), Ok(ThreadSchedulePolicy::Realtime(_)));
    if in_real_time && !schedule(other, USUAL.try_into()) {
        tracing::debug!("thread keeps its scheduling");
    }
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

    /// The loop starts planners like this. Without the privilege for real time there is nothing to leave.
    #[test]
    fn a_thread_that_was_started_in_real_time_can_leave_it() {
        let after = std::thread::spawn(|| {
            super::real_time();
            let started = |leave: fn()| {
                let thread = std::thread::spawn(move || {
                    leave();
                    (class(), niceness())
                });
                thread.join().unwrap()
            };
            (class(), [super::lower, super::ordinary].map(started))
        });
        let (in_real_time, after) = after.join().unwrap();
        // SCHED_FIFO, then SCHED_OTHER.
        if in_real_time == 1 {
            assert_eq!(after, [(0, 10), (0, 0)]);
        } else {
            eprintln!("skipped: this user has no real-time scheduling");
        }
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
