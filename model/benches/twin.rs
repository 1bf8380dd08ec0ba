//! Compares the checker with SPIN, which searches hand-written Promela models of the same protocol at equal bounds: time
//! and memory until the same verdict. Run it with `cargo bench -p imrs-model --bench twin`.
//!
//! All tools run on one thread, each search in a process of its own, in turns within each round, so that a slow moment of
//! the computer affects all of them. Times are those of the whole process; what SPIN needs before it can search (writing
//! and compiling the verifier) is shown apart. Memory is the greatest resident memory, which the operating system reports
//! for both.

#[path = "../tests/support/spin.rs"]
mod spin;

use imrs_model::worlds::Meeting;
use imrs_model::{Budget, Limits, Reductions, Watch, explore};
use imrs_protocol::rules::Rules;
use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const ROUNDS: usize = 3;

/// A world, described for the checker and for SPIN.
struct World {
    name: &'static str,
    meeting: Meeting,
    model: &'static str,
    /// The macro definitions that give the Promela model this world's size and rules.
    definitions: &'static [&'static str],
    /// The macro definitions with which the Promela model drops values that can no longer change behaviour, as the checker
    /// does.
    reduced: &'static [&'static str],
}

fn worlds() -> Vec<World> {
    let once = |members, loss| {
        let rules = Rules { answer_late_arrivals: false, ..Rules::DEFAULT };
        let budget = Budget { loss, dup: 0, crash: 0 };
        Meeting { rules, budget, ..Meeting::new(members, Watch::Stranded) }
    };
    let timed = |losses, margin, time_out| Meeting {
        time_out: Some(time_out),
        delay: Some(1),
        resend: Some(2),
        losses,
        margin: Some(margin),
        budget: Budget { loss: losses, dup: 0, crash: 0 },
        hurry: true,
        ..Meeting::new(3, Watch::AllOrNone)
    };
    vec![
        World {
            name: "sent once, 3 members, 2 losses",
            meeting: once(3, 2),
            model: "waitfor.pml",
            definitions: &["N=3", "LOSS=2"],
            reduced: &["FORGET"],
        },
        World {
            name: "sent once, 4 members, 2 losses",
            meeting: once(4, 2),
            model: "waitfor.pml",
            definitions: &["N=4", "LOSS=2"],
            reduced: &["FORGET"],
        },
        World {
            name: "sent once, 4 members, 3 losses",
            meeting: once(4, 3),
            model: "waitfor.pml",
            definitions: &["N=4", "LOSS=3"],
            reduced: &["FORGET"],
        },
        World {
            name: "time_outs and re-sending, 3 members at once, no loss",
            meeting: timed(0, 1, 3),
            model: "meeting_timed.pml",
            definitions: &["N=3", "HURRY", "ROOM=20", "T=3", "LOSS=0", "COPIES=0", "MARGIN=1"],
            reduced: &["FORGET"],
        },
        World {
            name: "time_outs and re-sending, 3 members at once, 1 loss",
            meeting: timed(1, 3, 5),
            model: "meeting_timed.pml",
            definitions: &["N=3", "HURRY", "ROOM=20", "T=5", "LOSS=1", "COPIES=1", "MARGIN=3"],
            reduced: &["FORGET"],
        },
    ]
}

/// A tool and its settings, with which a world is searched.
struct Tool {
    name: String,
    command: Vec<String>,
    runs: Vec<Run>,
}

/// The measurements of one search.
#[derive(Clone, Copy, Debug)]
struct Run {
    seconds: f64,
    megabytes: f64,
    states: u64,
    holds: bool,
    /// The memory in megabytes that SPIN itself reports.
    said_megabytes: Option<f64>,
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [flag, world, reduced] = &arguments[..]
        && flag == "--search"
    {
        return search(&worlds()[world.parse::<usize>().expect("a number")], reduced == "reduced");
    }
    // `cargo test --benches` only checks that the bench runs, so it gets the smallest bounds.
    let quick = arguments.iter().any(|argument| argument == "--test");
    let missing = spin::missing();
    if let Some(missing) = missing {
        println!("{missing} is missing: only the checker's side is shown");
    }
    let worlds = worlds();
    for (number, world) in worlds.iter().enumerate().take(if quick { 1 } else { worlds.len() }) {
        compare(number, world, missing.is_none(), if quick { 1 } else { ROUNDS });
    }
}

/// The checker's own search, in a process that does nothing else.
fn search(world: &World, reduced: bool) {
    let reductions = if reduced { Reductions::ALL } else { Reductions::NONE };
    let scenario = Meeting { reductions, ..world.meeting.clone() }.scenario().expect("a sound declaration");
    let found = explore(&scenario, Limits::default(), None);
    assert!(found.complete, "cut by memory");
    println!("{} {}", found.states, found.violation.is_none());
}

fn compare(number: usize, world: &World, with_spin: bool, rounds: usize) {
    println!("\n{}", world.name);
    let itself = std::env::current_exe().expect("this program").to_string_lossy().into_owned();
    let ours = |name: &str, how: &str| Tool {
        name: name.into(),
        command: [itself.as_str(), "--search", &number.to_string(), how].map(str::to_owned).into(),
        runs: Vec::new(),
    };
    let mut tools = vec![ours("imrs", "reduced"), ours("imrs, nothing reduced", "raw")];
    let folder = folder(number);
    if with_spin {
        tools.extend(verifiers(world, &folder));
    }
    for _ in 0..rounds {
        for tool in &mut tools {
            let run = measure(&tool.command);
            tool.runs.push(run);
        }
    }
    let _ = std::fs::remove_dir_all(&folder);
    show(&tools);
}

fn folder(number: usize) -> std::path::PathBuf {
    let folder = std::env::temp_dir().join(format!("imrs-twin-{}-{number}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder for temporary files");
    folder
}

/// SPIN's verifiers of the world: the model as it is, and the model that is reduced by hand; each as an exact search,
/// with COLLAPSE, and with hash-compact.
fn verifiers(world: &World, folder: &Path) -> Vec<Tool> {
    let flavours: [(&str, &[&str]); 3] =
        [("exact", &["-O2"]), ("COLLAPSE", &["-O2", "-DCOLLAPSE"]), ("hash-compact", &["-O2", "-DHC4"])];
    let mut tools = Vec::new();
    for (kind, more) in [("", &[][..]), (", reduced by hand", world.reduced)] {
        for (flavour, flags) in flavours {
            let folder = folder.join(tools.len().to_string());
            std::fs::create_dir_all(&folder).expect("a folder");
            let definitions = [world.definitions, more].concat();
            let definitions: Vec<String> = definitions.iter().map(|&d| d.to_owned()).collect();
            let start = Instant::now();
            let verifier =
                spin::build(&folder, &Path::new(spin::MODELS).join(world.model), &definitions, flags);
            let built = start.elapsed().as_secs_f64();
            // A hash table that fits, as an engineer who knows SPIN would choose it: the default hash table takes 128 MB.
            let states = verifier.run(&[]).states;
            let size = states.next_power_of_two().ilog2().max(16);
            tools.push(Tool {
                name: format!("SPIN {flavour}{kind} (built in {built:.1} s)"),
                command: vec![verifier.path().to_string_lossy().into_owned(), format!("-w{size}")],
                runs: Vec::new(),
            });
        }
    }
    tools
}

/// Runs a search to its end and watches its memory.
fn measure(command: &[String]) -> Run {
    let start = Instant::now();
    let mut process = Command::new(&command[0]);
    process.args(&command[1..]).stdout(Stdio::piped()).current_dir(std::env::temp_dir());
    let mut child = process.spawn().expect("the search starts");
    let mut output = child.stdout.take().expect("a pipe");
    let reader = std::thread::spawn(move || {
        let mut text = String::new();
        output.read_to_string(&mut text).expect("text");
        text
    });
    let mut megabytes = 0.0_f64;
    let mut seconds = start.elapsed().as_secs_f64();
    while child.try_wait().expect("a child").is_none() {
        megabytes = megabytes.max(most_resident(&child).unwrap_or(0.0));
        std::thread::sleep(Duration::from_millis(1));
        seconds = start.elapsed().as_secs_f64();
    }
    let said = reader.join().expect("its output");
    if let Some((states, holds)) =
        said.trim().split_once(' ').filter(|(_, holds)| holds.parse::<bool>().is_ok())
    {
        let (states, holds) = (states.parse().expect("a number"), holds == "true");
        return Run { seconds, megabytes, states, holds, said_megabytes: None };
    }
    let verdict = spin::read(&said);
    let said_megabytes = Some(verdict.megabytes);
    Run { seconds, megabytes, states: verdict.states, holds: verdict.holds, said_megabytes }
}

/// The greatest resident memory so far, in megabytes; `None` if the system does not report it.
fn most_resident(child: &Child) -> Option<f64> {
    let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes / 1024.0)
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Prints one row for each tool. A ratio is what the tool needs divided by what the checker needs, so more than
/// 1 is in the checker's favour.
fn show(tools: &[Tool]) {
    let ours = &tools[0].runs;
    println!(
        "| tool | verdict | states | seconds | MB resident | MB by its own report | bytes/state | states/s | time / imrs | memory / imrs |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for Tool { name, runs, .. } in tools {
        let first = runs[0];
        assert!(
            runs.iter().all(|run| run.states == first.states && run.holds == first.holds),
            "{name}: {runs:?}"
        );
        assert_eq!(first.holds, ours[0].holds, "{name} has another verdict");
        let seconds = median(runs.iter().map(|run| run.seconds));
        let megabytes = median(runs.iter().map(|run| run.megabytes));
        let time = median(runs.iter().zip(ours).map(|(run, ours)| run.seconds / ours.seconds));
        let memory = median(runs.iter().zip(ours).map(|(run, ours)| run.megabytes / ours.megabytes));
        let states = first.states as f64;
        println!(
            "| {name} | {} | {} | {seconds:.3} | {megabytes:.1} | {} | {:.0} | {:.0} | {time:.2} | {memory:.2} |",
            if first.holds { "holds" } else { "fails" },
            first.states,
            first.said_megabytes.map_or_else(|| "-".into(), |said| format!("{said:.1}")),
            megabytes * 1024.0 * 1024.0 / states,
            states / seconds,
        );
    }
}
