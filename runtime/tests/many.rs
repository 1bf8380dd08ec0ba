//! Tests of taking several messages under one lock (D111).

use crate::common::{A, B, C, LONG, LONG_TICKS, Tape, cell, finish, one_node, report, table};
use imrs_protocol::{
    Delivery, Incarnation, Input, NodeId, NodeTable, PortDecl, PortId, Request, Ticks, Usage,
};
use imrs_runtime::record::{Recorder, replay};
use imrs_runtime::{Context, MANY, TaskError};
use std::sync::{Arc, Barrier};
use std::time::Duration;

const SLOW: PortId = PortId(0);
const FAST: PortId = PortId(1);

/// A cell with ports from `a` to `b` and to `c`, each with room for `room` messages.
fn two_ports(room: u16) -> Arc<imrs_protocol::CellTable> {
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    cell.port(PortDecl::new("slow", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(room));
    cell.port(PortDecl::new("fast", A, Usage::Send, &[B], Ticks(30_000_000)).bounded_buffer(room));
    cell.port(PortDecl::new("long", A, Usage::Send, &[C], LONG_TICKS).bounded_buffer(room).fragments(2, 1));
    table(cell)
}

fn idle(_: &mut Context) -> Result<(), TaskError> {
    Ok(())
}

fn bytes(messages: &[Delivery]) -> Vec<u8> {
    messages.iter().map(|message| message.contents.as_bytes()[0]).collect()
}

#[test]
fn the_most_urgent_come_first_as_many_as_are_asked_for() {
    let table = two_ports(80);
    let tape = Arc::new(Tape::default());
    let sent = Arc::new(Barrier::new(2));
    let all_sent = Arc::clone(&sent);
    let recorder: Arc<dyn Recorder> = Arc::clone(&tape) as _;
    let node = one_node(&table)
        .recorder(recorder)
        .task("a", move |ctx| {
            for number in 0..70 {
                let _copies = ctx.send(SLOW, &[number])?;
            }
            for number in 70..73 {
                let _copies = ctx.send(FAST, &[number])?;
            }
            sent.wait();
            Ok(())
        })
        .task("b", move |ctx| {
            all_sent.wait();
            let mut messages = Vec::new();
            assert_eq!(ctx.receive_many(None, &mut messages, 5, None)?, 5);
            assert_eq!(bytes(&messages), [70, 71, 72, 0, 1]);
            assert_eq!(ctx.receive_many(Some(SLOW), &mut messages, usize::MAX, Some(LONG))?, MANY);
            assert_eq!(ctx.receive_many(Some(SLOW), &mut messages, 0, None)?, 1, "at least one");
            assert_eq!(ctx.receive_many(Some(SLOW), &mut messages, 9, None)?, 3, "those that are there");
            assert_eq!(bytes(&messages)[5..], (2..70).collect::<Vec<u8>>());
            assert!(messages.iter().all(|message| !message.budget.is_zero()));
            let none = ctx.receive_many(None, &mut messages, 9, Some(Duration::from_millis(5)))?;
            assert_eq!((none, messages.len()), (0, 73));
            Ok(())
        })
        .task("c", idle)
        .start()
        .unwrap();
    finish(node);

    // The recording has single GETs: the first has the time_out of the call, and the others are polls. The replay
    // repeats them.
    let log = std::mem::take(&mut *tape.closed.lock().unwrap()).remove(&B).expect("it was recorded");
    let asked = log.iter().filter_map(|recorded| match recorded.step.input {
        Input::Request(Request::Get { time_out, .. }) => Some(time_out),
        _ => None,
    });
    let asked: Vec<_> = asked.collect();
    assert_eq!(
        asked[..5],
        [None, Some(Ticks::ZERO), Some(Ticks::ZERO), Some(Ticks::ZERO), Some(Ticks::ZERO)]
    );
    assert_eq!(asked.len(), 5 + MANY + 1 + 4 + 1);
    let here = NodeTable::new(table, NodeId(0));
    assert_eq!(replay(&here, B, Incarnation(0), false, log.clone()), Ok(log.len()));
}

#[test]
fn a_message_of_several_packets_is_the_last_of_its_call() {
    let table = two_ports(8);
    let sent = Arc::new(Barrier::new(2));
    let all_sent = Arc::clone(&sent);
    let node = one_node(&table)
        .task("a", move |ctx| {
            let long = ctx.port("long")?;
            for number in 0..3 {
                let _copies = ctx.send(long, &[number; 20])?;
            }
            sent.wait();
            Ok(())
        })
        .task("b", idle)
        .task("c", move |ctx| {
            all_sent.wait();
            for number in 0..3 {
                let mut messages = Vec::new();
                assert_eq!(ctx.receive_many(None, &mut messages, 8, Some(LONG))?, 1);
                let whole: imrs_runtime::message::Bytes = ctx.read(&messages[0])?;
                assert_eq!(&whole[..], [number; 20]);
            }
            Ok(())
        })
        .start()
        .unwrap();
    finish(node);
}

/// Two threads send, and the receiver waits whenever it has taken all waiting messages. No message is lost or taken
/// twice, and the messages of each sender stay in order.
#[test]
fn a_stream_arrives_whole_and_in_order() {
    const EACH: u32 = 20_000;
    const ROOM: u32 = 64;
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    for (name, from) in [("from b", B), ("from c", C)] {
        cell.port(PortDecl::new(name, from, Usage::Send, &[A], LONG_TICKS).bounded_buffer(64));
    }
    let table = table(cell);
    let taken: Arc<[std::sync::atomic::AtomicU32; 2]> = Arc::default();
    let send = |place: usize| {
        let taken = Arc::clone(&taken);
        move |ctx: &mut Context| {
            for number in 0..EACH {
                while number - taken[place].load(std::sync::atomic::Ordering::Acquire) >= ROOM {
                    std::thread::yield_now();
                }
                let _copies = ctx.send(PortId::from_index(place), &number.to_le_bytes())?;
            }
            Ok(())
        }
    };
    let (tell, told) = report();
    let count = Arc::clone(&taken);
    let node = one_node(&table)
        .task("b", send(0))
        .task("c", send(1))
        .task("a", move |ctx| {
            let (mut next, mut messages, mut calls) = ([0_u32; 2], Vec::new(), 0_u32);
            while next.iter().sum::<u32>() < 2 * EACH {
                let time_out = (calls % 3 == 0).then_some(LONG);
                assert!(ctx.receive_many(None, &mut messages, MANY, time_out)? > 0);
                calls += 1;
                for message in messages.drain(..) {
                    let place = message.from.port.index();
                    let number =
                        u32::from_le_bytes(message.contents.as_bytes().try_into().expect("four bytes"));
                    assert_eq!(number, next[place]);
                    next[place] += 1;
                    count[place].store(next[place], std::sync::atomic::Ordering::Release);
                }
            }
            tell.send(calls).expect("the test listens");
            Ok(())
        })
        .start()
        .unwrap();
    let calls = told.recv_timeout(LONG).expect("all arrive");
    assert!(calls < 2 * EACH, "{calls} calls for {} messages", 2 * EACH);
    finish(node);
}
