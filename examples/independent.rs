//! Independent processes: two robots change the speed of one belt. Only the belt's own task sets the speed, and only for a
//! request with the current version. Of two changes at once, one robot is told the version that it missed, and asks again.
//!
//! `cargo run --example independent`

use imrs_runtime::{Asked, Context, TaskEnd, TaskError};
use std::time::Duration;

mod cell {
    imrs_macros::cell!("examples/classes/independent.cell");
}
use cell::{Speed, ports};

/// Sends its speed to all, and changes it on a request with the current version.
fn belt(ctx: &mut Context<Speed>) -> Result<(), TaskError> {
    ctx.on_query(ports::CHANGE, |ctx, wanted: Speed| {
        if wanted.version == ctx.state.version {
            ctx.state = Speed { version: wanted.version + 1, mm_s: wanted.mm_s };
        }
        Ok(ctx.state)
    })?;
    while ctx.state.version < 2 {
        ctx.tell(ports::SPEED, &ctx.state.clone())?;
        ctx.delay(Duration::from_millis(20))?;
    }
    println!("the belt runs at {} mm/s after {} changes", ctx.state.mm_s, ctx.state.version);
    Ok(())
}

/// Changes the speed once.
fn robot(ctx: &mut Context, mm_s: i16) -> Result<(), TaskError> {
    let mut now = Speed::default();
    if let Some(told) = ctx.take(ports::SPEED, Some(Duration::from_millis(500)))? {
        now = told.message;
    }
    loop {
        match ctx.query::<_, Speed>(ports::CHANGE, &Speed { mm_s, ..now })? {
            Asked::Reply(speed) if speed.version == now.version + 1 && speed.mm_s == mm_s => {
                println!("{} has set {mm_s} mm/s", ctx.name());
                return Ok(());
            }
            // The other robot was faster, or an earlier attempt succeeded and its answer was late.
            Asked::Reply(speed) => now = speed,
            Asked::Refused | Asked::TimedOutUnsent => ctx.delay(Duration::from_millis(10))?,
            Asked::TimedOutUnknown | Asked::PeerRestarted => println!("{} asks again", ctx.name()),
        }
    }
}

/// Runs the cell until its tasks have ended.
pub fn main() {
    let node = cell::builder(cell::nodes::HERE)
        .task("belt", Context::with_state(Speed { version: 0, mm_s: 200 }, belt))
        .task("slow", |ctx| robot(ctx, 100))
        .task("fast", |ctx| robot(ctx, 400))
        .start()
        .expect("a node that starts");
    assert!(node.wait(Duration::from_secs(30)), "the programs have ended");
    for (task, end) in node.stop(Duration::from_secs(1)) {
        assert_eq!(end, TaskEnd::Returned, "{task}");
    }
}
