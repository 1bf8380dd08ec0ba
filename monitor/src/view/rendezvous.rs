//! Screen 3: a card for each rendezvous, with a matrix that shows which member knows of which arrival.

use super::canvas::{Canvas, bar, columns, cut, fit};
use crate::app::App;
use crate::clock::{Moment, Span};
use crate::drawn::Hit;
use crate::keys::Action;
use crate::name::Name;
use crate::store::Presence;
use crate::store::health::Place;
use crate::store::meeting::{Meeting, Member, Standing, meetings};
use crate::store::rounds::history;
use crate::store::waits::cycles;
use crate::theme::Ink;
use imrs_protocol::TaskId;
use std::collections::BTreeSet;

type Line = Vec<(String, Ink)>;

pub(super) fn draw(app: &App, now: Moment, canvas: &mut Canvas<'_>) {
    let (lines, opens) = cards(app, now, canvas.area.width.saturating_sub(1));
    if lines.is_empty() {
        canvas.line(1, &[(" This cell has no waitfor.", Ink::Plain)]);
        return;
    }
    let room = usize::from(canvas.height());
    let (window, selected) = canvas.chosen(app.scroll, room, opens);
    let canvas = &mut canvas.beside_scrollbar(0, window);
    for (y, (at, line)) in (0..).zip(lines.iter().enumerate().skip(window.first).take(room)) {
        let pieces: Vec<_> = line.iter().map(|(text, ink)| (text.as_str(), *ink)).collect();
        canvas.line(y, &pieces);
        canvas.line_of(y, at, selected);
    }
}

/// The place of a task on the latest incarnation of its node.
pub(super) fn place_of(app: &App, cell: &Name, task: TaskId) -> Option<Place> {
    let home = app.store().names(cell)?.home(task)?;
    let node = app.store().latest(cell, home).map(|incarnation| incarnation.id).ok_or(home);
    // For a node that the monitor has never seen, the overview has only the row of the node itself.
    Some(Place { node, task: node.is_ok().then_some(task), port: None })
}

/// The lines of all cards. For each line, what Enter does on it: mostly it leads to the place that the line is about.
fn cards(app: &App, now: Moment, width: u16) -> (Vec<Line>, Vec<Option<Hit>>) {
    let Some(cell) = app.cell() else { return (Vec::new(), Vec::new()) };
    let (mut lines, mut opens) = (Vec::new(), Vec::new());
    let cycles = cycles(app.store(), &cell, now);
    let in_cycle = |task: TaskId| cycles.iter().any(|cycle| cycle.tasks.contains(&task));
    for cycle in &cycles {
        lines.push(vec![(" !! wait-for cycle: only a time-out ends it".to_owned(), Ink::Bad)]);
        lines.extend(cycle.why.iter().map(|why| vec![(format!("      {why}"), Ink::Bad)]));
    }
    if app.only_cycles {
        let text =
            if cycles.is_empty() { " No wait-for cycle." } else { " Only what waits in a cycle is shown." };
        opens.resize(lines.len(), None);
        lines.push(vec![(format!("{text} c: show all"), Ink::Warn)]);
        opens.push(Some(Hit::Key(Action::Cycles)));
    }
    for meeting in &meetings(app.store(), &cell, now) {
        if app.only_cycles && !meeting.members.iter().any(|m| !m.waits_for.is_empty() && in_cycle(m.task)) {
            continue;
        }
        if !lines.is_empty() {
            lines.push(Vec::new());
        }
        opens.resize(lines.len(), None);
        let owner = meeting.members.first().and_then(|member| place_of(app, &cell, member.task));
        lines.push(heading(app, meeting, width));
        let port = |place: Place| Place { port: place.task.map(|_| meeting.port), ..place };
        opens.push(owner.map(|place| Hit::Place(port(place))));
        let before = lines.len();
        card(app, meeting, width, &mut lines);
        opens.resize(before + usize::from(width >= NARROW), None);
        let members = meeting.members.iter().chain(meeting.lost());
        opens.extend(members.map(|member| place_of(app, &cell, member.task).map(Hit::Place)));
        lines.extend(past(app, &cell, meeting, width));
        opens.resize(lines.len(), None);
    }
    opens.resize(lines.len(), None);
    (lines, opens)
}

/// On a screen that is narrower than this, there are no titles and no matrix.
const NARROW: u16 = 60;

/// The lines with the statistics of a rendezvous's last rounds.
fn past(app: &App, cell: &Name, meeting: &Meeting, width: u16) -> Vec<Line> {
    let Some(history) = history(app.store(), cell, meeting.port) else { return Vec::new() };
    let told = history.summary(meeting.members.len());
    let time = |us: Option<u64>| us.map_or_else(|| "-".to_owned(), |us| Span::micros(us).to_string());
    let mut line = vec![
        (format!("   history ({}): ", history.rounds().count()), Ink::Dim),
        (format!("done {}", told.done), Ink::Plain),
        (format!("  timed out {}", told.in_vain), if told.in_vain > 0 { Ink::Warn } else { Ink::Plain }),
    ];
    let divided = if told.divergent > 0 { Ink::Bad } else { Ink::Plain };
    line.push((format!("  split rounds {}", told.divergent), divided));
    let mut more = vec![(
        format!("gather p50 {} p99 {}", time(told.gather_p50_us), time(told.gather_p99_us)),
        Ink::Plain,
    )];
    let member = |task| meeting.members.iter().find(|m| m.task == task).map(|m| m.name.to_string());
    if let Some((name, percent)) = told.slowest.and_then(|(task, percent)| Some((member(task)?, percent))) {
        more.push((format!("  slowest {name} ({percent}%)"), Ink::Plain));
    }
    if width < 100 {
        more.insert(0, ("   ".to_owned(), Ink::Plain));
        return vec![line, more];
    }
    line.push(("  ".to_owned(), Ink::Plain));
    line.extend(more);
    vec![line]
}

/// The lines of the members: titles, a row for each member, and a line for each member that can never arrive.
fn card(app: &App, meeting: &Meeting, width: u16, lines: &mut Vec<Line>) {
    let narrow = width < NARROW;
    let matrix = if narrow { Vec::new() } else { heads(meeting, usize::from(width) / 3) };
    if !narrow {
        lines.push(titles(&matrix));
    }
    for (i, member) in meeting.members.iter().enumerate() {
        lines.push(row(app, meeting, i, member, narrow, &matrix));
    }
    for lost in meeting.lost() {
        let why = match lost.presence {
            Some(gone @ (Presence::Dead(_) | Presence::Stopped(_))) => format!("node {} {gone}", lost.node),
            _ => lost.doing.clone(),
        };
        let text = format!("   !! {} can never arrive: {why}", lost.name);
        lines.push(vec![(text, Ink::Bad)]);
    }
}

fn heading(app: &App, meeting: &Meeting, width: u16) -> Line {
    let (arrived, all) = (meeting.arrived(), meeting.members.len());
    let waiting = meeting.is_waiting();
    let (state, ink) = if waiting { ("GATHERING", Ink::Warn) } else { ("none waiting", Ink::Dim) };
    let mut line = vec![
        (format!(" {}", meeting.name), Ink::Head),
        (format!(" {}", meeting.round), Ink::Plain),
        (format!("  {state} {arrived}/{all}"), ink),
    ];
    if let Some(left) = meeting.left {
        line.push((format!("  {left} left "), Ink::Plain));
        if width >= 60 {
            line.push((format!("[{}]", bar(&app.theme, 20, left.us, meeting.patience_us)), Ink::Bar));
        }
    }
    line
}

/// The column heads of the matrix, all of one width: the names of the members, or their last letters if their first
/// ones are alike (`task0`, `task6`). A matrix of very many members has no room and no heads; each row still names
/// the awaited members.
fn heads(meeting: &Meeting, room: usize) -> Vec<String> {
    let names = || meeting.members.iter().map(|member| member.name.shown());
    let most = (room / meeting.members.len().max(1)).saturating_sub(1);
    if most < 4 {
        return Vec::new();
    }
    let longest = names().map(columns).max().unwrap_or(0);
    let width = longest.clamp(4, u16::try_from(most).unwrap_or(u16::MAX));
    let begins: BTreeSet<String> = names().map(|name| cut(name, width)).collect();
    if begins.len() == meeting.members.len() {
        return names().map(|name| fit(name, width)).collect();
    }
    let end = |name: &str| {
        let at = name.char_indices().map(|(at, _)| at).find(|at| columns(&name[*at..]) <= width);
        let end = &name[at.unwrap_or(0)..];
        // Half of a wide character is not drawn, and its column stays free.
        let free = columns(name).min(width).saturating_sub(columns(end));
        fit(&(" ".repeat(free.into()) + end), width)
    };
    names().map(end).collect()
}

fn titles(matrix: &[String]) -> Line {
    let mut texts = vec![format!("   {:16} ", "MEMBER"), format!("{:18} ", "ARRIVED")];
    texts.extend(matrix.iter().map(|head| format!("{head} ")));
    texts.extend(["CONFIRMS ", "WAITS FOR"].map(str::to_owned));
    texts.into_iter().map(|text| (text, Ink::Dim)).collect()
}

fn row(app: &App, meeting: &Meeting, at: usize, member: &Member, narrow: bool, matrix: &[String]) -> Line {
    let gone = member.is_gone();
    let glyphs = app.theme.glyphs;
    let sign = if gone { glyphs.dead } else { " " };
    let name = format!("{}@{}", member.name, member.node);
    let (standing, ink) = standing(member, gone);
    if narrow {
        return vec![(format!(" {sign} {} ", fit(member.name.shown(), 14)), plain(gone)), (standing, ink)];
    }
    let mut line = vec![
        (format!(" {sign} {} ", fit(&name, 16)), plain(gone)),
        (format!("{} ", fit(&standing, 18)), ink),
    ];
    if let Some(head) = matrix.first() {
        for (j, knows) in member.knows.iter().enumerate() {
            let (cell, ink) = match knows {
                _ if j == at => ("-", Ink::Dim),
                Some(true) => (glyphs.yes, Ink::Good),
                Some(false) => (glyphs.no, Ink::Warn),
                None => ("?", Ink::Dim),
            };
            line.push((fit(cell, columns(head)) + " ", ink));
        }
    }
    let others = meeting.members.len().saturating_sub(1);
    let confirms =
        if member.left.is_some() { format!("{}/{others}", member.confirmed) } else { "-".to_owned() };
    line.push((format!("{confirms:8} "), plain(gone)));
    let names: Vec<_> = member.waits_for.iter().map(|&j| meeting.members[j].name.to_string()).collect();
    if member.within_margin {
        line.push(("a CONFIRM (too little time to release)".to_owned(), Ink::Warn));
    } else if !names.is_empty() {
        line.push((format!("{} {}", glyphs.arrow, names.join(",")), Ink::Warn));
    } else if member.standing == Standing::Missing || gone {
        line.push((format!("last seen: {}", member.doing), if gone { Ink::Bad } else { Ink::Dim }));
    }
    line
}

fn standing(member: &Member, gone: bool) -> (String, Ink) {
    let waited = member.waited_us.map_or_else(String::new, |us| format!(" {} ago", Span::micros(us)));
    match member.standing {
        Standing::Arrived => (format!("arrived{waited}"), Ink::Good),
        Standing::Released => ("released".to_owned(), Ink::Good),
        Standing::Missing | Standing::Unknown if gone => (format!("MISSING, {}", member.end()), Ink::Bad),
        Standing::Missing => ("missing".to_owned(), Ink::Warn),
        Standing::Unknown => ("not known".to_owned(), Ink::Dim),
    }
}

const fn plain(gone: bool) -> Ink {
    if gone { Ink::Dim } else { Ink::Plain }
}
