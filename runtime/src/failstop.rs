//! A panic in the machinery ends the process (D43): its state is not to be trusted any more, and peers learn of a dead
//! node by their time_outs, of a node that goes on half-dead never.

use std::io::Write;

/// Ends the process if it is dropped by a panic.
#[must_use = "guards for as long as it lives"]
pub(crate) struct FailStop {
    what: &'static str,
    /// A thread that unwinds already, and on its way only drops something here, is no panic of the machinery.
    unwinding: bool,
}

impl FailStop {
    /// Guards `what` from here to the end of the scope.
    pub fn of(what: &'static str) -> Self {
        Self { what, unwinding: std::thread::panicking() }
    }
}

impl Drop for FailStop {
    fn drop(&mut self) {
        if std::thread::panicking() && !self.unwinding {
            // In one piece: others may be writing their panics.
            let line = format!("imrs: {} panicked; the node stops\n", self.what);
            let _ = std::io::stderr().write_all(line.as_bytes());
            std::process::abort();
        }
    }
}
