//! Reassembly of messages of several packets. A message that is not complete by its deadline is dropped. Ports whose
//! messages take one packet skip this stage (D28).

use super::inbox::Inbox;
use super::{Origin, Server};
use crate::ids::{MessageId, TaskId};
use crate::observe::{Event, Reason};
use crate::packet::Packet;
use crate::task::fragments::Progress;
use crate::task::step::{Outbox, Step};
use crate::ticks::Ticks;

impl Server {
    /// Adds a fragment to its message. Returns the message once it is complete, as one packet with the least remaining time
    /// of all fragments. `reserved` is the link delay of the reply: the message expires as soon as its answer could no
    /// longer arrive in time (D18).
    pub(super) fn assemble(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        origin: Origin,
        packet: &Packet,
        reserved: Ticks,
    ) -> Option<(Packet, u8)> {
        let (inbox, source) = origin;
        let (now, endpoint) = (step.now(), self.inboxes[inbox].endpoint);
        let Some(assembly) = self.inboxes[inbox].assembly_mut(source) else {
            step.drop_packet(endpoint, packet, Reason::NotAllowed);
            return None;
        };
        if !assembly.is_open() {
            assembly.begin(packet.id);
        } else if assembly.id != packet.id {
            if !packet.id.sequence.is_newer_than(assembly.id.sequence) {
                step.drop_packet(endpoint, packet, Reason::Incomplete);
                return None;
            }
            self.overtake(step, origin, packet);
            self.inboxes[inbox].assembly_mut(source)?.begin(packet.id);
        }
        let assembly = self.inboxes[inbox].assembly_mut(source)?;
        match assembly.put(packet, now + packet.remaining - reserved) {
            Progress::Waits => None,
            Progress::Again => {
                step.duplicate(endpoint, packet);
                None
            }
            Progress::Broken => {
                step.drop_packet(endpoint, packet, Reason::Incomplete);
                None
            }
            Progress::Whole(fragments) => {
                let (remaining, contents) = (assembly.expires - now + reserved, assembly.contents[0]);
                Some((Packet { remaining, contents, fragment: 0, more: false, ..*packet }, fragments))
            }
        }
    }

    /// Drops the fragments of an older incomplete message, because a newer message of the source has come.
    pub(super) fn overtake(
        &mut self,
        step: &mut Step<'_, impl Outbox>,
        (inbox, source): Origin,
        packet: &Packet,
    ) {
        let Some(assembly) = self.inboxes[inbox].assembly_mut(source) else { return };
        if assembly.is_open() && packet.id.sequence.is_newer_than(assembly.id.sequence) {
            let old = assembly.id;
            assembly.have = 0;
            incomplete(step, &self.inboxes[inbox], packet.source, old);
        }
    }

    /// Drops the incomplete messages of a port that have expired.
    pub(super) fn discard_incomplete(&mut self, step: &mut Step<'_, impl Outbox>, inbox: usize) {
        for at in 0..self.inboxes[inbox].sources.len() {
            let entry = &mut self.inboxes[inbox];
            let task = entry.sources[at].task;
            let Some(assembly) = entry.assembly_mut(at) else { continue };
            if assembly.is_open() && assembly.expires <= step.now() {
                let id = assembly.id;
                assembly.have = 0;
                incomplete(step, &self.inboxes[inbox], task, id);
            }
        }
    }
}

fn incomplete(step: &mut Step<'_, impl Outbox>, inbox: &Inbox, source: TaskId, id: MessageId) {
    step.count(inbox.endpoint, |c| c.dropped += 1);
    step.note(Event::Discarded(Reason::Incomplete), inbox.port, source, id, Ticks::ZERO);
}
