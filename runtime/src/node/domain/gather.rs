//! The arrival of a member at a `waitfor` whose other members are all in the domain, as one fused step
//! (D193).

use super::{FusedSignals, Turn};
use crate::clock::Micros;
use crate::node::comm::{Comm, Completion};
use crate::node::effects::Effects;
use crate::node::home::{Home, Homes, RunBy};
use crate::observe::ring::Ring;
use crate::script::ScriptRunner;
use imrs_protocol::{
    CommTask, Gathering, Members, Observation, Outbox, Packet, Request, Signal, Ticks, TimeId,
};

impl Turn<'_> {
    /// Lets the member arrive at a `waitfor`, as one fused step with all other members of that `waitfor`
    /// (D193).
    #[inline(never)]
    pub(super) fn gather(
        &mut self,
        request: &Request,
        signals: &mut impl FusedSignals,
        effects: &mut Effects,
    ) -> bool {
        let Some(gathering) = Gathering::of(self.table, self.machine().task(), request) else { return false };
        let (home, now, homes) = (self.home, self.now(), self.homes);
        if !self.is_usual() {
            return false;
        }
        for place in gathering.others() {
            let there = homes.at(place);
            // A packet that one of the members has not taken yet must come first.
            if there.domain() != home.domain() || effects.inside.has_input_for(there) {
                return false;
            }
            let other = &mut self.members[there.member()];
            if !(other.is_usual() && other.catch_up_with(now)) {
                return false;
            }
        }
        let mut gathered =
            Gathered { at: now, own: home.place(), members: self.members, homes, signals, effects };
        if !gathering.step(&mut gathered) {
            return false;
        }
        gathering.others().for_each(|place| self.change(homes.at(place).member()));
        true
    }
}

/// The members of a domain during a fused arrival.
struct Gathered<'a, S> {
    at: Micros,
    /// The place, on the node, of the task that arrives.
    own: usize,
    members: &'a mut [Comm],
    homes: &'a Homes,
    signals: &'a mut S,
    effects: &'a mut Effects,
}

impl<S: FusedSignals> Members for Gathered<'_, S> {
    fn at(&mut self, place: usize) -> (&mut CommTask, impl Outbox) {
        let home = self.homes.at(place);
        let Comm { machine, ring, runner, .. } = &mut self.members[home.member()];
        let is_own = place == self.own;
        let (signals, effects) = (&mut *self.signals, &mut *self.effects);
        (machine, Gathers { at: self.at, home, is_own, ring, runner, signals, effects })
    }
}

/// The outbox of a member in a fused arrival. Such a step drops no message, and uses no Timer.
struct Gathers<'a, S> {
    at: Micros,
    home: Home,
    /// Whether this is the outbox of the member that arrives.
    is_own: bool,
    ring: &'a mut Ring,
    runner: &'a mut Option<Box<ScriptRunner>>,
    signals: &'a mut S,
    effects: &'a mut Effects,
}

impl<S: FusedSignals> Outbox for Gathers<'_, S> {
    fn transmit(&mut self, _: Packet) {}

    fn signal(&mut self, signal: Signal) {
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
