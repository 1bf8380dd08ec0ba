//! Tests of time: no wait ends early, and every wait ends.

use crate::common::{A, B, C, LONG_TICKS, ask, cell, finish, one_node, report, table};
use imrs_protocol::{NodeId, Outcome, Packet, PortDecl, Ticks, Usage};
use imrs_runtime::link::{Link, LinkBusy, PollEnd, Sink};
use imrs_runtime::{AsyncContext, Context, Rendezvous, Runtime, SPIN_TAIL, Sent};
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

/// A generous limit for the lateness of a wait, because the machine may be busy.
const LATE: Duration = Duration::from_secs(120);

fn timed<T>(call: impl FnOnce() -> T) -> (T, Duration) {
    let start = Instant::now();
    (call(), start.elapsed())
}

fn in_time(took: Duration, least: Duration) {
    assert!(took >= least, "early: {took:?} instead of {least:?}");
    assert!(took < least + LATE, "late: {took:?} instead of {least:?}");
}

#[test]
fn delays_and_empty_waits_never_end_early() {
    for spin_tail in [None, Some(Duration::ZERO), Some(SPIN_TAIL), Some(Duration::from_micros(300))] {
        wait_for_times(spin_tail);
    }
}

/// Lengths of delays: some about as long as the spin tail (the time for which the Timer thread spins), and longer
/// ones.
fn lengths(step: usize) -> impl Iterator<Item = Duration> {
    (0..16).chain((16..2_000).step_by(step)).map(|micros| Duration::from_nanos(micros * 1_001))
}

fn wait_for_times(spin_tail: Option<Duration>) {
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    let node = one_node(&table);
    let node = if let Some(tail) = spin_tail { node.spin_tail(tail) } else { node };
    let node = node
        .task("a", |ctx| {
            for length in lengths(37) {
                let (done, took) = timed(|| ctx.delay(length));
                done?;
                in_time(took, length);
            }
            Ok(())
        })
        .task("b", |ctx| {
            for length in lengths(41) {
                let (message, took) = timed(|| ctx.receive(None, Some(length)));
                assert_eq!(message?, None);
                in_time(took, length);
            }
            Ok(())
        })
        // The Timer thread serves this task's delays.
        .async_task("c", |mut ctx: AsyncContext| async move {
            for length in lengths(43) {
                let begins = Instant::now();
                ctx.delay(length).await?;
                in_time(begins.elapsed(), length);
            }
            Ok(())
        })
        .start()
        .unwrap();
    finish(node);
}

#[test]
fn a_command_nobody_answers_times_out_and_may_have_run() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(ask(Ticks(30_000)));
    let table = table(cell);
    let node = one_node(&table)
        .task("a", |ctx| {
            let ask = ctx.port("ask")?;
            let (sent, took) = timed(|| ctx.send(ask, b"anybody?"));
            assert_eq!(sent?, Sent::Outcome(Outcome::TimedOutUnknown));
            in_time(took, Duration::from_millis(30));
            Ok(())
        })
        .task("b", |_| Ok(()))
        .start()
        .unwrap();
    finish(node);
}

#[test]
fn whoever_waits_for_missing_tasks_gives_up_and_knows_who_is_missing() {
    let mut cell = cell(&[0, 0, 0], Ticks(0));
    cell.port(PortDecl::new("lift", A, Usage::Waitfor, &[B, C], Ticks(50_000)));
    let table = table(cell);
    let wait = |ctx: &mut Context| {
        let lift = ctx.port("lift")?;
        let (end, took) = timed(|| ctx.waitfor(lift));
        let Rendezvous::GaveUp { missing, .. } = end? else { panic!("a false release") };
        assert!(missing & 0b100 != 0, "c never came: {missing:b}");
        in_time(took, Duration::from_millis(50));
        Ok(())
    };
    finish(one_node(&table).task("a", wait).task("b", wait).task("c", |_| Ok(())).start().unwrap());
}

/// A link that takes no packet.
#[derive(Default)]
struct Busy {
    woken: Mutex<bool>,
    changed: Condvar,
}

impl Link for Busy {
    fn ready(&self, _next: NodeId) -> bool {
        false
    }

    fn send_at(&self, _next: NodeId, _packets: &[Packet], _at: Instant) -> Result<usize, LinkBusy> {
        Err(LinkBusy)
    }

    fn poll(&self, _sink: &dyn Sink, _until: Option<Instant>) -> PollEnd {
        let mut woken = self.woken.lock().unwrap();
        while !std::mem::take(&mut *woken) {
            woken = self.changed.wait(woken).unwrap();
        }
        PollEnd::Woken
    }

    fn wake(&self) {
        *self.woken.lock().unwrap() = true;
        self.changed.notify_all();
    }
}

#[test]
fn a_command_that_never_left_the_node_did_not_run() {
    let mut cell = cell(&[0, 1], Ticks(100));
    cell.port(ask(Ticks(30_000)));
    let table = table(cell);
    let node = Runtime::builder(table, NodeId(0))
        .link(Arc::new(Busy::default()))
        .task("a", |ctx| {
            let ask = ctx.port("ask")?;
            for _ in 0..5 {
                let (sent, took) = timed(|| ctx.send(ask, b"go"));
                assert_eq!(sent?, Sent::Outcome(Outcome::TimedOutUnsent));
                in_time(took, Duration::from_millis(30));
            }
            Ok(())
        })
        .start()
        .unwrap();
    finish(node);
}

#[test]
fn a_waiting_message_expires_though_nobody_looks() {
    let mut cell = cell(&[0, 0], Ticks(0));
    cell.port(PortDecl::new("tell", A, Usage::Send, &[B], Ticks(20_000)).bounded_buffer(8));
    let table = table(cell);
    let (tell, expire) = report();
    let node = one_node(&table)
        .task("a", |ctx| {
            let tell = ctx.port("tell")?;
            for _ in 0..3 {
                assert_eq!(ctx.send(tell, b"news")?, Sent::Copies(1));
            }
            Ok(())
        })
        // The thread of this task is busy, so the Timer thread must serve the expiry.
        .task("b", move |ctx| {
            expire.recv().expect("the test waits for that");
            assert_eq!(ctx.poll(None)?, None);
            Ok(())
        })
        .start()
        .unwrap();
    let start = Instant::now();
    let expired = || node.node().snapshot(8).tasks[1].view.ports[0].counters.expired;
    while expired() < 3 {
        assert!(start.elapsed() < LATE, "nothing expired");
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(start.elapsed() < LATE);
    tell.send(()).expect("b waits");
    finish(node);
}
