//! Tests of tasks that are scripts, on real nodes: with each other, with Rust tasks, and with actions outside of the node.

use crate::common::{A, B, LONG, LONG_TICKS, Tape, ask, cell, network, on, one_node, report, table, until};
use imrs_protocol::script::{
    Binary, End, Op, Outcomes, Program, ProgramBuilder, ScriptFault, StatementOutcome, Type,
};
use imrs_protocol::{
    CellTable, CoupleDecl, Incarnation, NodeId, NodeTable, PortDecl, PortId, PortView, Target, TaskId, Ticks,
    Usage,
};
use imrs_runtime::guard::GuardProgram;
use imrs_runtime::link::in_process::Faults;
use imrs_runtime::record::{Recorder, replay};
use imrs_runtime::script::{
    Act, Actions, CommandError, Commands, Ending, Functions, Note, Simulated, Stop, Watch,
};
use imrs_runtime::{Builder, Runtime, TaskEnd};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

const ASK: PortId = PortId(0);

/// A script that asks `times` questions and ends. It aborts if an answer is not one more than its question.
fn asker(times: i64) -> Arc<Program> {
    let mut b = ProgramBuilder::new("a");
    let (n, answer) = (b.variable("n", Type::Int16), b.variable("answer", Type::Int16));
    let top = b.label();
    b.put(top);
    b.send(ASK, Target::All, &[(Type::Int16, n)]).unpack(&[(Type::Int16, answer)]);
    b.when(Outcomes::TIME_OUT, |b| {
        b.abort("no answer in time");
    });
    b.statement().load(n).push(1).int(Binary::Add).store(n);
    let right = b.label();
    b.statement().load(answer).load(n).int(Binary::Equal).either(
        |b| {
            b.jump(right);
        },
        |b| {
            b.abort("a wrong answer");
        },
    );
    b.put(right);
    let over = b.label();
    b.statement().load(n).push(times).int(Binary::Less).unless(over).jump(top);
    b.put(over);
    b.end();
    Arc::new(b.finish().expect("a sound program"))
}

/// A script that answers each question with the received number plus one, in an endless loop.
fn answerer() -> Arc<Program> {
    let mut b = ProgramBuilder::new("b");
    let n = b.variable("n", Type::Int16);
    b.forever(|b| {
        b.receive(ASK, None, &[(Type::Int16, n)]);
        b.statement().load(n).push(1).int(Binary::Add).store(n);
        b.reply(&[(Type::Int16, n)]);
    });
    b.end();
    Arc::new(b.finish().expect("a sound program"))
}

/// A script that runs one action and ends. It aborts if the action fails.
fn actor(least: Ticks, most: Ticks) -> Arc<Program> {
    let mut b = ProgramBuilder::new("a");
    b.run("grip", least, most);
    b.when(Outcomes::of(&[StatementOutcome::Failed]), |b| {
        b.abort("the grip failed");
    });
    b.end();
    Arc::new(b.finish().expect("a sound program"))
}

fn end_of(runtime: Runtime, task: &str) -> TaskEnd {
    let ends = runtime.stop(LONG);
    ends.into_iter().find(|(name, _)| name == task).expect("a task of the node").1
}

#[test]
fn scripts_of_two_nodes_ask_and_answer() {
    let mut cell = cell(&[0, 1], Ticks(2_000));
    cell.port(ask(LONG_TICKS));
    let table = table(cell);
    let network = network(&table, Faults::default());
    let b = on(&network, &table, 1).script("b", answerer()).start().unwrap();
    let a = on(&network, &table, 0).script("a", asker(500)).start().unwrap();
    assert!(a.wait(LONG));
    assert_eq!(end_of(a, "a"), TaskEnd::Script(End::Finished));
    assert_eq!(end_of(b, "b"), TaskEnd::Returned, "it was stopped");
}

#[test]
fn a_script_and_a_rust_task_share_a_node() {
    let mut cell = cell(&[0, 0], Ticks(2_000));
    cell.port(ask(LONG_TICKS));
    let answers = |ctx: &mut imrs_runtime::Context| {
        let port = ctx.port("ask")?;
        while let Some(message) = ctx.receive(Some(port), None)? {
            let n = i16::from_le_bytes(message.contents.as_bytes().try_into().expect("two bytes"));
            ctx.reply(&message.from, &(n + 1).to_le_bytes())?;
        }
        Ok(())
    };
    let node =
        one_node(&table(cell)).script("a", asker(100)).task("b", answers).hold_scripts().start().unwrap();
    assert!(!node.wait(Duration::from_millis(20)), "the script waits to begin");
    node.begin();
    let deadline = Instant::now() + LONG;
    while node.node().snapshot(0).tasks[0].liveness != imrs_wire::obs::Liveness::Ended {
        assert!(Instant::now() < deadline, "the script does not end");
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(end_of(node, "a"), TaskEnd::Script(End::Finished));
}

#[test]
fn two_scripts_of_a_node_that_answer_each_other_for_ever_in_no_time_are_stopped() {
    let mut cell = cell(&[0, 0], Ticks(2_000));
    cell.port(ask(LONG_TICKS));
    // There are more questions than the steps that two scripts may take before the next input from outside of the
    // node.
    let node = one_node(&table(cell)).script("a", asker(30_000)).script("b", answerer()).start().unwrap();
    let deadline = Instant::now() + LONG;
    let alive = |node: &Runtime| {
        let tasks = node.node().snapshot(0).tasks;
        tasks.iter().all(|task| task.liveness == imrs_wire::obs::Liveness::Alive)
    };
    while alive(&node) {
        assert!(Instant::now() < deadline, "nobody stops them");
        std::thread::sleep(Duration::from_millis(1));
    }
    let ends = node.stop(LONG);
    let runaway = |(_, end): &(String, TaskEnd)| {
        matches!(end, TaskEnd::Script(End::Fault { fault: ScriptFault::Runaway, .. }))
    };
    assert_eq!(ends.iter().filter(|end| runaway(end)).count(), 1, "{ends:?}");
}

/// The counters of the ports of two scripts that ask and answer each other. `who` adds a watch or a recorder
/// to the node.
fn counted(who: impl FnOnce(Builder) -> Builder) -> Vec<Vec<PortView>> {
    let mut cell = cell(&[0, 0], Ticks(2_000));
    cell.port(ask(LONG_TICKS));
    let node = one_node(&table(cell)).script("a", asker(100)).script("b", answerer());
    let node = who(node).start().unwrap();
    until(|| node.node().snapshot(0).tasks[0].liveness == imrs_wire::obs::Liveness::Ended);
    let ports = node.node().snapshot(0).tasks.into_iter().map(|task| task.view.ports).collect();
    assert_eq!(end_of(node, "a"), TaskEnd::Script(End::Finished));
    ports
}

#[test]
fn scripts_without_a_watch_take_fused_steps_and_count_the_same() {
    let fused = counted(|node| node);
    let watched = counted(|node| node.watch(Arc::new(Notes(Mutex::default()))));
    let recorded = counted(|node| node.recorder(Arc::new(Tape::default())));
    let small = counted(|node| node.recorder(Arc::new(crate::common::SmallSteps)));
    assert_eq!(fused[1][0].counters.delivered, 100);
    assert_eq!([&fused, &fused, &fused], [&watched, &recorded, &small]);
}

fn replays(table: &Arc<CellTable>, tape: &Tape, node: NodeId, task: TaskId) -> usize {
    let steps = tape.closed.lock().unwrap().remove(&task).expect("steps");
    replay(&NodeTable::new(Arc::clone(table), node), task, Incarnation(1), false, steps)
        .expect("the same again")
}

#[test]
fn what_scripts_did_can_be_done_again_bit_equal_under_loss() {
    let mut cell = cell(&[0, 1], Ticks(2_000));
    cell.port(ask(LONG_TICKS).retry(20, Ticks(5_000)));
    let table = table(cell);
    let network = network(&table, Faults { seed: 7, loss: 0.2, ..Faults::default() });
    let tape = Arc::new(Tape::default());
    let recorder = || Arc::clone(&tape) as Arc<dyn Recorder>;
    let b = on(&network, &table, 1).script("b", answerer()).recorder(recorder()).start().unwrap();
    let a = on(&network, &table, 0).script("a", asker(50)).recorder(recorder()).start().unwrap();
    assert!(a.wait(LONG));
    assert_eq!(end_of(a, "a"), TaskEnd::Script(End::Finished));
    assert_eq!(end_of(b, "b"), TaskEnd::Returned);
    assert!(replays(&table, &tape, NodeId(0), A) > 100);
    assert!(replays(&table, &tape, NodeId(1), B) > 100);
}

fn act_with(actions: Arc<dyn Actions>) -> TaskEnd {
    let node = one_node(&table(cell(&[0], Ticks(2_000))));
    let node = node.script("a", actor(Ticks(0), Ticks(0))).actions(actions).start().unwrap();
    assert!(node.wait(LONG));
    end_of(node, "a")
}

fn simulated() -> Arc<dyn Actions> {
    Simulated::start(1, Vec::new(), Vec::new()).expect("a thread")
}

fn guard() -> GuardProgram {
    GuardProgram::At(env!("CARGO_BIN_EXE_imrs-guard").into())
}

fn command(words: &[&str]) -> Arc<dyn Actions> {
    let words = words.iter().map(ToString::to_string).collect();
    let commands = Commands::new(BTreeMap::from([("grip".to_owned(), words)]), simulated());
    // A busy machine may take longer than the default margin to start the guard and the command.
    Arc::new(commands.guard(guard()).margin(LONG))
}

#[test]
fn an_action_is_simulated_a_command_or_a_function() {
    assert_eq!(act_with(simulated()), TaskEnd::Script(End::Finished));
    assert_eq!(act_with(command(&["true"])), TaskEnd::Script(End::Finished));
    assert_eq!(act_with(command(&["false"])), TaskEnd::Script(End::Aborted(0)));
    let (tell, told) = std::sync::mpsc::channel();
    let words = BTreeMap::from([("grip".to_owned(), vec!["/no/such/program".to_owned()])]);
    let commands = || {
        let tell = tell.clone();
        Commands::new(words.clone(), simulated()).margin(LONG).tell(move |action, error| {
            let (program, why) = match error {
                CommandError::Program { program, why } | CommandError::Guard { program, why } => {
                    (program, why)
                }
                other => panic!("{other}"),
            };
            tell.send((action.to_owned(), program.to_owned(), why.kind())).unwrap();
        })
    };
    for (guard, program) in
        [(guard(), "/no/such/program"), (GuardProgram::At("/no/such/guard".into()), "/no/such/guard")]
    {
        assert_eq!(act_with(Arc::new(commands().guard(guard))), TaskEnd::Script(End::Aborted(0)));
        let missing = ("grip".to_owned(), program.to_owned(), std::io::ErrorKind::NotFound);
        assert_eq!(told.try_recv(), Ok(missing));
    }
    let functions = || Functions::new(simulated());
    assert_eq!(act_with(Arc::new(functions().action("grip", |_| Ok(1)))), TaskEnd::Script(End::Finished));
    let failing = functions().action("grip", |_| Err("no part there".into()));
    assert_eq!(act_with(Arc::new(failing)), TaskEnd::Script(End::Aborted(0)));
    let panicking = functions().action("grip", |_| panic!("the driver of the gripper"));
    assert_eq!(act_with(Arc::new(panicking)), TaskEnd::Script(End::Aborted(0)));
}

/// An executor of actions that reports when an action begins, and when it was stopped.
struct Told(std::sync::mpsc::Sender<&'static str>, Mutex<Vec<Ending>>);

impl Actions for Told {
    fn begin(&self, _act: &Act<'_>, ending: Ending) -> Option<Stop> {
        self.1.lock().unwrap().push(ending);
        let tell = self.0.clone();
        let _ = tell.send("begins");
        Some(Box::new(move || {
            let _ = tell.send("stopped");
        }))
    }
}

#[test]
fn a_node_that_stops_cuts_its_actions_short_and_their_ends_come_to_nothing() {
    let (tell, told) = report();
    let actions = Arc::new(Told(tell, Mutex::default()));
    let node = one_node(&table(cell(&[0], Ticks(2_000))));
    let bound = Arc::clone(&actions) as Arc<dyn Actions>;
    let node = node.script("a", actor(Ticks(0), LONG_TICKS)).actions(bound).start().unwrap();
    assert_eq!(told.recv_timeout(LONG), Ok("begins"));
    assert_eq!(end_of(node, "a"), TaskEnd::Returned);
    assert_eq!(told.recv_timeout(LONG), Ok("stopped"));
    actions.1.lock().unwrap().drain(..).for_each(|ending| ending.done(0));
}

struct Notes(Mutex<Vec<(u64, Note)>>);

impl Watch for Notes {
    fn note(&self, _task: TaskId, at: u64, note: &Note) {
        self.0.lock().unwrap().push((at, note.clone()));
    }
}

#[test]
fn a_simulated_action_takes_a_time_of_its_interval_the_same_for_the_same_seed() {
    let run = |seed| {
        let notes = Arc::new(Notes(Mutex::default()));
        let results = vec![imrs_runtime::script::Results {
            name: "grip".into(),
            give: imrs_runtime::script::Give::Whole(0, 1_000_000),
        }];
        let node = one_node(&table(cell(&[0], Ticks(2_000))));
        let node = node
            .script("a", actor(Ticks(20_000), Ticks(30_000)))
            .actions(Simulated::start(seed, results, Vec::new()).expect("a thread"))
            .watch(Arc::clone(&notes) as Arc<dyn Watch>)
            .start()
            .unwrap();
        assert!(node.wait(LONG));
        assert_eq!(end_of(node, "a"), TaskEnd::Script(End::Finished));
        let notes = notes.0.lock().unwrap();
        let begun = notes.iter().find(|(_, note)| matches!(note, Note::Acts { .. })).expect("it begins").0;
        let ended = notes.iter().find_map(|(at, note)| match note {
            Note::Acted { value, ok: true, .. } => Some((*at, *value)),
            _ => None,
        });
        let (ended, value) = ended.expect("it ends");
        assert!(ended - begun >= 20_000, "{}", ended - begun);
        value
    };
    let first = run(3);
    assert_eq!(first, run(3));
    assert_ne!(first, run(4));
}

#[test]
fn a_command_that_is_cut_short_is_killed() {
    let dir = std::env::temp_dir().join(format!("imrs-action-{}", std::process::id()));
    let mark = dir.to_str().expect("UTF-8").to_owned();
    let node = one_node(&table(cell(&[0], Ticks(2_000))));
    let actions = command(&["sh", "-c", &format!("echo $$ > {mark}; exec sleep 600")]);
    let node = node.script("a", actor(Ticks(0), LONG_TICKS)).actions(actions).start().unwrap();
    let deadline = Instant::now() + LONG;
    let pid: u32 = loop {
        let text = std::fs::read_to_string(&dir).unwrap_or_default();
        if let Ok(pid) = text.trim().parse() {
            break pid;
        }
        assert!(Instant::now() < deadline, "the command does not start");
        std::thread::sleep(Duration::from_millis(1));
    };
    std::fs::remove_file(&dir).expect("the mark");
    assert!(std::path::Path::new(&format!("/proc/{pid}")).exists());
    assert_eq!(end_of(node, "a"), TaskEnd::Returned);
    // A stopping node waits for the end of a command only for a limited time, so the test waits longer.
    let deadline = Instant::now() + LONG;
    while std::path::Path::new(&format!("/proc/{pid}")).exists() {
        assert!(Instant::now() < deadline, "the command runs on");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// A watch that blocks for longer than a lease when its script is about to act, as if the node had been stopped.
struct StandsStill(Mutex<Vec<Note>>);

const LEASE_US: u64 = 300_000;

impl Watch for StandsStill {
    fn note(&self, _task: TaskId, _at: u64, note: &Note) {
        let mut notes = self.0.lock().unwrap();
        if matches!(note, Note::Acts { .. }) {
            std::thread::sleep(Duration::from_micros(2 * LEASE_US));
        }
        notes.push(note.clone());
    }
}

/// An executor of actions that records which actions began.
struct Began(Mutex<Vec<String>>);

impl Actions for Began {
    fn begin(&self, act: &Act<'_>, ending: Ending) -> Option<Stop> {
        self.0.lock().unwrap().push(act.name.into());
        ending.done(0);
        None
    }
}

/// A script that begins an action once it has the lease.
fn welder() -> Arc<Program> {
    let mut b = ProgramBuilder::new("a");
    b.statement().op(Op::Lease).run("weld", Ticks(1_000), LONG_TICKS).end();
    Arc::new(b.finish().expect("a sound program"))
}

/// A script that answers its partner's heartbeats and does nothing else.
fn standby() -> Arc<Program> {
    let mut b = ProgramBuilder::new("b");
    b.statement().op(Op::Lease).end();
    b.takeover(|b| {
        b.run("go_on", Ticks(1), Ticks(1));
    });
    Arc::new(b.finish().expect("a sound program"))
}

#[test]
fn who_stood_still_for_longer_than_its_lease_begins_nothing() {
    let mut cell = cell(&[0, 1], Ticks(2_000));
    let time_out = Ticks(40_000);
    let via = cell.port(PortDecl::new("alive", A, Usage::Response, &[B], time_out));
    let [lease, takeover, every] = [LEASE_US, 20_000_000, LEASE_US / 15].map(Ticks);
    let (trusted, mutual) = (false, false);
    cell.couples.push(CoupleDecl { primary: A, standby: B, lease, takeover, every, via, trusted, mutual });
    let table = table(cell);
    let network = network(&table, Faults::default());
    let (still, began) = (Arc::new(StandsStill(Mutex::default())), Arc::new(Began(Mutex::default())));
    let b = on(&network, &table, 1).script("b", standby()).start().unwrap();
    let a = on(&network, &table, 0).script("a", welder()).actions(Arc::clone(&began) as Arc<dyn Actions>);
    let a = a.watch(Arc::clone(&still) as Arc<dyn Watch>).start().unwrap();
    assert!(a.wait(LONG), "its lease ends while it stands still");
    let notes = std::mem::take(&mut *still.0.lock().unwrap());
    assert!(notes.iter().any(|note| matches!(note, Note::Acts { .. })), "{notes:?}");
    assert_eq!(*began.0.lock().unwrap(), Vec::<String>::new(), "the lease was over by then: {notes:?}");
    assert_eq!(end_of(a, "a"), TaskEnd::Script(End::Fenced), "{notes:?}");
    drop(b.stop(LONG));
}
