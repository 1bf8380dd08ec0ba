//! Packs worlds into their canonical bytes and unpacks them (D51).

use super::{Place, World};
use crate::floor::canon::Least;
use crate::ghost::{self, Ghost};
use crate::network::{Codec, Flight};
use crate::scenario::Scenario;
use crate::state::{HEADER, Packed, Violation};
use crate::symmetry;
use imrs_protocol::{
    Decode, Encode, Frame, Kind, Overflow, Pass, PortId, Round, Seq24, TaskId, TaskState, Ticks, Walk, mark,
};

impl World {
    /// Unpacks a state. With `touch`, only that node is unpacked, and only steps of that node may follow.
    pub fn load(&mut self, state: &Packed, touch: Option<usize>) {
        let bytes = &state.0;
        self.violation = state.violation();
        (self.loss, self.dup, self.crash) = (bytes[1], bytes[2], bytes[3]);
        (self.healed, self.done) = (bytes[4] & 1 != 0, bytes[4] & 2 != 0);
        self.late = bytes[4] >> 4;
        self.steps = u16::from_le_bytes([bytes[5], bytes[6]]);
        let mut at = HEADER;
        for ghost in &mut self.ghosts {
            at += ghost::load(ghost, self.scenario.watch, self.scenario.lives(), &bytes[at..]);
        }
        self.rounds.fill(Frame::ROUND);
        let lives = self.scenario.lives();
        for i in 0..self.places.len() {
            let len = usize::from(bytes[at]);
            let block = &bytes[at..at + len];
            (self.open[i], self.owed[i]) = (block[1] & OPEN != 0, block[1] & OWED != 0);
            self.loaded[i] = touch.is_none_or(|touched| touched == i);
            if self.loaded[i] {
                load_place(&mut self.places[i], block, lives, self.scenario.clocks[i]);
            } else {
                self.blocks[i].clear();
                self.blocks[i].extend_from_slice(block);
            }
            at += len;
        }
        self.flights.clear();
        while at < bytes.len() {
            let (mut flight, len) = self.codec.decode(&bytes[at..]);
            if flight.packet.source == flight.packet.destination {
                // Packed without its sender, see `anonymous`: any other member will do.
                let other = (flight.packet.destination.index() + 1) % self.places.len();
                flight.packet.source = TaskId::from_index(other);
            }
            self.flights.push(flight);
            at += len;
        }
    }

    /// The destination of the packet at position `i` of a packed state. Unpacks no node.
    pub fn destination(scenario: &Scenario, state: &Packed, i: u8) -> Option<usize> {
        let bytes = &state.0;
        let mut at = HEADER;
        let mut ghost = Ghost::default();
        for _ in 0..scenario.tasks() {
            at += ghost::load(&mut ghost, scenario.watch, scenario.lives(), &bytes[at..]);
        }
        for _ in 0..scenario.tasks() {
            at += usize::from(*bytes.get(at)?);
        }
        let codec = Codec::new(scenario);
        for _ in 0..i {
            at += codec.decode(bytes.get(at..)?).1;
        }
        let (flight, _) = codec.decode(bytes.get(at..)?);
        Some(flight.packet.destination.index())
    }

    /// Packs the state in its canonical form.
    pub fn store(&mut self) -> Packed {
        self.store_as(Form::Canonical)
    }

    /// Packs the state with its turns as they are, for tests.
    pub fn store_plain(&mut self) -> Packed {
        self.store_as(Form::Plain)
    }

    /// Packs the state in this form.
    pub fn store_as(&mut self, form: Form<'_>) -> Packed {
        match self.try_store(form) {
            Ok(packed) => packed,
            // A relative number outgrew its field: an absorbing, visible failure, never a saturated value.
            Err(Overflow) => Packed(Box::new([Violation::Overflow.code(), 0, 0, 0, 0])),
        }
    }

    fn try_store(&mut self, form: Form<'_>) -> Result<Packed, Overflow> {
        if let Some(violation) = self.violation {
            // An absorbing state has no successors, so nothing else need be distinguished.
            return Ok(Packed(Box::new([violation.code(), 0, 0, 0, 0])));
        }
        if self.done {
            return Ok(Packed(Box::new([0, 0, 0, 0, 2])));
        }
        for (place, loaded) in self.places.iter_mut().zip(&self.loaded) {
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
        let frame = Frame { rounds: &rounds, sequences: &sequences, lives: self.scenario.lives() };
        for i in 0..self.n() {
            if self.loaded[i] {
                self.blocks[i].clear();
                store_place(&mut self.places[i], &frame, &mut self.blocks[i])?;
            }
            let marks = mark(self.open[i], OPEN) | mark(self.owed[i], OWED);
            self.blocks[i][1] = (self.blocks[i][1] & !(OPEN | OWED)) | marks;
        }
        let flags = u8::from(self.healed) | (self.late << 4);
        let [low, high] = self.steps.to_le_bytes();
        let header = [0, self.loss, self.dup, self.crash, flags, low, high];
        let least = self.ghosts.iter().map(|g| g.releases).min().unwrap_or(0);
        let mut ghosts = Vec::with_capacity(self.n());
        for (i, ghost) in self.ghosts.iter().enumerate() {
            let mut bytes = Vec::with_capacity(4);
            let task = TaskId::from_index(i);
            ghost::store(ghost, self.scenario.watch, &frame, u32::from(moved), task, least, &mut bytes)?;
            ghosts.push(bytes);
        }
        let reduces = self.scenario.reductions.ignores && !self.scenario.lives();
        // A CONFIRM releases a member waiting in its round, whoever sent it: the receiver is packed as its sender.
        let anonymous = |flight: &Flight| {
            let mut flight = *flight;
            if reduces && self.releases(&flight) {
                flight.packet.source = flight.packet.destination;
            }
            flight
        };
        let flights: Vec<Flight> = self.flights.iter().map(anonymous).collect();
        let parts = symmetry::Parts {
            header,
            ghosts: &ghosts,
            blocks: &self.blocks,
            flights: &flights,
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

    /// Unpacks the nodes that are still packed, because the numbers that they are relative to have moved.
    fn load_rest(&mut self) {
        for i in 0..self.n() {
            if !self.loaded[i] {
                load_place(
                    &mut self.places[i],
                    &self.blocks[i],
                    self.scenario.lives(),
                    self.scenario.clocks[i],
                );
                self.loaded[i] = true;
            }
        }
    }

    /// Whether no running node can crash any more: its next incarnation would notice what the present one ignores.
    fn is_settled(&self) -> bool {
        !self.scenario.lives() || self.crash == 0
    }

    /// Whether both nodes are up and `i` knows the present incarnation of `of`: no envelope from `of` is news.
    fn knows(&self, i: usize, of: usize) -> bool {
        let up = self.places[i].up && self.places[of].up;
        !self.scenario.lives() || (up && self.places[i].known[of] == self.places[of].life)
    }

    /// Whether the tasks at the ends of a packet have heard each other in their present incarnations.
    fn acquainted(&self, flight: &Flight) -> bool {
        let (from, to) = (flight.packet.source, flight.packet.destination);
        let heard = |at: TaskId, of: TaskId| {
            let life = self.task(at.index()).heard_in(&self.places[at.index()].table, flight.packet.port, of);
            life == Some(self.places[of.index()].life)
        };
        !self.scenario.lives() || (self.knows(from.index(), to.index()) && heard(from, to) && heard(to, from))
    }

    /// Drops CONFIRMs still to be sent that every member would ignore, then packets in flight that nobody can notice.
    /// The order matters, because a member that still owes a CONFIRM notices arrivals.
    fn drop_unnoticed(&mut self) {
        let port = PortId(0);
        for i in 0..self.n() {
            if let Some(round) = self.task(i).owes(port)
                && (0..self.n()).all(|other| {
                    other == i || (self.knows(other, i) && self.task(other).is_over(port, round))
                })
            {
                let task = &mut self.places[i].node.parts_mut().tasks[0];
                task.settle(port);
                task.bury();
            }
        }
        let mut flights = std::mem::take(&mut self.flights);
        flights.retain(|flight| !self.is_unnoticed(flight));
        self.flights = flights;
        if !self.scenario.lives() {
            self.drop_more_confirms();
        }
    }

    fn is_unnoticed(&self, flight: &Flight) -> bool {
        let packet = &flight.packet;
        let (from, to) = (packet.source.index(), packet.destination.index());
        let known = self.places[to].known[from];
        if self.scenario.lives() && self.places[to].up && flight.life != known {
            return flight.life.0 < known.0;
        }
        // A member that has left a round ignores CONFIRMs of it, even if it still owes one itself.
        let confirmed =
            packet.kind == Kind::Confirm && self.task(to).is_over(packet.port, packet.meeting().round);
        let ignores = || self.task(to).ignores(&self.places[to].table, packet, self.task(from));
        self.places[to].up && (confirmed || (self.acquainted(flight) && ignores()))
    }

    /// A member that waits in a round is released by the first CONFIRM of it and ignores the others. So only the
    /// oldest of those in flight to a member are kept: one more than can still be lost.
    fn drop_more_confirms(&mut self) {
        let enough = usize::from(self.loss) + 1;
        let releases: Vec<bool> = self.flights.iter().map(|flight| self.releases(flight)).collect();
        if releases.iter().filter(|&&releases| releases).count() <= enough {
            return;
        }
        let key = |at: usize, flight: &Flight| (std::cmp::Reverse(flight.age), flight.fresh, at);
        let older = |at: usize, flight: &Flight| {
            let others = self.flights.iter().enumerate().filter(|&(other, _)| releases[other]);
            let here = others.filter(|(_, other)| other.packet.destination == flight.packet.destination);
            here.filter(|&(other, of)| key(other, of) < key(at, flight)).count()
        };
        let kept = self.flights.iter().enumerate();
        let kept = kept.filter(|&(at, flight)| !releases[at] || older(at, flight) < enough);
        self.flights = kept.map(|(_, flight)| *flight).collect();
    }

    /// Whether a packet is a CONFIRM that would release its receiver now.
    fn releases(&self, flight: &Flight) -> bool {
        let packet = &flight.packet;
        let to = packet.destination.index();
        packet.kind == Kind::Confirm
            && match self.task(to).state() {
                TaskState::Waiting { round, .. } => round == packet.meeting().round,
                _ => false,
            }
    }

    /// For each port the least round in use, and for each task the next sequence.
    fn bases(&mut self) -> (Vec<Round>, Vec<Seq24>) {
        let sequence = |i: usize| if self.loaded[i] { self.next_sequence(i) } else { Frame::SEQUENCE };
        let sequences = (0..self.n()).map(sequence).collect();
        if self.scenario.lives() {
            // A restarted node counts rounds from the first one: only absolute rounds compare with those of others.
            return (self.rounds.clone(), sequences);
        }
        let mut least = Least(vec![None; self.rounds.len()]);
        for (i, place) in self.places.iter_mut().enumerate() {
            if self.loaded[i] {
                place.node.parts_mut().tasks[0].walk(&place.table, &mut least);
            } else if let Some(&low) = self.blocks[i].get(1) {
                least.round(PortId(0), &mut Frame::ROUND.plus(u16::from(low & !(OPEN | OWED))));
            }
        }
        self.flights.iter_mut().for_each(|flight| flight.packet.walk(&mut least));
        for ghost in &self.ghosts {
            if let Some(mut round) = ghost.last_released {
                least.round(PortId(0), &mut round);
            }
        }
        let rounds = least.0.iter().zip(&self.rounds).map(|(least, old)| least.unwrap_or(*old)).collect();
        (rounds, sequences)
    }

    /// Drops what the packed form would leave out, without packing.
    pub fn tidy(&mut self) {
        if self.scenario.reductions.ignores && self.is_settled() && self.violation.is_none() {
            for place in &mut self.places {
                place.node.parts_mut().tasks[0].bury();
            }
            self.drop_unnoticed();
        }
        self.tidy_turns();
    }

    /// Lets nodes take turns in the order `named`: that of the members in the state stored last.
    pub fn reorder(&mut self, named: &[usize]) {
        self.order.clear();
        self.order.extend(named);
    }
}

/// A bit beside a node's least round: its turn is not over.
const OPEN: u8 = 0x80;
/// Likewise: its timer is late.
const OWED: u8 = 0x40;

/// The form in which a state is packed.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Form<'a> {
    /// One form for all states that the reductions identify.
    Canonical,
    /// The same, with the turns as they are: for tests.
    Plain,
    /// With the members in this order: for tests of the symmetry reduction.
    Named(&'a [usize]),
}

/// A pass that moves the rounds of a new node to the base of this world's rounds.
pub(super) struct FromBase(pub Round);

impl Walk for FromBase {
    const PASS: Pass = Pass::Change;

    fn round(&mut self, _: PortId, round: &mut Round) {
        *round = round.plus(self.0.0);
    }
}

/// Packs a node: its length, its least round with two flags, whether it is up, its incarnations, its task.
fn store_place(place: &mut Place, frame: &Frame<'_>, out: &mut Vec<u8>) -> Result<(), Overflow> {
    let mut least = Least(vec![None; frame.rounds.len()]);
    let task = &mut place.node.parts_mut().tasks[0];
    if place.up {
        task.walk(&place.table, &mut least);
    }
    // A node that is down has no task: the one in `place` is left over from another state.
    let low = least.0.first().copied().flatten().map_or(0, |round| round.steps_from(frame.rounds[0]));
    out.extend([0, u8::try_from(low).ok().filter(|low| low & (OPEN | OWED) == 0).ok_or(Overflow)?]);
    Encode::append(out, frame, |w| walk_place(place, w))?;
    out[0] = u8::try_from(out.len()).map_err(|_| Overflow)?;
    Ok(())
}

fn load_place(place: &mut Place, block: &[u8], lives: bool, clock: u64) {
    Decode::read(&block[2..], lives, |r| walk_place(place, r));
    if place.up && clock != 0 {
        place.node.parts_mut().tasks[0].set_ahead(&place.table, Ticks(clock));
    }
}

fn walk_place<W: Walk>(place: &mut Place, w: &mut W) {
    let Place { node, table, up, life, known } = place;
    if w.lives() {
        w.flag(up);
        w.byte(&mut life.0);
        known.iter_mut().for_each(|life| w.byte(&mut life.0));
    }
    if *up {
        node.parts_mut().tasks[0].walk(table, w);
    }
}
