//! Tests of how incarnations end: nodes stop and restart, tasks crash.

use crate::common::{
    A, AMPLE_TICKS, B, C, LONG, LONG_TICKS, ask, cell, finish, network, on, one_node, report, table, until,
};
use imrs_protocol::{Incarnation, NodeId, Outcome, PortDecl, TaskState, Ticks, Usage};
use imrs_runtime::link::in_process::Faults;
use imrs_runtime::{Context, Rendezvous, Runtime, Sent, TaskEnd, TaskError};
use imrs_wire::obs::Liveness;
use std::sync::Arc;
use std::time::{Duration, Instant};

fn state(node: &Runtime, place: usize) -> TaskState {
    node.node().snapshot(0).tasks[place].view.state
}

#[test]
fn stopping_ends_every_kind_of_wait() {
    let mut cell = cell(&[0, 0, 0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    cell.port(PortDecl::new("lift", C, Usage::Waitfor, &[imrs_protocol::TaskId(3)], LONG_TICKS));
    let table = table(cell);
    let stopped = |result: Result<(), TaskError>| {
        assert_eq!(result, Err(TaskError::Stopped));
        result
    };
    let node = one_node(&table)
        .task("a", move |ctx| {
            let ask = ctx.port("ask")?;
            stopped(ctx.send(ask, b"?").map(|_| ()))
        })
        .task("b", move |ctx| {
            let _unanswered = ctx.receive(None, None)?;
            stopped(ctx.receive(None, None).map(|_| ()))?;
            stopped(ctx.poll(None).map(|_| ()))
        })
        .task("c", move |ctx| {
            let lift = ctx.port("lift")?;
            stopped(ctx.waitfor(lift).map(|_| ()))
        })
        .task("d", move |ctx| stopped(ctx.delay(LONG)))
        .start()
        .unwrap();
    until(|| (0..4).all(|place| state(&node, place) != TaskState::Running));
    let start = Instant::now();
    let ends = node.stop(LONG);
    assert!(ends.iter().all(|(_, end)| *end == TaskEnd::Returned), "{ends:?}");
    assert!(start.elapsed() < LONG / 2, "the stop waited for time_outs");
}

#[test]
fn a_program_that_never_asks_is_left_behind() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    let (release, wait) = report::<()>();
    let node = one_node(&table)
        .task("a", move |_| {
            let _ = wait.recv();
            Ok(())
        })
        .task("b", |_| Ok(()))
        .start()
        .unwrap();
    assert!(!node.wait(Duration::from_millis(20)));
    let ends = node.stop(Duration::from_millis(20));
    assert_eq!(ends[0].1, TaskEnd::Unfinished);
    drop(release);
}

#[test]
fn a_member_that_stops_tells_the_others() {
    let mut cell = cell(&[0, 1, 2], Ticks(1_000));
    cell.port(PortDecl::new("lift", A, Usage::Waitfor, &[B, C], LONG_TICKS));
    let table = table(cell);
    let network = network(&table, Faults::default());
    let wait = |ctx: &mut Context| {
        let lift = ctx.port("lift")?;
        ctx.waitfor(lift).map(|_| ())
    };
    let first = on(&network, &table, 0).task("a", wait);
    let second = on(&network, &table, 1).task("b", wait);
    let third = on(&network, &table, 2).task("c", |_| Ok(()));
    let (first, second) = (first.start().unwrap(), second.start().unwrap());
    let third = third.start().unwrap();
    let b_has_arrived = || first.node().snapshot(0).tasks[0].view.meetings[0].members[1].arrived;
    until(b_has_arrived);
    assert_eq!(second.stop(LONG)[0].1, TaskEnd::Returned);
    until(|| !b_has_arrived());
    assert!(matches!(state(&first, 0), TaskState::Waiting { .. }), "an ABORT ends nobody else's wait");
    drop((first, third));
}

#[test]
fn a_crash_is_the_tasks_own_and_shown() {
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    cell.port(ask(AMPLE_TICKS));
    cell.port(PortDecl::new("lift", A, Usage::Waitfor, &[B, C], Ticks(50_000)));
    let table = table(cell);
    let go_on = |ctx: &mut Context| {
        let lift = ctx.port("lift")?;
        let Rendezvous::GaveUp { missing, .. } = ctx.waitfor(lift)? else {
            panic!("b crashed before it came")
        };
        // The member that gives up last reports two members as missing: one of them is the member that gave up before it.
        assert!(missing & 0b010 != 0, "{missing:b}");
        Ok(())
    };
    let node = one_node(&table)
        .task("a", move |ctx| {
            let ask = ctx.port("ask")?;
            // The task took the message and crashed, so it is unknown whether the command ran.
            assert_eq!(ctx.send(ask, b"")?, Sent::Outcome(Outcome::TimedOutUnknown));
            go_on(ctx)
        })
        .task("b", |ctx| {
            let _question = ctx.receive(None, None)?;
            panic!("this crash is part of the test");
        })
        .task("c", move |ctx| {
            ctx.delay(Duration::from_millis(50))?;
            go_on(ctx)
        })
        .start()
        .unwrap();
    assert!(node.wait(LONG));
    let liveness: Vec<_> = node.node().snapshot(0).tasks.iter().map(|task| task.liveness).collect();
    let ends = node.stop(LONG);
    assert_eq!(ends[1].1, TaskEnd::Panicked("this crash is part of the test".into()));
    assert_eq!(liveness, [Liveness::Ended, Liveness::Crashed, Liveness::Ended], "{ends:?}");
}

#[test]
fn a_restart_while_a_command_waits_is_told_to_its_sender() {
    let mut cell = cell(&[0, 1], Ticks(1_000));
    cell.port(ask(LONG_TICKS));
    cell.port(PortDecl::new("alive", B, Usage::Send, &[A], LONG_TICKS));
    let table = table(cell);
    let network = network(&table, Faults::default());
    let asker = on(&network, &table, 0).task("a", |ctx| {
        let ask = ctx.port("ask")?;
        assert_eq!(ctx.send(ask, b"work")?, Sent::Outcome(Outcome::PeerRestarted));
        // The new incarnation cannot know which commands the old incarnation ran. For a while it says so in answer to
        // every command.
        assert_eq!(ctx.send(ask, b"work")?, Sent::Outcome(Outcome::PeerRestarted));
        Ok(())
    });
    let (taken, was_taken) = report::<()>();
    let first_incarnation = on(&network, &table, 1).task("b", move |ctx| {
        let alive = ctx.port("alive")?;
        assert_eq!(ctx.send(alive, b"")?, Sent::Copies(1));
        let _question = ctx.receive(None, None)?;
        taken.send(()).expect("the test listens");
        Ok(())
    });
    let (asker, first_incarnation) = (asker.start().unwrap(), first_incarnation.start().unwrap());
    was_taken.recv_timeout(LONG).expect("the question came");
    finish(first_incarnation);
    let link = network.join(NodeId(1), Incarnation(2), true);
    let second_incarnation = Runtime::builder(Arc::clone(&table), NodeId(1))
        .incarnation(Incarnation(2), true)
        .link(Arc::new(link))
        .task("b", |ctx| {
            let alive = ctx.port("alive")?;
            assert_eq!(ctx.send(alive, b"")?, Sent::Copies(1));
            Ok(())
        })
        .start()
        .unwrap();
    assert!(asker.wait(LONG), "the asker was not told");
    finish(second_incarnation);
    finish(asker);
}

/// Sends a command to a neighbour from which this node has never received anything; then the first datagram of that
/// neighbour arrives. Returns the command's outcome.
fn first_contact(restarted: bool, time_out: Ticks) -> Outcome {
    let mut cell = cell(&[0, 1], Ticks(1_000));
    cell.port(ask(time_out));
    cell.port(PortDecl::new("alive", B, Usage::Send, &[A], LONG_TICKS));
    let table = table(cell);
    let network = network(&table, Faults::default());
    let (tell, told) = report();
    let asker = on(&network, &table, 0).task("a", move |ctx| {
        let ask = ctx.port("ask")?;
        let Sent::Outcome(outcome) = ctx.send(ask, b"work")? else { panic!("a command has an outcome") };
        tell.send(outcome).expect("the test listens");
        Ok(())
    });
    let asker = asker.start().unwrap();
    until(|| asker.node().snapshot(0).links[0].sent == 1);
    let link = network.join(NodeId(1), Incarnation(7), restarted);
    let other = Runtime::builder(Arc::clone(&table), NodeId(1))
        .incarnation(Incarnation(7), restarted)
        .link(Arc::new(link))
        .task("b", |ctx| {
            let alive = ctx.port("alive")?;
            assert_eq!(ctx.send(alive, b"")?, Sent::Copies(1));
            Ok(())
        })
        .start()
        .unwrap();
    until(|| asker.node().snapshot(0).links[0].heard_us.is_some());
    let outcome = told.recv_timeout(LONG).expect("the command ends");
    finish(other);
    finish(asker);
    outcome
}

#[test]
fn a_neighbour_that_restarted_before_it_was_ever_heard_of_ends_a_command_that_waits() {
    assert_eq!(first_contact(true, LONG_TICKS), Outcome::PeerRestarted);
}

#[test]
fn a_neighbour_in_its_first_incarnation_ends_no_command_by_being_heard_of() {
    assert_eq!(first_contact(false, Ticks(500_000)), Outcome::TimedOutUnknown);
}
