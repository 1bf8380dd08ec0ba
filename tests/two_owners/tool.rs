//! The tool that both tasks of a trial use: the command of their actions, and the log that shows which task acted when.

#[path = "../../examples/actuator.rs"]
#[expect(dead_code, reason = "the start of the example as a program of its own")]
mod actuator;

use imrs_runtime::actuator::{Deadline, Orders, now};
use std::collections::BTreeMap;
use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;
use std::{env, thread};

/// The name of the log file in the tool's folder.
const LOG: &str = "tool.log";
/// The time between two steps of a command, as in `examples/actuator.rs`.
const STEP: Duration = Duration::from_millis(1);

/// What keeps the command of one task from acting while the command of the other acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Bound {
    /// Both the gate and the deadline, as in `examples/actuator.rs`.
    Both,
    /// The gate only. The command ignores its deadline.
    Gate,
    /// Neither the gate nor the deadline, for a comparison. Only the guard ends the command.
    Neither,
}

/// The shell command of an action, which uses the tool in this folder for the time `length`.
pub fn command(name: &str, folder: &Path, bound: Bound, length: Duration) -> String {
    let (program, folder) = (env::current_exe().expect("this program"), folder.display());
    let (program, length) = (program.display(), length.as_millis());
    let test = "two_owners::tool::moves_the_tool";
    format!("{name}={program} --exact {test} --nocapture tool={folder} bound={bound:?} millis={length}")
}

/// The work of an action's command. A node of a trial runs this test program with the name of this function.
#[test]
fn moves_the_tool() {
    let said = |name: &str| env::args().find_map(|argument| argument.strip_prefix(name).map(str::to_owned));
    let Some(tool) = said("tool=").map(PathBuf::from) else { return };
    let millis = said("millis=").and_then(|millis| millis.parse().ok()).expect("a length");
    let length = Duration::from_millis(millis);
    let Orders { epoch, deadline } = Orders::from_env().expect("numbers");
    let epoch = epoch.expect("the tasks are a couple");
    // If the gate refuses a later step of the command, the command fails, and so does the action.
    match said("bound=").as_deref() {
        Some("Both") => {
            let renewed = deadline.clone();
            thread::spawn(move || renewed.follow(std::io::stdin().lock()));
            actuator::weld(&tool, epoch, deadline, length).expect("it may act");
        }
        Some("Gate") => actuator::weld(&tool, epoch, Deadline::none(), length).expect("it may act"),
        _ => act_unbound(&tool, epoch, length),
    }
}

/// Acts for the time `length`, even if the other task acts, too. Writes the same kind of log as `examples/actuator.rs`.
fn act_unbound(tool: &Path, epoch: u8, length: Duration) {
    let mut log = OpenOptions::new().create(true).append(true).open(tool.join(LOG)).expect("the log");
    let mut line = |what: &str| {
        log.write_all(format!("{} {epoch} {what}\n", now()).as_bytes()).expect("a line of the log");
    };
    line("begin");
    let end = now() + u64::try_from(length.as_micros()).expect("64 bits");
    while now() < end {
        line("act");
        thread::sleep(STEP);
    }
    line("end");
}

/// One line of the log. Its time is read during the step that the line describes, in microseconds of `CLOCK_BOOTTIME`.
#[derive(Clone, Debug)]
pub struct Line {
    pub at: u64,
    pub epoch: u8,
    pub acts: bool,
}

/// The lines in the log of the tool in this folder, in the order in which they were written.
pub fn log_of(tool: &Path) -> Vec<Line> {
    let text = std::fs::read_to_string(tool.join(LOG)).unwrap_or_default();
    // A line that crosses a page boundary of the file may be only half visible to a reader.
    let text = text.rsplit_once('\n').map_or("", |(whole, _)| whole);
    let line = |line: &str| {
        let mut words = line.split(' ');
        let mut next = || words.next().expect("three words");
        let at = next().parse().expect("an instant");
        Line { at, epoch: next().parse().expect("an epoch"), acts: next() != "end" }
    };
    text.lines().map(line).collect()
}

/// How long a command of an older epoch still acted after the first step of a newer epoch, in microseconds. Both the
/// times and the order of the lines are compared, because a process may be stopped between reading the clock and
/// writing its line. If an older step stands after a newer one in the log, the result is at least one microsecond.
pub fn two_owners(log: &[Line]) -> u64 {
    let acts = || log.iter().filter(|line| line.acts);
    let mut of: BTreeMap<u8, (u64, u64)> = BTreeMap::new();
    for line in acts() {
        let (first, last) = of.entry(line.epoch).or_insert((line.at, line.at));
        (*first, *last) = (line.at.min(*first), line.at.max(*last));
    }
    let overlap = |(&older, &(_, last)): (&u8, &(u64, u64))| {
        let newer = of.range(older + 1..).map(|(_, &(first, _))| first).min();
        newer.map_or(0, |first| (last + 1).saturating_sub(first))
    };
    let by_instants = of.iter().map(overlap).max().unwrap_or(0);
    let mut newest = 0;
    let behind = acts().any(|line| {
        newest = newest.max(line.epoch);
        line.epoch < newest
    });
    by_instants.max(u64::from(behind))
}

#[test]
fn the_log_of_two_owners_is_told_from_that_of_one() {
    let line = |(at, epoch, acts)| Line { at, epoch, acts };
    let one =
        [(1, 1, true), (2, 1, true), (3, 1, false), (3, 2, true), (4, 2, true), (5, 1, false)].map(line);
    assert_eq!(two_owners(&one), 0, "an end is no act");
    let two = [(1, 1, true), (3, 2, true), (7, 1, true), (9, 2, true)].map(line);
    assert_eq!(two_owners(&two), 5);
    let at_once = [(1, 1, true), (3, 1, true), (3, 2, true)].map(line);
    assert_eq!(two_owners(&at_once), 1, "one instant is a microsecond");
    let late = [(1, 1, true), (5, 2, true), (2, 1, true), (6, 2, true)].map(line);
    assert_eq!(two_owners(&late), 1, "written after a newer one, at an earlier instant");
}

/// The smallest step of the log's clock that can be observed, in microseconds.
pub fn resolution() -> u64 {
    let steps = (0..1_000).map(|_| {
        let first = now();
        std::iter::repeat_with(now).find(|&next| next > first).map_or(0, |next| next - first)
    });
    steps.min().unwrap_or(0)
}
