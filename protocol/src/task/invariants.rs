//! The invariants of a communication task after every input. The checker, the simulator, the replay of recordings and debug
//! runs call [`check`]. A violation is a fault of the state machine, never of a program or of the network.

pub use super::violation::Violation;

use super::CommTask;
use crate::table::NodeTable;

/// Checks one communication task between two inputs. Scans its whole state, and allocates nothing.
///
/// # Errors
/// The first violation found.
pub fn check(task: &CommTask, table: &NodeTable) -> Result<(), Violation> {
    if task.due.is_some_and(|due| due != task.machines.due()) {
        return Err(Violation::WrongDeadline);
    }
    task.machines.check(table, &task.own)
}
