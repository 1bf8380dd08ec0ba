//! Floors back from packed bytes: see [`canon`](super::canon).

use super::body::{Body, Does, Level};
use super::judge::Name;
use super::plan::{Faults, FloorWatch};
use super::script::Running;
use super::{Crossing, Floor};
use crate::state::Packed;
use imrs_protocol::{Frame, Incarnation, MessageId, Packet, PortId, ReplyTo, Seq24, TaskId, Ticks};

/// Reads bytes.
struct Eye<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Eye<'a> {
    fn byte(&mut self) -> u8 {
        let byte = self.bytes.get(self.at).copied().unwrap_or(0);
        self.at += 1;
        byte
    }

    fn number(&mut self) -> u32 {
        match self.byte() {
            u8::MAX => u32::from_le_bytes([self.byte(), self.byte(), self.byte(), self.byte()]),
            short => u32::from(short),
        }
    }

    fn rest(&self) -> &'a [u8] {
        self.bytes.get(self.at..).unwrap_or(&[])
    }

    fn sequence(&mut self) -> Seq24 {
        Frame::SEQUENCE.plus(Seq24::MODULUS - u32::from(self.byte()))
    }

    fn name(&mut self) -> Name {
        let source = TaskId(u16::from(self.byte()));
        Name { source, number: self.sequence() }
    }
}

impl Floor {
    /// Reads a state.
    pub fn load(&mut self, state: &Packed) {
        self.violation = state.violation();
        self.load_bytes(&state.0);
    }

    /// Reads the bytes of a state without a violation.
    pub fn load_bytes(&mut self, bytes: &[u8]) {
        let mut eye = Eye { bytes, at: 1 };
        // A run that ended in a violation may have left some.
        self.inputs.clear();
        self.rounds.fill(Frame::ROUND);
        self.sequences.fill(Frame::SEQUENCE);
        let had = self.plan.faults;
        let mut left = |had: u8| if had > 0 { eye.byte() } else { 0 };
        self.faults = Faults {
            loss: left(had.loss),
            dup: left(had.dup),
            crash: left(had.crash),
            drift: left(had.drift),
            late: left(had.late),
            over: left(had.over),
        };
        if self.plan.room.is_some() {
            self.used.iter_mut().for_each(|used| *used = eye.byte());
        }
        if self.counts_behind() {
            self.behind.iter_mut().for_each(|behind| *behind = eye.byte());
        }
        for i in 0..self.stations.len() {
            if !self.plan.leaves_out(i) {
                self.load_station(i, &mut eye);
            }
        }
        for i in 0..self.bodies.len() {
            if self.leaves_out(i) {
                continue;
            }
            let body = &mut self.bodies[i];
            let named = self.turns.is_some();
            load_body(body, (self.plan.waits().is_some(), self.plan.lives(), named), &mut eye);
        }
        self.load_ghosts(&mut eye);
        self.crossings.clear();
        while eye.at < eye.bytes.len() {
            let (link, age) = (eye.byte(), eye.number());
            let life = Incarnation(if self.plan.lives() { eye.byte() } else { 0 });
            let (packet, len) = Packet::load(eye.rest(), self.plan.lives());
            eye.at += len;
            self.crossings.push(Crossing { packet, link, age, life });
        }
    }

    fn load_station(&mut self, i: usize, eye: &mut Eye<'_>) {
        let lives = self.plan.lives();
        let station = &mut self.stations[i];
        if lives {
            station.up = eye.byte() == 1;
            station.life = Incarnation(eye.byte());
            station.known.iter_mut().for_each(|known| *known = Incarnation(eye.byte()));
        }
        station.owed = if self.plan.faults.late > 0 { eye.byte() } else { 0 };
        if !station.up {
            return;
        }
        let ahead = Ticks(self.plan.clocks[i]);
        let parts = station.node.parts_mut();
        for task in &mut parts.tasks {
            eye.at += task.load(&station.table, lives, eye.rest());
            if !ahead.is_zero() {
                task.set_ahead(ahead);
            }
        }
        eye.at += parts.transit.load(&station.table, lives, eye.rest());
        eye.at += parts.timer.load(eye.rest());
        if !self.plan.fused {
            eye.at += station.node.load_work(lives, eye.rest());
        }
    }

    fn load_ghosts(&mut self, eye: &mut Eye<'_>) {
        let plan = &self.plan;
        let ghosts = &mut self.ghosts;
        ghosts.lives.clear();
        if plan.times_messages().is_some() {
            for _ in 0..eye.byte() {
                ghosts.lives.push((eye.name(), eye.byte()));
            }
        }
        ghosts.handed.fill(0);
        ghosts.denied.fill(0);
        if plan.watches(FloorWatch::DidNotRun) {
            let masks = ghosts.handed.iter_mut().chain(&mut ghosts.denied);
            masks.for_each(|mask| *mask = u16::from_le_bytes([eye.byte(), eye.byte()]));
        }
        if plan.watches(FloorWatch::AtMostOnce) {
            ghosts.handed.iter_mut().for_each(|mask| *mask = u16::from_le_bytes([eye.byte(), eye.byte()]));
        }
        if plan.fair().is_some() {
            ghosts.bypassed.iter_mut().for_each(|count| *count = eye.byte());
        }
        ghosts.refused.clear();
        if plan.counts_refusals() {
            for _ in 0..eye.byte() {
                let (task, port) = (TaskId(u16::from(eye.byte())), PortId(u16::from(eye.byte())));
                let count = eye.byte();
                ghosts.refused.push((task, port, eye.name(), count));
            }
        }
        ghosts.signals.fill(0);
        if plan.zeno().is_some() {
            ghosts.signals.iter_mut().for_each(|count| *count = eye.byte());
        }
        ghosts.told.flags_mut().for_each(|flag| *flag = eye.byte() == 1);
        ghosts.begun = if plan.watches(FloorWatch::OneActive) { eye.byte() } else { 0 };
        ghosts.heard = if plan.lives() && plan.watches(FloorWatch::OneActive) { eye.byte() } else { 0 };
        ghosts.ordered = if plan.watches(FloorWatch::FencedOrders) { eye.byte() } else { 0 };
    }
}

fn load_body(body: &mut Body, (waits, lives, named): (bool, bool, bool), eye: &mut Eye<'_>) {
    if let Some(actor) = &mut body.actor {
        eye.at += actor.script.load(&actor.program, lives, eye.rest());
        actor.running.clear();
        for _ in 0..eye.byte() {
            let level = eye.byte();
            let action = if named { u16::from(eye.byte()) } else { 0 };
            actor.running.push(Running { level, action, least: eye.number(), most: eye.number() });
        }
    } else {
        (body.times, body.rest) = (eye.byte(), eye.byte());
    }
    body.levels.clear();
    loop {
        let flags = eye.byte();
        let does = [Does::Free, Does::Waits, Does::Serves, Does::Works][usize::from(flags & 3)];
        let mut level = Level { does, nested: flags & 8 != 0, get: flags & 16 != 0, ..Level::default() };
        if flags & 32 != 0 {
            level.port = Some(PortId(u16::from(eye.byte())));
        }
        if flags & 4 != 0 {
            let (source, port) = (TaskId(u16::from(eye.byte())), PortId(u16::from(eye.byte())));
            let incarnation = Incarnation(if lives { eye.byte() } else { 0 });
            let id = MessageId { incarnation, sequence: eye.sequence() };
            level.to = Some(ReplyTo { port, source, id });
        }
        if matches!(does, Does::Serves | Does::Works) {
            level.age = eye.byte();
        }
        if waits {
            if does == Does::Waits {
                (level.left, level.question) = (eye.byte(), eye.byte());
            }
            if does == Does::Serves || level.to.is_some() {
                level.echo = eye.byte();
            }
        }
        if !body.levels.is_empty() {
            level.rank = eye.byte();
        }
        body.levels.push(level);
        if flags & 0x80 != 0 || body.levels.len() > 16 {
            return;
        }
    }
}
