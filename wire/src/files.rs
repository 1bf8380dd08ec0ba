//! Opens and creates files that are named on a command line. Such a name may be a pipe, a device or an existing file.
//! So opening never blocks, reading stops at a limit, and writing replaces nothing.
//!
//! ```
//! use imrs_wire::files::{self, FileError};
//! use std::path::Path;
//!
//! assert!(matches!(files::text(Path::new("/dev/zero"), 4096), Err(FileError::NotAFile)));
//! assert!(matches!(files::text(Path::new("/"), 4096), Err(FileError::Folder)));
//! ```

use rustix::fs::{Mode, OFlags};
use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::Path;
use thiserror::Error;

/// Why a file cannot be used.
#[derive(Debug, Error)]
pub enum FileError {
    /// The name belongs to a folder.
    #[error("this is a folder: name a file in it")]
    Folder,
    /// The name belongs to a pipe, a device or a socket: reading it might never end.
    #[error("not a regular file, and reading it might never end: name a file")]
    NotAFile,
    /// The file has more bytes than the caller reads.
    #[error("larger than {0} bytes, the most that is read: is it the right file?")]
    TooLarge(u64),
    /// The file is not UTF-8 text.
    #[error("not a text in UTF-8")]
    NotText,
    /// The file holds a secret, and users other than its owner can read it.
    #[error("other users can read it (mode {0:03o}): make it yours alone with `chmod 600`")]
    NotPrivate(u32),
    /// A file of this name exists, and its contents would be lost.
    #[error("there is a file of this name: name another one, or give --force to replace it")]
    Exists,
    /// The operating system refused the operation.
    #[error(transparent)]
    Io(#[from] io::Error),
}

impl From<FileError> for io::Error {
    fn from(error: FileError) -> Self {
        match error {
            FileError::Io(error) => error,
            other => Self::other(other),
        }
    }
}

/// Opens a regular file to read it. Unlike opening a pipe, this never waits for a writer.
///
/// # Errors
/// [`FileError`].
pub fn open(path: &Path) -> Result<File, FileError> {
    let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
    let file = match rustix::fs::open(path, flags, Mode::empty()) {
        Ok(file) => File::from(file),
        // This is the error for a socket, or for a device without a driver.
        Err(rustix::io::Errno::NXIO | rustix::io::Errno::NODEV) => return Err(FileError::NotAFile),
        Err(error) => return Err(FileError::Io(error.into())),
    };
    let of = file.metadata()?;
    match () {
        () if of.is_dir() => Err(FileError::Folder),
        () if !of.is_file() => Err(FileError::NotAFile),
        () => Ok(file),
    }
}

/// The text of a regular file of at most `most` bytes.
///
/// # Errors
/// [`FileError`].
pub fn text(path: &Path, most: u64) -> Result<String, FileError> {
    text_of(open(path)?, most)
}

/// The text of a regular file that only its owner can read: a secret.
///
/// # Errors
/// [`FileError`].
pub fn secret(path: &Path, most: u64) -> Result<String, FileError> {
    let file = open(path)?;
    let mode = file.metadata()?.mode() & 0o777;
    if mode & 0o077 != 0 {
        return Err(FileError::NotPrivate(mode));
    }
    text_of(file, most)
}

fn text_of(file: File, most: u64) -> Result<String, FileError> {
    let mut bytes = Vec::new();
    file.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        return Err(FileError::TooLarge(most));
    }
    String::from_utf8(bytes).map_err(|_| FileError::NotText)
}

/// Creates a file that only its owner can read, and opens it for writing. An existing file is an error. An existing
/// device, such as `/dev/null`, is opened, because writing to it destroys nothing.
///
/// # Errors
/// [`FileError::Exists`], or the error of the operating system.
pub fn create(path: &Path) -> Result<File, FileError> {
    let made = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path);
    match made {
        Err(error) if error.kind() != ErrorKind::AlreadyExists => Err(FileError::Io(error)),
        Err(_) if is_device(path) => Ok(OpenOptions::new().write(true).open(path)?),
        Err(_) => Err(FileError::Exists),
        Ok(file) => Ok(file),
    }
}

/// The folder that contains the file.
#[must_use]
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Returns the error that [`create`] would return for an existing name. With `force` a regular file of that name is
/// removed: call this right before [`create`], and [`check`] earlier.
///
/// # Errors
/// [`FileError`].
pub fn free(path: &Path, force: bool) -> Result<(), FileError> {
    check(path, force)?;
    match path.symlink_metadata() {
        Ok(of) if force && of.is_file() => Ok(std::fs::remove_file(path)?),
        _ => Ok(()),
    }
}

/// Returns the errors of [`free`], and changes nothing.
///
/// # Errors
/// [`FileError`].
pub fn check(path: &Path, force: bool) -> Result<(), FileError> {
    match path.symlink_metadata() {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        Err(error) => Err(error.into()),
        Ok(of) if of.is_dir() => Err(FileError::Folder),
        Ok(_) if is_device(path) => Ok(()),
        Ok(of) if force && of.is_file() => Ok(()),
        Ok(of) if force && !of.is_symlink() => Err(FileError::NotAFile),
        Ok(_) => Err(FileError::Exists),
    }
}

/// Removes an unfinished output file. Anything but a regular file, such as a device or a link, stays.
pub fn discard(path: &Path) {
    if path.symlink_metadata().is_ok_and(|of| of.is_file()) {
        // If the file cannot be removed, it stays: the caller already reports the error because of which the output is
        // discarded.
        let _ = std::fs::remove_file(path);
    }
}

fn is_device(path: &Path) -> bool {
    path.metadata().is_ok_and(|of| of.file_type().is_char_device())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::Permissions;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn what_is_no_regular_file_is_refused_without_waiting() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, Mode::RWXU, 0).unwrap();
        let socket = folder.path().join("socket");
        let _served = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        for path in [&pipe, &socket, Path::new("/dev/zero"), Path::new("/dev/tty")] {
            let refused = open(path).map(|_| ());
            assert!(matches!(refused, Err(FileError::NotAFile)), "{}: {refused:?}", path.display());
        }
        assert!(matches!(open(folder.path()), Err(FileError::Folder)));
    }

    #[test]
    fn a_file_is_read_up_to_a_size() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "12345678").unwrap();
        assert_eq!(text(&file, 8).unwrap(), "12345678");
        assert!(matches!(text(&file, 7), Err(FileError::TooLarge(7))));
        std::fs::write(&file, b"\xff").unwrap();
        assert!(matches!(text(&file, 7), Err(FileError::NotText)));
    }

    #[test]
    fn a_secret_that_others_can_read_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("secret");
        std::fs::write(&file, "secret").unwrap();
        for (mode, is_secret) in
            [(0o600, true), (0o400, true), (0o640, false), (0o604, false), (0o610, false)]
        {
            std::fs::set_permissions(&file, Permissions::from_mode(mode)).unwrap();
            let read = secret(&file, 100);
            assert_eq!(read.is_ok(), is_secret, "{mode:o}");
            assert!(is_secret || read.unwrap_err().to_string().contains("chmod 600"), "{mode:o}");
        }
    }

    #[test]
    fn what_is_written_is_private_and_replaces_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("new");
        free(&file, false).unwrap();
        let mode = create(&file).unwrap().metadata().unwrap().mode() & 0o777;
        assert_eq!(mode, 0o600);
        assert!(matches!(create(&file), Err(FileError::Exists)));
        assert!(matches!(free(&file, false), Err(FileError::Exists)));
        check(&file, true).unwrap();
        assert!(file.exists());
        free(&file, true).unwrap();
        create(&file).unwrap();
        assert!(matches!(free(folder.path(), true), Err(FileError::Folder)));
        free(Path::new("/dev/null"), false).unwrap();
        create(Path::new("/dev/null")).unwrap();
    }

    #[test]
    fn only_regular_files_are_discarded() {
        let folder = tempfile::tempdir().unwrap();
        let [file, link] = ["file", "link"].map(|name| folder.path().join(name));
        std::fs::write(&file, "half").unwrap();
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
        for path in [&file, &link, folder.path()] {
            discard(path);
        }
        assert!(!file.exists() && link.symlink_metadata().is_ok() && folder.path().exists());
    }
}
