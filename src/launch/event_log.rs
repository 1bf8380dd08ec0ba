//! The event log of a run, for people: lines in the order of time, and no faster than they can be read.

use super::script_event::Did;
use crate::failure::Failure;
use crate::output::{BAD, FAINT, NOTE, Output, Styled, count};
use imrs_protocol::{Cell, CellTable};
use std::collections::BTreeMap;

/// Nodes report events every few milliseconds. Events this old, in microseconds, are shown: no earlier ones can still come.
const SETTLED: u64 = 100_000;
/// Most lines of one task that are shown within one `SPAN`.
const PER_SPAN: u32 = 20;
/// The interval for `PER_SPAN`, in microseconds.
const SPAN: u64 = 1_000_000;

/// Collects lines until they can be shown.
pub struct EventLog {
    /// When the run began.
    began: u64,
    /// Lines by time, then by the order in which they were reported.
    waiting: BTreeMap<(u64, u64), Entry>,
    told: u64,
    /// For each task, the span of its last line, and how many lines it has had in that span.
    paces: Vec<(u64, u32)>,
}

/// A line of the event log.
enum Entry {
    Did(Did),
    Fault(String),
    Broken(String),
}

impl EventLog {
    /// An empty event log of a run that began at this instant of the clock that all processes of one machine share.
    pub fn new(cell: &Cell, began: u64) -> Self {
        Self { began, waiting: BTreeMap::new(), told: 0, paces: vec![(0, 0); cell.tasks.len()] }
    }

    /// Sets the beginning of the run.
    pub fn begin(&mut self, at: u64) {
        self.began = at;
    }

    /// When the run began.
    pub const fn began(&self) -> u64 {
        self.began
    }

    /// Adds an event of a script.
    pub fn add(&mut self, did: Did) {
        self.waiting.insert((did.at, self.told), Entry::Did(did));
        self.told += 1;
    }

    /// Adds a line about a fault.
    pub fn fault(&mut self, at: u64, words: String) {
        self.waiting.insert((at, self.told), Entry::Fault(words));
        self.told += 1;
    }

    /// Adds a line about a check that does not hold.
    pub fn broken(&mut self, at: u64, words: String) {
        self.waiting.insert((at, self.told), Entry::Broken(words));
        self.told += 1;
    }

    /// Whether no line is pending.
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Shows all lines that are older than `SETTLED` at `now`.
    ///
    /// # Errors
    /// [`Failure::Output`].
    pub fn show(&mut self, table: &CellTable, now: u64, out: &mut Output) -> Result<(), Failure> {
        let later = self.waiting.split_off(&(now.saturating_sub(SETTLED), 0));
        let settled = std::mem::replace(&mut self.waiting, later);
        for ((at, _), entry) in &settled {
            // Lines about faults and broken checks are few, and never dropped for a slow reader.
            let did = match entry {
                Entry::Did(did) => did,
                Entry::Fault(words) => {
                    out.line(format!("{} {}", Styled(FAINT, self.clock(*at)), Styled(NOTE, words)))?;
                    continue;
                }
                Entry::Broken(words) => {
                    out.line(format!("{} {}", Styled(FAINT, self.clock(*at)), Styled(BAD, words)))?;
                    continue;
                }
            };
            let left_out = self.pace(did);
            if left_out.is_some() || did.what.is_rare() {
                out.passing(self.line(table, did, left_out.unwrap_or_default()))?;
            }
        }
        Ok(())
    }

    /// Shows all pending lines.
    ///
    /// # Errors
    /// [`Failure::Output`].
    pub fn close(&mut self, table: &CellTable, out: &mut Output) -> Result<(), Failure> {
        self.show(table, u64::MAX, out)
    }

    /// If this line is shown, how many were left out before it; `None` if it is left out.
    fn pace(&mut self, did: &Did) -> Option<u32> {
        let span = did.at.saturating_sub(self.began) / SPAN;
        let pace = self.paces.get_mut(did.task.index())?;
        let left_out = if pace.0 == span { 0 } else { pace.1.saturating_sub(PER_SPAN) };
        *pace = if pace.0 == span { (span, pace.1 + 1) } else { (span, 1) };
        (pace.1 <= PER_SPAN).then_some(left_out)
    }

    fn clock(&self, at: u64) -> String {
        let ms = at.saturating_sub(self.began) / 1_000;
        format!("{:>4}.{:03} s", ms / 1_000, ms % 1_000)
    }

    fn line(&self, table: &CellTable, did: &Did, left_out: u32) -> String {
        let cell = table.cell();
        let at = self.clock(did.at);
        let width = cell.tasks.iter().map(|task| task.name.len()).max().unwrap_or(0);
        let task = cell.tasks.get(did.task.index()).map_or("", |task| task.name.as_str());
        let line = did.line.map(|line| format!("line {line}")).unwrap_or_default();
        let before = if left_out > 0 {
            format!("({} left out) ", count(left_out.into(), "line"))
        } else {
            String::new()
        };
        format!(
            "{} {task:<width$} {} {}{}",
            Styled(FAINT, at),
            Styled(FAINT, format!("{line:<8}")),
            Styled(FAINT, before),
            did.what.words(table)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::beam_lift;
    use crate::launch::script_event::ScriptEvent;
    use imrs_protocol::TaskId;

    fn did(at: u64, task: u16) -> Did {
        Did { at, task: TaskId(task), line: Some(3), what: ScriptEvent::CutShort(format!("{at}")) }
    }

    #[test]
    fn a_task_that_is_busy_is_shown_in_part_and_what_is_left_out_is_counted() {
        let mut event_log = EventLog::new(beam_lift().cell(), 0);
        let shown = (0..50).filter(|at| event_log.pace(&did(*at, 0)).is_some()).count();
        assert_eq!(shown, usize::try_from(PER_SPAN).unwrap());
        assert_eq!(event_log.pace(&did(7, 1)), Some(0));
        assert_eq!(event_log.pace(&did(SPAN, 0)), Some(50 - PER_SPAN));
        assert_eq!(event_log.pace(&did(SPAN, 0)), Some(0));
    }

    #[test]
    fn lines_wait_until_nothing_earlier_can_come() {
        let table = beam_lift();
        let mut event_log = EventLog::new(table.cell(), 0);
        event_log.add(did(200_000, 0));
        event_log.add(did(100_000, 1));
        let mut out = Output::new(crate::output::Color::Never);
        event_log.show(&table, 200_050, &mut out).unwrap();
        assert_eq!(event_log.waiting.keys().map(|(at, _)| *at).collect::<Vec<_>>(), [200_000]);
        event_log.close(&table, &mut out).unwrap();
        assert!(event_log.is_empty());
        assert!(event_log.line(&table, &did(1_234_000, 2), 4).contains("1.234 s"));
    }
}
