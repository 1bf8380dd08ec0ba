//! A panic in the runtime itself ends the process (D43): the state of the runtime can no longer be trusted. Other nodes
//! notice a dead node by their time_outs, but never a node that goes on half-dead.

use rustix::event::{PollFd, PollFlags, poll};
use rustix::stdio::stderr;
use rustix::time::Timespec;

/// Ends the process when dropped; only a panic drops it.
struct FailStop {
    what: &'static str,
}

/// Does `work` of the runtime; a panic in it ends the process. Without a panic this costs nothing.
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

/// Writes a line to standard error if that does not block: a reader that does not read must not delay the abort. The
/// write bypasses the lock of `std::io::stderr`, because another thread may hold that lock while its own write
/// blocks.
fn say(line: &str) {
    let error = stderr();
    let at_once = Timespec { tv_sec: 0, tv_nsec: 0 };
    let mut fds = [PollFd::new(&error, PollFlags::OUT)];
    if poll(&mut fds, Some(&at_once)).is_ok() && fds[0].revents().contains(PollFlags::OUT) {
        // The line is written in one piece, because other threads may be writing their panics. A ready pipe has room
        // for a whole page.
        let _ = rustix::io::write(error, line.as_bytes());
    }
}
