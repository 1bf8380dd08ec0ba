//! Floors as packed bytes and back (D51): one block, everything relative, in one order.

use super::Floor;
use super::body::Does;
use super::judge::Name;
use super::plan::FloorWatch;
use crate::state::{Packed, Violation};
use imrs_protocol::{Coming, Frame, Kind, Overflow, Packet, PortId, Round, Seq24, TaskId, Ticks, Visit};

/// Room for one part of a state while it is written.
const PART: usize = 512;

fn byte(number: impl TryInto<u8>) -> Result<u8, Overflow> {
    number.try_into().map_err(|_| Overflow)
}

/// A length of time: short ones in one byte.
pub(crate) fn number(length: u32, out: &mut Vec<u8>) {
    match u8::try_from(length) {
        Ok(short) if short < u8::MAX => out.push(short),
        _ => {
            out.push(u8::MAX);
            out.extend(length.to_le_bytes());
        }
    }
}

/// The numbers that a state is written relative to.
struct Bases {
    rounds: Vec<Round>,
    /// For each port, whether anybody has a round there.
    used: Vec<bool>,
    sequences: Vec<Seq24>,
    lives: bool,
}

impl Bases {
    fn frame(&self) -> Frame<'_> {
        Frame { rounds: &self.rounds, sequences: &self.sequences, lives: self.lives }
    }

    fn back(&self, source: TaskId, sequence: Seq24) -> Result<u8, Overflow> {
        let next = self.sequences.get(source.index()).copied().unwrap_or_default();
        byte(next.steps_from(sequence))
    }

    fn name(&self, name: &Name, out: &mut Vec<u8>) -> Result<(), Overflow> {
        out.extend([byte(name.source.0)?, self.back(name.source, name.number)?]);
        Ok(())
    }
}

impl Floor {
    /// Writes the state, canonical.
    pub fn store(&mut self) -> Packed {
        match self.try_store() {
            Ok(bytes) => Packed(bytes.into_boxed_slice()),
            // A distance outgrew its field: an absorbing, visible failure, never a saturated value.
            Err(Overflow) => Packed(Box::new([Violation::Overflow.code(), 0, 0, 0, 0])),
        }
    }

    fn try_store(&mut self) -> Result<Vec<u8>, Overflow> {
        if let Some(violation) = self.violation {
            return Ok(vec![violation.code(), 0, 0, 0, 0]);
        }
        for station in self.stations.iter_mut().filter(|s| s.up) {
            station.node.parts_mut().tasks.iter_mut().for_each(imrs_protocol::CommTask::bury);
        }
        if !self.plan.keeps_seen {
            let coming = self.coming();
            for station in self.stations.iter_mut().filter(|s| s.up) {
                station.node.parts_mut().tasks.iter_mut().for_each(|task| task.bury_seen(&coming));
            }
        }
        let bases = self.bases();
        let mut out = Vec::with_capacity(128);
        out.push(0);
        let (had, left) = (self.plan.faults, self.faults);
        for (had, left) in [
            (had.loss, left.loss),
            (had.dup, left.dup),
            (had.crash, left.crash),
            (had.drift, left.drift),
            (had.late, left.late),
            (had.over, left.over),
        ] {
            if had > 0 {
                out.push(left);
            }
        }
        if self.plan.room.is_some() {
            out.extend(&self.used);
        }
        if self.counts_behind() {
            for (port, &behind) in self.behind.iter().enumerate() {
                let moved = bases.rounds[port].steps_from(self.rounds[port]).cast_signed();
                let from_first = i32::from(behind) + i32::from(moved);
                // Behind nobody is nothing.
                let from_first = if bases.used[port] { from_first } else { 0 };
                out.push(byte(from_first.clamp(0, i32::from(super::FAR_BEHIND)))?);
            }
        }
        for i in (0..self.stations.len()).filter(|&i| !self.plan.leaves_out(i)) {
            self.store_station(i, &bases, &mut out)?;
        }
        for i in (0..self.bodies.len()).filter(|&i| !self.leaves_out(i)) {
            self.store_body(i, &bases, &mut out)?;
        }
        self.store_ghosts(&bases, &mut out)?;
        self.store_crossings(&bases, &mut out)?;
        Ok(out)
    }

    fn store_station(&self, i: usize, bases: &Bases, out: &mut Vec<u8>) -> Result<(), Overflow> {
        let station = &self.stations[i];
        if bases.lives {
            out.extend([u8::from(station.up), station.life.0]);
            out.extend(station.known.iter().map(|life| life.0));
        }
        if self.plan.faults.late > 0 {
            out.push(station.owed);
        }
        if !station.up {
            return Ok(());
        }
        let parts = station.node.parts();
        for task in &parts.tasks {
            put(out, |room| task.store(&station.table, &bases.frame(), room))?;
        }
        put(out, |room| parts.transit.store(&bases.frame(), room))?;
        put(out, |room| parts.timer.store(room))?;
        if !self.plan.fused {
            put(out, |room| station.node.store_work(&bases.frame(), room))?;
        }
        Ok(())
    }

    fn store_body(&self, i: usize, bases: &Bases, out: &mut Vec<u8>) -> Result<(), Overflow> {
        let body = &self.bodies[i];
        let top = byte(body.levels.len() - 1)?;
        if top > 15 {
            return Err(Overflow);
        }
        if let Some(actor) = &body.actor {
            put(out, |room| actor.script.store(&actor.program, &bases.frame(), room))?;
            out.push(byte(actor.running.len())?);
            for action in &actor.running {
                out.push(action.level);
                if self.turns.is_some() {
                    out.push(byte(action.action)?);
                }
                number(action.least, out);
                number(action.most, out);
            }
        } else {
            out.extend([body.times, body.rest]);
        }
        for (depth, level) in body.levels.iter().enumerate() {
            let last = if depth + 1 == body.levels.len() { 0x80 } else { 0 };
            let does = level.does as u8;
            let flags = (u8::from(level.to.is_some()) << 2)
                | (u8::from(level.nested) << 3)
                | (u8::from(level.get) << 4)
                | (u8::from(level.port.is_some()) << 5)
                | last;
            out.push(does | flags);
            if let Some(port) = level.port {
                out.push(byte(port.0)?);
            }
            if let Some(to) = level.to {
                out.extend([byte(to.source.0)?, byte(to.port.0)?]);
                if bases.lives {
                    out.push(to.id.incarnation.0);
                }
                out.push(bases.back(to.source, to.id.sequence)?);
            }
            if matches!(level.does, Does::Serves | Does::Works) {
                out.push(level.age);
            }
            if self.plan.waits().is_some() {
                if level.does == Does::Waits {
                    out.extend([level.left, level.question]);
                }
                if level.does == Does::Serves || level.to.is_some() {
                    out.push(level.echo);
                }
            }
            if depth > 0 {
                out.push(level.rank);
            }
        }
        Ok(())
    }

    fn store_ghosts(&mut self, bases: &Bases, out: &mut Vec<u8>) -> Result<(), Overflow> {
        let plan = &self.plan;
        let ghosts = &mut self.ghosts;
        if plan.times_messages().is_some() {
            ghosts.lives.sort_unstable_by_key(|(name, left)| (name.source, *left, name.number.get()));
            out.push(byte(ghosts.lives.len())?);
            for (name, left) in &ghosts.lives {
                bases.name(name, out)?;
                out.push(*left);
            }
        }
        if plan.watches(FloorWatch::AtMostOnce) {
            ghosts.handed.iter().for_each(|mask| out.extend(mask.to_le_bytes()));
        }
        if plan.watches(FloorWatch::DidNotRun) {
            let masks = ghosts.handed.iter().chain(&ghosts.denied);
            masks.for_each(|mask| out.extend(mask.to_le_bytes()));
        }
        if plan.fair().is_some() {
            out.extend(&ghosts.bypassed);
        }
        if plan.counts_refusals() {
            ghosts.refused.sort_unstable_by_key(|(task, port, name, _)| {
                (*task, *port, name.source, bases.back(name.source, name.number).unwrap_or(0))
            });
            out.push(byte(ghosts.refused.len())?);
            for (task, port, name, count) in &ghosts.refused {
                out.extend([byte(task.0)?, byte(port.0)?, *count]);
                bases.name(name, out)?;
            }
        }
        if plan.zeno().is_some() {
            out.extend(&ghosts.signals);
        }
        out.extend(ghosts.told.flags().map(u8::from));
        if plan.watches(FloorWatch::OneActive) {
            out.push(ghosts.begun);
            if bases.lives {
                out.push(ghosts.heard);
            }
        }
        if plan.watches(FloorWatch::FencedOrders) {
            out.push(ghosts.ordered);
        }
        Ok(())
    }

    fn store_crossings(&self, bases: &Bases, out: &mut Vec<u8>) -> Result<(), Overflow> {
        let mut packed: Vec<(u8, Vec<u8>)> = Vec::with_capacity(self.crossings.len());
        for crossing in &self.crossings {
            let mut bytes = Vec::with_capacity(12);
            bytes.push(crossing.link);
            number(crossing.age, &mut bytes);
            if bases.lives {
                bytes.push(crossing.life.0);
            }
            put(&mut bytes, |room| crossing.packet.store(&bases.frame(), room))?;
            packed.push((crossing.link, bytes));
        }
        match self.plan.way {
            super::plan::Way::Any => packed.sort_unstable(),
            // The order in which packets left is the order in which they come.
            super::plan::Way::Exact => packed.sort_by_key(|(link, _)| *link),
        }
        packed.iter().for_each(|(_, bytes)| out.extend(bytes));
        Ok(())
    }

    /// All messages that may still come to a task.
    fn coming(&self) -> Vec<Coming> {
        let up = || self.stations.iter().filter(|s| s.up).map(|station| &station.node);
        let waiting = up().flat_map(|node| node.parts().transit.waiting());
        let packets = self.crossings.iter().map(|crossing| crossing.packet).chain(waiting);
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

    /// The least round in use of each port, and the next sequence of each task.
    fn bases(&self) -> Bases {
        let sequences = (0..self.bodies.len()).map(|task| self.next_sequence(task)).collect();
        let lives = self.plan.lives();
        // A cell's checker says itself how far behind a new life is.
        if lives && self.turns.is_none() {
            // A restarted node counts from its own beginning: only absolute rounds say how it relates to the others.
            let used = vec![true; self.rounds.len()];
            return Bases { rounds: self.rounds.clone(), used, sequences, lives };
        }
        let mut least = Least(vec![None; self.rounds.len()]);
        for station in self.stations.iter().filter(|s| s.up) {
            let parts = station.node.parts();
            parts.tasks.iter().for_each(|task| task.visit(&mut least));
            parts.transit.waiting().iter().for_each(|packet| least.packet(packet));
            station.node.work_packets().for_each(|packet| least.packet(packet));
        }
        self.crossings.iter().for_each(|crossing| least.packet(&crossing.packet));
        let used = least.0.iter().map(Option::is_some).collect();
        let rounds = least.0.iter().zip(&self.rounds).map(|(least, old)| least.unwrap_or(*old)).collect();
        Bases { rounds, used, sequences, lives }
    }
}

/// Appends what `write` writes.
fn put(out: &mut Vec<u8>, write: impl FnOnce(&mut [u8]) -> Result<usize, Overflow>) -> Result<(), Overflow> {
    let start = out.len();
    out.resize(start + PART, 0);
    let len = write(&mut out[start..])?;
    out.truncate(start + len);
    Ok(())
}

struct Least(Vec<Option<Round>>);

impl Least {
    fn packet(&mut self, packet: &Packet) {
        if packet.is_of_meeting() {
            let meeting = packet.meeting();
            self.round(packet.port, meeting.round);
            self.round(packet.port, meeting.released);
        }
    }
}

impl Visit for Least {
    fn instant(&mut self, _: Ticks) {}
    fn round(&mut self, port: PortId, round: Round) {
        let slot = &mut self.0[port.index()];
        *slot = Some(slot.map_or(round, |least| if least.is_newer_than(round) { round } else { least }));
    }
    fn sequence(&mut self, _: TaskId, _: Seq24) {}
}
