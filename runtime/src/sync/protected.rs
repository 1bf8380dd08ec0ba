//! The interface between a hand-off and the data structure behind it.

use crate::sync::inbox::Slotted;

/// The data structure behind the combining lock.
pub(crate) trait Protected {
    /// The input that threads bring.
    type Input: Slotted;
    /// The answer that its task waits for.
    type Completion;
    /// The work that the thread does once the lock is released. The caller owns it.
    type Effects;

    /// Whether only the task's thread needs the result of this input. If so, the input may wait until that thread
    /// makes its next call.
    fn may_wait(input: &Self::Input) -> bool;

    /// Takes one input, and may change it. Returns an answer for the task, if there is one.
    fn feed(&mut self, input: &mut Self::Input, effects: &mut Self::Effects) -> Option<Self::Completion>;

    /// Processes inputs that the protected tasks have for each other. Called after each group of inputs that a thread
    /// has processed.
    fn work_inside(&mut self, effects: &mut Self::Effects) {
        let _ = effects;
    }

    /// Called last, before the lock is released. Returns the instant of the protected state's next expiry.
    fn settle(&mut self, rest: Rest, effects: &mut Self::Effects) -> u64;
}

/// Wakes a task's thread that waits in the link's socket, and not on its futex word.
pub(crate) trait ThreadWaker: Send + Sync {
    /// Ends the thread's current wait; if it is not waiting, its next wait.
    fn wake(&self);
}

/// What the task's thread does once the lock is released.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rest {
    /// The thread goes on running, and it is not known when it enters again.
    No,
    /// The thread goes to sleep now, and enters again at the protected state's next expiry.
    Begins,
    /// The thread still sleeps, and enters again at the expiry that `settle` returned for [`Begins`](Self::Begins).
    GoesOn,
}

/// The result for the task's own thread when it enters the hand-off.
#[derive(Debug)]
pub(crate) struct Entry<M> {
    /// The answer, if there is one already.
    pub completion: Option<M>,
    /// Whether the node stops.
    pub stopped: bool,
    /// The instant at which the thread must enter again at the latest, if there is no answer yet.
    pub until: u64,
}
