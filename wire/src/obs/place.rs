//! The paths of the Unix sockets that nodes create and monitors look for: `<base>/<cell>/<node>-<pid>.sock`.
//!
//! The base is `$XDG_RUNTIME_DIR/imrs`, or else `imrs-<uid>` in the folder for temporary files. A node creates these
//! folders with access for its user only. Neither nodes nor monitors use a folder that belongs to another user.

use std::ffi::OsStr;
use std::fs::{self, DirBuilder};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The longest path of a Unix socket, in bytes.
pub const MAX_PATH: usize = 107;
/// The longest encoded name of a cell or node in a file name, in bytes.
const MAX_NAME: usize = 32;

/// Why a socket path cannot be used.
#[derive(Debug, Error)]
pub enum PlaceError {
    /// The folder belongs to another user, or other users have access to it.
    #[error("{0} is not private to this user: remove it, or set XDG_RUNTIME_DIR")]
    NotPrivate(PathBuf),
    /// The path would be longer than [`MAX_PATH`].
    #[error("{0} is too long for a socket: set XDG_RUNTIME_DIR to a shorter path")]
    TooLong(PathBuf),
    /// The folder could not be created or inspected.
    #[error("cannot use the socket folder {path}: {source}")]
    Io {
        /// The folder in which the operation failed.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
}

/// The folder with one folder per cell. It need not exist.
#[must_use]
pub fn base_dir() -> PathBuf {
    base_from(std::env::var_os("XDG_RUNTIME_DIR").as_deref(), &std::env::temp_dir(), own_uid())
}

/// The folder of the sockets of `cell`'s nodes. It need not exist.
#[must_use]
pub fn socket_dir(cell: &str) -> PathBuf {
    base_dir().join(file_name(cell))
}

/// Creates the folder of `cell` under [`base_dir`], private to this user. Returns the path of the socket of `node` in
/// the process `pid`.
///
/// # Errors
/// [`PlaceError`].
pub fn prepare_socket(cell: &str, node: &str, pid: u32) -> Result<PathBuf, PlaceError> {
    prepare_in(&base_dir(), cell, node, pid)
}

/// As [`prepare_socket`], under another base folder.
///
/// # Errors
/// [`PlaceError`].
pub fn prepare_in(base: &Path, cell: &str, node: &str, pid: u32) -> Result<PathBuf, PlaceError> {
    let dir = base.join(file_name(cell));
    for private in [base, &dir] {
        let made = DirBuilder::new().recursive(true).mode(0o700).create(private);
        let meta = made.and_then(|()| fs::symlink_metadata(private));
        let meta = meta.map_err(|source| PlaceError::Io { path: private.to_owned(), source })?;
        if !meta.is_dir() || meta.mode() & 0o077 != 0 || Some(meta.uid()) != own_uid() {
            return Err(PlaceError::NotPrivate(private.to_owned()));
        }
    }
    let path = dir.join(format!("{}-{pid}.sock", file_name(node)));
    if path.as_os_str().len() > MAX_PATH { Err(PlaceError::TooLong(path)) } else { Ok(path) }
}

/// The sockets of all cells under `base`, sorted. A missing `base` has no sockets. A folder of another user is skipped.
///
/// # Errors
/// [`PlaceError::Io`] if `base` exists and cannot be read.
pub fn sockets_in(base: &Path) -> Result<Vec<PathBuf>, PlaceError> {
    let entries = match fs::read_dir(base) {
        Ok(entries) => entries,
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => return Err(PlaceError::Io { path: base.to_owned(), source }),
    };
    let mut found: Vec<_> = entries.flatten().flat_map(|entry| sockets_of(&entry.path())).collect();
    found.sort();
    Ok(found)
}

/// The sockets in the folder of one cell. A missing folder has no sockets, and a folder of another user is skipped.
#[must_use]
pub fn sockets_of(cell: &Path) -> Vec<PathBuf> {
    if !fs::symlink_metadata(cell).is_ok_and(|m| m.is_dir() && Some(m.uid()) == own_uid()) {
        return Vec::new();
    }
    let files = fs::read_dir(cell).into_iter().flatten().flatten().map(|entry| entry.path());
    files.filter(|path| pid_of(path).is_some()).collect()
}

/// The process id in a socket's file name.
#[must_use]
pub fn pid_of(socket: &Path) -> Option<u32> {
    let stem = socket.file_name().and_then(OsStr::to_str)?.strip_suffix(".sock")?;
    stem.rsplit_once('-')?.1.parse().ok()
}

/// The node's name in a socket's file name, encoded by [`file_name`].
#[must_use]
pub fn node_of(socket: &Path) -> Option<&str> {
    let stem = socket.file_name().and_then(OsStr::to_str)?.strip_suffix(".sock")?;
    stem.rsplit_once('-').map(|(node, _)| node)
}

/// Removes `socket` if no process can be listening: this user owns it, its process is gone, and a connection is
/// refused. Returns whether it was removed.
#[must_use]
pub fn remove_if_stale(socket: &Path) -> bool {
    let ours = fs::symlink_metadata(socket).is_ok_and(|m| Some(m.uid()) == own_uid());
    let refused = || UnixStream::connect(socket).is_err_and(|e| e.kind() == io::ErrorKind::ConnectionRefused);
    let gone = || pid_of(socket).is_some_and(is_gone);
    ours && gone() && refused() && fs::remove_file(socket).is_ok()
}

/// Whether the process has ended: no process has this id, or its parent has not reaped it yet. False if `/proc` is
/// missing.
fn is_gone(pid: u32) -> bool {
    let Ok(stat) = fs::read_to_string(format!("/proc/{pid}/stat")) else {
        return Path::new("/proc/self").exists() && !Path::new(&format!("/proc/{pid}")).exists();
    };
    // The process name before the last parenthesis may contain any characters.
    let state = stat.rsplit_once(')').and_then(|(_, rest)| rest.trim_start().chars().next());
    matches!(state, Some('Z' | 'X'))
}

fn base_from(runtime_dir: Option<&OsStr>, temp: &Path, uid: Option<u32>) -> PathBuf {
    let named = runtime_dir.map(Path::new).filter(|dir| dir.is_absolute());
    let private = || temp.join(uid.map_or_else(|| "imrs".to_owned(), |uid| format!("imrs-{uid}")));
    named.map_or_else(private, |dir| dir.join("imrs"))
}

/// The user id of this process, read from `/proc/self` or from the owner of its home folder.
fn own_uid() -> Option<u32> {
    let of = |path: &Path| fs::metadata(path).ok().map(|m| m.uid());
    of(Path::new("/proc/self")).or_else(|| of(Path::new(&std::env::var_os("HOME")?)))
}

/// A file name for `name`. Letters, digits, `_` and inner `.` and `-` stay, and any other byte becomes `%XX`. A long name is
/// cut and ends with a hash of the whole name. The encoding is lossy, so only the node itself can tell its name.
#[must_use]
pub fn file_name(name: &str) -> String {
    let mut out = String::new();
    for (i, byte) in name.bytes().enumerate() {
        let plain = byte.is_ascii_alphanumeric() || byte == b'_' || (i > 0 && matches!(byte, b'.' | b'-'));
        if plain {
            out.push(char::from(byte));
        } else {
            out.push_str(&format!("%{byte:02x}"));
        }
    }
    if out.len() > MAX_NAME {
        // The FNV-1a hash distinguishes long names with the same beginning.
        let fnv = |hash: u32, byte: u8| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
        let hash = name.bytes().fold(0x811c_9dc5, fnv);
        out.truncate(MAX_NAME - 9);
        out.push_str(&format!("~{hash:08x}"));
    }
    if out.is_empty() { "%".to_owned() } else { out }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_file_names_that_cannot_leave_the_folder() {
        assert_eq!(file_name("beam-lift"), "beam-lift");
        assert_eq!(file_name("../x"), "%2e.%2fx");
        assert_eq!(file_name("-a b\u{1b}"), "%2da%20b%1b");
        assert_eq!(file_name(""), "%");
        let (a, b) = (file_name(&"x".repeat(99)), file_name(&"x".repeat(98)));
        assert!(a.len() == MAX_NAME && b.len() == MAX_NAME && a != b, "{a} {b}");
    }

    #[test]
    fn the_base_is_the_runtime_folder_or_a_private_one() {
        let tmp = Path::new("/tmp");
        assert_eq!(base_from(Some(OsStr::new("/run/user/7")), tmp, Some(7)), Path::new("/run/user/7/imrs"));
        assert_eq!(base_from(Some(OsStr::new("")), tmp, Some(7)), Path::new("/tmp/imrs-7"));
        assert_eq!(base_from(None, tmp, None), Path::new("/tmp/imrs"));
    }

    #[test]
    fn the_process_is_read_from_the_file_name() {
        assert_eq!(pid_of(Path::new("/r/imrs/c/left-arm-812.sock")), Some(812));
        assert_eq!(pid_of(Path::new("/r/imrs/c/left.sock")), None);
        assert_eq!(pid_of(Path::new("/r/imrs/c/left-1.tmp")), None);
    }
}
