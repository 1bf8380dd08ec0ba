//! Loosely coupled processes: two welders share one tool, which its administrator lends. A welder that is refused does other
//! work meanwhile. A welder that dies with the tool loses it when the time limit ends.
//!
//! `cargo run --example loose`

use imrs_runtime::protocol::{PortId, TaskId, TimeId};
use imrs_runtime::{Asked, Context, TaskEnd, TaskError};
use std::time::Duration;

mod cell {
    imrs_macros::cell!("examples/classes/loose.cell");
}
use cell::{Grant, ports};

/// The time limit of a loan. No seam takes longer, so a welder that still has the tool then is dead.
const LENT: Duration = Duration::from_secs(4);
const HELD: TimeId = TimeId(1);
const SEAMS: u32 = 3;

/// Lends the tool to one welder at a time, until no welder has used it for a second.
fn tool(ctx: &mut Context<Option<TaskId>>) -> Result<(), TaskError> {
    ctx.on_timer(HELD, |ctx| {
        ctx.state = None;
        Ok(())
    });
    ctx.on_message(ports::GRAB, |ctx, asked| {
        let ok = ctx.state.is_none();
        if ok {
            ctx.state = Some(asked.from.source);
            ctx.start_timer(HELD, LENT)?;
        }
        ctx.answer(&asked.from, &Grant { ok })
    })?;
    while let Some(freed) = ctx.receive(Some(ports::FREE), Some(Duration::from_secs(1)))? {
        if ctx.state == Some(freed.from.source) {
            ctx.state = None;
            ctx.stop_timer(HELD)?;
        }
        ctx.answer(&freed.from, &())?;
    }
    Ok(())
}

/// Queries the other task. Returns its answer, if one came.
fn done<M: imrs_runtime::Message>(ctx: &mut Context, port: PortId) -> Result<Option<M>, TaskError> {
    Ok(match ctx.query::<(), M>(port, &())? {
        Asked::Reply(answer) => Some(answer),
        // No answer came. If the loan began anyway, the tool's time limit ends it.
        Asked::Refused | Asked::TimedOutUnsent | Asked::TimedOutUnknown | Asked::PeerRestarted => None,
    })
}

fn welder(ctx: &mut Context) -> Result<(), TaskError> {
    let mut seams = 0;
    while seams < SEAMS {
        if done::<Grant>(ctx, ports::GRAB)?.is_some_and(|grant| grant.ok) {
            seams += 1;
            println!("{:>5} welds seam {seams}", ctx.name());
            ctx.delay(Duration::from_millis(30))?;
            if done::<()>(ctx, ports::FREE)?.is_none() {
                println!("{:>5} cannot give the tool back", ctx.name());
            }
        }
        // Other work that does not need the tool.
        ctx.delay(Duration::from_millis(10))?;
    }
    Ok(())
}

/// Runs the cell until its tasks have ended.
pub fn main() {
    let node = cell::builder(cell::nodes::HERE)
        .task("tool", Context::with_state(None, tool))
        .task("left", welder)
        .task("right", welder)
        .start()
        .expect("a node that starts");
    assert!(node.wait(Duration::from_secs(60)), "the programs have ended");
    for (task, end) in node.stop(Duration::from_secs(1)) {
        assert_eq!(end, TaskEnd::Returned, "{task}");
    }
}
