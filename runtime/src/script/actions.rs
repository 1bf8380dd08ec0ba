//! The actions of scripts: how they begin, end, and are cut short.

use crate::node::Node;
use crate::node::effects::Effects;
use crate::sync::{Mutex, lock};
use imrs_protocol::Ticks;
use imrs_protocol::script::{End, Program};
use imrs_wire::obs::Liveness;
use std::collections::BTreeMap;
use std::sync::{Arc, Weak};
use std::time::Duration;

/// Carries out the actions of scripts: by a simulation, by commands, or by functions of a program.
pub trait Actions: Send + Sync {
    /// Begins an action and returns at once; `ending` reports later how the action ended. The returned [`Stop`] is
    /// called if the action is cut short: then the robot must not act any more.
    fn begin(&self, act: &Act<'_>, ending: Ending) -> Option<Stop>;
}

/// Stops an action.
pub type Stop = Box<dyn FnOnce() + Send>;

/// An action to be carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Act<'a> {
    /// The name of the task.
    pub task: &'a str,
    /// The name of the action.
    pub name: &'a str,
    /// The action's arguments; a `real` is given by its bits.
    pub arguments: &'a [i64],
    /// How many actions this task began before this one.
    pub number: u64,
    /// The least time that the action takes.
    pub least: Duration,
    /// The longest time that the action takes.
    pub most: Duration,
    /// The lease under which the task began the action. `None` if the task is in no couple (a primary and its standby), or
    /// does not hold the lease.
    pub lease: Option<HeldLease>,
}

/// The lease that a task holds while it acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeldLease {
    /// The epoch of the lease.
    pub epoch: u8,
    /// When the lease ends unless it is renewed, in microseconds of `CLOCK_BOOTTIME`: never later than its true end.
    /// `None` if the task took over and acts alone, because the lease then does not end by itself.
    pub until: Option<u64>,
}

/// Reports how an action ended. If this is dropped without a report, the action counts as failed.
#[derive(Debug)]
pub struct Ending {
    node: Weak<Node>,
    place: usize,
    /// The thread of the script that waits for the action, and the number of the action.
    of: (u8, u64),
    said: bool,
}

impl Ending {
    /// Reports that the action succeeded, with this result; a `real` is given by its bits.
    pub fn done(mut self, value: i32) {
        self.say(true, value);
    }

    /// Reports that the action failed.
    pub fn failed(mut self) {
        self.say(false, 0);
    }

    /// The lease that the action's task holds now; `None` if it holds none.
    pub(crate) fn lease(&self) -> Option<HeldLease> {
        let node = self.node.upgrade()?;
        let local = node.locals.list.get(self.place)?;
        node.look(local, |comm| comm.lease())
    }

    fn say(&mut self, ok: bool, value: i32) {
        if std::mem::replace(&mut self.said, true) {
            return;
        }
        let Some(node) = self.node.upgrade() else { return };
        let mut effects = Effects::new(None);
        let of = self.of;
        node.locals.list[self.place].with_runner(&mut effects, |runner, comm, effects| {
            runner.acted(comm, of, ok, value, effects);
        });
        node.carry_out(&mut effects);
    }
}

impl Drop for Ending {
    fn drop(&mut self) {
        self.say(false, 0);
    }
}

impl std::fmt::Debug for Node {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Node").field("name", &self.name()).finish_non_exhaustive()
    }
}

/// An effect of a script outside of the node. It is carried out once the lock is released.
#[derive(Clone, Debug)]
pub(crate) enum OutsideEffect {
    Begin(Begun),
    CutShort { place: usize, level: u8, number: u64 },
    Ended { place: usize, end: End },
}

/// An action that is about to begin.
#[derive(Clone, Debug)]
pub(crate) struct Begun {
    pub place: usize,
    pub level: u8,
    pub number: u64,
    pub action: u16,
    pub arguments: Vec<i64>,
    pub least: Ticks,
    pub most: Ticks,
    pub lease: Option<HeldLease>,
}

type OnEnd = Box<dyn Fn(usize, End) + Send + Sync>;

/// Where the scripts of a node carry out their actions.
pub(crate) struct Stage {
    node: Weak<Node>,
    actions: Arc<dyn Actions>,
    /// For each task and thread of its script, the action that was last begun or cut short. One thread may begin an
    /// action while another cuts it short, so the cut may come first.
    running: Mutex<BTreeMap<(usize, u8), Running>>,
    ended: OnEnd,
}

#[derive(Default)]
struct Running {
    /// Every action with a smaller number than this was cut short or has ended.
    over: u64,
    /// The action that runs, with its number.
    runs: Option<(u64, Stop)>,
}

impl Stage {
    pub fn new(node: Weak<Node>, actions: Arc<dyn Actions>, ended: OnEnd) -> Self {
        Self { node, actions, running: Mutex::new(BTreeMap::new()), ended }
    }

    pub fn perform(&self, node: &Node, effect: OutsideEffect) {
        match effect {
            OutsideEffect::Begin(begun) => self.begin(node, &begun),
            OutsideEffect::CutShort { place, level, number } => self.cut_short((place, level), number),
            OutsideEffect::Ended { place, end } => {
                let liveness = match end {
                    End::Finished | End::Fenced | End::Aborted(_) => Liveness::Ended,
                    End::Assertion(_) | End::Fault { .. } => Liveness::Crashed,
                };
                node.locals.list[place].set_liveness(liveness);
                (self.ended)(place, end);
            }
        }
    }

    fn begin(&self, node: &Node, begun: &Begun) {
        let Begun { place, level, number, .. } = *begun;
        if lock(&self.running).entry((place, level)).or_default().over > number {
            return;
        }
        let Some(program) = self.check(node, begun) else { return };
        let act = Act {
            task: &program.name,
            name: program.actions.get(usize::from(begun.action)).map_or("", String::as_str),
            arguments: &begun.arguments,
            number,
            least: Duration::from_micros(begun.least.0),
            most: Duration::from_micros(begun.most.0),
            lease: begun.lease,
        };
        let ending = Ending { node: Weak::clone(&self.node), place, of: (level, number), said: false };
        // The lock is not held here, because an action that ends at once may begin the next action on this same thread.
        let stop = self.actions.begin(&act, ending);
        let mut all = lock(&self.running);
        let running = all.entry((place, level)).or_default();
        if running.over > number {
            drop(all);
            stop.into_iter().for_each(|stop| stop());
        } else if running.runs.as_ref().is_none_or(|(last, _)| *last < number) {
            running.runs = stop.map(|stop| (number, stop));
        }
    }

    /// The program of a script whose action is about to begin; `None` if the action was cut short. The node may have
    /// been stopped since the script began the action. If the couple's lease has ended meanwhile, the script must
    /// learn of that end first (D153).
    fn check(&self, node: &Node, begun: &Begun) -> Option<Arc<Program>> {
        let Begun { place, level, number, .. } = *begun;
        let local = &node.locals.list[place];
        let (program, coupled) = node.look(local, |comm| (comm.program(), comm.is_coupled()));
        if coupled {
            node.catch_up(local);
            // Another thread may have noticed the end of the lease, but may not have cut the action short yet.
            return program.filter(|_| node.look(local, |comm| comm.is_acting(level, number)));
        }
        program
    }

    fn cut_short(&self, at: (usize, u8), number: u64) {
        let mut all = lock(&self.running);
        let running = all.entry(at).or_default();
        running.over = running.over.max(number + 1);
        let stop = running.runs.take_if(|(last, _)| *last <= number);
        drop(all);
        stop.into_iter().for_each(|(_, stop)| stop());
    }
}
