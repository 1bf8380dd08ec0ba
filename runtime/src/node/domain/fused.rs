//! A member's request as one fused step: it replaces several small steps of the tasks of a domain (D176, D200). The
//! recording lists the small steps that it replaces (D207).

use super::Turn;
use crate::clock::Micros;
use crate::node::comm::{Comm, Completion};
use crate::node::effects::Effects;
use crate::node::home::RunBy;
use crate::observe::ring::Ring;
use crate::record::{Logged, OutputDigest};
use crate::script::ScriptRunner;
use imrs_protocol::{
    Fusible, Input, NodeId, NodeOutbox, NodeTable, Observation, Packet, Request, Signal, TaskId,
};

impl Turn<'_> {
    /// Makes a request of the member in one fused step with the members that it concerns (D176, D193). If `request`
    /// is a REPLY, `then` may be the GET that follows it (D200). If no fused step is possible, returns false and
    /// changes nothing: the caller then takes the small steps.
    pub fn fuse(
        &mut self,
        requests: (&Request, Option<&Request>),
        signals: &mut impl FusedSignals,
        effects: &mut Effects,
    ) -> bool {
        if self.records {
            self.fuse_by::<true, _>(requests, signals, effects)
        } else {
            self.fuse_by::<false, _>(requests, signals, effects)
        }
    }

    /// As [`fuse`](Self::fuse). `RECORDS`: whether any member of the domain is recorded.
    #[inline(never)]
    fn fuse_by<const RECORDS: bool, S: FusedSignals>(
        &mut self,
        (request, then): (&Request, Option<&Request>),
        signals: &mut S,
        effects: &mut Effects,
    ) -> bool {
        let Self { members, member, table, .. } = self;
        if let Request::Get { .. } = request {
            let own = &mut members[*member];
            return own.is_usual() && get::<RECORDS>(own, table, request, signals);
        }
        if members.len() == 1 {
            return false;
        }
        let own = &self.members[self.member];
        let (home, task) = (own.home, own.machine.task());
        let Some(fusible) = Fusible::of(self.table, task, request) else {
            return matches!(request, Request::Arrive { .. })
                && self.gather::<RECORDS, _>(request, signals, effects);
        };
        let there = self.homes.at(fusible.other);
        // If a packet for the other member is still queued, the other member must take that packet first.
        if home.domain() != there.domain() || effects.inside.has_input_for(there) {
            return false;
        }
        let Ok([own, other]) = self.members.get_disjoint_mut([home.member(), there.member()]) else {
            return false;
        };
        let at = own.now();
        if !(own.is_usual() && other.takes_part::<RECORDS>(at)) {
            return false;
        }
        let mut out = Fused::<_, RECORDS> {
            at,
            task,
            rings: (&mut own.ring, &mut other.ring),
            signals,
            goes_on: then.is_some(),
            other: (there.member(), &mut other.runner),
            told: false,
            parts: RECORDS.then(|| Parts::new(own.logged.as_mut(), other.logged.as_mut())),
        };
        let machines = (&mut own.machine, &mut other.machine);
        let is_done = match then {
            None => fusible.step(machines.0, machines.1, request, &mut out),
            Some(get) => fusible.reply_and_get(self.table, machines, [request, get], &mut out),
        };
        if !is_done {
            return false;
        }
        let told = out.told;
        if RECORDS && let Some(parts) = out.parts {
            parts.record(request, then);
        }
        if !told {
            self.change(there.member());
            return true;
        }
        // The other member's wait is over, and no other deadline of that member begins. So the deadline that it has
        // published is at most too early, and need not be published again.
        match there.run_by {
            RunBy::AnyThread => effects.inside.told(there),
            RunBy::TheThreadOfFutures | RunBy::ItsThread => effects.called.push(there.place()),
        }
        true
    }
}

/// Lets a member take a GET in one fused step.
#[inline(always)]
fn get<const RECORDS: bool>(
    own: &mut Comm,
    table: &NodeTable,
    request: &Request,
    signals: &mut impl FusedSignals,
) -> bool {
    let at = own.now();
    let parts = RECORDS.then(|| Parts::new(own.logged.as_mut(), None));
    let mut out = Got::<_, RECORDS> { at, ring: &mut own.ring, signals, parts };
    let done = own.machine.fuse_get(table, request, &mut out);
    if RECORDS
        && done
        && let Some(parts) = out.parts
    {
        parts.record(request, None);
    }
    done
}

/// The data that the recordings of a fused step's two tasks need: the task that asks, and its partner.
struct Parts<'a> {
    /// The recording of the task that asks, then that of its partner.
    own: Option<&'a mut Logged>,
    other: Option<&'a mut Logged>,
    /// The packet that the task sends to its partner.
    packet: Option<Packet>,
    /// The digest of the task's outputs when its first request was accepted.
    first: OutputDigest,
}

impl<'a> Parts<'a> {
    const fn new(own: Option<&'a mut Logged>, other: Option<&'a mut Logged>) -> Self {
        Self { own, other, packet: None, first: OutputDigest::START }
    }

    fn sent(&mut self, packet: Packet) {
        if let Some(own) = &mut self.own {
            own.transmitted(&packet);
        }
        self.packet = Some(packet);
    }

    fn signalled(&mut self, is_own: bool, signal: Signal) {
        let logged = if is_own { &mut self.own } else { &mut self.other };
        let Some(logged) = logged else { return };
        logged.signalled(signal);
        if is_own && matches!(signal, Signal::Accepted(_)) {
            self.first = logged.digest;
        }
    }

    /// Records the requests of the task that asks, and what its partner takes.
    fn record(self, request: &Request, then: Option<&Request>) {
        if let Some(own) = self.own {
            own.own(request, then, self.first);
        }
        if let (Some(other), Some(packet)) = (self.other, self.packet) {
            other.part(Input::Packet(packet), other.digest);
        }
    }
}

/// Receives the signals of a fused step (one that replaces several small steps).
pub(crate) trait FusedSignals {
    /// Takes a signal to the task that makes the request.
    fn own(&mut self, answer: Completion);
    /// Takes a signal to the other task, which may have a script.
    fn other(&mut self, member: usize, script: Option<&mut ScriptRunner>, answer: Completion);
}

/// The outbox of a GET that is taken in one fused step.
struct Got<'a, S, const RECORDS: bool> {
    at: Micros,
    ring: &'a mut Ring,
    signals: &'a mut S,
    parts: Option<Parts<'a>>,
}

impl<S: FusedSignals, const RECORDS: bool> NodeOutbox for Got<'_, S, RECORDS> {
    fn link(&mut self, _: NodeId, _: Packet) {}

    #[inline(always)]
    fn signal(&mut self, _: TaskId, signal: Signal) {
        if RECORDS && let Some(parts) = &mut self.parts {
            parts.signalled(true, signal);
        }
        self.signals.own(Completion { signal, at: self.at });
    }

    #[inline]
    fn observe(&mut self, _: Option<TaskId>, observation: Observation) {
        self.ring.push(self.at, observation);
    }
}

/// The outbox of one fused step (which replaces several small steps). A fused step drops no message and sends no packet.
struct Fused<'a, S, const RECORDS: bool> {
    at: Micros,
    task: TaskId,
    /// The rings of observations of the task itself and of the other task.
    rings: (&'a mut Ring, &'a mut Ring),
    signals: &'a mut S,
    /// Whether the task makes another request once this one is accepted. If so, it needs no signal about the
    /// acceptance.
    goes_on: bool,
    other: (usize, &'a mut Option<Box<ScriptRunner>>),
    /// Whether the other task got a signal.
    told: bool,
    /// What the recordings need; `None` without `RECORDS`.
    parts: Option<Parts<'a>>,
}

impl<S: FusedSignals, const RECORDS: bool> NodeOutbox for Fused<'_, S, RECORDS> {
    fn link(&mut self, _: NodeId, _: Packet) {}

    #[inline(always)]
    fn signal(&mut self, task: TaskId, signal: Signal) {
        if RECORDS && let Some(parts) = &mut self.parts {
            parts.signalled(task == self.task, signal);
        }
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

    #[inline(always)]
    fn within(&mut self, packet: impl FnOnce() -> Packet) {
        if RECORDS && let Some(parts) = &mut self.parts {
            parts.sent(packet());
        }
    }
}
