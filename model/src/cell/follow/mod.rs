//! Follows a recorded run through the model: the model's scripts, state machines, links and nodes take the inputs that each
//! task took in the run.
//!
//! ```text
//!   recorded:  for each task its inputs, and what its script made of them, in microseconds
//!   followed:  at the tick of each input the node's clock counts, then the same input comes: the script must make
//!              the same of it
//! ```
//!
//! The model allows more here than in [`check_cell`](super::check_cell):
//! - a packet may arrive at any time after it was sent, again, or never; the caller measures and counts how long packets took;
//! - an action ends at any tick from its least time on, with any result; later than its most time it counts as
//!   [`Followed::late`];
//! - each node counts ticks from its own start, its tasks begin any time after it, and it may act late: [`Followed::behind`].

mod guide;
mod packets;
mod run;
mod steps;
mod time;
mod words;

pub use guide::follow_run;
pub use run::{Followed, Happened, Happening, Late, Run, Turn, Unexplained};
pub use steps::{Steps, steps_in_model};

use super::judge::{name, statement};
use super::plan::{CellFaults, CellPlan, Conduct};
use super::run_state::RunState;
pub(super) use words::plain;
use words::{alike, named, port_name, said};

use crate::cell_state::script::Running;
use crate::cell_state::{CellState, Effect, InFlight};
use imrs_protocol::script::{Address, ScriptInput};
use imrs_protocol::{Packet, TaskId};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Ticks that the clock of a node may be ahead of the run, because every node rounds the remaining time of a message.
const AHEAD: u64 = 2;
/// Ticks by which a node may notice late that time has passed. The cell's assumptions allow one tick (D42).
const LATE: u64 = 1;
/// More ticks than this between an early end and the allowed end of an action cannot come from rounding.
const ROUNDED: u64 = 4;

/// An input of a task, and what the task's script did with it.
#[derive(Clone, Debug)]
struct Group {
    at: u64,
    cause: Happened,
    /// The packets that left the task's node because of the input.
    sent: Vec<Packet>,
    turns: Vec<Turn>,
}

/// How the time of an input is rounded. An input without a rounding counts for the tick in which it happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rounding {
    /// The input happens one tick later.
    Up,
    /// The input happens one tick earlier.
    Down,
    /// The remaining time of the packet is one tick less.
    Charged,
    /// The reverse of the usual rule for a late node: it counts all missed ticks at once for timers, and deadline by
    /// deadline for communication tasks.
    Otherwise,
    /// The timer or delay whose end the run shows ends first in its tick, before the time_outs of that tick.
    First,
}

impl Rounding {
    pub const ALL: [Self; 5] = [Self::First, Self::Up, Self::Down, Self::Otherwise, Self::Charged];
}

/// How inputs' times are rounded, by task and position of the input's group (an input with what followed from it).
pub(super) type Roundings = BTreeMap<(usize, usize), Rounding>;

/// A run that the model has followed up to some input.
#[derive(Clone)]
pub(super) struct Follower {
    /// The length of a tick in microseconds.
    tick: u64,
    run_state: RunState,
    pub roundings: Roundings,
    /// For each node: the microsecond of its start, the ticks that its tasks have counted, and the ticks that its actions have
    /// counted.
    starts: Vec<u64>,
    clocks: Vec<u64>,
    acts: Vec<u64>,
    /// For each task and activation, by how many ticks its action has exceeded the action's most time.
    over: BTreeMap<(usize, u8), u64>,
    /// For each timer, by how many ticks its end was put off, because the run has not shown the end yet.
    put_off: BTreeMap<time::Timer, u64>,
    /// For each task, its inputs. `next` says how many of them were followed.
    groups: Arc<Vec<Vec<Group>>>,
    next: Vec<usize>,
    /// For each node, whether its recording is complete.
    whole: Vec<bool>,
    /// How many moves of killed nodes, which no recording has, were guessed.
    guessed: u64,
    /// The inputs that were followed, in order. Each is a task and a position among the task's groups.
    pub done: Vec<(usize, usize)>,
    /// For each task, steps of its script in the model that the run has not shown yet.
    pending: Vec<VecDeque<Turn>>,
    /// The packets that arrived last, the newest first.
    arrived: VecDeque<InFlight>,
    /// For each task, the packets that it has sent in the model and that the run has not shown yet, each with its node's tick.
    sends: Vec<Vec<(u64, Packet)>>,
    pub out: Followed,
}

/// Why the model cannot take an input now.
enum No {
    /// The model has not sent the packet of this input yet: another task may have to step first.
    NotYet(String),
    Never(String),
    /// The model cannot follow the input, however times are rounded.
    However(String),
}

/// Where following a run stops.
#[derive(Clone, Debug)]
pub(super) enum Stop {
    /// At the end of the run: the whole run was followed.
    Over,
    /// After as many inputs as requested.
    Far,
    /// At an event that the model cannot produce next.
    Stuck(Unexplained),
}

/// The inputs of a task, each with what the task's script did with it. Inputs that only let time pass are left out.
fn groups(run_state: &RunState, run: &Run, task: usize) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    let here = run_state.cell.node_state_of(task);
    for Happening { at, what, .. } in run.tasks.get(task).into_iter().flatten() {
        match what {
            Happened::Sent(packet) => {
                let leaves = run_state.cell.node_state_of(packet.destination.index()) != here;
                if let Some(group) = groups.last_mut().filter(|_| leaves) {
                    group.sent.push(named(packet));
                }
            }
            Happened::Turn(turn) => {
                if let Some(group) = groups.last_mut() {
                    group.turns.push(turn.clone());
                }
            }
            Happened::Stopped | Happened::PeerStopped(_) => break,
            cause => {
                groups.push(Group { at: *at, cause: cause.clone(), sent: Vec::new(), turns: Vec::new() });
            }
        }
    }
    // The model does not follow incarnations: the input that a peer has restarted counts as passing time.
    let idle = |group: &Group| matches!(group.cause, Happened::Time | Happened::PeerRestarted(_));
    groups.retain(|group| !idle(group) || !group.sent.is_empty() || !group.turns.is_empty());
    groups
}

impl Follower {
    pub fn new(plan: &Arc<CellPlan>, run: &Run) -> Self {
        let mut run_state = RunState::new(plan, &CellFaults::default());
        // No script has begun yet, because the run decides the order in which its tasks begin.
        run_state.cell = CellState::waiting(&Arc::clone(&run_state.cell.plan));
        run_state.cell.keep_log = true;
        let (nodes, tasks) = (run_state.cell.nodes.len(), plan.tasks.len());
        let groups: Vec<_> = (0..tasks).map(|task| groups(&run_state, run, task)).collect();
        let first = |node: usize| {
            let here = (0..tasks).filter(|&task| run_state.cell.node_state_of(task) == node);
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
            run_state,
            out: Followed::default(),
        }
    }

    /// The next input of a task that is to be followed: the task, and the position among the task's groups.
    pub fn stuck_at(&self, task: TaskId) -> (usize, usize) {
        (task.index(), self.next[task.index()])
    }

    /// The node of a task.
    pub fn node_of(&self, task: TaskId) -> usize {
        self.run_state.cell.node_state_of(task.index())
    }

    /// Follows the run until `inputs` of its inputs were followed in all, or until the model cannot go on.
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

    /// The operation of a task's next script step in the run; if there is none, the one at which the task is in the model.
    fn address(&self, task: usize) -> Address {
        let next = self.groups[task].get(self.next[task]).and_then(|group| group.turns.first());
        next.map_or_else(|| super::judge::position(&self.run_state, task), |turn| turn.at)
    }

    fn follow(&mut self, task: usize) -> Result<(), No> {
        let groups = Arc::clone(&self.groups);
        let Some(group) = groups[task].get(self.next[task]) else { return Ok(()) };
        let node = self.run_state.cell.node_state_of(task);
        let now = group.at.saturating_sub(self.starts[node]) / self.tick;
        let counted = now.saturating_add_signed(self.rounding(task));
        match group.cause {
            Happened::Started => {}
            Happened::Begun => {
                // A script may begin long after its node's first record. That time must not count for its first action.
                self.let_actions_go_on(node, now);
                self.catch_up(node, counted)?;
                self.run_state.cell.leave(task, ScriptInput::Begin);
                self.made(node)?;
            }
            Happened::Time | Happened::PeerRestarted(_) => {
                self.let_time_show(task, node, (now, counted), group)?;
            }
            Happened::Unsent(id) => self.unsent(task, node, id)?,
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
                self.run_state.cell.leave(task, ScriptInput::Chosen(choice));
                self.made(node)?;
            }
            Happened::Sent(_) | Happened::Turn(_) | Happened::Stopped | Happened::PeerStopped(_) => {}
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
        let table = &self.run_state.plan.table;
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

    /// Runs the scripts after a move of the model, and collects what they did.
    fn made(&mut self, node: usize) -> Result<(), No> {
        self.out.moves += 1;
        let run_state = &mut self.run_state;
        let result = run_state.cell.run_scripts();
        run_state.cell.in_flight.sort_by_key(|carried| carried.link);
        self.collect(node);
        result.map_err(|violation| No::Never(violation.text().into()))
    }

    fn collect(&mut self, node: usize) {
        let turns = self.run_state.cell.turns.as_mut().map(std::mem::take).unwrap_or_default();
        for turn in turns {
            let (at, input, passed, end) = (turn.at, turn.input, turn.passed, turn.end);
            self.pending[turn.task].push_back(Turn { at, input, passed, end });
        }
        for effect in std::mem::take(&mut self.run_state.cell.log) {
            if let Effect::Sent(_, packet) = effect {
                let task = packet.source.index();
                // Packets that a node only relays do not count as sent by its tasks.
                if self.run_state.cell.node_state_of(task) == node {
                    self.sends[task].push((self.clocks[node], named(&packet)));
                }
            }
        }
    }

    /// Checks that the run has shown everything that a task did in the model, before the task takes a new input.
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
        let actor = self.run_state.cell.bodies[task].actor.as_ref();
        let Some(&Running { action, least, .. }) = actor.and_then(|actor| actor.running.iter().find(runs))
        else {
            return Err(No::Never("an action ends that the model has not begun".into()));
        };
        if !least.is_zero() {
            let why = format!("an action ends {least} ticks before its least time is over");
            return Err(if least.0 > ROUNDED { No::However(why) } else { No::Never(why) });
        }
        if let Conduct::Program { values, .. } = &self.run_state.plan.tasks[task] {
            let tried = values.get(usize::from(action)).map_or(&[][..], Vec::as_slice);
            let is_tried = if tried.is_empty() { value == 0 } else { tried.contains(&value) };
            self.out.other_values += u64::from(ok && !is_tried);
        }
        self.run_state.cell.acted(task, level, ok, value);
        self.made(node)
    }

    fn tell(&self, task: usize, turn: &Turn) -> String {
        let table = &self.run_state.plan.table;
        let what = match &self.run_state.plan.tasks[task] {
            Conduct::Program { program, .. } => statement(table, program, turn.at),
            Conduct::Extern(_) => String::new(),
        };
        format!("{}: {what}: {}", name(table, task), said(&turn.input))
    }
}
