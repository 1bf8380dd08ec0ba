//! A communication task behind its lock, with its clock, its recorder and its observations.

use crate::clock::{self, Micros};
use crate::node::effects::{Effect, Effects, Stamped};
use crate::node::home::{Home, Homes, RunBy};
use crate::observe::ring::Ring;
use crate::record::{Digesting, Log, Logged, OutputDigest, ScriptStep};
use crate::script::{HeldLease, ScriptRunner};
use crate::sync::alarm::{Alarm, Cover};
use crate::sync::handoff::Rest;
use imrs_protocol::script::Program;
use imrs_protocol::{
    CommTask, Delivery, Event, Input, Instant, NodeTable, Observation, Outbox, Packet, PortId, QueueView,
    Reason, Signal, TaskId, TaskView, Ticks, TimeId,
};
use std::sync::Arc;

pub(crate) struct Comm {
    pub machine: CommTask,
    table: NodeTable,
    pub home: Home,
    homes: Arc<Homes>,
    /// The answer that the task's future has not taken yet.
    pub answer: Option<Completion>,
    /// Whether this task is already in its domain's list of changed tasks (a domain is the tasks that share one
    /// lock).
    pub changed: bool,
    alarm: Arc<Alarm>,
    cover: Cover,
    /// Whether the task belongs to a couple (a primary or its standby). An input of such a task takes effect
    /// when the task takes it, if that is later than the input's stamp.
    coupled: bool,
    /// The instant on the node's clock at which the state machine's own clock began.
    started: Micros,
    /// The log of the state machine's steps, if they are recorded.
    pub logged: Option<Logged>,
    pub ring: Ring,
    discards: [u64; Reason::ALL.len()],
    /// The script of the task, if it has one. It runs under the lock of its communication task.
    pub runner: Option<Box<ScriptRunner>>,
}

impl Comm {
    pub fn new(
        machine: CommTask,
        table: NodeTable,
        (home, homes): (Home, Arc<Homes>),
        alarm: Arc<Alarm>,
        log: Option<Box<dyn Log>>,
        now: Micros,
    ) -> Self {
        Self {
            coupled: machine.epoch().is_some(),
            machine,
            table,
            alarm,
            cover: Cover::new(home.place()),
            home,
            homes,
            answer: None,
            changed: false,
            started: now,
            logged: log.map(Logged::new),
            ring: Ring::new(),
            discards: [0; Reason::ALL.len()],
            runner: None,
        }
    }

    /// Gives the task its script, before the task takes any input.
    pub fn runner(&mut self, runner: ScriptRunner) {
        self.runner = Some(Box::new(runner));
    }

    /// The program of the task's script.
    pub fn program(&self) -> Option<Arc<Program>> {
        self.runner.as_ref().map(|runner| Arc::clone(runner.program()))
    }

    /// Whether the script still waits for the end of this action, so that the action has not been cut short.
    pub fn is_acting(&self, level: u8, number: u64) -> bool {
        self.runner.as_ref().is_some_and(|runner| runner.is_acting(level, number))
    }

    /// The lease under which the task acts, if there is one.
    pub fn lease(&self) -> Option<HeldLease> {
        let epoch = self.machine.epoch().filter(|_| self.machine.is_active())?;
        Some(HeldLease {
            epoch,
            until: self.machine.lease_left().map(|left| self.now().saturating_add(left.0)),
        })
    }

    /// By how much `now` is later than the state machine's own time; zero if it is not later.
    pub const fn elapsed(&self, now: Micros) -> Ticks {
        Ticks(now.saturating_sub(self.now()))
    }

    /// Whether no deadline of this task ends before or at `now`.
    pub fn is_idle_until(&mut self, now: Micros) -> bool {
        now < self.due()
    }

    /// Whether the task is one of a couple.
    pub const fn is_coupled(&self) -> bool {
        self.coupled
    }

    /// Whether the task's lease has ended by `now` although the state machine's clock has not reached that end yet.
    pub fn is_overdue(&self, now: Micros) -> bool {
        self.machine.lease_left().is_some_and(|left| self.now().saturating_add(left.0) <= now)
    }

    pub const fn machine(&self) -> &CommTask {
        &self.machine
    }

    /// The time to which the state machine has been advanced, on the node's clock.
    pub const fn now(&self) -> Micros {
        self.started + self.machine.now().0
    }

    /// Lets the state machine take one step. The machine's answers go to `answers`.
    pub fn run(
        &mut self,
        elapsed: Ticks,
        input: &Input,
        answers: &mut dyn FnMut(Signal),
        effects: &mut Effects,
    ) {
        if let Some(logged) = &mut self.logged {
            logged.begin(&self.machine);
        }
        let mut out = Out {
            at: self.now() + elapsed.0,
            task: self.machine.task(),
            home: self.home,
            homes: &self.homes,
            effects,
            answers,
            ring: &mut self.ring,
            discards: &mut self.discards,
        };
        let digest = self.logged.as_mut().map(|logged| &mut logged.digest);
        let out = &mut Digesting { digest, out: &mut out };
        self.machine.handle(&self.table, self.machine.now() + elapsed, input, out);
        if let Some(logged) = &mut self.logged {
            logged.small(elapsed, input);
        }
    }

    pub const fn table(&self) -> &NodeTable {
        &self.table
    }

    /// Whether this task's steps are recorded.
    pub const fn is_recorded(&self) -> bool {
        self.logged.is_some()
    }

    /// Whether the state machine's clock has advanced since the last recorded step.
    pub fn owes_time(&self) -> bool {
        self.logged.as_ref().is_some_and(Logged::owes_time)
    }

    /// Records a step of the task's script, and the digest of the script's earlier outputs.
    pub fn record(&mut self, step: ScriptStep, done: OutputDigest) {
        if let Some(logged) = &mut self.logged {
            logged.script(step, done);
        }
    }

    /// The state of the state machine at an instant, with up to `queue_limit` waiting messages of each port, and that
    /// instant.
    pub fn view(&self, queue_limit: impl Fn(PortId) -> usize) -> (TaskView, Micros) {
        (self.machine.view_of(&self.table, queue_limit), self.now())
    }

    /// The messages that wait at a port at an instant, and that instant.
    pub fn queue(&self, port: PortId, limit: usize) -> Option<(QueueView, Micros)> {
        Some((self.machine.queue_view(port, limit)?, self.now()))
    }

    pub fn discards(&self) -> &[u64; Reason::ALL.len()] {
        &self.discards
    }

    pub fn ring(&mut self) -> &mut Ring {
        &mut self.ring
    }

    /// Records a message that expired on its last stretch: after the state machine gave it out, and before the task's
    /// program had it (§5.1.1).
    pub fn expired_in_hand(&mut self, message: &Delivery) {
        self.discards[Reason::Expired as usize] += 1;
        self.ring.push(
            self.now(),
            Observation {
                event: Event::Discarded(Reason::Expired),
                port: message.from.port,
                peer: message.from.source,
                number: message.from.id.sequence.get(),
                remaining: Ticks::ZERO,
            },
        );
    }

    /// The instant of the state machine's next deadline.
    fn due(&mut self) -> Micros {
        self.started.saturating_add(self.machine.keep_deadline().0)
    }

    /// Publishes the state machine's next deadline for the Timer thread, unless the task's own thread watches it.
    /// Returns the deadline.
    pub fn settle(&mut self, rest: Rest) -> Micros {
        let due = self.due();
        self.cover.settle(&self.alarm, rest, due);
        due
    }

    /// As [`settle`](Self::settle), for a script or a future: no thread of its own sleeps until its deadline.
    pub fn settle_shared(&mut self) {
        let due = self.due();
        self.cover.keep(&self.alarm, self.now(), due);
    }

    /// Whether the task may take part in a fused step (one that replaces several small steps). A task of a couple may
    /// not, because a pause of the node can end its lease. Nor may a task whose recording needs a keyframe first.
    pub const fn is_usual(&self) -> bool {
        !self.coupled && !matches!(&self.logged, Some(logged) if logged.wants_keyframe())
    }

    /// Whether the task can take part at `now` in a fused step that another task begins. `RECORDS`: whether tasks are
    /// recorded.
    #[inline(always)]
    pub fn takes_part<const RECORDS: bool>(&mut self, now: Micros) -> bool {
        self.is_usual()
            && !(RECORDS && self.is_recorded() && self.has_told_script())
            && self.catch_up_with(now)
    }

    /// Whether the task's script has not taken a signal of an earlier fused step yet. A replay gives the script each
    /// signal before the task's next input. So a recorded task takes part in no further fused step until its script
    /// has the signal.
    fn has_told_script(&self) -> bool {
        self.runner.as_ref().is_some_and(|runner| runner.has_input())
    }

    /// Advances the state machine's clock to `now`. Returns false, and changes nothing, if anything is due before
    /// that.
    #[inline]
    pub fn catch_up_with(&mut self, now: Micros) -> bool {
        self.now() == now || self.let_idle_time_pass(now)
    }

    fn let_idle_time_pass(&mut self, now: Micros) -> bool {
        let (before, now) = (self.machine.now(), Instant(now.saturating_sub(self.started)));
        let passes = before < now && self.machine.let_idle_time_pass(&self.table, now);
        if passes && let Some(logged) = &mut self.logged {
            logged.pass(now - before);
        }
        passes
    }

    /// Takes an input of a task that has no script.
    #[inline]
    pub fn take(&mut self, stamped: &mut Stamped, effects: &mut Effects) -> Option<Completion> {
        // The thread, or the whole node, may have been stopped since the thread read the clock. If the lease ended
        // meanwhile, it must end before the input has any effect (D153).
        let at = if self.coupled { stamped.at.max(clock::now_by_kernel()) } else { stamped.at };
        let elapsed = self.elapsed(at);
        let at = self.now() + elapsed.0;
        if let Input::Packet(packet) = &mut stamped.input {
            // The packet also pays for the time by which another thread has advanced the state machine beyond
            // `stamped.at`.
            packet.remaining = packet.remaining - Ticks(at.saturating_sub(stamped.at));
        }
        let mut completion = None;
        let answers = &mut |signal| completion = Some(Completion { signal, at });
        self.run(elapsed, &stamped.input, answers, effects);
        completion
    }
}

/// An answer of the state machine to its task.
#[derive(Clone, Copy, Debug)]
pub struct Completion {
    /// The answer itself.
    pub signal: Signal,
    /// The instant at which the state machine gave the answer.
    pub at: Micros,
}

/// The outbox that the state machine fills while it takes one input.
struct Out<'a> {
    at: Micros,
    task: TaskId,
    home: Home,
    homes: &'a Homes,
    effects: &'a mut Effects,
    answers: &'a mut dyn FnMut(Signal),
    ring: &'a mut Ring,
    discards: &'a mut [u64; Reason::ALL.len()],
}

impl Outbox for Out<'_> {
    fn transmit(&mut self, packet: Packet) {
        let is_inside = |home: &Home| home.domain() == self.home.domain() && home.run_by != RunBy::ItsThread;
        match self.homes.of(packet.destination).filter(is_inside) {
            Some(home) => {
                self.effects.inside.send(home, Stamped { at: self.at, input: Input::Packet(packet) });
            }
            None => self.effects.queue.push_back(Effect::Transmit(self.at, packet)),
        }
    }

    fn signal(&mut self, signal: Signal) {
        (self.answers)(signal);
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
