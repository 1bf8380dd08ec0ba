//! The lines that the user typed after `/` and `:`, and the small file that keeps them between runs. The file has one
//! line for each, which begins with `/` or `:`; the latest is last.

use imrs_wire::files::{self, FileError};
use std::fmt::Write as _;
use std::io::{self, ErrorKind, Write as _};
use std::path::Path;
use thiserror::Error;

/// How many lines of each kind are remembered.
const REMEMBERED: usize = 50;
/// Longer lines, in bytes, are not kept in the file.
const LONGEST: usize = 512;
/// The longest file that is read, in bytes. [`save`] writes shorter files.
const MOST: u64 = 1 << 16;

/// What a line is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A filter: only rows that match the line are shown.
    Filter,
    /// A command, which the monitor carries out when the user completes the line.
    Command,
}

/// The lines that were typed before, latest last.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Typed {
    filters: Vec<String>,
    commands: Vec<String>,
}

/// Why the file of the lines cannot be used.
#[derive(Debug, Error)]
pub enum TypedError {
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// The line with this number begins with neither `/` nor `:`, which the monitor never writes.
    #[error("line {0} is neither a filter nor a command")]
    Line(usize),
}

impl Typed {
    /// The lines of a kind.
    #[must_use]
    pub fn of(&self, kind: Kind) -> &[String] {
        match kind {
            Kind::Filter => &self.filters,
            Kind::Command => &self.commands,
        }
    }

    /// Adds a line. A line that is repeated is kept once, as the latest.
    pub fn remember(&mut self, kind: Kind, text: &str) {
        let lines = match kind {
            Kind::Filter => &mut self.filters,
            Kind::Command => &mut self.commands,
        };
        lines.retain(|line| line != text);
        if !text.trim().is_empty() {
            lines.push(text.to_owned());
        }
        let surplus = lines.len().saturating_sub(REMEMBERED);
        lines.drain(..surplus);
    }

    /// The text of the file.
    fn text(&self) -> String {
        let mut text = String::new();
        for (sign, lines) in [('/', &self.filters), (':', &self.commands)] {
            let fits = |line: &&String| line.len() <= LONGEST && !line.contains(char::is_control);
            for line in lines.iter().filter(fits) {
                let _ = writeln!(text, "{sign}{line}");
            }
        }
        text
    }

    /// Reads the lines from the text of the file.
    fn parse(text: &str) -> Result<Self, TypedError> {
        let mut typed = Self::default();
        for (number, line) in (1..).zip(text.lines()) {
            let kind = match line.chars().next() {
                Some('/') => Kind::Filter,
                Some(':') => Kind::Command,
                _ => return Err(TypedError::Line(number)),
            };
            if line.contains(char::is_control) {
                return Err(TypedError::Line(number));
            }
            typed.remember(kind, &line[1..]);
        }
        Ok(typed)
    }
}

/// The lines in the file at `path`; none if there is no file.
///
/// # Errors
/// [`TypedError`].
pub fn load(path: &Path) -> Result<Typed, TypedError> {
    match files::text(path, MOST) {
        Ok(text) => Typed::parse(&text),
        Err(FileError::Io(error)) if error.kind() == ErrorKind::NotFound => Ok(Typed::default()),
        Err(error) => Err(error.into()),
    }
}

/// Writes the lines into the file at `path`, which only its owner can read. Lines that another monitor has written
/// there meanwhile are kept. The file is replaced as a whole, so that no reader sees a part of it.
///
/// # Errors
/// An error of the file system, for the file or its folder.
pub fn save(path: &Path, typed: &Typed) -> io::Result<()> {
    let folder = files::folder_of(path);
    std::fs::create_dir_all(folder)?;
    // A file that cannot be read is replaced.
    let mut all = load(path).unwrap_or_default();
    for kind in [Kind::Filter, Kind::Command] {
        typed.of(kind).iter().for_each(|line| all.remember(kind, line));
    }
    let new = path.with_extension(format!("new-{}", std::process::id()));
    files::free(&new, true)?;
    files::create(&new)?.write_all(all.text().as_bytes())?;
    std::fs::rename(&new, path).inspect_err(|_| {
        // The caller gets the error of the rename. An error of this removal would say less.
        let _ = std::fs::remove_file(&new);
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    fn lines(filters: &[&str], commands: &[&str]) -> Typed {
        let owned = |lines: &[&str]| lines.iter().map(|line| (*line).to_owned()).collect();
        Typed { filters: owned(filters), commands: owned(commands) }
    }

    #[test]
    fn what_is_saved_is_loaded_and_only_its_owner_reads_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state/imrs/monitor-lines");
        assert_eq!(load(&path).unwrap(), Typed::default());
        let typed = lines(&["slack<20ms", " b\u{e9}at"], &["port beat", "theme mono"]);
        save(&path, &typed).unwrap();
        assert_eq!(load(&path).unwrap(), typed);
        assert_eq!(path.metadata().unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
        // A second monitor saves other lines. A line that it repeats becomes the latest.
        save(&path, &lines(&["slack<20ms"], &["quit"])).unwrap();
        let both = lines(&[" b\u{e9}at", "slack<20ms"], &["port beat", "theme mono", "quit"]);
        assert_eq!(load(&path).unwrap(), both);
    }

    #[test]
    fn the_file_is_bounded_whatever_is_typed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lines");
        let mut typed = Typed::default();
        for number in 0..400 {
            typed.remember(Kind::Filter, &format!("{number}{}", "\u{1f916}".repeat(number)));
            typed.remember(Kind::Command, &format!("port {number}"));
        }
        typed.remember(Kind::Command, "a\nb");
        save(&path, &typed).unwrap();
        assert!(path.metadata().unwrap().len() <= MOST);
        let kept = load(&path).unwrap();
        assert_eq!(kept.of(Kind::Command).len(), REMEMBERED - 1);
        assert_eq!(kept.of(Kind::Command).last().unwrap(), "port 399");
        assert!(kept.of(Kind::Filter).iter().all(|line| line.len() <= LONGEST));
    }

    #[test]
    fn a_corrupt_file_is_refused_with_its_reason_and_then_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lines");
        let long = format!(":{}\n", "x".repeat(usize::try_from(MOST).unwrap()));
        for (bytes, why) in [
            (&b"/ok\nport beat\n"[..], "line 2 is neither"),
            (b":a\x1b[31m\n", "line 1 is neither"),
            (b"\n", "line 1 is neither"),
            (b"\xff\xfe", "not a text"),
            (long.as_bytes(), "larger than"),
        ] {
            std::fs::write(&path, bytes).unwrap();
            let error = load(&path).unwrap_err().to_string();
            assert!(error.contains(why), "{error}");
            save(&path, &lines(&[], &["quit"])).unwrap();
            assert_eq!(load(&path).unwrap(), lines(&[], &["quit"]));
        }
        // If a folder has the file's name, loading and saving fail, and no temporary file is left behind.
        std::fs::remove_file(&path).unwrap();
        std::fs::create_dir(&path).unwrap();
        assert!(load(&path).unwrap_err().to_string().contains("folder"));
        assert!(save(&path, &lines(&[], &["quit"])).is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
