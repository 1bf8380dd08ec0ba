//! The file of the token that a monitor shows to nodes.

use crate::failure::Failure;
use imrs_wire::files;
use imrs_wire::obs::Token;
use std::path::Path;

/// More than the longest token and the end of its line.
const LONGEST: u64 = 4_096;

/// The token in a file that only its owner can read.
///
/// # Errors
/// [`Failure::Usage`] where there is none.
pub fn read(path: &Path) -> Result<Token, Failure> {
    let failed = |why: &dyn std::fmt::Display| Failure::Usage(format!("the token {}: {why}", path.display()));
    let text = files::secret(path, LONGEST).map_err(|error| failed(&error))?;
    Token::of(&text).map_err(|error| failed(&error))
}
