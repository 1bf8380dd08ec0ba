//! What runs behind a hand-off, and what both ends of it know of each other.

/// What runs behind the lock.
pub(crate) trait Station {
    /// What is brought to it.
    type Input;
    /// What its task waits for.
    type Mail;
    /// What it wants done once the lock is released. Owned by the caller.
    type Effects;

    /// Whether nobody but the task's thread needs what comes of this input, so that it may wait until that comes in.
    fn may_wait(input: &Self::Input) -> bool;

    /// Takes one input; an answer for the task is returned.
    fn feed(&mut self, input: Self::Input, effects: &mut Self::Effects) -> Option<Self::Mail>;

    /// Called last before the lock is released. Returns when the station next has something to do by itself.
    fn settle(&mut self, rest: Rest, effects: &mut Self::Effects) -> u64;
}

/// Calls back a task's thread that waits elsewhere than on its word.
pub(crate) trait Bell: Send + Sync {
    /// Ends its present wait there, or else the next one.
    fn ring(&self);
}

/// What the task's thread does once the lock is released.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rest {
    /// It runs, or will: it does not come back by itself.
    No,
    /// It goes to sleep now, and comes back when the station next has something to do.
    Begins,
    /// It sleeps, and comes back when it was told to by the `settle` that its rest began with.
    GoesOn,
}

/// What the task's own thread finds.
#[derive(Debug)]
pub(crate) struct Entry<M> {
    /// The answer, if it is there.
    pub mail: Option<M>,
    /// Whether the node stops.
    pub stopped: bool,
    /// When to come back at the latest, if there is no answer yet.
    pub until: u64,
}
