//! While a task's thread runs, other threads leave input for it until its next call (D130). The task gets the inputs
//! in order, the messages' remaining time keeps running, and an observer sees the messages.

use crate::common::{A, B, LONG, LONG_TICKS, cell, finish, one_node, report, table};
use imrs_protocol::{PortDecl, PortId, Reason, Target, Ticks, Usage};
use imrs_runtime::{Context, TaskEnd, TaskError};
use std::sync::{Arc, Barrier};
use std::thread;
use std::time::Duration;

const NEWS: PortId = PortId(0);
const URGENT: PortId = PortId(1);
/// More inputs than can ever be left for a running thread.
const MANY: u8 = 50;

fn two_ports() -> Arc<imrs_protocol::CellTable> {
    let mut cell = cell(&[0, 0], Ticks(0));
    let port = |name, ttl| PortDecl::new(name, A, Usage::Send, &[B], ttl).bounded_buffer(64);
    cell.port(port("news", LONG_TICKS));
    cell.port(port("urgent", Ticks(30_000_000)));
    table(cell)
}

/// A program that calls its communication task once. From then on the node knows that this thread runs.
fn runs(ctx: &mut Context) -> Result<(), TaskError> {
    assert_eq!(ctx.poll(None)?, None);
    Ok(())
}

/// Sends `count` messages to a task that runs, and checks in which order that task takes them.
fn send_to_a_task_that_runs(count: u8) {
    let (begins, sent) = (Arc::new(Barrier::new(2)), Arc::new(Barrier::new(2)));
    let (it_runs, all_sent) = (Arc::clone(&begins), Arc::clone(&sent));
    let node = one_node(&two_ports())
        .task("a", move |ctx| {
            it_runs.wait();
            for number in 1..=count {
                let _copies = ctx.send(NEWS, &[number])?;
            }
            let brief = Some(Duration::from_millis(20));
            let _copies = ctx.send_with(NEWS, Target::All, &[u8::MAX], brief)?;
            let _copies = ctx.send(URGENT, &[0])?;
            all_sent.wait();
            Ok(())
        })
        .task("b", move |ctx| {
            runs(ctx)?;
            begins.wait();
            sent.wait();
            thread::sleep(Duration::from_millis(40));
            for number in 0..=count {
                let message = ctx.receive(None, Some(LONG))?.expect("all were sent before");
                assert_eq!(message.contents.as_bytes(), [number]);
                let ttl = if number == 0 { Ticks(30_000_000) } else { LONG_TICKS };
                assert!(message.budget <= ttl - Ticks(40_000), "what it waited is taken off: {message:?}");
            }
            assert_eq!(ctx.poll(None)?, None, "what expired meanwhile is not served");
            Ok(())
        })
        .start()
        .unwrap();
    let view = Arc::clone(node.node());
    finish(node);
    let counts = view.snapshot(0).discards;
    let expired = counts.iter().find(|count| count.name == Reason::Expired.name());
    assert_eq!(expired.map_or(0, |count| count.count), 1);
}

#[test]
fn what_was_left_to_it_is_served_by_urgency_or_expires() {
    send_to_a_task_that_runs(8);
}

#[test]
fn so_is_more_than_is_left_to_it() {
    send_to_a_task_that_runs(MANY);
}

#[test]
fn whoever_looks_sees_what_was_left() {
    let (begins, sent, seen) =
        (Arc::new(Barrier::new(2)), Arc::new(Barrier::new(2)), Arc::new(Barrier::new(2)));
    let (it_runs, all_sent, was_seen) = (Arc::clone(&begins), Arc::clone(&sent), Arc::clone(&seen));
    let node = one_node(&two_ports())
        .task("a", move |ctx| {
            it_runs.wait();
            for number in 0..5 {
                let _copies = ctx.send(NEWS, &[number])?;
            }
            all_sent.wait();
            Ok(())
        })
        .task("b", move |ctx| {
            runs(ctx)?;
            begins.wait();
            was_seen.wait();
            Ok(())
        })
        .start()
        .unwrap();
    sent.wait();
    let waiting = node.node().snapshot(2).tasks[1].view.ports[0].clone();
    seen.wait();
    assert_eq!((waiting.len, waiting.queue.len(), waiting.counters.enqueued), (5, 2, 5));
    finish(node);
}

/// The delay is far longer than the test needs on any machine. The end of the node ends the delay.
#[test]
fn a_handler_interrupts_a_delay_that_is_spun_for() {
    let length = 10 * LONG;
    let (begins, it_begins) = report();
    let (handles, handled) = report();
    let node = one_node(&two_ports())
        .spin_tail(2 * length)
        .task("a", move |ctx| {
            it_begins.recv_timeout(LONG).expect("b begins");
            // By now the thread most likely spins.
            thread::sleep(Duration::from_millis(50));
            ctx.send(NEWS, b"!").map(|_copies| ())
        })
        .task("b", move |ctx| {
            ctx.on_message(NEWS, move |_, _| {
                handles.send(()).expect("the test listens");
                Ok(())
            })?;
            begins.send(()).expect("a waits");
            assert_eq!(ctx.delay(length), Err(TaskError::Stopped), "the delay goes on");
            Ok(())
        })
        .start()
        .unwrap();
    handled.recv_timeout(LONG).expect("a handler runs before the delay is over");
    let ends = node.stop(LONG);
    assert!(ends.iter().all(|(_, end)| *end == TaskEnd::Returned), "{ends:?}");
}
