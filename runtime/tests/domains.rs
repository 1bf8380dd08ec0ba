//! Tests of tasks of a node that share a domain: futures that exchange messages in fused steps (D187), and futures or
//! scripts that meet in fused steps (D193).

use crate::common::{LONG, LONG_TICKS, SmallSteps, Tape, ask, cell, one_node, table};
use imrs_protocol::script::{Binary, End, Program, ProgramBuilder, Type};
use imrs_protocol::{PortCounters, PortDecl, PortId, PortView, TaskId, Ticks, Usage};
use imrs_runtime::{AsyncContext, Builder, Rendezvous, TaskEnd, TaskError};
use std::future::{Future, poll_fn};
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::task::{Context, Wake, Waker};

const QUESTIONS: u64 = 100;

/// A waker of the test, which calls the executor's waker.
struct Between {
    waker: Waker,
    calls: Arc<AtomicU32>,
}

impl Wake for Between {
    fn wake(self: Arc<Self>) {
        self.calls.fetch_add(1, Ordering::Relaxed);
        self.waker.wake_by_ref();
    }
}

/// Polls `program` with a new waker of the test each time. Counts the calls of these wakers.
async fn between<T>(program: impl Future<Output = T>, calls: Arc<AtomicU32>) -> T {
    let mut program = pin!(program);
    poll_fn(move |poller| {
        let between = Between { waker: poller.waker().clone(), calls: Arc::clone(&calls) };
        program.as_mut().poll(&mut Context::from_waker(&Waker::from(Arc::new(between))))
    })
    .await
}

async fn question(mut ctx: AsyncContext) -> Result<(), TaskError> {
    let ask = ctx.port("ask")?;
    for number in 0..QUESTIONS {
        let sent = ctx.send(ask, &number.to_le_bytes()[..2]).await?;
        assert!(sent.reply().is_some(), "no answer but {sent:?}");
    }
    Ok(())
}

async fn answer(mut ctx: AsyncContext) -> Result<(), TaskError> {
    let ask = ctx.port("ask")?;
    for _ in 0..QUESTIONS {
        let message = ctx.receive(Some(ask), None).await?.expect("only a message ends the wait");
        ctx.reply(&message.from, message.contents.as_bytes())?;
    }
    Ok(())
}

/// The counters of the ports of two futures, one of which asks the other. `how` completes the node's builder. With
/// `calls`, each future is polled with a waker of the test instead of the executor's.
fn counted(how: impl FnOnce(Builder) -> Builder, calls: Option<Arc<AtomicU32>>) -> Vec<Vec<PortView>> {
    let mut cell = cell(&[0, 0], Ticks(2_000));
    cell.port(ask(LONG_TICKS));
    let node = one_node(&table(cell));
    let node = match calls {
        None => node.async_task("a", question).async_task("b", answer),
        Some(calls) => {
            let asks = Arc::clone(&calls);
            node.async_task("a", |ctx| between(question(ctx), asks))
                .async_task("b", |ctx| between(answer(ctx), calls))
        }
    };
    let node = how(node).start().unwrap();
    assert!(node.wait(LONG), "a program did not end");
    let ports = node.node().snapshot(0).tasks.into_iter().map(|task| task.view.ports).collect();
    let ends = node.stop(LONG);
    assert!(ends.iter().all(|(_, end)| *end == TaskEnd::Returned), "{ends:?}");
    ports
}

#[test]
fn futures_that_take_fused_steps_count_the_same_as_those_that_take_small_steps() {
    let fused = counted(|node| node, None);
    assert_eq!(fused[1][0].counters.delivered, QUESTIONS);
    assert_eq!(fused, counted(|node| node.recorder(Arc::new(SmallSteps)), None));
    assert_eq!(fused, counted(|node| node.recorder(Arc::new(Tape::default())), None));
}

#[test]
fn a_future_with_another_waker_than_the_executors_is_woken_by_that_one() {
    let calls = Arc::new(AtomicU32::new(0));
    let ports = counted(|node| node, Some(Arc::clone(&calls)));
    assert_eq!(ports[1][0].counters.delivered, QUESTIONS);
    let calls = u64::from(calls.load(Ordering::Relaxed));
    assert!(calls >= QUESTIONS, "{calls} calls for {QUESTIONS} questions and as many answers");
}

const MEETINGS: u64 = 50;

async fn meet(mut ctx: AsyncContext) -> Result<(), TaskError> {
    let lift = ctx.port("lift")?;
    for _ in 0..MEETINGS {
        let met = ctx.waitfor(lift).await?;
        assert!(matches!(met, Rendezvous::Released { .. }), "{met:?}");
    }
    Ok(())
}

/// A script that meets the other tasks once and ends.
fn meeter() -> Arc<Program> {
    let mut b = ProgramBuilder::new("meeter");
    let n = b.variable("n", Type::Int32);
    let (top, over) = (b.label(), b.label());
    b.put(top);
    b.waitfor(PortId(0));
    b.statement().load(n).push(1).int(Binary::Add).store(n);
    b.statement()
        .load(n)
        .push(i64::try_from(MEETINGS).expect("few"))
        .int(Binary::Less)
        .unless(over)
        .jump(top);
    b.put(over);
    b.end();
    Arc::new(b.finish().expect("a sound program"))
}

/// The counters of the ports of four tasks that meet repeatedly. `with` gives the node its tasks.
fn met(with: impl FnOnce(Builder) -> Builder) -> Vec<PortCounters> {
    let mut cell = cell(&[0, 0, 0, 0], Ticks(2_000));
    cell.port(PortDecl::new(
        "lift",
        TaskId(1),
        Usage::Waitfor,
        &[TaskId(3), TaskId(0), TaskId(2)],
        LONG_TICKS,
    ));
    let node = with(one_node(&table(cell))).start().unwrap();
    assert!(node.wait(LONG), "a program did not end");
    let ports = node.node().snapshot(0).tasks.into_iter().map(|task| task.view.ports[0].counters).collect();
    let ends = node.stop(LONG);
    let well = |end: &TaskEnd| matches!(end, TaskEnd::Returned | TaskEnd::Script(End::Finished));
    assert!(ends.iter().all(|(_, end)| well(end)), "{ends:?}");
    ports
}

fn all(node: Builder, add: impl Fn(Builder, &str) -> Builder) -> Builder {
    ["a", "b", "c", "d"].into_iter().fold(node, add)
}

#[test]
fn tasks_that_meet_in_fused_steps_meet_as_often_as_those_that_take_small_steps() {
    let futures = |node: Builder| all(node, |node, name| node.async_task(name, meet));
    let scripts = |node: Builder| all(node, |node, name| node.script(name, meeter()));
    // Scripts and futures never share a domain.
    let mixed = |node: Builder| {
        let three = ["a", "b", "c"].into_iter().fold(node, |node, name| node.async_task(name, meet));
        three.script("d", meeter())
    };
    let tape = |node: Builder| node.recorder(Arc::new(Tape::default()));
    let small = |node: Builder| node.recorder(Arc::new(SmallSteps));
    let counts = |ports: Vec<PortCounters>| -> Vec<_> {
        ports.into_iter().map(|port| (port.sent, port.delivered, port.timed_out)).collect()
    };
    let expected = vec![(MEETINGS, MEETINGS, 0); 4];
    assert_eq!(counts(met(futures)), expected);
    assert_eq!(counts(met(scripts)), expected);
    assert_eq!(counts(met(mixed)), expected);
    assert_eq!(counts(met(|node| small(futures(node)))), expected);
    assert_eq!(counts(met(|node| small(scripts(node)))), expected);
    assert_eq!(counts(met(|node| tape(futures(node)))), expected);
    assert_eq!(counts(met(|node| tape(scripts(node)))), expected);
    // Nothing is sent within a fused step, so no CONFIRM arrives after its receiver has gone on to the next round.
    assert!(met(scripts).iter().all(|port| port.dropped == 0));
}
