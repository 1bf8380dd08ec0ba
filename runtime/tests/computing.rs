//! Tests of a future that computes, so that polling it takes long. Meanwhile other threads do the due work of all
//! futures of its node (D186, D187).

use crate::common::{A, B, C, LONG, LONG_TICKS, cell, finish, one_node, report, table, until};
use imrs_protocol::{Outcome, PortDecl, PortId, Ticks, Usage};
use imrs_runtime::{AsyncContext, Sent};
use std::future::poll_fn;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::Poll;
use std::time::{Duration, Instant};

const CALL: PortId = PortId(0);
const NEWS: PortId = PortId(1);
/// How long the second future waits for an answer that does not come.
const PATIENCE: Duration = Duration::from_millis(100);
/// More messages than an inbox has room for.
const MANY: u8 = 200;

/// Yields to the other futures of the thread until the flag is set.
async fn hears(flag: Arc<AtomicBool>) {
    poll_fn(|poller| {
        if flag.load(Ordering::Acquire) {
            return Poll::Ready(());
        }
        poller.waker().wake_by_ref();
        Poll::Pending
    })
    .await;
}

/// One future asks a question. Then another future of the same thread computes until the test has seen the first
/// future's time_out and all messages of a third task.
#[test]
fn while_a_future_computes_another_one_expires_is_observed_and_gets_messages() {
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    let patience = Ticks(u64::try_from(PATIENCE.as_micros()).expect("short"));
    cell.port(PortDecl::new("call", B, Usage::Query, &[C], patience));
    cell.port(PortDecl::new("news", C, Usage::Send, &[A, B], LONG_TICKS).bounded_buffer(MANY.into()));
    let asked = Arc::new(AtomicBool::new(false));
    let asks = Arc::clone(&asked);
    let ((computes, computing), (begins, begun), (ends, end)) = (report(), report(), report());
    let (says_sent, sent) = report();
    let node = one_node(&table(cell))
        .async_task("a", |mut ctx: AsyncContext| async move {
            hears(asked).await;
            computes.send(()).expect("the test listens");
            end.recv_timeout(LONG).expect("the test ends it");
            for number in 0..MANY {
                let news = ctx.receive(Some(NEWS), Some(LONG)).await?.expect("it was sent");
                assert_eq!(news.contents.as_bytes(), [number]);
            }
            Ok(())
        })
        .async_task("b", |mut ctx: AsyncContext| async move {
            let begin = Instant::now();
            asks.store(true, Ordering::Release);
            assert_eq!(ctx.send(CALL, b"anyone?").await?, Sent::Outcome(Outcome::TimedOutUnknown));
            assert!(begin.elapsed() >= PATIENCE);
            Ok(())
        })
        .task("c", move |ctx| {
            begun.recv_timeout(LONG).expect("the test begins it");
            for number in 0..MANY {
                let _copies = ctx.send(NEWS, &[number])?;
            }
            says_sent.send(()).expect("the test listens");
            Ok(())
        })
        .start()
        .unwrap();
    computing.recv_timeout(LONG).expect("the future computes");
    let counters = |task: usize, port: PortId| {
        let view = node.node().snapshot(0).tasks[task].view.clone();
        view.ports.into_iter().find(|view| view.port == port).expect("its port").counters
    };
    begins.send(()).expect("it waits");
    sent.recv_timeout(LONG).expect("no message waits for the end of a poll");
    assert_eq!((counters(0, NEWS).enqueued, counters(1, NEWS).enqueued), (MANY.into(), MANY.into()));
    // The future is observed. Neither its own thread nor the observer makes its wait expire: the Timer thread does.
    until(|| counters(1, CALL).timed_out == 1);
    ends.send(()).expect("it computes");
    finish(node);
}
