//! Reads cell files; `-` reads standard input.

use imrs_language::{LONGEST_FILE, Source};
use imrs_wire::files::{self, FileError};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Why a cell file cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum CellFileError {
    /// The file does not exist.
    #[error("{}: there is no such file: name a cell file, such as first.cell", .0.display())]
    Missing(PathBuf),
    /// The name belongs to a folder.
    #[error("{}: this is a folder: name one cell file in it", .0.display())]
    Folder(PathBuf),
    /// The name belongs to a pipe, a device or a socket: reading it might never end.
    #[error("{}: not a regular file: name a cell file, or `-` for standard input", .0.display())]
    NotAFile(PathBuf),
    /// The file is larger than a cell file may be.
    #[error("{}: larger than {} MiB, the most that is read: is it a cell file?", .0.display(), LONGEST_FILE >> 20)]
    TooLarge(PathBuf),
    /// The file is not UTF-8 text.
    #[error("{}: {message}: save the file as UTF-8", path.display())]
    NotText {
        /// The file that is not text.
        path: PathBuf,
        /// A text that says where in the file the first bytes are that are no UTF-8.
        message: String,
    },
    /// The operating system cannot read the file.
    #[error("{}: cannot be read: {source}", path.display())]
    Unreadable {
        /// The file that could not be read.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
}

/// Whether a path stands for standard input.
#[must_use]
pub fn is_stdin(path: &Path) -> bool {
    path.as_os_str() == "-"
}

/// The name of a file for diagnostics.
#[must_use]
pub fn shown(path: &Path) -> String {
    if is_stdin(path) { "<stdin>".to_owned() } else { path.display().to_string() }
}

/// Reads a cell file; `-` is standard input. Stops reading beyond the largest allowed size.
///
/// # Errors
/// [`CellFileError`].
pub fn read(path: &Path) -> Result<Source, CellFileError> {
    let own = || PathBuf::from(shown(path));
    let bytes = bytes(path).map_err(|error| match error {
        FileError::Folder => CellFileError::Folder(own()),
        FileError::NotAFile => CellFileError::NotAFile(own()),
        FileError::Io(source) if source.kind() == io::ErrorKind::NotFound => CellFileError::Missing(own()),
        // Standard input may be connected to a folder.
        FileError::Io(source) if source.kind() == io::ErrorKind::IsADirectory => CellFileError::Folder(own()),
        other => CellFileError::Unreadable { path: own(), source: other.into() },
    })?;
    if bytes.len() > LONGEST_FILE {
        return Err(CellFileError::TooLarge(own()));
    }
    Source::new(&bytes).map_err(|found| CellFileError::NotText { path: own(), message: found.message })
}

fn bytes(path: &Path) -> Result<Vec<u8>, FileError> {
    let mut bytes = Vec::new();
    let most = LONGEST_FILE as u64 + 1;
    if is_stdin(path) {
        io::stdin().lock().take(most).read_to_end(&mut bytes)?;
    } else {
        files::open(path)?.take(most).read_to_end(&mut bytes)?;
    }
    Ok(bytes)
}
