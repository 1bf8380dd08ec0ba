//! Writes the files that an option names: `--save`, `--trace`, `--out`. One rule for all: an existing file is replaced only
//! with `--force` (D151).

use crate::cell_file::shown;
use imrs_wire::files::{self, FileError};
use rustix::fs::{Access, access};
use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};

/// Why a file cannot be written: it exists already, or the operating system refuses.
#[derive(Debug, thiserror::Error)]
pub enum KeptError {
    /// The file exists already.
    #[error("{}: {}", .0.display(), FileError::Exists)]
    Taken(PathBuf),
    /// The file cannot be written.
    #[error(
        "{}: cannot be written: {source}: name another file, in a folder that exists and has room",
        path.display()
    )]
    Unwritable {
        /// The path of the file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
}

impl KeptError {
    fn of(path: &Path) -> impl Fn(FileError) -> Self {
        move |error| match error {
            FileError::Exists => Self::Taken(path.to_owned()),
            other => Self::unwritable(path)(other.into()),
        }
    }

    fn unwritable(path: &Path) -> impl Fn(io::Error) -> Self {
        move |source| Self::Unwritable { path: path.to_owned(), source }
    }
}

/// Fails early if a file cannot be written or may not be replaced, before the work for it begins. Changes nothing.
///
/// # Errors
/// [`KeptError`].
pub fn check(path: &Path, force: bool) -> Result<(), KeptError> {
    writable(path).map_err(KeptError::unwritable(path))?;
    files::check(path, force).map_err(KeptError::of(path))
}

/// Whether a path can be written, as far as this is known before there is data.
fn writable(path: &Path) -> io::Result<()> {
    let target = match fs::metadata(path) {
        Ok(of) if of.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
        // Opening a pipe would block until another process reads it.
        Ok(of) if of.file_type().is_fifo() || of.file_type().is_socket() => {
            return Err(FileError::NotAFile.into());
        }
        // A regular file is replaced by renaming, which needs write access to its folder.
        Ok(of) if of.is_file() => files::folder_of(path),
        Ok(_) => path,
        Err(error) if error.kind() == io::ErrorKind::NotFound => files::folder_of(path),
        Err(error) => return Err(error),
    };
    Ok(access(target, Access::WRITE_OK)?)
}

/// Creates a file that only its owner can read; `force` replaces an existing one.
fn create(path: &Path, force: bool) -> Result<File, KeptError> {
    let made = files::free(path, force).and_then(|()| files::create(path));
    made.map_err(KeptError::of(path))
}

/// Calls `write` with a temporary file, and gives it the name `path` once it is complete. Until then, an existing file stays as
/// it is. If `write` fails, no partial file remains.
///
/// # Errors
/// [`KeptError`], or the error of `write`.
pub fn keep_or<T, E: From<KeptError>>(
    path: &Path,
    force: bool,
    write: impl FnOnce(File) -> Result<T, E>,
) -> Result<T, E> {
    let unwritable = KeptError::unwritable(path);
    // A device is written directly, because it cannot be replaced.
    if fs::metadata(path).is_ok_and(|of| !of.is_file()) {
        return write(create(path, force)?);
    }
    let new = tempfile::NamedTempFile::new_in(files::folder_of(path)).map_err(&unwritable)?;
    let kept = write(new.as_file().try_clone().map_err(&unwritable)?)?;
    check(path, force)?;
    let named = if force { new.persist(path) } else { new.persist_noclobber(path) };
    named.map_err(|error| match error.error.kind() {
        io::ErrorKind::AlreadyExists => KeptError::Taken(path.to_owned()),
        _ => unwritable(error.error),
    })?;
    Ok(kept)
}

/// Like [`keep_or`], for a `write` that fails with I/O errors.
///
/// # Errors
/// [`KeptError`].
pub fn keep<T>(path: &Path, force: bool, write: impl FnOnce(File) -> io::Result<T>) -> Result<T, KeptError> {
    keep_or(path, force, |file| write(file).map_err(KeptError::unwritable(path)))
}

/// Like [`keep`], for a text.
///
/// # Errors
/// [`KeptError`].
pub fn keep_text(path: &Path, force: bool, text: &str) -> Result<(), KeptError> {
    keep(path, force, |mut file| file.write_all(text.as_bytes()))
}

/// The message that the named file was not written, and why. If an older file of that name exists, the message also
/// warns that it is not the answer.
pub fn nothing_kept(path: &Path, why: &str) -> String {
    let is_old = path.symlink_metadata().is_ok_and(|of| of.is_file());
    let old = if is_old { "; what is there is of an earlier run" } else { "" };
    format!("nothing was saved to {}: {why}{old}", shown(path))
}
