//! A panic in the machinery ends the process (D43): its state is not to be trusted any more, and peers learn of a dead
//! node by their time_outs, of a node that goes on half-dead never.

use rustix::event::{PollFd, PollFlags, poll};
use rustix::stdio::stderr;
use rustix::time::Timespec;

/// Ends the process when it is dropped: only a panic drops it.
struct FailStop {
    what: &'static str,
}

/// Does this work of the machinery; a panic in it ends the process. Costs nothing where there is none.
#[inline]
pub(crate) fn guarded<R>(what: &'static str, work: impl FnOnce() -> R) -> R {
    let guard = FailStop { what };
    let done = work();
    std::mem::forget(guard);
    done
}

impl Drop for FailStop {
    fn drop(&mut self) {
        say(&format!("imrs: {} panicked; the node stops\n", self.what));
        std::process::abort();
    }
}

/// Writes a line to standard error if that takes bytes at once: a reader that stands still must not hold up the abort. Without
/// the lock of `std::io::stderr`, which another thread may hold while its own write waits.
fn say(line: &str) {
    let error = stderr();
    let at_once = Timespec { tv_sec: 0, tv_nsec: 0 };
    let mut fds = [PollFd::new(&error, PollFlags::OUT)];
    if poll(&mut fds, Some(&at_once)).is_ok() && fds[0].revents().contains(PollFlags::OUT) {
        // In one piece, because others may be writing their panics. A pipe that is ready has room for a whole page.
        let _ = rustix::io::write(error, line.as_bytes());
    }
}
