//! Tests of what a service manager sees of a run, and of `imrs unit`. The manager is a datagram socket, as `sd_notify(3)`
//! describes it.

use crate::support::program::Program;
use crate::support::{imrs, own_address, run_in, runtime_dir, signal};
use rustix::process::Signal;
use std::io::ErrorKind;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::time::{Duration, Instant};

/// How often the manager wants a ping, in microseconds.
const WITHIN_US: u64 = 3_000_000;

/// A cell of one node, at an address of its own, whose task serves for ever.
fn cell(folder: &Path) -> String {
    let (own, [port]) = own_address();
    let text = format!(
        "cell line;\ntick 10 msec;\nnode press at \"{own}\" port {port};\n\
         task stamp on press\n  var n: int16;\nbegin\n  loop\n    delay 1 sec;\n    n := 1;\n  end;\nend stamp;\n"
    );
    let file = folder.join("line.cell");
    std::fs::write(&file, text).expect("the cell is written");
    file.to_str().expect("UTF-8").to_owned()
}

/// The states that the manager receives in one datagram; `None` if none arrives within `within`.
fn told(manager: &UnixDatagram, within: Duration) -> Option<String> {
    manager.set_read_timeout(Some(within)).expect("a time limit");
    let mut bytes = [0; 4096];
    match manager.recv(&mut bytes) {
        Ok(length) => Some(String::from_utf8_lossy(&bytes[..length]).into_owned()),
        Err(error) if [ErrorKind::WouldBlock, ErrorKind::TimedOut].contains(&error.kind()) => None,
        // The kernel's freezer or a debugger stopped this process meanwhile.
        Err(error) if error.kind() == ErrorKind::Interrupted => told(manager, within),
        Err(error) => panic!("the manager's socket: {error}"),
    }
}

/// Whether the manager receives a ping within 60 s.
fn pings(manager: &UnixDatagram) -> bool {
    let end = Instant::now() + Duration::from_secs(60);
    while Instant::now() < end {
        if told(manager, Duration::from_secs(60)).is_some_and(|states| states.contains("WATCHDOG=1")) {
            return true;
        }
    }
    false
}

#[test]
fn a_service_manager_hears_that_a_node_is_up_that_it_works_and_that_it_stops() {
    let dir = runtime_dir();
    let cell = cell(dir.path());
    let socket = dir.path().join("notify");
    let manager = UnixDatagram::bind(&socket).expect("a socket");
    let mut command = imrs(dir.path(), &["run", &cell, "--node", "press", "--insecure", "--format", "json"]);
    command.env("NOTIFY_SOCKET", &socket).env("WATCHDOG_USEC", WITHIN_US.to_string());
    let mut program = Program::start(command);
    let ready = told(&manager, Duration::from_secs(60)).expect("that it is up");
    assert_eq!(ready, "READY=1\nSTATUS=1 node of the cell line up: press\n");
    let node = program.json()["started"][0]["pid"].as_u64().expect("a process");
    assert!(pings(&manager), "a node that works is reported");

    // A suspended node sends nothing. Only the pings that it sent before the suspension arrive.
    let node = u32::try_from(node).expect("a process");
    signal(node, Signal::STOP);
    let stopped = Instant::now();
    let within = Duration::from_micros(WITHIN_US);
    while told(&manager, within).is_some() {
        assert!(stopped.elapsed() < 20 * within, "a suspended node is reported as one that works");
    }
    signal(node, Signal::CONT);
    assert!(pings(&manager), "the node works again");

    signal(program.pid(), Signal::TERM);
    let said = program.finish();
    assert_eq!(said.code, Some(0), "{said:?}");
    let last = std::iter::from_fn(|| told(&manager, Duration::from_millis(1))).last();
    assert_eq!(last.as_deref(), Some("STOPPING=1\nSTATUS=stopping\n"));
}

#[test]
fn a_missing_service_manager_is_reported_once_and_stops_nothing() {
    let dir = runtime_dir();
    let cell = cell(dir.path());
    let mut command = imrs(dir.path(), &["run", &cell, "--node", "press", "--insecure", "--for", "1s"]);
    command.env("NOTIFY_SOCKET", dir.path().join("nothing"));
    let said = Program::start(command).finish();
    assert_eq!(said.code, Some(0), "{said:?}");
    assert_eq!(
        said.err.matches("the service manager (NOTIFY_SOCKET) does not listen").count(),
        1,
        "{said:?}"
    );
}

#[test]
fn a_unit_runs_one_node_with_its_options() {
    let dir = runtime_dir();
    let cell = cell(dir.path());
    assert_eq!(run_in(dir.path(), &["keygen", &cell]).code, Some(0));
    let options = ["--rt", "--seed", "7", "--keys", "line.keys"];
    let said = run_in(
        dir.path(),
        &[&["unit", &cell, "--node", "press", "--user", "robot", "--"][..], &options].concat(),
    );
    assert_eq!(said.code, Some(0), "{said:?}");
    let program = env!("CARGO_BIN_EXE_imrs");
    let folder = dir.path().canonicalize().expect("a folder");
    let folder = folder.display();
    let command = format!(
        "ExecStart={program} run {folder}/line.cell --node press --rt --seed 7 --keys line.keys\nWorkingDirectory={folder}\nUser=robot\n"
    );
    assert!(said.out.contains(&command), "{said:?}");
    for line in [
        "Type=notify",
        "WatchdogSec=3",
        "Restart=on-failure",
        "RestartPreventExitStatus=2 5 6",
        "KillMode=mixed",
        "LimitRTPRIO=99",
        "Environment=XDG_STATE_HOME=%S XDG_RUNTIME_DIR=%t",
        "WantedBy=multi-user.target",
    ] {
        assert!(said.out.lines().any(|own| own == line), "{line}: {said:?}");
    }
    let plain = run_in(dir.path(), &["unit", &cell, "--node", "press"]);
    assert!(plain.out.contains("User=imrs\n") && !plain.out.contains("LimitRTPRIO"), "{plain:?}");
}

#[test]
fn a_unit_that_could_not_start_its_node_is_refused() {
    let dir = runtime_dir();
    let cell = cell(dir.path());
    let unit = |args: &[&str]| run_in(dir.path(), &[&["unit"], args].concat());
    for (args, words) in [
        (&[&*cell, "--node", "pres"][..], "the cell has no node `pres`"),
        (&[&cell, "--node", "press"], "node `press` has no keys"),
        (&["-", "--node", "press"], "name a cell file"),
        (&["nothing.cell", "--node", "press"], "there is no such file"),
        (&[&cell, "--node", "press", "--user", "a b"], "this is no name of a user"),
        (&[&cell, "--node", "press", "--", "--insecure", "--speed"], "unexpected argument"),
        (&[&cell, "--node", "press", "--", "--insecure", "--record", "r"], "a recording is never replaced"),
        (&[&cell, "--node", "press", "--", "--insecure", "--action", "a=b"], "the cell has no action `a`"),
    ] {
        let said = unit(args);
        assert_eq!(said.code, Some(2), "{args:?}: {said:?}");
        assert!(said.err.contains(words) && said.out.is_empty(), "{args:?}: {said:?}");
    }
    assert_eq!(run_in(dir.path(), &["keygen", &cell]).code, Some(0));
    std::fs::remove_file(dir.path().join("line.keys/press.keys")).expect("its keys");
    let said = unit(&[&cell, "--node", "press"]);
    assert!(said.code == Some(2) && said.err.contains("press.keys: there is no such file"), "{said:?}");
}
