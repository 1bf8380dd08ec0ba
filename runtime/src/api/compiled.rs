//! Cells that `imrs_macros::cell!` compiled into the program. The code that the macro writes calls these functions; programs
//! do not.

use crate::{Builder, Runtime};
use imrs_protocol::script::Program;
use imrs_protocol::{Cell, CellTable, NodeId};
use std::sync::Arc;

/// The table of a cell that was checked when the program was compiled.
///
/// # Panics
/// If the bytes were written by another version of this library.
#[must_use]
pub fn table(cell: &[u8]) -> Arc<CellTable> {
    let cell: Cell = postcard::from_bytes(cell).expect("the macros and the runtime are of one version");
    Arc::new(CellTable::new(cell).expect("a cell that was compiled"))
}

/// A builder for a node, with those scripts of the cell that belong to it.
///
/// # Panics
/// If the bytes were written by another version of this library.
pub fn builder(table: Arc<CellTable>, node: NodeId, scripts: &[(&str, NodeId, &[u8])]) -> Builder {
    let own = scripts.iter().filter(|(_, on, _)| *on == node);
    own.fold(Runtime::builder(table, node), |builder, (name, _, program)| {
        let program: Program =
            postcard::from_bytes(program).expect("the macros and the runtime are of one version");
        builder.script(name, Arc::new(program))
    })
}
