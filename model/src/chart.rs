//! A counterexample as a sequence chart: one lane a task, one line a step, at most 100 columns.

use crate::explore::Exploration;
use crate::network::Flight;
use crate::scenario::Scenario;
use crate::state::Packed;
use crate::world::{Action, World};
use imrs_protocol::{Control, Event, Kind, Observation, Outcome, Signal, TaskId};
use serde::Serialize;
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

/// The widest chart.
const COLUMNS: usize = 100;
/// Columns for the tick.
const MARGIN: usize = 6;

/// Draws the path of an exploration; `None` where it found no violation.
#[must_use]
pub fn draw(scenario: &Arc<Scenario>, exploration: &Exploration) -> Option<Counterexample> {
    let states = exploration.states_on_path.as_ref()?;
    let violation = exploration.violation?;
    let mut pen = Pen::new(scenario);
    let mut world = World::new(scenario);
    world.keep_log = true;
    let mut tick = 0;
    for target in states.iter().skip(1) {
        let (action, next) = concrete_step(&world, target)?;
        let flight = match action {
            Action::Deliver(i) | Action::Lose(i) | Action::Duplicate(i) => {
                world.flights.get(usize::from(i)).copied()
            }
            _ => None,
        };
        world = next;
        tick += u32::from(action == Action::Tick);
        pen.step(tick, action, flight.as_ref(), &world);
    }
    pen.conclude(violation.text());
    let length = u32::try_from(states.len().saturating_sub(1)).unwrap_or(u32::MAX);
    Some(Counterexample { length, steps: pen.steps, chart: pen.lines.join("\n") })
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
        (next.clone().store() == *target).then_some((action, next))
    })
}

struct Pen<'a> {
    scenario: &'a Scenario,
    lane: usize,
    steps: Vec<String>,
    lines: Vec<String>,
    last_tick: Option<u32>,
}

impl<'a> Pen<'a> {
    fn new(scenario: &'a Scenario) -> Self {
        let n = scenario.tasks();
        let lane = ((COLUMNS - MARGIN) / n).min(28);
        let mut pen = Self { scenario, lane, steps: Vec::new(), lines: Vec::new(), last_tick: None };
        let mut head = pen.empty(' ');
        for i in 0..n {
            pen.put(&mut head, pen.at(i), scenario.name(TaskId::from_index(i)));
        }
        pen.lines.push(format!("{:>MARGIN$}{}", "tick ", head.iter().collect::<String>().trim_end()));
        pen
    }

    const fn at(&self, task: usize) -> usize {
        task * self.lane
    }

    fn empty(&self, mark: char) -> Vec<char> {
        let n = self.scenario.tasks();
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

    fn event(&mut self, tick: u32, task: TaskId, text: &str) {
        let mut line = self.empty('|');
        self.put(&mut line, self.at(task.index()), &format!("* {text}"));
        self.line(tick, &line);
        self.steps.push(format!("tick {tick}: {} {text}", self.scenario.name(task)));
    }

    fn arrow(&mut self, tick: u32, flight: &Flight, fate: &str) {
        let packet = &flight.packet;
        let (from, to) = (packet.source.index(), packet.destination.index());
        let label = label(flight);
        let mut line = self.empty('|');
        let (left, right) = (self.at(from.min(to)), self.at(from.max(to)));
        for slot in &mut line[left + 1..right] {
            *slot = '-';
        }
        let text = if fate.is_empty() { format!(" {label} ") } else { format!(" {label} {fate} ") };
        let room = (right - left).saturating_sub(4);
        let text: String = text.chars().take(room).collect();
        self.put(&mut line, left + 2 + (room - text.chars().count()) / 2, &text);
        let lost = fate == "LOST";
        if from < to {
            line[right - 1] = if lost { 'x' } else { '>' };
        } else {
            line[left + 1] = if lost { 'x' } else { '<' };
        }
        self.line(tick, &line);
        let names = (self.scenario.name(packet.source), self.scenario.name(packet.destination));
        let verb = if fate.is_empty() { "arrives" } else { fate };
        self.steps.push(format!("tick {tick}: {label} from {} to {} {verb}", names.0, names.1));
    }

    fn step(&mut self, tick: u32, action: Action, flight: Option<&Flight>, world: &World) {
        match (action, flight) {
            (Action::Deliver(_), Some(flight)) => self.arrow(tick, flight, ""),
            (Action::Lose(_), Some(flight)) => self.arrow(tick, flight, "LOST"),
            (Action::Duplicate(_), Some(flight)) => self.arrow(tick, flight, "TWICE"),
            (Action::Crash(i), _) => self.event(tick, TaskId(u16::from(i)), "CRASHES"),
            (Action::Restart(i), _) => self.event(tick, TaskId(u16::from(i)), "restarts"),
            (Action::Heal, _) => {
                self.lines.push("      the faults stop here".into());
                self.steps.push(format!("tick {tick}: the faults stop"));
            }
            _ => {}
        }
        for (task, shown) in &world.log {
            let text = match shown {
                Shown::Seen(seen) => told(seen, self.scenario),
                Shown::Told(signal) => said(signal),
            };
            if let Some(text) = text {
                self.event(tick, *task, &text);
            }
        }
    }

    fn conclude(&mut self, text: &str) {
        self.lines.push(format!("      => {text}"));
        self.steps.push(format!("so {text}"));
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

fn label(flight: &Flight) -> String {
    let packet = &flight.packet;
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

fn told(seen: &Observation, scenario: &Scenario) -> Option<String> {
    let number = seen.number;
    let peer = || scenario.name(seen.peer);
    Some(match seen.event {
        Event::Reached => format!("reaches r{number}"),
        Event::Rejoined => format!("goes on to r{number}"),
        Event::ReleasedComplete => format!("RELEASED r{number} (all here)"),
        Event::ReleasedByConfirm => format!("RELEASED r{number} (told)"),
        Event::WithinMargin => "all here, but too late".into(),
        Event::GaveUp => format!("GIVES UP r{number}"),
        Event::Rejected => format!("rejects #{number}"),
        Event::Interrupted => format!("is interrupted by #{number}"),
        Event::Resumed => "goes on".into(),
        Event::Sent => format!("sends #{number}"),
        Event::Resent => format!("sends #{number} again"),
        Event::Replied => format!("answers #{number}"),
        Event::Delivered => format!("takes #{number} of {}", peer()),
        Event::TimedOut => format!("TIME_OUT of #{number}"),
        Event::TimedOutUnsent => format!("TIME_OUT of #{number}, unsent"),
        Event::Discarded(reason) => format!("drops #{number}: {}", reason.name()),
        Event::Enqueued
        | Event::Answered
        | Event::RefusedByPeer
        | Event::PeerRestarted
        | Event::PartnerArrived
        | Event::PartnerAborted
        | Event::Confirmed => return None,
    })
}

fn said(signal: &Signal) -> Option<String> {
    match signal {
        Signal::Outcome(Outcome::Reply(_)) => Some("gets the answer".into()),
        Signal::Outcome(Outcome::Refused) => Some("is refused".into()),
        Signal::Outcome(Outcome::PeerRestarted) => Some("hears of the restart".into()),
        _ => None,
    }
}
