//! Tests of malicious files and command lines: no command may panic, hang or read without end, and each must say what is
//! wrong.

mod commands;
mod escapes;
mod files;
mod recordings;

use crate::support::{PATIENCE, Said};
use std::io::Read;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// The exit codes that `imrs --help` names, without those for a fault of the program and for an exhausted system.
const DOCUMENTED: [i32; 6] = [0, 1, 2, 3, 4, 5];

/// Runs a command to its end. A command that hangs is killed, and the test fails. The output need not be text.
fn ended(mut command: Command) -> Said {
    let shown = format!("{command:?}");
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
    let (out, err) = (child.stdout.take().expect("a pipe"), child.stderr.take().expect("a pipe"));
    let [out, err] = [Box::new(out) as Box<dyn Read + Send>, Box::new(err)].map(|mut pipe| {
        thread::spawn(move || {
            let mut bytes = Vec::new();
            let _ = pipe.read_to_end(&mut bytes);
            String::from_utf8_lossy(&bytes).into_owned()
        })
    });
    let end = Instant::now() + PATIENCE;
    let code = loop {
        match child.try_wait().expect("it can be waited for") {
            Some(status) => break status.code(),
            None if Instant::now() > end => {
                let _ = child.kill();
                panic!("it does not end: {shown}");
            }
            None => thread::sleep(Duration::from_millis(2)),
        }
    };
    Said { out: out.join().expect("read"), err: err.join().expect("read"), code }
}

/// Why the way in which a command ended is a defect, whatever the command's input was; `None` if it is no defect.
fn fault_of(said: &Said) -> Option<String> {
    let Some(code) = said.code else { return Some("a signal ended it".into()) };
    let text = format!("{}\n{}", said.out, said.err);
    if !DOCUMENTED.contains(&code) {
        return Some(format!("it ended with {code}"));
    }
    if text.contains("panicked at") || text.contains("RUST_BACKTRACE") {
        return Some("it panicked".into());
    }
    (code != 0 && said.err.trim().is_empty() && said.out.trim().is_empty())
        .then(|| format!("it ended with {code} and said nothing"))
}
