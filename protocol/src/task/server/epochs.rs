//! Fencing of commands that are sent under a lease: commands of a past epoch are dropped. Ports that no lease guards skip
//! this stage (D61).

use super::{Held, Origin, Server, discard};
use crate::observe::Reason;
use crate::packet::{Contents, Packet};
#[cfg(feature = "checker")]
use crate::state::Walk;
use crate::table::Ends;
use crate::task::lease::is_newer_epoch;
use crate::task::step::{Outbox, Step};
use crate::ticks::Instant;
use serde::{Deserialize, Serialize};

/// The newest epoch of a couple of which this task has heard, on any of the ports on which the couple commands this task.
/// The epoch is kept as long as a command of an older epoch may arrive (D61).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) struct Guard {
    /// The position of the couple in the cell.
    pub couple: u8,
    epoch: u8,
    until: Instant,
}

impl Guard {
    pub const fn new(couple: u8) -> Self {
        Self { couple, epoch: 0, until: Instant::START }
    }

    /// Whether a command of this epoch is accepted. The holder of an older epoch was fenced before the newer epoch began, so
    /// the commands of that holder have expired by `until`.
    fn admit(&mut self, epoch: u8, now: Instant, until: Instant) -> bool {
        if self.until > now && is_newer_epoch(self.epoch, epoch) {
            return false;
        }
        (self.epoch, self.until) = (epoch, until.max(self.until));
        true
    }

    /// Forgets an epoch of which no command can arrive any more.
    #[cfg(feature = "checker")]
    pub fn bury(&mut self, now: Instant) {
        if self.until <= now {
            *self = Self { until: now, ..Self::new(self.couple) };
        }
    }

    #[cfg(feature = "checker")]
    pub fn walk<W: Walk>(&mut self, w: &mut W) {
        let Self { couple, epoch, until } = self;
        w.epoch(*couple, epoch);
        w.instant(until);
    }
}

impl Server {
    /// Returns the contents of a message sent under a lease, without the epoch behind them. Returns `None` if a newer epoch
    /// is known. A new epoch drops all waiting commands of older epochs.
    pub(super) fn within_epoch(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        (ends, (inbox, source)): (Ends<'_>, Origin),
        couple: u8,
        packet: &Packet,
    ) -> Option<Contents> {
        let now = step.now();
        let guard = self.guards.iter_mut().find(|guard| guard.couple == couple)?;
        let until = now + ends.other().time_out + ends.peer.bound;
        let said = packet.contents.as_bytes().split_last();
        let newer = said.is_some_and(|(&e, _)| guard.until > now && is_newer_epoch(e, guard.epoch));
        let heeds = step.table.rules().heed_epochs;
        let contents = said.filter(|&(&epoch, _)| guard.admit(epoch, now, until) || !heeds);
        let Some((_, bytes)) = contents else {
            self.inboxes[inbox].close(source, packet.id);
            let reason = if said.is_some() { Reason::StaleEpoch } else { Reason::NotAllowed };
            step.drop_packet(ends.own.place, packet, reason);
            return None;
        };
        if newer && heeds {
            self.drop_orders(step, couple);
        }
        Some(Contents::new(bytes).unwrap_or_default())
    }

    /// Drops the waiting commands of past epochs, on every port of the couple.
    fn drop_orders(&mut self, step: &mut Step<'_, impl Outbox>, couple: u8) {
        for inbox in 0..self.inboxes.len() {
            let port = self.inboxes[inbox].port;
            if step.table.port(port).is_none_or(|port| port.decl.guard != Some(couple)) {
                continue;
            }
            while let Some(old) = self.inboxes[inbox].queue.pop_if(|_: &Held| true) {
                discard(step, &self.inboxes[inbox], &old, Reason::StaleEpoch);
            }
            self.touch(step.own, inbox);
        }
    }
}
