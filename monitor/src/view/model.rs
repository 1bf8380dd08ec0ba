//! Screen 7: the conformance of each node, and the coverage of transitions (D63).

use super::canvas::{Canvas, bar, columns, fit};
use super::words::short;
use crate::app::App;
use crate::clock::Moment;
use crate::drawn::Hit;
use crate::name::Name;
use crate::store::NodeIncarnation;
use crate::store::conformance::{Verdict, conformance};
use crate::store::coverage::{Abilities, KINDS};
use crate::store::health::Place;
use crate::store::timeline::timeline_of;
use crate::store::trail::{KEPT, Trail};
use crate::theme::Ink;
use imrs_protocol::{Event, TaskId};

/// How many observations are shown below a violation.
const BEFORE: usize = 20;

pub(super) type Line = Vec<(String, Ink)>;

pub(super) fn draw(app: &App, now: Moment, canvas: &mut Canvas<'_>) {
    let (lines, places) = lines(app, now, canvas.area.width.saturating_sub(1));
    let room = usize::from(canvas.height());
    let (window, selected) =
        canvas.chosen(app.scroll, room, places.into_iter().map(|place| place.map(Hit::Place)).collect());
    let canvas = &mut canvas.beside_scrollbar(0, window);
    for (y, (at, line)) in (0..).zip(lines.iter().enumerate().skip(window.first).take(room)) {
        let pieces: Vec<_> = line.iter().map(|(text, ink)| (text.as_str(), *ink)).collect();
        canvas.line(y, &pieces);
        canvas.line_of(y, at, selected);
    }
}

/// All lines of the screen. For each line, the node or task that it is about.
fn lines(app: &App, now: Moment, width: u16) -> (Vec<Line>, Vec<Option<Place>>) {
    let Some(cell) = app.cell() else { return (Vec::new(), Vec::new()) };
    let store = app.store();
    let (mut lines, mut places): (Vec<Line>, Vec<_>) = (Vec::new(), vec![None]);
    let mut whole = Sum::default();
    for incarnation in store.present(&cell) {
        if !lines.is_empty() {
            lines.push(Vec::new());
            places.push(None);
        }
        let place = Place { node: Ok(incarnation.id), task: None, port: None };
        node(app, incarnation, now, width, &mut lines);
        places.resize(lines.len() + 1, Some(place));
        for task in incarnation.tasks() {
            let sum = Sum::of(store.trail(), incarnation, task.view.task);
            whole.add(&sum);
            coverage(app, incarnation, task.view.task, &sum, width, &mut lines);
            places.resize(lines.len() + 1, Some(Place { task: Some(task.view.task), ..place }));
        }
    }
    let (fired, possible) = (whole.fired.len(), whole.fired.len() + whole.never.len());
    let percent = (fired * 100).checked_div(possible).unwrap_or(0);
    let head = format!(" {fired} of {possible} transition kinds seen ({percent}%)");
    lines.insert(0, vec![(head, Ink::Head), ("  since the monitor attached; with counts".into(), Ink::Dim)]);
    (lines, places)
}

/// The validator's verdict on the recorded inputs of a node.
fn node(app: &App, incarnation: &NodeIncarnation, now: Moment, width: u16, lines: &mut Vec<Line>) {
    let told = conformance(app.store(), incarnation.id);
    let gone = incarnation.presence(now).is_gone();
    let sign = if gone { app.theme.glyphs.dead } else { " " };
    let (word, ink, rest) = match &told.verdict {
        Verdict::Unknown { why } => ("UNKNOWN", Ink::Warn, crate::name::shown_line(why)),
        Verdict::Conforms => ("conforms", Ink::Good, String::new()),
        Verdict::Violates { step, what } => {
            ("VIOLATES", Ink::Bad, format!("at step {step}: {}", crate::name::shown_line(what)))
        }
    };
    let steps = if told.steps > 0 { format!("  {} steps checked", told.steps) } else { String::new() };
    lines.push(vec![
        (format!("{sign}{}", incarnation.node), Ink::Head),
        (format!("  {word}"), ink),
        (steps, Ink::Plain),
    ]);
    wrapped(
        "   ",
        rest.split(' ').map(str::to_owned),
        " ",
        if ink == Ink::Bad { ink } else { Ink::Dim },
        width,
        lines,
    );
    if matches!(told.verdict, Verdict::Violates { .. }) {
        lines.push(vec![(format!("   the last {BEFORE} that was observed:"), Ink::Dim)]);
        let timeline = timeline_of(app.store(), &incarnation.names.cell, KEPT, |_| true);
        let own: Vec<_> = timeline.marks.iter().filter(|mark| mark.incarnation == incarnation.id).collect();
        for mark in own.iter().skip(own.len().saturating_sub(BEFORE)) {
            let task = incarnation.names.task(mark.task);
            let text = format!("     {} {}", padded(&task), short(mark, &incarnation.names, &app.theme));
            lines.push(vec![(text, super::words::ink(mark.seen.what.event))]);
        }
    }
    if incarnation.lost > 0 {
        let text = format!("   {} observations lost: what they were is not counted", incarnation.lost);
        lines.push(vec![(text, Ink::Warn)]);
    }
}

/// The kinds of transition of a task: those that were observed, and possible ones that were never observed.
#[derive(Default)]
struct Sum {
    fired: Vec<(Event, u64)>,
    never: Vec<Event>,
}

impl Sum {
    fn of(trail: &Trail, incarnation: &NodeIncarnation, task: TaskId) -> Self {
        let counts = trail.fired(incarnation.id, Some(task));
        let mut sum = Self::default();
        let Some(snapshot) = incarnation.task(task) else { return sum };
        let abilities = Abilities::of(&snapshot.view);
        for (at, kind) in KINDS.into_iter().enumerate() {
            match counts.and_then(|counts| counts.get(at)).copied().unwrap_or(0) {
                0 if abilities.allow(kind) => sum.never.push(kind),
                0 => {}
                count => sum.fired.push((kind, count)),
            }
        }
        sum
    }

    /// Adds the kinds of another task. A kind that any of the tasks showed counts once.
    fn add(&mut self, other: &Self) {
        for &(kind, count) in &other.fired {
            self.never.retain(|never| *never != kind);
            match self.fired.iter_mut().find(|(known, _)| *known == kind) {
                Some((_, sum)) => *sum = sum.saturating_add(count),
                None => self.fired.push((kind, count)),
            }
        }
        for &kind in &other.never {
            if !self.never.contains(&kind) && !self.fired.iter().any(|(known, _)| *known == kind) {
                self.never.push(kind);
            }
        }
    }
}

fn coverage(
    app: &App,
    incarnation: &NodeIncarnation,
    task: TaskId,
    sum: &Sum,
    width: u16,
    lines: &mut Vec<Line>,
) {
    let (fired, all) = (sum.fired.len() as u64, (sum.fired.len() + sum.never.len()) as u64);
    lines.push(vec![
        (format!("   {} ", padded(&incarnation.names.task(task))), Ink::Plain),
        (format!("{fired:2}/{all:2} "), Ink::Plain),
        (format!("[{}]", bar(&app.theme, if width < 60 { 10 } else { 20 }, fired, all)), Ink::Bar),
    ]);
    let seen = sum.fired.iter().map(|(kind, count)| format!("{} {count}", name(*kind)));
    wrapped("     seen:  ", seen, ", ", Ink::Plain, width, lines);
    wrapped("     never: ", sum.never.iter().map(|kind| name(*kind)), ", ", Ink::Dim, width, lines);
}

/// The name of a task, padded to at least twelve columns.
fn padded(task: &Name) -> String {
    fit(task.shown(), columns(task.shown()).max(12))
}

fn name(event: Event) -> String {
    match event {
        Event::Discarded(reason) => format!("x {}", reason.name()),
        Event::ReleasedComplete => "released (all)".to_owned(),
        Event::ReleasedByConfirm => "released (confirm)".to_owned(),
        other => crate::store::journal::word(other).to_owned(),
    }
}

/// Wraps words at `width`.
fn wrapped(
    title: &str,
    words: impl Iterator<Item = String>,
    between: &str,
    ink: Ink,
    width: u16,
    lines: &mut Vec<Line>,
) {
    let mut text = String::new();
    let mut head = title.to_owned();
    let room = width.saturating_sub(columns(title));
    for word in words {
        if !text.is_empty() && columns(&text) + columns(&word) + columns(between) > room {
            lines.push(vec![
                (std::mem::replace(&mut head, " ".repeat(columns(title).into())), Ink::Dim),
                (text, ink),
            ]);
            text = String::new();
        }
        if !text.is_empty() {
            text += between;
        }
        text += &word;
    }
    if !text.is_empty() {
        lines.push(vec![(head, Ink::Dim), (text, ink)]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lines are wrapped by screen columns, not by bytes: these characters are two columns wide.
    #[test]
    fn lines_are_as_long_as_the_screen_is_wide() {
        let wrap = |words: &[&str]| {
            let mut lines = Vec::new();
            wrapped("", words.iter().map(|word| (*word).to_owned()), " ", Ink::Plain, 10, &mut lines);
            lines.into_iter().map(|line| line[1].0.clone()).collect::<Vec<_>>()
        };
        assert_eq!(
            wrap(&["\u{5de6}\u{8155}", "\u{5de6}\u{8155}", "ab"]),
            ["\u{5de6}\u{8155} \u{5de6}\u{8155}", "ab"]
        );
        assert_eq!(wrap(&["abcd", "efghij"]), ["abcd", "efghij"]);
        // Continued lines are indented by the width of the title in screen columns.
        let mut lines = Vec::new();
        wrapped(
            "\u{5de6}: ",
            ["abcd", "efgh"].map(str::to_owned).into_iter(),
            " ",
            Ink::Plain,
            10,
            &mut lines,
        );
        assert_eq!(lines[1][0].0, "    ");
    }
}
