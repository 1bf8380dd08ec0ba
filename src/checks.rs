//! Prints the verdicts on the checks that a cell declares.

use crate::failure::Failure;
use crate::output::{BAD, GOOD, NOTE, Output, Styled};
use imrs_launch::checks::{Outcome, Settlement};

/// Prints one line for each check.
///
/// # Errors
/// [`Failure::Output`].
pub fn show(checks: &Settlement, out: &mut Output) -> Result<(), Failure> {
    for check in &checks.0 {
        let style = match check.outcome {
            Outcome::Held => GOOD,
            Outcome::Broken => BAD,
            Outcome::Untested | Outcome::Elsewhere | Outcome::Apart | Outcome::Unknown => NOTE,
        };
        out.line(format!("  check {} (line {}): {}", check.name, check.line, Styled(style, check.words())))?;
        if let Some(first) = &check.first {
            out.line(format!("    first at {:.3} s: {}", first.seconds, first.values.join(", ")))?;
        }
    }
    Ok(())
}
