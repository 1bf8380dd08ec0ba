//! Packs cell states into their canonical bytes and unpacks them: one block of bytes, with relative numbers, in a fixed
//! order (D51).

use super::judge::Name;
use super::plan::Transfer;
use super::{CellState, FAR_BEHIND, InFlight};
use crate::state::{Packed, Violation};
use imrs_protocol::{
    Coming, CommTask, Decode, Encode, Frame, Kind, Overflow, Packet, Pass, PortId, Round, Seq24, Usage, Walk,
};

/// The numbers to which packed numbers are relative.
struct Bases {
    rounds: Vec<Round>,
    /// For each port, whether some round of it is in use.
    used: Vec<bool>,
    sequences: Vec<Seq24>,
    incarnations: bool,
}

impl Bases {
    fn frame(&self) -> Frame<'_> {
        Frame { rounds: &self.rounds, sequences: &self.sequences, incarnations: self.incarnations }
    }

    fn back(&self, name: &Name) -> u32 {
        let next = self.sequences.get(name.source.index()).copied().unwrap_or_default();
        next.steps_from(name.number)
    }
}

impl CellState {
    /// Packs the state in its canonical form.
    pub fn store(&mut self) -> Packed {
        let mut out = Vec::with_capacity(128);
        self.append_to(&mut out);
        Packed(out.into_boxed_slice())
    }

    /// Appends the packed state to `out`.
    pub fn append_to(&mut self, out: &mut Vec<u8>) {
        let from = out.len();
        // If a relative number outgrows its field, the search reports a violation; no value saturates silently.
        let violation =
            self.violation.or_else(|| self.try_append(out).err().map(|Overflow| Violation::Overflow));
        if let Some(violation) = violation {
            out.truncate(from);
            out.extend([violation.code(), 0, 0, 0, 0]);
        }
    }

    fn try_append(&mut self, out: &mut Vec<u8>) -> Result<(), Overflow> {
        for node_state in self.nodes.iter_mut().filter(|s| s.up) {
            node_state.node.parts_mut().tasks.iter_mut().for_each(CommTask::bury);
        }
        if !self.plan.keeps_seen {
            let coming = self.coming();
            for node_state in self.nodes.iter_mut().filter(|s| s.up) {
                node_state.node.parts_mut().tasks.iter_mut().for_each(|task| task.bury_seen(&coming));
            }
        }
        let bases = self.bases();
        let frame = bases.frame();
        self.spec_states
            .remaining
            .sort_unstable_by_key(|(name, left)| (name.source, *left, name.number.get()));
        self.spec_states
            .refused
            .sort_unstable_by_key(|(task, port, name, _)| (*task, *port, name.source, bases.back(name)));
        let mut behind = if self.counts_behind() { self.behind_from(&bases) } else { Vec::new() };
        out.push(0);
        Encode::append(out, &frame, |w| self.walk(&mut behind, w))?;
        // Packets of a link are packed in the order in which they left, because they arrive in that order. In the
        // search of a cell the packets are already sorted by their links.
        let is_in_order =
            self.plan.transfer == Transfer::Exact && self.in_flight.is_sorted_by_key(|carried| carried.link);
        if is_in_order {
            return Encode::append(out, &frame, |w| {
                self.in_flight.iter_mut().for_each(|carried| carried.walk(w));
            });
        }
        let mut in_flight = Vec::with_capacity(self.in_flight.len());
        for carried in &mut self.in_flight {
            in_flight.push((carried.link, Encode::bytes(&frame, |w| carried.walk(w))?));
        }
        match self.plan.transfer {
            Transfer::Any => in_flight.sort_unstable(),
            Transfer::Exact => in_flight.sort_by_key(|(link, _)| *link),
        }
        in_flight.iter().for_each(|(_, bytes)| out.extend(bytes));
        Ok(())
    }

    /// Unpacks a state.
    pub fn load(&mut self, state: &Packed) {
        self.violation = state.violation();
        self.load_bytes(&state.0);
    }

    /// Unpacks the bytes of a state without a violation.
    pub fn load_bytes(&mut self, bytes: &[u8]) {
        // If a run ended in a violation, scripts may still have inputs that they have not taken. These are dropped.
        self.ready.clear();
        self.rounds.fill(Frame::ROUND);
        self.sequences.fill(Frame::SEQUENCE);
        let mut behind = std::mem::take(&mut self.behind);
        Decode::read(bytes.get(1..).unwrap_or_default(), self.plan.incarnations(), |r| {
            self.walk(&mut behind, r);
            self.in_flight.clear();
            while r.has_more() {
                let mut carried = InFlight::BLANK;
                carried.walk(r);
                self.in_flight.push(carried);
            }
        });
        self.behind = behind;
    }

    /// For each port, the distance from the round with which a new incarnation begins to the least round that any member
    /// uses now.
    fn behind_from(&self, bases: &Bases) -> Vec<u8> {
        let of_port = |(port, &behind): (usize, &u8)| {
            let moved = bases.rounds[port].steps_from(self.rounds[port]).cast_signed();
            let from_first = i32::from(behind) + i32::from(moved);
            // While no member uses a round of the port, a restarted node has no rounds to catch up with.
            let from_first = if bases.used[port] { from_first } else { 0 };
            u8::try_from(from_first.clamp(0, i32::from(FAR_BEHIND))).unwrap_or(FAR_BEHIND)
        };
        self.behind.iter().enumerate().map(of_port).collect()
    }

    /// All messages that may still arrive at a task: in flight, queued, or retransmitted by a waiting sender.
    fn coming(&self) -> Vec<Coming> {
        let up = || self.nodes.iter().filter(|s| s.up).map(|node_state| &node_state.node);
        let waiting = up().flat_map(|node| node.parts().transit.waiting());
        let packets = self.in_flight.iter().map(|carried| carried.packet).chain(waiting);
        let packets = packets.chain(up().flat_map(imrs_protocol::Node::work_packets).copied());
        let messages = packets.filter(|packet| matches!(packet.kind, Kind::Send | Kind::Query));
        let of_packet = |packet: Packet| Coming {
            port: packet.port,
            source: packet.source,
            to: packet.destination,
            sequence: packet.id.sequence,
        };
        let again = up().flat_map(|node| &node.parts().tasks).flat_map(|task| {
            let source = task.task();
            let asked = task.outstanding();
            asked.map(move |(port, to, id)| Coming { port, source, to, sequence: id.sequence })
        });
        messages.map(of_packet).chain(again).collect()
    }

    /// For each port the least round in use, and for each task its next sequence number.
    fn bases(&mut self) -> Bases {
        let sequences = (0..self.bodies.len()).map(|task| self.next_sequence(task)).collect();
        let incarnations = self.plan.incarnations();
        // In the search of a cell, `behind` says how far the rounds of a new incarnation are behind the rounds of the other
        // members.
        if incarnations && self.turns.is_none() {
            // A restarted node counts rounds from the first round on, so only absolute rounds can be compared with those of
            // other nodes.
            let used = vec![true; self.rounds.len()];
            return Bases { rounds: self.rounds.clone(), used, sequences, incarnations };
        }
        let mut least = Least(vec![None; self.rounds.len()]);
        // Only rendezvous have rounds. In a cell without a `waitfor`, no task is searched for its least round.
        if self.plan.cell.ports().iter().any(|port| port.decl.usage == Usage::Waitfor) {
            for node_state in self.nodes.iter_mut().filter(|s| s.up) {
                let parts = node_state.node.parts_mut();
                parts.tasks.iter_mut().for_each(|task| task.walk(&node_state.table, &mut least));
                parts.transit.walk(&node_state.table, &mut least);
                node_state.node.walk_work(&mut least);
            }
            self.in_flight.iter_mut().for_each(|carried| carried.packet.walk(&mut least));
        }
        let used = least.0.iter().map(Option::is_some).collect();
        let rounds = least.0.iter().zip(&self.rounds).map(|(least, old)| least.unwrap_or(*old)).collect();
        Bases { rounds, used, sequences, incarnations }
    }
}

/// A pass over the fields of tasks, which finds the least round in use for each port.
pub(crate) struct Least(pub Vec<Option<Round>>);

impl Walk for Least {
    const PASS: Pass = Pass::Look;

    fn round(&mut self, port: PortId, round: &mut Round) {
        let slot = &mut self.0[port.index()];
        *slot = Some(slot.map_or(*round, |least| if least.is_newer_than(*round) { *round } else { least }));
    }
}
