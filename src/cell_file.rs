//! Reads and replaces cell files; `-` reads standard input.

use imrs_language::{LONGEST_FILE, Source};
use imrs_wire::files::{self, FileError};
use rustix::fs::{Access, access};
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Why a cell file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum CellFileError {
    /// The file does not exist.
    #[error("{}: there is no such file: name a cell file, such as examples/beam_lift.cell", .0.display())]
    Missing(PathBuf),
    /// It is a folder.
    #[error("{}: this is a folder: name one cell file in it", .0.display())]
    Folder(PathBuf),
    /// It is a pipe, a device or the like: reading it might never end.
    #[error("{}: not a regular file: name a cell file, or `-` for standard input", .0.display())]
    NotAFile(PathBuf),
    /// It is larger than a cell file may be.
    #[error("{}: larger than {} MiB, the most that is read: is it a cell file?", .0.display(), LONGEST_FILE >> 20)]
    TooLarge(PathBuf),
    /// It is not UTF-8 text.
    #[error("{}: {message}: save the file as UTF-8", path.display())]
    NotText {
        /// The file.
        path: PathBuf,
        /// The first invalid place.
        message: String,
    },
    /// It cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// It cannot be written.
    #[error("{}: cannot be written: {source}", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// Whether a path stands for standard input.
pub fn is_stdin(path: &Path) -> bool {
    path.as_os_str() == "-"
}

/// The name of a file for diagnostics.
pub fn shown(path: &Path) -> String {
    if is_stdin(path) { "<stdin>".to_owned() } else { path.display().to_string() }
}

/// Reads a cell file; `-` is standard input. Stops reading beyond the largest allowed size.
///
/// # Errors
/// [`CellFileError`], all but `Unwritable`.
pub fn read(path: &Path) -> Result<Source, CellFileError> {
    let own = || PathBuf::from(shown(path));
    let bytes = bytes(path).map_err(|error| match error {
        FileError::Folder => CellFileError::Folder(own()),
        FileError::NotAFile => CellFileError::NotAFile(own()),
        FileError::Io(source) if source.kind() == io::ErrorKind::NotFound => CellFileError::Missing(own()),
        // Standard input may be a folder.
        FileError::Io(source) if source.kind() == io::ErrorKind::IsADirectory => CellFileError::Folder(own()),
        other => CellFileError::Unreadable { path: own(), source: other.into() },
    })?;
    if bytes.len() > LONGEST_FILE {
        return Err(CellFileError::TooLarge(own()));
    }
    Source::new(&bytes).map_err(|found| CellFileError::NotText { path: own(), message: found.message })
}

/// Replaces the text of a file atomically: writes a new file beside it, syncs it, and renames it. If that fails, the file stays
/// as it was.
///
/// # Errors
/// [`CellFileError::Unwritable`].
pub fn replace(path: &Path, text: &str) -> Result<(), CellFileError> {
    replaced(path, text).map_err(|source| CellFileError::Unwritable { path: path.to_owned(), source })
}

fn replaced(path: &Path, text: &str) -> io::Result<()> {
    // A symbolic link stays a link: its target is replaced.
    let path = fs::canonicalize(path)?;
    access(&path, Access::WRITE_OK)?;
    let old = fs::metadata(&path)?;
    let folder = files::folder_of(&path);
    let beside = |error: io::Error| {
        io::Error::new(
            error.kind(),
            format!("no new file can be put in its place in {}: {error}", folder.display()),
        )
    };
    let mut new = tempfile::NamedTempFile::new_in(folder).map_err(beside)?;
    new.write_all(text.as_bytes())?;
    let own = new.as_file().metadata()?;
    if (own.uid(), own.gid()) != (old.uid(), old.gid()) {
        std::os::unix::fs::fchown(new.as_file(), Some(old.uid()), Some(old.gid())).map_err(beside)?;
    }
    new.as_file().set_permissions(old.permissions())?;
    new.as_file().sync_all()?;
    new.persist(&path)?;
    File::open(folder)?.sync_all()
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
