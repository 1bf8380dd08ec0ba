//! Counts Ctrl-C, SIGTERM and SIGHUP. Each of these signals ends the run in order, with its summary.

use crate::children::Message;
use crate::error::LaunchError;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::SyncSender;
use std::thread;

/// Counts the signals that asked for the end of the run.
#[derive(Clone, Default)]
pub struct Interrupts(Arc<AtomicU64>);

impl Interrupts {
    /// Starts a thread that counts each signal, and wakes the launcher, which receives `messages`.
    ///
    /// # Errors
    /// An error if the operating system refuses a handler or a thread.
    pub(crate) fn watch(messages: SyncSender<Message>) -> Result<Self, LaunchError> {
        let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP]).map_err(LaunchError::Start)?;
        let own = Self::default();
        let counted = own.clone();
        let watch = move || {
            for _ in signals.forever() {
                counted.0.fetch_add(1, Ordering::Relaxed);
                // If the queue is full, its receiver is awake. If the receiver is gone, counting the signal is enough.
                let _ = messages.try_send(Message::Interrupted);
            }
        };
        thread::Builder::new().name("imrs signals".into()).spawn(watch).map_err(LaunchError::Start)?;
        Ok(own)
    }

    /// The number of signals so far.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}
