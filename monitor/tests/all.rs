//! The tests of the monitor, built as one program. The tests in `*_memory.rs` are programs of their own.

mod blocked;
mod clicks;
mod common;
#[path = "../../protocol/tests/allocations.rs"]
mod counting;
mod crowd;
mod cursor;
mod cuts;
mod events;
mod export;
mod history;
mod hostile;
mod large;
mod layout;
mod link_health;
mod live;
mod missing;
mod narrow;
mod overview;
mod problems;
mod query;
mod reading;
mod reduce;
mod replay;
mod replay_screens;
mod screens;
mod settings;
mod steer;
mod targets;
mod timeline;
mod titles;
mod trouble;
mod typing;
mod waits;

use counting::allocations;
