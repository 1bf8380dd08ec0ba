//! Reads the token file. With the token a monitor proves to nodes that it may observe them.

use crate::failure::Failure;
use imrs_wire::files;
use imrs_wire::obs::Token;
use std::path::Path;

/// The greatest length of the file, in bytes: more than the longest token and a line break.
const LONGEST: u64 = 4_096;

/// Reads the token in a file. Only the file's owner may be able to read it.
///
/// # Errors
/// [`Failure::Usage`] if the file cannot be read, or contains no token.
pub fn read(path: &Path) -> Result<Token, Failure> {
    let failed = |why: &dyn std::fmt::Display| Failure::Usage(format!("the token {}: {why}", path.display()));
    let text = files::secret(path, LONGEST).map_err(|error| failed(&error))?;
    Token::of(&text).map_err(|error| failed(&error))
}
