//! Two arms lift a beam with a hoist (tightly coupled robots, §II).
//!
//! All three meet at the `waitfor` port `lift` before every lift: nobody pulls alone. While they move, the left arm
//! asks the right one every few milliseconds whether it still moves too (`beat`, class 2), and says when to stop
//! (`halt`, class 1, because it must never hold up the own stop; a lost halt is made up for by the silence that
//! follows). The times are those of a real lift made about ten times shorter, so that a short run has hundreds of meetings.

use imrs_protocol::{Cell, PortDecl, Ticks, Usage};

/// The cell's name.
pub const NAME: &str = "beam-lift";
/// The port where all meet.
pub const LIFT: &str = "lift";
/// The port of the heart-beats between the arms.
pub const BEAT: &str = "beat";
/// The port of the order to stop.
pub const HALT: &str = "halt";
/// The left arm, which leads.
pub const ARM_L: &str = "armL";
/// The right arm.
pub const ARM_R: &str = "armR";
/// The hoist.
pub const HOIST: &str = "hoist";

/// Microseconds: the ticks of the runtime.
const fn msec(n: u64) -> Ticks {
    Ticks(n * 1_000)
}

/// The cell. Its ticks are microseconds.
#[must_use]
pub fn cell() -> Cell {
    let mut cell = Cell::new(NAME, msec(1));
    let (left, right, top) = (cell.node("nl"), cell.node("nr"), cell.node("nh"));
    for (a, b) in [(left, right), (left, top), (right, top)] {
        cell.link(a, b, msec(1));
    }
    let arm_l = cell.task(ARM_L, left);
    let arm_r = cell.task(ARM_R, right);
    let hoist = cell.task(HOIST, top);

    cell.port(PortDecl::new(LIFT, arm_l, Usage::Waitfor, &[arm_r, hoist], msec(200)).resend(msec(5), 2));
    cell.port(
        PortDecl::new(BEAT, arm_l, Usage::Send, &[arm_r], msec(20))
            .command()
            .retry(2, msec(6))
            .format("Beat: sent_us: int64; round: int16; step: int8"),
    );
    cell.port(
        PortDecl::new(HALT, arm_l, Usage::Send, &[arm_r, hoist], msec(10))
            .bounded_buffer(2)
            .format("Stop: sent_us: int64; round: int16; reason: int8"),
    );
    cell
}

#[cfg(test)]
mod tests {
    use super::*;
    use imrs_protocol::CellTable;

    #[test]
    fn the_cell_is_sound_and_its_margin_leaves_time_to_meet() {
        let table = CellTable::new(cell()).expect("no fault in the declarations");
        let lift = table.ports().iter().find(|p| p.decl.name == LIFT).expect("the port");
        assert_eq!(lift.parties.len(), 3);
        // Two losses cost two more periods of re-sending: 1 + 2 x (5 + 1) + 1 ms.
        assert_eq!(lift.margin, msec(14));
        assert!(lift.decl.time_out.0 > 10 * lift.margin.0);
    }
}
