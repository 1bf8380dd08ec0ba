//! A running command, whose output lines are read as they come.

use super::{PATIENCE, Said, signal};
use rustix::process::Signal;
use serde_json::Value;
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::thread::{self, JoinHandle};
use std::time::Instant;

/// A running command. Dropping this kills it.
pub struct Program {
    child: Child,
    lines: Receiver<(Instant, String)>,
    /// The lines that have been read so far.
    out: String,
    errors: Option<JoinHandle<String>>,
}

impl Program {
    pub fn start(mut command: Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
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

    /// The next line, and when it came; none if the command has ended.
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

    /// The next line, and when it came.
    pub fn line(&mut self) -> (Instant, String) {
        if let Some(line) = self.next() {
            return line;
        }
        let errors = self.errors();
        panic!("it ended after {:?}: {errors:?}", self.out);
    }

    /// The next line, as JSON.
    pub fn json(&mut self) -> Value {
        self.json_at().1
    }

    /// The next line, as JSON; none if the command has ended.
    pub fn next_json(&mut self) -> Option<Value> {
        self.next().map(|(_, line)| parsed(&line))
    }

    /// The next line, as JSON, and when it came.
    pub fn json_at(&mut self) -> (Instant, Value) {
        let (at, line) = self.line();
        (at, parsed(&line))
    }

    /// Reads lines until `is_enough` accepts one, or the command ends.
    pub fn read_until(&mut self, mut is_enough: impl FnMut(&str) -> bool) {
        let end = Instant::now() + PATIENCE;
        while let Some((_, line)) = self.next() {
            if is_enough(&line) {
                return;
            }
            assert!(Instant::now() < end, "it never said enough: {}", self.out);
        }
    }

    /// Sends SIGINT, as Ctrl-C does: a run ends in order, with its summary.
    pub fn interrupt(&self) {
        signal(self.pid(), Signal::INT);
    }

    /// Waits for the end of the command. Returns its whole output.
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

/// Returns a function that is true once lines with these words have come, in this order.
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

/// Returns a function that is true once lines with each of these words have come, in any order.
pub fn all_of(words: &'static [&'static str]) -> impl FnMut(&str) -> bool {
    let mut left = words.to_vec();
    move |line| {
        left.retain(|words| !line.contains(words));
        left.is_empty()
    }
}

/// Returns a function that is true once so many lines with these words have come.
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
