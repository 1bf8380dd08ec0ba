//! Where packets from other nodes enter this node.

use super::Node;
use crate::clock;
use crate::link::{LinkDiscard, Sink};
use crate::node::effects::Effects;
use crate::sync::{Mutex, Ordering, lock};
use imrs_protocol::{Incarnation, Input, NodeId, Packet, Ticks};
use std::sync::Arc;
use std::time::Instant;

/// The state with which one thread receives: the node, and the thread's effects.
pub(crate) struct Inlet {
    node: Arc<Node>,
    effects: Mutex<Effects>,
}

impl Inlet {
    pub fn new(node: Arc<Node>) -> Self {
        let effects = Effects::of_a_receiver(node.locals.list.len());
        Self { node, effects: Mutex::new(effects) }
    }

    /// Sends the packets that waited for a neighbour, because the link can take packets for this neighbour again.
    pub fn ready(&self) {
        self.node.dispatch.ready();
        let mut effects = lock(&self.effects);
        self.node.dispatch.pump(clock::now(), &mut effects);
        self.node.carry_out(&mut effects);
    }
}

impl Sink for Inlet {
    fn packets(&self, from: NodeId, packets: &[Packet], charge: Ticks, at: Instant) {
        // The clock is read first, so that packets never count as too young. If this thread is preempted between the
        // two readings, that time is charged twice, and the packets count as too old. If it is preempted later, that
        // time is charged once, because the packets get the stamp `now`, not the instant at which the tasks take them.
        let now = clock::now();
        let charge = charge + Ticks(clock::micros(at.elapsed()));
        if let Some(peer) = self.node.peer(from) {
            peer.received.fetch_add(packets.len() as u64, Ordering::Relaxed);
            peer.heard.store(now, Ordering::Relaxed);
        }
        self.node.receive(from, packets, charge, now, &mut lock(&self.effects));
    }

    fn peer(&self, node: NodeId, incarnation: Incarnation, restarted: bool) {
        let Some(peer) = self.node.peer(node) else { return };
        let before = lock(&peer.incarnation).replace(incarnation);
        // A command to an earlier incarnation of the neighbour may or may not have run, and no answer to it will
        // come. This node may have sent the command before it received anything from the neighbour. A neighbour that
        // lost its state may start again with the number of an earlier incarnation.
        if before.is_some() || restarted {
            self.node.tell_all(Input::PeerRestarted(node), clock::now(), &mut lock(&self.effects));
        }
    }

    fn stopped(&self, node: NodeId) {
        self.node.tell_all(Input::PeerStopped(node), clock::now(), &mut lock(&self.effects));
    }

    fn discarded(&self, reason: LinkDiscard) {
        self.node.link_discards[reason.index()].fetch_add(1, Ordering::Relaxed);
    }
}
