//! Tests of hostile command lines, written by mistake or on purpose: numbers and times near the end of their range, empty
//! and broken words, flags without values or twice, special files. Every command must end, say what is wrong, and not panic.

use super::{DOCUMENTED, ended, fault_of};
use crate::support::{imrs, runtime_dir};
use rustix::fs::{CWD, FileType, Mode, mknodat};
use std::ffi::OsString;
use std::os::unix::ffi::OsStringExt;
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// A cell that can be checked and run quickly.
const CELL: &str =
    "cell c; tick 1 msec; node n; node m; link n -- m delay 1 msec; task t on n begin skip; end t;";

type Line = Vec<OsString>;

fn words(words: &[&str]) -> Line {
    words.iter().map(Into::into).collect()
}

fn with(line: &[&str], last: impl Into<OsString>) -> Line {
    let mut line = words(line);
    line.push(last.into());
    line
}

/// Special files, and file names that are used as arguments.
struct Files {
    /// A valid cell file.
    cell: String,
    special: Vec<OsString>,
    _socket: UnixListener,
}

impl Files {
    fn make(folder: &Path) -> Self {
        let at = |name: &str| folder.join(name);
        std::fs::write(at("good.cell"), CELL).expect("written");
        std::fs::write(at("empty"), "").expect("written");
        std::fs::write(at("bytes"), [0xff, 0, 0x9d, 0x1b]).expect("written");
        std::fs::write(at("text"), "cell \u{1b}]0;x\u{7} \u{202e};\n").expect("written");
        std::fs::create_dir(at("folder")).expect("made");
        mknodat(CWD, at("pipe"), FileType::Fifo, Mode::RWXU, 0).expect("a pipe");
        let socket = UnixListener::bind(at("socket")).expect("a socket");
        std::os::unix::fs::symlink(at("loop"), at("loop")).expect("a link to itself");
        let names = ["empty", "bytes", "text", "folder", "pipe", "socket", "loop", "missing"];
        let mut special: Vec<OsString> = names.iter().map(|name| at(name).into()).collect();
        special.extend(["", "/dev/zero", "/dev/full", "\u{1b}[2J"].map(OsString::from));
        special.push("x".repeat(5_000).into());
        special.push(OsString::from_vec(b"\xff\xfe.cell".to_vec()));
        Self { cell: at("good.cell").to_str().expect("UTF-8").into(), special, _socket: socket }
    }
}

/// Command lines with every kind of special file in every place in which a verb takes a file.
fn special_files(files: &Files) -> Vec<Line> {
    let cell = files.cell.as_str();
    let places: [&[&str]; 20] = [
        &["check"],
        &["fmt"],
        &["fmt", "--check"],
        &["graph"],
        &["verify"],
        &["simulate", "--seeds", "1"],
        &["run", "--for", "50ms"],
        &["replay"],
        &["replay", "--cell"],
        &["export", "--to", "jsonl", "--out", "-"],
        &["monitor", "--once", "--replay"],
        &["monitor", "--once", "--config"],
        &["monitor", "--once", "--token"],
        &["monitor", "--once", "--judge"],
        &["simulate", cell, "--seeds", "1", "--plan"],
        &["simulate", cell, "--seeds", "1", "--save"],
        &["verify", cell, "--save"],
        &["verify", cell, "--trace"],
        &["run", cell, "--for", "50ms", "--observe", "127.0.0.1:0", "--observe-token"],
        &["monitor", "--for", "50ms", "--record"],
    ];
    let all = places.iter().flat_map(|place| files.special.iter().map(|file| with(place, file)));
    // These output files are in a folder that does not exist.
    let lost = places[15..18].iter().map(|place| with(place, "/no/such/folder/file"));
    all.chain(lost).collect()
}

/// Words that are barely valid, or invalid, as numbers, times or sizes.
const VALUES: [&str; 22] = [
    "",
    " ",
    "-1",
    "-0",
    "+1",
    "00000000000000000000000000000000000001",
    "1e3",
    "0x10",
    "NaN",
    "inf",
    "1_000",
    "256",
    "65536",
    "4294967296",
    "18446744073709551616",
    "99999999999999999999999999999999999999",
    "36501days",
    "584942417355years",
    "-3s",
    "1s@",
    "\u{661}\u{662}",
    "\u{1b}[31m\u{9b}\u{202e}",
];

/// Command lines with every flag, each with these values. If a value may be valid, the verb ends by itself.
fn values(files: &Files) -> Vec<Line> {
    let cell = files.cell.as_str();
    let run = ["run", cell, "--for", "50ms"];
    let flags: [(&[&str], &str); 23] = [
        (&["run", cell], "--for="),
        (&run, "--seed="),
        (&run, "--loss="),
        (&run, "--kill="),
        (&run, "--kill=n@"),
        (&run, "--restart=n@"),
        (&run, "--cut="),
        (&run, "--cut=n--m@1ms+"),
        (&run, "--observe="),
        (&run, "--node="),
        (&run, "--action="),
        (&["verify", cell], "--within="),
        (&["verify", cell], "--jobs="),
        (&["verify", cell], "--memory="),
        (&["verify", cell], "--loss="),
        (&["verify", cell], "--crash="),
        (&["verify", cell], "--finding="),
        (&["simulate", cell, "--seeds", "1"], "--seed="),
        (&["simulate", cell, "--seeds", "1"], "--steps="),
        (&["monitor", "--once"], "--connect="),
        (&["monitor", "--once"], "--filter="),
        (&["monitor", "--once", "--replay", "/none"], "--speed="),
        (&["export", "/none", "--to", "svg"], "--last="),
    ];
    let of = |(line, flag): &(&[&str], &str)| {
        let runs_for_ever = |value: &&&str| *flag != "--for=" || value.parse::<f64>().is_err();
        let values = VALUES.iter().filter(runs_for_ever);
        values.map(|value| with(line, format!("{flag}{value}"))).collect::<Vec<Line>>()
    };
    flags.iter().flat_map(of).collect()
}

/// Command lines with mistakes that any verb must reject.
fn verbs(files: &Files) -> Vec<Line> {
    let cell = files.cell.as_str();
    let verbs: [&[&str]; 13] = [
        &["verify", cell],
        &["simulate", cell],
        &["check", cell],
        &["fmt", cell],
        &["explain", "E104"],
        &["graph", cell],
        &["run", cell],
        &["demo", "beam-lift"],
        &["monitor"],
        &["replay", cell],
        &["export", cell],
        &["completions", "bash"],
        &["man"],
    ];
    let broken = || OsString::from_vec(b"--\xff".to_vec());
    let wrong = |verb: &&[&str]| {
        let own = |last: &str| with(verb, last);
        vec![
            own("--nonsense"),
            own("--color"),
            own("--color=purple"),
            own("--format="),
            own("--format=xml"),
            own("-\u{1b}"),
            own("--for"),
            with(verb, broken()),
            [words(verb), words(&["--seed", "1", "--seed", "2", "--within", "x"])].concat(),
            [words(verb), words(&["--color", "never", "--color", "always", "--bad"])].concat(),
        ]
    };
    let mut all: Vec<Line> = verbs.iter().flat_map(wrong).collect();
    let unknown: [&[&str]; 16] = [
        &["explain", "E999"],
        &["explain", ""],
        &["explain", "\u{1b}[2J\n"],
        &["man", "nothing"],
        &["demo", "nothing"],
        &["completions", "nothing"],
        &["verify", "--claim", "nothing"],
        &["verify", "--explore", "1.2.3.4:1", "--claim", "pairing"],
        &["monitor", "--theme", "nothing"],
        &["monitor", "--assert", "up>="],
        &["monitor", "--assert", "(((((((((("],
        &["monitor", "--cell", "nothing", "--once"],
        &["nothing"],
        &["--", "check"],
        &["bench", "\u{9b}"],
        &["--full", "check", "x"],
    ];
    all.extend(unknown.iter().map(|line| words(line)));
    all.push(vec![OsString::from_vec(b"\xff".to_vec())]);
    all.push(with(&["explain"], OsString::from_vec(b"\xf0\x28\x8c".to_vec())));
    all.push(with(&["monitor", "--filter"], "(".repeat(20_000)));
    all
}

/// Runs all command lines, in one thread per core. Returns the faults that were found.
fn tried(folder: &Path, lines: &[Line]) -> Vec<String> {
    let (next, faults) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(2, usize::from) {
            scope.spawn(|| {
                while let Some(line) = lines.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let mut command = imrs(folder, &[]);
                    command.args(line).current_dir(folder);
                    let said = ended(command);
                    if let Some(fault) = fault_of(&said) {
                        let short: Vec<String> =
                            line.iter().map(|word| format!("{word:?}").chars().take(60).collect()).collect();
                        faults.lock().expect("no panic").push(format!("{fault}: {short:?}: {}", said.err));
                    }
                }
            });
        }
    });
    faults.into_inner().expect("no panic")
}

#[test]
fn hostile_command_lines_end_with_a_documented_code_and_a_reason() {
    let folder = runtime_dir();
    let files = Files::make(folder.path());
    let lines = [special_files(&files), values(&files), verbs(&files)].concat();
    assert!(lines.len() >= 200, "only {}", lines.len());
    let help = crate::support::run(&["--help"]).out;
    for code in DOCUMENTED {
        assert!(help.contains(&format!("{code} ")), "`imrs --help` does not name exit code {code}");
    }
    let faults = tried(folder.path(), &lines);
    println!("{} command lines", lines.len());
    assert!(faults.is_empty(), "{} of {}:\n{}", faults.len(), lines.len(), faults.join("\n"));
    // A failing command removes its partial output, but never a device, even as root.
    assert!(["/dev/zero", "/dev/full"].iter().all(|device| Path::new(device).exists()));
}

/// The command line, to be run by a shell with a resource limit.
fn limited(folder: &Path, limit: &str, args: &[&str]) -> std::process::Command {
    let mut command = std::process::Command::new("bash");
    let line = format!("ulimit {limit}; exec \"$0\" \"$@\"");
    command.args(["-c", &line, env!("CARGO_BIN_EXE_imrs")]).args(args);
    command.env("XDG_RUNTIME_DIR", folder).env("XDG_STATE_HOME", folder.join("state"));
    // A backtrace needs memory; without enough memory, the process would end in the middle of the backtrace.
    command.env("RUST_BACKTRACE", "0");
    command
}

#[test]
fn without_descriptors_or_memory_the_command_ends_in_order() {
    let folder = runtime_dir();
    let cell = crate::support::example("beam_lift.cell");
    let verbs: [&[&str]; 7] = [
        &["check", &cell],
        &["verify", &cell, "--within", "200ms"],
        &["simulate", &cell, "--seed", "1"],
        &["run", &cell, "--for", "200ms"],
        &["run", &cell, "--for", "200ms", "--in-process"],
        &["monitor", "--once"],
        &["replay", &cell],
    ];
    let (mut codes, mut faults) = (std::collections::BTreeMap::new(), Vec::new());
    for limit in ["-n 3", "-n 4", "-n 6", "-n 9", "-n 14", "-v 34000", "-v 40000", "-v 60000"] {
        // If not even the program itself starts with this limit, the limit is skipped.
        if ended(limited(folder.path(), limit, &["--version"])).code != Some(0) {
            continue;
        }
        for args in verbs {
            let said = ended(limited(folder.path(), limit, args));
            *codes.entry(said.code).or_insert(0) += 1;
            let fault = fault_of(&said).filter(|_| said.code != Some(71) || said.err.is_empty());
            faults.extend(fault.map(|fault| format!("ulimit {limit}, {args:?}: {fault}: {said:?}")));
        }
    }
    println!("{codes:?}");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(codes.contains_key(&Some(71)), "nothing ran out: {codes:?}");
}
