//! Work-coupled processes: one robot welds spot after spot under a lease, and its program crashes. The other, which has
//! heard its beats, takes over at the spot that was published last. The gun obeys one of them at a time.
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

/// Welds a spot, or says that nobody knows whether it was.
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
        // Longer than a beat: the other hears where this one is.
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

/// Obeys until nobody has asked for some time, and tells what it has welded.
fn gun(ctx: &mut Context, welded: &Sender<i8>) -> Result<(), TaskError> {
    while let Some(asked) = ctx.receive(None, Some(Duration::from_secs(20)))? {
        let Spot { number } = ctx.read(&asked)?;
        // Who has ended listens to nothing more.
        let _ = welded.send(number);
        ctx.answer(&asked.from, &())?;
        if number == SPOTS - 1 {
            break;
        }
    }
    Ok(())
}

/// Runs the cell until its programs have ended.
pub fn main() {
    let (tells, welded) = channel();
    let node = cell::builder(cell::nodes::HERE)
        .task("first", first)
        .task_with("second", false, second)
        .task("gun", move |ctx| gun(ctx, &tells))
        .start()
        .expect("a node that starts");
    assert!(node.wait(Duration::from_secs(60)), "the programs have ended");
    for (task, end) in node.stop(Duration::from_secs(1)) {
        // On a machine that stands still the first one may lose its lease before it crashes.
        let gone = matches!(end, TaskEnd::Panicked(_) | TaskEnd::Failed(_));
        assert!(gone == (task == "first") && (gone || end == TaskEnd::Returned), "{task}: {end:?}");
    }
    let mut spots: Vec<i8> = welded.iter().collect();
    // The one that was under way last may be welded twice: the other knows what it heard, no more.
    spots.sort_unstable();
    spots.dedup();
    assert_eq!(spots, [0, 1, 2, 3, 4, 5], "every spot");
}
