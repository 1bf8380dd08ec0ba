//! The recording of one communication task's steps, and the state that its next record needs.

use super::{Log, OutputDigest, ScriptStep, Step};
use imrs_protocol::{CommTask, Input, Packet, Request, Signal, Ticks};

/// The log of one communication task's steps.
///
/// A fused step is recorded as the small steps that it replaces, because a replay takes only small steps. This holds
/// for every task that took part in the fused step (D207).
pub(crate) struct Logged {
    log: Box<dyn Log>,
    /// Whether the log wants the state machine's state before the next step.
    wants_keyframe: bool,
    /// The digest of all outputs so far.
    pub digest: OutputDigest,
    /// How far the state machine's clock has advanced since the last recorded step.
    passed: Ticks,
}

impl Logged {
    pub fn new(log: Box<dyn Log>) -> Self {
        let wants_keyframe = log.wants_keyframe();
        Self { log, wants_keyframe, digest: OutputDigest::START, passed: Ticks::ZERO }
    }

    /// Whether the log wants the state machine's state before the next step. If so, the task must take no fused step
    /// next.
    pub const fn wants_keyframe(&self) -> bool {
        self.wants_keyframe
    }

    /// Whether the state machine's clock has advanced since the last recorded step.
    pub const fn owes_time(&self) -> bool {
        self.passed.0 != 0
    }

    /// Notes that the state machine's clock advanced by `elapsed` without a step. The next recorded step includes
    /// this time.
    #[inline]
    pub fn pass(&mut self, elapsed: Ticks) {
        self.passed = Ticks(self.passed.0 + elapsed.0);
    }

    /// Records the state machine's state before a small step, if the log wants it.
    pub fn begin(&mut self, machine: &CommTask) {
        if self.wants_keyframe {
            self.log.keyframe(machine, self.digest);
        }
    }

    /// Records a small step that the state machine has taken. `elapsed` is the time by which its clock advanced in
    /// this step.
    pub fn small(&mut self, elapsed: Ticks, input: &Input) {
        let step = self.step(elapsed, *input);
        self.wants_keyframe = self.log.step(&step, self.digest);
    }

    /// Records the state machine's part in a fused step. `digest` is that of all outputs, this part included.
    #[inline]
    pub fn part(&mut self, input: Input, digest: OutputDigest) {
        let step = self.step(Ticks::ZERO, input);
        // The log may want a keyframe after this part. A second part of the same fused step may still come before the
        // keyframe.
        self.wants_keyframe |= self.log.part(&step, digest);
    }

    /// Records a fused step that the task began itself. With two requests, `first` is the digest of the outputs up to
    /// the first.
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
