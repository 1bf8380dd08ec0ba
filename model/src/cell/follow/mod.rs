//! Follows a recorded run through the model: the same scripts and machines, the same links and nodes, led by what each
//! task took.
//!
//! ```text
//!   recorded:  task by task, what it took and what its script made of it, in microseconds
//!   followed:  at the tick of each of these the node's clock counts, then the same input comes: the script must make
//!              the same of it
//! ```
//!
//! What is wider than in [`check_cell`](super::check_cell):
//! - a packet may arrive at any time after it was sent, again, or never; the caller measures how long it took, and counts;
//! - an action ends at any tick between its least and its most, with any result;
//! - each node counts its own ticks from its own start, its tasks begin any time after it, and it notices a tick later than it comes: [`Followed::behind`].

mod guide;
mod packets;
mod run;
mod steps;
mod time;
mod words;

pub use guide::follow_run;
pub use run::{Followed, Happened, Happening, Late, Run, Turn, Unexplained};
pub use steps::{Steps, steps_in_model};

use super::course::Course;
use super::judge::{name, statement};
use super::plan::{CellFaults, CellPlan, Conduct};
pub(super) use words::plain;
use words::{alike, named, port_name, said};

use crate::floor::script::Running;
use crate::floor::{Crossing, Effect, Floor};
use imrs_protocol::script::{Address, ScriptInput};
use imrs_protocol::{Packet, TaskId};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// How many ticks the clock of a node may be ahead of the run: what a message has left is rounded at every node.
const AHEAD: u64 = 2;
/// How many ticks late a node may notice that time has passed: one that is declared (D42).
const LATE: u64 = 1;
/// By how many ticks no rounding of two times changes what lies between them.
const ROUNDED: u64 = 4;

/// Something that a task took, and what came of it.
#[derive(Clone, Debug)]
struct Group {
    at: u64,
    cause: Happened,
    /// What left its node.
    sent: Vec<Packet>,
    turns: Vec<Turn>,
}

/// How the time of something is rounded where it is not rounded down to its tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rounding {
    /// It is one tick later.
    Up,
    /// It is one tick earlier.
    Down,
    /// What the packet has left is one tick less.
    Charged,
    /// Time that passed unnoticed is counted at once where timers end, and else tick by tick.
    Otherwise,
    /// The timer or delay that the run shows ends before the time_outs of its tick.
    First,
}

impl Rounding {
    pub const ALL: [Self; 5] = [Self::First, Self::Up, Self::Down, Self::Otherwise, Self::Charged];
}

/// For groups of tasks, by their numbers.
pub(super) type Roundings = BTreeMap<(usize, usize), Rounding>;

/// A run that is followed so far.
#[derive(Clone)]
pub(super) struct Follower {
    /// Microseconds.
    tick: u64,
    course: Course,
    pub roundings: Roundings,
    /// For each node, the microsecond at which it began, the ticks that its tasks counted, and those that its actions
    /// did.
    starts: Vec<u64>,
    clocks: Vec<u64>,
    acts: Vec<u64>,
    /// By task and thread, by how many ticks the action there takes longer than its most.
    over: BTreeMap<(usize, u8), u64>,
    /// By how many ticks the ends of timers were put off, that the run has not shown yet.
    put_off: BTreeMap<time::Timer, u64>,
    /// For each task, what it took, and how much of it was followed.
    groups: Arc<Vec<Vec<Group>>>,
    next: Vec<usize>,
    /// For each node, whether its recording ends by itself.
    whole: Vec<bool>,
    /// Moves of killed nodes that no recording has.
    guessed: u64,
    /// What was followed, in order: task, and which of its groups.
    pub done: Vec<(usize, usize)>,
    /// For each task, what its script in the model did and the run has not shown yet.
    pending: Vec<VecDeque<Turn>>,
    /// What arrived last, the last first.
    arrived: VecDeque<Crossing>,
    /// For each task, what it sent in the model and the run has not shown yet, and in which tick of its node.
    sends: Vec<Vec<(u64, Packet)>>,
    pub out: Followed,
}

/// Why a group cannot be followed now.
enum No {
    /// Its packet is not under way: somebody else may have to go on first.
    NotYet(String),
    Never(String),
    /// Nor would it with any other rounding of times.
    However(String),
}

/// Where following a run stops.
#[derive(Clone, Debug)]
pub(super) enum Stop {
    /// All of it was followed.
    Over,
    /// So much of it as was asked.
    Far,
    /// The model cannot do the next thing.
    Stuck(Unexplained),
}

/// What a task took, each with what came of it. Time in which nothing shows is left out.
fn groups(course: &Course, run: &Run, task: usize) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    let here = course.floor.station_of(task);
    for Happening { at, what, .. } in run.tasks.get(task).into_iter().flatten() {
        match what {
            Happened::Sent(packet) => {
                let leaves = course.floor.station_of(packet.destination.index()) != here;
                if let Some(group) = groups.last_mut().filter(|_| leaves) {
                    group.sent.push(named(packet));
                }
            }
            Happened::Turn(turn) => {
                if let Some(group) = groups.last_mut() {
                    group.turns.push(turn.clone());
                }
            }
            Happened::Stopped => break,
            cause => {
                groups.push(Group { at: *at, cause: cause.clone(), sent: Vec::new(), turns: Vec::new() });
            }
        }
    }
    // Lives of nodes are not followed: that one began is time that passes.
    let idle = |group: &Group| matches!(group.cause, Happened::Time | Happened::PeerRestarted(_));
    groups.retain(|group| !idle(group) || !group.sent.is_empty() || !group.turns.is_empty());
    groups
}

impl Follower {
    pub fn new(plan: &Arc<CellPlan>, run: &Run) -> Self {
        let mut course = Course::new(plan, &CellFaults::default());
        // The run says the order in which its tasks go on.
        course.floor = Floor::waiting(&Arc::clone(&course.floor.plan));
        course.floor.keep_log = true;
        let (nodes, tasks) = (course.floor.stations.len(), plan.tasks.len());
        let groups: Vec<_> = (0..tasks).map(|task| groups(&course, run, task)).collect();
        let first = |node: usize| {
            let here = (0..tasks).filter(|&task| course.floor.station_of(task) == node);
            here.filter_map(|task| run.tasks.get(task)?.first()).map(|first| first.at).min().unwrap_or(0)
        };
        Self {
            tick: run.tick.max(1),
            starts: (0..nodes).map(first).collect(),
            clocks: vec![0; nodes],
            acts: vec![0; nodes],
            over: BTreeMap::new(),
            put_off: BTreeMap::new(),
            pending: vec![VecDeque::new(); tasks],
            arrived: VecDeque::new(),
            sends: vec![Vec::new(); tasks],
            groups: Arc::new(groups),
            next: vec![0; tasks],
            whole: run.whole.clone(),
            guessed: 0,
            done: Vec::new(),
            roundings: Roundings::new(),
            course,
            out: Followed::default(),
        }
    }

    /// The group of a task that comes next.
    pub fn stuck_at(&self, task: TaskId) -> (usize, usize) {
        (task.index(), self.next[task.index()])
    }

    /// The node of a task.
    pub fn node_of(&self, task: TaskId) -> usize {
        self.course.floor.station_of(task.index())
    }

    /// Follows the run until so many of its inputs were followed, or it cannot.
    pub fn go(&mut self, inputs: usize) -> Stop {
        let mut order: Vec<(u64, usize)> = Vec::new();
        while self.done.len() < inputs {
            order.clear();
            for (task, groups) in self.groups.iter().enumerate() {
                order.extend(groups.get(self.next[task]).map(|group| (group.at, task)));
            }
            if order.is_empty() {
                return Stop::Over;
            }
            order.sort_unstable();
            let mut first = None;
            let went = order.iter().find_map(|&(at, task)| match self.follow(task) {
                Ok(()) => Some(Ok((at, task))),
                Err(No::NotYet(why)) => {
                    first.get_or_insert((at, task, why, false));
                    None
                }
                Err(No::Never(why)) => Some(Err((at, task, why, false))),
                Err(No::However(why)) => Some(Err((at, task, why, true))),
            });
            let stuck = |(at, task, why, however): (u64, usize, String, bool)| {
                let address = self.address(task);
                Stop::Stuck(Unexplained { at, task: TaskId::from_index(task), address, why, however })
            };
            match (went, first) {
                (Some(Ok((at, task))), _) => {
                    self.done.push((task, self.next[task]));
                    self.next[task] += 1;
                    self.out.until = at;
                }
                (Some(Err(never)), _) => return stuck(never),
                (None, Some(not_yet)) => return stuck(not_yet),
                (None, None) => return Stop::Over,
            }
        }
        Stop::Far
    }

    /// Where the run's next turn of a task begins; else where the task stands in the model.
    fn address(&self, task: usize) -> Address {
        let next = self.groups[task].get(self.next[task]).and_then(|group| group.turns.first());
        next.map_or_else(|| super::waiting::position(&self.course, task), |turn| turn.at)
    }

    fn follow(&mut self, task: usize) -> Result<(), No> {
        let groups = Arc::clone(&self.groups);
        let Some(group) = groups[task].get(self.next[task]) else { return Ok(()) };
        let node = self.course.floor.station_of(task);
        let now = group.at.saturating_sub(self.starts[node]) / self.tick;
        let counted = now.saturating_add_signed(self.rounding(task));
        match group.cause {
            Happened::Started => {}
            Happened::Begun => {
                // A node may begin long after its first record: that is no time of its first action.
                self.let_actions_go_on(node, now);
                self.catch_up(node, counted)?;
                self.course.floor.leave(task, ScriptInput::Begin);
                self.made(node)?;
            }
            Happened::Time | Happened::PeerRestarted(_) => {
                self.let_time_show(task, node, (now, counted), group)?;
            }
            Happened::Came(packet) => self.packet(task, node, (now, counted), packet)?,
            Happened::Acted(level, ok, value) => {
                self.quiet(task, "its action ends")?;
                self.let_actions_go_on(node, now);
                self.catch_up(node, counted)?;
                self.acted(task, node, group.at, (level, ok, value))?;
            }
            Happened::Chosen(choice) => {
                self.quiet(task, "it chooses")?;
                self.let_actions_go_on(node, now);
                self.course.floor.leave(task, ScriptInput::Chosen(choice));
                self.made(node)?;
            }
            Happened::Sent(_) | Happened::Turn(_) | Happened::Stopped => {}
        }
        group.turns.iter().try_for_each(|turn| self.expect(task, turn))?;
        for packet in &group.sent {
            let Some(at) = self.sends[task].iter().position(|(_, sent)| sent == packet) else {
                return Err(No::Never(format!(
                    "{}, which it does not in the model",
                    self.sends_what(packet)
                )));
            };
            self.sends[task].remove(at);
        }
        let old = self.sends[task].iter().find(|(at, _)| at + AHEAD < now);
        old.map_or(Ok(()), |(_, packet)| {
            Err(No::Never(format!("in the model {}, which it does not in the run", self.sends_what(packet))))
        })
    }

    fn sends_what(&self, packet: &Packet) -> String {
        let table = &self.course.plan.table;
        let (from, to) = (name(table, packet.source.index()), name(table, packet.destination.index()));
        let again = if packet.resent { " again" } else { "" };
        format!("{from} sends a {:?} on {} to {to}{again}", packet.kind, port_name(table, packet.port))
    }

    fn rounding(&self, task: usize) -> i64 {
        match self.roundings.get(&(task, self.next[task])) {
            Some(Rounding::Up) => 1,
            Some(Rounding::Down) => -1,
            Some(Rounding::Charged | Rounding::Otherwise | Rounding::First) | None => 0,
        }
    }

    /// The model has made a move.
    fn made(&mut self, node: usize) -> Result<(), No> {
        self.out.moves += 1;
        let course = &mut self.course;
        let result = course.floor.run_scripts();
        course.floor.crossings.sort_by_key(|crossing| crossing.link);
        self.collect(node);
        result.map_err(|violation| No::Never(violation.text().into()))
    }

    fn collect(&mut self, node: usize) {
        let turns = self.course.floor.turns.as_mut().map(std::mem::take).unwrap_or_default();
        for turn in turns {
            let (at, input, passed, end) = (turn.at, turn.input, turn.passed, turn.end);
            self.pending[turn.task].push_back(Turn { at, input, passed, end });
        }
        for effect in std::mem::take(&mut self.course.floor.log) {
            if let Effect::Sent(_, packet) = effect {
                let task = packet.source.index();
                // Not what a node only passes on.
                if self.course.floor.station_of(task) == node {
                    self.sends[task].push((self.clocks[node], named(&packet)));
                }
            }
        }
    }

    /// Nothing of the model waits for the run to show it, before a task takes something new.
    fn quiet(&self, task: usize, what: &str) -> Result<(), No> {
        match self.pending[task].front() {
            None => Ok(()),
            Some(turn) => Err(No::Never(format!("{what}, but in the model {} first", self.tell(task, turn)))),
        }
    }

    fn expect(&mut self, task: usize, turn: &Turn) -> Result<(), No> {
        let Some(made) = self.pending[task].pop_front() else {
            return Err(No::Never(format!("{}: in the model nothing happens", self.tell(task, turn))));
        };
        if !alike(&made, turn) {
            let (run, model) = (self.tell(task, turn), self.tell(task, &made));
            return Err(No::Never(format!("{run}; in the model: {model}")));
        }
        self.out.turns += 1;
        Ok(())
    }

    fn acted(
        &mut self,
        task: usize,
        node: usize,
        at: u64,
        (level, ok, value): (u8, bool, i32),
    ) -> Result<(), No> {
        let over = self.over.remove(&(task, level)).unwrap_or(0);
        self.late(task, at, over);
        let runs = |running: &&Running| running.level == level;
        let actor = self.course.floor.bodies[task].actor.as_ref();
        let Some(&Running { action, least, .. }) = actor.and_then(|actor| actor.running.iter().find(runs))
        else {
            return Err(No::Never("an action ends that the model has not begun".into()));
        };
        if least > 0 {
            let why = format!("an action ends {least} ticks before its least time is over");
            return Err(if u64::from(least) > ROUNDED { No::However(why) } else { No::Never(why) });
        }
        if let Conduct::Program { values, .. } = &self.course.plan.tasks[task] {
            let tried = values.get(usize::from(action)).map_or(&[][..], Vec::as_slice);
            let is_tried = if tried.is_empty() { value == 0 } else { tried.contains(&value) };
            self.out.other_values += u64::from(ok && !is_tried);
        }
        self.course.floor.acted(task, level, ok, value);
        self.made(node)
    }

    fn tell(&self, task: usize, turn: &Turn) -> String {
        let table = &self.course.plan.table;
        let what = match &self.course.plan.tasks[task] {
            Conduct::Program { program, .. } => statement(table, program, turn.at),
            Conduct::Extern(_) => String::new(),
        };
        format!("{}: {what}: {}", name(table, task), said(&turn.input))
    }
}
