//! Recorded tasks take fused steps, and a replay takes the small steps that these replace. Both must have equal
//! outputs and equal states, in random cells (D207).

use crate::common::{LONG, cell, one_node, table};
use imrs_protocol::script::{Binary, End, Op, Program, ProgramBuilder, Slot, Trigger, Type};
use imrs_protocol::{
    CellTable, Class, CommTask, Incarnation, Input, NodeId, NodeTable, PortDecl, PortId, Request, Target,
    TaskId, Ticks, Usage,
};
use imrs_runtime::record::{Log, OutputDigest, Recorded, Recorder, Replay, ScriptStep, Step, Verdict};
use imrs_runtime::{AsyncContext, Builder, TaskEnd, TaskError};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// The most random cells that a test runs. The test ends earlier if each kind of step was compared often enough.
const CELLS: u64 = 1_000;
const ROUNDS: u16 = 40;
const NAMES: [&str; 4] = ["a", "b", "c", "d"];
/// After how many steps a log wants the state of its task, on average.
const STATES: u8 = 16;
/// How often each kind of fused step must have been recorded.
const LEAST: usize = 1_000;

/// An entry of a task's log.
enum Entry {
    /// A step, and whether it was part of a fused step.
    Step(Recorded, bool),
    Script(ScriptStep, OutputDigest),
    Keyframe(Vec<u8>, OutputDigest),
}

/// A recorder that keeps everything, and at times wants the state of a task.
struct Tape {
    seed: u64,
    of: Mutex<BTreeMap<TaskId, Vec<Entry>>>,
}

struct TapeOf {
    tape: Arc<Tape>,
    task: TaskId,
    draws: fastrand::Rng,
}

impl Recorder for Tape {
    fn log(self: Arc<Self>, task: TaskId) -> Option<Box<dyn Log>> {
        let mut draws = fastrand::Rng::with_seed(self.seed ^ u64::from(task.0));
        // Some tasks are not recorded, so that fused steps of recorded and other tasks occur.
        if draws.u8(..16) == 0 {
            return None;
        }
        Some(Box::new(TapeOf { tape: self, task, draws }))
    }
}

impl TapeOf {
    fn keep(&self, entry: Entry) {
        self.tape.of.lock().unwrap().entry(self.task).or_default().push(entry);
    }

    fn keep_step(&mut self, step: Step, digest: OutputDigest, is_part: bool) -> bool {
        self.keep(Entry::Step(Recorded { step, digest }, is_part));
        self.draws.u8(..STATES) == 0
    }
}

impl Log for TapeOf {
    fn step(&mut self, &step: &Step, digest: OutputDigest) -> bool {
        self.keep_step(step, digest, false)
    }

    fn part(&mut self, &step: &Step, digest: OutputDigest) -> bool {
        self.keep_step(step, digest, true)
    }

    fn script(&mut self, step: ScriptStep, done: OutputDigest) {
        self.keep(Entry::Script(step, done));
    }

    fn keyframe(&mut self, machine: &CommTask, digest: OutputDigest) {
        self.keep(Entry::Keyframe(postcard::to_allocvec(machine).expect("a machine"), digest));
    }
}

/// An act that a task repeats.
#[derive(Clone, Copy, Debug)]
enum Act {
    Send {
        port: PortId,
        to: Target,
        time_out: Option<Ticks>,
    },
    /// Receives a number of messages, and answers each of them.
    Serve {
        port: Option<PortId>,
        time_out: Ticks,
        times: u8,
    },
    Receive {
        port: Option<PortId>,
        time_out: Ticks,
    },
    Meet {
        port: PortId,
        time_out: Option<Ticks>,
    },
    Delay(Ticks),
}

/// A random cell of one node, and the acts of its tasks.
struct Plan {
    table: Arc<CellTable>,
    acts: Vec<Vec<Act>>,
    /// For each task, the port whose messages a handler of its script answers; `None` without a handler.
    handled: Vec<Option<PortId>>,
}

impl Plan {
    fn new(draws: &mut fastrand::Rng) -> Self {
        let tasks = draws.u16(2..=4);
        let mut cell = cell(&vec![0; usize::from(tasks)], Ticks(0));
        for number in 0..draws.u16(2..6) {
            let owner = draws.u16(..tasks);
            let others: Vec<TaskId> = (0..tasks).filter(|&task| task != owner).map(TaskId).collect();
            let one = [others[draws.usize(..others.len())]];
            let users = if draws.bool() { &others[..] } else { &one };
            let port =
                |usage| PortDecl::new(&format!("p{number}"), TaskId(owner), usage, users, Ticks(1_500));
            let usages = [Usage::Send, Usage::Receive, Usage::Query, Usage::Response];
            let port = match draws.u8(..10) {
                0..2 => port(Usage::Waitfor),
                2..5 => port(usages[draws.usize(..2)]),
                _ => port(usages[draws.usize(..4)]).command().retry(draws.u8(..2), Ticks(700)),
            };
            cell.port(port.bounded_buffer(draws.u16(1..4)));
        }
        let table = table(cell);
        let tasks = (0..tasks).map(TaskId);
        let acts = tasks.clone().map(|task| acts_of(&table, task, draws)).collect();
        let handled = tasks.map(|task| ports(&table, task, Way::In).pop().filter(|_| draws.u8(..4) == 0));
        let handled = handled.collect();
        Self { table, acts, handled }
    }

    fn script(&self, task: usize) -> Arc<Program> {
        let mut b = ProgramBuilder::new(NAMES[task]);
        let n = b.variable("n", Type::Int32);
        let (top, over) = (b.label(), b.label());
        b.put(top);
        self.acts[task].iter().for_each(|&act| add(&mut b, act, n));
        b.statement().load(n).push(1).int(Binary::Add).store(n);
        b.statement().load(n).push(ROUNDS.into()).int(Binary::Less).unless(over).jump(top);
        b.put(over);
        b.end();
        if let Some(port) = self.handled[task] {
            b.handler(Trigger::Message(port), |b| reply(b, n));
        }
        Arc::new(b.finish().expect("a sound program"))
    }
}

/// Whether a port brings messages to a task, or takes messages from it.
#[derive(Clone, Copy, PartialEq)]
enum Way {
    In,
    Out,
    Both,
}

fn ports(table: &CellTable, task: TaskId, way: Way) -> Vec<PortId> {
    let fits = |id: &&PortId| {
        let usage = table.port(**id).and_then(|port| port.party(task)).map(|party| party.usage);
        way == match usage {
            Some(Usage::Send | Usage::Query) => Way::Out,
            Some(Usage::Receive | Usage::Response) => Way::In,
            _ => Way::Both,
        }
    };
    table.ports_of(task).iter().filter(fits).copied().collect()
}

fn acts_of(table: &CellTable, task: TaskId, draws: &mut fastrand::Rng) -> Vec<Act> {
    let [coming, going, meeting] = [Way::In, Way::Out, Way::Both].map(|way| ports(table, task, way));
    let mut acts = Vec::new();
    for _ in 0..draws.u8(2..6) {
        let time_out = Ticks(draws.u64(..400));
        let some = (draws.u8(..4) == 0).then_some(time_out + Ticks(1));
        let port = draws.choice(&coming).copied().filter(|_| draws.u8(..4) > 0);
        acts.push(match draws.u8(..12) {
            0..2 if !meeting.is_empty() => {
                Act::Meet { port: meeting[draws.usize(..meeting.len())], time_out: some }
            }
            0..5 if !going.is_empty() => {
                let port = going[draws.usize(..going.len())];
                let peers: Vec<TaskId> = table.port(port).expect("a port").peers(task).collect();
                let one = Target::One(peers[draws.usize(..peers.len())]);
                Act::Send { port, to: if draws.u8(..8) == 0 { Target::All } else { one }, time_out: some }
            }
            0..10 if !coming.is_empty() => Act::Serve { port, time_out, times: draws.u8(1..4) },
            10..11 if !coming.is_empty() => Act::Receive { port, time_out },
            _ => Act::Delay(Ticks(draws.u64(1..200))),
        });
    }
    acts
}

fn reply(b: &mut ProgramBuilder, n: Slot) {
    b.reply(&[(Type::Int32, n)]);
}

/// Adds an act to a script.
fn add(b: &mut ProgramBuilder, act: Act, n: Slot) {
    let get = |b: &mut ProgramBuilder, port, time_out| {
        b.statement().op(Op::Get { port, source: None, time_out: Some(time_out) });
    };
    match act {
        Act::Send { port, to, time_out } => {
            let format = b.format(&[Type::Int32]);
            b.statement().load(n).op(Op::Send { port, to, format, time_out });
        }
        Act::Serve { port, time_out, times } => {
            for _ in 0..times {
                get(b, port, time_out);
                reply(b, n);
            }
            get(b, port, time_out);
        }
        Act::Receive { port, time_out } => get(b, port, time_out),
        Act::Meet { port, time_out } => {
            let format = b.format(&[]);
            b.statement().op(Op::Arrive { port, format, time_out });
        }
        Act::Delay(length) => {
            b.delay(length);
        }
    }
}

/// Carries out the acts as a future.
async fn program(mut ctx: AsyncContext, acts: Vec<Act>) -> Result<(), TaskError> {
    let time = |ticks: Ticks| Duration::from_micros(ticks.0);
    for round in 0..ROUNDS {
        for &act in &acts {
            match act {
                Act::Send { port, to, time_out } => {
                    let _outcome = ctx.send_with(port, to, &round.to_le_bytes(), time_out.map(time)).await?;
                }
                Act::Receive { port, time_out } => {
                    let _message = ctx.receive(port, Some(time(time_out))).await?;
                }
                Act::Serve { port, time_out, times } => {
                    let mut next = ctx.receive(port, Some(time(time_out))).await?;
                    for _ in 0..times {
                        let Some(message) = next.take().filter(|message| message.class == Class::Command)
                        else {
                            break;
                        };
                        let then = Some(time(time_out));
                        // The answer may come too late.
                        next = ctx.reply_and_receive(&message.from, b"yes", port, then).await.unwrap_or(None);
                    }
                }
                Act::Meet { port, time_out } => {
                    let _met = ctx.waitfor_with(port, [0; 8], time_out.map(time)).await?;
                }
                Act::Delay(length) => ctx.delay(time(length)).await?,
            }
        }
    }
    Ok(())
}

/// Runs a node, and replays the recording of each task in small steps. Counts the parts of fused steps by their kind.
fn compare(
    plan: &Plan,
    seed: u64,
    node: Builder,
    script: impl Fn(usize) -> Option<Arc<Program>>,
    counts: &mut BTreeMap<&'static str, usize>,
) {
    let tape = Arc::new(Tape { seed, of: Mutex::default() });
    let node = node.recorder(Arc::clone(&tape) as _).start().expect("a node that starts");
    assert!(node.wait(LONG), "a program did not end");
    let ends = node.stop(LONG);
    let well = |end: &TaskEnd| matches!(end, TaskEnd::Returned | TaskEnd::Script(End::Finished));
    assert!(ends.iter().all(|(_, end)| well(end)), "seed {seed}: {ends:?}");
    let table = NodeTable::new(Arc::clone(&plan.table), NodeId(0));
    let mut started = None;
    for (&task, log) in &*tape.of.lock().unwrap() {
        let mut passed = 0;
        let mut replay = Replay::new(&table, task, Incarnation(0), false);
        if let Some(program) = script(task.index()) {
            replay = replay.with_script(&program);
        }
        let mut before = None;
        for entry in log {
            match entry {
                Entry::Keyframe(state, digest) => {
                    let compared = replay.keyframe(state, *digest);
                    assert_eq!(compared, Ok(()), "seed {seed}, {task}, after {before:?}");
                    *counts.entry("state").or_default() += 1;
                }
                Entry::Script(step, done) => {
                    if let ScriptStep::Begin { at } = step {
                        let base = *started.get_or_insert(at - passed);
                        assert_eq!(at - passed, base, "seed {seed}: all machines of the node began at once");
                    }
                    replay.script(*step, *done);
                }
                Entry::Step(recorded, is_part) => {
                    replay.step(*recorded);
                    passed += recorded.step.elapsed.0;
                    let input = recorded.step.input;
                    if let Input::Packet(packet) = input {
                        assert_eq!(packet.destination, task, "seed {seed}");
                    }
                    let kind = kind(&plan.table, &input).filter(|_| *is_part);
                    kind.into_iter().for_each(|kind| *counts.entry(kind).or_default() += 1);
                    if let (Some("get"), Some("reply" | "response")) = (kind, before) {
                        *counts.entry("reply and get").or_default() += 1;
                    }
                    before = kind;
                }
            }
            assert_eq!(replay.verdict(), Verdict::Same, "seed {seed}");
        }
    }
}

/// The kind of a step that may be part of a fused step.
fn kind(table: &CellTable, input: &Input) -> Option<&'static str> {
    let is_query = |port: PortId| {
        let usage = table.port(port).map(|port| port.decl.usage);
        matches!(usage, Some(Usage::Query | Usage::Response))
    };
    let is_status = |port: PortId| table.port(port).is_some_and(|port| port.decl.class == Class::Status);
    Some(match *input {
        Input::Packet(_) => "packet",
        Input::Request(Request::Send { port, .. }) if is_query(port) => "query",
        Input::Request(Request::Send { port, .. }) if is_status(port) => "status",
        Input::Request(Request::Send { .. }) => "command",
        Input::Request(Request::Reply { to, .. }) if is_query(to.port) => "response",
        Input::Request(Request::Reply { .. }) => "reply",
        Input::Request(Request::Get { .. }) => "get",
        Input::Request(Request::Arrive { .. }) => "arrival",
        _ => return None,
    })
}

/// Runs random cells until each kind of step was compared often enough.
fn compare_all(
    script: impl Fn(&Plan, usize) -> Option<Arc<Program>>,
    add: impl Fn(&Plan, usize, Builder) -> Builder,
) {
    let kinds =
        ["command", "status", "query", "reply", "response", "get", "reply and get", "arrival", "packet"];
    let mut counts = BTreeMap::new();
    for seed in 0..CELLS {
        let plan = Plan::new(&mut fastrand::Rng::with_seed(seed));
        let node = (0..plan.acts.len()).fold(one_node(&plan.table), |node, task| add(&plan, task, node));
        compare(&plan, seed, node, |task| script(&plan, task), &mut counts);
        if kinds
            .into_iter()
            .chain(["state"])
            .all(|kind| counts.get(kind).is_some_and(|&times| times >= LEAST))
        {
            return;
        }
    }
    panic!("not each kind of step was compared {LEAST} times: {counts:?}");
}

#[test]
fn recorded_scripts_that_take_fused_steps_replay_in_small_steps() {
    compare_all(
        |plan, task| Some(plan.script(task)),
        |plan, task, node| node.script(NAMES[task], plan.script(task)),
    );
}

#[test]
fn recorded_futures_that_take_fused_steps_replay_in_small_steps() {
    compare_all(
        |_, _| None,
        |plan, task, node| {
            let acts = plan.acts[task].clone();
            node.async_task(NAMES[task], move |ctx| program(ctx, acts))
        },
    );
}
