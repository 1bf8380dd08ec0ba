//! Checks a whole cell: the scripts of its tasks over the machine, every interleaving within declared faults.
//!
//! ```text
//!   CellPlan --> independent parts, each a Course (a Floor whose time jumps from event to event)
//!                                                                           |
//!                                                                         search, without faults and with them
//!                                                                           |
//!   Verdicts: findings, each with the shortest way to it; bounds, sizes, coverage  <--+
//! ```
//!
//! What is looked at, and what is not:
//! - A packet takes its link's bound, in the order sent; it may be lost, doubled or cut off within the budgets, or
//!   arrive right before one that was sent earlier.
//! - An action ends when its least time is over or when its most is. Each end gives each of the values worth trying, and
//!   may fail within the budget.
//! - That is [`Times::Ends`]. The finer [`Times`] let actions end and packets arrive right after whatever else happens in the
//!   cell meanwhile, or at every tick.
//! - What two nodes do in the same tick cannot reach each other in it: the nodes take turns in their order, and checks
//!   are looked at after each turn. On one node every order of arrivals and ends of actions is tried, after what the
//!   tick itself brings there (time_outs, timers, beats).
//! - A named node crashes after any of its steps, and comes back in its next life at once, when a packet comes for it, or
//!   when nothing else happens any more; or it stays down. With [`CellPlan::everything`] also at every other event.
//! - A named link is cut from any packet on, in both directions, until any later one.
//! - A named node pauses before anything that it would do, and goes on after any later event, when its own next deadline
//!   or lease is over, or when the pause has lasted as long as it may (`course::pause`).
//! - A time_out and a packet of the same tick: the time_out comes first.
//! - The script of a task whose node came back begins when nothing of its earlier life is under way any more, as on real nodes (D157).
//! - A task outside the cell chooses among all uses of its ports, or none, once in its period; what it says is one of a few
//!   values: zero, one, constants of the other tasks and what lies next to those ([`Tried`]).
//!
//! Tasks that share no port, node, link, couple or check are in independent parts (`parts`), each searched by itself. With
//! [`Times::Between`], and when a node that is down starts again, what happens "in the cell" is what happens in the part.
//!
//! A request that ends by its time_out without a fault is starvation where it was put off more often than aging allows.
//! Where all tasks go on for ever and nothing comes further any more, that is a warning (`standstill`). Not looked at: a task that
//! goes on for ever without coming further while another one of its part does come further.

mod alike;
mod conclude;
mod context;
mod course;
mod done;
mod each_part;
mod follow;
mod frames;
mod guard;
mod judge;
mod legend;
mod missed;
mod outside;
mod parts;
mod plan;
mod reader;
mod search;
mod seen;
mod simulate;
mod standstill;
mod starve;
mod story;
mod svg;
mod unpacked;
mod values;
mod verdict;
mod view;
mod waiting;
mod walker;

pub use crate::chart::{Folding, Note, chart};
pub use course::CellMove;
pub use follow::{
    Followed, Happened, Happening, Late, Run, Steps, Turn, Unexplained, follow_run, steps_in_model,
};
pub use frames::{NodeFrame, Scene, Shows, scenes};
pub use guard::{Agreement, Disagreement, Effort, compare_with_walks};
pub use legend::Legend;
pub use plan::{Budget, CellCheck, CellFaults, CellPlan, Conduct, Holds, Pause, Times};
pub use search::check_cell;
pub use simulate::{Chooser, Ended, Fault, Found, MOST_FAULTS, Schedule, Shrunk, Simulated, Simulator, Tape};
pub use story::drawn;
pub use svg::svg;
pub use values::Tried;
pub use verdict::{Concerned, Coverage, Finding, Kind, Phase, Refused, Step, TaskView, Verdicts};
