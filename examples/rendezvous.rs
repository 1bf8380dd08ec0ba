//! Three robots meet before each of three lifts: a whole program, on one node, without a network.
//!
//! `cargo run --example rendezvous`

use imrs_protocol::{Cell, CellTable, PortDecl, TaskId, Ticks, Usage};
use imrs_runtime::{Context, Rendezvous, Runtime, StartError, TaskEnd, TaskError};
use std::sync::Arc;
use std::time::{Duration, Instant};

const ROBOTS: [&str; 3] = ["left arm", "right arm", "hoist"];
const LIFTS: u32 = 3;

/// Gets ready at the robot's own speed, meets the others, and lifts.
fn robot(ctx: &mut Context, begin: Instant) -> Result<(), TaskError> {
    let lift = ctx.port("lift")?;
    let slowness = u64::from(ctx.id().0) + 1;
    for _ in 0..LIFTS {
        ctx.delay(Duration::from_millis(40 * slowness))?;
        println!("{:>9} is ready   at {:>3} ms", ctx.name(), begin.elapsed().as_millis());
        match ctx.waitfor(lift)? {
            Rendezvous::Released { round, .. } => {
                println!("{:>9} lifts ({round}) at {:>3} ms", ctx.name(), begin.elapsed().as_millis());
            }
            Rendezvous::GaveUp { missing, .. } => println!("{:>9} gives up: {missing:b} missing", ctx.name()),
        }
    }
    Ok(())
}

fn main() -> Result<(), StartError> {
    let mut cell = Cell::new("three-robots", Ticks(1_000));
    let here = cell.node("here");
    let [left, right, hoist]: [TaskId; 3] = ROBOTS.map(|name| cell.task(name, here));
    // In microseconds: the robots wait for each other for at most two seconds.
    cell.port(PortDecl::new("lift", left, Usage::Waitfor, &[right, hoist], Ticks(2_000_000)));
    let table = Arc::new(CellTable::new(cell).expect("a cell without faults"));

    let begin = Instant::now();
    let mut node = Runtime::builder(table, here);
    for name in ROBOTS {
        node = node.task(name, move |ctx| robot(ctx, begin));
    }
    let node = node.start()?;
    assert!(node.wait(Duration::from_secs(30)), "the robots have ended");
    for (task, end) in node.stop(Duration::from_secs(1)) {
        assert_eq!(end, TaskEnd::Returned, "{task}");
    }
    Ok(())
}
