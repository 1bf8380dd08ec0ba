//! The examples of the language under the checker of cells, and a cell of four tasks and six ports.

use crate::cells::{Text, within};
use imrs_model::cell::{Kind, Verdicts};

const WELD: &str = include_str!("../../examples/weld_cell.cell");
const PRESS: &str = include_str!("../../examples/press_line.cell");

/// Checks a cell with at most `states` states in each phase.
fn checked(text: &str, states: u64) -> (Text, Verdicts) {
    let mut cell = Text::new(text);
    cell.plan.budget = within(states);
    let verdicts = cell.check();
    (cell, verdicts)
}

#[test]
fn four_tasks_and_six_ports_are_looked_at_whole() {
    let (cell, verdicts) = checked(PRESS, 500_000);
    assert!(verdicts.is_complete(), "{:?}", verdicts.phases);
    assert_eq!(cell.found(&verdicts), []);
    // Without retransmission, and without a branch for a time_out, a lost packet ends a task.
    let helpless = PRESS
        .replace("class = 2 retry = 2 resend = 40 msec", "class = 2 retry = 0")
        .replace(" on time_out do abort \"left is gone\"; end on refused do abort \"left is full\"; end", "");
    let (cell, verdicts) = checked(&helpless, 20_000);
    assert!(cell.found(&verdicts).iter().any(|(kind, _)| *kind == Kind::Ends), "{:?}", cell.found(&verdicts));
}

#[test]
fn any_number_of_threads_finds_the_same() {
    let text = WELD.replace("within 200 msec", "within 100 msec").replace("retry = 3 resend = 40 msec", "");
    let mut cell = Text::new(&text);
    cell.plan.budget = within(3_000);
    let mut told = [1, 2, 3].map(|jobs| {
        cell.plan.jobs = jobs;
        let verdicts = cell.check();
        let phases =
            verdicts.phases.iter().map(|phase| (phase.states, phase.moves, phase.depth)).collect::<Vec<_>>();
        let findings =
            verdicts.findings.into_iter().map(|finding| (finding.kind, finding.moves)).collect::<Vec<_>>();
        (phases, findings, verdicts.statements)
    });
    told.rotate_left(1);
    assert!(told[0].0.iter().any(|&(states, ..)| states >= 1_000), "{:?}", told[0].0);
    assert_eq!(told[0], told[1]);
    assert_eq!(told[0], told[2]);
}
