//! Commands that are given under a lease (D61): those of an epoch that has passed are dropped. A stage that other ports do
//! not have.

use super::{Held, Server, Way, discard};
use crate::observe::Reason;
use crate::packet::{Contents, Packet};
#[cfg(feature = "checker")]
use crate::state::Walk;
use crate::table::Port;
use crate::task::lease::is_newer_epoch;
use crate::task::step::{Outbox, Step};
use crate::ticks::{Instant, Ticks};
use serde::{Deserialize, Serialize};

/// What a receiver of commands that are given under a lease remembers of the couple, whichever of its ports they come
/// through: the newest epoch, for as long as commands of an older one may still arrive (D61).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) struct Guard {
    /// The couple's position in the cell.
    pub couple: u8,
    epoch: u8,
    until: Instant,
}

impl Guard {
    pub const fn new(couple: u8) -> Self {
        Self { couple, epoch: 0, until: Instant::START }
    }

    /// Whether a command of this epoch is taken. Whoever acted in an older epoch was fenced before the newer one began,
    /// so what it sent is over by `until`.
    fn admit(&mut self, epoch: u8, now: Instant, until: Instant) -> bool {
        if self.until > now && is_newer_epoch(self.epoch, epoch) {
            return false;
        }
        (self.epoch, self.until) = (epoch, until.max(self.until));
        true
    }

    /// Forgets an epoch of which nothing can come any more.
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
    /// What a message says under the lease of a couple, without its epoch; `None` where a newer one was heard of. With a newer
    /// one goes what still waits of older ones.
    pub(super) fn within_epoch(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        port: &Port,
        (couple, (inbox, source)): (u8, Way),
        packet: &Packet,
    ) -> Option<Contents> {
        let now = step.now();
        let guard = self.guards.iter_mut().find(|guard| guard.couple == couple)?;
        let declared = port.party(packet.source).map_or(Ticks::ZERO, |party| party.time_out);
        let until = now + declared + step.table.bound_between(packet.source, step.own.task);
        let said = packet.contents.as_bytes().split_last();
        let newer = said.is_some_and(|(&e, _)| guard.until > now && is_newer_epoch(e, guard.epoch));
        let heeds = step.table.rules().heed_epochs;
        let contents = said.filter(|&(&epoch, _)| guard.admit(epoch, now, until) || !heeds);
        let Some((_, bytes)) = contents else {
            self.inboxes[inbox].close(source, packet.id);
            let reason = if said.is_some() { Reason::StaleEpoch } else { Reason::NotAllowed };
            step.drop_packet(packet, reason);
            return None;
        };
        if newer && heeds {
            self.drop_orders(step, couple);
        }
        Some(Contents::new(bytes).unwrap_or_default())
    }

    /// Drops what still waits of an epoch that has passed, on every port of the couple.
    fn drop_orders(&mut self, step: &mut Step<'_, impl Outbox>, couple: u8) {
        for inbox in 0..self.inboxes.len() {
            let port = self.inboxes[inbox].port;
            if step.table.port(port).is_none_or(|port| port.decl.guard != Some(couple)) {
                continue;
            }
            while let Some(old) = self.inboxes[inbox].queue.pop_if(|_: &Held| true) {
                discard(step, port, &old, Reason::StaleEpoch);
            }
            self.touch(step.own, inbox);
        }
    }
}
