//! The text of a row's health cell, and how a block is shown in the overview.

use super::columns::{Cells, HEALTH_CELL};
use super::mark;
use super::nodes;
use crate::app::App;
use crate::clock::Moment;
use crate::rows::Row;
use crate::store::blocked::{Blocker, Kind};
use crate::store::health::{Finding, Place};
use crate::store::journal::Severity;
use crate::theme::Ink;

/// Marks the row of the place that blocks the cell, and the rows of the tasks that it holds. The ink of the first cell of
/// the former is [`Ink::Alarm`], which stands for the whole row.
pub(super) fn accuse(
    app: &App,
    row: &Row,
    findings: &[Finding],
    blockers: &[Blocker],
    (width, now): (u16, Moment),
    cells: &mut Cells,
) {
    let mut alarming = blockers.iter().filter(|blocker| blocker.is_alarming());
    // A finding that only follows from a block is shown less strikingly than the block.
    let worst = findings.iter().find(|finding| row.place.holds(&finding.place));
    if worst.is_some_and(|worst| blockers.iter().any(|blocker| blocker.explains(worst))) {
        cells[HEALTH_CELL].1 = Ink::Warn;
    }
    // The row of an open node leaves the alarm to the row of its task, unless the node itself is gone.
    let is_gone = row.place.node.is_ok_and(|id| nodes::is_gone(app, id, now));
    let is_shown_within = |blocker: &Blocker| row.open && row.place != blocker.place && !is_gone;
    if let Some(blocker) =
        alarming.clone().find(|blocker| blocker.is_within(&row.place) && !is_shown_within(blocker))
    {
        cells[0].1 = Ink::Alarm;
        let names = app.cell().and_then(|cell| app.store().names(&cell));
        let all = names.map_or(0, |names| names.tasks.len());
        // A finding of the row itself is shown first, because it is more important than the number of tasks that
        // wait.
        let is_innermost = row.depth == 1 || row.depth == 0 && !row.open;
        let holds = !blocker.by.is_empty() && blocker.kind != Kind::Cut;
        if width >= 60 && holds && is_innermost {
            let own = findings.iter().find(|f| row.place.holds(&f.place) && !blocker.explains(f));
            let own = own.map_or_else(String::new, |f| format!("; {}", f.text));
            let task = if row.depth == 0 { format!("{} ", blocker.name) } else { String::new() };
            let text = format!("{} {task}holds {} of {all}{own}", mark(blocker.level), blocker.by.len());
            cells[HEALTH_CELL] = (text, Ink::Bad);
        }
        return;
    }
    // The row of a port shows only its own findings. The row of an open node shows none, because the rows of its tasks do.
    let is_of_row = |task| app.incarnation_of_task(task).is_some_and(|node| row.place.node == Ok(node.id));
    let is_held = |blocker: &Blocker| match row.depth {
        0 if !row.open => blocker.held().iter().any(|task| is_of_row(*task)),
        1 => blocker.holds(&row.place),
        _ => false,
    };
    let Some(blocker) = alarming.find(|blocker| is_held(blocker)) else { return };
    let worst = findings.iter().find(|f| row.place.holds(&f.place) && !blocker.explains(f));
    if worst.is_none() {
        let text = if width < 60 { String::new() } else { format!(" held by {}", blocker.name) };
        cells[HEALTH_CELL] = (format!("!{text}"), Ink::Warn);
    }
    (cells[0].1, cells[1].1) = (Ink::Warn, Ink::Warn);
}

/// The most severe finding within a row. On a narrow screen this is only a sign.
pub(super) fn health(row: &Row, findings: &[Finding], width: u16) -> (String, Ink) {
    let Some(worst) = findings.iter().find(|f| row.place.holds(&f.place)) else {
        let never_seen = row.place.node.is_err() && row.place != Place::HEALTHY;
        let text = if never_seen { "?" } else { "ok" };
        return (text.to_owned(), if never_seen { Ink::Dim } else { Ink::Good });
    };
    let ink = if worst.level == Severity::Bad { Ink::Bad } else { Ink::Warn };
    let text = if width < 60 { String::new() } else { format!(" {}", worst.text) };
    (format!("{}{text}", mark(worst.level)), ink)
}
