//! The file of the token that a monitor shows to nodes.

use crate::exit::Failure;
use imrs_wire::obs::Token;
use std::path::Path;

/// The token in a file.
///
/// # Errors
/// [`Failure::Usage`] where there is none.
pub fn read(path: &Path) -> Result<Token, Failure> {
    let failed = |why: &dyn std::fmt::Display| Failure::Usage(format!("the token {}: {why}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|error| failed(&error))?;
    Token::of(&text).map_err(|error| failed(&error))
}
