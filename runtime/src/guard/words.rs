//! The protocol between a node and a guard: first the arguments with which the guard starts, then lines.

use std::ffi::{OsStr, OsString};
use std::path::PathBuf;

/// The task of a guard. Instants are microseconds of `CLOCK_BOOTTIME`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Errand {
    /// The instant at which the time of the action is over; `u64::MAX` never comes.
    pub limit: u64,
    /// The instant at which the lease of the task ends unless it is renewed.
    pub lease: Option<u64>,
    /// The epoch of the task's lease.
    pub epoch: Option<u8>,
    /// The cores that the command may use, as `0,1,5`; `None` for those of the node.
    pub cores: Option<String>,
    /// Whether the command prints a real instead of a whole number.
    pub real: bool,
    /// The named pipe in which the guard also reports the end of the command, and the key of the command in these reports.
    pub notices: Option<(PathBuf, String)>,
    /// The process that started this one. The guard passes its own process id to the process that becomes the command.
    pub parent: Option<i32>,
    /// The program of the command, and its arguments.
    pub command: Vec<OsString>,
}

impl Errand {
    /// The instant by which the command must have ended.
    pub fn deadline(&self) -> u64 {
        self.lease.map_or(self.limit, |lease| lease.min(self.limit))
    }

    /// Converts the errand into arguments of the guard program.
    pub fn words(&self) -> Vec<OsString> {
        let mut words = vec!["--limit".into(), self.limit.to_string().into()];
        let mut add = |name: &str, value: Option<OsString>| {
            words.extend(value.into_iter().flat_map(|value| [name.into(), value]));
        };
        add("--lease", self.lease.map(|at| at.to_string().into()));
        add("--epoch", self.epoch.map(|epoch| epoch.to_string().into()));
        add("--cores", self.cores.clone().map(OsString::from));
        add("--gives", self.real.then(|| REAL.into()));
        add("--parent", self.parent.map(|pid| pid.to_string().into()));
        if let Some((path, key)) = &self.notices {
            add("--notices", Some(path.into()));
            add("--key", Some(key.into()));
        }
        words.push("--".into());
        words.extend(self.command.iter().cloned());
        words
    }

    /// Reads an errand from the arguments of the guard program; `None` if they are invalid.
    pub fn read(words: &[OsString]) -> Option<Self> {
        let split = words.iter().position(|word| word == "--")?;
        let (options, command) = (&words[..split], &words[split + 1..]);
        let mut errand = Self { command: command.to_vec(), ..Self::default() };
        let (mut path, mut key) = (None, None);
        for pair in options.chunks(2) {
            let [name, value] = pair else { return None };
            match name.to_str()? {
                "--limit" => errand.limit = number(value)?,
                "--lease" => errand.lease = Some(number(value)?),
                "--epoch" => errand.epoch = Some(number(value)?),
                "--cores" => errand.cores = Some(value.to_str()?.to_owned()),
                "--gives" => errand.real = value == REAL,
                "--parent" => errand.parent = Some(number(value)?),
                "--notices" => path = Some(PathBuf::from(value)),
                "--key" => key = Some(value.to_str()?.to_owned()),
                _ => return None,
            }
        }
        errand.notices = path.zip(key);
        (!errand.command.is_empty()).then_some(errand)
    }
}

/// The value of the argument `--gives` for a command that prints a real.
const REAL: &str = "real";

fn number<T: std::str::FromStr>(word: &OsStr) -> Option<T> {
    word.to_str()?.parse().ok()
}

/// How a command ended, as its guard reports it in its last line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The command ended with exit code 0, and with this number in the first line of its output.
    Done(i32),
    /// The command ended with another exit code, or by a signal of another process.
    Failed,
    /// The command was killed, because the time of the action was over.
    Late,
    /// The command was killed, because the lease of its task ended.
    LeaseEnded,
    /// The command was killed, because the node stopped it or was gone.
    Stopped,
    /// The command could not be started; the number is the kernel's error code.
    Unstarted(i32),
}

impl Outcome {
    /// The outcome as a line that the guard writes.
    pub fn line(self) -> String {
        match self {
            Self::Done(value) => format!("done {value}\n"),
            Self::Failed => "failed\n".into(),
            Self::Late => "late\n".into(),
            Self::LeaseEnded => "lease-ended\n".into(),
            Self::Stopped => "stopped\n".into(),
            Self::Unstarted(errno) => format!("unstarted {errno}\n"),
        }
    }

    /// Reads the outcome in a line of the guard; `None` for any other line.
    pub fn read(line: &str) -> Option<Self> {
        let (word, value) = line.split_once(' ').unwrap_or((line, ""));
        Some(match word {
            "done" => Self::Done(value.parse().ok()?),
            "failed" => Self::Failed,
            "late" => Self::Late,
            "lease-ended" => Self::LeaseEnded,
            "stopped" => Self::Stopped,
            "unstarted" => Self::Unstarted(value.parse().ok()?),
            _ => return None,
        })
    }
}

/// The line with which the guard names the process group of its command.
pub fn began(pid: i32) -> String {
    format!("began {pid}\n")
}

/// Reads the process group in a line that [`began`] wrote.
pub fn read_began(line: &str) -> Option<i32> {
    line.strip_prefix("began ")?.parse().ok()
}

/// The line with which the node renews the lease.
pub fn lease(until: u64) -> String {
    format!("lease {until}\n")
}

/// Reads the end of the lease in a line that [`lease`] wrote.
pub fn read_lease(line: &str) -> Option<u64> {
    line.strip_prefix("lease ")?.parse().ok()
}

/// Assembles whole lines from the pieces that a pipe gives. An unfinished line, of a process that was killed, is dropped.
#[derive(Debug, Default)]
pub struct Lines(Vec<u8>);

/// The length limit of a line. No line of these protocols is longer.
const LONGEST_LINE: usize = 4096;

impl Lines {
    /// Adds bytes that were read from the pipe.
    pub fn add(&mut self, bytes: &[u8]) {
        self.0.extend_from_slice(bytes);
        if self.0.len() > LONGEST_LINE && !self.0.contains(&b'\n') {
            self.0.clear();
        }
    }

    /// The next whole line, without its line break.
    pub fn next(&mut self) -> Option<String> {
        let end = self.0.iter().position(|&byte| byte == b'\n')?;
        let line: Vec<u8> = self.0.drain(..=end).take(end).collect();
        Some(String::from_utf8_lossy(&line).into_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_guard_is_started_for_comes_back_from_its_arguments() {
        let bare = Errand { limit: 7, command: vec!["true".into()], ..Errand::default() };
        let full = Errand {
            real: true,
            limit: u64::MAX,
            lease: Some(5),
            epoch: Some(200),
            cores: Some("0,3".into()),
            notices: Some(("/tmp/a b".into(), "1-0-4".into())),
            parent: Some(77),
            command: ["grip", "--hard", "--", "--limit", "-3"].map(OsString::from).to_vec(),
        };
        assert_eq!((bare.deadline(), full.deadline()), (7, 5));
        for errand in [bare, full] {
            assert_eq!(Errand::read(&errand.words()), Some(errand));
        }
        for wrong in
            [&["--limit", "7"][..], &["--limit", "--", "true"], &["--limit", "x", "--", "true"], &["--"]]
        {
            let words: Vec<OsString> = wrong.iter().map(OsString::from).collect();
            assert_eq!(Errand::read(&words), None, "{wrong:?}");
        }
    }

    #[test]
    fn lines_come_whole_or_not_at_all() {
        let mut lines = Lines::default();
        lines.add(b"lease 5\nlease 6\nleas");
        assert_eq!(
            [lines.next(), lines.next(), lines.next()],
            [Some("lease 5".into()), Some("lease 6".into()), None]
        );
        lines.add(b"e 7\n");
        assert_eq!(lines.next().as_deref().and_then(read_lease), Some(7));
        lines.add(&[b'x'; LONGEST_LINE + 1]);
        lines.add(b"done 3\n");
        assert_eq!(lines.next().as_deref().and_then(Outcome::read), Some(Outcome::Done(3)));
        for outcome in [
            Outcome::Done(-4),
            Outcome::Failed,
            Outcome::Late,
            Outcome::LeaseEnded,
            Outcome::Stopped,
            Outcome::Unstarted(2),
        ] {
            assert_eq!(Outcome::read(outcome.line().trim_end()), Some(outcome));
        }
        assert_eq!((read_began(began(9).trim_end()), Outcome::read("began 9")), (Some(9), None));
    }
}
