//! A cell with a camera in Rust: the camera finds parts on a belt, and a scripted robot picks them.
//!
//! `cargo run --example extern_task`, or the camera alone: `cargo run --example extern_task -- --node nc`, beside
//! `imrs run examples/extern_task.cell --node np`, with the keys of `imrs keygen examples/extern_task.cell`.

use imrs_client::{Context, Program, ProgramError, TaskEnd, TaskError};
use std::time::Duration;

const CELL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/extern_task.cell");
/// The time between two pictures: about 30 a second.
const PERIOD: Duration = Duration::from_millis(34);
/// The camera stops after ten seconds. By then the robot has picked all its parts.
const PICTURES: i16 = 300;

/// Finds a part in every picture. Every second part lies out of the robot's reach.
fn camera(ctx: &mut Context) -> Result<(), TaskError> {
    let pose = ctx.port("pose")?;
    for picture in 0..PICTURES {
        let x = if picture % 2 == 0 { 120 + picture } else { 900 };
        // A message is the bytes of its fields, one after the other, little endian.
        let [a, b] = x.to_le_bytes();
        let [c, d] = 40_i16.to_le_bytes();
        // The message is a status: it has no answer, and is dropped if it comes too late.
        let _copies = ctx.send(pose, &[a, b, c, d])?;
        ctx.delay(PERIOD)?;
    }
    Ok(())
}

/// Runs the whole cell, or one node of it.
pub fn main() -> Result<(), ProgramError> {
    let mut program = Program::open(CELL)?.task("camera", camera).action("pick_at", |call| {
        let [x, y] = call.arguments[..] else { return Err("no place".into()) };
        println!("{} picks the part at ({x}, {y})", call.task);
        Ok(0)
    });
    let args: Vec<String> = std::env::args().collect();
    if let [_, flag, node] = &args[..]
        && flag == "--node"
    {
        program = program.node(node);
    }
    // The run ends when all tasks have ended, or after a minute.
    for (task, end) in program.run(Some(Duration::from_secs(60)))? {
        let how = match end {
            TaskEnd::Script(_) => "done",
            TaskEnd::Returned => "returned",
            TaskEnd::Failed(_) | TaskEnd::Panicked(_) | TaskEnd::Unfinished => "failed",
        };
        println!("{task}: {how}");
    }
    Ok(())
}
