//! Requests of a domain's member as fused steps: one step does what several small steps would do (D176,
//! D200).

use super::Turn;
use crate::clock::Micros;
use crate::node::comm::Completion;
use crate::node::effects::Effects;
use crate::node::home::RunBy;
use crate::observe::ring::Ring;
use crate::script::ScriptRunner;
use imrs_protocol::{Fusible, NodeId, NodeOutbox, Observation, Packet, Request, Signal, TaskId};

impl Turn<'_> {
    /// Takes a request of the member as one fused step with the other members that it concerns (D176, D193).
    /// If the request is a REPLY, `then` may be the GET that follows it (D200). If anything is unusual, this
    /// returns false and changes nothing; then the caller takes the small steps.
    pub fn fuse(
        &mut self,
        (request, then): (&Request, Option<&Request>),
        signals: &mut impl FusedSignals,
        effects: &mut Effects,
    ) -> bool {
        let Self { members, member, table, .. } = self;
        let own = &mut members[*member];
        if let Request::Get { .. } = request {
            let usual = own.is_usual();
            let mut out = Got { at: own.now(), ring: &mut own.ring, signals };
            return usual && own.machine.fuse_get(table, request, &mut out);
        }
        if members.len() == 1 {
            return false;
        }
        let own = &self.members[self.member];
        let (home, task) = (own.home, own.machine.task());
        let Some(fusible) = Fusible::of(self.table, task, request) else {
            return matches!(request, Request::Arrive { .. }) && self.gather(request, signals, effects);
        };
        let there = self.homes.at(fusible.other);
        // If a packet for the other member is still in the queue, that packet comes first.
        if home.domain() != there.domain() || effects.inside.has_input_for(there) {
            return false;
        }
        let Ok([own, other]) = self.members.get_disjoint_mut([home.member(), there.member()]) else {
            return false;
        };
        if !(own.is_usual() && other.is_usual() && other.catch_up_with(own.now())) {
            return false;
        }
        let mut out = Fused {
            at: own.now(),
            task,
            rings: (&mut own.ring, &mut other.ring),
            signals,
            goes_on: then.is_some(),
            other: (there.member(), &mut other.runner),
            told: false,
        };
        let machines = (&mut own.machine, &mut other.machine);
        let is_done = match then {
            None => fusible.step(machines.0, machines.1, request, &mut out),
            Some(get) => fusible.reply_and_get(self.table, machines, [request, get], &mut out),
        };
        if !is_done {
            return false;
        }
        if !out.told {
            self.change(there.member());
            return true;
        }
        // The other member's wait is over, and no other deadline of this member begins. So the expiry that it has
        // published is not later than its next one, and may stay.
        match there.run_by {
            RunBy::AnyThread => effects.inside.told(there),
            RunBy::TheThreadOfFutures | RunBy::ItsThread => effects.called.push(there.place()),
        }
        true
    }
}

/// Where the signals of a fused step go.
pub(crate) trait FusedSignals {
    /// To the task that makes the request.
    fn own(&mut self, answer: Completion);
    /// The signals to the other member, which may have a script.
    fn other(&mut self, member: usize, script: Option<&mut ScriptRunner>, answer: Completion);
}

/// The outbox of a fused GET.
struct Got<'a, S> {
    at: Micros,
    ring: &'a mut Ring,
    signals: &'a mut S,
}

impl<S: FusedSignals> NodeOutbox for Got<'_, S> {
    fn link(&mut self, _: NodeId, _: Packet) {}

    #[inline(always)]
    fn signal(&mut self, _: TaskId, signal: Signal) {
        self.signals.own(Completion { signal, at: self.at });
    }

    #[inline]
    fn observe(&mut self, _: Option<TaskId>, observation: Observation) {
        self.ring.push(self.at, observation);
    }
}

/// The outbox of one fused step. A fused step drops no message and sends no packet.
struct Fused<'a, S> {
    at: Micros,
    task: TaskId,
    /// The rings of observations of the task itself and of the other task.
    rings: (&'a mut Ring, &'a mut Ring),
    signals: &'a mut S,
    /// Whether the task makes another request once this one is accepted, so that it needs no signal about the
    /// acceptance.
    goes_on: bool,
    other: (usize, &'a mut Option<Box<ScriptRunner>>),
    /// Whether the other task got a signal.
    told: bool,
}

impl<S: FusedSignals> NodeOutbox for Fused<'_, S> {
    fn link(&mut self, _: NodeId, _: Packet) {}

    #[inline(always)]
    fn signal(&mut self, task: TaskId, signal: Signal) {
        let answer = Completion { signal, at: self.at };
        if task == self.task {
            if !(self.goes_on && matches!(signal, Signal::Accepted(_))) {
                self.signals.own(answer);
            }
        } else {
            self.told = true;
            self.signals.other(self.other.0, self.other.1.as_deref_mut(), answer);
        }
    }

    #[inline]
    fn observe(&mut self, at: Option<TaskId>, observation: Observation) {
        let ring = if at == Some(self.task) { &mut self.rings.0 } else { &mut self.rings.1 };
        ring.push(self.at, observation);
    }
}
