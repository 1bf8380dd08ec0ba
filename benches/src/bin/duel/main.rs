//! The stale-command duel: one stream of commands through the runtime, zenoh and libzmq, under the same loss, pauses and
//! load. `specs/duel.md` says what it compares, and what not.

mod contestants;
mod ends;
mod hosts;

use clap::Parser;
use contestants::Contestant;
use ends::{BEGINS, LISTENS};
use hosts::Cable;
use imrs_bench::duel::{HEAD, Tally};
use imrs_bench::machine::Facts;
use imrs_bench::report;
use rustix::process::{Pid, Signal, kill_process};
use std::error::Error;
use std::fmt::Write;
use std::io::{BufRead, BufReader, Lines};
use std::path::PathBuf;
use std::process::{Child, ChildStdout, Command};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Send one stream of commands through the runtime, zenoh and libzmq, and count the stale ones that are executed.
#[derive(Debug, Parser)]
#[command(name = "imrs-duel", version)]
struct Cli {
    /// How long each stream lasts, in seconds.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=600))]
    seconds: u64,
    /// How many streams each contestant sends under each conditions, in turns with the others.
    #[arg(long, default_value_t = 2)]
    rounds: u64,
    /// The number from which the losses and the times of the pauses are drawn.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Let only contestants take part that have this text in their names.
    #[arg(long, default_value = "")]
    only: String,
    /// Renew the table between the marks of a page.
    #[arg(long, value_name = "FILE")]
    write: Option<PathBuf>,
    /// Be one end of a stream: `command` or `execute`.
    #[arg(long, hide = true)]
    end: Option<String>,
}

/// The conditions of a stream.
struct Conditions {
    name: &'static str,
    /// How many of a hundred packets are lost, in each direction.
    loss: u8,
    pauses: bool,
    load: bool,
}

const CONDITIONS: [Conditions; 5] = [
    Conditions { name: "none", loss: 0, pauses: false, load: false },
    Conditions { name: "loss", loss: 5, pauses: false, load: false },
    Conditions { name: "pauses", loss: 0, pauses: true, load: false },
    Conditions { name: "load", loss: 0, pauses: false, load: true },
    Conditions { name: "loss, pauses, load", loss: 5, pauses: true, load: true },
];

/// How long the executor is stopped, once in each second.
const PAUSE: Duration = Duration::from_millis(200);
/// How many busy loops run for each core.
const LOOPS: usize = 2;
/// How long the executor goes on after the stream, so that commands that wait are executed or dropped.
const DRAIN: Duration = Duration::from_secs(1);

fn main() -> Result<(), Box<dyn Error>> {
    let cli = Cli::parse();
    let length = Duration::from_secs(cli.seconds);
    if let Some(end) = &cli.end {
        let contestant = contestants::ALL.iter().find(|contestant| contestant.name == cli.only);
        let contestant = contestant.ok_or("there is no such contestant")?;
        if end == "execute" {
            (contestant.execute)();
        } else {
            (contestant.command)(length);
        }
        return Ok(());
    }
    let facts = Facts::now();
    let takes_part = |contestant: &&Contestant| contestant.name.contains(&cli.only);
    let mut rows = String::new();
    for conditions in &CONDITIONS {
        let mut tallies: Vec<(&Contestant, Tally)> =
            contestants::ALL.iter().filter(takes_part).map(|one| (one, Tally::default())).collect();
        for round in 0..cli.rounds {
            for (contestant, tally) in &mut tallies {
                eprintln!("{}, round {}: {}", conditions.name, round + 1, contestant.name);
                tally.add(&stream(contestant, conditions, length, cli.seed + round)?);
            }
        }
        for (contestant, tally) in tallies {
            writeln!(rows, "| {} | {} | {} |", conditions.name, contestant.name, tally.columns())?;
        }
    }
    let how =
        format!("Measured {}; {} rounds of {} s, seed {}.", facts.line(), cli.rounds, cli.seconds, cli.seed);
    let table = format!("{how}\n\n{HEAD}{rows}");
    print!("{table}");
    if let Some(page) = &cli.write {
        report::renew_page(page, &table)?;
    }
    Ok(())
}

/// One end of a stream. Dropping this value kills its process.
struct End {
    process: Child,
    lines: Lines<BufReader<ChildStdout>>,
}

impl End {
    fn new(mut process: Child) -> Self {
        let output = process.stdout.take().expect("a pipe");
        Self { process, lines: BufReader::new(output).lines() }
    }

    fn line(&mut self) -> Result<String, Box<dyn Error>> {
        Ok(self.lines.next().ok_or("an end of the stream has failed")??)
    }

    /// Reads the next line of the process, and fails if it is another one.
    fn expect(&mut self, line: &str) -> Result<(), Box<dyn Error>> {
        let said = self.line()?;
        if said == line { Ok(()) } else { Err(format!("`{said}` came instead of `{line}`").into()) }
    }
}

impl Drop for End {
    fn drop(&mut self) {
        // A process that has ended already cannot be killed.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Sends one stream under these conditions.
fn stream(
    contestant: &Contestant,
    conditions: &Conditions,
    length: Duration,
    seed: u64,
) -> Result<Tally, Box<dyn Error>> {
    let seconds = length.as_secs().to_string();
    let own = std::env::current_exe()?;
    let end = |name| {
        let mut command = Command::new(&own);
        command.args(["--only", contestant.name, "--seconds", &seconds, "--end", name]);
        command
    };
    let (executor, far) = hosts::start(true, &mut end("execute"))?;
    let mut executor = End::new(executor);
    executor.expect(LISTENS)?;
    let (commander, near) = hosts::start(false, &mut end("command"))?;
    let mut commander = End::new(commander);
    let cable = Cable::new([near, far], seed);
    commander.expect(BEGINS)?;
    let pid = Pid::from_child(&executor.process);
    let sent = under(conditions, &cable, pid, seed, || commander.line())?;
    thread::sleep(DRAIN);
    executor.process.kill()?;
    let mut tally = Tally { sent: sent.parse()?, length, executions: Vec::new() };
    for line in executor.lines.by_ref() {
        let line = line?;
        let (number, age) = line.split_once(' ').ok_or("an execution has a number and an age")?;
        tally.executions.push((number.parse()?, age.parse()?));
    }
    Ok(tally)
}

/// Causes the conditions (loss, pauses, load) while `work` runs.
fn under<T>(conditions: &Conditions, cable: &Cable, executor: Pid, seed: u64, work: impl FnOnce() -> T) -> T {
    let over = AtomicBool::new(false);
    let is_over = || over.load(Ordering::Relaxed);
    thread::scope(|scope| {
        cable.lose(conditions.loss);
        if conditions.pauses {
            scope.spawn(|| pause(executor, fastrand::Rng::with_seed(seed), is_over));
        }
        if conditions.load {
            for _ in 0..LOOPS * thread::available_parallelism().map_or(1, usize::from) {
                scope.spawn(|| {
                    while !is_over() {
                        std::hint::spin_loop();
                    }
                });
            }
        }
        let done = work();
        over.store(true, Ordering::Relaxed);
        cable.lose(0);
        done
    })
}

/// Stops the executor once in each second, at a random time.
fn pause(executor: Pid, mut draws: fastrand::Rng, is_over: impl Fn() -> bool) {
    let mut second = Instant::now();
    while !is_over() {
        let before = (Duration::from_secs(1) - PAUSE).mul_f64(draws.f64());
        thread::sleep((second + before).saturating_duration_since(Instant::now()));
        // The process is a child of this program and was not waited for, so its process id is not in use again.
        let _ = kill_process(executor, Signal::STOP);
        thread::sleep(PAUSE);
        let _ = kill_process(executor, Signal::CONT);
        second += Duration::from_secs(1);
        thread::sleep(second.saturating_duration_since(Instant::now()));
    }
}
