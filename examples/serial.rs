//! Serialized motions: one robot hands parts to the other. They meet, and the second robot closes its gripper. The first one
//! opens its own only when the second one reports that it holds the part.
//!
//! `cargo run --example serial`

use imrs_runtime::{Asked, Context, Rendezvous, TaskEnd, TaskError};
use std::time::Duration;

mod cell {
    imrs_macros::cell!("examples/classes/serial.cell");
}
use cell::ports;

const PARTS: u32 = 3;

fn pick(ctx: &mut Context) -> Result<(), TaskError> {
    for part in 1..=PARTS {
        ctx.delay(Duration::from_millis(20))?;
        if let Rendezvous::GaveUp { .. } = ctx.waitfor(ports::GIVE)? {
            println!("pick puts part {part} back: place is missing");
            continue;
        }
        match ctx.take::<bool>(ports::RELEASE, Some(Duration::from_secs(1)))? {
            Some(told) => {
                if told.message {
                    println!("pick lets go of part {part}");
                }
                ctx.answer(&told.from, &())?;
            }
            None => println!("pick keeps part {part}: place does not say that it holds it"),
        }
    }
    Ok(())
}

fn place(ctx: &mut Context) -> Result<(), TaskError> {
    for part in 1..=PARTS {
        if let Rendezvous::GaveUp { .. } = ctx.waitfor(ports::GIVE)? {
            println!("place goes on without part {part}: pick is missing");
            continue;
        }
        ctx.delay(Duration::from_millis(10))?;
        match ctx.query::<bool, ()>(ports::RELEASE, &true)? {
            Asked::Reply(()) => println!("place has part {part}"),
            Asked::Refused | Asked::TimedOutUnsent => println!("place opens again: pick was not told"),
            // Both robots may hold the part, or this one alone: neither may drop it.
            Asked::TimedOutUnknown | Asked::PeerRestarted => println!("place holds on to part {part}"),
        }
    }
    Ok(())
}

/// Runs the cell until its tasks have ended.
pub fn main() {
    let node = cell::builder(cell::nodes::HERE)
        .task("pick", pick)
        .task("place", place)
        .start()
        .expect("a node that starts");
    assert!(node.wait(Duration::from_secs(30)), "the programs have ended");
    for (task, end) in node.stop(Duration::from_secs(1)) {
        assert_eq!(end, TaskEnd::Returned, "{task}");
    }
}
