//! A communication task behind its lock, with its clock, its recorder and its observations.

use crate::alarm::Alarm;
use crate::clock::{FAR, Micros};
use crate::effects::{Effect, Effects, Stamped};
use crate::failstop::FailStop;
use crate::handoff::{Rest, Station};
use crate::record::{Digesting, OutputDigest, Recorder, Step, run};
use crate::ring::Ring;
use imrs_protocol::{
    CommTask, Delivery, Event, Input, NodeTable, Observation, Outbox, Packet, Reason, Signal, TaskId,
    TaskView, Ticks, TimeId,
};
use std::sync::Arc;

/// After so long (19 hours) the machine's own clock is put back to zero, long before anything could wrap.
const REBASE_AFTER: Micros = 1 << 36;

pub(crate) struct Comm {
    machine: CommTask,
    table: NodeTable,
    alarm: Arc<Alarm>,
    /// The position of this communication task among those of the node.
    slot: usize,
    /// When the machine last advanced.
    last: Micros,
    rebased: Micros,
    /// Until when the sleeping task's thread looks after this machine's time.
    covered: Micros,
    recorder: Option<Arc<dyn Recorder>>,
    digest: OutputDigest,
    ring: Ring,
    discards: [u64; Reason::ALL.len()],
}

impl Comm {
    pub fn new(
        machine: CommTask,
        table: NodeTable,
        slot: usize,
        alarm: Arc<Alarm>,
        recorder: Option<Arc<dyn Recorder>>,
        now: Micros,
    ) -> Self {
        Self {
            machine,
            table,
            alarm,
            slot,
            last: now,
            rebased: now,
            covered: 0,
            recorder,
            digest: OutputDigest::START,
            ring: Ring::new(),
            discards: [0; Reason::ALL.len()],
        }
    }

    /// The machine's state, and when it was so.
    pub fn view(&self, queue_limit: usize) -> (TaskView, Micros) {
        (self.machine.view(&self.table, queue_limit), self.last)
    }

    pub fn discards(&self) -> &[u64; Reason::ALL.len()] {
        &self.discards
    }

    pub fn ring(&mut self) -> &mut Ring {
        &mut self.ring
    }

    /// A message whose life ended between the machine and its task: the last place where it can (§5.1.1).
    pub fn expired_in_hand(&mut self, message: &Delivery) {
        self.discards[Reason::Expired as usize] += 1;
        self.ring.push(
            self.last,
            Observation {
                event: Event::Discarded(Reason::Expired),
                port: message.from.port,
                peer: message.from.source,
                number: message.from.id.sequence.get(),
                remaining: Ticks::ZERO,
            },
        );
    }

    /// When the machine next does something by itself.
    fn due(&self) -> Micros {
        self.machine.next_expiry().map_or(FAR, |left| self.last.saturating_add(left.0))
    }

    fn rebase_in_time(&mut self) {
        if self.last - self.rebased > REBASE_AFTER {
            self.machine.rebase();
            self.rebased = self.last;
        }
    }
}

/// An answer on its way to the task.
#[derive(Clone, Copy, Debug)]
pub struct Mail {
    /// The answer.
    pub signal: Signal,
    /// When the machine gave it.
    pub at: Micros,
}

impl Station for Comm {
    type Input = Stamped;
    type Mail = Mail;
    type Effects = Effects;

    fn feed(&mut self, stamped: Stamped, effects: &mut Effects) -> Option<Mail> {
        let _guard = FailStop::of("a communication task");
        let late = self.last.saturating_sub(stamped.at);
        let elapsed = Ticks(stamped.at.saturating_sub(self.last));
        self.last += elapsed.0;
        let mut input = stamped.input;
        if let Input::Packet(packet) = &mut input {
            // Another thread was faster: what the packet waited for this one is taken from its life, too.
            packet.remaining = packet.remaining - Ticks(late);
        }
        let step = Step { elapsed, input };
        if let Some(recorder) = &self.recorder {
            if recorder.wants_keyframe(self.machine.task()) {
                recorder.keyframe(&self.machine, self.digest);
            }
            recorder.input(self.machine.task(), step);
        }
        let mut mail = None;
        let mut out = Out {
            at: self.last,
            task: self.machine.task(),
            effects,
            mail: &mut mail,
            ring: &mut self.ring,
            discards: &mut self.discards,
        };
        let digest = self.recorder.is_some().then_some(&mut self.digest);
        run(&mut self.machine, &self.table, step, &mut Digesting { digest, out: &mut out });
        if let Some(recorder) = &self.recorder {
            recorder.output(self.machine.task(), self.digest);
        }
        self.rebase_in_time();
        mail
    }

    fn settle(&mut self, rest: Rest, _effects: &mut Effects) -> Micros {
        let due = self.due();
        match rest {
            Rest::No => self.covered = 0,
            Rest::Begins => self.covered = due,
            Rest::GoesOn => {}
        }
        // Whoever sleeps until then looks after it: the Timer thread serves only expiries that nobody waits for.
        self.alarm.publish(self.slot, if due >= self.covered && self.covered != 0 { FAR } else { due });
        due
    }
}

/// The outbox of one input.
struct Out<'a> {
    at: Micros,
    task: TaskId,
    effects: &'a mut Effects,
    mail: &'a mut Option<Mail>,
    ring: &'a mut Ring,
    discards: &'a mut [u64; Reason::ALL.len()],
}

impl Outbox for Out<'_> {
    fn transmit(&mut self, packet: Packet) {
        self.effects.queue.push_back(Effect::Transmit(self.at, packet));
    }

    fn signal(&mut self, signal: Signal) {
        *self.mail = Some(Mail { signal, at: self.at });
    }

    fn arm(&mut self, id: TimeId, turn: u8, length: Ticks) {
        self.effects.queue.push_back(Effect::Arm(self.at, self.task, id, turn, length));
    }

    fn disarm(&mut self, id: TimeId) {
        self.effects.queue.push_back(Effect::Disarm(self.at, self.task, id));
    }

    fn observe(&mut self, observation: Observation) {
        if let Event::Discarded(reason) = observation.event {
            self.discards[reason as usize] += 1;
        }
        self.ring.push(self.at, observation);
    }
}
