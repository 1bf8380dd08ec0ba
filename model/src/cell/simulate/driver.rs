//! Decides the next move of a random run: a fault of the schedule if one is due, otherwise a choice.

mod who;

use super::schedule::{Chooser, Fault, Tape, in_order};
use crate::cell::run_state::{CellMove, OPEN, RunState, UNUSED};
use crate::cell_state::script::Running;
use imrs_protocol::{NodeId, TaskId};
use who::{Who, is_of_a_turn, who};

/// Where a run gets its choices.
#[derive(Clone, Copy, Debug)]
pub(super) enum Source<'a> {
    /// Random numbers, the same for the same seed.
    Seed(u64),
    /// A tape with the choices of an earlier run.
    Tape(&'a Tape),
}

/// How a number below a limit is drawn.
#[derive(Clone, Copy)]
enum Spread {
    /// Each alternative has the same chance.
    Even,
    /// Half of the draws choose the first or the last alternative, the others any alternative.
    Ends,
}

/// The choices of one chooser.
struct Choices {
    who: Chooser,
    random: fastrand::Rng,
    made: Vec<u32>,
}

/// The end that was chosen for an action: when the action ends.
struct Chosen {
    task: u8,
    level: u8,
    action: u16,
    /// The latest end of the action. It distinguishes two actions that follow each other in one activation.
    latest: u64,
    /// How many more times an action without an upper bound goes on.
    left: u32,
}

impl Chosen {
    /// Whether this end was chosen for the action that this activation runs now.
    fn is_of(&self, run_state: &RunState, (task, level): (u8, u8), running: &Running) -> bool {
        (self.task, self.level, self.action, self.latest)
            == (task, level, running.action, latest(run_state, running))
    }
}

/// The latest instant at which an action may end.
fn latest(run_state: &RunState, running: &Running) -> u64 {
    if running.most == Running::FOREVER { u64::MAX } else { run_state.passed + running.most.0 }
}

/// A directed link, with its packets.
#[derive(Clone, Copy, Default)]
struct Line {
    /// The number of packets that have arrived over the link.
    arrived: u32,
    /// The number of the packet for which an arrival was chosen last, and the age at which it arrives.
    chosen: Option<(u32, u32)>,
}

/// Decides the moves of one run.
pub(super) struct Driver<'a> {
    source: Source<'a>,
    /// The faults of the schedule, in the order in which the budgets number them.
    faults: Vec<Fault>,
    happened: Vec<bool>,
    /// The choices of each chooser: first the tasks, then the links, then the nodes.
    choices: Vec<Choices>,
    tasks: usize,
    lines: Vec<Line>,
    /// For each task, the number of its actions that have ended.
    ended: Vec<u32>,
    actions: Vec<Chosen>,
    /// For each node that is down, the instant from which it may restart.
    restarts: Vec<Option<u64>>,
    /// For each cut that has begun, the instant at which it ends.
    cuts: Vec<Option<u64>>,
}

impl<'a> Driver<'a> {
    pub fn new(faults: &[Fault], source: Source<'a>, start: &RunState) -> Self {
        let cell = start.plan.table.cell();
        let links = &start.cell.links;
        let tasks = (0..cell.tasks.len()).map(|task| Chooser::Task(TaskId::from_index(task)));
        let ends = links.iter().map(|&(from, to, _)| Chooser::Link(from, to));
        let nodes = (0..cell.nodes.len()).map(|node| Chooser::Node(NodeId::from_index(node)));
        let seed = match source {
            Source::Seed(seed) => seed,
            Source::Tape(_) => 0,
        };
        let own = |(number, who)| Choices { who, random: random(seed, number), made: Vec::new() };
        let faults = in_order(faults);
        Self {
            source,
            happened: vec![false; faults.len()],
            choices: (FIRST_OF_CHOOSERS..).zip(tasks.chain(ends).chain(nodes)).map(own).collect(),
            tasks: cell.tasks.len(),
            lines: vec![Line::default(); links.len()],
            ended: vec![0; cell.tasks.len()],
            actions: Vec::new(),
            restarts: vec![None; cell.nodes.len()],
            cuts: vec![None; faults.len()],
            faults,
        }
    }

    /// The choices that the run has made so far.
    pub fn tape(&self) -> Tape {
        let made = self.choices.iter().filter(|choices| !choices.made.is_empty());
        made.map(|choices| (choices.who, choices.made.clone())).collect()
    }

    /// For each directed link, the number of packets that arrived; for each task, the number of actions that ended.
    pub fn counts(&self) -> (Vec<u32>, Vec<u32>) {
        (self.lines.iter().map(|line| line.arrived).collect(), self.ended.clone())
    }

    /// For each fault of the schedule, in the order of [`in_order`], whether it happened.
    pub fn happened(self) -> Vec<bool> {
        self.happened
    }

    /// The next move, one of `moves`; `None` if the run is over.
    pub fn next(&mut self, run_state: &RunState, moves: &[CellMove]) -> Option<CellMove> {
        let step = if moves.iter().any(|step| is_of_a_turn(*step)) {
            self.in_turn(run_state, moves)
        } else {
            self.between(run_state, moves)
        }?;
        self.note(run_state, step);
        Some(step)
    }

    /// The next move if no node has anything to do in this tick.
    fn between(&mut self, run_state: &RunState, moves: &[CellMove]) -> Option<CellMove> {
        let now = run_state.passed;
        let waits = run_state.next_event().is_some();
        moves
            .iter()
            .copied()
            .find(|step| match *step {
                CellMove::Crash(number) => self.stop(number).is_some_and(|(_, at, _)| at <= now),
                CellMove::Restart(node) => self.is_back(node, if waits { now } else { u64::MAX }),
                CellMove::Drift(node, more) => self.drift(node, more, now).is_some(),
                CellMove::Wake(node) => run_state.must_wake(usize::from(node)),
                _ => self.pause(*step, now).is_some(),
            })
            .or_else(|| moves.iter().copied().find(|step| *step == CellMove::Pass))
    }

    /// The next move if a node has something to do in this tick.
    fn in_turn(&mut self, run_state: &RunState, moves: &[CellMove]) -> Option<CellMove> {
        if let Some(CellMove::Choose(task, _)) = moves.first() {
            let choice = self.draw(usize::from(*task), moves.len(), Spread::Even);
            return moves.get(choice as usize).copied();
        }
        let back = moves
            .iter()
            .copied()
            .find(|step| matches!(step, CellMove::Restart(node) if self.is_back(*node, run_state.passed)));
        if back.is_some() {
            return back;
        }
        let pauses = moves.iter().copied().find(|step| self.pause(*step, run_state.passed).is_some());
        if pauses.is_some() {
            return pauses;
        }
        let mut ready: Vec<Who> = Vec::new();
        let mut seen: Vec<Who> = Vec::new();
        let is_busy = moves.iter().any(|step| matches!(step, CellMove::Take(..) | CellMove::Begin(_)));
        for &step in moves {
            let Some(who) = who(run_state, step).filter(|who| !seen.contains(who)) else { continue };
            seen.push(who);
            if is_busy && !self.comes_now(run_state, who) {
                continue;
            }
            let waits = match who {
                Who::Action(task, level) => self.goes_on(run_state, moves, (task, level)),
                Who::Line(link) => self.stays(run_state, moves, link),
                Who::Input(_) => None,
            };
            if waits.is_some() {
                return waits;
            }
            ready.push(who);
        }
        let node = match *ready.first()? {
            Who::Action(task, _) => run_state.cell.node_state_of(usize::from(task)),
            Who::Line(link) => run_state.cell.links[link].1.index(),
            Who::Input(CellMove::Take(node, _) | CellMove::Begin(node)) => usize::from(node),
            Who::Input(_) => return None,
        };
        let first = self.draw(self.tasks + self.lines.len() + node, ready.len(), Spread::Even);
        match *ready.get(first as usize)? {
            Who::Action(task, level) => self.ends(moves, (task, level)),
            Who::Line(link) => self.comes(run_state, moves, link),
            Who::Input(step) => Some(step),
        }
    }

    /// Whether a move may be made while inputs wait in a node: an action ends at its chosen instant, or a packet
    /// arrives that has no fault or has another packet behind it.
    fn comes_now(&self, run_state: &RunState, who: Who) -> bool {
        match who {
            Who::Input(_) => true,
            Who::Action(task, level) => {
                let actor = run_state.cell.bodies[usize::from(task)].actor.as_ref();
                actor.and_then(|actor| actor.runs(level)).is_some_and(|running| {
                    let chosen = self.actions.iter().find(|of| of.is_of(run_state, (task, level), running));
                    running.most.is_zero() || chosen.is_some_and(|chosen| chosen.left == 0)
                })
            }
            Who::Line(link) => {
                let mut on = (0..run_state.cell.in_flight.len())
                    .filter(|&at| usize::from(run_state.cell.in_flight[at].link) == link);
                on.next().is_some_and(|first| run_state.cell.is_followed(first))
                    || !self.is_named(run_state, link)
            }
        }
    }

    /// Whether the schedule has a fault for a link's next packet at its bound: the packet is lost, doubled or cut off.
    fn is_named(&self, run_state: &RunState, link: usize) -> bool {
        let (from, to, _) = run_state.cell.links[link];
        let next = self.lines[link].arrived + 1;
        let is = |fault: &Fault| match *fault {
            Fault::Lose { link, nth } | Fault::Copy { link, nth } => link == (from, to) && nth == next,
            _ => false,
        };
        self.named(is).is_some() || self.cut(run_state, link).is_some()
    }

    /// The move that ends an action: a failure that the schedule names, or one of the action's results by choice.
    fn ends(&mut self, moves: &[CellMove], (task, level): (u8, u8)) -> Option<CellMove> {
        let at = usize::from(task);
        let next = self.ended[at] + 1;
        let fails = CellMove::Acted(task, level, false, 0);
        let is =
            |fault: &Fault| matches!(*fault, Fault::Fail { task, nth } if task.index() == at && nth == next);
        if let Some(fault) = self.named(is).filter(|_| moves.contains(&fails)) {
            self.happened[fault] = true;
            return Some(fails);
        }
        let ends =
            |step: &&CellMove| matches!(**step, CellMove::Acted(t, l, true, _) if (t, l) == (task, level));
        let value = self.draw(at, moves.iter().filter(ends).count(), Spread::Even);
        moves.iter().filter(ends).nth(value as usize).copied()
    }

    /// The move by which an action that may end now goes on; `None` if the action ends.
    fn goes_on(
        &mut self,
        run_state: &RunState,
        moves: &[CellMove],
        (task, level): (u8, u8),
    ) -> Option<CellMove> {
        let running = *run_state.cell.bodies[usize::from(task)].actor.as_ref()?.runs(level)?;
        if !moves.contains(&CellMove::GoOn(task, level)) {
            return None;
        }
        let endless = running.most == Running::FOREVER;
        let known = self.actions.iter_mut().find(|chosen| chosen.is_of(run_state, (task, level), &running));
        if let Some(chosen) = known {
            chosen.left = chosen.left.checked_sub(1)?;
            return Some(CellMove::GoOn(task, level));
        }
        self.actions.retain(|chosen| (chosen.task, chosen.level) != (task, level));
        // The action ends now, or a whole number of the plan's steps before its latest end.
        let step = run_state.plan.step.max(1);
        let most = u32::try_from(running.most.0).unwrap_or(u32::MAX);
        let first = most - (most.saturating_sub(1) / step) * step;
        let instants = if endless { ENDLESS } else { 2 + (most - first) / step };
        let number = self.draw(usize::from(task), instants as usize, Spread::Ends);
        let left = if endless { number } else { 0 };
        self.actions.push(Chosen {
            task,
            level,
            action: running.action,
            latest: latest(run_state, &running),
            left: left.saturating_sub(1),
        });
        match number {
            0 => None,
            _ if endless => Some(CellMove::GoOn(task, level)),
            _ => Some(CellMove::Takes(task, level, first + (number - 1) * step)),
        }
    }

    /// The move by which a packet that may arrive now stays on its link; `None` if the packet arrives.
    fn stays(&mut self, run_state: &RunState, moves: &[CellMove], link: usize) -> Option<CellMove> {
        let stays = CellMove::Stay(u8::try_from(link).ok()?);
        let first = run_state.cell.in_flight.iter().find(|carried| usize::from(carried.link) == link)?;
        if !moves.contains(&stays) {
            return None;
        }
        let (age, bound) = (u32::try_from(first.age.0).unwrap_or(u32::MAX), run_state.cell.links[link].2);
        (self.is_named(run_state, link) || age < self.arrives(link, (age, bound.into()))).then_some(stays)
    }

    /// The move for the first packet of a link: the packet arrives, or a fault happens to it.
    fn comes(&mut self, run_state: &RunState, moves: &[CellMove], link: usize) -> Option<CellMove> {
        let cell_state = &run_state.cell;
        let first = cell_state.in_flight.iter().position(|carried| usize::from(carried.link) == link)?;
        let (first, (from, to, _)) = (u8::try_from(first).ok()?, cell_state.links[link]);
        let next = self.lines[link].arrived + 1;
        let here = |of: (NodeId, NodeId), is: bool| of == (from, to) && is;
        let overtaken =
            self.named(|fault| matches!(*fault, Fault::Overtake { link, nth } if here(link, nth <= next)));
        let lost = self.named(|fault| matches!(*fault, Fault::Lose { link, nth } if here(link, nth == next)));
        let twice =
            self.named(|fault| matches!(*fault, Fault::Copy { link, nth } if here(link, nth == next)));
        let behind = moves.iter().copied().find(|step| {
            matches!(*step, CellMove::Deliver(i) if i != first && who(run_state, *step) == Some(Who::Line(link)))
        });
        let (step, fault) = match self.cut(run_state, link) {
            Some(Cut::Lasts) => (Some(CellMove::Vanish(first)), None),
            Some(Cut::Begins(number, fault)) => (Some(CellMove::Cut(first, number)), Some(fault)),
            None if overtaken.is_some() && behind.is_some() => (behind, overtaken),
            None if lost.is_some() => (Some(CellMove::Lose(first)), lost),
            None if twice.is_some() => (Some(CellMove::Duplicate(first)), twice),
            None => (None, None),
        };
        let allowed = step.filter(|step| moves.contains(step));
        if let (Some(step), fault) = (allowed, fault) {
            fault.into_iter().for_each(|fault| self.happened[fault] = true);
            return Some(step);
        }
        let arrives =
            |step: &CellMove| matches!(*step, CellMove::Deliver(i) | CellMove::Mend(i, _) if i == first);
        moves.iter().copied().find(arrives)
    }

    /// The age in ticks at which a packet arrives, if it may arrive before the link's bound.
    fn arrives(&mut self, link: usize, (age, bound): (u32, u32)) -> u32 {
        let nth = self.lines[link].arrived + 1;
        match self.lines[link].chosen {
            Some((of, age)) if of == nth => age,
            _ => {
                let early = bound.saturating_sub(age) as usize + 1;
                let early = self.draw(self.tasks + link, early, Spread::Ends);
                let age = bound.saturating_sub(early);
                self.lines[link].chosen = Some((nth, age));
                age
            }
        }
    }

    /// What the cuts of the schedule do to the packet at the end of a link.
    fn cut(&self, run_state: &RunState, link: usize) -> Option<Cut> {
        let cuts = (0_u8..).zip(self.faults.iter().enumerate().filter_map(|(fault, of)| match *of {
            Fault::Cut { link, at, .. } => Some((fault, link, at)),
            _ => None,
        }));
        let here = || cuts.clone().filter(|(_, (_, of, _))| *of == link / 2);
        let state = |number: u8| run_state.beside.cuts.get(usize::from(number)).copied();
        // While one cut of a link is open, no other cut of this link begins.
        if let Some((_, (fault, ..))) = here().find(|(number, _)| state(*number) == Some(OPEN)) {
            let over = self.cuts[fault].is_some_and(|over| over <= run_state.passed);
            return (!over).then_some(Cut::Lasts);
        }
        let (number, (fault, _, at)) = here().find(|(number, _)| state(*number) == Some(UNUSED))?;
        (at <= run_state.passed).then_some(Cut::Begins(number, fault))
    }

    /// The first fault of the schedule that has not happened and for which `is` holds.
    fn named(&self, is: impl Fn(&Fault) -> bool) -> Option<usize> {
        let mut all = self.faults.iter().zip(&self.happened);
        all.position(|(fault, happened)| !happened && is(fault))
    }

    /// The fault of the schedule for this declared crash: its position, its instant, and how long the node stays down.
    fn stop(&self, number: u8) -> Option<(usize, u64, Option<u64>)> {
        let stops = self.faults.iter().enumerate().filter_map(|(fault, of)| match *of {
            Fault::Stop { at, restart, .. } => Some((fault, at, restart)),
            _ => None,
        });
        stops.into_iter().nth(usize::from(number))
    }

    fn drift(&self, node: u8, more: bool, now: u64) -> Option<usize> {
        let is = |fault: &Fault| {
            matches!(*fault, Fault::Drift { node: of, at, more: how }
                if of.index() == usize::from(node) && how == more && at <= now)
        };
        self.named(is)
    }

    /// The fault of the schedule for this pause, if it is due.
    fn pause(&self, step: CellMove, now: u64) -> Option<usize> {
        let (number, before) = match step {
            CellMove::Pause(number, _) | CellMove::PauseNext(number, _) => (number, false),
            CellMove::PauseBefore(number, _) => (number, true),
            _ => return None,
        };
        let pauses = self.faults.iter().enumerate().filter_map(|(fault, of)| match *of {
            Fault::Pause { at, before_action, .. } => Some((fault, at, before_action)),
            _ => None,
        });
        let (fault, at, how) = pauses.into_iter().nth(usize::from(number))?;
        (at <= now && how == before).then_some(fault)
    }

    fn is_back(&self, node: u8, now: u64) -> bool {
        self.restarts[usize::from(node)].is_some_and(|due| due <= now)
    }

    /// Takes note of a move: updates the counts, and which faults happened.
    fn note(&mut self, run_state: &RunState, step: CellMove) {
        let line =
            |i: u8| run_state.cell.in_flight.get(usize::from(i)).map(|carried| usize::from(carried.link));
        match step {
            CellMove::Deliver(i)
            | CellMove::Lose(i)
            | CellMove::Duplicate(i)
            | CellMove::Vanish(i)
            | CellMove::Mend(i, _) => self.arrived(line(i)),
            CellMove::Cut(i, number) => {
                self.arrived(line(i));
                let mut cuts = self.faults.iter().enumerate().filter_map(|(fault, of)| match *of {
                    Fault::Cut { lasts, .. } => Some((fault, lasts)),
                    _ => None,
                });
                if let Some((fault, lasts)) = cuts.nth(usize::from(number)) {
                    self.cuts[fault] = lasts.map(|lasts| run_state.passed.saturating_add(lasts));
                }
            }
            CellMove::Acted(task, level, ..) => {
                self.ended[usize::from(task)] += 1;
                self.actions.retain(|chosen| (chosen.task, chosen.level) != (task, level));
            }
            CellMove::Crash(number) => {
                if let Some((fault, _, restart)) = self.stop(number) {
                    self.happened[fault] = true;
                    let due = restart.map(|after| run_state.passed.saturating_add(after));
                    self.restarts[run_state.crash_node(number)] = due;
                }
            }
            CellMove::Restart(node) => self.restarts[usize::from(node)] = None,
            CellMove::Drift(node, more) => {
                if let Some(fault) = self.drift(node, more, run_state.passed) {
                    self.happened[fault] = true;
                }
            }
            CellMove::Pause(..) | CellMove::PauseBefore(..) | CellMove::PauseNext(..) => {
                if let Some(fault) = self.pause(step, u64::MAX) {
                    self.happened[fault] = true;
                }
            }
            CellMove::Pass
            | CellMove::GoOn(..)
            | CellMove::Takes(..)
            | CellMove::Stay(_)
            | CellMove::Take(..)
            | CellMove::Begin(_)
            | CellMove::Choose(..)
            | CellMove::Wake(_) => {}
        }
    }

    fn arrived(&mut self, link: Option<usize>) {
        if let Some(line) = link.and_then(|link| self.lines.get_mut(link)) {
            line.arrived += 1;
        }
    }

    /// Makes a choice below `limit`. If there is only one alternative, no number of the tape is used.
    fn draw(&mut self, chooser: usize, limit: usize, spread: Spread) -> u32 {
        let most = u32::try_from(limit.saturating_sub(1)).unwrap_or(u32::MAX - 1);
        if most == 0 {
            return 0;
        }
        let choices = &mut self.choices[chooser];
        let choice = match (self.source, spread) {
            (Source::Tape(tape), _) => {
                let choice = tape.get(&choices.who).and_then(|tape| tape.get(choices.made.len()));
                choice.copied().unwrap_or(0).min(most)
            }
            (Source::Seed(_), Spread::Even) => choices.random.u32(..=most),
            (Source::Seed(_), Spread::Ends) => match choices.random.u8(..4) {
                0 => 0,
                1 => most,
                _ => choices.random.u32(..=most),
            },
        };
        choices.made.push(choice);
        choice
    }
}

/// A random run prolongs an action without an upper bound fewer times than this.
const ENDLESS: u32 = 4;
/// The random streams below this number are for drawing faults, the streams from it on for choosers.
pub(super) const FIRST_OF_CHOOSERS: u64 = 64;

/// The random stream with this number that belongs to a seed. Draws from one stream do not change the other streams.
pub(super) fn random(seed: u64, stream: u64) -> fastrand::Rng {
    // Each seed is the first number of another generator, so that neighbouring seeds and streams share no bits.
    let mut of_seed = fastrand::Rng::with_seed(seed);
    let mut of_stream = fastrand::Rng::with_seed(of_seed.u64(..) ^ stream);
    fastrand::Rng::with_seed(of_stream.u64(..))
}

/// What a cut does to the packet that is about to arrive.
enum Cut {
    /// The cut with this number begins with this packet, because of the fault at this position.
    Begins(u8, usize),
    /// A cut is open, so this packet is lost, too.
    Lasts,
}
