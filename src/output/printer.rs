//! Writes lines on a thread of its own, so that a slow or stopped reader blocks no other thread.

use super::count;
use indicatif::ProgressBar;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;
use std::collections::VecDeque;
use std::io;
use std::os::fd::AsFd;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// The greatest number of lines that wait for the reader. If there are more, lines about scripts are dropped.
const LINES: usize = 4_096;
/// The greatest number of bytes that wait for the reader. Later lines are dropped and counted.
const BYTES: usize = 1 << 20;
/// How often a waiting caller checks for an interruption.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// Formats how many lines are missing, and why.
pub type Notice = fn(u64, &str) -> String;

/// The notice about missing lines, for people.
pub fn notice(lines: u64, why: &str) -> String {
    format!("... {} not shown: {why}", count(lines, "line"))
}

/// A bounded queue of lines, and the thread that writes them.
///
/// [`push`](Self::push) never waits. If the queue is full, the line is dropped, and a notice takes its place as soon as
/// the reader reads again. A failed write loses only its own line: the next line is tried again. Once the reader has
/// closed the pipe (EPIPE), all lines are dropped.
pub struct Printer(Arc<Shared>);

struct Shared {
    queue: Mutex<Queue>,
    /// Signals that a line was added, or written.
    changed: Condvar,
    notice: Notice,
}

#[derive(Default)]
struct Queue {
    items: VecDeque<Item>,
    bytes: usize,
    /// The lines that the thread is writing.
    in_hand: InHand,
    /// Lines that were not shown, and that no notice has counted yet.
    missing: u64,
    /// How many of the missing lines were marked as kept, but could not be written.
    missing_kept: u64,
    /// How many lines were marked as kept, could not be written, and were counted by a notice already.
    lost: u64,
    /// Why the last write failed.
    failed: Option<String>,
    /// Why the write of the last line failed that `lost` counts.
    lost_because: Option<String>,
    /// Whether the reader has closed the pipe.
    gone: bool,
    /// The newest text of the progress line, if it has not been drawn yet.
    progress: Option<String>,
    closed: bool,
}

/// Lines that are being written.
#[derive(Clone, Copy, Default)]
struct InHand {
    /// The number of lines, including the missing lines that the notice before them counts.
    lines: u64,
    /// How many of the missing lines were marked as kept.
    failed_before: u64,
    /// Whether the line after the notice is marked as kept.
    is_kept: bool,
}

enum Item {
    Line {
        text: String,
        kept: bool,
    },
    Dropped(u64),
    /// Remove the progress line from the terminal.
    Clear,
}

/// The next step of the thread.
enum Work {
    Write(String),
    Progress(String),
    Clear,
}

/// The lines that were not written.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Untaken {
    /// How many lines were not written.
    pub lines: u64,
    /// Why writing failed; `None` if the reader did not read in time.
    pub failed: Option<String>,
}

impl Printer {
    /// Starts the thread that writes to `stream`. The thread also draws the progress line, so that the two outputs do
    /// not mix.
    ///
    /// # Errors
    /// An error if the operating system refuses a thread.
    pub fn start(
        stream: impl AsFd + Send + 'static,
        notice: Notice,
        progress: ProgressBar,
    ) -> io::Result<Self> {
        let shared = Arc::new(Shared { queue: Mutex::default(), changed: Condvar::new(), notice });
        let own = Arc::clone(&shared);
        let work = move || {
            while let Some(work) = own.next() {
                own.carry_out(work, &stream, &progress);
            }
        };
        thread::Builder::new().name("imrs printer".into()).spawn(work)?;
        Ok(Self(shared))
    }

    /// Adds a text that has its own line breaks. A text marked as `kept` is never dropped: there are few such texts.
    pub fn push(&self, text: String, kept: bool) {
        let mut queue = self.0.lock();
        if queue.gone {
            return;
        }
        let is_full = queue.items.len() >= LINES || queue.bytes + text.len() > BYTES;
        if kept || !is_full {
            queue.bytes += text.len();
            queue.items.push_back(Item::Line { text, kept });
        } else if let Some(Item::Dropped(lines)) = queue.items.back_mut() {
            *lines += 1;
        } else {
            queue.items.push_back(Item::Dropped(1));
        }
        self.0.changed.notify_all();
    }

    /// Sets the progress line.
    pub fn progress(&self, text: String) {
        self.0.lock().progress = Some(text);
        self.0.changed.notify_all();
    }

    /// Removes the progress line.
    pub fn clear(&self) {
        let mut queue = self.0.lock();
        queue.progress = None;
        queue.items.push_back(Item::Clear);
        self.0.changed.notify_all();
    }

    /// Waits until all lines are written, at most for `within`, and only until `interrupted`. Returns the lines that
    /// are not written.
    pub fn settle(&self, within: Duration, interrupted: impl Fn() -> bool) -> Untaken {
        let end = Instant::now() + within;
        let mut queue = self.0.lock();
        while !queue.is_idle() && Instant::now() < end && !interrupted() {
            let waited = self.0.changed.wait_timeout(queue, LOOK_EVERY);
            queue = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        let lines = |item: &Item| match item {
            Item::Line { .. } => 1,
            Item::Dropped(lines) => *lines,
            Item::Clear => 0,
        };
        let waiting: u64 = queue.items.iter().map(lines).sum();
        let unwritten = waiting + queue.in_hand.lines + queue.missing + queue.lost;
        let lines = if queue.gone { 0 } else { unwritten };
        Untaken { lines, failed: queue.failed.clone().or_else(|| queue.lost_because.clone()) }
    }
}

impl Drop for Printer {
    fn drop(&mut self) {
        self.0.lock().closed = true;
        self.0.changed.notify_all();
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn next(&self) -> Option<Work> {
        let mut queue = self.lock();
        loop {
            if let Some(work) = queue.take(self.notice) {
                return Some(work);
            }
            if queue.closed {
                return None;
            }
            queue = self.changed.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn carry_out(&self, work: Work, stream: &impl AsFd, progress: &ProgressBar) {
        let written = match work {
            Work::Write(text) => progress.suspend(|| write(stream, text.as_bytes())),
            Work::Progress(text) => {
                progress.set_message(text);
                progress.tick();
                Ok(())
            }
            Work::Clear => {
                progress.finish_and_clear();
                Ok(())
            }
        };
        let mut queue = self.lock();
        let InHand { lines, failed_before, is_kept } = std::mem::take(&mut queue.in_hand);
        match written {
            Ok(()) if lines > 0 => {
                let failed = queue.failed.take();
                if failed_before > 0 {
                    queue.lost += failed_before;
                    queue.lost_because = failed;
                }
            }
            Ok(()) => {}
            Err(Errno::PIPE) => {
                queue.gone = true;
                queue.items.clear();
            }
            Err(error) => {
                queue.missing += lines;
                queue.missing_kept += failed_before + u64::from(is_kept);
                queue.failed = Some(io::Error::from(error).to_string());
            }
        }
        drop(queue);
        self.changed.notify_all();
    }
}

impl Queue {
    /// Whether no line waits to be written.
    fn is_idle(&self) -> bool {
        self.items.is_empty() && self.in_hand.lines == 0
    }

    fn take(&mut self, notice: Notice) -> Option<Work> {
        let (text, own, is_kept) = match self.items.pop_front() {
            None => return Some(Work::Progress(self.progress.take()?)),
            Some(Item::Clear) => return Some(Work::Clear),
            Some(Item::Dropped(lines)) => {
                self.missing += lines;
                (self.told(notice), 0, false)
            }
            Some(Item::Line { text, kept }) => {
                self.bytes -= text.len();
                let text = if self.missing > 0 { self.told(notice) + &text } else { text };
                (text, 1, kept)
            }
        };
        let lines = std::mem::take(&mut self.missing) + own;
        self.in_hand = InHand { lines, failed_before: std::mem::take(&mut self.missing_kept), is_kept };
        Some(Work::Write(text))
    }

    /// The notice about missing lines. After a failed write it starts on a new line, because a part of a line may have been
    /// written.
    fn told(&self, notice: Notice) -> String {
        match &self.failed {
            Some(why) => format!("\n{}\n", notice(self.missing, why)),
            None => format!("{}\n", notice(self.missing, "the reader was too slow")),
        }
    }
}

/// Writes all bytes, and waits for the reader as long as it takes.
fn write(stream: &impl AsFd, mut bytes: &[u8]) -> Result<(), Errno> {
    while !bytes.is_empty() {
        match rustix::io::write(stream, bytes) {
            Ok(0) => return Err(Errno::IO),
            Ok(written) => bytes = &bytes[written..],
            Err(Errno::INTR) => {}
            // Another process that shares the terminal or pipe has made it non-blocking, so this waits for the reader.
            Err(Errno::AGAIN) => {
                let wait = poll(&mut [PollFd::new(stream, PollFlags::OUT)], None);
                wait.map(drop).or_else(|error| if error == Errno::INTR { Ok(()) } else { Err(error) })?;
            }
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::io::{BufRead, BufReader, Read};

    const LONG: Duration = Duration::from_secs(600);

    fn printer(stream: impl AsFd + Send + 'static) -> Printer {
        Printer::start(stream, notice, ProgressBar::hidden()).expect("a thread")
    }

    #[test]
    fn a_reader_that_does_not_read_keeps_nobody_waiting_and_is_told_what_it_missed() {
        let (reader, writer) = io::pipe().expect("a pipe");
        let printer = printer(writer);
        for line in 0..100_000 {
            printer.push(format!("line {line} {}\n", "x".repeat(100)), false);
        }
        printer.push("kept\n".into(), true);
        let untaken = printer.settle(Duration::ZERO, || false);
        assert!(untaken.lines > 90_000 && untaken.failed.is_none(), "{untaken:?}");
        let mut reader = BufReader::new(reader);
        let mut lines = Vec::new();
        while lines.last().is_none_or(|line| line != "kept") {
            let mut line = String::new();
            reader.read_line(&mut line).expect("a line");
            lines.push(line.trim_end().to_owned());
        }
        // Every line is either shown in its place, or counted in the notice that replaces it.
        let mut number = 0;
        for line in &lines[..lines.len() - 1] {
            let second = line.split(' ').nth(1).expect("a number").replace(',', "");
            let second = second.parse::<usize>().expect("a number");
            if line.ends_with("not shown: the reader was too slow") {
                number += second;
            } else {
                assert_eq!(second, number, "{line}");
                number += 1;
            }
        }
        assert_eq!(number, 100_000);
        assert_eq!(printer.settle(LONG, || false), Untaken::default());
    }

    #[test]
    fn lines_for_a_full_disk_are_counted_and_those_for_a_reader_that_has_gone_are_not() {
        let full = printer(File::options().write(true).open("/dev/full").expect("a device"));
        full.push("one\n".into(), false);
        full.push("two\n".into(), true);
        let untaken = full.settle(LONG, || false);
        assert_eq!(untaken.lines, 2);
        assert!(untaken.failed.is_some_and(|why| why.contains("No space left")));
        let (reader, writer) = io::pipe().expect("a pipe");
        drop(reader);
        let gone = printer(writer);
        gone.push("one\n".into(), true);
        assert_eq!(gone.settle(LONG, || false), Untaken::default());
    }

    #[test]
    fn a_line_that_must_be_kept_is_missing_even_when_later_ones_are_written() {
        let shared = Shared { queue: Mutex::default(), changed: Condvar::new(), notice };
        let printer = Printer(Arc::new(shared));
        let write_to = |path: &str| {
            let stream = File::options().write(true).open(path).expect("a device");
            let work = printer.0.next().expect("a line");
            printer.0.carry_out(work, &stream, &ProgressBar::hidden());
        };
        for (kept, missing) in [(false, 0), (true, 1)] {
            printer.push("one\n".into(), kept);
            write_to("/dev/full");
            assert_eq!(printer.settle(LONG, || false).lines, 1);
            printer.push("two\n".into(), true);
            write_to("/dev/null");
            let untaken = printer.settle(LONG, || false);
            assert_eq!((untaken.lines, untaken.failed.is_some()), (missing, kept));
        }
    }

    #[test]
    fn who_waits_for_the_reader_can_be_interrupted() {
        let (mut reader, writer) = io::pipe().expect("a pipe");
        let printer = printer(writer);
        printer.push("x".repeat(1 << 20) + "\n", true);
        assert_eq!(printer.settle(LONG, || true).lines, 1);
        drop(printer);
        let mut text = String::new();
        reader.read_to_string(&mut text).expect("the thread ends after the last line, and with it the pipe");
        assert_eq!(text.len(), (1 << 20) + 1);
    }
}
