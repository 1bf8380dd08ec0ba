//! Measures an urgent message behind a full port (goal P7), and the throughput of many messages (goal P6).

use super::cells::{self, LONG_TICKS};
use super::floors;
use crate::cores::{self, Core};
use crate::sample::{Sample, nanos_of};
use crate::suite::{Effort, Goal, Row, Stat, Suite};
use imrs_protocol::{NodeId, PortDecl, PortId, TaskId, Ticks, Usage};
use imrs_runtime::{MANY, Runtime};
use std::collections::BinaryHeap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{TryRecvError, channel, sync_channel};
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

/// How many messages are queued before the urgent one is sent.
pub const BEHIND: u16 = 1_024;
/// How long the receiver works for each queued message.
const SERVICE: Duration = Duration::from_micros(2);
/// How many messages of one sender may be in flight at once.
pub const WINDOW: u64 = 256;

/// The suite with an urgent message behind 1,024 others.
#[must_use]
pub fn urgent() -> Suite {
    let mut suite = Suite::new("urgent");
    floors::line(&mut suite);
    suite.case(
        "runtime/urgent behind 1024",
        "from the call that sends it until its receiver has it; 1,024 others of 2 us each wait in another port of the task",
        urgent_in_ports,
    );
    suite.case(
        "floor/one FIFO behind 1024",
        "the same through std::sync::mpsc::sync_channel: it comes last",
        |effort| {
            urgent_through(effort, || {
                let (tell, told) = sync_channel::<bool>(usize::from(BEHIND) + 1);
                (move |urgent| tell.send(urgent).expect("it listens"), move || told.recv().ok())
            })
        },
    );
    suite.case(
        "floor/two channels behind 1024",
        "a channel of its own for what is urgent, looked at first: the order is the program's",
        |effort| urgent_through(effort, two_channels),
    );
    let (own, fifo) = ("runtime/urgent behind 1024", "floor/one FIFO behind 1024");
    suite.row(
        Row::new("P7", own, "floor/two channels behind 1024", Stat::P50, Goal::AtMost(4.0)).was("<= 1.2"),
    );
    suite.row(Row::new("P7", own, fifo, Stat::P50, Goal::AtLeast(1_000.0)));
    suite.row(Row::new("P7", own, fifo, Stat::P99, Goal::AtMost(0.02)));
    suite
}

fn two_channels() -> (impl FnMut(bool) + Send, impl FnMut() -> Option<bool>) {
    let capacity = usize::from(BEHIND) + 1;
    let (urgent, first) = sync_channel::<bool>(capacity);
    let (other, second) = sync_channel::<bool>(capacity);
    let send = move |is: bool| if is { &urgent } else { &other }.send(is).expect("it listens");
    let receive = move || match first.try_recv() {
        Ok(urgent) => Some(urgent),
        Err(TryRecvError::Empty | TryRecvError::Disconnected) => second.recv().ok(),
    };
    (send, receive)
}

/// How many urgent messages are sent in a round. With fewer messages, the median would depend on chance.
#[must_use]
pub fn times(effort: Effort) -> u32 {
    effort.of(100).max(9)
}

/// Fills a channel made by `make`, sends the urgent message, and only then lets the receiver begin. Both threads are
/// awake, on two cores.
pub fn urgent_through<S, R>(effort: Effort, make: impl Fn() -> (S, R)) -> Sample
where
    S: FnMut(bool) + Send,
    R: FnMut() -> Option<bool>,
{
    let (mut send, mut receive) = make();
    let gate = Gate::default();
    let times = u64::from(times(effort));
    let begins = Instant::now();
    let sent = AtomicU64::new(0);
    cores::pin(Core::First);
    let nanos = std::thread::scope(|s| {
        let (gate, sent) = (&gate, &sent);
        s.spawn(move || {
            cores::pin(Core::Second);
            for time in 0..times {
                (0..BEHIND).for_each(|_| send(false));
                gate.filled(time);
                sent.store(nanos_of(begins.elapsed()), Ordering::SeqCst);
                send(true);
                gate.sent(time);
            }
        });
        let one = |time: u64| {
            gate.ready(time);
            let mut took = 0;
            for _ in 0..=BEHIND {
                if receive().expect("a message") {
                    took = nanos_of(begins.elapsed()) - sent.load(Ordering::SeqCst);
                } else if took == 0 {
                    serve();
                }
            }
            gate.served(time);
            took
        };
        (0..times).map(one).collect()
    });
    cores::unpin();
    Sample::of(nanos, 1)
}

/// Keeps sender and receiver in step. Both are awake and on their cores when the urgent message is sent, so that
/// neither of them waits for the scheduler.
#[derive(Default)]
struct Gate(AtomicU64);

impl Gate {
    fn reach(&self, step: u64) {
        self.0.store(step, Ordering::SeqCst);
    }

    fn until(&self, step: u64, between: fn()) {
        while self.0.load(Ordering::SeqCst) < step {
            between();
        }
    }

    /// The sender calls this when all other messages are queued. Returns when the receiver is awake.
    fn filled(&self, time: u64) {
        self.reach(4 * time + 1);
        self.until(4 * time + 2, std::hint::spin_loop);
    }

    /// The sender calls this when it has sent the urgent message. Returns when all messages are served.
    fn sent(&self, time: u64) {
        self.reach(4 * time + 3);
        self.until(4 * time + 4, std::thread::yield_now);
    }

    /// The receiver calls this before it begins. Returns when the urgent message is sent.
    fn ready(&self, time: u64) {
        self.until(4 * time + 1, std::thread::yield_now);
        self.reach(4 * time + 2);
        self.until(4 * time + 3, std::hint::spin_loop);
    }

    /// The receiver calls this when all messages are served.
    fn served(&self, time: u64) {
        self.reach(4 * time + 4);
    }
}

fn serve() {
    let begins = Instant::now();
    while begins.elapsed() < SERVICE {
        std::hint::spin_loop();
    }
}

fn urgent_in_ports(effort: Effort) -> Sample {
    let mut cell = cells::cell(2, 1);
    let [work, halt] = [("work", LONG_TICKS, BEHIND), ("halt", Ticks(1_000_000), 1)].map(|(name, ttl, n)| {
        cell.port(PortDecl::new(name, cells::A, Usage::Send, &[cells::B], ttl).bounded_buffer(n))
    });
    let (tell, told) = channel();
    let times = u64::from(times(effort));
    let (begins, sent) = (Instant::now(), Arc::new(AtomicU64::new(0)));
    let gate = Arc::new(Gate::default());
    let (other_gate, other_sent) = (Arc::clone(&gate), Arc::clone(&sent));
    let node = Runtime::builder(cells::table(cell), NodeId(0))
        .task("t0", move |ctx| {
            cores::pin(Core::Second);
            for time in 0..times {
                for _ in 0..BEHIND {
                    let _copies = ctx.send(work, &cells::FULL)?;
                }
                other_gate.filled(time);
                other_sent.store(nanos_of(begins.elapsed()), Ordering::SeqCst);
                let _copies = ctx.send(halt, &cells::FULL)?;
                other_gate.sent(time);
            }
            Ok(())
        })
        .task("t1", move |ctx| {
            cores::pin(Core::First);
            let mut nanos = Vec::new();
            for time in 0..times {
                gate.ready(time);
                let mut took = 0;
                for _ in 0..=BEHIND {
                    let message = ctx.receive(None, None)?.expect("a message");
                    if message.from.port == halt {
                        took = nanos_of(begins.elapsed()) - sent.load(Ordering::SeqCst);
                    } else if took == 0 {
                        serve();
                    }
                }
                nanos.push(took);
                gate.served(time);
            }
            tell.send(Sample::of(nanos, 1)).expect("the harness listens");
            Ok(())
        })
        .start()
        .expect("a node that starts");
    cells::hear(node, &told)
}

/// The suite with many messages of 32 bytes to one receiver.
#[must_use]
pub fn streams() -> Suite {
    let mut suite = Suite::new("streams");
    for senders in [1, 4] {
        let name = |of: &str| format!("{of} {senders}->1");
        suite.case(
            name("runtime/stream"),
            "class-1 messages from tasks on threads to one that takes what is there (receive_many); at most 256 under way of each; nanoseconds per message",
            move |effort| stream_of_ports(effort, senders, MANY),
        );
        suite.case(
            name("runtime/stream one at a time"),
            "the same, each message taken by a receive of its own",
            move |effort| stream_of_ports(effort, senders, 1),
        );
        suite.case(
            name("floor/mutex heap"),
            "what one would write: a Mutex around a BinaryHeap, two Condvars, at most 1,024 waiting",
            move |effort| stream_through(effort, senders, naive_heap),
        );
        suite.case(
            name("floor/std channel"),
            "std::sync::mpsc::sync_channel(1024): no order",
            move |effort| {
                stream_through(effort, senders, || {
                    let (tell, told) = sync_channel::<Message>(1_024);
                    (move |m| tell.send(m).expect("it listens"), move || told.recv().expect("a message"))
                })
            },
        );
        let was = if senders == 1 { ">= 6" } else { ">= 15" };
        let (own, naive) = (name("runtime/stream"), name("floor/mutex heap"));
        suite.row(Row::new("P6", own, &naive, Stat::Mean, Goal::AtLeast(3.0)).was(was));
        let one = name("runtime/stream one at a time");
        suite.row(Row::new("P6", one, &naive, Stat::Mean, Goal::AtLeast(1.0)));
    }
    suite
}

/// A message of 32 bytes, which is the size of a packet.
pub type Message = [u64; 4];

fn naive_heap() -> (impl FnMut(Message) + Clone + Send, impl FnMut() -> Message) {
    struct Shared {
        heap: Mutex<BinaryHeap<Message>>,
        came: Condvar,
        went: Condvar,
    }
    let shared = Arc::new(Shared { heap: Mutex::default(), came: Condvar::new(), went: Condvar::new() });
    let other = Arc::clone(&shared);
    let send = move |message| {
        let mut heap = shared.heap.lock().expect("no panic");
        while heap.len() >= 1_024 {
            heap = shared.went.wait(heap).expect("no panic");
        }
        heap.push(message);
        drop(heap);
        shared.came.notify_one();
    };
    let receive = move || {
        let mut heap = other.heap.lock().expect("no panic");
        loop {
            if let Some(message) = heap.pop() {
                drop(heap);
                other.went.notify_one();
                return message;
            }
            heap = other.came.wait(heap).expect("no panic");
        }
    };
    (send, receive)
}

/// Measures a stream: `senders` threads on one core send to one thread on the other core.
pub fn stream_through<S, R>(effort: Effort, senders: usize, make: impl Fn() -> (S, R)) -> Sample
where
    S: FnMut(Message) + Clone + Send,
    R: FnMut() -> Message,
{
    let (send, mut receive) = make();
    let each = u64::from(effort.of(60_000)) / senders as u64;
    cores::pin(Core::First);
    let elapsed = std::thread::scope(|s| {
        for _ in 0..senders {
            let mut send = send.clone();
            s.spawn(move || {
                cores::pin(Core::Second);
                // Keys in pseudo-random order, the same in every run: later messages are not more urgent.
                (0..each).for_each(|n| send([n.wrapping_mul(0x9E37_79B9_7F4A_7C15), n, 0, 0]));
            });
        }
        let begins = Instant::now();
        for _ in 0..each * senders as u64 {
            std::hint::black_box(receive());
        }
        begins.elapsed()
    });
    cores::unpin();
    Sample::of_all(elapsed, each * senders as u64)
}

/// Measures streams through ports of the runtime. The receiver takes up to `most` messages at once.
fn stream_of_ports(effort: Effort, senders: usize, most: usize) -> Sample {
    let mut cell = cells::cell(senders + 1, 1);
    let receiver = TaskId::from_index(senders);
    let window = u16::try_from(WINDOW).expect("few");
    for sender in 0..senders {
        let decl = PortDecl::new(
            &format!("p{sender}"),
            TaskId::from_index(sender),
            Usage::Send,
            &[receiver],
            LONG_TICKS,
        );
        cell.port(decl.bounded_buffer(window));
    }
    let each = u64::from(effort.of(60_000)) / senders as u64;
    let taken: Arc<[AtomicU64]> = (0..senders).map(|_| AtomicU64::new(0)).collect();
    let goes = Arc::new(AtomicBool::new(false));
    let mut builder = Runtime::builder(cells::table(cell), NodeId(0));
    for sender in 0..senders {
        let (taken, goes) = (Arc::clone(&taken), Arc::clone(&goes));
        builder = builder.task(&format!("t{sender}"), move |ctx| {
            cores::pin(Core::Second);
            while !goes.load(Ordering::Acquire) {
                std::thread::yield_now();
            }
            let port = PortId::from_index(sender);
            for n in 0..each {
                // A full class-1 port drops messages, so the sender waits while `WINDOW` of its messages have not been
                // taken yet.
                while n - taken[sender].load(Ordering::Acquire) >= WINDOW {
                    std::thread::yield_now();
                }
                let ttl = Duration::from_secs(30 + (n.wrapping_mul(0x9E37_79B9) & 15));
                let _copies = ctx.send_with(port, imrs_protocol::Target::All, &cells::FULL, Some(ttl))?;
            }
            Ok(())
        });
    }
    let (tell, told) = channel();
    let node = builder
        .task(&format!("t{senders}"), move |ctx| {
            cores::pin(Core::First);
            goes.store(true, Ordering::Release);
            let begins = Instant::now();
            let mut messages = Vec::with_capacity(most);
            let mut left = each * senders as u64;
            while left > 0 {
                if most == 1 {
                    messages.extend(ctx.receive(None, None)?);
                } else {
                    let _count = ctx.receive_many(None, &mut messages, most, None)?;
                }
                left -= messages.len() as u64;
                for message in messages.drain(..) {
                    taken[message.from.port.index()].fetch_add(1, Ordering::Release);
                }
            }
            let sample = Sample::of_all(begins.elapsed(), each * senders as u64);
            tell.send(sample).expect("the harness listens");
            Ok(())
        })
        .start()
        .expect("a node that starts");
    cells::hear(node, &told)
}
