//! A panic in the machinery ends the process (D43): its state is not to be trusted any more, and peers learn of a dead
//! node by their time_outs, of a node that goes on half-dead never.

use std::io::Write;

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
        // In one piece: others may be writing their panics.
        let line = format!("imrs: {} panicked; the node stops\n", self.what);
        let _ = std::io::stderr().write_all(line.as_bytes());
        std::process::abort();
    }
}
