//! Ctrl-C and the like: they end the run in order, with its summary.

use super::children::Message;
use super::error::LaunchError;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::SyncSender;
use std::thread;

/// How many signals have asked for the end so far.
#[derive(Clone, Default)]
pub struct Interrupts(Arc<AtomicU64>);

impl Interrupts {
    /// Watches for them. Each is counted, and wakes whoever waits for messages.
    ///
    /// # Errors
    /// The operating system refuses a handler or a thread.
    pub fn watch(messages: SyncSender<Message>) -> Result<Self, LaunchError> {
        let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP]).map_err(LaunchError::Start)?;
        let own = Self::default();
        let counted = own.clone();
        let watch = move || {
            for _ in signals.forever() {
                counted.0.fetch_add(1, Ordering::Relaxed);
                // Where messages wait already, nobody has to be woken; where nobody waits for messages, the count tells.
                let _ = messages.try_send(Message::Interrupted);
            }
        };
        thread::Builder::new().name("imrs signals".into()).spawn(watch).map_err(LaunchError::Start)?;
        Ok(own)
    }

    /// How many so far.
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}
