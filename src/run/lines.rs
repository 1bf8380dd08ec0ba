//! Shows the lines of a run while the run lasts.

use crate::failure::Failure;
use crate::output::{BAD, FAINT, NOTE, Output, Styled, count};
use imrs_launch::{Line, Run, Telling};

/// Shows lines. Lines about faults and broken checks are few, and are never dropped for a slow reader.
pub fn show(lines: &[Line], run: &Run<'_>, out: &mut Output) -> Result<(), Failure> {
    let cell = run.loaded.table.cell();
    let width = cell.tasks.iter().map(|task| task.name.len()).max().unwrap_or(0);
    for Line { at, what } in lines {
        let ms = at / 1_000;
        let at = Styled(FAINT, format!("{:>4}.{:03} s", ms / 1_000, ms % 1_000));
        match what {
            Telling::Did { task, line, left_out, words } => {
                let task = cell.tasks.get(task.index()).map_or("", |task| task.name.as_str());
                let line = line.map(|line| format!("line {line}")).unwrap_or_default();
                let before = match left_out {
                    0 => String::new(),
                    left_out => format!("({} left out) ", count((*left_out).into(), "line")),
                };
                let (line, before) = (Styled(FAINT, format!("{line:<8}")), Styled(FAINT, before));
                out.passing(format!("{at} {task:<width$} {line} {before}{words}"))?;
            }
            Telling::Fault(words) => out.line(format!("{at} {}", Styled(NOTE, words)))?,
            Telling::Broken(words) => out.line(format!("{at} {}", Styled(BAD, words)))?,
            Telling::Idle(words) => {
                let end = if run.until_idle { "" } else { "; Ctrl-C ends the run, or use --until-idle" };
                out.line(format!("{at} {}", Styled(NOTE, format_args!("{words}{end}"))))?;
            }
        }
    }
    Ok(())
}
