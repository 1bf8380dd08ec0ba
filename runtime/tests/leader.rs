//! Tests of a task that waits in the socket (D40): which threads are woken, which are not, and what happens to
//! datagrams for other tasks. These tests run alone, because they would also count the threads of another test.

use crate::alone;
use crate::common::udp::{builders, links, udp_links};
use crate::common::{A, B, C, LONG, LONG_TICKS, ask, cell, finish, report, table};
use imrs_protocol::script::{End, ProgramBuilder};
use imrs_protocol::{CellTable, Incarnation, NodeId, Packet, PortDecl, PortId, Target, Ticks, Usage};
use imrs_runtime::link::udp::{UdpCount, UdpLink};
use imrs_runtime::link::{Came, Leading, Link, LinkBusy, PollEnd, Sink};
use imrs_runtime::{AsyncContext, Builder, Context, Runtime, Sent, TaskEnd, TaskError};
use rustix::thread::{Pid, gettid};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU64, Ordering};
use std::time::{Duration, Instant};

fn sleeps_of(thread: &std::path::Path) -> u64 {
    let status = std::fs::read_to_string(thread.join("status")).expect("a thread");
    let line = status.lines().find_map(|line| line.strip_prefix("voluntary_ctxt_switches:"));
    line.expect("counted").trim().parse().expect("a number")
}

/// How often the receiving threads of the nodes slept.
fn sleeps_of_receivers() -> u64 {
    let threads = std::fs::read_dir("/proc/self/task").expect("the threads of this process").flatten();
    let named = |path: &std::path::Path| std::fs::read_to_string(path.join("comm")).unwrap_or_default();
    let receivers = threads.map(|t| t.path()).filter(|path| named(path).trim() == "imrs receive");
    receivers.map(|path| sleeps_of(&path)).sum()
}

/// A link that reports whether a thread waits in it.
struct Watched {
    link: UdpLink,
    /// The number of the thread that waits in the link; zero if there is none.
    waits: AtomicI32,
}

impl Watched {
    /// Waits until a leading thread sleeps in the link, because that thread then receives all later datagrams. On a
    /// busy machine the task may fail to lead once, because its last wait ended in another way. The round trip then
    /// wakes the receiving thread, and the test counts that wake-up.
    fn is_led(&self) {
        let begin = Instant::now();
        let is_asleep = |thread: i32| {
            let stat = std::fs::read_to_string(format!("/proc/self/task/{thread}/stat")).expect("a thread");
            stat.rsplit_once(") ").is_some_and(|(_, state)| state.starts_with('S'))
        };
        loop {
            let thread = self.waits.load(Ordering::Acquire);
            if (thread != 0 && is_asleep(thread)) || begin.elapsed() > Duration::from_secs(5) {
                return;
            }
            std::thread::sleep(Duration::from_micros(100));
        }
    }
}

impl Link for Watched {
    fn ready(&self, next: NodeId) -> bool {
        self.link.ready(next)
    }

    fn send_at(&self, next: NodeId, packets: &[Packet], at: Instant) -> Result<usize, LinkBusy> {
        self.link.send_at(next, packets, at)
    }

    fn poll(&self, sink: &dyn Sink, until: Option<Instant>) -> PollEnd {
        self.link.poll(sink, until)
    }

    fn wake(&self) {
        self.link.wake();
    }

    fn leading(&self) -> Option<&dyn Leading> {
        Some(self)
    }
}

impl Leading for Watched {
    fn wait(&self, left: Option<Duration>) -> Came {
        self.waits.store(Pid::as_raw(Some(gettid())), Ordering::Release);
        let came = self.link.leading().expect("it leads").wait(left);
        self.waits.store(0, Ordering::Release);
        came
    }

    fn take_in(&self, sink: &dyn Sink) -> bool {
        self.link.leading().expect("it leads").take_in(sink)
    }

    fn call(&self) {
        self.link.leading().expect("it leads").call();
    }
}

/// Builders of two nodes with a task each, `a` that asks and `b` that answers, and the links of the two nodes.
fn asking() -> ([Builder; 2], [Arc<Watched>; 2]) {
    let mut cell = cell(&[0, 1], Ticks(1_000));
    cell.port(ask(Ticks(10 * LONG_TICKS.0)));
    let table = table(cell);
    let links = udp_links(&table).map(|link| Arc::new(Watched { link, waits: AtomicI32::new(0) }));
    let node = |(node, link): (u16, &Arc<Watched>)| {
        let builder = Runtime::builder(Arc::clone(&table), NodeId(node)).incarnation(Incarnation(1), false);
        builder.insecure(true).link(Arc::clone(link) as Arc<dyn Link>)
    };
    ([(0, &links[0]), (1, &links[1])].map(node), links)
}

/// How many round trips the test makes before it counts. In each, a task sends while the other task waits in its
/// link. The first trips bring both tasks into this state.
const WARM_UP: u64 = 5;
const TRIPS: u64 = 20;

/// Checks that the receiving threads were hardly ever woken.
fn nobody_else_was_woken(before: u64) {
    let slept = sleeps_of_receivers() - before;
    assert!(slept < TRIPS / 4, "the receiving threads slept {slept} times in {TRIPS} round trips");
}

fn nodes<const N: usize>(table: &Arc<CellTable>) -> [Builder; N] {
    let nodes = builders(table, &links(table, 0.0));
    nodes.try_into().unwrap_or_else(|_| panic!("{N} nodes"))
}

#[test]
fn leaders() {
    let _alone = alone();
    a_reply_wakes_one_thread();
    a_reply_to_a_future_wakes_one_thread();
    what_is_for_others_does_not_wait_for_a_task_that_computes();
    a_leader_is_called_by_tasks_of_its_own_node();
    time_outs_end_and_stopping_ends_a_wait();
    what_is_sent_together_leaves_in_full_datagrams();
    what_a_script_sends_before_it_waits_leaves_together();
}

fn a_reply_wakes_one_thread() {
    let ([first, second], [of_a, of_b]) = asking();
    let first = first.task("a", move |ctx| {
        let ask = ctx.port("ask")?;
        let mut before = 0;
        for trip in 0..WARM_UP + TRIPS {
            if trip == WARM_UP {
                before = sleeps_of_receivers();
            }
            if trip >= WARM_UP {
                of_b.is_led();
            }
            ctx.send(ask, b"?")?.reply().expect("nothing is lost");
        }
        nobody_else_was_woken(before);
        Ok(())
    });
    let second = second.task("b", move |ctx| {
        let mut trip = 0;
        while let Some(question) = ctx.receive(None, None)? {
            if trip >= WARM_UP {
                of_a.is_led();
            }
            trip += 1;
            ctx.reply(&question.from, b"!")?;
        }
        Ok(())
    });
    let second = second.start().unwrap();
    finish(first.start().unwrap());
    finish_stopped(second);
}

/// On both nodes, the thread of the futures leads while all its futures wait.
fn a_reply_to_a_future_wakes_one_thread() {
    let ([first, second], [of_a, of_b]) = asking();
    let first = first.async_task("a", |mut ctx: AsyncContext| async move {
        let ask = ctx.port("ask")?;
        let mut before = 0;
        for trip in 0..WARM_UP + TRIPS {
            if trip == WARM_UP {
                before = sleeps_of_receivers();
            }
            if trip >= WARM_UP {
                of_b.is_led();
            }
            ctx.send(ask, b"?").await?.reply().expect("nothing is lost");
        }
        nobody_else_was_woken(before);
        Ok(())
    });
    let second = second.async_task("b", |mut ctx: AsyncContext| async move {
        let mut trip = 0;
        while let Some(question) = ctx.receive(None, None).await? {
            if trip >= WARM_UP {
                of_a.is_led();
            }
            trip += 1;
            ctx.reply(&question.from, b"!")?;
        }
        Ok(())
    });
    let second = second.start().unwrap();
    finish(first.start().unwrap());
    finish_stopped(second);
}

fn finish_stopped(runtime: imrs_runtime::Runtime) {
    let ends = runtime.stop(LONG);
    assert!(ends.iter().all(|(_, end)| *end == TaskEnd::Returned), "{ends:?}");
}

/// Task `a` leads (it waits in the socket for its node), takes its message and then computes. Messages for task `b` of
/// that node still arrive.
fn what_is_for_others_does_not_wait_for_a_task_that_computes() {
    let mut cell = cell(&[0, 0, 1], Ticks(1_000));
    cell.port(PortDecl::new("to-a", C, Usage::Send, &[A], LONG_TICKS).command());
    cell.port(PortDecl::new("to-b", C, Usage::Send, &[B], LONG_TICKS).command());
    let [here, there] = nodes(&table(cell));
    let (free, done) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
    let (busy, others) = (Arc::clone(&free), Arc::clone(&done));
    let here = here
        .task("a", move |ctx| {
            let message = ctx.receive(None, None)?.expect("only a message ends it");
            ctx.reply(&message.from, b"")?;
            let start = Instant::now();
            while !others.load(Ordering::Acquire) {
                assert!(start.elapsed() < LONG, "what is for others waits for this task");
                std::hint::spin_loop();
            }
            Ok(())
        })
        .task("b", move |ctx| {
            for _ in 0..20 {
                let message = ctx.receive(None, None)?.expect("only a message ends it");
                ctx.reply(&message.from, b"")?;
            }
            free.store(true, Ordering::Release);
            Ok(())
        });
    let there = there.task("c", move |ctx| {
        let ports = [ctx.port("to-a")?, ctx.port("to-b")?];
        // Meanwhile `a` and `b` go to sleep. Most likely `a` sleeps first, and becomes the leader: it waits in the socket.
        ctx.delay(Duration::from_millis(20))?;
        ctx.send(ports[0], b"")?.reply().expect("nothing is lost");
        for _ in 0..20 {
            ctx.send(ports[1], b"")?.reply().expect("it is not `a` that must take it in");
        }
        done.store(true, Ordering::Release);
        Ok(())
    });
    let here = here.start().unwrap();
    finish(there.start().unwrap());
    finish(here);
    assert!(busy.load(Ordering::Acquire));
}

/// Task `b` waits in the link. In turn, it gets a question from its own node and a datagram.
fn a_leader_is_called_by_tasks_of_its_own_node() {
    let mut cell = cell(&[0, 0, 1], Ticks(1_000));
    cell.port(ask(LONG_TICKS));
    cell.port(PortDecl::new("far", C, Usage::Send, &[B], LONG_TICKS).command());
    let [here, there] = nodes(&table(cell));
    let asking = |name: &'static str| {
        move |ctx: &mut Context| -> Result<(), TaskError> {
            let port = ctx.port(name)?;
            for _ in 0..300 {
                ctx.send(port, b"?")?.reply().expect("nothing is lost");
            }
            Ok(())
        }
    };
    let here = here.task("a", asking("ask")).task("b", |ctx| {
        for _ in 0..600 {
            let question = ctx.receive(None, None)?.expect("only a message ends it");
            ctx.reply(&question.from, b"!")?;
        }
        Ok(())
    });
    let here = here.start().unwrap();
    finish(there.task("c", asking("far")).start().unwrap());
    finish(here);
}

fn time_outs_end_and_stopping_ends_a_wait() {
    let mut cell = cell(&[0, 1], Ticks(1_000));
    cell.port(ask(Ticks(30_000)));
    let table = table(cell);
    let [first, _silent] = nodes(&table);
    let (tell, told) = report();
    let first = first.task("a", move |ctx| {
        let ask = ctx.port("ask")?;
        for micros in [0, 300, 1_500, 12_000] {
            let (length, start) = (Duration::from_micros(micros), Instant::now());
            assert_eq!(ctx.receive(None, Some(length))?, None);
            assert!(start.elapsed() >= length, "{micros} us");
        }
        let start = Instant::now();
        assert!(matches!(ctx.send(ask, b"?")?, Sent::Outcome(_)), "nobody answers");
        assert!(start.elapsed() >= Duration::from_millis(30));
        tell.send(()).expect("the test listens");
        ctx.receive(None, None).map(|_| ())
    });
    let first = first.start().unwrap();
    told.recv_timeout(LONG).expect("time_outs end");
    finish_stopped(first);
}

fn what_is_sent_together_leaves_in_full_datagrams() {
    const MESSAGES: usize = 100;
    let mut cell = cell(&[0, 1], Ticks(1_000));
    let decl = PortDecl::new("news", A, Usage::Send, &[B], LONG_TICKS);
    // The port has room for all of these messages, because the receiver may be late.
    cell.port(decl.bounded_buffer(MESSAGES as u16 + 3));
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    let links = links(&table, 0.0);
    let (count, alone) = (Arc::clone(&links[0]), Arc::new(AtomicU64::new(0)));
    let both = builders(&table, &links);
    let [first, second] = <[Builder; 2]>::try_from(both).unwrap_or_else(|_| panic!("two nodes"));
    let sent = Arc::clone(&alone);
    let first = first.task("a", move |ctx| {
        let (news, ask) = (ctx.port("news")?, ctx.port("ask")?);
        let datagrams = || count.inner().count(UdpCount::DatagramsSent);
        ctx.send(ask, b"?")?.reply().expect("nothing is lost");
        let before = datagrams();
        let since = || datagrams() - before;
        ctx.together(|ctx| (0..MESSAGES).try_for_each(|_| ctx.send(news, b"news").map(|_| ())))?;
        assert_eq!(since(), 3, "44, 44 and 12");
        ctx.together(|ctx| {
            let _copies = ctx.send(news, b"news")?;
            assert_eq!(since(), 3, "it waits for more");
            // All messages that a task has sent leave before the task waits for an answer.
            ctx.send(ask, b"?")?.reply().expect("nothing is lost");
            assert_eq!(since(), 4, "both in one");
            ctx.send(news, b"news").map(|_| ())
        })?;
        assert_eq!(since(), 5);
        let _copies = ctx.send(news, b"news")?;
        assert_eq!(since(), 6, "a lone message leaves at once");
        sent.store(1, Ordering::Release);
        Ok(())
    });
    let second = second.task("b", move |ctx| {
        let (mut news, port) = (0, ctx.port("ask")?);
        while news < MESSAGES + 3 {
            let message = ctx.receive(None, None)?.expect("only a message ends it");
            if message.from.port == port {
                ctx.reply(&message.from, b"!")?;
            } else {
                news += 1;
            }
        }
        Ok(())
    });
    let second = second.start().unwrap();
    finish(first.start().unwrap());
    assert_eq!(alone.load(Ordering::Acquire), 1);
    finish(second);
}

fn what_a_script_sends_before_it_waits_leaves_together() {
    const MESSAGES: usize = 5;
    let mut cell = cell(&[0, 1], Ticks(1_000));
    let decl = PortDecl::new("news", A, Usage::Send, &[B], LONG_TICKS);
    cell.port(decl.bounded_buffer(16));
    let table = table(cell);
    let links = links(&table, 0.0);
    let both = builders(&table, &links);
    let [first, second] = <[Builder; 2]>::try_from(both).unwrap_or_else(|_| panic!("two nodes"));
    let mut script = ProgramBuilder::new("a");
    for _ in 0..MESSAGES {
        script.send(PortId(0), Target::All, &[]);
    }
    script.end();
    let script = Arc::new(script.finish().expect("a sound program"));
    let second = second.task("b", |ctx| {
        for _ in 0..MESSAGES {
            ctx.receive(None, None)?.expect("only a message ends it");
        }
        Ok(())
    });
    let second = second.start().unwrap();
    let first = first.script("a", script).start().unwrap();
    finish(second);
    assert_eq!(links[0].inner().count(UdpCount::DatagramsSent), 1);
    assert_eq!(first.stop(LONG), [("a".to_owned(), TaskEnd::Script(End::Finished))]);
}
