//! Tests of whole nodes over loopback UDP.

use crate::common::udp::{builders, links};
use crate::common::{A, B, C, LONG, LONG_TICKS, ask, cell, finish, report, table};
use imrs_protocol::{Incarnation, NodeId, NodeTable, Outcome, PortDecl, Round, Ticks, Usage};
use imrs_runtime::link::udp::{UdpLink, UdpOptions};
use imrs_runtime::{Context, Rendezvous, Runtime, Sent, TaskError};
use std::sync::Arc;
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

#[test]
fn send_receive_reply_over_udp() {
    let mut cell = cell(&[0, 1], Ticks(1_000));
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    let mut nodes = builders(&table, &links(&table, 0.0)).into_iter();
    let mut next = || nodes.next().expect("two nodes");
    let first = next().task("a", |ctx| {
        let ask = ctx.port("ask")?;
        for _ in 0..200 {
            assert_eq!(ctx.send(ask, b"?")?.reply().expect("nothing is lost").as_bytes(), b"!");
        }
        Ok(())
    });
    let second = next().task("b", |ctx| {
        for _ in 0..200 {
            let question = ctx.receive(None, None)?.expect("only a message ends it");
            ctx.reply(&question.from, b"!")?;
        }
        Ok(())
    });
    let (first, second) = (first.start().unwrap(), second.start().unwrap());
    assert!(first.node().snapshot(0).insecure);
    assert!(first.wait(LONG) && second.wait(LONG));
    let link = &first.node().snapshot(0).links[0];
    assert!(link.sent >= 200 && link.received >= 200 && link.heard_us.is_some(), "{link:?}");
    finish(first);
    finish(second);
}

/// The receiver of a command ends before the sender receives anything from it. The receiver's next incarnation says
/// with its first datagram that it was restarted.
#[test]
fn a_restart_before_the_first_contact_is_told_to_the_sender_over_udp() {
    let mut cell = cell(&[0, 1], Ticks(1_000));
    cell.port(ask(LONG_TICKS));
    cell.port(PortDecl::new("alive", B, Usage::Send, &[A], LONG_TICKS));
    let table = table(cell);
    let bind = |node, incarnation, restarted| {
        let here = NodeTable::new(Arc::clone(&table), NodeId(node));
        let address = "127.0.0.1:0".parse().expect("an address");
        UdpLink::bind(here, address, UdpOptions::new(Incarnation(incarnation), restarted))
            .expect("a free port")
    };
    let (asker, first_incarnation) = (bind(0, 1, false), bind(1, 1, false));
    let asker_address = Some(asker.local_address());
    asker.set_address(NodeId(1), Some(first_incarnation.local_address())).expect("a neighbour");
    let asker = Runtime::builder(Arc::clone(&table), NodeId(0))
        .incarnation(Incarnation(1), false)
        .link(Arc::new(asker))
        .task("a", |ctx| {
            let ask = ctx.port("ask")?;
            assert_eq!(ctx.send(ask, b"work")?, Sent::Outcome(Outcome::PeerRestarted));
            Ok(())
        })
        .start()
        .unwrap();
    let start = Instant::now();
    while asker.node().snapshot(0).links[0].sent == 0 {
        assert!(start.elapsed() < LONG, "the command did not leave");
        std::thread::sleep(Duration::from_millis(1));
    }
    drop(first_incarnation);
    let second_incarnation = bind(1, 2, true);
    second_incarnation.set_address(NodeId(0), asker_address).expect("a neighbour");
    let second_incarnation = Runtime::builder(table, NodeId(1))
        .incarnation(Incarnation(2), true)
        .link(Arc::new(second_incarnation))
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

const ATTEMPTS: usize = 40;

fn meet(tell: Sender<(u16, Option<Round>)>) -> impl FnOnce(&mut Context) -> Result<(), TaskError> + Send {
    move |ctx| {
        let lift = ctx.port("lift")?;
        for _ in 0..ATTEMPTS {
            let released = match ctx.waitfor(lift)? {
                Rendezvous::Released { round, .. } => Some(round),
                Rendezvous::GaveUp { .. } => None,
            };
            tell.send((ctx.id().0, released)).expect("the test listens");
        }
        Ok(())
    }
}

#[test]
fn three_nodes_meet_over_udp_under_loss_and_nothing_hangs() {
    let mut cell = cell(&[0, 1, 2], Ticks(5_000));
    let lift = PortDecl::new("lift", A, Usage::Waitfor, &[B, C], Ticks(300_000));
    cell.port(lift.resend(Ticks(10_000), 2));
    let table = table(cell);
    let (tell, told) = report();
    let links = links(&table, 0.2);
    let nodes: Vec<Runtime> = builders(&table, &links)
        .into_iter()
        .zip(["a", "b", "c"])
        .map(|(node, task)| node.task(task, meet(tell.clone())).start().unwrap())
        .collect();
    drop(tell);
    assert!(nodes.iter().all(|node| node.wait(LONG)), "something hangs");
    nodes.into_iter().for_each(finish);
    let lost: u64 = links.iter().map(|link| link.injected().lost_packets).sum();
    assert!(lost > 0, "the links lost nothing");
    let ends: Vec<_> = told.iter().collect();
    assert_eq!(ends.len(), 3 * ATTEMPTS, "every attempt ends, one way or the other");
    for task in 0..3 {
        let rounds: Vec<Round> =
            ends.iter().filter(|(t, _)| *t == task).filter_map(|(_, round)| *round).collect();
        assert!(
            rounds.windows(2).all(|pair| pair[1].is_newer_than(pair[0])),
            "a round released twice: {rounds:?}"
        );
        assert!(!rounds.is_empty(), "task {task} was never released");
    }
}
