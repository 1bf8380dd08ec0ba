//! Packs worlds into their canonical bytes and unpacks them (D51).

use super::World;
use crate::cell_state::NodeState;
use crate::cell_state::canon::Least;
use crate::network::{Codec, InFlight};
use crate::scenario::Scenario;
use crate::spec_state::{self, SpecState};
use crate::state::{HEADER, Packed, Violation};
use crate::symmetry;
use imrs_protocol::{
    Decode, Encode, Frame, Kind, Overflow, Pass, PortId, Round, Seq24, TaskId, TaskState, Ticks, Walk, mark,
};

impl World {
    /// Unpacks a state. If `touch` names a node, only that node is unpacked, and only steps of that node may follow.
    pub fn load(&mut self, state: &Packed, touch: Option<usize>) {
        let bytes = &state.0;
        self.violation = state.violation();
        (self.loss, self.dup, self.crash) = (bytes[1], bytes[2], bytes[3]);
        (self.healed, self.done) = (bytes[4] & 1 != 0, bytes[4] & 2 != 0);
        self.late = bytes[4] >> 4;
        self.steps = u16::from_le_bytes([bytes[5], bytes[6]]);
        let mut at = HEADER;
        for spec_state in &mut self.spec_states {
            at +=
                spec_state::load(spec_state, self.scenario.watch, self.scenario.incarnations(), &bytes[at..]);
        }
        self.rounds.fill(Frame::ROUND);
        let incarnations = self.scenario.incarnations();
        for i in 0..self.nodes.len() {
            let len = usize::from(bytes[at]);
            let block = &bytes[at..at + len];
            self.open[i] = block[1] & OPEN != 0;
            self.nodes[i].owed = u8::from(block[1] & OWED != 0);
            self.loaded[i] = touch.is_none_or(|touched| touched == i);
            if self.loaded[i] {
                load_node_state(&mut self.nodes[i], block, incarnations, self.scenario.clocks[i]);
            } else {
                self.blocks[i].clear();
                self.blocks[i].extend_from_slice(block);
            }
            at += len;
        }
        self.in_flight.clear();
        while at < bytes.len() {
            let (mut carried, len) = self.codec.decode(&bytes[at..]);
            if carried.packet.source == carried.packet.destination {
                // This CONFIRM was packed without its sender (see `anonymous`), so any other member becomes its source.
                let other = (carried.packet.destination.index() + 1) % self.nodes.len();
                carried.packet.source = TaskId::from_index(other);
            }
            self.in_flight.push(carried);
            at += len;
        }
    }

    /// The destination of the packet at position `i` of a packed state. Unpacks no node.
    pub fn destination(scenario: &Scenario, state: &Packed, i: u8) -> Option<usize> {
        let bytes = &state.0;
        let mut at = HEADER;
        let mut spec_state = SpecState::default();
        for _ in 0..scenario.tasks() {
            at += spec_state::load(&mut spec_state, scenario.watch, scenario.incarnations(), &bytes[at..]);
        }
        for _ in 0..scenario.tasks() {
            at += usize::from(*bytes.get(at)?);
        }
        let codec = Codec::new(scenario);
        for _ in 0..i {
            at += codec.decode(bytes.get(at..)?).1;
        }
        let (carried, _) = codec.decode(bytes.get(at..)?);
        Some(carried.packet.destination.index())
    }

    /// Packs the state in its canonical form.
    pub fn store(&mut self) -> Packed {
        self.store_as(Form::Canonical)
    }

    /// Packs the state, but leaves the marks of the reduction by turns unchanged. For tests.
    pub fn store_plain(&mut self) -> Packed {
        self.store_as(Form::Plain)
    }

    /// Packs the state in the given form.
    pub fn store_as(&mut self, form: Form<'_>) -> Packed {
        match self.try_store(form) {
            Ok(packed) => packed,
            // If a relative number outgrows its field, the result is an absorbing violation, never a saturated value.
            Err(Overflow) => Packed(Box::new([Violation::Overflow.code(), 0, 0, 0, 0])),
        }
    }

    fn try_store(&mut self, form: Form<'_>) -> Result<Packed, Overflow> {
        if let Some(violation) = self.violation {
            // The violating state has no successors, so no other part of it needs to be kept.
            return Ok(Packed(Box::new([violation.code(), 0, 0, 0, 0])));
        }
        if self.done {
            return Ok(Packed(Box::new([0, 0, 0, 0, 2])));
        }
        for (place, loaded) in self.nodes.iter_mut().zip(&self.loaded) {
            if *loaded {
                place.node.parts_mut().tasks[0].bury();
            }
        }
        if self.scenario.reductions.ignores && self.is_settled() {
            self.drop_unnoticed();
        }
        if form != Form::Plain {
            self.tidy_turns();
        }
        let (rounds, sequences) = self.bases();
        let moved = rounds.first().zip(self.rounds.first()).map_or(0, |(new, old)| new.steps_from(*old));
        if moved != 0 {
            self.load_rest();
        }
        let frame =
            Frame { rounds: &rounds, sequences: &sequences, incarnations: self.scenario.incarnations() };
        for i in 0..self.n() {
            if self.loaded[i] {
                self.blocks[i].clear();
                store_node_state(&mut self.nodes[i], &frame, &mut self.blocks[i])?;
            }
            let marks = mark(self.open[i], OPEN) | mark(self.nodes[i].owed > 0, OWED);
            self.blocks[i][1] = (self.blocks[i][1] & !(OPEN | OWED)) | marks;
        }
        let flags = u8::from(self.healed) | (self.late << 4);
        let [low, high] = self.steps.to_le_bytes();
        let header = [0, self.loss, self.dup, self.crash, flags, low, high];
        let least = self.spec_states.iter().map(|g| g.releases).min().unwrap_or(0);
        let mut specs = Vec::with_capacity(self.n());
        for (task, spec) in (0..).map(TaskId::from_index).zip(&self.spec_states) {
            let mut bytes = Vec::with_capacity(4);
            spec_state::store(spec, self.scenario.watch, &frame, u32::from(moved), task, least, &mut bytes)?;
            specs.push(bytes);
        }
        let reduces = self.scenario.reductions.ignores && !self.scenario.incarnations();
        // A CONFIRM releases a waiting member whatever its sender, so the receiver is packed in the sender's place.
        let anonymous = |carried: &InFlight| {
            let mut carried = *carried;
            if reduces && self.releases(&carried) {
                carried.packet.source = carried.packet.destination;
            }
            carried
        };
        let packets: Vec<InFlight> = self.in_flight.iter().map(anonymous).collect();
        let parts = symmetry::Parts {
            header,
            specs: &specs,
            blocks: &self.blocks,
            packets: &packets,
            frame,
            codec: self.codec,
        };
        let bytes = match form {
            Form::Named(order) => parts.renamed(order)?,
            Form::Canonical | Form::Plain if self.scenario.members_alike() => {
                let (bytes, named) = parts.least()?;
                self.named = named;
                bytes
            }
            Form::Canonical | Form::Plain => parts.in_order()?,
        };
        Ok(Packed(bytes.into_boxed_slice()))
    }

    /// Unpacks the nodes that are still packed, because the round or sequence number to which their numbers are relative
    /// has moved.
    fn load_rest(&mut self) {
        for i in 0..self.n() {
            if !self.loaded[i] {
                load_node_state(
                    &mut self.nodes[i],
                    &self.blocks[i],
                    self.scenario.incarnations(),
                    self.scenario.clocks[i],
                );
                self.loaded[i] = true;
            }
        }
    }

    /// Whether no running node can crash any more. If a node could crash, its next incarnation might notice packets that
    /// the present incarnation ignores.
    fn is_settled(&self) -> bool {
        !self.scenario.incarnations() || self.crash == 0
    }

    /// Whether both nodes are up and node `i` knows the present incarnation of node `of`, so that no envelope from `of`
    /// reports a new incarnation.
    fn knows(&self, i: usize, of: usize) -> bool {
        let up = self.nodes[i].up && self.nodes[of].up;
        !self.scenario.incarnations() || (up && self.nodes[i].known[of] == self.nodes[of].incarnation)
    }

    /// Whether the tasks at both ends of a packet have heard from each other in their present incarnations.
    fn acquainted(&self, carried: &InFlight) -> bool {
        let (from, to) = (carried.packet.source, carried.packet.destination);
        let heard = |at: TaskId, of: TaskId| {
            let incarnation =
                self.task(at.index()).heard_in(&self.nodes[at.index()].table, carried.packet.port, of);
            incarnation == Some(self.nodes[of.index()].incarnation)
        };
        !self.scenario.incarnations()
            || (self.knows(from.index(), to.index()) && heard(from, to) && heard(to, from))
    }

    /// Drops CONFIRMs that are still to be sent and that every member would ignore, then packets in flight that no task can
    /// notice. The order matters, because a member that still owes a CONFIRM notices arrivals.
    fn drop_unnoticed(&mut self) {
        let port = PortId(0);
        for i in 0..self.n() {
            if let Some(round) = self.task(i).owes(port)
                && (0..self.n()).all(|other| {
                    other == i || (self.knows(other, i) && self.task(other).is_over(port, round))
                })
            {
                let task = &mut self.nodes[i].node.parts_mut().tasks[0];
                task.settle(port);
                task.bury();
            }
        }
        let mut in_flight = std::mem::take(&mut self.in_flight);
        in_flight.retain(|carried| !self.is_unnoticed(carried));
        self.in_flight = in_flight;
        if !self.scenario.incarnations() {
            self.drop_more_confirms();
        }
    }

    fn is_unnoticed(&self, carried: &InFlight) -> bool {
        let packet = &carried.packet;
        let (from, to) = (packet.source.index(), packet.destination.index());
        let known = self.nodes[to].known[from];
        if self.scenario.incarnations() && self.nodes[to].up && carried.incarnation != known {
            return carried.incarnation.0 < known.0;
        }
        // A member that has left a round ignores CONFIRMs of that round, even if it still owes one itself.
        let confirmed =
            packet.kind == Kind::Confirm && self.task(to).is_over(packet.port, packet.meeting().round);
        let ignores = || self.task(to).ignores(&self.nodes[to].table, packet, self.task(from));
        self.nodes[to].up && (confirmed || (self.acquainted(carried) && ignores()))
    }

    /// The first CONFIRM of a round releases a member that waits in that round, and the member ignores later ones. So only
    /// the oldest CONFIRMs in flight to a member are kept: one more than the number of packets that can still be lost.
    fn drop_more_confirms(&mut self) {
        let enough = usize::from(self.loss) + 1;
        let releases: Vec<bool> = self.in_flight.iter().map(|carried| self.releases(carried)).collect();
        if releases.iter().filter(|&&releases| releases).count() <= enough {
            return;
        }
        let key = |at: usize, carried: &InFlight| (std::cmp::Reverse(carried.age), carried.fresh, at);
        let older = |at: usize, carried: &InFlight| {
            let others = self.in_flight.iter().enumerate().filter(|&(other, _)| releases[other]);
            let here = others.filter(|(_, other)| other.packet.destination == carried.packet.destination);
            here.filter(|&(other, of)| key(other, of) < key(at, carried)).count()
        };
        let kept = self.in_flight.iter().enumerate();
        let kept = kept.filter(|&(at, carried)| !releases[at] || older(at, carried) < enough);
        self.in_flight = kept.map(|(_, carried)| *carried).collect();
    }

    /// Whether a packet is a CONFIRM that would release its receiver now.
    fn releases(&self, carried: &InFlight) -> bool {
        let packet = &carried.packet;
        let to = packet.destination.index();
        packet.kind == Kind::Confirm
            && match self.task(to).state() {
                TaskState::Waiting { round, .. } => round == packet.meeting().round,
                _ => false,
            }
    }

    /// For each port the least round in use, and for each task the next sequence number.
    fn bases(&mut self) -> (Vec<Round>, Vec<Seq24>) {
        let sequence = |i: usize| if self.loaded[i] { self.next_sequence(i) } else { Frame::SEQUENCE };
        let sequences = (0..self.n()).map(sequence).collect();
        if self.scenario.incarnations() {
            // A restarted node counts rounds from the first one, so only absolute rounds can be compared with those of other
            // nodes.
            return (self.rounds.clone(), sequences);
        }
        let mut least = Least(vec![None; self.rounds.len()]);
        for (i, place) in self.nodes.iter_mut().enumerate() {
            if self.loaded[i] {
                place.node.parts_mut().tasks[0].walk(&place.table, &mut least);
            } else if let Some(&low) = self.blocks[i].get(1) {
                least.round(PortId(0), &mut Frame::ROUND.plus(u16::from(low & !(OPEN | OWED))));
            }
        }
        self.in_flight.iter_mut().for_each(|carried| carried.packet.walk(&mut least));
        for spec_state in &self.spec_states {
            if let Some(mut round) = spec_state.last_released {
                least.round(PortId(0), &mut round);
            }
        }
        let rounds = least.0.iter().zip(&self.rounds).map(|(least, old)| least.unwrap_or(*old)).collect();
        (rounds, sequences)
    }

    /// Drops everything that the packed form of the state would leave out, without packing the state.
    pub fn tidy(&mut self) {
        if self.scenario.reductions.ignores && self.is_settled() && self.violation.is_none() {
            for place in &mut self.nodes {
                place.node.parts_mut().tasks[0].bury();
            }
            self.drop_unnoticed();
        }
        self.tidy_turns();
    }

    /// Lets the nodes take turns in the order of `named`, which is the order of the members in the state that was packed
    /// last.
    pub fn reorder(&mut self, named: &[usize]) {
        self.order.clear();
        self.order.extend(named);
    }
}

/// A flag beside a node's least round: the node's turn is not over.
const OPEN: u8 = 0x80;
/// A flag beside a node's least round: the node's timer is late.
const OWED: u8 = 0x40;

/// The form in which a state is packed.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Form<'a> {
    /// The same form for all states that the reductions treat as equal.
    Canonical,
    /// As `Canonical`, but the marks of the reduction by turns are left unchanged. For tests.
    Plain,
    /// As `Canonical`, but the members are packed in this order. For tests of the symmetry reduction.
    Named(&'a [usize]),
}

/// A pass over the fields of a new node, which moves its rounds to the round from which this world counts.
pub(super) struct FromBase(pub Round);

impl Walk for FromBase {
    const PASS: Pass = Pass::Change;

    fn round(&mut self, _: PortId, round: &mut Round) {
        *round = round.plus(self.0.0);
    }
}

/// Packs a node: its length, its least round with two flags, whether it is up, its incarnations, and its task.
fn store_node_state(place: &mut NodeState, frame: &Frame<'_>, out: &mut Vec<u8>) -> Result<(), Overflow> {
    let mut least = Least(vec![None; frame.rounds.len()]);
    let task = &mut place.node.parts_mut().tasks[0];
    if place.up {
        task.walk(&place.table, &mut least);
    }
    // A node that is down has no task. The task in `place` is left over from a state that was loaded before.
    let low = least.0.first().copied().flatten().map_or(0, |round| round.steps_from(frame.rounds[0]));
    out.extend([0, u8::try_from(low).ok().filter(|low| low & (OPEN | OWED) == 0).ok_or(Overflow)?]);
    Encode::append(out, frame, |w| walk_node_state(place, w))?;
    out[0] = u8::try_from(out.len()).map_err(|_| Overflow)?;
    Ok(())
}

fn load_node_state(place: &mut NodeState, block: &[u8], incarnations: bool, clock: u64) {
    Decode::read(&block[2..], incarnations, |r| walk_node_state(place, r));
    if place.up && clock != 0 {
        place.node.parts_mut().tasks[0].set_ahead(&place.table, Ticks(clock));
    }
}

fn walk_node_state<W: Walk>(place: &mut NodeState, w: &mut W) {
    if w.incarnations() {
        place.walk_incarnations(w);
    }
    if place.up {
        place.node.parts_mut().tasks[0].walk(&place.table, w);
    }
}
