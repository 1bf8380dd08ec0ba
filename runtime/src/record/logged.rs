//! What is recorded of one communication task, with what its next record needs.

use super::{Log, OutputDigest, ScriptStep, Step};
use imrs_protocol::{CommTask, Input, Packet, Request, Signal, Ticks};

/// The log of one communication task's steps.
///
/// A step is recorded as a replay takes it, also if the task took it as its part of a fused step (D207): a fused step is recorded as
/// the small steps for which it stands.
pub(crate) struct Logged {
    log: Box<dyn Log>,
    /// Whether the log wants the machine's state before the next step.
    wants_keyframe: bool,
    /// The digest of all outputs so far.
    pub digest: OutputDigest,
    /// The time that has passed at the machine since the last recorded step.
    passed: Ticks,
}

impl Logged {
    pub fn new(log: Box<dyn Log>) -> Self {
        let wants_keyframe = log.wants_keyframe();
        Self { log, wants_keyframe, digest: OutputDigest::START, passed: Ticks::ZERO }
    }

    /// Whether the log wants the machine's state before the next step. Then that must be a small step.
    pub const fn wants_keyframe(&self) -> bool {
        self.wants_keyframe
    }

    /// Whether time has passed at the machine that is in no recorded step yet.
    pub const fn owes_time(&self) -> bool {
        self.passed.0 != 0
    }

    /// Time passed at the machine, and nothing else happened: it becomes a part of the next recorded step.
    #[inline]
    pub fn pass(&mut self, elapsed: Ticks) {
        self.passed = Ticks(self.passed.0 + elapsed.0);
    }

    /// Records the machine's state before a small step, if the log wants it.
    pub fn begin(&mut self, machine: &CommTask) {
        if self.wants_keyframe {
            self.log.keyframe(machine, self.digest);
        }
    }

    /// Records a small step that the machine has taken. `elapsed`: the time that passed in it.
    pub fn small(&mut self, elapsed: Ticks, input: &Input) {
        let step = self.step(elapsed, *input);
        self.wants_keyframe = self.log.step(&step, self.digest);
    }

    /// Records the machine's part in a fused step. `digest`: of all outputs, those of this part included.
    #[inline]
    pub fn part(&mut self, input: Input, digest: OutputDigest) {
        let step = self.step(Ticks::ZERO, input);
        // A second part may follow before the keyframe that the log wants after the first.
        self.wants_keyframe |= self.log.part(&step, digest);
    }

    /// Records a fused step that the task began itself. `first`: the digest of the outputs up to the first request, if there are two.
    #[inline]
    pub fn own(&mut self, request: &Request, then: Option<&Request>, first: OutputDigest) {
        let Some(&then) = then else { return self.part(Input::Request(*request), self.digest) };
        self.part(Input::Request(*request), first);
        self.part(Input::Request(then), self.digest);
    }

    #[inline]
    pub fn transmitted(&mut self, packet: &Packet) {
        self.digest.transmitted(packet);
    }

    #[inline]
    pub fn signalled(&mut self, signal: Signal) {
        self.digest.signalled(signal);
    }

    pub fn script(&mut self, step: ScriptStep, done: OutputDigest) {
        self.log.script(step, done);
    }

    #[inline]
    fn step(&mut self, elapsed: Ticks, input: Input) -> Step {
        let elapsed = Ticks(std::mem::replace(&mut self.passed, Ticks::ZERO).0 + elapsed.0);
        Step { elapsed, input }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, Mutex};

    struct Kept(Arc<Mutex<Vec<(u64, bool)>>>);

    impl Log for Kept {
        fn step(&mut self, step: &Step, _: OutputDigest) -> bool {
            self.0.lock().unwrap().push((step.elapsed.0, false));
            false
        }

        fn part(&mut self, step: &Step, _: OutputDigest) -> bool {
            self.0.lock().unwrap().push((step.elapsed.0, true));
            true
        }
    }

    #[test]
    fn time_that_passes_without_a_step_becomes_part_of_the_next_record() {
        let kept = Arc::<Mutex<Vec<(u64, bool)>>>::default();
        let mut logged = Logged::new(Box::new(Kept(Arc::clone(&kept))));
        assert!(!logged.owes_time());
        logged.pass(Ticks(2));
        logged.pass(Ticks(3));
        assert!(logged.owes_time());
        logged.small(Ticks(4), &Input::Time);
        assert!(!logged.owes_time());
        logged.pass(Ticks(1));
        logged.own(&Request::Done, Some(&Request::Cancel), OutputDigest::START);
        assert!(!logged.owes_time() && logged.wants_keyframe());
        logged.small(Ticks(0), &Input::Time);
        assert!(!logged.wants_keyframe());
        assert_eq!(*kept.lock().unwrap(), [(9, false), (1, true), (0, true), (0, false)]);
    }
}
