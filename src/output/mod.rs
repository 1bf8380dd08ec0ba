//! Standard output and standard error: coloured for people, plain otherwise, and quiet once the reader has exited.

mod color;
mod printer;

pub use color::Color;
pub use imrs_launch::words::{count, grouped, span};
pub use printer::{Notice, Untaken, notice};

use crate::failure::Failure;
use anstream::AutoStream;
use anstream::adapter::strip_str;
use anstyle::{AnsiColor, Style};
use imrs_launch::LaunchError;
use imrs_wire::text::{self, acts};
use indicatif::ProgressBar;
use printer::Printer;
use std::borrow::Cow;
use std::fmt::{self, Display};
use std::io::{self, IsTerminal, Stdout, Write};
use std::sync::OnceLock;
use std::time::Duration;

/// The style of good news; the text says so as well.
pub const GOOD: Style = AnsiColor::Green.on_default().bold();
/// The style of bad news; the text says so as well.
pub const BAD: Style = AnsiColor::Red.on_default().bold();
/// The style of notes and warnings.
pub const NOTE: Style = AnsiColor::Yellow.on_default();
/// The style of headings.
pub const HEAD: Style = Style::new().bold();
/// The style of less important text.
pub const FAINT: Style = Style::new().dimmed();

/// Standard output.
pub struct Output {
    lines: Lines,
    /// When the output has colour, as the user chose.
    pub color: Color,
}

/// The ways in which lines are written.
enum Lines {
    /// The calling thread writes, and may block on the reader.
    Direct {
        stream: Box<AutoStream<Stdout>>,
        /// Whether the reader has closed the pipe.
        closed: bool,
    },
    /// A thread of its own writes the lines. If `plain`, it removes escapes.
    Aside { printer: Printer, plain: bool },
}

impl Output {
    /// Opens standard output, with colour as the user chose.
    pub fn new(color: Color) -> Self {
        let stream = Box::new(AutoStream::new(io::stdout(), color.into()));
        Self { lines: Lines::Direct { stream, closed: false }, color }
    }

    /// Starts threads that from now on write to standard output and standard error, so that a slow reader blocks no
    /// caller. Lines written in [passing](Self::passing) are dropped if the reader is too slow, and counted by
    /// `notice`.
    ///
    /// # Errors
    /// [`Failure::Launch`] if the operating system refuses a thread.
    pub fn step_aside(&mut self, notice: Notice, progress: ProgressBar) -> Result<(), Failure> {
        let hidden = ProgressBar::hidden();
        // If lines and progress bar share one terminal, one thread draws both.
        let shown = io::stdout().is_terminal();
        let (with_lines, with_errors) = if shown { (progress, hidden) } else { (hidden, progress) };
        complain_aside(with_errors).map_err(LaunchError::Start)?;
        let plain = matches!(&self.lines, Lines::Direct { stream, .. } if stream.current_choice() == anstream::ColorChoice::Never);
        let printer = Printer::start(io::stdout(), notice, with_lines).map_err(LaunchError::Start)?;
        self.lines = Lines::Aside { printer, plain };
        Ok(())
    }

    /// Writes a line. A closed pipe (`imrs verify | head`) is no error.
    ///
    /// # Errors
    /// [`Failure::Output`].
    pub fn line(&mut self, line: impl Display) -> Result<(), Failure> {
        let line = line.to_string();
        self.write(&harmless(&line), true)
    }

    /// Writes a line that may be dropped if the reader is too slow.
    ///
    /// # Errors
    /// [`Failure::Output`].
    pub fn passing(&mut self, line: impl Display) -> Result<(), Failure> {
        let line = line.to_string();
        self.write(&harmless(&line), false)
    }

    /// Writes the bytes of a text unchanged, because the answer is a file. On a terminal its escapes are made harmless.
    ///
    /// # Errors
    /// [`Failure::Output`].
    pub fn file(&mut self, text: &str) -> Result<(), Failure> {
        let text = if io::stdout().is_terminal() { harmless(text) } else { Cow::Borrowed(text) };
        // `AutoStream` would remove escapes if colours are off, so it is bypassed.
        let mut stream = io::stdout().lock();
        let written = stream.write_all(text.as_bytes()).and_then(|()| stream.flush());
        self.note(written)
    }

    fn write(&mut self, line: &str, kept: bool) -> Result<(), Failure> {
        let written = match &mut self.lines {
            Lines::Direct { closed: true, .. } => return Ok(()),
            Lines::Direct { stream, .. } => writeln!(stream, "{line}").and_then(|()| stream.flush()),
            Lines::Aside { printer, plain } => {
                let text = if *plain { strip_str(line).to_string() } else { line.to_owned() };
                printer.push(text + "\n", kept);
                Ok(())
            }
        };
        self.note(written)
    }

    fn note(&mut self, written: io::Result<()>) -> Result<(), Failure> {
        match written {
            Ok(()) => Ok(()),
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {
                if let Lines::Direct { closed, .. } = &mut self.lines {
                    *closed = true;
                }
                Ok(())
            }
            Err(error) => Err(Failure::Output(error)),
        }
    }

    /// Sets the progress line, or removes it.
    pub fn progress(&self, text: Option<&str>) {
        for printer in self.printer().into_iter().chain(ERRORS.get()) {
            match text {
                Some(text) => printer.progress(text.to_owned()),
                None => printer.clear(),
            }
        }
    }

    /// Waits until everything is written, at most for `within`, and only until `interrupted`. Returns the lines that are not
    /// written.
    pub fn settle(&self, within: Duration, interrupted: impl Fn() -> bool) -> Untaken {
        self.printer().map(|printer| printer.settle(within, interrupted)).unwrap_or_default()
    }

    const fn printer(&self) -> Option<&Printer> {
        match &self.lines {
            Lines::Aside { printer, .. } => Some(printer),
            Lines::Direct { .. } => None,
        }
    }

    /// Writes a text that has its own line breaks.
    ///
    /// # Errors
    /// [`Failure::Output`].
    pub fn text(&mut self, text: &str) -> Result<(), Failure> {
        match text.strip_suffix('\n') {
            Some(lines) => self.line(lines),
            None if text.is_empty() => Ok(()),
            None => self.line(text),
        }
    }

    /// Writes a value as one line of JSON.
    ///
    /// # Errors
    /// [`Failure::Output`].
    pub fn json(&mut self, value: &impl serde::Serialize) -> Result<(), Failure> {
        let text = serde_json::to_string(value).map_err(|e| Failure::Output(e.into()))?;
        self.write(&text::json(&text), true)
    }
}

/// Escapes a text from a cell, a recording or a peer for a terminal. Line breaks and the styles of this program stay;
/// any other character on which a terminal acts is written out. Texts that must stay on one line are escaped where the
/// program receives them ([`text::one_line`]).
pub fn harmless(text: &str) -> Cow<'_, str> {
    if !text.contains(acts) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        let length = match c {
            '\n' | '\t' => 1,
            '\x1b' => style_at(rest).unwrap_or(0),
            c if acts(c) => 0,
            c => c.len_utf8(),
        };
        match length {
            0 => out.extend(c.escape_default()),
            length => out.push_str(&rest[..length]),
        }
        rest = &rest[length.max(c.len_utf8())..];
    }
    Cow::Owned(out)
}

/// The parameters of text styles that cannot hide text: reset, bold, faint, underlined, and colours of letters.
const HARMLESS: [&str; 17] =
    ["", "0", "1", "2", "4", "31", "32", "33", "34", "35", "36", "91", "92", "93", "94", "95", "96"];

/// The length of the style sequence at the beginning of a text; `None` if there is none, or if it could hide text.
fn style_at(text: &str) -> Option<usize> {
    let parameters = text.strip_prefix("\x1b[")?;
    let (parameters, _) = parameters.split_once('m')?;
    parameters.split(';').all(|one| HARMLESS.contains(&one)).then_some(parameters.len() + 3)
}

/// The thread that writes to standard error, once [`complain_aside`] has started it.
static ERRORS: OnceLock<Printer> = OnceLock::new();

/// How long the end of the process waits for the reader of standard error.
const COMPLAINED_WITHIN: Duration = Duration::from_secs(1);

/// Makes every later [complaint](complain) go to a thread of its own, so that none waits for the reader of standard error.
///
/// # Errors
/// An error if the operating system refuses a thread.
pub fn complain_aside(progress: ProgressBar) -> io::Result<()> {
    let printer = Printer::start(io::stderr(), notice, progress)?;
    // A process starts at most one such thread, so the value is never set twice.
    let _ = ERRORS.set(printer);
    Ok(())
}

/// Prints an error message on standard error. A failure to write it is ignored.
pub fn complain(what: impl Display) {
    let what = what.to_string();
    let line = format!("imrs: {}\n", harmless(&what));
    match ERRORS.get() {
        Some(printer) => printer.push(line, false),
        None => drop(io::stderr().write_all(line.as_bytes())),
    }
}

/// Waits, for at most a second, until all complaints are written. The process calls this before it ends.
pub fn settle_complaints() {
    ERRORS.get().map(|printer| printer.settle(COMPLAINED_WITHIN, || false));
}

/// Prints diagnostics on standard error, for verbs that print another answer on standard output.
pub fn complain_in_full(color: Color, text: &str) {
    let mut stream = AutoStream::new(io::stderr(), color.into());
    let _ = stream.write_all(harmless(text).as_bytes());
}

/// Text in a style. Padding and alignment do not count the escapes.
pub struct Styled<T>(pub Style, pub T);

impl<T: Display> Display for Styled<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0.render())?;
        self.1.fmt(f)?;
        write!(f, "{}", self.0.render_reset())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_text_hides_is_written_out() {
        let shown = |text| harmless(text).into_owned();
        assert_eq!(shown("two\tlines\nand \u{e9}"), "two\tlines\nand \u{e9}");
        assert_eq!(
            shown("\x1b]0;title\x07 \u{9b}2J \u{202e}txt\r"),
            "\\u{1b}]0;title\\u{7} \\u{9b}2J \\u{202e}txt\\r"
        );
        // Styles of this program stay in the text. Concealed text and other sequences do not.
        let styled = Styled(GOOD, "well").to_string();
        assert_eq!(shown(&styled), styled);
        assert_eq!(shown("\x1b[8mhidden\x1b[2J"), "\\u{1b}[8mhidden\\u{1b}[2J");
    }

    #[test]
    fn padding_does_not_count_the_escapes() {
        assert_eq!(format!("{:>6}|", Styled(Style::new(), "ok")), "    ok|");
        assert!(format!("{:<4}|", Styled(GOOD, "ok")).contains("ok  "));
    }
}
