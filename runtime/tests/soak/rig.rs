//! Three nodes over loopback UDP whose tasks use every primitive, at full speed or at a fixed pace.

use crate::common::kept::Kept;
use crate::common::udp::{builders, links};
use crate::common::{A, B, C, LONG, cell, finish, table};
use imrs_protocol::{
    Answers, CellTable, Class, Incarnation, NodeId, NodeTable, Outcome, PortDecl, PortId, Round, TaskId,
    Ticks, Usage,
};
use imrs_runtime::link::faulty::FaultyLink;
use imrs_runtime::link::udp::{UdpCount, UdpLink};
use imrs_runtime::record::{About, FileRecorder};
use imrs_runtime::{Builder, Context, Rendezvous, Runtime, Sent, TaskError};
use imrs_wire::obs::Snapshot;
use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Tasks `d`, `e` and `f` serve on the nodes of `a`, `b` and `c`.
const SERVANTS: [TaskId; 3] = [TaskId(3), TaskId(4), TaskId(5)];
/// Each of the three nodes has a thread for each of two tasks, the receiving thread, and the Timer thread.
pub const THREADS: usize = 3 * 4;
/// How many cycles a driver makes between two meetings.
const MEET_EVERY: u32 = 8;
/// How many cycles a driver makes at least, however long the machine takes.
const LEAST: u32 = 25 * MEET_EVERY;

/// The cell: each driver sends commands to the servant of the next node and statuses to both other drivers. `a` asks
/// two tasks at once, `b` asks a task that never answers, `c` sends messages that expire unread, and all three drivers
/// meet.
fn soaked() -> Arc<CellTable> {
    let [d, e, f] = SERVANTS;
    let mut cell = cell(&[0, 1, 2, 0, 1, 2], Ticks(1_000));
    for (name, from, to) in [("do-a", A, e), ("do-b", B, f), ("do-c", C, d)] {
        let decl = PortDecl::new(name, from, Usage::Send, &[to], Ticks(2_000_000)).command();
        cell.port(decl.retry(1, Ticks(500_000)));
    }
    cell.port(PortDecl::new("state", A, Usage::Query, &[e, f], Ticks(2_000_000)).command());
    for (name, from, to) in [("news-a", A, [e, f]), ("news-b", B, [d, f]), ("news-c", C, [d, e])] {
        cell.port(PortDecl::new(name, from, Usage::Send, &to, Ticks(50_000)).bounded_buffer(8));
    }
    cell.port(PortDecl::new("unheard", B, Usage::Send, &[A], Ticks(8_000)).command());
    cell.port(PortDecl::new("old", C, Usage::Send, &[A], Ticks(5_000)).bounded_buffer(4));
    cell.port(PortDecl::new("meet", A, Usage::Waitfor, &[B, C], Ticks(2_000_000)).resend(Ticks(50_000), 1));
    table(cell)
}

/// How the class-2 requests of a port ended.
#[derive(Clone, Debug, Default)]
pub struct Asked {
    pub requests: u64,
    /// The number of outcomes: one for each asked task.
    pub outcomes: u64,
    pub expected: u64,
    pub replies: u64,
    pub refused: u64,
    pub unsent: u64,
    pub unknown: u64,
    pub restarted: u64,
    /// How long after its time_out the latest outcome came.
    pub latest: Duration,
}

/// What a driver has done in a run.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    pub cycles: u64,
    pub copies: u64,
    pub released: u64,
    pub gave_up: u64,
    /// How long the driver ran.
    pub took: Duration,
    pub asked: BTreeMap<PortId, Asked>,
}

impl Asked {
    fn outcome(&mut self, outcome: &Outcome, expected: &[u8]) {
        self.outcomes += 1;
        match outcome {
            Outcome::Reply(answer) => {
                assert_eq!(answer.as_bytes(), expected, "the answer to another request");
                self.replies += 1;
            }
            Outcome::Refused => self.refused += 1,
            Outcome::TimedOutUnsent => self.unsent += 1,
            Outcome::TimedOutUnknown => self.unknown += 1,
            Outcome::PeerRestarted => self.restarted += 1,
        }
    }

    fn several(&mut self, Answers { asked, answered, refused, restarted, unsent }: Answers) {
        let count = |bits: u64| u64::from(bits.count_ones());
        assert_eq!((answered | refused | restarted | unsent) & !asked, 0, "an outcome of somebody not asked");
        let (some, unknown) = (
            count(answered | refused | restarted | unsent),
            count(asked & !answered & !refused & !restarted & !unsent),
        );
        assert_eq!(count(answered) + count(refused) + count(restarted) + count(unsent), some, "two outcomes");
        self.outcomes += some + unknown;
        self.replies += count(answered);
        self.refused += count(refused);
        self.restarted += count(restarted);
        self.unsent += count(unsent);
        self.unknown += unknown;
    }
}

/// Which drivers wait in a meeting, and how the last meetings ended.
#[derive(Default)]
struct Meetings {
    /// For each driver: the last round that it left, with the bit [`WAITS`] set while it waits.
    at: [AtomicU32; 3],
    /// For each of the last rounds: how many tasks were released, and how many gave up.
    ends: Mutex<VecDeque<(Round, u8, u8)>>,
    diverged: AtomicU32,
    over: AtomicBool,
}

const WAITS: u32 = 1 << 16;

impl Meetings {
    fn begins(&self, driver: TaskId) {
        self.at[driver.index()].fetch_or(WAITS, Ordering::SeqCst);
    }

    /// Notes how a driver's meeting ended, and checks a release: all drivers must have arrived in its round. So each
    /// other driver must still wait, or must have left this round or a later one.
    fn ended(&self, driver: TaskId, end: Rendezvous) {
        let (Rendezvous::Released { round, .. } | Rendezvous::GaveUp { round, .. }) = end;
        let released = matches!(end, Rendezvous::Released { .. });
        for (other, at) in
            self.at.iter().enumerate().filter(|(other, _)| released && *other != driver.index())
        {
            let at = at.load(Ordering::SeqCst);
            let behind = round.0.wrapping_sub((at & 0xffff) as u16);
            let was_there = at & WAITS != 0 || behind == 0 || behind > u16::MAX / 2;
            assert!(was_there, "{driver} was released in {round:?}, {other} had not arrived");
        }
        self.at[driver.index()].store(u32::from(round.0), Ordering::SeqCst);
        let mut ends = self.ends.lock().unwrap();
        let known = ends.iter().position(|(of, ..)| *of == round);
        let known = known.unwrap_or_else(|| {
            ends.push_back((round, 0, 0));
            ends.len() - 1
        });
        ends[known].1 += u8::from(released);
        ends[known].2 += u8::from(!released);
        if ends.len() > 64 {
            self.judge(ends.pop_front());
        }
    }

    fn judge(&self, end: Option<(Round, u8, u8)>) {
        if let Some((_, 1.., 1..)) = end {
            self.diverged.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// The state that all programs share.
struct Shared {
    table: Arc<CellTable>,
    period: Option<Duration>,
    /// Set once the drivers' next meeting is their last.
    enough: AtomicBool,
    meetings: Meetings,
    tallies: Mutex<Vec<Tally>>,
    stop: AtomicBool,
}

/// The program of a driver. Its ports determine what it does in a cycle.
fn drive(ctx: &mut Context, shared: &Shared) -> Result<(), TaskError> {
    let (own, letter) = (ctx.id(), ctx.name().to_owned());
    let [command, news, meet] =
        [format!("do-{letter}"), format!("news-{letter}"), "meet".into()].map(|name| ctx.port(&name));
    let (command, news, meet) = (command?, news?, meet?);
    let [state, unheard, old] = [(A, "state"), (B, "unheard"), (C, "old")]
        .map(|(owner, name)| (owner == own).then(|| ctx.port(name)).transpose());
    let (state, unheard, old) = (state?, unheard?, old?);
    let mut tally = Tally::default();
    let begin = Instant::now();
    let mut next = begin;
    for cycle in 0_u32.. {
        tally.copies += ctx.together(|ctx| {
            let mut copies = tell(ctx, news, cycle)? + tell(ctx, news, cycle)?;
            if let Some(old) = old {
                copies += tell(ctx, old, cycle)?;
            }
            Ok::<_, TaskError>(copies)
        })?;
        ask(ctx, shared, command, cycle, &mut tally)?;
        if let Some(state) = state.filter(|_| cycle % 4 == 0) {
            ask(ctx, shared, state, cycle, &mut tally)?;
        }
        if let Some(unheard) = unheard.filter(|_| cycle % 256 == 0) {
            ask(ctx, shared, unheard, cycle, &mut tally)?;
        }
        tally.cycles += 1;
        if cycle % MEET_EVERY == 0 {
            if own == A && cycle >= LEAST && shared.enough.load(Ordering::SeqCst) {
                shared.meetings.over.store(true, Ordering::SeqCst);
            }
            shared.meetings.begins(own);
            let end = ctx.waitfor(meet)?;
            shared.meetings.ended(own, end);
            match end {
                Rendezvous::Released { .. } => tally.released += 1,
                Rendezvous::GaveUp { .. } => tally.gave_up += 1,
            }
            if shared.meetings.over.load(Ordering::SeqCst) {
                break;
            }
        }
        if let Some(period) = shared.period {
            // If the machine stood still, the missed cycles are left out.
            next = (next + period).max(Instant::now() - Duration::from_secs(1));
            ctx.delay(next.saturating_duration_since(Instant::now()))?;
        }
    }
    tally.took = begin.elapsed();
    shared.tallies.lock().unwrap().push(tally);
    Ok(())
}

fn tell(ctx: &mut Context, port: PortId, cycle: u32) -> Result<u64, TaskError> {
    match ctx.send(port, &cycle.to_le_bytes())? {
        Sent::Copies(copies) => Ok(u64::from(copies)),
        other => panic!("news ended with {other:?}"),
    }
}

fn ask(
    ctx: &mut Context,
    shared: &Shared,
    port: PortId,
    cycle: u32,
    tally: &mut Tally,
) -> Result<(), TaskError> {
    let begin = Instant::now();
    let sent = ctx.send(port, &cycle.to_le_bytes())?;
    let took = begin.elapsed();
    let decl = &shared.table.cell().ports[port.index()];
    let asked = tally.asked.entry(port).or_default();
    asked.requests += 1;
    asked.expected += decl.users.len() as u64;
    asked.latest = asked.latest.max(took.saturating_sub(Duration::from_micros(decl.time_out.0)));
    match sent {
        Sent::Outcome(outcome) => asked.outcome(&outcome, &cycle.to_le_bytes()),
        Sent::Several(answers) => asked.several(answers),
        Sent::Copies(_) => panic!("a command without an outcome"),
    }
    Ok(())
}

/// The program of a servant: it answers every request, and checks every other message. No command may run twice.
fn serve(ctx: &mut Context, shared: &Shared) -> Result<(), TaskError> {
    let mut last: Option<u32> = None;
    while !shared.stop.load(Ordering::Relaxed) {
        let Some(message) = ctx.receive(None, Some(Duration::from_millis(100)))? else { continue };
        let port = &shared.table.cell().ports[message.from.port.index()];
        assert!(message.budget <= port.time_out, "{} has grown older than {:?}", port.name, message.budget);
        if message.class == Class::Status {
            continue;
        }
        let bytes = message.contents.as_bytes();
        let cycle = u32::from_le_bytes(bytes.try_into().expect("a cycle"));
        if port.usage == Usage::Send {
            assert!(last.is_none_or(|last| last < cycle), "command {cycle} ran again, or after {last:?}");
            last = Some(cycle);
            if cycle % 512 == 511 {
                ctx.delay(Duration::from_millis(1))?;
            }
        }
        // If the machine stood still, the sender may no longer wait.
        let _late = ctx.reply(&message.from, bytes);
    }
    Ok(())
}

/// The results of a run.
pub struct Ran {
    pub table: Arc<CellTable>,
    pub tallies: Vec<Tally>,
    /// Meetings in which some members were released and others gave up (D2).
    pub diverged: u32,
    /// The nodes' snapshots after their programs had ended.
    pub snapshots: Vec<Snapshot>,
    pub links: Vec<Arc<FaultyLink<UdpLink>>>,
    /// The recording of each node.
    pub recordings: Vec<(NodeTable, Vec<u8>)>,
}

/// How the nodes are to run.
#[derive(Clone, Copy, Default)]
pub struct Plan {
    pub length: Duration,
    /// The period of a driver's cycles; `None` for full speed.
    pub period: Option<Duration>,
    pub recorded: bool,
}

/// Runs the three nodes, and calls `look` repeatedly meanwhile. The drivers end once `plan.length` has passed and `look` has
/// returned true.
pub fn run(plan: Plan, mut look: impl FnMut() -> bool) -> Ran {
    let since = Instant::now();
    let table = soaked();
    let shared = Arc::new(Shared {
        table: Arc::clone(&table),
        period: plan.period,
        enough: AtomicBool::new(false),
        meetings: Meetings::default(),
        tallies: Mutex::default(),
        stop: AtomicBool::new(false),
    });
    let links = links(&table, 0.0);
    let builders = builders(&table, &links).into_iter().zip(["a", "b", "c"]).zip(["d", "e", "f"]);
    let mut recorders = Vec::new();
    let mut begin = |(node, ((builder, driver), servant)): (_, ((Builder, _), _))| {
        let [drives, serves] = [(); 2].map(|()| Arc::clone(&shared));
        let mut builder = builder
            .task(driver, move |ctx| drive(ctx, &drives))
            .task(servant, move |ctx| serve(ctx, &serves));
        if plan.recorded {
            let here = NodeTable::new(Arc::clone(&table), NodeId::from_index(node));
            let (recorder, kept) = recorder(&here);
            builder = builder.recorder(Arc::clone(&recorder) as _);
            recorders.push((here, recorder, kept));
        }
        builder.start().expect("a node that starts")
    };
    let nodes: Vec<Runtime> = (0..).zip(builders).map(&mut begin).collect();
    while shared.tallies.lock().unwrap().len() < nodes.len() {
        assert!(since.elapsed() < plan.length + 10 * LONG, "a driver does not end");
        if look() && since.elapsed() > plan.length {
            shared.enough.store(true, Ordering::SeqCst);
        }
    }
    // In this time packets in flight arrive, and expiring messages expire.
    std::thread::sleep(Duration::from_millis(200));
    shared.stop.store(true, Ordering::Relaxed);
    let snapshots = nodes.iter().map(|node| node.node().snapshot(0)).collect();
    nodes.into_iter().for_each(finish);
    let recordings = recorders.into_iter().map(|(here, recorder, kept)| (here, recorded(&recorder, &kept)));
    let recordings = recordings.collect();
    let meetings = &shared.meetings;
    meetings.ends.lock().unwrap().drain(..).for_each(|end| meetings.judge(Some(end)));
    let tallies = std::mem::take(&mut *shared.tallies.lock().unwrap());
    let diverged = meetings.diverged.load(Ordering::Relaxed);
    Ran { table, tallies, diverged, snapshots, links, recordings }
}

impl Ran {
    pub fn udp(&self, count: UdpCount) -> u64 {
        self.links.iter().map(|link| link.inner().count(count)).sum()
    }
}

fn recorder(here: &NodeTable) -> (Arc<FileRecorder>, Kept) {
    let kept = Kept::default();
    let about =
        About { incarnation: (Incarnation(1), false), insecure: true, build: "the soak", statements: 0 };
    let failed = |error: &_| panic!("memory takes everything: {error}");
    (FileRecorder::start(kept.clone(), here, &about, failed).expect("a recording"), kept)
}

fn recorded(recorder: &FileRecorder, kept: &Kept) -> Vec<u8> {
    let status = recorder.stop(LONG).expect("it was not stopped before");
    assert!(status.ended, "{status:?}");
    std::mem::take(&mut *kept.0.lock().unwrap())
}
