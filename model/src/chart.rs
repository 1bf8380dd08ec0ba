//! Counterexamples as sequence charts, which show in words what happened at which tasks.

mod draw;

pub use draw::{Folding, chart};

use crate::explore::Exploration;
use crate::network::InFlight;
use crate::scenario::Scenario;
use crate::state::Packed;
use crate::world::{Action, Shown, World};
use imrs_protocol::{Call, Control, Event, Kind, Observation, Outcome, Packet, PortId, Signal, TaskId};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A shortest path to a violation of a claim.
#[derive(Clone, Debug, Serialize)]
pub struct Counterexample {
    /// How many steps the path has.
    pub length: u32,
    /// The steps in words.
    pub steps: Vec<String>,
    /// The steps as a sequence chart.
    pub chart: String,
}

/// A line of a chart that is not drawn yet. Lanes are positions among the chart's names.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Note {
    /// Something happens at one task, and is drawn on the task's lane.
    Event {
        /// Ticks since the start of the path.
        tick: u32,
        /// The number of the lane in which the event is drawn.
        lane: usize,
        /// What happens in the lane, in words.
        text: String,
        /// The line of the cell's source text to which the event belongs, from 1.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        line: Option<u32>,
    },
    /// A packet between two lanes.
    Packet {
        /// Ticks since the start of the path.
        tick: u32,
        /// The lane of the sender.
        from: usize,
        /// The lane of the receiver.
        to: usize,
        /// The packet in words.
        label: String,
        /// What became of the packet; empty if it simply arrived.
        #[serde(rename = "fate")]
        outcome: String,
        /// The line of the cell's source text that sent the packet, from 1.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        line: Option<u32>,
    },
    /// Something happens that belongs to no lane.
    Remark {
        /// Ticks since the start of the path.
        tick: u32,
        /// What happens, in words.
        text: String,
    },
}

impl Note {
    /// Ticks from the start of the path to this note.
    pub(crate) const fn tick(&self) -> u32 {
        let (Self::Event { tick, .. } | Self::Packet { tick, .. } | Self::Remark { tick, .. }) = self;
        *tick
    }

    /// The line of the cell's source text to which the note belongs; `None` if it belongs to no line.
    pub(crate) const fn line(&self) -> Option<u32> {
        match self {
            Self::Event { line, .. } | Self::Packet { line, .. } => *line,
            Self::Remark { .. } => None,
        }
    }

    /// Adds to the note the line `of` of the cell's source text, and the values, which are written behind the note's words.
    pub(crate) fn explain(&mut self, of: Option<u32>, values: Option<&str>) {
        let (Self::Event { text, line, .. } | Self::Packet { label: text, line, .. }) = self else { return };
        *line = of;
        if let Some(values) = values {
            text.push(' ');
            text.push_str(values);
        }
    }

    /// The note in words, with these names for the lanes.
    pub(crate) fn words(&self, names: &[String]) -> String {
        let name = |lane: usize| names.get(lane).map_or("?", String::as_str);
        match self {
            Self::Event { lane, text, .. } => format!("{} {text}", name(*lane)),
            Self::Packet { from, to, label, outcome, .. } => {
                let outcome = if outcome.is_empty() { "arrives" } else { outcome_words(outcome) };
                format!("{label} from {} to {} {outcome}", name(*from), name(*to))
            }
            Self::Remark { text, .. } => text.clone(),
        }
    }
}

/// Words for the outcome of a packet.
fn outcome_words(outcome: &str) -> &str {
    match outcome {
        "LOST" => "is LOST",
        "CUT OFF" => "is CUT OFF: its link is interrupted",
        "TWICE" => "arrives, and a copy of it comes later",
        "OVERTAKES" => "OVERTAKES one that was sent earlier",
        other => other,
    }
}

/// Draws the path to the violation that an exploration found; `None` if the exploration found no violation.
#[must_use]
pub fn draw(scenario: &Arc<Scenario>, exploration: &Exploration) -> Option<Counterexample> {
    conclude(exploration, |states| walk(scenario, states))
}

/// Draws the path to the violation that an exploration found, with `walk` as the recorder of its steps; `None` if the
/// exploration found no violation.
pub(crate) fn conclude<A>(
    exploration: &Exploration<A>,
    walk: impl FnOnce(&[Packed]) -> Option<ChartRecorder>,
) -> Option<Counterexample> {
    let states = exploration.states_on_path.as_ref()?;
    let violation = exploration.violation?;
    let length = u32::try_from(states.len().saturating_sub(1)).unwrap_or(u32::MAX);
    Some(walk(states)?.conclude(violation.text(), length))
}

/// Records a path as notes. `None` if one of its states does not follow from the one before.
pub(crate) fn walk(scenario: &Arc<Scenario>, states: &[Packed]) -> Option<ChartRecorder> {
    let mut recorder = recorder(scenario);
    let mut world = World::new(scenario);
    world.keep_log = true;
    let mut tick = 0;
    for target in states.iter().skip(1) {
        let (action, next) = concrete_step(&world, target)?;
        let carried = carried_by(&world, action);
        world = next;
        tick += u32::from(matches!(action, Action::Tick | Action::Late(_)));
        recorder.step(tick, action, carried.as_ref(), &world);
    }
    Some(recorder)
}

fn recorder(scenario: &Scenario) -> ChartRecorder {
    let name = |i| scenario.name(TaskId::from_index(i)).to_string();
    ChartRecorder::new((0..scenario.tasks()).map(name).collect())
}

/// The packet that a move of the checker delivers, loses, charges too much or duplicates; `None` for other moves.
fn carried_by(world: &World, action: Action) -> Option<InFlight> {
    match action {
        Action::Deliver(i) | Action::Overcharge(i, _) | Action::Lose(i) | Action::Duplicate(i) => {
            world.in_flight.get(usize::from(i)).copied()
        }
        _ => None,
    }
}

/// Records one step from a packed state. In the chart each member has the lane of its position in that state.
pub(crate) fn one_step(scenario: &Arc<Scenario>, state: &Packed, action: Action) -> ChartRecorder {
    let (mut recorder, mut world) = (recorder(scenario), World::new(scenario));
    world.load(state, None);
    world.keep_log = true;
    world.log.clear();
    let carried = carried_by(&world, action);
    world.apply(action);
    recorder.step(0, action, carried.as_ref(), &world);
    recorder
}

/// The step of `world` whose canonical result is `target`. In the states of a path the members are sorted, but in a chart
/// each member must keep its name. So the chart replays the path without sorting members.
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

/// Records a run as notes, with a lane for each name.
pub(crate) struct ChartRecorder {
    names: Vec<String>,
    /// The names of the ports, in the order of their ids; empty if notes name no ports.
    ports: Vec<String>,
    /// The names of each task's timers, in the order of the tasks; empty if notes name no timers.
    timers: Vec<Vec<String>>,
    /// The notes recorded so far.
    pub notes: Vec<Note>,
}

impl ChartRecorder {
    pub const fn new(names: Vec<String>) -> Self {
        Self { names, ports: Vec::new(), timers: Vec::new(), notes: Vec::new() }
    }

    /// Lets notes name the port of each message and the name of a timer that ends.
    pub fn naming(self, ports: Vec<String>, timers: Vec<Vec<String>>) -> Self {
        Self { ports, timers, ..self }
    }

    /// The names of the lanes.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// The names of the ports.
    pub fn ports(&self) -> &[String] {
        &self.ports
    }

    /// Adds an event at a lane. An event that only repeats the previous note is left out.
    pub fn event(&mut self, tick: u32, lane: usize, text: &str) {
        let same = |note: &Note| matches!(note, Note::Event { tick: t, lane: l, text: x, .. } if (*t, *l, &x[..]) == (tick, lane, text));
        if !self.notes.last().is_some_and(same) {
            self.notes.push(Note::Event { tick, lane, text: text.into(), line: None });
        }
    }

    /// Adds a packet between two lanes.
    pub fn arrow(&mut self, tick: u32, (from, to): (usize, usize), packet: &Packet, outcome: &str) {
        let label = label(packet, &self.ports);
        self.notes.push(Note::Packet { tick, from, to, label, outcome: outcome.into(), line: None });
    }

    fn step(&mut self, tick: u32, action: Action, carried: Option<&InFlight>, world: &World) {
        let charged;
        let outcome = match action {
            Action::Deliver(_) => Some(""),
            Action::Overcharge(_, extra) => {
                charged = format!("CHARGED +{extra}");
                Some(charged.as_str())
            }
            Action::Lose(_) => Some("LOST"),
            Action::Duplicate(_) => Some("TWICE"),
            _ => None,
        };
        if let (Some(outcome), Some(InFlight { packet, .. })) = (outcome, carried) {
            self.arrow(tick, (packet.source.index(), packet.destination.index()), packet, outcome);
        }
        match action {
            Action::Late(i) => self.event(tick, usize::from(i), "LATE TIMER"),
            Action::Crash(i) => self.event(tick, usize::from(i), "CRASHES"),
            Action::Restart(i) => self.event(tick, usize::from(i), "restarts"),
            Action::Heal => self.notes.push(Note::Remark { tick, text: "the faults stop here".into() }),
            _ => {}
        }
        for (task, shown) in &world.log {
            self.shown(tick, task.index(), shown);
        }
    }

    /// Adds notes for what a step showed about a task.
    pub fn shown(&mut self, tick: u32, lane: usize, shown: &Shown) {
        let text = match shown {
            Shown::Seen(seen) => self.told(seen),
            Shown::Signalled(signal) => {
                said(signal, &self.ports, self.timers.get(lane).map_or(&[], Vec::as_slice))
            }
        };
        if let Some(text) = text {
            self.event(tick, lane, &text);
        }
    }

    pub fn conclude(self, text: &str, length: u32) -> Counterexample {
        let step = |note: &Note| format!("tick {}: {}", note.tick(), note.words(&self.names));
        let steps = self.notes.iter().map(step).chain([format!("so {text}")]).collect();
        let drawn = chart(&self.names, &self.notes, text, Folding::Repeats);
        Counterexample { length, steps, chart: drawn }
    }

    fn told(&self, seen: &Observation) -> Option<String> {
        let number = seen.number;
        let message = || named(seen.port, &self.ports, format_args!("#{number}"));
        let meeting = || named(seen.port, &self.ports, format_args!("round {number}"));
        let peer = || self.names.get(seen.peer.index()).map_or("?", String::as_str);
        Some(match seen.event {
            Event::Reached => format!("reaches {}", meeting()),
            Event::Rejoined => format!("goes on to {}", meeting()),
            Event::ReleasedComplete => format!("RELEASED {} (all here)", meeting()),
            Event::ReleasedByConfirm => format!("RELEASED {} (told)", meeting()),
            Event::WithinMargin => "all here, but too late".into(),
            Event::GaveUp => format!("GIVES UP {}", meeting()),
            Event::Sent => format!("sends {}", message()),
            Event::Resent => format!("sends {} again", message()),
            Event::Replied => format!("answers {}", message()),
            Event::Delivered => format!("takes {} of {}", message(), peer()),
            Event::TimedOut => format!("TIME_OUT of {}", message()),
            Event::TimedOutUnsent => format!("TIME_OUT of {}, unsent", message()),
            Event::Rejected => format!("rejects {} of {}", message(), peer()),
            Event::Resumed => "goes on".into(),
            Event::Granted => format!("ACTS in epoch {number}"),
            Event::TookOver => format!("TAKES OVER in epoch {number}"),
            Event::Fenced => "is FENCED: its lease is lost".into(),
            Event::Discarded(reason) => format!("drops {}: {}", message(), reason.name()),
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

/// A message or a round as text, with the name of its port if ports have names.
fn named(port: PortId, ports: &[String], what: std::fmt::Arguments<'_>) -> String {
    match ports.get(port.index()) {
        Some(name) => format!("{name} {what}"),
        None => what.to_string(),
    }
}

/// A packet in words: its kind, its port if ports have names, and its number.
pub(crate) fn label(packet: &Packet, ports: &[String]) -> String {
    let number = packet.id.sequence.get();
    let message = |kind: &str| format!("{kind} {}", named(packet.port, ports, format_args!("#{number}")));
    let meeting = |kind: &str| {
        let round = packet.meeting().round.0;
        format!("{kind} {}", named(packet.port, ports, format_args!("round {round}")))
    };
    match packet.kind {
        Kind::Send => message("SEND"),
        Kind::Query => message("QUERY"),
        Kind::Reply => message("REPLY"),
        Kind::Response => message("RESPONSE"),
        Kind::Arrive => meeting("ARRIVE"),
        Kind::Confirm => meeting("CONFIRM"),
        Kind::Abort => format!("{}, go on with {}", meeting("ABORT"), packet.meeting().next_round().0),
        Kind::Control => match packet.control() {
            Some(Control::Refused) => message("REFUSED"),
            Some(Control::RefusedOnTheWay) => message("REFUSED ON THE WAY"),
            Some(Control::Restarted) => message("RESTARTED"),
            None => "CONTROL".into(),
        },
    }
}

/// A signal to a task, in words; `None` if charts leave it out.
fn said(signal: &Signal, ports: &[String], timers: &[String]) -> Option<String> {
    match signal {
        Signal::Outcome(Outcome::Reply(_)) => Some("gets the answer".into()),
        Signal::Outcome(Outcome::Refused) => Some("is refused".into()),
        Signal::Outcome(Outcome::PeerRestarted) => Some("gets notice of the restart".into()),
        Signal::Interrupt(Call::Message(delivery)) => Some(match ports.get(delivery.from.port.index()) {
            Some(name) => format!("{name} arrives, its handler runs"),
            None => "is interrupted".into(),
        }),
        Signal::Interrupt(Call::Timer(timer)) => Some(match timers.get(usize::from(timer.0)) {
            Some(name) => format!("timer {name} ends, its handler runs"),
            None => "a timer ends, its handler runs".into(),
        }),
        // The previous event already says whether the task is fenced or takes over.
        Signal::Interrupt(Call::Fenced | Call::TakeOver(_)) => Some("is interrupted".into()),
        Signal::Fault(fault) => Some(format!("gets an error: {fault}")),
        _ => None,
    }
}
