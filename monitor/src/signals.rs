//! Handles the signals that must not leave the terminal in raw mode.

use crate::error::MonitorError;
use crate::terminal::give_back;
use signal_hook::consts::{SIGCONT, SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGTSTP};
use signal_hook::iterator::{Handle, Signals};
use signal_hook::low_level::emulate_default_handler;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// How long the main loop may take to restore the terminal before this thread restores it.
const PATIENCE: Duration = Duration::from_secs(1);

/// How long the terminal may take to accept the output with which this thread restores it.
const LAST_MOMENT: Duration = Duration::from_millis(200);

/// A signal's request to the main loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Call {
    /// End the monitor as this signal would.
    End(i32),
    /// Restore the terminal and suspend the monitor.
    Stop,
    /// Continue after a suspension: redraw everything.
    GoOn,
}

/// Listens for signals until it is dropped.
#[derive(Debug)]
pub struct Listener {
    handle: Handle,
    answered: Arc<AtomicBool>,
}

impl Listener {
    /// Starts a thread that calls `tell` for every signal.
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

    /// Ends the process as `signal` would have, so that the parent sees the true exit status.
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

/// Ends the process if the main loop does not react: its terminal may be gone, or may block it.
fn end_at_last(signal: i32, told: bool, answered: &AtomicBool) {
    let until = Instant::now() + PATIENCE;
    while told && !answered.load(Ordering::SeqCst) && Instant::now() < until {
        thread::sleep(Duration::from_millis(10));
    }
    if !answered.load(Ordering::SeqCst) {
        // Writing to a stuck terminal blocks, so another thread writes.
        let _ = thread::Builder::new().spawn(give_back);
        thread::sleep(LAST_MOMENT);
        let _ = emulate_default_handler(signal);
    }
}

/// Suspends the process as ^Z does, until it is continued.
pub fn stop() {
    let _ = emulate_default_handler(SIGTSTP);
}
