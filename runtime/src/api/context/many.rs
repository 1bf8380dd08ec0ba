//! Taking several messages under one lock (D111).

use super::calls::{mismatch, ticks};
use super::{Context, TaskError};
use crate::clock::{self, Micros};
use crate::node::comm::Completion;
use imrs_protocol::{Delivery, PortId, Request, Signal, Ticks};
use std::time::Duration;

/// The most messages that [`Context::receive_many`] takes at once. The limit bounds how long other threads wait for
/// the lock.
pub const MANY: usize = 64;

impl<S> Context<S> {
    /// Waits as [`receive`](Self::receive) does, then takes the most urgent of the messages that wait, as repeated
    /// calls of [`poll`](Self::poll) would: at most `limit`, and at most [`MANY`] at once. Adds the messages to
    /// `messages`, the most urgent first, and returns how many; zero says that the time_out ended first. A message of
    /// several packets is the last one taken, so that it can be [`read`](Self::read).
    ///
    /// This is for streams of messages. While other threads send, most of the cost of taking a message is waiting for
    /// the lock. This call takes the lock once for all messages. Messages that arrive during the call are taken, too,
    /// but a more urgent one comes after those that were taken before it.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn receive_many(
        &mut self,
        port: Option<PortId>,
        messages: &mut Vec<Delivery>,
        limit: usize,
        time_out: Option<Duration>,
    ) -> Result<usize, TaskError> {
        let until = time_out.map(|time_out| clock::now().saturating_add(clock::micros(time_out)));
        let limit = limit.clamp(1, MANY);
        let mut left = time_out.map(ticks);
        let mut taken = std::mem::take(&mut self.taken);
        let before = messages.len();
        loop {
            taken.clear();
            taken.reserve(limit);
            let poll = Request::Get { port, source: None, time_out: Some(Ticks::ZERO) };
            let mut more = |completion: &Completion| match completion.signal {
                Signal::Message(message) => {
                    taken.push((completion.at, message));
                    (taken.len() < limit && message.fragments <= 1).then_some(poll)
                }
                _ => None,
            };
            let request = Request::Get { port, source: None, time_out: left };
            let answered = self.call_with(request, &mut more);
            self.hand_over(&taken, messages);
            if messages.len() > before || taken.is_empty() || answered.is_err() {
                self.taken = taken;
                let (signal, _) = answered?;
                return match signal {
                    Signal::Message(_) | Signal::Nothing => Ok(messages.len() - before),
                    other => mismatch(&request, &other),
                };
            }
            left = until.map(|until| Ticks(until.saturating_sub(clock::now())));
        }
    }

    /// Adds the messages that this call took from the ports to the program's list.
    fn hand_over(&mut self, taken: &[(Micros, Delivery)], messages: &mut Vec<Delivery>) {
        let now = if taken.is_empty() { 0 } else { clock::now() };
        for (at, message) in taken {
            messages.extend(self.caller.in_hand(message, Ticks(now.saturating_sub(*at))));
        }
    }
}
