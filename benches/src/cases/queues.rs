//! Measures the deadline queue and the timers by themselves (goals P8, P13), and the lateness of time_outs (goal P14).

use super::cells;
use super::floors::GROUP;
use super::heaps::Heaps;
use crate::cores;
use crate::sample::{Sample, each, nanos_of};
use crate::suite::{Effort, Goal, Row, Stat, Suite};
use imrs_protocol::queue::{Entry, Key, Queue};
use imrs_protocol::{NodeId, TaskId, Ticks, TimeId, Timer};
use imrs_runtime::Runtime;
use rustix::time::{ClockId, Timespec, clock_gettime};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

/// The greatest capacity of a queue.
const MOST: u16 = 65_000;
const SIZES: [(u16, &str); 3] = [(16, "16"), (1_000, "1k"), (MOST, "65k")];

/// An entry with a deadline and the size of a packet.
pub struct Waiting {
    /// Entries are ordered by their deadlines.
    pub deadline: u64,
    /// Of two entries with equal deadlines, the one with the lesser number is first.
    pub number: u64,
    /// The remaining data, so that the entry has the size of a packet.
    pub packet: [u64; 4],
}

impl Entry for Waiting {
    type Side = ();
    fn key(&self) -> Key {
        (imrs_protocol::Instant(self.deadline), self.number)
    }
    fn due(&self, (): &()) -> imrs_protocol::Instant {
        imrs_protocol::Instant(self.deadline)
    }
    fn yields(&self) -> bool {
        false
    }
}

/// The suite of the deadline queue.
#[must_use]
pub fn queues() -> Suite {
    let mut suite = Suite::new("queues");
    for (size, name) in SIZES {
        let named = |of: &str| format!("{of} {name}");
        suite.case(
            named("machine/queue"),
            "pop the most urgent and push another of 48 bytes: a port's buffer without a handler, where what expires next is the most urgent and who makes room is looked for when it is full",
            move |effort| held(effort, Queue::new(size + 1)),
        );
        suite.case(
            named("machine/watched queue"),
            "the same in two orders, urgency and what is due next: the transit buffer, and a port with a handler",
            move |effort| held(effort, Queue::watched(size + 1)),
        );
        suite.case(
            named("floor/BinaryHeap"),
            "the same with std's heap: it has keys and places, the entries of 48 bytes stand beside it, any of them can be taken from its place, and a key without entry is skipped",
            move |effort| heap(effort, size, false),
        );
        suite.case(
            named("floor/two BinaryHeaps"),
            "the same with a second such heap, in the order of what is due next",
            move |effort| heap(effort, size, true),
        );
        let was = if size == MOST { "<= 0.6" } else { "<= 0.85" };
        for (own, floor) in [("queue", "BinaryHeap"), ("watched queue", "two BinaryHeaps")] {
            let (own, floor) = (named(&format!("machine/{own}")), named(&format!("floor/{floor}")));
            suite.row(Row::new("P8", own, &floor, Stat::P50, Goal::AtMost(1.0)).was(was));
        }
    }
    suite.row(Row::new("growth", "machine/queue 1k", "machine/queue 16", Stat::P50, Goal::AtMost(2.0)));
    suite.row(Row::new("growth", "machine/queue 65k", "machine/queue 16", Stat::P50, Goal::AtMost(4.0)));
    suite
}

/// Draws deadlines at a bounded distance after the given one, in pseudo-random order, the same in every run.
fn deadlines() -> impl FnMut(u64) -> u64 {
    let mut state = 0x2545_F491_4F6C_DD1D_u64;
    move |now| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        now + (state & 0xF_FFFF)
    }
}

/// Measures a queue that has room for one more entry than it contains.
fn held(effort: Effort, mut queue: Queue<Waiting>) -> Sample {
    let mut next = deadlines();
    let mut number = 0;
    let mut push = |queue: &mut Queue<Waiting>, now| {
        number += 1;
        let waiting = Waiting { deadline: next(now), number, packet: [number; 4] };
        assert!(queue.push(waiting).is_ok(), "room");
    };
    (1..queue.capacity()).for_each(|_| push(&mut queue, 0));
    each(effort.of(100_000), GROUP, || {
        let first = queue.pop_if(|_| true).expect("not empty");
        push(&mut queue, first.deadline);
    })
}

fn heap(effort: Effort, size: u16, two: bool) -> Sample {
    let mut next = deadlines();
    let mut number = 0;
    let mut push = |heaps: &mut Heaps, now| {
        number += 1;
        let waiting = Waiting { deadline: next(now), number, packet: [number; 4] };
        assert!(heaps.push(waiting).is_some(), "room");
    };
    let mut heaps = Heaps::new(size + 1, two);
    (0..size).for_each(|_| push(&mut heaps, 0));
    each(effort.of(100_000), GROUP, || {
        let first = heaps.pop().expect("not empty");
        push(&mut heaps, first.deadline);
    })
}

/// The suite of timers and time_outs.
#[must_use]
pub fn timers() -> Suite {
    let mut suite = Suite::new("timers");
    for (size, name) in [(1_000, "1k"), (10_000, "10k"), (MOST, "65k")] {
        suite.case(
            format!("machine/timer {name}"),
            "arm and disarm one among so many of the Timer's",
            move |effort| arm_and_disarm(effort, size),
        );
        suite.case(
            format!("floor/wheel {name}"),
            "arm and cancel in a hashed wheel of doubly linked entries",
            move |effort| wheel(effort, size),
        );
        let floor = format!("floor/wheel {name}");
        suite.row(Row::new("P13", format!("machine/timer {name}"), &floor, Stat::P50, Goal::AtMost(4.0)));
    }
    suite.case(
        "machine/timer 1k, 64 under way",
        "arm one among so many and disarm another, of 64 that are taken back in turn",
        |effort| in_turn(effort, 1_000),
    );
    suite.row(Row::new("growth", "machine/timer 65k", "machine/timer 1k", Stat::P50, Goal::AtMost(1.3)));
    suite.case(
        "floor/clock_nanosleep",
        "lateness of an absolute clock_nanosleep, timer slack 1 ns",
        lateness_of_the_kernel,
    );
    suite.case(
        "runtime/delay",
        "lateness of a task's delay, from the call; counts those that ended early",
        lateness_of_a_delay,
    );
    suite.case(
        "runtime/time_out",
        "lateness of the time_out of a receive, from the call; counts those that ended early",
        lateness_of_a_receive,
    );
    suite.case(
        "runtime/delay, spin tail",
        "the same on a node with a spin tail of 200 us in place of the default 8",
        lateness_with_a_tail,
    );
    let tail = "runtime/delay, spin tail";
    let what = format!("{tail}: nanoseconds late");
    suite.row(Row::bounded("P14", &what, tail, Stat::P50, Goal::AtMost(1_000.0)));
    let what = format!("{tail}: how many ended early");
    suite.row(Row::bounded("P14", &what, tail, Stat::Count, Goal::AtMost(0.0)));
    for own in ["runtime/delay", "runtime/time_out"] {
        suite.row(Row::new("P14", own, "floor/clock_nanosleep", Stat::P50, Goal::AtMost(1.1)));
        let what = format!("{own}: how many ended early");
        suite.row(Row::bounded("P14", &what, own, Stat::Count, Goal::AtMost(0.0)));
    }
    suite
}

fn arm_and_disarm(effort: Effort, size: u16) -> Sample {
    let mut next = deadlines();
    let mut timer = Timer::new(size + 1);
    for owner in 0..size {
        assert!(timer.arm(TaskId(owner), TimeId(0), 0, Ticks(next(1))), "room");
    }
    each(effort.of(100_000), GROUP, || {
        assert!(timer.arm(TaskId(u16::MAX), TimeId(1), 0, Ticks(next(1))), "room");
        assert!(timer.disarm(TaskId(u16::MAX), TimeId(1)), "it is there");
    })
}

fn in_turn(effort: Effort, size: u16) -> Sample {
    const UNDER_WAY: u16 = 64;
    let mut next = deadlines();
    let mut timer = Timer::new(size + UNDER_WAY);
    for owner in 0..size + UNDER_WAY {
        assert!(timer.arm(TaskId(owner), TimeId(0), 0, Ticks(next(1))), "room");
    }
    let mut turn = 0;
    each(effort.of(100_000), GROUP, || {
        turn = (turn + 1) % UNDER_WAY;
        assert!(timer.disarm(TaskId(size + turn), TimeId(0)), "it is there");
        assert!(timer.arm(TaskId(size + turn), TimeId(0), 0, Ticks(next(1))), "room");
    })
}

/// The baseline: a hashed timer wheel. Its entries are in a slab; the entries of one time slot are doubly linked.
struct Wheel {
    links: Vec<[u32; 2]>,
    slots: u32,
}

impl Wheel {
    fn new(entries: u32, slots: u32) -> Self {
        // The list head of each slot of the wheel comes after the entries, and is linked to itself at first.
        let links = (0..entries + slots).map(|at| [at, at]).collect();
        Self { links, slots }
    }

    fn arm(&mut self, entry: u32, at: u64) {
        #[expect(clippy::cast_possible_truncation, reason = "a remainder of a u32")]
        let slot = (at % u64::from(self.slots)) as u32;
        let head = self.links.len() as u32 - self.slots + slot;
        let first = self.links[head as usize][1];
        self.links[entry as usize] = [head, first];
        self.links[first as usize][0] = entry;
        self.links[head as usize][1] = entry;
    }

    fn cancel(&mut self, entry: u32) {
        let [before, after] = self.links[entry as usize];
        self.links[before as usize][1] = after;
        self.links[after as usize][0] = before;
    }
}

fn wheel(effort: Effort, size: u16) -> Sample {
    let (mut next, size) = (deadlines(), u32::from(size));
    let mut wheel = Wheel::new(size + 1, 4_096);
    for entry in 0..size {
        wheel.arm(entry, next(1));
    }
    each(effort.of(100_000), GROUP, || {
        wheel.arm(size, next(1));
        wheel.cancel(std::hint::black_box(size));
    })
}

/// Draws pseudo-random lengths of 1 to 2 ms.
fn lengths() -> impl FnMut() -> Duration {
    let mut next = deadlines();
    move || Duration::from_micros(1_000 + next(0) % 1_000)
}

fn lateness(times: u32, mut sleep: impl FnMut(Duration)) -> Sample {
    let mut length = lengths();
    let (mut nanos, mut early) = (Vec::new(), 0);
    for _ in 0..times {
        let length = length();
        let begins = Instant::now();
        sleep(length);
        match begins.elapsed().checked_sub(length) {
            Some(late) => nanos.push(nanos_of(late)),
            None => early += 1,
        }
    }
    Sample::of(nanos, 1).with(f64::from(early))
}

fn lateness_of_the_kernel(effort: Effort) -> Sample {
    let times = effort.of(150);
    // The case runs on a thread of its own, so that the next case does not inherit its timer slack.
    let thread = std::thread::spawn(move || {
        cores::sleep_exactly();
        lateness(times, |length| {
            let now = clock_gettime(ClockId::Monotonic);
            let nanos = now.tv_nsec + i64::try_from(length.as_nanos()).unwrap_or(i64::MAX);
            let until =
                Timespec { tv_sec: now.tv_sec + nanos / 1_000_000_000, tv_nsec: nanos % 1_000_000_000 };
            while rustix::thread::clock_nanosleep_absolute(ClockId::Monotonic, &until).is_err() {}
        })
    });
    thread.join().expect("no panic")
}

fn lateness_with_a_tail(effort: Effort) -> Sample {
    let tail = Duration::from_micros(200);
    late_task(effort, Some(tail), |ctx, length| ctx.delay(length).expect("the node runs"))
}

fn lateness_of_a_delay(effort: Effort) -> Sample {
    late_task(effort, None, |ctx, length| ctx.delay(length).expect("the node runs"))
}

fn lateness_of_a_receive(effort: Effort) -> Sample {
    late_task(effort, None, |ctx, length| {
        let nothing = ctx.receive(None, Some(length)).expect("the node runs");
        assert_eq!(nothing, None);
    })
}

fn late_task(
    effort: Effort,
    tail: Option<Duration>,
    sleep: fn(&mut imrs_runtime::Context, Duration),
) -> Sample {
    let times = effort.of(150);
    let (tell, told) = channel();
    let node = Runtime::builder(cells::table(cells::cell(1, 1)), NodeId(0));
    let node = if let Some(tail) = tail { node.spin_tail(tail) } else { node };
    let node = node
        .task("t0", move |ctx| {
            tell.send(lateness(times, |length| sleep(ctx, length))).expect("the harness listens");
            Ok(())
        })
        .start()
        .expect("a node that starts");
    cells::hear(node, &told)
}
