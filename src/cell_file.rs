//! Reads and replaces cell files; `-` reads standard input.

pub use imrs_client::cell_file::{CellFileError, is_stdin, read, shown};

use imrs_wire::files;
use rustix::fs::{Access, access};
use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// The error that a cell file cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("{}: cannot be written: {source}", path.display())]
pub struct Unwritable {
    path: PathBuf,
    source: io::Error,
}

/// Replaces the text of a file atomically: writes a new file in the same folder, syncs it, and renames it. If that
/// fails, the old file stays.
///
/// # Errors
/// [`Unwritable`].
pub fn replace(path: &Path, text: &str) -> Result<(), Unwritable> {
    replaced(path, text).map_err(|source| Unwritable { path: path.to_owned(), source })
}

fn replaced(path: &Path, text: &str) -> io::Result<()> {
    // If the path is a symbolic link, the file to which it leads is replaced, and the link stays.
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
