//! Tests of the cells in `examples/faulty/inside`. Each has a fault that shows only if something takes neither its least
//! nor its most time, but some time between them. So a search of the ends of the intervals misses it, and a search of all times,
//! by zones or tick by tick, must find it where the file says.
//!
//! A line of the file names the choices of times that miss the fault: `(* missed by: ends, between *)`.

use crate::cells::{Text, within};
use crate::faulty_cells::{Faulty, all, comment, faulty_in, right, told};
use imrs_model::cell::{Times, Verdicts};

/// The number of cells.
const CELLS: usize = 10;

fn inside() -> Vec<Faulty> {
    let cells = faulty_in("../examples/faulty/inside");
    assert_eq!(cells.len(), CELLS);
    cells
}

/// Checks a cell completely with a choice of times.
fn checked(name: &str, text: &str, times: Times) -> (Text, Verdicts) {
    let mut cell = Text::new(text);
    (cell.plan.times, cell.plan.budget) = (times, within(20_000));
    let verdicts = cell.check();
    assert!(verdicts.is_complete(), "{name}, {times:?}: {:?} {:?}", verdicts.refused, verdicts.phases);
    (cell, verdicts)
}

#[test]
fn faults_inside_an_interval_are_found_by_zones_and_at_every_tick_and_missed_at_the_ends() {
    let mut missed_between = 0;
    for Faulty { name, text, finds } in inside() {
        let missed = text.lines().find_map(|line| comment(line, "missed by")).expect("what misses the fault");
        assert!(["ends", "ends, between"].contains(&missed), "{name}: {missed}");
        missed_between += usize::from(missed.ends_with("between"));
        let found = |times| {
            let (cell, verdicts) = checked(&name, &text, times);
            let found: Vec<String> = all(&verdicts).map(|finding| told(&cell, finding, &finds)).collect();
            found.join(", ")
        };
        for times in [Times::Zones, Times::Every] {
            assert_eq!(found(times), finds, "{name}, {times:?}");
        }
        assert_eq!(found(Times::Ends), "", "{name}: the ends show it");
        let between = if missed.ends_with("between") { "" } else { &finds };
        assert_eq!(found(Times::Between), between, "{name}, between the ends");
    }
    assert!(missed_between >= 5, "times after events find all but {missed_between}");
}

#[test]
fn with_its_line_put_right_a_cell_has_no_finding_at_any_time() {
    for Faulty { name, text, .. } in inside() {
        let text = right(&text).expect("the right line");
        for times in [Times::Zones, Times::Every] {
            let (cell, verdicts) = checked(&name, &text, times);
            assert!(all(&verdicts).next().is_none(), "{name}, {times:?}: {:?}", cell.found(&verdicts));
        }
    }
}
