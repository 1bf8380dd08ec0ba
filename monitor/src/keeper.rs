//! A thread that writes the typed lines into their file, so that no disk delays the screen.

use crate::name::shown_line;
use crate::typed::{Typed, save};
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;
use std::time::Duration;

/// How long leaving the monitor waits for the last line to be written.
const LAST: Duration = Duration::from_millis(500);

/// The thread. Dropping this value ends the thread after it has written the lines that it was given.
pub struct Keeper {
    lines: Option<Sender<Typed>>,
    ended: Receiver<()>,
}

impl Keeper {
    /// Starts the thread. `tell` reports the first write error, and no later ones. If no thread can be started,
    /// nothing is written.
    pub fn start(path: PathBuf, tell: impl Fn(String) + Send + 'static) -> Self {
        let ((lines, given), (end, ended)) = (channel::<Typed>(), channel());
        let write = move || {
            let mut is_told = false;
            for typed in &given {
                if let Err(error) = save(&path, &typed)
                    && !std::mem::replace(&mut is_told, true)
                {
                    tell(format!(
                        "typed lines are not kept: {error}: {}",
                        shown_line(&path.display().to_string())
                    ));
                }
            }
            drop(end);
        };
        // The lines are a convenience, so the monitor runs without the thread, too.
        let started = thread::Builder::new().name("imrs-lines".into()).spawn(write);
        Self { lines: started.ok().map(|_| lines), ended }
    }

    /// Writes these lines soon.
    pub fn keep(&self, typed: Typed) {
        if let Some(lines) = &self.lines {
            // The thread has ended only if it panicked, which was reported.
            let _ = lines.send(typed);
        }
    }
}

impl Drop for Keeper {
    fn drop(&mut self) {
        self.lines = None;
        // A disk that hangs must not keep the user from leaving.
        let _ = self.ended.recv_timeout(LAST);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::typed::{Kind, load};

    fn typed(line: &str) -> Typed {
        let mut typed = Typed::default();
        typed.remember(Kind::Command, line);
        typed
    }

    #[test]
    fn what_was_given_is_written_when_it_ends() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lines");
        let keeper = Keeper::start(path.clone(), |told| panic!("{told}"));
        keeper.keep(typed("port beat"));
        drop(keeper);
        assert_eq!(load(&path).unwrap(), typed("port beat"));
    }

    #[test]
    fn a_file_that_cannot_be_written_is_reported_once() {
        let folder = tempfile::tempdir().unwrap();
        let (tell, told) = channel();
        let keeper = Keeper::start(folder.path().to_owned(), move |text| tell.send(text).unwrap());
        keeper.keep(typed("a"));
        keeper.keep(typed("b"));
        drop(keeper);
        let said: Vec<String> = told.iter().collect();
        assert!(said.len() == 1 && said[0].starts_with("typed lines are not kept: "), "{said:?}");
    }
}
