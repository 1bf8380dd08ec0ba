//! Tests of the handlers of Rust tasks, of their timers, of typed and long messages, and of the state of a task after a
//! panic.

use crate::common::{
    A, AMPLE, AMPLE_TICKS, B, C, LONG, LONG_TICKS, ask, cell, finish, network, on, one_node, report, table,
};
use imrs_protocol::{Cell, CoupleDecl, Fault, PortDecl, Ranked, Target, Ticks, TimeId, Usage};
use imrs_runtime::link::in_process::Faults;
use imrs_runtime::message::Bytes;
use imrs_runtime::{Asked, Context, Rendezvous, RequestFault, Sent, TaskEnd, TaskError};
use std::time::{Duration, Instant};

/// The program of a task that asks `times` questions, and expects in each answer a number that is one greater than in
/// the question.
fn asks(times: i32) -> impl FnOnce(&mut Context) -> Result<(), TaskError> + Send + 'static {
    move |ctx| {
        let ask = ctx.port("ask")?;
        for number in 0..times {
            assert_eq!(ctx.query(ask, &number)?, Asked::Reply(number + 1));
        }
        Ok(())
    }
}

/// A cell with a task that answers questions while it does something else.
fn ask_and_news() -> Cell {
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    cell.port(PortDecl::new("news", C, Usage::Send, &[B], LONG_TICKS).bounded_buffer(4));
    cell
}

#[test]
fn a_handler_answers_while_the_task_waits_for_something_else() {
    let (done, asked) = report();
    let b = Context::with_state(0_i32, |ctx| {
        let (ask, news) = (ctx.port("ask")?, ctx.port("news")?);
        ctx.on_query(ask, |ctx, number: i32| {
            ctx.state += 1;
            Ok(number + 1)
        })?;
        let received = ctx.take::<i8>(news, None)?.expect("without a time_out only a message ends the wait");
        assert_eq!((received.message, received.from.source), (7, C));
        assert_eq!(ctx.state, 100, "every question interrupted the wait");
        Ok(())
    });
    let node = one_node(&table(ask_and_news()))
        .task("a", move |ctx| {
            asks(100)(ctx)?;
            done.send(()).expect("c listens");
            Ok(())
        })
        .task("b", b)
        .task("c", move |ctx| {
            asked.recv_timeout(LONG).expect("a has its answers");
            let news = ctx.port("news")?;
            assert_eq!(ctx.tell(news, &7_i8)?, 1);
            Ok(())
        });
    finish(node.start().unwrap());
}

#[test]
fn without_an_order_a_delay_is_interrupted_only_by_the_rejected_and_with_one_by_the_ranked() {
    for ranked in [false, true] {
        let b = Context::with_state(Vec::new(), move |ctx| {
            let ask = ctx.port("ask")?;
            if ranked {
                ctx.order(&[Ranked::Port(ask), Ranked::Own])?;
            }
            ctx.on_query(ask, |ctx, number: i32| {
                ctx.state.push("handler begins");
                // This delay of the handler interrupts another delay, which goes on meanwhile.
                ctx.delay(Duration::from_millis(5))?;
                ctx.state.push("handler ends");
                Ok(number + 1)
            })?;
            let begin = Instant::now();
            while ctx.state.is_empty() {
                ctx.delay(Duration::from_millis(20))?;
            }
            assert!(begin.elapsed() >= Duration::from_millis(20), "the delay is not cut short");
            assert_eq!(ctx.state, ["handler begins", "handler ends"]);
            Ok(())
        });
        let node = one_node(&table(ask_and_news())).task("a", asks(1)).task("b", b).task("c", |_| Ok(()));
        finish(node.start().unwrap());
    }
}

#[test]
fn a_task_that_computes_is_interrupted_at_its_boundaries_and_never_in_an_atomic_section() {
    let b = Context::with_state(0, |ctx| {
        let ask = ctx.port("ask")?;
        ctx.order(&[Ranked::Port(ask), Ranked::Own])?;
        ctx.on_query(ask, |ctx, number: i32| {
            ctx.state += 1;
            Ok(number + 1)
        })?;
        let before = ctx.atomic(|ctx| {
            for _ in 0..20 {
                ctx.boundary()?;
                ctx.atomic(|ctx| ctx.delay(Duration::from_millis(1)))?;
            }
            Ok(ctx.state)
        })?;
        while ctx.state == before {
            ctx.boundary()?;
        }
        assert_eq!((before, ctx.state), (0, 1));
        Ok(())
    });
    let node = one_node(&table(ask_and_news())).task("a", asks(1)).task("b", b).task("c", |_| Ok(()));
    finish(node.start().unwrap());
}

#[test]
fn timers_end_while_the_task_waits_and_a_stopped_one_does_not() {
    let b = Context::with_state(0, |ctx| {
        let (beat, watch) = (TimeId(1), TimeId(2));
        assert_eq!(ctx.start_timer(beat, Duration::from_millis(1)), Err(TaskError::NoHandler(beat)));
        ctx.on_timer(watch, |_| panic!("it was stopped"));
        ctx.on_timer(beat, move |ctx| {
            ctx.state += 1;
            ctx.start_timer(beat, Duration::from_millis(2))
        });
        ctx.start_timer(watch, Duration::from_secs(50))?;
        ctx.start_timer(beat, Duration::from_millis(2))?;
        ctx.order(&[Ranked::Timers, Ranked::Own])?;
        while ctx.state < 5 {
            ctx.delay(Duration::from_millis(10))?;
        }
        ctx.stop_timer(watch)?;
        ctx.stop_timer(beat)
    });
    let node = one_node(&table(ask_and_news())).task("a", |_| Ok(())).task("b", b).task("c", |_| Ok(()));
    finish(node.start().unwrap());
}

#[test]
fn long_messages_and_answers_come_whole() {
    let mut cell = cell(&[0, 1], Ticks(100));
    cell.port(ask(LONG_TICKS).fragments(16, 3));
    let table = table(cell);
    let network = network(&table, Faults::default());
    let first = on(&network, &table, 0).task("a", |ctx| {
        let ask = ctx.port("ask")?;
        for length in [0_u8, 12, 13, 24, 150, 192] {
            let question: Vec<u8> = (0..length).collect();
            let question = Bytes::new(&question).expect("it fits");
            let answer = ctx.query::<Bytes, Bytes>(ask, &question)?.reply().expect("an answer");
            let backwards: Vec<u8> = (0..length).rev().take(36).collect();
            assert_eq!(&*answer, backwards);
        }
        assert_eq!(ctx.send(ask, &[0; 193]), Err(TaskError::TooLong(193)));
        Ok(())
    });
    let second = on(&network, &table, 1).task("b", |ctx| {
        let ask = ctx.port("ask")?;
        for _ in 0..6 {
            let question = ctx.take::<Bytes>(ask, None)?.expect("a message");
            let backwards: Vec<u8> = question.message.iter().rev().take(36).copied().collect();
            ctx.answer(&question.from, &Bytes::new(&backwards).expect("it fits"))?;
        }
        Ok(())
    });
    let (first, second) = (first.start().unwrap(), second.start().unwrap());
    finish(first);
    finish(second);
}

#[test]
fn nothing_of_an_answer_that_was_too_late_is_part_of_the_next_one() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS).fragments(1, 3));
    let node = one_node(&table(cell))
        .task("a", |ctx| {
            let ask = ctx.port("ask")?;
            let short = Some(AMPLE);
            assert_eq!(ctx.query_with::<(), Bytes>(ask, Target::All, &(), short)?, Asked::TimedOutUnknown);
            let answer = ctx.query::<(), Bytes>(ask, &())?.reply().expect("an answer");
            assert_eq!(&*answer, b"short");
            Ok(())
        })
        .task("b", |ctx| {
            let ask = ctx.port("ask")?;
            let first = ctx.receive(Some(ask), None)?.expect("a question");
            ctx.delay(AMPLE)?;
            let late = ctx.reply(&first.from, &[7; 36]);
            assert_eq!(late, Err(TaskError::Fault(RequestFault(Fault::Late))));
            let second = ctx.receive(Some(ask), None)?.expect("a question");
            ctx.reply(&second.from, b"short")
        });
    finish(node.start().unwrap());
}

#[test]
fn several_are_asked_at_once_and_each_answer_is_told_apart() {
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    cell.port(PortDecl::new("state", A, Usage::Query, &[B, C], AMPLE_TICKS).command());
    let answers = |value: i16| {
        move |ctx: &mut Context| {
            let state = ctx.port("state")?;
            let asked = ctx.take::<()>(state, None)?.expect("a question");
            ctx.answer(&asked.from, &value)
        }
    };
    let node = one_node(&table(cell))
        .task("a", |ctx| {
            let state = ctx.port("state")?;
            let mut said = Vec::new();
            ctx.query_all(state, Target::All, &(), |task, asked| said.push((task, asked)))?;
            assert_eq!(said, [(B, Asked::Reply(20_i16)), (C, Asked::Reply(30))]);
            said.clear();
            // The task answered the first query. No task answers this second query.
            ctx.query_all(state, Target::All, &(), |task, asked| said.push((task, asked)))?;
            assert_eq!(said, [(B, Asked::TimedOutUnknown), (C, Asked::TimedOutUnknown)]);
            let one =
                ctx.query_with::<(), i16>(state, Target::One(B), &(), Some(Duration::from_millis(10)))?;
            assert!(one.may_have_run() || one == Asked::Refused, "{one:?}");
            Ok(())
        })
        .task("b", answers(20))
        .task("c", answers(30));
    finish(node.start().unwrap());
}

#[test]
fn what_is_no_message_of_the_type_is_said_and_a_status_port_is_not_asked() {
    let node = one_node(&table(ask_and_news()))
        .task("a", |_| Ok(()))
        .task("b", |ctx| {
            let news = ctx.port("news")?;
            let wrong = ctx.take::<(i32, bool)>(news, None);
            assert_eq!(wrong, Err(TaskError::NotThisType(1, "(i32, bool)")));
            Ok(())
        })
        .task("c", |ctx| {
            let news = ctx.port("news")?;
            assert!(matches!(ctx.query::<(), ()>(news, &()), Err(TaskError::Fault(_))));
            assert_eq!(ctx.tell(news, &f32::NAN), Err(TaskError::NotSendable("f32")));
            ctx.tell(news, &1_i8).map(drop)
        });
    finish(node.start().unwrap());
}

#[test]
fn what_a_handler_fails_with_ends_the_task() {
    let node = one_node(&table(ask_and_news()))
        .task("a", |ctx| {
            let ask = ctx.port("ask")?;
            let asked = ctx.query_with::<i32, i32>(ask, Target::All, &1, Some(AMPLE))?;
            assert_eq!(asked, Asked::TimedOutUnknown);
            Ok(())
        })
        .task("b", |ctx| {
            let (ask, news) = (ctx.port("ask")?, ctx.port("news")?);
            ctx.on_message(ask, |ctx, _| ctx.port("nowhere").map(drop))?;
            let failed = Err(TaskError::NoPort("nowhere".into()));
            assert_eq!(ctx.receive(Some(news), None).map(drop), failed);
            assert_eq!(ctx.delay(Duration::ZERO), failed, "and it stays so");
            failed
        })
        .task("c", |_| Ok(()))
        .start()
        .unwrap();
    assert!(node.wait(LONG));
    let ends: Vec<_> = node.stop(LONG).into_iter().map(|(_, end)| end).collect();
    let failed = TaskEnd::Failed(TaskError::NoPort("nowhere".into()));
    assert_eq!(ends, [TaskEnd::Returned, failed, TaskEnd::Returned]);
}

#[test]
fn a_panic_in_a_handler_is_the_tasks_crash_and_the_partners_of_its_wait_are_told() {
    let mut cell = ask_and_news();
    cell.port(PortDecl::new("meet", B, Usage::Waitfor, &[A, C], LONG_TICKS));
    let node = one_node(&table(cell))
        .task("a", |ctx| {
            let ask = ctx.port("ask")?;
            let asked = ctx.query_with::<i32, i32>(ask, Target::All, &1, Some(AMPLE))?;
            assert!(asked.may_have_run());
            let meet = ctx.port("meet")?;
            // The loop repeats until the crash of b has cancelled b's arrival. Before that, b's arrival still counts.
            loop {
                match ctx.waitfor_with(meet, [0; 8], Some(Duration::from_millis(20)))? {
                    Rendezvous::GaveUp { missing, .. } if missing & 1 == 1 => return Ok(()),
                    Rendezvous::GaveUp { .. } => {}
                    Rendezvous::Released { .. } => panic!("c never arrives"),
                }
            }
        })
        .task("b", |ctx| {
            let (ask, meet) = (ctx.port("ask")?, ctx.port("meet")?);
            ctx.order(&[Ranked::Port(ask), Ranked::Own])?;
            ctx.on_message(ask, |_, _| panic!("the gripper is gone"))?;
            ctx.waitfor(meet).map(drop)
        })
        .task("c", |_| Ok(()))
        .start()
        .unwrap();
    assert!(node.wait(LONG));
    let ends: Vec<_> = node.stop(LONG).into_iter().map(|(_, end)| end).collect();
    let crash = TaskEnd::Panicked("the gripper is gone".into());
    assert_eq!(ends, [TaskEnd::Returned, crash, TaskEnd::Returned]);
}

/// The primary's partner is stopped, so the primary loses its lease. It is then in the middle of an atomic section that
/// only the loss of the lease can end. Messages that it sends after the loss are refused, in the handler and after the
/// handler (D61, D87).
#[test]
fn the_loss_of_the_lease_interrupts_an_atomic_section_and_what_is_ordered_then_is_refused() {
    let mut cell = cell(&[0, 1, 0], Ticks(2_000));
    let via = cell.port(PortDecl::new("alive", A, Usage::Response, &[B], Ticks(40_000)));
    cell.port(PortDecl::new("move", A, Usage::Send, &[C], Ticks(50_000)).guard(0));
    // The lease is longer than the time for which a busy machine keeps a thread from running. So the primary loses the
    // lease only once, and not before its partner has ended.
    let [lease, takeover, every] = [3_000_000, 20_000_000, 20_000].map(Ticks);
    let (trusted, mutual) = (false, false);
    cell.couples.push(CoupleDecl { primary: A, standby: B, lease, takeover, every, via, trusted, mutual });
    let table = table(cell);
    let network = network(&table, Faults::default());
    let refused = Err(TaskError::Fault(RequestFault(Fault::Fenced)));
    let (tell, told) = report();
    let a = Context::with_state(0, move |ctx| {
        let port = ctx.port("move")?;
        let fenced = refused.clone();
        ctx.on_fence(move |ctx| {
            ctx.state += 1;
            assert_eq!(ctx.send(port, b"go"), fenced);
            Ok(())
        });
        assert_eq!(ctx.send(port, b"go"), refused, "nobody has given it the lease");
        tell.send(()).expect("the test listens");
        let _epoch = ctx.lease()?;
        let sent = ctx.send(port, b"go");
        // If the machine did not run for a while, the lease may be lost before the partner ends.
        assert!(sent == Ok(Sent::Copies(1)) || sent == refused, "{sent:?}");
        tell.send(()).expect("the test listens");
        ctx.atomic(|ctx| {
            while ctx.state == 0 {
                ctx.delay(Duration::from_millis(10))?;
            }
            Ok(())
        })?;
        assert_eq!((ctx.state, ctx.send(port, b"go")), (1, refused));
        Ok(())
    });
    let first = on(&network, &table, 0).task("a", a);
    let first = first.task("c", |_| Ok(()));
    let second = on(&network, &table, 1).task("b", |ctx| ctx.receive(None, None).map(drop));
    let first = first.start().unwrap();
    // Only the second node can grant the lease.
    told.recv_timeout(LONG).expect("it is refused without the lease");
    let second = second.start().unwrap();
    told.recv_timeout(LONG).expect("it is given the lease");
    let _ends = second.stop(LONG);
    finish(first);
}
