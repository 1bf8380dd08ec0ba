//! The examples of the language under the checker of cells.

mod cells;

use cells::Text;
use imrs_model::cell::Budget;

fn sized(name: &str, text: &str) {
    let tick = std::env::var("CELL_TICK").map_or(String::new(), |t| format!("\nmodel tick {t} msec;"));
    let mut cell = Text::new(&text.replacen("tick 1 msec;", &format!("tick 1 msec;{tick}"), 1));
    cell.plan.jobs = std::env::var("CELL_JOBS").map_or(1, |_| 2);
    let seconds = std::env::var("CELL_SECONDS").ok().and_then(|s| s.parse().ok()).unwrap_or(10.0);
    cell.plan.budget = Budget { seconds, bytes: 3 << 30, ..Budget::default() };
    println!("== {name}");
    cell.check();
}

#[test]
fn beam() {
    sized("beam", include_str!("../../examples/beam_lift.cell"));
}

#[test]
fn weld() {
    sized("weld", include_str!("../../examples/weld_cell.cell"));
}
