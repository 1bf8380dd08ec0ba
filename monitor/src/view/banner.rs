//! The banner below the header of every screen: what blocks the cell, for how long, and which tasks the block holds.

use super::canvas::{Canvas, columns};
use crate::app::App;
use crate::clock::{Moment, Span};
use crate::drawn::Hit;
use crate::name::Name;
use crate::store::Names;
use crate::store::blocked::{Blocker, Kind};
use crate::store::health::{Finding, Place, held_back_sentence};
use crate::store::journal::Severity;
use crate::theme::Ink;

/// How many rows the banner takes. On a very low screen, only an alarm has room.
pub(super) fn rows(app: &App, blockers: &[Blocker], height: u16) -> u16 {
    let alarm = blockers.first().is_some_and(Blocker::is_alarming);
    u16::from(app.cell().is_some() && (height >= 8 || (height >= 3 && alarm)))
}

/// Draws the banner. A click on it selects the place that blocks the cell.
pub(super) fn draw(
    app: &App,
    findings: &[Finding],
    blockers: &[Blocker],
    now: Moment,
    canvas: &mut Canvas<'_>,
) {
    let Some(cell) = app.cell().filter(|_| canvas.height() > 0) else { return };
    let Some(names) = app.store().names(&cell) else { return };
    let Some(first) = blockers.first() else {
        let (text, ink) = match held_back(app, &cell, now) {
            Some((text, place)) => {
                canvas.drawn.banner = Some(place);
                (text, Ink::Warn)
            }
            // A block is shown only after half a second, but its findings already show that the cell is not well.
            None if findings.iter().any(|finding| finding.level == Severity::Bad) => return,
            None => (" no single blocker".to_owned(), Ink::Dim),
        };
        canvas.line(0, &[(text.as_str(), ink)]);
        leads_there(app, canvas);
        return;
    };
    let ink = ink(first.level);
    let width = canvas.area.width;
    let forms = forms(first, names, blockers.len() - 1);
    let shortest = forms.len() - 1;
    let text = forms.iter().find(|form| columns(form) <= width).unwrap_or(&forms[shortest]);
    let end = canvas.at(0, 0, width, text, ink);
    if ink == Ink::Alarm {
        canvas.at(end, 0, width, &" ".repeat(width.saturating_sub(end).into()), ink);
    }
    canvas.drawn.banner = Some(first.place);
    leads_there(app, canvas);
}

/// Makes the banner a target if it leads to a place, and shows the cursor if it is there.
fn leads_there(app: &App, canvas: &mut Canvas<'_>) {
    let Some(place) = canvas.drawn.banner else { return };
    canvas.target(0, 0, canvas.area.width, Hit::Place(place));
    if app.is_on_banner() {
        canvas.cursor(0);
        canvas.drawn.is_on_banner = true;
    }
}

const fn ink(level: Severity) -> Ink {
    match level {
        Severity::Bad => Ink::Alarm,
        Severity::Warn => Ink::Warn,
        Severity::Note | Severity::Trace => Ink::Dim,
    }
}

/// The texts about a block, longest first. Each begins with the cause of the block, so that a cut text names it, too.
fn forms(blocker: &Blocker, names: &Names, others: usize) -> Vec<String> {
    let Blocker { name, state, .. } = blocker;
    let title = match (blocker.kind, blocker.is_alarming()) {
        (Kind::Cycle, _) => "WAIT CYCLE",
        (Kind::Lost, _) => "LOST",
        (Kind::Cut, _) => "LINK CUT",
        (Kind::Awaited, true) => "BLOCKED BY",
        (Kind::Awaited, false) => "waiting for",
    };
    let more = if others > 0 { format!("  +{others} more") } else { String::new() };
    if blocker.kind == Kind::Cut {
        let lead = format!(" {title} {name} - {state}");
        return vec![
            format!("{lead}, though packets are sent{more}  b: go there"),
            format!("{lead}{more}"),
            lead,
        ];
    }
    if blocker.kind == Kind::Lost {
        return vec![
            format!(" {title} {name} - {state} - holds no task now{more}  b: go there"),
            format!(" {title} {name} - {state} - holds no task now{more}"),
            format!(" {title} {name} - {state}"),
        ];
    }
    let (held, all) = (blocker.by.len(), names.tasks.len());
    let few: Vec<_> = blocker.by.iter().take(4).map(|task| names.task(*task).to_string()).collect();
    let few = few.join(", ") + if held > 4 { ", ..." } else { "" };
    let why = &blocker.why;
    let port = why.rsplit(' ').next().unwrap_or(why);
    let waited = blocker.waited_us.map_or_else(String::new, |us| format!(" for {}", Span::micros(us)));
    let others = match blocker.others {
        0 => String::new(),
        1 => ", +1 other".to_owned(),
        others => format!(", +{others} others"),
    };
    let usual = blocker.usual_us.map_or_else(String::new, |us| format!(", p99 {}", Span::micros(us)));
    vec![
        format!(
            " {title} {name} - {state}{others} - holds {held} of {all}{waited}{usual} ({why}): {few}{more}  b: go there"
        ),
        format!(" {title} {name} - {state}{others} - holds {held} of {all}{waited}{usual} ({why}){more}"),
        format!(" {title} {name} - {state}{others} - holds {held} of {all} ({port}){more}"),
        format!(" {title} {name} {state} {held}/{all}"),
        format!(" {title} {name} {state}"),
    ]
}

/// The text about the restarted node whose scripts are held back longest, and its place.
fn held_back(app: &App, cell: &Name, now: Moment) -> Option<(String, Place)> {
    let up = app.store().present(cell).filter(|incarnation| !incarnation.presence(now).is_gone());
    let held = up.filter_map(|incarnation| Some((incarnation.longest_held_back(now)?, incarnation)));
    let (us, incarnation) = held.max_by_key(|(us, _)| *us)?;
    let place = Place { node: Ok(incarnation.id), task: None, port: None };
    Some((format!(" {} {}", incarnation.node, held_back_sentence(us)), place))
}
