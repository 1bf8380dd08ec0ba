//! Notices about the commands of actions: a node writes a notice before a command begins, and the command's guard writes one
//! when the command and all that it started have ended. The notices come through a named pipe, so they arrive even if the
//! node is dead (D142).

use imrs_runtime::guard::Notice;
use rustix::fs::{CWD, FileType, Mode, OFlags, mknodat, open};
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// The launcher's end of the named pipe.
pub struct Noticed {
    path: PathBuf,
    pipe: File,
    /// The beginning of a notice whose end has not been read yet.
    begun: Vec<u8>,
    _dir: TempDir,
}

impl Noticed {
    /// Creates the named pipe, in a folder that only this user can open.
    ///
    /// # Errors
    /// An error if there is no folder for temporary files, or a pipe cannot be created in it.
    pub fn new() -> io::Result<Self> {
        let dir = tempfile::Builder::new().prefix("imrs").tempdir()?;
        let path = dir.path().join("commands");
        mknodat(CWD, &path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0)?;
        // The launcher opens the pipe for writing, too, so that reading never meets the end of the file.
        let flags = OFlags::RDWR | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let pipe = File::from(open(&path, flags, Mode::empty())?);
        Ok(Self { path, pipe, begun: Vec::new(), _dir: dir })
    }

    /// The path at which nodes and guards write notices.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Reads all pending notices. They include everything that a process wrote before it was killed.
    pub fn drain(&mut self) -> Vec<Notice> {
        let mut bytes = [0; 1 << 14];
        while let Ok(read @ 1..) = self.pipe.read(&mut bytes) {
            self.begun.extend_from_slice(&bytes[..read]);
        }
        let whole = self.begun.iter().rposition(|&byte| byte == b'\n').map_or(0, |end| end + 1);
        let lines: Vec<u8> = self.begun.drain(..whole).collect();
        String::from_utf8_lossy(&lines).lines().filter_map(Notice::read).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn notices_come_whole_and_in_their_order() {
        let mut noticed = Noticed::new().expect("a pipe");
        assert_eq!(noticed.drain(), []);
        let mut pipe = File::options().write(true).open(noticed.path()).expect("it is there");
        let began = Notice::Began { key: "0-0-1".into(), task: "r1".into(), at: 5 };
        let ended = Notice::Ended { key: "0-0-1".into(), at: 6 };
        let text = format!("{}{}", began.line(), ended.line());
        let (first, rest) = text.split_at(text.len() - 3);
        pipe.write_all(first.as_bytes()).expect("room");
        assert_eq!(noticed.drain(), [began]);
        pipe.write_all(rest.as_bytes()).expect("room");
        assert_eq!(noticed.drain(), [ended]);
    }
}
