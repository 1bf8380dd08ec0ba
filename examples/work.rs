//! Work-coupled processes: one robot welds spot after spot under a lease, and its program crashes. The other robot, which has
//! received its heartbeats, takes over at the last published spot. The gun obeys one of them at a time.
//!
//! `cargo run --example work`

use imrs_runtime::protocol::PortId;
use imrs_runtime::{Asked, Context, TaskEnd, TaskError};
use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

mod cell {
    imrs_macros::cell!("examples/classes/work.cell");
}
use cell::{Spot, ports};

const SPOTS: i8 = 6;
const CRASHES_AT: i8 = 3;

/// Welds a spot, or prints that it must be rechecked, because it may have been welded.
fn weld<S>(ctx: &mut Context<S>, gun: PortId, number: i8) -> Result<(), TaskError> {
    match ctx.query::<_, ()>(gun, &Spot { number })? {
        Asked::Reply(()) => println!("{:>6} has welded spot {number}", ctx.name()),
        Asked::Refused | Asked::TimedOutUnsent => println!("{:>6} left out spot {number}", ctx.name()),
        Asked::TimedOutUnknown | Asked::PeerRestarted => println!("recheck spot {number}"),
    }
    Ok(())
}

fn first(ctx: &mut Context) -> Result<(), TaskError> {
    ctx.lease()?;
    for number in 0..SPOTS {
        ctx.publish(&[number.to_le_bytes()[0]])?;
        assert_ne!(number, CRASHES_AT, "the first robot's program crashes here");
        weld(ctx, ports::WELD, number)?;
        // Longer than a heartbeat period, so that the other robot learns the current spot.
        ctx.delay(Duration::from_millis(100))?;
    }
    Ok(())
}

fn second(ctx: &mut Context<bool>) -> Result<(), TaskError> {
    ctx.on_takeover(|ctx, epoch| {
        println!("second takes over, epoch {epoch}");
        let heard = ctx.published();
        let from = heard
            .as_ref()
            .and_then(|told| told.as_bytes().first())
            .map_or(0, |&byte| i8::from_le_bytes([byte]));
        for number in from..SPOTS {
            weld(ctx, ports::REWELD, number)?;
        }
        ctx.state = true;
        Ok(())
    });
    while !ctx.state {
        ctx.delay(Duration::from_millis(100))?;
    }
    Ok(())
}

/// Obeys until the last spot, or until no request has come for some time. Reports each spot that it welds.
fn gun(ctx: &mut Context, welded: &Sender<i8>) -> Result<(), TaskError> {
    while let Some(asked) = ctx.receive(None, Some(Duration::from_secs(20)))? {
        let Spot { number } = ctx.read(&asked)?;
        // The receiver may be gone, which does not matter.
        let _ = welded.send(number);
        ctx.answer(&asked.from, &())?;
        if number == SPOTS - 1 {
            break;
        }
    }
    Ok(())
}

/// Runs the cell until its tasks have ended.
pub fn main() {
    let (tells, welded) = channel();
    let node = cell::builder(cell::nodes::HERE)
        .task("first", first)
        .task("second", Context::with_state(false, second))
        .task("gun", move |ctx| gun(ctx, &tells))
        .start()
        .expect("a node that starts");
    assert!(node.wait(Duration::from_secs(60)), "the programs have ended");
    for (task, end) in node.stop(Duration::from_secs(1)) {
        // If the machine stalls, the first robot may lose its lease before it crashes.
        let gone = matches!(end, TaskEnd::Panicked(_) | TaskEnd::Failed(_));
        assert!(gone == (task == "first") && (gone || end == TaskEnd::Returned), "{task}: {end:?}");
    }
    let mut spots: Vec<i8> = welded.iter().collect();
    // The spot at which the first robot failed may be there twice: the second robot knows only of spots that a message named.
    spots.sort_unstable();
    spots.dedup();
    assert_eq!(spots, [0, 1, 2, 3, 4, 5], "every spot");
}
