//! Tests of tasks whose programs are futures (D113): every primitive, dropped waits, crashes, and the end of a node.

use crate::common::{
    A, AMPLE, AMPLE_TICKS, B, C, LONG, LONG_TICKS, Tape, ask, busy, cell, finish, network, on, one_node,
    report, table,
};
use futures_util::future::{Either, select};
use imrs_protocol::{
    Class, Fault, Incarnation, NodeId, NodeTable, Outcome, PortDecl, Ranked, Target, Ticks, TimeId, Usage,
};
use imrs_runtime::link::in_process::Faults;
use imrs_runtime::record::{Recorder, replay};
use imrs_runtime::{Asked, AsyncContext, Rendezvous, RequestFault, Sent, TaskEnd, TaskError};
use imrs_wire::obs::Liveness;
use std::future::{Future, poll_fn, ready};
use std::pin::pin;
use std::sync::{Arc, Mutex};
use std::task::{Poll, Waker};
use std::time::{Duration, Instant};

const SOON: Duration = Duration::from_millis(20);

/// The program of a task that answers `questions` questions, each with its number plus one.
async fn answer(mut ctx: AsyncContext, questions: u32) -> Result<(), TaskError> {
    let ask = ctx.port("ask")?;
    for _ in 0..questions {
        let question =
            ctx.take::<i32>(ask, None).await?.expect("without a time_out only a message ends the wait");
        ctx.answer(&question.from, &(question.message + 1))?;
    }
    Ok(())
}

async fn question(mut ctx: AsyncContext, questions: u32) -> Result<(), TaskError> {
    let ask = ctx.port("ask")?;
    for number in 0..i32::try_from(questions).unwrap() {
        assert_eq!(ctx.query::<i32, i32>(ask, &number).await?, Asked::Reply(number + 1));
    }
    Ok(())
}

/// Yields once to the other futures of the thread.
async fn give_way() {
    let mut given = false;
    poll_fn(|poller| {
        if std::mem::replace(&mut given, true) {
            return Poll::Ready(());
        }
        poller.waker().wake_by_ref();
        Poll::Pending
    })
    .await;
}

/// A flag by which another thread gives a signal to a future.
#[derive(Default)]
pub struct Told(Mutex<(bool, Option<Waker>)>);

impl Told {
    pub fn tell(&self) {
        let mut told = self.0.lock().unwrap();
        told.0 = true;
        if let Some(waker) = told.1.take() {
            waker.wake();
        }
    }

    pub fn hear(&self) -> impl Future<Output = ()> {
        poll_fn(|poller| {
            let mut told = self.0.lock().unwrap();
            if told.0 {
                return Poll::Ready(());
            }
            told.1 = Some(poller.waker().clone());
            Poll::Pending
        })
    }
}

#[test]
fn send_receive_reply_between_two_futures_of_a_node() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    let node = one_node(&table(cell));
    let node = node.async_task("a", |ctx| question(ctx, 2_000)).async_task("b", |ctx| answer(ctx, 2_000));
    finish(node.start().unwrap());
}

#[test]
fn a_future_and_a_thread_ask_each_other_between_nodes() {
    let mut cell = cell(&[0, 1], Ticks(100));
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    let network = network(&table, Faults::default());
    let first = on(&network, &table, 0).async_task("a", |ctx| question(ctx, 300));
    let second = on(&network, &table, 1).task("b", |ctx| {
        let ask = ctx.port("ask")?;
        for _ in 0..300 {
            let question = ctx.take::<i32>(ask, None)?.expect("a question");
            ctx.answer(&question.from, &(question.message + 1))?;
        }
        Ok(())
    });
    let (first, second) = (first.start().unwrap(), second.start().unwrap());
    finish(first);
    finish(second);
}

#[test]
fn statuses_time_outs_and_faults() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(PortDecl::new("news", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(4));
    cell.port(ask(Ticks(30_000)));
    let node = one_node(&table(cell))
        .async_task("a", |mut ctx: AsyncContext| async move {
            let (news, ask) = (ctx.port("news")?, ctx.port("ask")?);
            assert_eq!((ctx.name(), ctx.id(), ctx.task("b")?), ("a", A, B));
            assert_eq!(ctx.port("olds"), Err(TaskError::NoPort("olds".into())));
            assert_eq!(ctx.tell(news, &7_i32)?, 1);
            assert_eq!(ctx.send_to(news, B, &8_i32.to_le_bytes()).await?, Sent::Copies(1));
            let fault = |fault| TaskError::Fault(RequestFault(fault));
            assert_eq!(ctx.tell(ask, &1_i32), Err(fault(Fault::WrongUsage)));
            assert_eq!(ctx.receive(Some(ask), None).await, Err(fault(Fault::WrongUsage)));
            assert_eq!(ctx.send(ask, &[0; 13]).await, Err(TaskError::TooLong(13)));
            // No task takes this command.
            let begins = Instant::now();
            assert_eq!(ctx.send(ask, b"anyone?").await?, Sent::Outcome(Outcome::TimedOutUnknown));
            assert!(begins.elapsed() >= Duration::from_millis(30));
            Ok(())
        })
        .async_task("b", |mut ctx: AsyncContext| async move {
            let news = ctx.port("news")?;
            let first = ctx.take::<i32>(news, None).await?.expect("the first");
            assert_eq!((first.message, first.from.source), (7, A));
            let second = ctx.receive_from(Some(news), A, None).await?.expect("the second");
            assert_eq!((second.class, ctx.read::<i32>(&second)?), (Class::Status, 8));
            let begins = Instant::now();
            assert_eq!(ctx.receive(Some(news), Some(SOON)).await?, None);
            assert!(begins.elapsed() >= SOON);
            let begins = Instant::now();
            ctx.delay(SOON).await?;
            assert!(begins.elapsed() >= SOON);
            Ok(())
        });
    finish(node.start().unwrap());
}

#[test]
fn futures_and_a_thread_meet_and_one_gives_up() {
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    cell.port(PortDecl::new("lift", A, Usage::Waitfor, &[B, C], LONG_TICKS));
    let (tell, told) = report();
    let meet = move |mut ctx: AsyncContext| {
        let tell = tell.clone();
        async move {
            let lift = ctx.port("lift")?;
            for _ in 0..50 {
                tell.send(ctx.waitfor(lift).await?).unwrap();
            }
            if ctx.id() == B {
                let end = ctx.waitfor_with(lift, [1; 8], Some(SOON)).await?;
                assert!(matches!(end, Rendezvous::GaveUp { missing: 0b101, .. }), "{end:?}");
            }
            Ok(())
        }
    };
    let node = one_node(&table(cell)).async_task("a", meet.clone()).async_task("b", meet).task("c", |ctx| {
        let lift = ctx.port("lift")?;
        (0..50).try_for_each(|_| {
            ctx.waitfor(lift).map(|end| assert!(matches!(end, Rendezvous::Released { .. })))
        })
    });
    finish(node.start().unwrap());
    let met: Vec<_> = told.try_iter().collect();
    assert_eq!(met.len(), 100);
    assert!(met.iter().all(|end| matches!(end, Rendezvous::Released { .. })));
}

#[test]
fn handlers_get_the_state_while_the_program_waits() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(PortDecl::new("pose", B, Usage::Query, &[A], LONG_TICKS).command());
    cell.port(PortDecl::new("halt", B, Usage::Send, &[A], LONG_TICKS));
    let a = AsyncContext::with_state((40_i16, false, 0), |mut ctx| async move {
        let (pose, halt) = (ctx.port("pose")?, ctx.port("halt")?);
        ctx.on_query(pose, |state, add: i16| {
            state.0 += add;
            Ok(state.0)
        })?;
        ctx.on_message(halt, |state, (): ()| {
            state.1 = true;
            Ok(())
        })?;
        ctx.on_timer(TimeId(1), |state| {
            state.2 += 1;
            Ok(())
        });
        assert_eq!(ctx.start_timer(TimeId(2), SOON), Err(TaskError::NoHandler(TimeId(2))));
        ctx.start_timer(TimeId(1), SOON)?;
        ctx.order(&[Ranked::Port(pose), Ranked::Port(halt), Ranked::Timer(TimeId(1)), Ranked::Own])?;
        while !ctx.state.1 || ctx.state.2 == 0 {
            ctx.delay(Duration::from_millis(5)).await?;
        }
        assert_eq!(ctx.state.0, 42);
        Ok(())
    });
    let node =
        one_node(&table(cell)).async_task("a", a).async_task("b", |mut ctx: AsyncContext| async move {
            let (pose, halt) = (ctx.port("pose")?, ctx.port("halt")?);
            assert_eq!(ctx.query::<i16, i16>(pose, &1).await?, Asked::Reply(41));
            assert_eq!(ctx.query::<i16, i16>(pose, &1).await?, Asked::Reply(42));
            ctx.tell(halt, &())?;
            Ok(())
        });
    finish(node.start().unwrap());
}

#[test]
fn a_future_hears_another_thread_while_it_waits_for_a_message() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(PortDecl::new("news", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(4));
    let (told, free) = (Arc::new(Told::default()), Arc::new(Told::default()));
    let (hears, is_free) = (Arc::clone(&told), Arc::clone(&free));
    let (tell, begun) = report();
    let node = one_node(&table(cell))
        .async_task("a", move |mut ctx: AsyncContext| async move {
            let news = ctx.port("news")?;
            is_free.hear().await;
            ctx.tell(news, &1_i32)?;
            Ok(())
        })
        .async_task("b", move |mut ctx: AsyncContext| async move {
            let news = ctx.port("news")?;
            {
                let (message, other) = (pin!(ctx.receive(Some(news), None)), pin!(hears.hear()));
                tell.send(()).unwrap();
                assert!(matches!(select(message, other).await, Either::Right(_)));
            }
            free.tell();
            // The dropped wait left no request behind, so the task may make a request again.
            assert_eq!(ctx.take::<i32>(news, None).await?.expect("the news").message, 1);
            Ok(())
        })
        .start()
        .unwrap();
    begun.recv_timeout(LONG).unwrap();
    std::thread::spawn(move || told.tell()).join().unwrap();
    finish(node);
}

#[test]
fn a_message_that_comes_for_a_dropped_wait_is_kept_for_the_next_that_it_suits() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(PortDecl::new("news", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(4));
    cell.port(PortDecl::new("short", A, Usage::Send, &[B], Ticks(30_000)).bounded_buffer(4));
    cell.port(ask(LONG_TICKS));
    let node = one_node(&table(cell))
        .async_task("a", |mut ctx: AsyncContext| async move {
            let (news, short, ask) = (ctx.port("news")?, ctx.port("short")?, ctx.port("ask")?);
            // `b` already waits for each message when it is sent.
            for number in [1, 2] {
                assert_eq!(ctx.query::<i32, i32>(ask, &number).await?, Asked::Reply(number));
                give_way().await;
                let port = if number == 1 { news } else { short };
                ctx.tell(port, &number)?;
            }
            assert_eq!(ctx.query::<i32, i32>(ask, &3).await?, Asked::Reply(3));
            ctx.tell(news, &3)?;
            Ok(())
        })
        .async_task("b", |mut ctx: AsyncContext| async move {
            let (news, short, ask) = (ctx.port("news")?, ctx.port("short")?, ctx.port("ask")?);
            for port in [news, short] {
                let question = ctx.take::<i32>(ask, None).await?.expect("a question");
                ctx.answer(&question.from, &question.message)?;
                let mut wait = Box::pin(ctx.receive(Some(port), None));
                assert!(poll_fn(|poller| Poll::Ready(wait.as_mut().poll(poller))).await.is_pending());
                // The message comes while no thread polls the wait.
                for _ in 0..10 {
                    give_way().await;
                }
                drop(wait);
            }
            // The message of the port with the short time_out has expired.
            ctx.delay(Duration::from_millis(40)).await?;
            assert_eq!(ctx.receive(Some(short), Some(Duration::ZERO)).await?, None);
            let question = ctx.take::<i32>(ask, None).await?.expect("the last question");
            ctx.answer(&question.from, &question.message)?;
            assert_eq!(ctx.take::<i32>(news, None).await?.expect("kept").message, 1);
            assert_eq!(ctx.take::<i32>(news, None).await?.expect("sent since").message, 3);
            Ok(())
        });
    finish(node.start().unwrap());
}

#[test]
fn who_drops_a_waitfor_has_left_it_and_a_dropped_delay_is_over() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(PortDecl::new("lift", A, Usage::Waitfor, &[B], Ticks(50_000)));
    let (tell, left) = report();
    let node = one_node(&table(cell))
        .async_task("a", |mut ctx: AsyncContext| async move {
            let lift = ctx.port("lift")?;
            assert!(matches!(select(pin!(ctx.waitfor(lift)), ready(())).await, Either::Right(_)));
            assert!(matches!(select(pin!(ctx.delay(LONG)), ready(())).await, Either::Right(_)));
            tell.send(()).expect("b listens");
            ctx.delay(Duration::from_millis(1)).await
        })
        .task("b", move |ctx| {
            let lift = ctx.port("lift")?;
            left.recv().expect("a has left");
            assert!(matches!(ctx.waitfor(lift)?, Rendezvous::GaveUp { missing: 0b01, .. }));
            Ok(())
        });
    finish(node.start().unwrap());
}

#[test]
fn a_panic_is_the_crash_of_one_future() {
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    cell.port(ask(AMPLE_TICKS));
    cell.port(PortDecl::new("more", A, Usage::Send, &[C], LONG_TICKS).command());
    let node = one_node(&table(cell))
        .async_task("a", |mut ctx: AsyncContext| async move {
            let (ask, more) = (ctx.port("ask")?, ctx.port("more")?);
            assert_eq!(ctx.query::<i32, i32>(ask, &1).await?, Asked::TimedOutUnknown);
            assert_eq!(ctx.query::<i32, i32>(more, &1).await?, Asked::Reply(2));
            Err(TaskError::Gone)
        })
        .async_task("b", |mut ctx: AsyncContext| async move {
            ctx.receive(None, None).await?;
            panic!("this crash is part of the test")
        })
        .async_task("c", |mut ctx: AsyncContext| async move {
            let question = ctx.receive(None, None).await?.expect("a question");
            ctx.answer(&question.from, &2_i32)
        })
        .start()
        .unwrap();
    assert!(node.wait(LONG));
    let liveness: Vec<_> = node.node().snapshot(0).tasks.iter().map(|task| task.liveness).collect();
    assert_eq!(liveness, [Liveness::Ended, Liveness::Crashed, Liveness::Ended]);
    let ends: Vec<_> = node.stop(LONG).into_iter().map(|(_, end)| end).collect();
    let crash = TaskEnd::Panicked("this crash is part of the test".into());
    assert_eq!(ends, [TaskEnd::Failed(TaskError::Gone), crash, TaskEnd::Returned]);
}

#[test]
fn stopping_ends_every_wait_and_drops_who_waits_for_something_else() {
    struct Dropped(std::sync::mpsc::Sender<()>);
    impl Drop for Dropped {
        fn drop(&mut self) {
            let _ = self.0.send(());
        }
    }
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    cell.port(PortDecl::new("news", A, Usage::Send, &[B], LONG_TICKS));
    let ((began, begun), (tell, told)) = (report(), report());
    let node = one_node(&table(cell))
        .async_task("a", {
            let began = began.clone();
            move |mut ctx: AsyncContext| async move {
                began.send(()).unwrap();
                ctx.delay(LONG).await.map(|()| panic!("it ended"))
            }
        })
        .async_task("b", {
            let began = began.clone();
            move |mut ctx: AsyncContext| async move {
                began.send(()).unwrap();
                assert_eq!(ctx.receive(None, None).await, Err(TaskError::Stopped));
                // Every later wait also ends with `Stopped`.
                assert_eq!(ctx.delay(SOON).await, Err(TaskError::Stopped));
                Ok(())
            }
        })
        .async_task("c", move |ctx: AsyncContext| async move {
            let _dropped = Dropped(tell);
            began.send(()).unwrap();
            std::future::pending::<()>().await;
            drop(ctx);
            Ok(())
        })
        .start()
        .unwrap();
    (0..3).for_each(|_| begun.recv_timeout(LONG).unwrap());
    let ends: Vec<_> = node.stop(AMPLE).into_iter().map(|(_, end)| end).collect();
    assert_eq!(ends, [TaskEnd::Returned, TaskEnd::Returned, TaskEnd::Unfinished]);
    told.recv_timeout(LONG).expect("what never ends is dropped");
}

/// The program of a task of [`busy`]: between `rounds` meetings `a` sends a status and asks, and the others answer.
async fn meets_and_asks(mut ctx: AsyncContext, rounds: u8) -> Result<(), TaskError> {
    let (lift, news) = (ctx.port("lift")?, ctx.port("news")?);
    for round in 0..rounds {
        let _either = ctx.waitfor_with(lift, [round; 8], None).await?;
        if ctx.id() == A {
            let _copies = ctx.send(news, &[round]).await?;
            let ask = ctx.port("ask")?;
            let _outcome = ctx.send(ask, &[round]).await?;
        } else {
            while let Some(message) = ctx.receive(None, Some(Duration::from_millis(5))).await? {
                if message.class == Class::Command {
                    // A late reply is refused, and a recording must contain that, too.
                    let _late = ctx.reply(&message.from, b"yes");
                }
            }
        }
        drop(select(pin!(ctx.delay(SOON)), ready(())).await);
        ctx.delay(Duration::from_millis(1)).await?;
    }
    Ok(())
}

#[test]
fn a_recorded_run_of_futures_replays_bit_equal() {
    let (table, network) = busy();
    let tape = Arc::new(Tape::default());
    let builder = |(node, task)| {
        let recorder: Arc<dyn Recorder> = Arc::clone(&tape) as _;
        on(&network, &table, node).recorder(recorder).async_task(task, |ctx| meets_and_asks(ctx, 20))
    };
    let builders: Vec<_> = (0..3).zip(["a", "b", "c"]).map(builder).collect();
    let nodes: Vec<_> = builders.into_iter().map(|node| node.start().unwrap()).collect();
    assert!(nodes.iter().all(|node| node.wait(LONG)));
    nodes.into_iter().for_each(finish);
    let logs = std::mem::take(&mut *tape.closed.lock().unwrap());
    assert_eq!(logs.len(), 3);
    for (task, log) in logs {
        let node = NodeTable::new(Arc::clone(&table), NodeId(task.0));
        assert!(log.len() > 100, "{task} took only {} inputs", log.len());
        assert_eq!(replay(&node, task, Incarnation(1), false, log.clone()), Ok(log.len()));
    }
}

#[test]
fn several_are_asked_at_once() {
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    cell.port(PortDecl::new("state", A, Usage::Query, &[B, C], AMPLE_TICKS).command());
    let node = one_node(&table(cell))
        .async_task("a", |mut ctx: AsyncContext| async move {
            let state = ctx.port("state")?;
            let mut said = Vec::new();
            ctx.query_all::<(), i16>(state, Target::All, &(), |task, asked| said.push((task, asked))).await?;
            said.sort_by_key(|(task, _)| *task);
            assert_eq!(said, [(B, Asked::Reply(7)), (C, Asked::TimedOutUnknown)]);
            said.clear();
            ctx.query_all::<(), i16>(state, Target::One(B), &(), |task, asked| said.push((task, asked)))
                .await?;
            assert_eq!(said, [(B, Asked::Reply(8))]);
            Ok(())
        })
        .async_task("b", |mut ctx: AsyncContext| async move {
            let state = ctx.port("state")?;
            for answer in [7_i16, 8] {
                let asked = ctx.take::<()>(state, None).await?.expect("a question");
                ctx.answer(&asked.from, &answer)?;
            }
            Ok(())
        })
        // This task never answers.
        .task("c", |_| Ok(()));
    finish(node.start().unwrap());
}

#[test]
fn what_is_there_is_taken_without_a_wait_and_what_belongs_together_leaves_together() {
    let mut cell = cell(&[0, 1], Ticks(100));
    cell.port(PortDecl::new("news", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(8));
    let table = table(cell);
    let network = network(&table, Faults::default());
    let first = on(&network, &table, 0).async_task("a", |mut ctx: AsyncContext| async move {
        let news = ctx.port("news")?;
        let told =
            ctx.together(|ctx| (0..4_i32).map(|n| ctx.tell(news, &n)).collect::<Result<Vec<_>, _>>())?;
        assert_eq!(told, [1; 4]);
        Ok(())
    });
    let second = on(&network, &table, 1).async_task("b", |mut ctx: AsyncContext| async move {
        let news = ctx.port("news")?;
        let mut heard = Vec::new();
        while heard.len() < 4 {
            match ctx.poll(Some(news)).await? {
                Some(message) => heard.push(ctx.read::<i32>(&message)?),
                None => ctx.delay(Duration::from_millis(1)).await?,
            }
        }
        // The messages are equally urgent, except for the microseconds at which the task took each, so their order is not fixed.
        heard.sort_unstable();
        assert_eq!(heard, [0, 1, 2, 3]);
        assert_eq!(ctx.poll(Some(news)).await?, None);
        Ok(())
    });
    let (first, second) = (first.start().unwrap(), second.start().unwrap());
    finish(second);
    finish(first);
}

#[test]
fn nothing_interrupts_an_atomic_section_and_one_that_is_dropped_is_over() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(PortDecl::new("halt", B, Usage::Send, &[A], LONG_TICKS).bounded_buffer(4));
    cell.port(PortDecl::new("go", A, Usage::Send, &[B], LONG_TICKS));
    let a = AsyncContext::with_state(0, |mut ctx| async move {
        let (halt, go) = (ctx.port("halt")?, ctx.port("go")?);
        ctx.on_message(halt, |halts, (): ()| {
            *halts += 1;
            Ok(())
        })?;
        ctx.order(&[Ranked::Port(halt), Ranked::Own])?;
        ctx.atomic(async |ctx| {
            ctx.tell(go, &())?;
            ctx.delay(5 * SOON).await?;
            assert_eq!(ctx.state, 0, "interrupted");
            // Atomic sections may be nested.
            ctx.atomic(async |ctx| ctx.boundary().await).await?;
            assert_eq!(ctx.state, 0, "interrupted");
            Ok(())
        })
        .await?;
        while ctx.state == 0 {
            ctx.boundary().await?;
            ctx.delay(Duration::from_millis(1)).await?;
        }
        // This section is dropped, because another future is ready first.
        {
            let section = pin!(ctx.atomic(async |ctx| ctx.delay(LONG).await));
            assert!(matches!(select(section, ready(())).await, Either::Right(_)));
        }
        ctx.tell(go, &())?;
        while ctx.state == 1 {
            ctx.delay(Duration::from_millis(1)).await?;
        }
        assert_eq!(ctx.state, 2);
        Ok(())
    });
    let node =
        one_node(&table(cell)).async_task("a", a).async_task("b", |mut ctx: AsyncContext| async move {
            let (halt, go) = (ctx.port("halt")?, ctx.port("go")?);
            for _ in 0..2 {
                ctx.receive(Some(go), None).await?;
                ctx.tell(halt, &())?;
            }
            Ok(())
        });
    finish(node.start().unwrap());
}

/// A message of twenty bytes, which takes two packets.
type Long = (u32, u32, u32, u32, u32);
const ONES: Long = (1, 1, 1, 1, 1);
const TWOS: Long = (2, 2, 2, 2, 2);

#[test]
fn a_long_message_that_was_kept_is_read_whole_until_another_is_taken() {
    for another in [false, true] {
        let mut cell = cell(&[0, 0], Ticks(0));
        cell.port(PortDecl::new("long", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(4).fragments(2, 1));
        cell.port(PortDecl::new("other", A, Usage::Send, &[B], LONG_TICKS).bounded_buffer(4).fragments(2, 1));
        cell.port(ask(LONG_TICKS));
        let node = one_node(&table(cell))
            .async_task("a", |mut ctx: AsyncContext| async move {
                let (long, other, ask) = (ctx.port("long")?, ctx.port("other")?, ctx.port("ask")?);
                assert_eq!(ctx.query::<i32, i32>(ask, &1).await?, Asked::Reply(1));
                give_way().await;
                ctx.tell(long, &ONES)?;
                ctx.tell(other, &TWOS)?;
                Ok(())
            })
            .async_task("b", move |mut ctx: AsyncContext| async move {
                let (long, other, ask) = (ctx.port("long")?, ctx.port("other")?, ctx.port("ask")?);
                let question = ctx.take::<i32>(ask, None).await?.expect("a question");
                ctx.answer(&question.from, &question.message)?;
                {
                    let mut wait = Box::pin(ctx.receive(Some(long), None));
                    assert!(poll_fn(|poller| Poll::Ready(wait.as_mut().poll(poller))).await.is_pending());
                    for _ in 0..10 {
                        give_way().await;
                    }
                }
                if another {
                    assert_eq!(ctx.take::<Long>(other, None).await?.expect("the other").message, TWOS);
                }
                let kept = ctx.receive(Some(long), None).await?.expect("kept");
                let read = ctx.read::<Long>(&kept);
                assert_eq!(read, if another { Err(TaskError::Gone) } else { Ok(ONES) });
                Ok(())
            });
        finish(node.start().unwrap());
    }
}
