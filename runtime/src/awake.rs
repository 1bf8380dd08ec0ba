//! Waiting awake: a thread that expects to wait briefly looks at its word for a while before it sleeps (D110).
//!
//! Whether it does rests on three things: how long waits of that kind took lately, how often it looked in vain, and
//! whether another thread needs its core. Nothing but speed rests on any of them.

use crate::clock::{self, FAR, Micros};
use imrs_protocol::Request;
use rustix::thread::{CpuSet, sched_getaffinity};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicI16, AtomicIsize, AtomicU16, Ordering};

/// How many threads of tasks of this process run, or are about to because somebody woke them.
static AWAKE: AtomicIsize = AtomicIsize::new(0);
/// Of those, the ones that may use this core alone.
static BOUND: [AtomicI16; CpuSet::MAX_CPU] = [const { AtomicI16::new(0) }; CpuSet::MAX_CPU];
/// No single core.
const ANY: u16 = u16::MAX;

/// Whether a task's thread runs, told to all others. The thread itself says that it goes; that it is back says whoever wakes
/// it, or itself where nobody did.
#[derive(Debug)]
pub(crate) struct Presence {
    /// The only core that the thread may use. Changed by itself alone, while it runs.
    core: AtomicU16,
}

impl Presence {
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

    /// Says which core is the only one of the calling thread, whose presence this is, if there is one.
    fn keeps_to(&self, core: Option<u16>) {
        self.goes();
        self.core.store(core.unwrap_or(ANY), Ordering::Relaxed);
        self.returns();
    }
}

/// How much of the processor's time the process may use, in cores; [`isize::MAX`] where nobody limits it. Asked once, before
/// the first thread of a task waits.
pub(crate) fn quota() -> isize {
    static QUOTA: OnceLock<isize> = OnceLock::new();
    *QUOTA.get_or_init(|| {
        // The library takes the lesser of the cores that this thread may use and the limit.
        let lesser = std::thread::available_parallelism().map_or(1, usize::from);
        let cores = sched_getaffinity(None).map_or(1, |set| set.count() as usize);
        if lesser < cores { isize::try_from(lesser).unwrap_or(isize::MAX) } else { isize::MAX }
    })
}

/// The cores of a thread.
#[derive(Clone, Copy, Debug)]
struct Cores {
    /// How many threads of tasks may run at once before one of them lacks a core.
    most: isize,
    /// The only one that the thread may use.
    only: Option<u16>,
}

impl Cores {
    /// Of the calling thread.
    fn now() -> Self {
        let set = sched_getaffinity(None).unwrap_or_else(|_| CpuSet::new());
        let count = isize::try_from(set.count()).unwrap_or_default();
        let first = (0..CpuSet::MAX_CPU).find(|&core| set.is_set(core));
        let only = first.filter(|_| count == 1).and_then(|core| u16::try_from(core).ok());
        Self { most: if only.is_some() { quota() } else { count.min(quota()) }, only }
    }

    /// Whether nobody else needs the core that the calling thread runs on.
    fn free(self) -> bool {
        let bound = self.only.and_then(|core| BOUND.get(usize::from(core)));
        AWAKE.load(Ordering::Relaxed) <= self.most
            && bound.is_none_or(|bound| bound.load(Ordering::Relaxed) <= 1)
    }
}

/// What a task's thread waits for, of those waits that another thread can end soon.
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
            Request::Get { .. } => Some(Self::Message),
            Request::Arrive { .. } => Some(Self::Meeting),
            _ => None,
        }
    }
}

/// How waits of one kind went.
#[derive(Clone, Copy, Debug, Default)]
struct Habit {
    /// Whether the last one was brief: what ended it came within the budget, however late the thread noticed.
    brief: bool,
    /// How many more often it looked in vain than not, at most [`Self::MOST`].
    vain: u32,
    /// How many waits go by before it looks again.
    pause: u32,
}

impl Habit {
    const MOST: u32 = 10;

    fn tries(&mut self) -> bool {
        if !self.brief {
            return false;
        }
        let due = self.pause == 0;
        self.pause = self.pause.saturating_sub(1);
        due
    }

    fn looked(&mut self, found: bool) {
        if found {
            self.vain = self.vain.saturating_sub(1);
        } else {
            self.vain = (self.vain + 1).min(Self::MOST);
            self.pause = (1 << self.vain) - 1;
        }
    }
}

/// How a task's thread waits.
#[derive(Debug)]
pub(crate) struct Patience {
    /// For how long it looks before it sleeps.
    budget: Micros,
    /// Those of the calling thread, once it had a reason to ask.
    cores: Option<Cores>,
    habits: [Habit; 3],
}

impl Patience {
    /// How many looks share one look at the clock.
    const LOOKS: u32 = 16;

    pub fn new(budget: Micros) -> Self {
        Self { budget, cores: None, habits: [Habit::default(); 3] }
    }

    /// A wait of this kind was ended by what came after so long.
    pub fn learn(&mut self, kind: Kind, after: Micros) {
        self.habits[kind as usize].brief = after <= self.budget;
    }

    /// Looks, where that is worth it, for what ends the wait: at most for the budget, and not beyond `until`. Whether it is
    /// there.
    pub fn look(
        &mut self,
        kind: Kind,
        presence: &Presence,
        until: Micros,
        mut there: impl FnMut() -> bool,
    ) -> bool {
        if self.budget == 0 || !self.habits[kind as usize].tries() {
            return false;
        }
        let cores = *self.cores.get_or_insert_with(|| {
            let cores = Cores::now();
            presence.keeps_to(cores.only);
            cores
        });
        let mut ends = FAR;
        while cores.free() {
            for _ in 0..Self::LOOKS {
                if there() {
                    self.habits[kind as usize].looked(true);
                    return true;
                }
                std::hint::spin_loop();
            }
            let now = clock::now();
            if ends == FAR {
                ends = now.saturating_add(self.budget).min(until);
            }
            if now >= ends {
                self.habits[kind as usize].looked(false);
                return false;
            }
        }
        false
    }
}
