//! Tests of every primitive between real threads, on one node and between nodes.

use crate::common::{
    A, AMPLE, AMPLE_TICKS, B, C, LONG, LONG_TICKS, ask, cell, finish, network, on, one_node, report, table,
    until,
};
use imrs_protocol::{Fault, NodeId, Outcome, PortDecl, Ranked, ReleasedBy, Ticks, Usage};
use imrs_runtime::link::in_process::Faults;
use imrs_runtime::{Context, Rendezvous, RequestFault, Sent, StartError, TaskEnd, TaskError};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Barrier};
use std::time::Duration;

/// The program of a task that answers every question with its number plus one.
fn answer(questions: u32) -> impl FnOnce(&mut Context) -> Result<(), TaskError> + Send + 'static {
    move |ctx| {
        let ask = ctx.port("ask")?;
        for _ in 0..questions {
            let question =
                ctx.receive(Some(ask), None)?.expect("without a time_out only a message ends the wait");
            let number = u32::from_le_bytes(question.contents.as_bytes().try_into().expect("four bytes"));
            ctx.reply(&question.from, &(number + 1).to_le_bytes())?;
        }
        Ok(())
    }
}

fn question(questions: u32) -> impl FnOnce(&mut Context) -> Result<(), TaskError> + Send + 'static {
    move |ctx| {
        let ask = ctx.port("ask")?;
        for number in 0..questions {
            let reply = ctx.send(ask, &number.to_le_bytes())?.reply().expect("a reply");
            assert_eq!(reply.as_bytes(), (number + 1).to_le_bytes());
        }
        Ok(())
    }
}

#[test]
fn send_receive_reply_on_one_node() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    finish(one_node(&table).task("a", question(2_000)).task("b", answer(2_000)).start().unwrap());
}

#[test]
fn send_receive_reply_between_nodes() {
    let mut cell = cell(&[0, 1], Ticks(100));
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    let network = network(&table, Faults::default());
    let first = on(&network, &table, 0).task("a", question(500));
    let second = on(&network, &table, 1).task("b", answer(500));
    let (first, second) = (first.start().unwrap(), second.start().unwrap());
    finish(first);
    finish(second);
}

#[test]
fn a_packet_is_relayed_over_nodes_that_do_not_join_its_ends() {
    let mut cell = imrs_protocol::Cell::new("line", Ticks(1_000));
    let nodes: Vec<NodeId> = ["x", "y", "z"].map(|name| cell.node(name)).into();
    cell.link(nodes[0], nodes[1], Ticks(100));
    cell.link(nodes[1], nodes[2], Ticks(100));
    cell.task("a", nodes[0]);
    cell.task("b", nodes[2]);
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    let network = network(&table, Faults::default());
    let relay = on(&network, &table, 1);
    let first = on(&network, &table, 0).task("a", question(50));
    let last = on(&network, &table, 2).task("b", answer(50));
    let relay = relay.start().unwrap();
    let (first, last) = (first.start().unwrap(), last.start().unwrap());
    finish(first);
    finish(last);
    finish(relay);
}

#[test]
fn class_1_goes_to_all_users_and_is_polled() {
    let mut cell = cell(&[0, 0, 1], Ticks(100));
    cell.port(PortDecl::new("halt", A, Usage::Send, &[B, C], LONG_TICKS));
    let table = table(cell);
    let network = network(&table, Faults::default());
    let listen = |ctx: &mut Context| {
        let halt = ctx.port("halt")?;
        loop {
            if let Some(message) = ctx.poll(Some(halt))? {
                assert_eq!((message.from.source, message.contents.as_bytes()), (A, &b"stop"[..]));
                return Ok(());
            }
            ctx.delay(Duration::from_millis(1))?;
        }
    };
    let tell = |ctx: &mut Context| {
        let halt = ctx.port("halt")?;
        assert_eq!(ctx.send(halt, b"stop")?, Sent::Copies(2));
        Ok(())
    };
    let second = on(&network, &table, 1).task("c", listen);
    let first = on(&network, &table, 0).task("a", tell).task("b", listen);
    let (first, second) = (first.start().unwrap(), second.start().unwrap());
    assert!(second.wait(LONG));
    finish(first);
    finish(second);
}

#[test]
fn the_most_urgent_message_comes_first_and_a_source_can_be_chosen() {
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    cell.port(PortDecl::new("slow", B, Usage::Send, &[A], LONG_TICKS).bounded_buffer(4));
    cell.port(PortDecl::new("fast", C, Usage::Send, &[A], Ticks(30_000_000)).bounded_buffer(4));
    let table = table(cell);
    let sent = Arc::new(Barrier::new(3));
    let tell = |port: &'static str| {
        let sent = Arc::clone(&sent);
        move |ctx: &mut Context| {
            let port = ctx.port(port)?;
            assert_eq!(ctx.send(port, b"1")?, Sent::Copies(1));
            assert_eq!(ctx.send(port, b"2")?, Sent::Copies(1));
            sent.wait();
            Ok(())
        }
    };
    let all_sent = Arc::clone(&sent);
    let node = one_node(&table)
        .task("b", tell("slow"))
        .task("c", tell("fast"))
        .task("a", move |ctx| {
            all_sent.wait();
            let next = |ctx: &mut Context| ctx.poll(None).map(|m| m.map(|m| (m.from.source, m.contents)));
            let slow = ctx.receive_from(None, B, Some(LONG))?.expect("b has sent");
            assert_eq!(slow.contents.as_bytes(), b"1");
            let rest: Vec<_> = std::iter::from_fn(|| next(ctx).expect("no fault")).collect();
            let rest: Vec<_> = rest.iter().map(|(source, c)| (*source, c.as_bytes()[0])).collect();
            assert_eq!(rest, [(C, b'1'), (C, b'2'), (B, b'2')]);
            Ok(())
        })
        .start()
        .unwrap();
    finish(node);
}

#[test]
fn a_full_buffer_refuses_at_once() {
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    cell.port(PortDecl::new("ask", B, Usage::Receive, &[A, C], LONG_TICKS).command());
    let table = table(cell);
    let (first, second) = (report::<()>(), report::<()>());
    let node = one_node(&table)
        .task("a", move |ctx| {
            let ask = ctx.port("ask")?;
            assert_eq!(ctx.send(ask, b"a")?.reply().expect("b answers one").as_bytes(), b"yes");
            Ok(())
        })
        .task("c", move |ctx| {
            first.1.recv().expect("a has asked");
            // The port's buffer holds one message, so the second sender finds it full.
            let ask = ctx.port("ask")?;
            assert_eq!(ctx.send(ask, b"c")?, Sent::Outcome(Outcome::Refused));
            second.0.send(()).expect("b listens");
            Ok(())
        })
        .task("b", move |ctx| {
            second.1.recv().expect("c was refused");
            let question = ctx.receive(None, None)?.expect("a has asked");
            assert_eq!(question.from.source, A);
            ctx.reply(&question.from, b"yes")
        })
        .start()
        .unwrap();
    until(|| node.node().snapshot(0).tasks[1].view.ports[0].len == 1);
    first.0.send(()).expect("c listens");
    finish(node);
}

#[test]
fn a_reply_after_the_budget_is_late_and_a_second_one_answers_nothing() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(AMPLE_TICKS));
    let table = table(cell);
    let node = one_node(&table)
        .task("a", |ctx| {
            let ask = ctx.port("ask")?;
            assert_eq!(ctx.send(ask, b"")?, Sent::Outcome(Outcome::TimedOutUnknown));
            Ok(())
        })
        .task("b", |ctx| {
            let question = ctx.receive(None, None)?.expect("a asks");
            assert!(question.budget <= AMPLE_TICKS);
            ctx.delay(AMPLE)?;
            let late = ctx.reply(&question.from, b"too late");
            assert_eq!(late, Err(TaskError::Fault(RequestFault(Fault::Late))));
            Ok(())
        })
        .start()
        .unwrap();
    finish(node);
}

/// Lets three tasks meet repeatedly. The counters of a round prove that all tasks had arrived when a task was released.
fn meet(
    rounds: u32,
    counts: Arc<[AtomicU32]>,
) -> impl Fn(&mut Context) -> Result<(), TaskError> + Clone + Send {
    move |ctx| {
        let lift = ctx.port("lift")?;
        for attempt in 0..rounds {
            counts[attempt as usize].fetch_add(1, Ordering::SeqCst);
            match ctx.waitfor(lift)? {
                Rendezvous::Released { by, .. } => {
                    assert_eq!(counts[attempt as usize].load(Ordering::SeqCst), 3, "a false release");
                    assert!(by != ReleasedBy::Confirm(ctx.id()));
                }
                Rendezvous::GaveUp { round, missing } => panic!("gave up {round}, missing {missing:b}"),
            }
        }
        Ok(())
    }
}

#[test]
fn three_tasks_of_one_node_meet_many_times() {
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    cell.port(PortDecl::new("lift", A, Usage::Waitfor, &[B, C], LONG_TICKS));
    let table = table(cell);
    let program = meet(500, (0..500).map(|_| AtomicU32::new(0)).collect());
    let node = one_node(&table).task("a", program.clone()).task("b", program.clone()).task("c", program);
    finish(node.start().unwrap());
}

#[test]
fn three_nodes_meet_many_times_while_packets_overtake_each_other() {
    let mut cell = cell(&[0, 1, 2], Ticks(2_000));
    let lift = PortDecl::new("lift", A, Usage::Waitfor, &[B, C], LONG_TICKS);
    cell.port(lift.resend(Ticks(20_000), 1));
    let table = table(cell);
    let faults =
        Faults { seed: 7, duplicates: 0.2, most_delay: Duration::from_millis(1), ..Faults::default() };
    let network = network(&table, faults);
    let program = meet(100, (0..100).map(|_| AtomicU32::new(0)).collect());
    let builders: Vec<_> = (0..3)
        .zip(["a", "b", "c"])
        .map(|(node, task)| on(&network, &table, node).task(task, program.clone()))
        .collect();
    let nodes: Vec<_> = builders.into_iter().map(|node| node.start().unwrap()).collect();
    // No node ends before all tasks have met, because another node may still ask for a CONFIRM.
    assert!(nodes.iter().all(|node| node.wait(LONG)));
    nodes.into_iter().for_each(finish);
}

#[test]
fn faults_of_a_request_are_errors_and_change_nothing() {
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    cell.port(PortDecl::new("tell", C, Usage::Send, &[A], LONG_TICKS));
    let table = table(cell);
    let fault = |fault| Err(TaskError::Fault(RequestFault(fault)));
    let node = one_node(&table)
        .task("a", move |ctx| {
            let (ask, tell) = (ctx.port("ask")?, ctx.port("tell")?);
            assert_eq!(ctx.port("none"), Err(TaskError::NoPort("none".into())));
            assert_eq!(ctx.task("nobody"), Err(TaskError::NoTask("nobody".into())));
            assert_eq!(ctx.task("c"), Ok(C));
            assert_eq!(ctx.send(ask, &[0; 13]), Err(TaskError::TooLong(13)));
            assert_eq!(ctx.send_to(ask, C, b""), fault(Fault::NotAPeer));
            assert_eq!(ctx.send(tell, b""), fault(Fault::WrongUsage));
            assert_eq!(ctx.receive(Some(ask), None), Err(TaskError::Fault(RequestFault(Fault::WrongUsage))));
            assert_eq!(ctx.order(&[Ranked::Port(ask); 9]), Err(TaskError::TooManyLevels(9)));
            ctx.order(&[Ranked::Port(tell)])
        })
        .task("b", |ctx| {
            // A port of other tasks is not found under its name.
            assert_eq!(ctx.port("tell"), Err(TaskError::NoPort("tell".into())));
            Ok(())
        })
        .task("c", |_| Ok(()))
        .start()
        .unwrap();
    finish(node);
}

#[test]
fn a_node_that_cannot_start_says_why() {
    let mut cell = cell(&[0, 1], Ticks(100));
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    let nothing = |_: &mut Context| Ok(());
    let builder = || on(&network(&table, Faults::default()), &table, 0);
    let error = |builder: imrs_runtime::Builder| builder.start().err().expect("must not start").to_string();
    assert_eq!(error(builder()), "task `a` was given no program");
    assert_eq!(error(builder().task("a", nothing).task("a", nothing)), "task `a` was given two programs");
    assert_eq!(error(builder().task("b", nothing)), "task `b` runs on node `n1`, not here");
    assert_eq!(error(builder().task("x", nothing)), "the cell has no task `x`");
    assert_eq!(error(one_node(&table).task("a", nothing)), "node `n0` has neighbours but was given no link");
    let nowhere = imrs_runtime::Runtime::builder(Arc::clone(&table), NodeId(9));
    assert!(matches!(nowhere.start(), Err(StartError::NoNode(NodeId(9)))));
}

#[test]
fn programs_that_fail_are_told_apart() {
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    let node = one_node(&table)
        .task("a", |ctx| ctx.port("nowhere").map(|_| ()))
        .task("b", |_| panic!("this crash is part of the test"))
        .task("c", |_| Ok(()))
        .start()
        .unwrap();
    assert!(node.wait(LONG));
    let ends: Vec<TaskEnd> = node.stop(LONG).into_iter().map(|(_, end)| end).collect();
    assert_eq!(
        ends,
        [
            TaskEnd::Failed(TaskError::NoPort("nowhere".into())),
            TaskEnd::Panicked("this crash is part of the test".into()),
            TaskEnd::Returned,
        ]
    );
}
