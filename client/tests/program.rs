//! Tests which programs the library refuses, and runs a cell whose two nodes are two programs.

use imrs_client::{Context, Program, ProgramError, TaskEnd, TaskError, cells, keys};
use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

fn cell() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/extern_task.cell"))
}

#[test]
fn what_does_not_fit_the_cell_is_refused() {
    let open = || Program::open(cell()).expect("a cell");
    let soon = Some(Duration::from_millis(1));
    assert!(matches!(open().run(soon), Err(ProgramError::NoBody(task)) if task == "camera"));
    let body = |task: &str| open().task(task, |_| Ok(()));
    assert!(matches!(body("pick").run(soon), Err(ProgramError::NotExtern(task)) if task == "pick"));
    assert!(matches!(body("pik").run(soon), Err(ProgramError::NoTask(task)) if task == "pik"));
    let unknown = body("camera").action("pik_at", |_| Ok(0));
    assert!(matches!(unknown.run(soon), Err(ProgramError::NoAction(name)) if name == "pik_at"));
    assert!(matches!(body("camera").node("nx").run(soon), Err(ProgramError::NoNode(name)) if name == "nx"));
    // The cell of a text has no folder of keys beside it.
    let text = std::fs::read_to_string(cell()).expect("the cell");
    let alone = Program::of_text("x.cell", &text).expect("a cell").task("camera", |_| Ok(())).node("nc");
    assert!(matches!(alone.run(soon), Err(ProgramError::NoKeys(name)) if name == "nc"));
    let faulty = Program::of_text("x.cell", "cell x;\nnode a\n");
    assert!(matches!(faulty, Err(ProgramError::Cell(words)) if words.contains("x.cell:2:")));
    let missing = Program::open("no.cell");
    assert!(
        matches!(missing, Err(ProgramError::Cell(words)) if words.contains("no.cell: there is no such file"))
    );
}

#[test]
fn monitors_over_tcp_need_a_token() {
    let watched = |program: Program| program.task("camera", |_| Ok(())).run(Some(Duration::from_millis(1)));
    for ip in [[0, 0, 0, 0], [127, 0, 0, 1]] {
        let open = || Program::open(cell()).expect("a cell").observe((ip, 0).into());
        assert!(matches!(watched(open()), Err(ProgramError::Watched(_))));
        assert!(matches!(watched(open().observe_token("short")), Err(ProgramError::Token(_))));
    }
}

/// The cell that the two programs share. Its nodes have an address that no other process uses.
const CELL: &str = r#"
cell apart;
tick 1 msec;
node na at "ADDRESS" port 7511;
node nb at "ADDRESS" port 7512;
link na -- nb delay 1 msec;
task left on na extern
  port ask(x: int16) usage = send user_list = {right} time_out = 500 msec class = 2;
end left;
task right on nb extern
  use_port ask(x: int16) usage = receive;
end right;
"#;
/// The environment variable that names the node of a child process; the next two variables have the node's address and,
/// if it has keys, their folder.
const NODE: &str = "IMRS_TEST_CLIENT_NODE";
const ADDRESS: &str = "IMRS_TEST_CLIENT_ADDRESS";
const KEYS: &str = "IMRS_TEST_CLIENT_KEYS";
/// How long the nodes may run. This limit ends the test only if they do not find each other.
const LENGTH: Duration = Duration::from_secs(300);

/// Asks until an answer comes, because the other program may start later.
fn left(ctx: &mut Context) -> Result<(), TaskError> {
    let ask = ctx.port("ask")?;
    while ctx.send(ask, &7_i16.to_le_bytes())?.reply().is_none() {}
    Ok(())
}

/// Answers until no task has asked for a while, because an answer may be lost.
fn right(ctx: &mut Context) -> Result<(), TaskError> {
    let ask = ctx.port("ask")?;
    let mut wait = None;
    while let Some(question) = ctx.receive(Some(ask), wait)? {
        assert_eq!(question.contents.as_bytes(), 7_i16.to_le_bytes());
        // If the answer is too late, the other task asks again.
        let _ = ctx.reply(&question.from, &[]);
        wait = Some(Duration::from_secs(2));
    }
    Ok(())
}

/// The body of a child process. The next test starts this test in such a process.
#[test]
fn the_program_of_one_node() {
    let Ok(node) = std::env::var(NODE) else { return };
    let (task, body): (_, fn(&mut Context) -> _) =
        if node == "na" { ("left", left) } else { ("right", right) };
    let text = CELL.replace("ADDRESS", &std::env::var(ADDRESS).expect("an address"));
    let program = Program::of_text("apart.cell", &text).expect("a cell").task(task, body).node(&node);
    let program = match std::env::var_os(KEYS) {
        Some(keys) => program.keys(keys),
        None => program.insecure(),
    };
    let ends = program.run(Some(LENGTH)).expect("it runs");
    assert_eq!(ends, [(task.to_owned(), TaskEnd::Returned)]);
}

#[test]
fn two_programs_run_a_node_each_with_keys_and_without() {
    let state = tempfile::tempdir().expect("a folder");
    let [_, a, b, c] = std::process::id().to_be_bytes();
    // Other programs on this machine use addresses 127.0.x.y.
    let address = format!("127.{}.{b}.{c}", 64 | a);
    let loaded = cells::load("apart.cell", &CELL.replace("ADDRESS", &address), false).expect("a cell");
    for (node, text) in ["na", "nb"].iter().zip(keys::draw(&loaded).expect("keys")) {
        let file = keys::file_of(state.path(), node);
        std::fs::write(&file, &*text).expect("a file");
        std::fs::set_permissions(&file, Permissions::from_mode(0o600)).expect("its mode");
    }
    for with_keys in [true, false] {
        two_programs(state.path(), &address, with_keys);
    }
}

fn two_programs(state: &Path, address: &str, with_keys: bool) {
    let start = |node: &str| -> Child {
        let mut program = Command::new(std::env::current_exe().expect("this program"));
        program.args(["--exact", "program::the_program_of_one_node", "--nocapture", "--test-threads", "1"]);
        program
            .env(NODE, node)
            .env(ADDRESS, address)
            .env("XDG_STATE_HOME", state)
            .env("XDG_RUNTIME_DIR", state);
        if with_keys {
            program.env(KEYS, state);
        }
        program.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts")
    };
    let programs = ["na", "nb"].map(|node| (node, start(node)));
    for (node, program) in programs {
        let said = program.wait_with_output().expect("its end");
        assert!(said.status.success(), "{node}: {said:?}");
        let stored = state.join(format!("imrs/apart/{node}.life"));
        let stored = std::fs::read_to_string(stored).expect("its incarnation");
        assert!(stored.trim().parse::<u8>().is_ok(), "{stored}");
    }
}

#[test]
fn a_body_finds_the_other_nodes_when_it_begins() {
    // The nodes start in the order of the cell. Starting the nodes between `na` and `nb` takes so long that a message
    // sent too early would find no receiver.
    let between: String = (0..40).map(|i| format!("node n{i};\n")).collect();
    let cell = format!(
        r#"
cell together;
tick 1 msec;
node na;
{between}node nb;
link na -- nb delay 1 msec;
task left on na extern
  port ask(x: int16) usage = send user_list = {{right}} time_out = 20 sec class = 2;
end left;
task right on nb
  use_port ask(x: int16) usage = receive;
  var x: int16;
begin
  receive ask(x);
  reply();
end right;
"#
    );
    let program = Program::of_text("together.cell", &cell).expect("a cell").task("left", |ctx| {
        let ask = ctx.port("ask")?;
        // The message is sent once: without its receiver's node it would get no answer.
        assert!(ctx.send(ask, &[7, 0])?.reply().is_some(), "no answer");
        Ok(())
    });
    let ends = program.run(Some(Duration::from_secs(60))).expect("it runs");
    assert_eq!(ends[0].1, TaskEnd::Returned);
    assert!(matches!(ends[1].1, TaskEnd::Script(_)), "{ends:?}");
}
