//! A counterexample as a sequence chart: one lane a task, one line a step, at most 100 columns.

use crate::explore::Exploration;
use crate::network::Flight;
use crate::scenario::Scenario;
use crate::state::Packed;
use crate::world::{Action, World};
use imrs_protocol::{Control, Event, Kind, Observation, Outcome, Packet, Signal, TaskId};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A shortest way to a violation.
#[derive(Clone, Debug, Serialize)]
pub struct Counterexample {
    /// How many steps it has.
    pub length: u32,
    /// The steps in words.
    pub steps: Vec<String>,
    /// The steps as a sequence chart.
    pub chart: String,
}

/// A line of a chart, not yet drawn. Lanes are positions among the chart's names.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Note {
    /// Something happens at a lane.
    Event {
        /// Ticks since the start.
        tick: u32,
        /// Where.
        lane: usize,
        /// What.
        text: String,
    },
    /// A packet between two lanes.
    Packet {
        /// Ticks since the start.
        tick: u32,
        /// From this lane
        from: usize,
        /// to this one.
        to: usize,
        /// What it is.
        label: String,
        /// What became of it, where it did not simply arrive.
        fate: String,
    },
}

impl Note {
    /// The line in words, where the lanes have these names.
    pub(crate) fn words(&self, names: &[String]) -> String {
        let name = |lane: usize| names.get(lane).map_or("?", String::as_str);
        match self {
            Self::Event { lane, text, .. } => format!("{} {text}", name(*lane)),
            Self::Packet { from, to, label, fate, .. } => {
                let fate = match fate.as_str() {
                    "" => "arrives",
                    "LOST" => "is LOST",
                    "CUT OFF" => "is CUT OFF: its link is interrupted",
                    "TWICE" => "arrives, and a copy of it comes later",
                    "OVERTAKES" => "OVERTAKES one that was sent earlier",
                    other => other,
                };
                format!("{label} from {} to {} {fate}", name(*from), name(*to))
            }
        }
    }
}

/// The widest chart.
const COLUMNS: usize = 100;
/// Columns for the tick.
const MARGIN: usize = 6;

/// Draws the path of an exploration; `None` where it found no violation.
#[must_use]
pub fn draw(scenario: &Arc<Scenario>, exploration: &Exploration) -> Option<Counterexample> {
    let states = exploration.states_on_path.as_ref()?;
    let violation = exploration.violation?;
    let length = u32::try_from(states.len().saturating_sub(1)).unwrap_or(u32::MAX);
    Some(walk(scenario, states)?.conclude(violation.text(), length))
}

/// Draws a path. `None` where its states do not follow from each other.
pub(crate) fn walk(scenario: &Arc<Scenario>, states: &[Packed]) -> Option<Pen> {
    let mut pen = pen(scenario);
    let mut world = World::new(scenario);
    world.keep_log = true;
    let mut tick = 0;
    for target in states.iter().skip(1) {
        let (action, next) = concrete_step(&world, target)?;
        let flight = flight_of(&world, action);
        world = next;
        tick += u32::from(matches!(action, Action::Tick | Action::Late(_)));
        pen.step(tick, action, flight.as_ref(), &world);
    }
    Some(pen)
}

fn pen(scenario: &Scenario) -> Pen {
    let name = |i| scenario.name(TaskId::from_index(i)).to_string();
    Pen::new((0..scenario.tasks()).map(name).collect())
}

/// The packet that an action is about.
fn flight_of(world: &World, action: Action) -> Option<Flight> {
    match action {
        Action::Deliver(i) | Action::Overcharge(i, _) | Action::Lose(i) | Action::Duplicate(i) => {
            world.flights.get(usize::from(i)).copied()
        }
        _ => None,
    }
}

/// One step from a packed state, drawn. Members have the places that the state gives them.
pub(crate) fn one_step(scenario: &Arc<Scenario>, state: &Packed, action: Action) -> Pen {
    let (mut pen, mut world) = (pen(scenario), World::new(scenario));
    world.load(state, None);
    world.keep_log = true;
    world.log.clear();
    let flight = flight_of(&world, action);
    world.apply(action);
    pen.step(0, action, flight.as_ref(), &world);
    pen
}

/// The step of `world` whose canonical result is `target`. States on a path name members by their sorted position; the
/// chart must keep everybody's name, so the path is walked again with the names kept.
fn concrete_step(world: &World, target: &Packed) -> Option<(Action, World)> {
    let mut actions = Vec::new();
    world.actions(&mut actions);
    actions.into_iter().find_map(|action| {
        let mut next = world.clone();
        next.log.clear();
        next.apply(action);
        next.tidy();
        let mut stored = next.clone();
        (stored.store() == *target).then(|| {
            next.reorder(&stored.named);
            (action, next)
        })
    })
}

/// Draws one lane for each name.
pub(crate) struct Pen {
    names: Vec<String>,
    lane: usize,
    steps: Vec<String>,
    lines: Vec<String>,
    last_tick: Option<u32>,
    /// What was drawn.
    pub notes: Vec<Note>,
}

impl Pen {
    pub fn new(names: Vec<String>) -> Self {
        let lane = ((COLUMNS - MARGIN) / names.len()).min(28);
        let mut pen =
            Self { names, lane, steps: Vec::new(), lines: Vec::new(), last_tick: None, notes: Vec::new() };
        let mut head = pen.empty(' ');
        for i in 0..pen.names.len() {
            pen.put(&mut head, pen.at(i), &pen.names[i]);
        }
        pen.lines.push(format!("{:>MARGIN$}{}", "tick ", head.iter().collect::<String>().trim_end()));
        pen
    }

    /// Whose lanes are drawn.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    const fn at(&self, lane: usize) -> usize {
        lane * self.lane
    }

    fn empty(&self, mark: char) -> Vec<char> {
        let n = self.names.len();
        let mut line = vec![' '; (n * self.lane).min(COLUMNS - MARGIN)];
        for i in 0..n {
            line[i * self.lane] = mark;
        }
        line
    }

    fn put(&self, line: &mut [char], at: usize, text: &str) {
        for (slot, c) in line.iter_mut().skip(at).zip(text.chars()) {
            *slot = c;
        }
    }

    fn line(&mut self, tick: u32, line: &[char]) {
        let shown = if self.last_tick == Some(tick) { String::new() } else { tick.to_string() };
        self.last_tick = Some(tick);
        let text: String = line.iter().collect();
        self.lines.push(format!("{shown:>4}  {}", text.trim_end()));
    }

    pub fn event(&mut self, tick: u32, lane: usize, text: &str) {
        let mut line = self.empty('|');
        self.put(&mut line, self.at(lane), &format!("* {text}"));
        self.line(tick, &line);
        self.notes.push(Note::Event { tick, lane, text: text.into() });
        self.steps.push(format!("tick {tick}: {} {text}", self.names[lane]));
    }

    /// A packet between two lanes.
    pub fn arrow(&mut self, tick: u32, (from, to): (usize, usize), packet: &Packet, fate: &str) {
        let label = label(packet);
        self.notes.push(Note::Packet { tick, from, to, label: label.clone(), fate: fate.into() });
        let mut line = self.empty('|');
        let (left, right) = (self.at(from.min(to)), self.at(from.max(to)));
        for slot in &mut line[left + 1..right] {
            *slot = '-';
        }
        let text = if fate.is_empty() { format!(" {label} ") } else { format!(" {label} {fate} ") };
        let room = (right - left).saturating_sub(4);
        let text: String = text.chars().take(room).collect();
        self.put(&mut line, left + 2 + (room - text.chars().count()) / 2, &text);
        let lost = matches!(fate, "LOST" | "CUT OFF");
        if from < to {
            line[right - 1] = if lost { 'x' } else { '>' };
        } else {
            line[left + 1] = if lost { 'x' } else { '<' };
        }
        self.line(tick, &line);
        let verb = if fate.is_empty() { "arrives" } else { fate };
        self.steps
            .push(format!("tick {tick}: {label} from {} to {} {verb}", self.names[from], self.names[to]));
    }

    fn step(&mut self, tick: u32, action: Action, flight: Option<&Flight>, world: &World) {
        let charged;
        let fate = match action {
            Action::Deliver(_) => Some(""),
            Action::Overcharge(_, extra) => {
                charged = format!("CHARGED +{extra}");
                Some(charged.as_str())
            }
            Action::Lose(_) => Some("LOST"),
            Action::Duplicate(_) => Some("TWICE"),
            _ => None,
        };
        if let (Some(fate), Some(Flight { packet, .. })) = (fate, flight) {
            self.arrow(tick, (packet.source.index(), packet.destination.index()), packet, fate);
        }
        match action {
            Action::Late(i) => self.event(tick, usize::from(i), "LATE TIMER"),
            Action::Crash(i) => self.event(tick, usize::from(i), "CRASHES"),
            Action::Restart(i) => self.event(tick, usize::from(i), "restarts"),
            Action::Heal => {
                self.lines.push("      the faults stop here".into());
                self.steps.push(format!("tick {tick}: the faults stop"));
            }
            _ => {}
        }
        for (task, shown) in &world.log {
            self.shown(tick, task.index(), shown);
        }
    }

    /// What a step showed about a task.
    pub fn shown(&mut self, tick: u32, lane: usize, shown: &Shown) {
        let text = match shown {
            Shown::Seen(seen) => self.told(seen),
            Shown::Told(signal) => said(signal),
        };
        if let Some(text) = text {
            self.event(tick, lane, &text);
        }
    }

    pub fn conclude(mut self, text: &str, length: u32) -> Counterexample {
        self.lines.push(format!("      => {text}"));
        self.steps.push(format!("so {text}"));
        Counterexample { length, steps: self.steps, chart: self.lines.join("\n") }
    }

    fn told(&self, seen: &Observation) -> Option<String> {
        let number = seen.number;
        let peer = || self.names.get(seen.peer.index()).map_or("?", String::as_str);
        Some(match seen.event {
            Event::Reached => format!("reaches r{number}"),
            Event::Rejoined => format!("goes on to r{number}"),
            Event::ReleasedComplete => format!("RELEASED r{number} (all here)"),
            Event::ReleasedByConfirm => format!("RELEASED r{number} (told)"),
            Event::WithinMargin => "all here, but too late".into(),
            Event::GaveUp => format!("GIVES UP r{number}"),
            Event::Sent => format!("sends #{number}"),
            Event::Resent => format!("sends #{number} again"),
            Event::Replied => format!("answers #{number}"),
            Event::Delivered => format!("takes #{number} of {}", peer()),
            Event::TimedOut => format!("TIME_OUT of #{number}"),
            Event::TimedOutUnsent => format!("TIME_OUT of #{number}, unsent"),
            Event::Rejected => format!("rejects #{number} of {}", peer()),
            Event::Resumed => "goes on".into(),
            Event::Granted => format!("ACTS in epoch {number}"),
            Event::TookOver => format!("TAKES OVER in epoch {number}"),
            Event::Fenced => "is FENCED".into(),
            Event::Discarded(reason) => format!("drops #{number}: {}", reason.name()),
            Event::Interrupted
            | Event::Enqueued
            | Event::Answered
            | Event::RefusedByPeer
            | Event::PeerRestarted
            | Event::PartnerArrived
            | Event::PartnerAborted
            | Event::Confirmed => return None,
        })
    }
}

/// What a step showed about a task.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Shown {
    /// An observation of its communication task.
    Seen(Observation),
    /// An answer to the task.
    Told(Signal),
}

/// A packet in a word and its number.
pub(crate) fn label(packet: &Packet) -> String {
    let round = || packet.meeting().round;
    let number = packet.id.sequence.get();
    match packet.kind {
        Kind::Send => format!("SEND #{number}"),
        Kind::Query => format!("QUERY #{number}"),
        Kind::Reply => format!("REPLY #{number}"),
        Kind::Response => format!("RESPONSE #{number}"),
        Kind::Arrive => format!("ARRIVE {}", round()),
        Kind::Confirm => format!("CONFIRM {}", round()),
        Kind::Abort => format!("ABORT {} go on with {}", round(), packet.meeting().next_round()),
        Kind::Control => match packet.control() {
            Some(Control::Refused) => format!("REFUSED #{number}"),
            Some(Control::RefusedOnTheWay) => format!("REFUSED ON THE WAY #{number}"),
            Some(Control::Restarted) => format!("RESTARTED #{number}"),
            Some(Control::Probe) => "PROBE".into(),
            None => "CONTROL".into(),
        },
    }
}

fn said(signal: &Signal) -> Option<String> {
    match signal {
        Signal::Outcome(Outcome::Reply(_)) => Some("gets the answer".into()),
        Signal::Outcome(Outcome::Refused) => Some("is refused".into()),
        Signal::Outcome(Outcome::PeerRestarted) => Some("hears of the restart".into()),
        Signal::Interrupt(_) => Some("is interrupted".into()),
        Signal::Fault(fault) => Some(format!("is told of a fault: {fault:?}")),
        _ => None,
    }
}
