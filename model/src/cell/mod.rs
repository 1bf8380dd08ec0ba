//! Checks a whole cell: runs its scripts on the protocol's state machine, in every interleaving within the declared faults.
//!
//! ```text
//!   CellPlan --> independent parts, each a Course (a cell state whose time jumps from event to event)
//!                                                                           |
//!                                                                         search, without faults and with them
//!                                                                           |
//!   Verdicts: findings, each with its shortest counterexample; bounds, sizes, coverage  <--+
//! ```
//!
//! What the search covers:
//! - A packet takes its link's bound, in the order sent. Within the budgets it may be lost, duplicated or cut off, or arrive
//!   right before a packet that was sent earlier.
//! - An action ends at its least or most time. An action that ends gives each of the results worth trying, or fails within
//!   the budget.
//! - These times are [`Times::Ends`]. The finer [`Times`] also let actions end and packets arrive right after any other
//!   event of the cell, or at every tick. `look` chooses among them.
//! - Two nodes cannot reach each other within a tick, so nodes act one after the other. Checks are evaluated after every step.
//!   A check that reads several nodes must hold in any order of these nodes (D161).
//! - On one node the search tries every order of what its tasks do, of arrivals and of ends of actions. Each task notices the
//!   time first, so its time_out comes before a packet of the same tick (D170).
//! - A node named for a crash crashes at the end of any tick in which it took a step. The node restarts in its next
//!   incarnation at once, when a packet arrives for it, or when nothing else happens any more; or it stays down. With
//!   [`CellPlan::everything`], crash and restart happen at every other event, too.
//! - A link named for a cut loses every packet in both directions, from any packet on until any later packet.
//! - A node named for a pause pauses before any of its steps. The node wakes after any later event, at its own next
//!   deadline or end of lease, or when the pause reaches its bound (`run_state::pause`).
//! - The script of a restarted node begins once no message of its earlier incarnation is in flight, as on real nodes (D157).
//! - A task outside the cell chooses one use of its ports, or none, once in its period. Its messages carry one of a few values:
//!   zero, one, constants of the other tasks and their neighbours ([`Tried`]).
//!
//! Tasks that share no port, node, link, couple or check are in independent parts (`parts`), and each part is searched by
//! itself. Therefore, for [`Times::Between`], and for a restart "when nothing else happens", only events of the same part
//! count.
//!
//! A request that ends by its time_out without a fault is starvation if it was rejected or bypassed more often than aging
//! allows. A livelock of all tasks is a warning (`standstill`); a livelock of one task, while others progress, is not
//! detected.

mod alike;
mod conclude;
mod context;
mod done;
mod each_part;
mod follow;
mod frames;
mod guard;
mod judge;
mod legend;
mod look;
mod missed;
mod outside;
mod parts;
mod plan;
mod progress;
mod reader;
mod run_state;
mod search;
mod seen;
mod simulate;
mod standstill;
mod starve;
mod story;
mod svg;
mod unfinished;
mod unpacked;
mod values;
mod verdict;
mod view;
mod waiting;
mod walker;
mod zones;

pub use crate::chart::{Folding, Note, chart};
pub use follow::{
    Followed, Happened, Happening, Late, Run, Steps, Turn, Unexplained, follow_run, steps_in_model,
};
pub use frames::{NodeFrame, Scene, Shows, scenes};
pub use guard::{Agreement, Disagreement, Effort, compare_with_walks};
pub use legend::Legend;
pub use look::{check_cell, check_cell_and_tell};
pub use plan::{Budget, CellCheck, CellFaults, CellPlan, Conduct, Holds, Pause, Times};
pub use progress::{FoundSoFar, SearchProgress, SoFar};
pub use run_state::CellMove;
pub use simulate::{Chooser, Ended, Fault, Found, MOST_FAULTS, Schedule, Shrunk, Simulated, Simulator, Tape};
pub use story::drawn;
pub use svg::svg;
pub use values::Tried;
pub use verdict::{
    Concerned, Coverage, Finding, Kind, ManyValues, Phase, Refused, Step, TaskView, TimeRange, Timed,
    Unfinished, Verdicts,
};
pub use zones::{compare_ranges_with_runs, compare_zones_with_walks};
