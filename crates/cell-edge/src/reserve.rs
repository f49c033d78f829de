//! File handles kept in reserve, for a process that must still take orders when it has no handles left.
//!
//! In: a call that opens something. Out: its result; where the process or the system has no handle left, one
//! from the reserve is given up and the call is tried again. Who takes orders fills the reserve again, and
//! who accepts connections keeps none while it is not half full: otherwise the next connection would take
//! each handle that comes free. The reserve is opened at the start, so its numbers stay below a limit that
//! is lowered later.

use rustix::process::{Resource, getrlimit, setrlimit};
use std::fs::File;
use std::io;
use std::sync::{Mutex, MutexGuard, PoisonError, TryLockError};

/// Handles in reserve: orders, status and answers open one or two each.
const SPARE: usize = 12;

static RESERVE: Mutex<Vec<File>> = Mutex::new(Vec::new());

fn reserve() -> MutexGuard<'static, Vec<File>> {
    RESERVE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// File handles that this process may have open.
pub fn limit() -> usize {
    getrlimit(Resource::Nofile).current.map_or(usize::MAX, |most| usize::try_from(most).unwrap_or(usize::MAX))
}

/// Raises that limit as far as the system allows without privileges.
pub fn raise_limit() {
    let mut limit = getrlimit(Resource::Nofile);
    limit.current = limit.maximum;
    if let Err(error) = setrlimit(Resource::Nofile, limit) {
        tracing::debug!(%error, "the limit of file handles stays as it is");
    }
}

/// Fills the reserve as far as handles are left; false if it is not even half full then. Without a call of
/// this there is no reserve. Never waits: who takes orders must not stand still because a thread of low
/// priority, which fills it too, does not get a processor.
pub fn fill() -> bool {
    let mut reserve = match RESERVE.try_lock() {
        Ok(reserve) => reserve,
        Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
        // Another thread is filling it.
        Err(TryLockError::WouldBlock) => return true,
    };
    while reserve.len() < SPARE {
        let Ok(file) = File::open("/dev/null") else { return reserve.len() >= SPARE / 2 };
        reserve.push(file);
    }
    true
}

/// Opens something, with handles from the reserve where there are no others.
///
/// # Errors
/// That of `open`; also where the reserve is used up.
pub fn with_spare<T>(mut open: impl FnMut() -> io::Result<T>) -> io::Result<T> {
    loop {
        match open() {
            Err(error) if is_out_of_handles(&error) => {
                // Another thread may take the handle that this one gives up: the next one then.
                if reserve().pop().is_none() {
                    return Err(error);
                }
            }
            result => return result,
        }
    }
}

/// The process or the system has no handle left, as the system's own error says.
fn is_out_of_handles(error: &io::Error) -> bool {
    let codes = [rustix::io::Errno::MFILE, rustix::io::Errno::NFILE].map(|errno| errno.raw_os_error());
    error.raw_os_error().is_some_and(|code| codes.contains(&code))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_of_handles_is_raised_to_the_most_that_is_allowed() {
        raise_limit();
        let allowed = getrlimit(Resource::Nofile).maximum;
        assert_eq!(limit(), allowed.map_or(usize::MAX, |most| usize::try_from(most).unwrap_or(usize::MAX)));
    }

    #[test]
    fn without_handles_the_reserve_is_used_and_an_empty_reserve_is_an_error() {
        assert!(fill());
        let full = || io::Error::from_raw_os_error(rustix::io::Errno::MFILE.raw_os_error());
        let mut refusals = 3;
        let opened = with_spare(|| {
            refusals -= 1;
            if refusals >= 0 { Err(full()) } else { Ok(7) }
        });
        assert_eq!(opened.expect("opened"), 7);
        assert_eq!(reserve().len(), SPARE - 3);
        assert!(with_spare::<()>(|| Err(full())).is_err());
        assert!(reserve().is_empty());
        assert!(fill());
        assert_eq!(reserve().len(), SPARE);
        let held = reserve();
        assert!(std::thread::spawn(fill).join().expect("it ends"), "without waiting for who holds it");
        drop(held);
        let absent = with_spare(|| File::open("/nowhere/at/all")).expect_err("absent");
        assert_eq!((absent.kind(), reserve().len()), (io::ErrorKind::NotFound, SPARE));
    }
}
