//! The signals that must not leave a terminal broken.

use crate::error::MonitorError;
use crate::terminal::give_back;
use signal_hook::consts::{SIGCONT, SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGTSTP};
use signal_hook::iterator::{Handle, Signals};
use signal_hook::low_level::emulate_default_handler;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// How long the main loop has to give the terminal back; then it is taken from it.
const PATIENCE: Duration = Duration::from_secs(1);

/// How long the terminal then has to take what gives it back.
const LAST_MOMENT: Duration = Duration::from_millis(200);

/// What a signal asks of the main loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Call {
    /// End, as by this signal.
    End(i32),
    /// Give the terminal back and stop.
    Stop,
    /// Going on after a stop: draw everything.
    GoOn,
}

/// Listens for signals until it is dropped.
#[derive(Debug)]
pub struct Listener {
    handle: Handle,
    answered: Arc<AtomicBool>,
}

impl Listener {
    /// Calls `tell` from a thread of its own for every signal.
    ///
    /// # Errors
    /// [`MonitorError::Signals`].
    pub fn start(tell: impl Fn(Call) -> bool + Send + 'static) -> Result<Self, MonitorError> {
        let mut signals = Signals::new([SIGTERM, SIGINT, SIGHUP, SIGQUIT, SIGTSTP, SIGCONT])
            .map_err(MonitorError::Signals)?;
        let handle = signals.handle();
        let answered = Arc::new(AtomicBool::new(false));
        let done = answered.clone();
        let listen = move || {
            for signal in &mut signals {
                let call = match signal {
                    SIGTSTP => Call::Stop,
                    SIGCONT => Call::GoOn,
                    end => Call::End(end),
                };
                let told = tell(call);
                if let Call::End(signal) = call {
                    end_at_last(signal, told, &done);
                }
            }
        };
        thread::Builder::new().name("imrs-signals".into()).spawn(listen).map_err(MonitorError::Signals)?;
        Ok(Self { handle, answered })
    }

    /// Ends the process as `signal` would have, so that whoever started it sees the truth.
    pub fn end_as(&self, signal: i32) {
        self.answered.store(true, Ordering::SeqCst);
        let _ = emulate_default_handler(signal);
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.answered.store(true, Ordering::SeqCst);
        self.handle.close();
    }
}

/// A main loop that cannot answer (its terminal may be gone, or hold it up) must not keep the process.
fn end_at_last(signal: i32, told: bool, answered: &AtomicBool) {
    let until = Instant::now() + PATIENCE;
    while told && !answered.load(Ordering::SeqCst) && Instant::now() < until {
        thread::sleep(Duration::from_millis(10));
    }
    if !answered.load(Ordering::SeqCst) {
        // A terminal that takes no output holds up whoever writes to it: not this thread.
        let _ = thread::Builder::new().spawn(give_back);
        thread::sleep(LAST_MOMENT);
        let _ = emulate_default_handler(signal);
    }
}

/// Stops the process as ^Z does, until it is continued.
pub fn stop() {
    let _ = emulate_default_handler(SIGTSTP);
}
