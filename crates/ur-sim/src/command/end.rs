//! What ends a simulator: Ctrl-C, SIGTERM, and, if it was ordered, the end of standard input.
//!
//! In: the process's signals and standard input. Out: a future. The signals are caught in any case: the
//! first process of a container would get none otherwise. A pipe as standard input closes with the program
//! that holds its other end, however that ends, so that nothing is left behind by a test that was killed.

use std::io::Read;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::oneshot;

/// Resolves when the process has to end; signals are caught from the call on.
///
/// # Errors
/// Signals cannot be caught, or the thread that reads standard input not be started.
pub fn of_process(until_eof: bool) -> std::io::Result<impl Future<Output = ()>> {
    let mut interrupted = signal(SignalKind::interrupt())?;
    let mut terminated = signal(SignalKind::terminate())?;
    let (tx, mut closed) = oneshot::channel();
    if until_eof {
        // A thread of its own: the runtime would wait for its last read when it ends.
        let read = move || {
            read_away(std::io::stdin().lock());
            let _ = tx.send(());
        };
        std::thread::Builder::new().name("sim-stdin".to_owned()).spawn(read)?;
    }
    Ok(async move {
        tokio::select! {
            _ = interrupted.recv() => (),
            _ = terminated.recv() => (),
            _ = &mut closed, if until_eof => (),
        }
    })
}

/// Returns when there is nothing more to read.
fn read_away(mut stream: impl Read) {
    let mut bytes = [0; 4096];
    loop {
        match stream.read(&mut bytes) {
            Ok(0) => return,
            Ok(_) => (),
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => (),
            Err(_) => return,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_passed_over_until_the_end() {
        let mut text = std::io::Cursor::new(vec![b'x'; 10_000]);
        read_away(&mut text);
        assert_eq!(text.position(), 10_000);
    }
}
