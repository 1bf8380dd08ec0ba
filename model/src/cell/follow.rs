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
//! - a packet may arrive at any time after it was sent, or never; the caller measures how long it took;
//! - an action ends at any tick between its least and its most, with any result;
//! - each node counts its own ticks from its own start, its tasks begin any time after it, and it notices a tick later than it comes: [`Followed::behind`].

use super::course::Course;
use super::judge::{name, statement};
use super::plan::{CellFaults, CellPlan, Conduct};
use super::run::{Followed, Happened, Happening, Late, Run, Turn, Unexplained};
use crate::floor::{Effect, Floor};
use crate::floor::script::Running;
use imrs_protocol::script::{Address, ScriptInput};
use imrs_protocol::{
    Call, CellTable, NodeInput, NodeOutbox, Outcome, Packet, PortId, Signal, TaskId, Ticks,
};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// How many ticks the clock of a node may be ahead of the run: what a message has left is rounded at every node.
const AHEAD: u64 = 2;
/// How many ticks late a node may notice that time has passed: one that is declared (D42).
const LATE: u64 = 1;

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
}

impl Rounding {
    pub const ALL: [Self; 4] = [Self::Up, Self::Down, Self::Otherwise, Self::Charged];
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
    /// For each task, what it took, and how much of it was followed.
    groups: Arc<Vec<Vec<Group>>>,
    next: Vec<usize>,
    /// What was followed, in order: task, and which of its groups.
    pub done: Vec<(usize, usize)>,
    /// For each task, what its script in the model did and the run has not shown yet.
    pending: Vec<VecDeque<Turn>>,
    /// For each task, what it sent in the model and the run has not shown yet, and in which tick of its node.
    sends: Vec<Vec<(u64, Packet)>>,
    pub out: Followed,
}

/// Why a group cannot be followed now.
enum No {
    /// Its packet is not under way: somebody else may have to go on first.
    NotYet(String),
    Never(String),
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
    groups.retain(|group| group.cause != Happened::Time || !group.sent.is_empty() || !group.turns.is_empty());
    groups
}

impl Follower {
    pub fn new(plan: &Arc<CellPlan>, run: &Run) -> Self {
        let mut course = Course::new(plan, &CellFaults::default());
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
            pending: vec![VecDeque::new(); tasks],
            sends: vec![Vec::new(); tasks],
            groups: Arc::new(groups),
            next: vec![0; tasks],
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
                    first.get_or_insert((at, task, why));
                    None
                }
                Err(No::Never(why)) => Some(Err((at, task, why))),
            });
            let stuck = |(at, task, why): (u64, usize, String)| {
                let address = self.address(task);
                Stop::Stuck(Unexplained { at, task: TaskId::from_index(task), address, why })
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
        next.map_or_else(|| super::judge::position(&self.course, task), |turn| turn.at)
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
                self.catch_up(node, counted)?;
                self.course.floor.leave(task, ScriptInput::Begin);
                self.made(node)?;
            }
            Happened::Time => self.let_time_show(task, node, (now, counted), group)?,
            Happened::Came(packet) => self.packet(task, node, (now, counted), packet)?,
            Happened::Acted(level, ok, value) => {
                self.quiet(task, "its action ends")?;
                self.let_actions_go_on(node, now);
                self.catch_up(node, counted)?;
                self.acted(task, node, group.at, (level, ok, value))?;
            }
            Happened::Chosen(choice) => {
                self.quiet(task, "it chooses")?;
                self.course.floor.leave(task, ScriptInput::Chosen(choice));
                self.made(node)?;
            }
            Happened::Sent(_) | Happened::Turn(_) | Happened::Stopped => {}
        }
        group.turns.iter().try_for_each(|turn| self.expect(task, turn))?;
        for packet in &group.sent {
            let Some(at) = self.sends[task].iter().position(|(_, sent)| sent == packet) else {
                return Err(No::Never(format!("{}, which it does not in the model", self.sends_what(packet))));
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
        format!("{from} sends a {:?} on {} to {to}{again}", packet.kind, statement_port(table, packet.port))
    }

    fn rounding(&self, task: usize) -> i64 {
        match self.roundings.get(&(task, self.next[task])) {
            Some(Rounding::Up) => 1,
            Some(Rounding::Down) => -1,
            Some(Rounding::Charged | Rounding::Otherwise) | None => 0,
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
            Some(turn) => {
                Err(No::Never(format!("{what}, but in the model {} first", self.tell(task, turn))))
            }
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

    /// The ticks until time alone makes a node act.
    fn expiry(&self, node: usize) -> Option<u64> {
        self.course.floor.stations[node].node.next_expiry().map(|ticks| ticks.0.max(1))
    }

    fn count(&mut self, node: usize, ticks: u64) -> Result<(), No> {
        if ticks == 0 {
            return Ok(());
        }
        self.clocks[node] += ticks;
        let step = self.course.floor.step(node, NodeInput::Advance(Ticks(ticks)));
        step.map_err(|violation| No::Never(violation.text().into()))?;
        self.made(node)
    }

    /// Whether so much time shows anything at a node.
    fn shows(&self, node: usize, ticks: u64) -> bool {
        let mut look = Look(false);
        self.course.floor.stations[node].node.clone().step(NodeInput::Advance(Ticks(ticks)), &mut look);
        look.0
    }

    /// Lets a node count up to a tick, but not to where time would show: the run shows that later.
    fn catch_up(&mut self, node: usize, now: u64) -> Result<(), No> {
        while self.clocks[node] < now {
            let left = now - self.clocks[node];
            let Some(expiry) = self.expiry(node).filter(|&expiry| expiry <= left) else {
                return self.count(node, left);
            };
            if self.shows(node, expiry) {
                self.count(node, expiry - 1)?;
                return Ok(());
            }
            self.count(node, expiry)?;
        }
        Ok(())
    }

    fn let_actions_go_on(&mut self, node: usize, now: u64) {
        let ticks = u32::try_from(now.saturating_sub(self.acts[node])).unwrap_or(u32::MAX);
        self.acts[node] = self.acts[node].max(now);
        for task in 0..self.course.floor.bodies.len() {
            if self.course.floor.station_of(task) == node
                && let Some(actor) = &mut self.course.floor.bodies[task].actor
            {
                self.over.retain(|&(of, level), _| {
                    of != task || actor.running.iter().any(|running| running.level == level)
                });
                for running in actor.running.iter().filter(|running| running.most < ticks) {
                    *self.over.entry((task, running.level)).or_default() += u64::from(ticks - running.most);
                }
                actor.pass(ticks);
            }
        }
    }

    /// A task acts so many ticks after it is time.
    fn late(&mut self, task: usize, at: u64, ticks: u64) {
        self.out.behind = self.out.behind.max(ticks);
        if ticks > LATE {
            let address = self.address(task);
            self.out.late.push(Late { at, task: TaskId::from_index(task), address, ticks });
        }
    }

    /// Time makes a task act, as the run says.
    fn let_time_show(
        &mut self,
        task: usize,
        node: usize,
        (now, counted): (u64, u64),
        group: &Group,
    ) -> Result<(), No> {
        self.let_actions_go_on(node, now);
        let stepwise = self.steps_timers(task, group);
        while self.pending[task].len() < group.turns.len() || !self.has_sent(task, group) {
            let what = || match (group.turns.first(), group.sent.first()) {
                (Some(turn), _) => self.tell(task, turn),
                (None, Some(packet)) => self.sends_what(packet),
                (None, None) => String::new(),
            };
            let Some(expiry) = self.expiry(node) else {
                return Err(No::Never(format!("{}: in the model no time_out runs", what())));
            };
            let then = self.clocks[node] + expiry;
            if then > now + AHEAD {
                let early = then - now;
                return Err(No::Never(format!("{}: in the model {early} ticks later", what())));
            }
            let all = if stepwise { 0 } else { counted.saturating_sub(self.clocks[node]) };
            let ticks = expiry.max(all);
            self.count(node, ticks)?;
            self.late(task, group.at, now.saturating_sub(then));
            self.out.ahead = self.out.ahead.max(then.saturating_sub(now));
        }
        Ok(())
    }

    /// Whether the model's task has sent what the run's did.
    fn has_sent(&self, task: usize, group: &Group) -> bool {
        group.sent.iter().all(|packet| self.sends[task].iter().any(|(_, sent)| sent == packet))
    }

    /// A node that is late gives its communication tasks all the time at once, but ends each timer by itself.
    fn steps_timers(&self, task: usize, group: &Group) -> bool {
        let timer = |turn: &Turn| {
            matches!(
                turn.input,
                ScriptInput::Signal(Signal::TimeOut(_) | Signal::Interrupt(Call::Timer(_)))
            )
        };
        let otherwise = self.roundings.get(&(task, self.next[task])) == Some(&Rounding::Otherwise);
        group.turns.first().is_some_and(timer) != otherwise
    }

    fn packet(
        &mut self,
        task: usize,
        node: usize,
        (now, counted): (u64, u64),
        packet: Packet,
    ) -> Result<(), No> {
        if self.course.floor.station_of(packet.source.index()) == node {
            return Ok(());
        }
        let Some(first) = self.under_way(&packet) else {
            let table = &self.course.plan.table;
            let (from, kind) = (name(table, packet.source.index()), packet.kind);
            let port = statement_port(table, packet.port);
            let why = format!("a {kind:?} of {from} on {port} arrives that the model has not sent");
            return Err(No::NotYet(why));
        };
        self.quiet(task, "a packet comes")?;
        self.let_actions_go_on(node, now);
        self.catch_up(node, counted)?;
        let charge = u64::from(self.roundings.get(&(task, self.next[task])) == Some(&Rounding::Charged));
        let mut at = Some(first);
        while let Some(i) = at {
            let crossing = self.course.floor.crossings.remove(i);
            let (_, to, bound) = self.course.floor.links[usize::from(crossing.link)];
            let last = to.index() == node;
            // What it was charged beyond the bound, in whole ticks (D20).
            let left = crossing.packet.remaining.0.saturating_sub(u64::from(bound)) * self.tick;
            let over = if last { left.saturating_sub(packet.remaining.0) / self.tick + charge } else { 0 };
            let step = self.course.floor.deliver(crossing, u8::try_from(over).unwrap_or(u8::MAX));
            step.map_err(|violation| No::Never(violation.text().into()))?;
            self.made(to.index())?;
            if last {
                return Ok(());
            }
            // It was at a node that only passes it on.
            at = self.under_way(&packet);
        }
        Err(No::Never("a packet arrives that a node on the way drops in the model".into()))
    }

    /// The packet that is under way in the model and nearest to this one in what is left of its life.
    fn under_way(&self, packet: &Packet) -> Option<usize> {
        let left = packet.remaining.0 / self.tick;
        let same = |other: &Packet| named(other) == named(packet);
        let floor = &self.course.floor;
        let all = floor.crossings.iter().enumerate().filter(|(_, crossing)| same(&crossing.packet));
        let distance = |at: usize| {
            let crossing = &floor.crossings[at];
            let charge = u64::from(floor.links[usize::from(crossing.link)].2);
            crossing.packet.remaining.0.saturating_sub(charge).abs_diff(left)
        };
        all.map(|(at, _)| at).min_by_key(|&at| distance(at))
    }

    fn acted(&mut self, task: usize, node: usize, at: u64, (level, ok, value): (u8, bool, i32)) -> Result<(), No> {
        let over = self.over.remove(&(task, level)).unwrap_or(0);
        self.late(task, at, over);
        let runs = |running: &&Running| running.level == level;
        let actor = self.course.floor.bodies[task].actor.as_ref();
        let Some(&Running { action, least, .. }) = actor.and_then(|actor| actor.running.iter().find(runs))
        else {
            return Err(No::Never("an action ends that the model has not begun".into()));
        };
        if least > 0 {
            return Err(No::Never(format!("an action ends {least} ticks before its least time is over")));
        }
        if let Conduct::Program { values, .. } = &self.course.plan.tasks[task] {
            let tried = values.get(usize::from(action)).map_or(&[][..], Vec::as_slice);
            let is_tried = if tried.is_empty() { value == 0 } else { tried.contains(&value) };
            self.out.other_values += u64::from(ok && !is_tried);
        }
        self.course.floor.acted(task, level, ok, value);
        self.made(node)
    }

    /// What is left under way when the run ends was lost, but for what was sent just before.
    pub fn count_lost(&mut self) {
        let floor = &self.course.floor;
        for (at, (from, to, _)) in floor.links.iter().enumerate() {
            let left = floor.crossings.iter().filter(|crossing| usize::from(crossing.link) == at).count();
            if left > 0 {
                self.out.lost.push((from.index(), to.index(), left as u64));
            }
        }
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

fn statement_port(table: &CellTable, port: PortId) -> String {
    table.port(port).map_or_else(|| "?".into(), |port| format!("`{}`", port.decl.name))
}

/// What came, in a few words.
fn said(input: &ScriptInput) -> String {
    match input {
        ScriptInput::Begin => "begins".into(),
        ScriptInput::Acted { ok: true, value, .. } => format!("the action ends: {value}"),
        ScriptInput::Acted { ok: false, .. } => "the action fails".into(),
        ScriptInput::Chosen(choice) => format!("chooses {choice}"),
        ScriptInput::Signal(signal) => match signal {
            Signal::Outcome(Outcome::Reply(_)) => "is answered".into(),
            Signal::Released { round, .. } => format!("is released from round {}", round.0),
            other => format!("{other:?}"),
        },
    }
}

/// Without what relays and time change.
fn named(packet: &Packet) -> Packet {
    Packet { remaining: Ticks::ZERO, hops: 0, ..*packet }
}

/// Whether two turns are the same but for what is counted in other units.
fn alike(a: &Turn, b: &Turn) -> bool {
    (a.at, &a.passed, a.end) == (b.at, &b.passed, b.end) && plain(a.input) == plain(b.input)
}

/// Without what is left of lives.
fn plain(mut input: ScriptInput) -> ScriptInput {
    if let ScriptInput::Signal(
        Signal::Message(delivery) | Signal::Interrupt(Call::Message(delivery)),
    ) = &mut input
    {
        delivery.budget = Ticks::ZERO;
    }
    input
}

/// Whether anything shows.
struct Look(bool);

impl NodeOutbox for Look {
    fn link(&mut self, _: imrs_protocol::NodeId, _: Packet) {
        self.0 = true;
    }

    fn signal(&mut self, _: TaskId, _: Signal) {
        self.0 = true;
    }
}
