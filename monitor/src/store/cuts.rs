//! Links over which nothing arrives, though packets are sent. The two ends share no clock, so the monitor counts the packets
//! that one node has sent since the other node last received one.

use super::{IncarnationId, NodeIncarnation, Presence, Store};
use crate::clock::Moment;
use crate::name::Name;
use std::collections::BTreeMap;
use std::time::Duration;

/// No packet is delayed for this long, so one that has not arrived by then is lost.
const SILENCE: Duration = Duration::from_secs(2);
/// A packet that was sent within this time after the last arrival may itself be the packet that arrived.
const SETTLED: Duration = Duration::from_millis(500);
/// The least number of packets that must all be lost; fewer may be lost by chance.
const PACKETS: u64 = 5;
/// The greatest number of link directions that are followed.
const MOST: usize = 4096;

/// Drop counters that grow routinely. Packets of a neighbour's previous incarnation still arrive after a restart, and
/// on a busy machine answers in handshakes may come too late.
pub(super) const ORDINARY: &[&str] = &["stale_incarnation", "unproven_session", "stale_session"];

/// What is known of one direction of a link since its last arrival.
#[derive(Clone, Copy, Debug)]
struct Silence {
    /// The last arrival, on the clock of the node that receives, in microseconds.
    heard_us: u64,
    /// The last arrival, on the monitor's clock.
    heard: Moment,
    /// How many packets the sender had sent by a moment soon after the last arrival ([`SETTLED`]).
    before: u64,
    /// The moment at which the sender had sent enough packets after that ([`PACKETS`]) to call the link cut.
    enough: Option<Moment>,
}

/// The directions of all links.
#[derive(Clone, Debug, Default)]
pub struct Silences {
    /// The key is the receiving incarnation and then the sending one.
    known: BTreeMap<(IncarnationId, IncarnationId), Silence>,
}

impl Silences {
    /// Takes note of a new state of an incarnation.
    pub fn sampled(&mut self, store: &Store, incarnation: &NodeIncarnation) {
        let Some(last) = &incarnation.last else { return };
        for link in &last.snapshot.links {
            let Some(peer) = store.latest(&incarnation.names.cell, link.peer) else { continue };
            // If nothing ever arrived over a link, the silence is as long as the node runs.
            let silent_us = link.heard_us.unwrap_or(last.snapshot.uptime_us);
            let heard_us = last.snapshot.mono_us.saturating_sub(silent_us);
            let to_here = (incarnation.id, peer.id);
            // Two reports of one arrival differ by less than a millisecond, because each is computed from two
            // readings of the node's clock.
            if self.known.get(&to_here).is_none_or(|known| heard_us > known.heard_us.saturating_add(1_000)) {
                let heard = last.at.saturating_sub(Duration::from_micros(silent_us));
                let before = sent(peer, incarnation);
                self.known.insert(to_here, Silence { heard_us, heard, before, enough: None });
            }
            if let Some(silence) = self.known.get_mut(&(peer.id, incarnation.id)) {
                silence.has_sent(last.at, link.sent);
            }
        }
        if self.known.len() > MOST {
            self.known.pop_first();
        }
    }

    fn of(&self, to: &NodeIncarnation, from: &NodeIncarnation) -> Option<&Silence> {
        self.known.get(&(to.id, from.id))
    }
}

impl Silence {
    /// Notes that the sender has sent `count` packets by the moment `at`.
    fn has_sent(&mut self, at: Moment, count: u64) {
        if at.saturating_sub(self.heard) < SETTLED {
            self.before = count;
        } else if self.enough.is_none() && count >= self.before.saturating_add(PACKETS) {
            self.enough = Some(at);
        }
    }
}

/// How many packets a node has sent to another one.
fn sent(from: &NodeIncarnation, to: &NodeIncarnation) -> u64 {
    let links = from.last.as_ref().map_or(&[][..], |last| &last.snapshot.links);
    links.iter().find(|link| link.peer == to.node_id).map_or(0, |link| link.sent)
}

/// A direction of a link in which nothing arrives.
#[derive(Clone, Copy, Debug)]
pub struct Cut<'a> {
    /// The node that sends.
    pub from: &'a NodeIncarnation,
    /// The node at which nothing arrives.
    pub to: &'a NodeIncarnation,
    /// How many packets were sent since the last arrival.
    pub sent: u64,
    /// The time since the last arrival.
    pub silent: Duration,
}

/// The cut links of a cell: between nodes that both report, where one sends and the other hears nothing.
#[must_use]
pub fn cuts<'a>(store: &'a Store, cell: &Name, now: Moment) -> Vec<Cut<'a>> {
    let mut found = Vec::new();
    for to in store.incarnations_of(cell).filter(|to| store.is_present(to) && is_awake(to, now)) {
        let Some(last) = &to.last else { continue };
        for link in &last.snapshot.links {
            let Some(from) = store.latest(cell, link.peer) else { continue };
            let Some(silence) = store.silences.of(to, from) else { continue };
            // Packets that are in flight when the states are taken arrive a moment later.
            let is_long = silence.enough.is_some_and(|enough| last.at.saturating_sub(enough) >= SILENCE);
            // A node that drops datagrams receives them.
            if is_long && is_awake(from, now) && !drops(to) {
                let sent = sent(from, to).saturating_sub(silence.before);
                found.push(Cut { from, to, sent, silent: now.saturating_sub(silence.heard) });
            }
        }
    }
    found
}

/// Whether a node reports at present, and has reported for the last seconds without a pause. A node whose process was
/// stopped receives nothing, though its links work.
fn is_awake(incarnation: &NodeIncarnation, now: Moment) -> bool {
    incarnation.presence(now) == Presence::Up && now.saturating_sub(incarnation.resumed) >= SILENCE
}

/// Whether the links of a node have dropped a datagram that arrived, within the last seconds.
fn drops(incarnation: &NodeIncarnation) -> bool {
    let count = |sample: &Option<super::Sample>| {
        let drops = sample.as_ref().map_or(&[][..], |sample| &sample.snapshot.link_discards);
        // Failed sends say nothing about arrivals. After a restart a node drops some datagrams and then accepts others,
        // unless the two ends find no common session.
        let is_other = |name: &str| name.starts_with("send_") || ORDINARY.contains(&name);
        let arrived = drops.iter().filter(|drop| !is_other(&drop.name));
        arrived.map(|drop| drop.count).fold(0, u64::saturating_add)
    };
    count(&incarnation.last) > count(&incarnation.base)
}
