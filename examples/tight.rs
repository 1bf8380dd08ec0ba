//! Tightly coupled processes: two arms lift one beam. They start together, and while they move the left arm keeps asking the
//! right one for its position. An arm that hears nothing from the other one stops.
//!
//! `cargo run --example tight`

use imrs_runtime::protocol::{Ranked, TimeId};
use imrs_runtime::{Asked, Context, Rendezvous, TaskEnd, TaskError};
use std::time::Duration;

mod cell {
    imrs_macros::cell!("examples/classes/tight.cell");
}
use cell::{Beat, ports};

/// The right arm stops if no `beat` has come for this time.
const SILENCE: Duration = Duration::from_millis(300);
const WATCH: TimeId = TimeId(1);
const HEIGHT: i16 = 40;

fn left(ctx: &mut Context<Beat>) -> Result<(), TaskError> {
    match ctx.waitfor(ports::LIFT)? {
        Rendezvous::Released { .. } => ctx.state.moving = true,
        Rendezvous::GaveUp { .. } => println!("left opens its gripper: the other arm is missing"),
    }
    while ctx.state.moving {
        ctx.state.height += 2;
        let me = Beat { moving: ctx.state.height < HEIGHT, ..ctx.state };
        ctx.state.moving = match ctx.query::<_, Beat>(ports::BEAT, &me)? {
            Asked::Reply(other) => me.moving && other.moving,
            // The other arm may have stopped or not, so this one stops.
            Asked::Refused | Asked::TimedOutUnsent | Asked::TimedOutUnknown | Asked::PeerRestarted => false,
        };
        ctx.delay(Duration::from_millis(3))?;
    }
    println!("left stops at {} mm", ctx.state.height);
    Ok(())
}

fn right(ctx: &mut Context<Beat>) -> Result<(), TaskError> {
    ctx.order(&[Ranked::Port(ports::BEAT), Ranked::Timers, Ranked::Own])?;
    ctx.on_timer(WATCH, |ctx| {
        ctx.state.moving = false;
        Ok(())
    });
    ctx.on_query(ports::BEAT, |ctx, other: Beat| {
        ctx.start_timer(WATCH, SILENCE)?;
        ctx.state = Beat { height: other.height, moving: ctx.state.moving && other.moving };
        Ok(ctx.state)
    })?;
    // A query may come before this arm learns of its release. So the arm counts as moving from its arrival on.
    ctx.state.moving = true;
    match ctx.waitfor(ports::LIFT)? {
        Rendezvous::Released { .. } => ctx.start_timer(WATCH, SILENCE)?,
        Rendezvous::GaveUp { .. } => ctx.state.moving = false,
    }
    while ctx.state.moving {
        // Every `beat` interrupts this delay, and so does `WATCH`.
        ctx.delay(Duration::from_millis(5))?;
    }
    println!("right stops at {} mm", ctx.state.height);
    Ok(())
}

/// Runs the cell until its tasks have ended.
pub fn main() {
    let node = cell::builder(cell::nodes::HERE)
        .task("left", Context::with_state(Beat::default(), left))
        .task("right", Context::with_state(Beat::default(), right))
        .start()
        .expect("a node that starts");
    assert!(node.wait(Duration::from_secs(30)), "the programs have ended");
    for (task, end) in node.stop(Duration::from_secs(1)) {
        assert_eq!(end, TaskEnd::Returned, "{task}");
    }
}
