//! Spinning before sleeping: a thread that expects a short wait checks its futex word repeatedly for a while before it
//! sleeps (D110).
//!
//! Whether a thread spins depends on three things: how long its last waits of that kind took, how often spinning
//! failed, and whether another thread needs its core. The decision affects only speed.

use crate::clock::{self, FAR, Micros};
use imrs_protocol::Request;
use rustix::thread::{CpuSet, sched_getaffinity};
use std::sync::atomic::{AtomicI16, AtomicIsize, AtomicU16, Ordering};

/// How many threads of this process's tasks run, or are about to run because another thread woke them.
static AWAKE: AtomicIsize = AtomicIsize::new(0);
/// For each core, how many of the running threads of tasks may use only that core.
static BOUND: [AtomicI16; CpuSet::MAX_CPU] = [const { AtomicI16::new(0) }; CpuSet::MAX_CPU];
/// The value for a thread that may use several cores.
const ANY: u16 = u16::MAX;

/// Whether a task's thread runs, visible to all other threads. Before the thread waits, it subtracts itself from
/// `AWAKE`. The thread that wakes it adds it again. If no thread wakes it (its time is over), it adds itself.
#[derive(Debug)]
pub(crate) struct ThreadState {
    /// The only core that the thread may use, or `ANY`. Only the thread itself changes it, while it runs.
    core: AtomicU16,
}

impl ThreadState {
    pub const fn new() -> Self {
        Self { core: AtomicU16::new(ANY) }
    }

    pub fn goes(&self) {
        self.count(-1);
    }

    pub fn returns(&self) {
        self.count(1);
    }

    fn count(&self, by: i8) {
        AWAKE.fetch_add(by.into(), Ordering::Relaxed);
        if let Some(bound) = BOUND.get(usize::from(self.core.load(Ordering::Relaxed))) {
            bound.fetch_add(by.into(), Ordering::Relaxed);
        }
    }

    /// Sets the only core that the calling thread may use, if there is just one. `self` must be the state of the
    /// calling thread.
    fn keeps_to(&self, core: Option<u16>) {
        self.goes();
        self.core.store(core.unwrap_or(ANY), Ordering::Relaxed);
        self.returns();
    }
}

/// How much processor time the process may use, in cores; [`isize::MAX`] without a limit. It is read before the first
/// wait of a task's thread, and then cached.
pub(crate) fn quota() -> isize {
    const UNKNOWN: isize = 0;
    static QUOTA: AtomicIsize = AtomicIsize::new(UNKNOWN);
    let known = QUOTA.load(Ordering::Relaxed);
    if known != UNKNOWN {
        return known;
    }
    // `available_parallelism` returns the lesser of two numbers: the cores of this thread and the limit of the process.
    let lesser = std::thread::available_parallelism().map_or(1, usize::from);
    let cores = sched_getaffinity(None).map_or(1, |set| set.count() as usize);
    let quota = if lesser < cores { isize::try_from(lesser).unwrap_or(isize::MAX) } else { isize::MAX };
    QUOTA.store(quota, Ordering::Relaxed);
    quota
}

/// The cores that a thread may use.
#[derive(Clone, Copy, Debug)]
struct Cores {
    /// How many task threads may run at once before one of them lacks a core.
    most: isize,
    /// The only core that the thread may use.
    only: Option<u16>,
}

impl Cores {
    /// The cores of the calling thread.
    fn now() -> Self {
        let set = sched_getaffinity(None).unwrap_or_else(|_| CpuSet::new());
        let count = isize::try_from(set.count()).unwrap_or_default();
        let first = (0..CpuSet::MAX_CPU).find(|&core| set.is_set(core));
        let only = first.filter(|_| count == 1).and_then(|core| u16::try_from(core).ok());
        Self { most: if only.is_some() { quota() } else { count.min(quota()) }, only }
    }

    /// Whether no other thread needs the core on which the calling thread runs.
    fn free(self) -> bool {
        let bound = self.only.and_then(|core| BOUND.get(usize::from(core)));
        AWAKE.load(Ordering::Relaxed) <= self.most
            && bound.is_none_or(|bound| bound.load(Ordering::Relaxed) <= 1)
    }
}

/// The kinds of waits that another thread can end soon.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Answers,
    Message,
    Meeting,
}

impl Kind {
    pub const fn of(request: &Request) -> Option<Self> {
        match request {
            Request::Send { .. } => Some(Self::Answers),
            // A REPLY does not wait, but the GET right after it does.
            Request::Get { .. } | Request::Reply { .. } => Some(Self::Message),
            Request::Arrive { .. } => Some(Self::Meeting),
            _ => None,
        }
    }
}

/// The spin history of one kind of wait.
#[derive(Clone, Copy, Debug)]
struct SpinHistory {
    /// Whether the last wait was brief: the event that ended it came within the spin budget, however late the thread noticed.
    brief: bool,
    /// How many more spins failed than succeeded, at most [`Self::MOST`].
    vain: u32,
    /// How many waits pass before the thread spins again.
    pause: u32,
}

impl SpinHistory {
    const MOST: u32 = 10;
    /// After how many waits that were not brief the thread spins once nevertheless. Two threads that both sleep wake
    /// each other so late that no wait would ever be brief.
    const UNLIKELY: u32 = 63;
    const NEW: Self = Self { brief: false, vain: 0, pause: Self::UNLIKELY };

    fn tries(&mut self) -> bool {
        let due = self.pause == 0;
        self.pause = match (due, self.brief) {
            (false, _) => self.pause - 1,
            (true, true) => 0,
            (true, false) => Self::UNLIKELY,
        };
        due
    }

    fn looked(&mut self, found: bool) {
        if found {
            (self.vain, self.pause) = (self.vain.saturating_sub(1), 0);
        } else {
            self.vain = (self.vain + 1).min(Self::MOST);
            self.pause = self.pause.max((1 << self.vain) - 1);
        }
    }

    fn ended(&mut self, brief: bool) {
        self.brief = brief;
        if brief && self.vain == 0 {
            self.pause = 0;
        }
    }
}

/// The spin policy of a task's thread: whether, and for how long, it spins before it sleeps.
#[derive(Debug)]
pub(crate) struct SpinPolicy {
    /// For how long the thread spins before it sleeps.
    budget: Micros,
    /// The cores of the calling thread, known once it has waited.
    cores: Option<Cores>,
    histories: [SpinHistory; 3],
}

impl SpinPolicy {
    /// How many checks of the word share one reading of the clock.
    const LOOKS: u32 = 16;

    pub fn new(budget: Micros) -> Self {
        Self { budget, cores: None, histories: [SpinHistory::NEW; 3] }
    }

    /// Records how long after the start of a wait of this kind its event came.
    pub fn learn(&mut self, kind: Kind, after: Micros) {
        self.histories[kind as usize].ended(after <= self.budget);
    }

    /// Spins until `there` returns true, if spinning is likely to pay. Spins at most for the budget, and not beyond
    /// `until`. Returns whether `there` returned true.
    pub fn look(
        &mut self,
        kind: Kind,
        thread_state: &ThreadState,
        until: Micros,
        mut there: impl FnMut() -> bool,
    ) -> bool {
        if self.budget == 0 {
            return false;
        }
        let cores = *self.cores.get_or_insert_with(|| {
            let cores = Cores::now();
            thread_state.keeps_to(cores.only);
            cores
        });
        let history = &mut self.histories[kind as usize];
        if !history.tries() {
            return false;
        }
        let mut ends = FAR;
        let mut looks = false;
        while cores.free() {
            for _ in 0..Self::LOOKS {
                if there() {
                    history.looked(true);
                    return true;
                }
                std::hint::spin_loop();
            }
            let now = clock::now();
            if ends == FAR {
                ends = now.saturating_add(self.budget).min(until);
            }
            if now >= ends {
                break;
            }
            looks = true;
        }
        if looks {
            history.looked(false);
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FREE: Cores = Cores { most: isize::MAX, only: None };
    const CROWDED: Cores = Cores { most: isize::MIN, only: None };

    fn policy(cores: Cores) -> SpinPolicy {
        SpinPolicy { cores: Some(cores), ..SpinPolicy::new(200) }
    }

    /// In how many of `waits` waits the thread spins, if no event ends any of them.
    fn tried(policy: &mut SpinPolicy, waits: u32) -> u32 {
        let thread_state = ThreadState::new();
        let mut tried = 0;
        for _ in 0..waits {
            let mut looks = 0;
            let there = || {
                looks += 1;
                false
            };
            assert!(!policy.look(Kind::Message, &thread_state, FAR, there));
            tried += u32::from(looks > 0);
        }
        tried
    }

    #[test]
    fn it_looks_where_the_last_wait_was_brief_and_finds_what_comes() {
        let (mut policy, thread_state) = (policy(FREE), ThreadState::new());
        assert!(!policy.look(Kind::Message, &thread_state, FAR, || true), "nothing is known yet");
        policy.learn(Kind::Message, 200);
        assert!(
            !policy.look(Kind::Answers, &thread_state, FAR, || true),
            "of the other kind nothing is known"
        );
        for _ in 0..100 {
            let mut looks = 0;
            let third = || {
                looks += 1;
                looks == 3
            };
            assert!(policy.look(Kind::Message, &thread_state, FAR, third));
        }
    }

    #[test]
    fn waits_that_are_long_are_looked_at_once_in_64_and_less_each_time_in_vain() {
        let mut policy = policy(FREE);
        assert_eq!(tried(&mut policy, 64), 1);
        // Six more times 63 waits pass without a spin, then 127, 255, 511, and from there on 1,023 each.
        assert_eq!(tried(&mut policy, 10_000), 17);
    }

    #[test]
    fn waits_that_are_brief_only_where_it_sleeps_are_hardly_looked_at() {
        let mut policy = policy(FREE);
        let mut all = 0;
        for _ in 0..5_000 {
            policy.learn(Kind::Message, 5);
            all += tried(&mut policy, 1);
        }
        assert!((10..=16).contains(&all), "{all} of 5,000");
    }

    #[test]
    fn it_does_not_look_where_others_need_the_core_or_without_a_budget() {
        let mut crowded = policy(CROWDED);
        let mut none = SpinPolicy { budget: 0, ..policy(FREE) };
        for policy in [&mut crowded, &mut none] {
            policy.learn(Kind::Message, 0);
            assert_eq!(tried(policy, 100), 0);
        }
    }

    #[test]
    fn it_looks_no_longer_than_the_budget_and_not_beyond_the_end() {
        let (mut policy, thread_state) = (policy(FREE), ThreadState::new());
        policy.learn(Kind::Message, 0);
        let begins = clock::now();
        assert!(!policy.look(Kind::Message, &thread_state, FAR, || false));
        assert!(clock::now() - begins >= 200);
        policy.budget = FAR;
        (policy.histories[1].pause, policy.histories[1].brief) = (0, true);
        assert!(!policy.look(Kind::Message, &thread_state, clock::now() + 50, || false), "it ends");
    }
}
