//! Two tasks on one node, to test a part by itself, and a record of its effects.

use super::own::Own;
use super::step::{Outbox, Step};
use crate::cell::{Cell, CoupleDecl, PortDecl, Usage};
use crate::ids::{Incarnation, NodeId, PortId, TaskId};
use crate::observe::Observation;
use crate::packet::Packet;
use crate::request::{Signal, TimeId};
use crate::table::{CellTable, Ends, NodeTable};
use crate::ticks::{Instant, Ticks};
use alloc::sync::Arc;
use alloc::vec::Vec;

/// On this port, A may send commands to B, with retransmissions.
pub(super) const MOVE: PortId = PortId(0);
/// The port of a rendezvous of A and B.
pub(super) const LIFT: PortId = PortId(1);
/// The port of the couple's heartbeats: A is the primary, B the standby.
pub(super) const ALIVE: PortId = PortId(2);
pub(super) const A: TaskId = TaskId(0);
pub(super) const B: TaskId = TaskId(1);

/// The recorded effects of one part of a communication task, such as its server or its lease.
#[derive(Default)]
pub(super) struct Effects {
    pub packets: Vec<Packet>,
    pub armed: Vec<(TimeId, u8, Ticks)>,
    pub disarmed: Vec<TimeId>,
    pub observed: Vec<Observation>,
}

impl Outbox for Effects {
    fn transmit(&mut self, packet: Packet) {
        self.packets.push(packet);
    }
    fn signal(&mut self, signal: Signal) {
        panic!("no part tells the task by itself: {signal:?}");
    }
    fn arm(&mut self, id: TimeId, turn: u8, length: Ticks) {
        self.armed.push((id, turn, length));
    }
    fn disarm(&mut self, id: TimeId) {
        self.disarmed.push(id);
    }
    fn observe(&mut self, observation: Observation) {
        self.observed.push(observation);
    }
}

/// The context in which a part of one of the two tasks works.
pub(super) struct Fixture {
    pub table: NodeTable,
    pub own: Own,
    pub effects: Effects,
}

impl Fixture {
    pub fn new(task: TaskId) -> Self {
        let mut cell = Cell::new("pair", Ticks(1));
        let node = cell.node("n");
        let (a, b) = (cell.task("a", node), cell.task("b", node));
        cell.port(PortDecl::new("move", a, Usage::Send, &[b], Ticks(20)).command().retry(2, Ticks(4)));
        cell.port(PortDecl::new("lift", b, Usage::Waitfor, &[a], Ticks(40)).resend(Ticks(6), 1));
        let via = cell.port(PortDecl::new("alive", a, Usage::Response, &[b], Ticks(6)));
        let (lease, takeover, every) = (Ticks(14), Ticks(32), Ticks(4));
        let (trusted, mutual) = (false, false);
        cell.couples.push(CoupleDecl {
            primary: a,
            standby: b,
            lease,
            takeover,
            every,
            via,
            trusted,
            mutual,
        });
        let table = NodeTable::new(Arc::new(CellTable::new(cell).expect("a cell")), NodeId(0));
        let own = Own::new(&table, task, Incarnation(0), false);
        Self { table, own, effects: Effects::default() }
    }

    /// The port of a packet, with this task and the source of the packet as its two ends.
    pub fn ends<'a>(table: &'a NodeTable, packet: &Packet) -> Ends<'a> {
        let port = table.port(packet.port).expect("a port");
        port.ends(packet.destination, packet.source).expect("admitted")
    }

    /// The step context at an instant.
    pub fn at(&mut self, now: Instant) -> Step<'_, Effects> {
        self.own.now = now;
        Step { table: &self.table, own: &mut self.own, out: &mut self.effects }
    }

    /// The packets that were sent since the last call.
    pub fn packets(&mut self) -> Vec<Packet> {
        core::mem::take(&mut self.effects.packets)
    }
}
