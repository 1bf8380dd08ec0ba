//! Canonical packing of a transit buffer.

use super::{Transit, Waiting};
use crate::packet::Packet;
use crate::state::{Pass, Walk, restart};
use crate::table::NodeTable;
use alloc::vec::Vec;

/// A flag in the first packed byte: whether refusals wait.
const WITH_WORDS: u8 = 0x80;

impl Transit {
    /// Sets the buffer's clock back to zero. This changes no behaviour.
    pub fn rebase(&mut self, table: &NodeTable) {
        let now = self.now;
        self.walk(table, &mut restart(now));
    }

    /// Walks the waiting packets, most urgent first. The packed form consists of the packets with their remaining times. A
    /// pass that reads computes the other fields from the packets' routes.
    pub fn walk<W: Walk>(&mut self, table: &NodeTable, w: &mut W) {
        w.clock(&mut self.now);
        let Self {
            now,
            // This counter is not packed: only the order of arrival matters, and the order of packing keeps it.
            arrivals,
            queue,
            words,
            // This field is a counter for monitors, and behaviour does not depend on it.
            forwarded: _,
            discarded: _,
        } = self;
        if W::PASS == Pass::Change {
            return [queue, words]
                .into_iter()
                .for_each(|queue| queue.change_all(|waiting, ()| waiting.walk(w)));
        }
        let mut waiting: Vec<Packet> = Vec::new();
        if W::READS {
            *arrivals = 0;
            queue.clear();
            words.clear();
        } else if queue.len() + words.len() > 0 {
            let both = queue.sorted().into_iter().chain(words.sorted());
            waiting.extend(both.map(|(_, waiting)| waiting.left(*now)));
        }
        // Seven bits for the number of messages, and one bit for whether refusals follow.
        let messages = u8::try_from(queue.len()).ok().filter(|&messages| messages < WITH_WORDS);
        if messages.is_none() {
            w.overflows();
        }
        let head = w.put(messages.unwrap_or(0) | if words.len() > 0 { WITH_WORDS } else { 0 });
        let words = if head & WITH_WORDS != 0 { w.count(words.len()) } else { 0 };
        waiting.iter_mut().for_each(|packet| packet.walk(w));
        if W::READS {
            let messages = usize::from(head & !WITH_WORDS);
            (0..messages + words).for_each(|i| self.take_in(table, i < messages, w));
        }
    }

    /// Reads one waiting packet.
    fn take_in<W: Walk>(&mut self, table: &NodeTable, is_message: bool, w: &mut W) {
        let mut packet = Packet::BLANK;
        packet.walk(w);
        let Some(way) = table.way_to(packet.destination) else { return };
        let waiting = self.waits(table, packet, way);
        let queue = if is_message { &mut self.queue } else { &mut self.words };
        let _ = queue.push(waiting);
    }
}

impl Waiting {
    fn walk<W: Walk>(&mut self, w: &mut W) {
        let Self {
            packet,
            expires,
            leave_by,
            // The pass need not shift these two fields: an arrival number, and the next hop.
            arrival: _,
            next: _,
        } = self;
        packet.walk(w);
        w.instant(expires);
        w.instant(leave_by);
    }
}
