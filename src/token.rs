//! Reads the file with the token that a monitor presents to nodes.

use crate::failure::Failure;
use imrs_wire::files;
use imrs_wire::obs::Token;
use std::path::Path;

/// Most bytes of the file: more than the longest token and a line break.
const LONGEST: u64 = 4_096;

/// Reads the token of a file, which only its owner may be able to read.
///
/// # Errors
/// [`Failure::Usage`]: the file cannot be read, or holds no token.
pub fn read(path: &Path) -> Result<Token, Failure> {
    let failed = |why: &dyn std::fmt::Display| Failure::Usage(format!("the token {}: {why}", path.display()));
    let text = files::secret(path, LONGEST).map_err(|error| failed(&error))?;
    Token::of(&text).map_err(|error| failed(&error))
}
