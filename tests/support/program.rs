//! A running command, whose output is read line by line as it is printed.

use super::{PATIENCE, Said, signal};
use rustix::process::Signal;
use serde_json::Value;
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Starts a command. A program that the test has just copied is busy while a process that another test forked meanwhile still has
/// the copy open for writing, for a moment.
fn spawned(command: &mut Command) -> Child {
    for _ in 0..500 {
        match command.spawn() {
            Err(error) if error.kind() == ErrorKind::ExecutableFileBusy => {
                thread::sleep(Duration::from_millis(10));
            }
            started => return started.expect("it starts"),
        }
    }
    panic!("the program stays busy");
}

/// A running command. Dropping this value kills the command.
pub struct Program {
    child: Child,
    lines: Receiver<(Instant, String)>,
    /// The output lines that have been read so far.
    out: String,
    errors: Option<JoinHandle<String>>,
}

impl Program {
    pub fn start(mut command: Command) -> Self {
        let mut child = spawned(command.stdout(Stdio::piped()).stderr(Stdio::piped()));
        let (out, mut err) = (child.stdout.take().expect("a pipe"), child.stderr.take().expect("a pipe"));
        let (sender, lines) = mpsc::channel();
        thread::spawn(move || {
            for line in BufReader::new(out).lines().map_while(Result::ok) {
                if sender.send((Instant::now(), line)).is_err() {
                    return;
                }
            }
        });
        let errors = Some(thread::spawn(move || {
            let mut text = String::new();
            let _ = err.read_to_string(&mut text);
            text
        }));
        Self { child, lines, out: String::new(), errors }
    }

    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// The next line of output, and when it was read; `None` if the command has ended.
    fn next(&mut self) -> Option<(Instant, String)> {
        match self.lines.recv_timeout(PATIENCE) {
            Ok((at, line)) => {
                self.out.push_str(&line);
                self.out.push('\n');
                Some((at, line))
            }
            Err(RecvTimeoutError::Disconnected) => None,
            Err(RecvTimeoutError::Timeout) => {
                // Standard error can be read to its end only after the command has ended.
                let _ = self.child.kill();
                let errors = self.errors();
                panic!("it said nothing more after {:?}: {errors:?}", self.out);
            }
        }
    }

    /// The next line of output, and when it was read.
    pub fn line(&mut self) -> (Instant, String) {
        if let Some(line) = self.next() {
            return line;
        }
        let errors = self.errors();
        panic!("it ended after {:?}: {errors:?}", self.out);
    }

    /// The next line of output, parsed as JSON.
    pub fn json(&mut self) -> Value {
        self.json_at().1
    }

    /// The next line of output, parsed as JSON; `None` if the command has ended.
    pub fn next_json(&mut self) -> Option<Value> {
        self.next().map(|(_, line)| parsed(&line))
    }

    /// The next line of output, parsed as JSON, and when it was read.
    pub fn json_at(&mut self) -> (Instant, Value) {
        let (at, line) = self.line();
        (at, parsed(&line))
    }

    /// Reads lines of output until `is_enough` accepts one, or the command ends.
    pub fn read_until(&mut self, mut is_enough: impl FnMut(&str) -> bool) {
        let end = Instant::now() + PATIENCE;
        while let Some((_, line)) = self.next() {
            if is_enough(&line) {
                return;
            }
            assert!(Instant::now() < end, "it never said enough: {}", self.out);
        }
    }

    /// Sends SIGINT, as Ctrl-C does. A run then ends in the normal way, and prints its summary.
    pub fn interrupt(&self) {
        signal(self.pid(), Signal::INT);
    }

    /// Waits for the end of the command. Returns everything that it printed, and its exit code.
    pub fn finish(mut self) -> Said {
        self.read_until(|_| false);
        let code = self.child.wait().expect("it ends").code();
        Said { err: self.errors(), out: std::mem::take(&mut self.out), code }
    }

    fn errors(&mut self) -> String {
        self.errors.take().map(|thread| thread.join().expect("its errors")).unwrap_or_default()
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Returns a function that is called with each line. It is true once lines with these words have come in this order.
pub fn one_after_the_other(words: &'static [&'static str]) -> impl FnMut(&str) -> bool {
    let mut left = words;
    move |line| {
        if let [first, rest @ ..] = left
            && line.contains(first)
        {
            left = rest;
        }
        left.is_empty()
    }
}

/// Returns a function that is called with each line. It is true once each of these words has come in some line.
pub fn all_of(words: &'static [&'static str]) -> impl FnMut(&str) -> bool {
    let mut left = words.to_vec();
    move |line| {
        left.retain(|words| !line.contains(words));
        left.is_empty()
    }
}

/// Returns a function that is called with each line. It is true once `count` lines with these words have come.
pub fn times(count: usize, words: &'static str) -> impl FnMut(&str) -> bool {
    let mut found = 0;
    move |line| {
        found += usize::from(line.contains(words));
        found >= count
    }
}

fn parsed(line: &str) -> Value {
    serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"))
}
