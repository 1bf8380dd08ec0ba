//! The panic hook. For each thread name and source line, the first panic is printed as usual, and later panics are counted.
//!
//! The checker catches panics of the state machine and reports them as findings. The runtime reports a task that panics as
//! crashed. While a finding is shrunk, the same line may panic in thousands of runs.

use crate::exit::says_exhausted;
use crate::output::harmless;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::panic::PanicHookInfo;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Where a panic happened: the name of its thread, and the line in the sources.
type Place = (Option<String>, Option<String>);

/// The panics of this process.
pub struct Panics {
    /// Whether every panic so far had a lack of memory, file descriptors or threads as its cause.
    sound: Arc<AtomicBool>,
    counts: Mutex<BTreeMap<Place, u64>>,
}

/// Installs the hook that counts and prints the panics of this process. It does not end the process.
pub fn report() -> Arc<Panics> {
    let panics = Arc::new(Panics { sound: Arc::new(AtomicBool::new(true)), counts: Mutex::default() });
    let (default, own) = (std::panic::take_hook(), Arc::clone(&panics));
    std::panic::set_hook(Box::new(move |panic| {
        // A panic for lack of resources leaves `sound` true, because printing that panic may abort the process for the
        // same lack.
        if !panic.payload_as_str().is_some_and(says_exhausted) {
            own.sound.store(false, Ordering::SeqCst);
        }
        let place = place(panic);
        match own.count(&place) {
            1 => default(panic),
            // The line is printed only at 2, 4, 8 panics and so on, so that thousands of panics do not fill the screen.
            times if times.is_power_of_two() => {
                // If standard error is closed, the line is lost.
                let message = panic.payload_as_str().unwrap_or("no message");
                let line = format!("imrs: {}, this time with: {message}\n", again(&place, times));
                let _ = io::stderr().write_all(harmless(&line).as_bytes());
            }
            _ => {}
        }
    }));
    panics
}

fn place(panic: &PanicHookInfo<'_>) -> Place {
    let thread = std::thread::current().name().map(str::to_owned);
    (thread, panic.location().map(ToString::to_string))
}

fn again((thread, line): &Place, times: u64) -> String {
    let [thread, line] = [(thread, "<unnamed>"), (line, "an unknown line")]
        .map(|(name, unknown)| name.as_deref().unwrap_or(unknown));
    format!("thread '{thread}' panicked again at {line}: {times} times so far")
}

impl Panics {
    /// A flag that is true until a thread panics for another reason than a lack of resources.
    pub fn sound(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.sound)
    }

    /// The total count of each place at which more panics happened than were printed.
    pub fn untold(&self) -> Vec<String> {
        let counts = self.counts();
        let untold = counts.iter().filter(|(_, times)| !times.is_power_of_two());
        untold.map(|(place, times)| again(place, *times)).collect()
    }

    fn count(&self, place: &Place) -> u64 {
        let mut counts = self.counts();
        let times = counts.entry(place.clone()).or_default();
        *times += 1;
        *times
    }

    fn counts(&self) -> MutexGuard<'_, BTreeMap<Place, u64>> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::panic::catch_unwind;
    use std::process::Command;
    use std::thread;

    #[test]
    fn a_caught_panic_of_the_main_thread_does_not_end_the_process() {
        let panics = || {
            let panics = report();
            catch_unwind(|| panic!("caught")).is_err() && !panics.sound().load(Ordering::SeqCst)
        };
        let main = thread::Builder::new().name("main".into()).spawn(panics).expect("a thread");
        assert!(main.join().expect("the panic was caught"));
    }

    /// The body of a child process that another test starts. A thread of one name panics five times at one line, and a
    /// thread of another name panics once.
    #[test]
    fn panics_again_and_again() {
        if std::env::var_os("IMRS_PANICS").is_none() {
            return;
        }
        let panics = report();
        for name in ["weld", "weld", "dress", "weld", "weld", "weld"] {
            let body = || panic!("no part");
            let ended = thread::Builder::new().name(name.into()).spawn(body).expect("a thread").join();
            assert!(ended.is_err());
        }
        eprintln!("untold: {:?}", panics.untold());
    }

    /// The body of a child process that another test starts. It panics, then aborts, as a process does that runs out of
    /// memory while it prints a panic.
    #[test]
    fn a_panic_that_cannot_be_written_down() {
        let Ok(says) = std::env::var("IMRS_PANICS_OF") else { return };
        let panics = report();
        crate::end_without_memory(panics.sound());
        assert!(std::panic::catch_unwind(|| panic!("{says}")).is_err());
        std::process::abort();
    }

    #[test]
    fn an_abort_after_a_panic_is_a_fault_unless_the_system_had_nothing_left() {
        let code = |says: &str| {
            let mut program = Command::new(std::env::current_exe().expect("this program"));
            program.args(["--exact", "panics::tests::a_panic_that_cannot_be_written_down"]);
            program.env("IMRS_PANICS_OF", says).output().expect("it runs").status.code()
        };
        let spawn = "failed to spawn thread: Os { code: 11, kind: WouldBlock, message: \"try again\" }";
        let stack = "failed to allocate an alternative stack: Cannot allocate memory (os error 12)";
        assert_eq!([spawn, stack, "a fault"].map(code), [Some(71), Some(71), None]);
    }

    #[test]
    fn later_panics_of_a_thread_at_a_line_are_counted() {
        let mut program = Command::new(std::env::current_exe().expect("this program"));
        program.args(["--exact", "panics::tests::panics_again_and_again", "--nocapture"]);
        let said = program.env("IMRS_PANICS", "1").output().expect("it runs");
        let said = String::from_utf8_lossy(&said.stderr);
        let all = |word: &str| said.matches(word).count();
        assert_eq!((all("no part"), all("thread 'dress'")), (4, 1), "{said}");
        for (times, is_said) in [(2, 1), (3, 0), (4, 1), (5, 1)] {
            // The last count that is expected here is printed by `untold`, not by the hook.
            let pieces = said.lines().flat_map(|line| line.split('"'));
            let pieces = pieces.map(|piece| piece.trim_end_matches(", this time with: no part"));
            let told = pieces.filter(|piece| {
                piece.contains("thread 'weld' panicked again at src/panics.rs:")
                    && piece.ends_with(&format!(": {times} times so far"))
            });
            assert_eq!(told.count(), is_said, "{times}: {said}");
        }
    }
}
