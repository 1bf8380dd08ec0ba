//! A member's arrival at a `waitfor`, in one fused step, if the other members are in the same domain (D193). The
//! recording lists the small steps that the fused step replaces (D207).

use super::{FusedSignals, Turn};
use crate::clock::Micros;
use crate::node::comm::{Comm, Completion};
use crate::node::effects::Effects;
use crate::node::home::{Home, Homes, RunBy};
use crate::observe::ring::Ring;
use crate::record::Logged;
use crate::script::ScriptRunner;
use imrs_protocol::{
    CommTask, Gathering, Input, Members, Observation, Outbox, Packet, Request, Signal, Ticks, TimeId,
};

impl Turn<'_> {
    /// Lets the member arrive at a `waitfor` in one fused step with all other members (D193). `RECORDS`: whether any
    /// member of the domain is recorded.
    #[inline(never)]
    pub(super) fn gather<const RECORDS: bool, S: FusedSignals>(
        &mut self,
        request: &Request,
        signals: &mut S,
        effects: &mut Effects,
    ) -> bool {
        let Some(gathering) = Gathering::of(self.table, self.machine().task(), request) else { return false };
        if !self.is_usual() {
            return false;
        }
        let (own, at, homes) = (self.home, self.now(), self.homes);
        let members = &mut *self.members;
        let mut gathered = Gathered::<_, RECORDS> { at, own, members, homes, signals, effects, packet: None };
        let Some(released) = gathering.step(&mut gathered) else { return false };
        if RECORDS {
            gathered.record(request, gathering.others());
        }
        // The other members' deadlines change only if this arrival releases them.
        if released {
            gathering.others().for_each(|place| self.change(homes.at(place).member()));
        }
        true
    }
}

/// The members of a domain during an arrival that is one fused step.
struct Gathered<'a, S, const RECORDS: bool> {
    at: Micros,
    /// The home (domain and position) of the task that arrives.
    own: Home,
    members: &'a mut [Comm],
    homes: &'a Homes,
    signals: &'a mut S,
    effects: &'a mut Effects,
    /// The ARRIVE for the last of the other members. The ARRIVEs for the others have another destination, and are
    /// equal otherwise.
    packet: Option<Packet>,
}

impl<S, const RECORDS: bool> Gathered<'_, S, RECORDS> {
    /// Records what each member did in this step, for the members that are recorded.
    fn record(self, request: &Request, others: impl Iterator<Item = usize>) {
        if let Some(own) = &mut self.members[self.own.member()].logged {
            own.part(Input::Request(*request), own.digest);
        }
        let Some(packet) = self.packet else { return };
        for place in others {
            let Comm { machine, logged, .. } = &mut self.members[self.homes.at(place).member()];
            if let Some(other) = logged {
                other.part(Input::Packet(Packet { destination: machine.task(), ..packet }), other.digest);
            }
        }
    }
}

impl<S: FusedSignals, const RECORDS: bool> Members for Gathered<'_, S, RECORDS> {
    /// False if tasks are recorded: in a recording, the CONFIRMs of released members are inputs of their own, and a
    /// script takes them only after it has gone on.
    fn may_release(&self) -> bool {
        !RECORDS
    }

    fn hearing(&mut self, place: usize) -> (&mut CommTask, impl FnOnce(Observation)) {
        let Comm { machine, ring, .. } = &mut self.members[self.homes.at(place).member()];
        let at = self.at;
        (machine, move |observation| ring.push(at, observation))
    }

    fn takes_part(&mut self, place: usize) -> bool {
        let there = self.homes.at(place);
        // If a packet for this member is still queued, the member must take that packet first.
        there.domain() == self.own.domain()
            && !self.effects.inside.has_input_for(there)
            && self.members[there.member()].takes_part::<RECORDS>(self.at)
    }

    fn at(&mut self, place: usize) -> (&mut CommTask, impl Outbox) {
        let home = self.homes.at(place);
        let Comm { machine, ring, runner, logged, .. } = &mut self.members[home.member()];
        let is_own = home == self.own;
        let (signals, effects) = (&mut *self.signals, &mut *self.effects);
        let parts = RECORDS.then_some((logged.as_mut(), &mut self.packet));
        (machine, Gathers::<_, RECORDS> { at: self.at, home, is_own, ring, runner, parts, signals, effects })
    }
}

/// The outbox of a member when all members of a `waitfor` take one fused step. Such a step drops no message, and uses
/// no Timer.
struct Gathers<'a, S, const RECORDS: bool> {
    at: Micros,
    home: Home,
    /// Whether this is the outbox of the member that arrives.
    is_own: bool,
    ring: &'a mut Ring,
    runner: &'a mut Option<Box<ScriptRunner>>,
    /// With `RECORDS`: the recording of this member, and the last ARRIVE of the member that arrives.
    parts: Option<(Option<&'a mut Logged>, &'a mut Option<Packet>)>,
    signals: &'a mut S,
    effects: &'a mut Effects,
}

impl<S: FusedSignals, const RECORDS: bool> Outbox for Gathers<'_, S, RECORDS> {
    const TRANSMITS: bool = RECORDS;

    #[inline(always)]
    fn transmit(&mut self, packet: Packet) {
        if RECORDS && let Some((logged, last)) = &mut self.parts {
            if let Some(logged) = logged {
                logged.transmitted(&packet);
            }
            if self.is_own {
                **last = Some(packet);
            }
        }
    }

    fn signal(&mut self, signal: Signal) {
        if RECORDS && let Some((Some(logged), _)) = &mut self.parts {
            logged.signalled(signal);
        }
        let answer = Completion { signal, at: self.at };
        if self.is_own {
            return self.signals.own(answer);
        }
        self.signals.other(self.home.member(), self.runner.as_deref_mut(), answer);
        match self.home.run_by {
            RunBy::AnyThread => self.effects.inside.told(self.home),
            RunBy::TheThreadOfFutures | RunBy::ItsThread => self.effects.called.push(self.home.place()),
        }
    }

    fn arm(&mut self, _: TimeId, _: u8, _: Ticks) {}

    fn disarm(&mut self, _: TimeId) {}

    fn observe(&mut self, observation: Observation) {
        self.ring.push(self.at, observation);
    }
}
