//! Tests of servers that answer and wait for the next message in one call (D200).

use crate::common::{A, B, C, LONG, LONG_TICKS, SmallSteps, Tape, ask, cell, finish, one_node, table};
use imrs_protocol::{Fault, Outcome, PortCounters, PortDecl, Target, Ticks, Usage};
use imrs_runtime::{Asked, AsyncContext, Builder, Context, RequestFault, Sent, TaskEnd, TaskError};
use std::future::{Future, poll_fn};
use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

const QUESTIONS: u8 = 100;

async fn question(mut ctx: AsyncContext) -> Result<(), TaskError> {
    let ask = ctx.port("ask")?;
    for number in 0..QUESTIONS {
        let sent = ctx.send(ask, &[number]).await?;
        assert_eq!(sent.reply().expect("an answer").as_bytes(), [number, 1]);
    }
    Ok(())
}

/// Answers in two calls.
async fn in_two(mut ctx: AsyncContext) -> Result<(), TaskError> {
    let ask = ctx.port("ask")?;
    let mut next = ctx.receive(Some(ask), None).await?;
    for number in 0..QUESTIONS {
        let message = next.expect("only a message ends the wait");
        assert_eq!(message.contents.as_bytes(), [number]);
        ctx.reply(&message.from, &[number, 1])?;
        let time_out = (number + 1 == QUESTIONS).then_some(Duration::ZERO);
        next = ctx.receive(Some(ask), time_out).await?;
    }
    assert_eq!(next, None);
    Ok(())
}

/// Does in one call what [`in_two`] does in two.
async fn in_one(mut ctx: AsyncContext) -> Result<(), TaskError> {
    let ask = ctx.port("ask")?;
    let mut next = ctx.receive(Some(ask), None).await?;
    for number in 0..QUESTIONS {
        let message = next.expect("only a message ends the wait");
        assert_eq!(message.contents.as_bytes(), [number]);
        let time_out = (number + 1 == QUESTIONS).then_some(Duration::ZERO);
        next = ctx.reply_and_receive(&message.from, &[number, 1], Some(ask), time_out).await?;
    }
    assert_eq!(next, None);
    Ok(())
}

/// As [`in_one`], on a thread.
fn on_a_thread(ctx: &mut Context) -> Result<(), TaskError> {
    let ask = ctx.port("ask")?;
    let mut next = ctx.receive(Some(ask), None)?;
    for number in 0..QUESTIONS {
        let message = next.expect("only a message ends the wait");
        assert_eq!(message.contents.as_bytes(), [number]);
        let time_out = (number + 1 == QUESTIONS).then_some(Duration::ZERO);
        next = ctx.reply_and_receive(&message.from, &[number, 1], Some(ask), time_out)?;
    }
    assert_eq!(next, None);
    Ok(())
}

/// The counters of the ports of the two tasks.
fn counted(with: impl FnOnce(Builder) -> Builder) -> Vec<PortCounters> {
    let mut cell = cell(&[0, 0], Ticks(2_000));
    cell.port(ask(LONG_TICKS));
    let node = with(one_node(&table(cell)).async_task("a", question)).start().unwrap();
    assert!(node.wait(LONG), "a program did not end");
    let ports = node.node().snapshot(0).tasks.into_iter().map(|task| task.view.ports[0].counters).collect();
    let ends = node.stop(LONG);
    assert!(ends.iter().all(|(_, end)| *end == TaskEnd::Returned), "{ends:?}");
    ports
}

#[test]
fn one_call_does_what_two_do() {
    let expected = counted(|node| node.async_task("b", in_two));
    assert!(expected.iter().all(|port| port.delivered == u64::from(QUESTIONS)), "{expected:?}");
    assert_eq!(counted(|node| node.async_task("b", in_one)), expected);
    let small = |node: Builder| node.recorder(Arc::new(SmallSteps));
    assert_eq!(counted(|node| small(node).async_task("b", in_one)), expected);
    let tape = |node: Builder| node.recorder(Arc::new(Tape::default()));
    assert_eq!(counted(|node| tape(node).async_task("b", in_one)), expected);
    assert_eq!(counted(|node| node.task("b", on_a_thread)), expected);
}

/// A task whose second question times out. It reports that on the port `gone`, and asks again. Its first question was
/// answered, but the deadline of that question is still published to the Timer thread.
async fn impatient(mut ctx: AsyncContext) -> Result<(), TaskError> {
    let (ask, gone) = (ctx.port("ask")?, ctx.port("gone")?);
    assert_eq!(ctx.send(ask, b"0").await?.reply().expect("an answer").as_bytes(), b"zero");
    let short = Some(Duration::from_millis(20));
    let sent = ctx.send_with(ask, Target::All, b"1", short).await?;
    assert_eq!(sent, Sent::Outcome(Outcome::TimedOutUnknown));
    ctx.tell(gone, &())?;
    assert_eq!(ctx.send(ask, b"2").await?.reply().expect("an answer").as_bytes(), b"two");
    Ok(())
}

fn with_an_impatient_asker() -> Builder {
    let mut cell = cell(&[0, 0], Ticks(2_000));
    cell.port(ask(LONG_TICKS));
    cell.port(PortDecl::new("gone", A, Usage::Send, &[B], LONG_TICKS));
    one_node(&table(cell)).async_task("a", impatient)
}

#[test]
fn after_an_answer_that_is_late_nothing_is_received() {
    let node = with_an_impatient_asker().async_task("b", |mut ctx: AsyncContext| async move {
        let (ask, gone) = (ctx.port("ask")?, ctx.port("gone")?);
        let zero = ctx.receive(Some(ask), None).await?.expect("a question");
        let first = ctx.reply_and_receive(&zero.from, b"zero", Some(ask), None).await?.expect("another");
        ctx.receive(Some(gone), None).await?;
        let late = ctx.reply_and_receive(&first.from, b"one", Some(ask), None).await;
        assert_eq!(late, Err(RequestFault(Fault::Late).into()));
        let second = ctx.receive(Some(ask), None).await?.expect("the other question");
        ctx.reply(&second.from, b"two")
    });
    finish(node.start().unwrap());
    let node = with_an_impatient_asker().task("b", |ctx: &mut Context| {
        let (ask, gone) = (ctx.port("ask")?, ctx.port("gone")?);
        let zero = ctx.receive(Some(ask), None)?.expect("a question");
        let first = ctx.reply_and_receive(&zero.from, b"zero", Some(ask), None)?.expect("another");
        ctx.receive(Some(gone), None)?;
        let late = ctx.reply_and_receive(&first.from, b"one", Some(ask), None);
        assert_eq!(late, Err(RequestFault(Fault::Late).into()));
        let second = ctx.receive(Some(ask), None)?.expect("the other question");
        ctx.reply(&second.from, b"two")
    });
    finish(node.start().unwrap());
}

/// Lets the other futures of the node run.
async fn give_way() {
    let mut given = false;
    poll_fn(|poller| {
        if given {
            return Poll::Ready(());
        }
        given = true;
        poller.waker().wake_by_ref();
        Poll::Pending
    })
    .await;
}

#[test]
fn what_came_for_a_dropped_wait_is_received_after_the_answer() {
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    cell.port(PortDecl::new("go", B, Usage::Send, &[C], LONG_TICKS));
    cell.port(PortDecl::new("news", C, Usage::Send, &[B], LONG_TICKS).bounded_buffer(4));
    let node = one_node(&table(cell))
        .async_task("a", |mut ctx: AsyncContext| async move {
            let ask = ctx.port("ask")?;
            assert_eq!(ctx.query::<i32, i32>(ask, &1).await?, Asked::Reply(2));
            Ok(())
        })
        .async_task("b", |mut ctx: AsyncContext| async move {
            let (ask, go, news) = (ctx.port("ask")?, ctx.port("go")?, ctx.port("news")?);
            let question = ctx.take::<i32>(ask, None).await?.expect("a question");
            ctx.tell(go, &())?;
            let mut wait = Box::pin(ctx.receive(Some(news), None));
            assert!(poll_fn(|poller| Poll::Ready(wait.as_mut().poll(poller))).await.is_pending());
            // The status comes while no thread polls the future that waits for it.
            for _ in 0..10 {
                give_way().await;
            }
            drop(wait);
            let answer = 2_i32.to_le_bytes();
            let kept = ctx.reply_and_receive(&question.from, &answer, Some(news), None).await?;
            assert_eq!(ctx.read::<i32>(&kept.expect("kept"))?, 7);
            Ok(())
        })
        .async_task("c", |mut ctx: AsyncContext| async move {
            let (go, news) = (ctx.port("go")?, ctx.port("news")?);
            ctx.receive(Some(go), None).await?;
            ctx.tell(news, &7)?;
            Ok(())
        });
    finish(node.start().unwrap());
}

#[test]
fn handlers_run_while_a_server_waits_for_the_next_message() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    cell.port(PortDecl::new("pose", A, Usage::Query, &[B], LONG_TICKS).command());
    let table = table(cell);
    let with_an_asker = || {
        one_node(&table).async_task("a", |mut ctx: AsyncContext| async move {
            let (ask, pose) = (ctx.port("ask")?, ctx.port("pose")?);
            for number in 0..20 {
                assert_eq!(ctx.query::<i32, i32>(ask, &number).await?, Asked::Reply(number));
                assert_eq!(ctx.query::<i32, i32>(pose, &number).await?, Asked::Reply(number + 1));
            }
            Ok(())
        })
    };
    let b = AsyncContext::with_state(0, |mut ctx| async move {
        let (ask, pose) = (ctx.port("ask")?, ctx.port("pose")?);
        ctx.on_query(pose, |count, number: i32| {
            *count += 1;
            Ok(number + 1)
        })?;
        let mut next = ctx.receive(Some(ask), None).await?;
        while let Some(message) = next {
            let wait = if ctx.state == 19 { Duration::ZERO } else { LONG };
            let contents = message.contents;
            next = ctx.reply_and_receive(&message.from, contents.as_bytes(), Some(ask), Some(wait)).await?;
        }
        while ctx.state < 20 {
            ctx.delay(Duration::from_millis(1)).await?;
        }
        Ok(())
    });
    finish(with_an_asker().async_task("b", b).start().unwrap());
    let b = Context::with_state(0, |ctx| {
        let (ask, pose) = (ctx.port("ask")?, ctx.port("pose")?);
        ctx.on_query(pose, |ctx, number: i32| {
            ctx.state += 1;
            Ok(number + 1)
        })?;
        let mut next = ctx.receive(Some(ask), None)?;
        while let Some(message) = next {
            let wait = if ctx.state == 19 { Duration::ZERO } else { LONG };
            next =
                ctx.reply_and_receive(&message.from, message.contents.as_bytes(), Some(ask), Some(wait))?;
        }
        while ctx.state < 20 {
            ctx.delay(Duration::from_millis(1))?;
        }
        Ok(())
    });
    finish(with_an_asker().task("b", b).start().unwrap());
}
