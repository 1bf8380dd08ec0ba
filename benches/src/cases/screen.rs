//! Measures the time of a frame of the monitor (goal M1): every screen, for 100 nodes with 10,000 ports, on a large terminal.

use crate::sample::{Sample, worked};
use crate::suite::{Effort, Goal, Row, Stat, Suite};
use imrs_monitor::specimen::{Shown, Specimen};

/// The size of the terminal: columns and rows.
const SIZE: (u16, u16) = (200, 60);
/// The bound of goal M1, in nanoseconds.
const BOUND_NS: f64 = 4e6;
/// The keys that lead from the overview to each screen.
const SCREENS: [(&str, &str); 11] = [
    ("overview", "1"),
    ("overview by slack", "1s"),
    ("overview, its end", "1G"),
    ("overview, filtered", "/slack<100ms and class=1\n"),
    ("port", "2"),
    ("message", "2\n"),
    ("rendezvous", "3"),
    ("timeline", "4"),
    ("timers", "5"),
    ("events", "6"),
    ("model", "7"),
];

/// The suite with a case for each screen of the monitor.
#[must_use]
pub fn screen() -> Suite {
    let mut suite = Suite::new("screen");
    for (name, keys) in SCREENS {
        let case = format!("frame/{name}");
        suite.case(
            case.clone(),
            "a frame of 200 by 60 of a cell of 100 nodes with 100 ports each: built, and compared with the one before; between \
             two frames ten nodes tell what changed and what happened, which is not timed. Of the processor's time: what its neighbours take is not the screen's",
            move |effort| frames(effort, Specimen::CELL, keys),
        );
        suite.row(Row::bounded(
            "M1",
            &format!("ns of a frame, {name}"),
            &case,
            Stat::P99,
            Goal::AtMost(BOUND_NS),
        ));
    }
    let case = "frame/overview of one node";
    suite.case(
        case,
        "the same of one node with 10,000 ports, which tells something before every frame",
        |effort| frames(effort, Specimen::NODE, "1G"),
    );
    suite.row(Row::bounded("M1", "ns of a frame, one node", case, Stat::P99, Goal::AtMost(BOUND_NS)));
    suite
}

fn frames(effort: Effort, cell: Specimen, keys: &str) -> Sample {
    let mut screen = Shown::new(cell, SIZE, keys);
    let times = effort.of(500);
    let mut nanos = Vec::with_capacity(times as usize);
    for _ in 0..times {
        screen.go_on();
        let begins = worked();
        std::hint::black_box(screen.draw());
        nanos.push(worked().saturating_sub(begins));
    }
    Sample::of(nanos, 1)
}
