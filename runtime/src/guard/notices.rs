//! Tells a launcher which commands run, by lines in a named pipe that the launcher owns. So the end of a command is reported
//! even if its node is dead.

use crate::clock;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::fs::{Mode, OFlags, open};
use rustix::io::Errno;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// A notice about a command. Instants are microseconds of `CLOCK_BOOTTIME`, which all processes of a machine share.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Notice {
    /// A node starts the command. The node writes this notice before the command runs.
    Began {
        /// Identifies the command in its later notices, such as `1-0-4`.
        key: String,
        /// The task to which the action belongs.
        task: String,
        /// The instant of the start.
        at: u64,
    },
    /// The command and all that it started have ended.
    Ended {
        /// Identifies the command: the key that [`Began`](Self::Began) gave.
        key: String,
        /// The instant of the end.
        at: u64,
    },
    /// The command's guard died first, so it is not known whether everything that the command started has ended.
    Lost {
        /// Identifies the command: the key that [`Began`](Self::Began) gave.
        key: String,
        /// The instant at which the node noticed the guard's death.
        at: u64,
    },
}

impl Notice {
    /// The notice that a command has ended now.
    pub(crate) fn ended(key: &str) -> Self {
        Self::Ended { key: key.to_owned(), at: clock::next() }
    }

    /// The notice as a line, such as `ended 1-0-4 81234567`.
    #[must_use]
    pub fn line(&self) -> String {
        match self {
            Self::Began { key, task, at } => format!("began {key} {at} {task}\n"),
            Self::Ended { key, at } => format!("ended {key} {at}\n"),
            Self::Lost { key, at } => format!("lost {key} {at}\n"),
        }
    }

    /// Reads the notice in a line without its line break; `None` if the line is no notice.
    #[must_use]
    pub fn read(line: &str) -> Option<Self> {
        let mut words = line.splitn(4, ' ');
        let (word, key, at) = (words.next()?, words.next()?.to_owned(), words.next()?.parse().ok()?);
        Some(match (word, words.next()) {
            ("began", Some(task)) => Self::Began { key, task: task.to_owned(), at },
            ("ended", None) => Self::Ended { key, at },
            ("lost", None) => Self::Lost { key, at },
            _ => return None,
        })
    }
}

/// A launcher's named pipe, open for lines.
#[derive(Debug)]
pub struct Notices {
    path: PathBuf,
    pipe: File,
}

impl Notices {
    /// Opens the pipe.
    ///
    /// # Errors
    /// An error if the pipe is not there, or no process reads it.
    pub fn open(path: &Path) -> io::Result<Self> {
        let flags = OFlags::WRONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        Ok(Self { path: path.to_owned(), pipe: File::from(open(path, flags, Mode::empty())?) })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Writes a line, whole or not at all.
    ///
    /// # Errors
    /// An error if the pipe is full, or no process reads it.
    pub(crate) fn tell(&self, notice: &Notice) -> io::Result<()> {
        (&self.pipe).write_all(notice.line().as_bytes())
    }

    /// Writes a line as soon as the pipe has room for it, and waits until then.
    pub(crate) fn tell_at_last(&self, notice: &Notice) {
        while let Err(error) = self.tell(notice) {
            if error.kind() != io::ErrorKind::WouldBlock {
                // No process reads the pipe any more.
                return;
            }
            match poll(&mut [PollFd::new(&self.pipe, PollFlags::OUT)], None) {
                Ok(_) | Err(Errno::INTR) => {}
                Err(_) => return,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_notice_comes_back_from_its_line() {
        for notice in [
            Notice::Began { key: "1-0-4".into(), task: "arm L".into(), at: 7 },
            Notice::Ended { key: "1-0-4".into(), at: u64::MAX },
            Notice::Lost { key: "k".into(), at: 0 },
        ] {
            assert_eq!(Notice::read(notice.line().trim_end()), Some(notice));
        }
        for line in ["", "began k 7", "ended k", "ended k x", "ended k 7 more", "other k 7"] {
            assert_eq!(Notice::read(line), None, "{line}");
        }
    }
}
