//! The command line: its verbs, options and help texts.

mod bench;
mod cell;
mod export;
mod keygen;
mod monitor;
mod run;
mod simulate;
mod unit;
mod verify;

pub use bench::BenchArgs;
pub use cell::{CheckArgs, ExplainArgs, FmtArgs, GraphArgs, Picture};
pub use export::{ExportArgs, ExportForm};
pub use keygen::KeygenArgs;
pub use monitor::MonitorArgs;
pub use run::{DemoArgs, LaunchArgs, ReplayArgs, RunArgs};
pub use simulate::{STEPS, SimulateArgs};
pub use unit::UnitArgs;
pub use verify::{CellFaultArgs, Times, VerifyArgs, VerifyVerb};

use crate::output::Color;
use clap::{ColorChoice, Parser, Subcommand, ValueEnum};

/// Write a multi-robot cell once, check it exhaustively, run exactly that code, watch it live.
///
/// Without a verb, imrs checks the protocol's claims (`imrs verify`).
#[derive(Debug, Parser)]
#[command(
    name = "imrs",
    version,
    after_help = "\
Examples:
  imrs                               check the protocol's claims: under a minute
  imrs check examples/beam_lift.cell say what is wrong with a cell
  imrs demo beam-lift                three nodes, a link that fails in mid lift
  imrs demo failover-weld            a robot whose node dies, and the one that takes over
  imrs monitor                       watch the nodes that run on this machine

Exit codes: 0 all well, 1 a finding, 2 bad input or usage, 3 nothing to attach to,
4 out of the given budget with a partial answer, 5 evidence is missing: nothing found, not
everything judged, 6 nothing found, but links were faulty or datagrams of others came,
70 an internal fault, 71 the system has no memory, file descriptor or thread left."
)]
pub struct Cli {
    /// When to use colour; NO_COLOR is honoured.
    #[arg(long, global = true, value_enum, default_value_t = Color::Auto, value_name = "WHEN")]
    pub color: Color,
    /// What to do.
    #[command(subcommand)]
    pub verb: Option<Verb>,
    /// The flags of `verify`, for when no verb is given.
    #[command(flatten)]
    pub verify: VerifyArgs,
}

/// The verbs.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Check the protocol's claims, or a cell, by exhausting every schedule within stated bounds.
    ///
    /// With a cell file: its own scripts, first without faults, then with those that it declares. Deadlocks, waits in
    /// vain, tasks that end badly, checks that do not hold: each on its line, with the shortest path there. A search
    /// that ends before everything was looked at says so.
    ///
    /// Without: every claim has an expectation: the decided rules hold, and each rejected reading of the paper fails with a
    /// shortest counterexample. The verdict of a run is whether everything came out as expected.
    #[command(after_help = "\
Examples:
  imrs verify                        all claims, smoke bounds
  imrs verify --claim no-false-release
  imrs verify --claim pairing --explore localhost:3000
  imrs verify examples/weld_cell.cell  a cell, with the faults that it declares
  imrs verify cell.cell --loss 1 --crash hoist --trace found.svg
  imrs verify cell.cell --pause 1                    any node may stand still for a while
  imrs verify cell.cell --save found.imrs    then `imrs monitor --replay found.imrs`
  imrs verify --full --memory 8G     the large bounds
  imrs verify --format json | jq '.claims[] | select(.as_expected | not)'")]
    Verify(VerifyVerb),
    /// Run a cell at random, on the state machine itself, with faults drawn among those that it declares.
    ///
    /// For cells that are too large for `imrs verify`, and for longer runs than its search reaches. Each seed is one run: which
    /// packets are lost, when nodes stop, how long actions take. What is found is shrunk to the fewest faults and choices that
    /// show it. Nothing found proves nothing.
    ///
    /// --plan takes the faults from a file instead, with choices of each seed, or with those that --save kept in it. Times
    /// are from the start, and packets and actions are counted from 1.
    #[command(
        verbatim_doc_comment,
        after_help = "\
A plan:
  version = 2
  [[fault]]
  lose = 3                   # also: copy, overtake
  link = \"nl -> nr\"
  [[fault]]
  stop = \"nh\"                # also: cut = \"nl -- nr\" with at and lasts
  at = \"120ms\"
  restart_after = \"300ms\"    # without it the node stays down
  [[fault]]
  fail = 2                   # also: drift = \"nh\" with at and tick = \"twice\" or \"missed\"
  task = \"hoist\"
  [[fault]]
  pause = \"nh\"               # with action = \"waits\": an action that it has just begun begins after the pause
  at = \"120ms\"
  lasts = \"300ms\"

Examples:
  imrs simulate examples/weld_cell.cell              1000 runs
  imrs simulate cell.cell --seeds 100000 --seed 1    many, the same each time
  imrs simulate cell.cell --seed 42                  one run, drawn
  imrs simulate cell.cell --save found.toml; imrs simulate cell.cell --plan found.toml
  imrs simulate cell.cell --plan faults.toml --seeds 100
  imrs simulate cell.cell --format json | jq '.findings[].again'"
    )]
    Simulate(SimulateArgs),
    /// Compile a cell file and say everything that can be known without running it.
    #[command(after_help = "\
Examples:
  imrs check examples/beam_lift.cell
  imrs check --paper cell.cell               only the paper's keywords and its literal rules
  imrs check cell.cell --format json | jq '.diagnostics[].code'
  imrs explain E104                          what a code means, with examples

A cell with warnings ends with 0, one with errors with 1, a file that cannot be read with 2.")]
    Check(CheckArgs),
    /// Format cell files: indentation, spaces, small letters, one spelling of each option.
    #[command(after_help = "\
Examples:
  imrs fmt cell.cell                         rewrites the file in place
  imrs fmt --check examples/*.cell           changes nothing; ends with 1 where something would be
  imrs fmt - < cell.cell                     from standard input to standard output")]
    Fmt(FmtArgs),
    /// Explain a code of a diagnostic, with a wrong example and a right one.
    #[command(after_help = "\
Examples:
  imrs explain                               all codes
  imrs explain E104")]
    Explain(ExplainArgs),
    /// Draw a cell: its nodes, their tasks, and who sends what to whom.
    #[command(after_help = "\
Examples:
  imrs graph examples/beam_lift.cell > beam_lift.svg
  imrs graph examples/beam_lift.cell --to dot | dot -Tpdf > beam_lift.pdf")]
    Graph(GraphArgs),
    /// Make the keys with which the nodes of a cell close their packets.
    ///
    /// Each node gets a file with its own key, the public keys of the others, and a key of the cell. Nodes whose keys were made
    /// together can talk; no other process can read what they send, forge it, or repeat it. The files are secret: each belongs
    /// on the machine of its node, and nowhere else. To replace keys, make all of them anew and start all nodes again.
    #[command(after_help = "\
Examples:
  imrs keygen cell.cell                   into the folder cell.keys
  imrs run cell.cell --node nl            with the keys in that folder
  imrs run cell.cell --node nl --keys /etc/imrs/cell")]
    Keygen(KeygenArgs),
    /// Run a cell, one process per node over loopback UDP.
    ///
    /// The cell's actions are simulated: each takes a time from its interval, the same under the same --seed. An action
    /// bound by --action is a command to execute: the action's arguments follow the command's own, without a shell; exit
    /// code 0 is success, the first line of standard output the result. A command is killed, with everything that it
    /// started, when it ends, when its action is cut short or takes 2 s longer than declared, when the lease of its task
    /// ends, and when its node ends, for whatever reason. Its environment has IMRS_DEADLINE_US (by when it must be over,
    /// in microseconds of CLOCK_BOOTTIME) and, under a lease, IMRS_EPOCH. Its standard input has a line `deadline N` at
    /// once and for each renewal; its end means: stop now.
    ///
    /// The cell's checks (`never`, `always`, `leads`) are judged by what the run does. One that does not hold is reported
    /// with its line and values, and ends with exit code 1. With --node only checks about tasks of that node are judged.
    /// Where evidence is missing (a check whose tasks reported nothing, a node that could not report everything), the
    /// answer is `incomplete`, exit code 5.
    ///
    /// A run ends when all of its tasks have. A task that serves for ever (`loop` without `exit`, or handlers only) keeps it going: imrs
    /// says when only such tasks are left, and --until-idle ends the run then.
    ///
    /// The run does not wait for a slow reader: it leaves out lines that come faster than they are read, and counts them.
    /// The summary waits for its reader, for 5 s at most; a second Ctrl-C ends that wait.
    ///
    /// With --node one node of the cell runs here, at the address that the cell declares for it (`node n at "10.0.0.11"
    /// port 7000;`), and sends to the other nodes at theirs. It remembers its incarnation in $XDG_STATE_HOME/imrs.
    /// It takes the keys of `imrs keygen`, so that no other process can read or forge its packets. Without --node the run makes keys
    /// of its own, and forgets them.
    ///
    /// With --rt the nodes run under SCHED_FIFO with their memory locked, each on one core. What the kernel refuses of
    /// that is reported once and shown in the monitor (`NO RT`); the nodes run without it.
    #[command(after_help = "\
Examples:
  imrs run examples/beam_lift.cell                    until Ctrl-C
  imrs run cell.cell --for 10s --in-process           in one process
  imrs run cell.cell --until-idle                     until only servers are left
  imrs run cell.cell --loss 10% --kill hoist@2s       with faults
  imrs run cell.cell --kill hoist@2s --restart hoist@3s  and started again
  imrs run cell.cell --node nl --rt                   one node, on its robot
  imrs run cell.cell --observe 127.0.0.1:7100         watched over TCP, too
  imrs run cell.cell --observe 0.0.0.0:7100 --observe-token FILE  by who has the file
  imrs run cell.cell --action 'grip=./grip --hard'    a robot's own command
  imrs run cell.cell --record run.imrs                to `imrs replay run.NODE.imrs --cell cell.cell`")]
    Run(RunArgs),
    /// Print a systemd unit that runs one node of a cell, and starts it again after a failure or a reboot.
    ///
    /// The unit runs this program with `run CELL --node NAME` and the options behind `--`, as the user `imrs` or the one that
    /// --user names. `imrs run` reports to systemd when its node is up, and then pings it: if the node is silent for 3 s, systemd
    /// starts it again, in its next incarnation. A stop lets the node end its tasks in order. What the node must remember is in
    /// /var/lib/imrs, and the sockets for monitors are in /run/imrs.
    ///
    /// The cell, the options and the keys are checked as `imrs run` checks them, so print the unit on the machine of the node.
    #[command(after_help = "\
Examples:
  imrs unit /etc/imrs/line.cell --node feeding
  imrs unit line.cell --node feeding --user robot -- --rt --action 'pick=./pick --gently'
  imrs unit line.cell --node feeding | sudo tee /etc/systemd/system/imrs-line-feeding.service
  sudo systemctl daemon-reload && sudo systemctl enable --now imrs-line-feeding")]
    Unit(UnitArgs),
    /// Run a built-in cell with a fault, one process per node over loopback UDP, and explain what happened.
    ///
    /// Every demo brings a fault of its own, at the moment when it hurts. It ends with the outcome, in words, and
    /// with 1 where that is not what is promised. It takes all flags of `run`; faults of your own take the place of
    /// the demo's.
    #[command(after_help = "\
Examples:
  imrs demo beam-lift                        a link fails in mid lift: both arms stop
  imrs demo failover-weld                    a robot's node dies: the other takes over
  imrs demo shared-tool                      the holder of a tool dies: another gets it
  imrs demo conveyor                         a camera stands still: nothing old is picked
  imrs demo belt-administrator               two want another speed at once: one gives way
  imrs demo beam-lift --no-fault --for 5s    without any fault
  imrs demo beam-lift --loss 20% --for 30s   with every fifth packet lost
  imrs demo beam-lift --kill hoist@2s        with a node killed: no arm starts without it
  imrs demo failover-weld --cut n1--nt@2s+1s with a link interrupted

While it runs, `imrs monitor` in another terminal shows the nodes.")]
    Demo(DemoArgs),
    /// Watch the nodes that run on this machine: who waits for whom, and how long they still can.
    #[command(after_help = "\
Examples:
  imrs monitor                          the nodes that run on this machine
  imrs monitor --demo                   nodes to look at, where there are none
  imrs monitor --assert 'up>=3 and expired==0' --for 60s    exit code 1 unless that holds
  imrs monitor --once --format json     one sample, for programs
  imrs monitor --connect unix:/run/user/1000/imrs/beam_lift/nl-812.sock
  imrs monitor --connect tcp:robot:7100 --token FILE    the whole cell of that node
  imrs monitor --record run.imrs --for 60s     without a screen
  imrs monitor --replay run.imrs --at -30s --speed 4
  imrs verify cell.cell --save found.imrs; imrs monitor --replay found.imrs")]
    Monitor(MonitorArgs),
    /// Run the state machine again on what a node recorded, and compare every output.
    ///
    /// A recording that was cut off or misses inputs is judged as far as it goes. Where nothing differs there, the answer is
    /// `incomplete`, with exit code 5. So is that of --model where inputs are missing, where a node was restarted (the model
    /// follows a node only up to its end), or where late nodes leave more ways to round times than are tried.
    #[command(after_help = "\
Examples:
  imrs demo beam-lift --record run.imrs
  imrs replay run.nl.imrs
  imrs replay run.*.imrs --cell cell.cell --model    was this run a path of the model?")]
    Replay(ReplayArgs),
    /// Turn a recording of `imrs monitor` into what other tools open: MCAP, lines of JSON, a sequence chart, an asciicast.
    #[command(after_help = "\
Examples:
  imrs monitor --record run.imrs --for 30s
  imrs export run.imrs --to mcap                     Foxglove and PlotJuggler open run.mcap
  imrs export run.imrs --to jsonl -o - | jq 'select(.event == \"timed out\")'
  imrs export run.imrs --to svg --last 200           a sequence chart
  imrs export run.imrs --to asciicast --keys 3       the rendezvous, as the screen showed them")]
    Export(ExportArgs),
    /// Measure the runtime on this machine, side by side with hand-written floors.
    ///
    /// The default build leaves this out: `cargo run --release --features bench -- bench` builds it and measures.
    ///
    /// Cases are measured in turns, round by round, and only ratios of one round are judged: times of a shared machine move
    /// by a factor of two. The package `imrs-bench` adds the channels, actors and links that people would pick instead.
    #[command(after_help = "\
Examples:
  imrs bench --quick                         that it runs: half a minute
  imrs bench threads network --rounds 15     hand-overs between threads and nodes
  imrs bench --format json > ratios.json; imrs bench --list")]
    Bench(BenchArgs),
    /// Print a shell's completion script.
    #[command(
        after_help = "Example:\n  imrs completions bash > ~/.local/share/bash-completion/completions/imrs"
    )]
    Completions {
        /// The shell.
        shell: clap_complete::Shell,
    },
    /// Print a manual page, in roff.
    #[command(after_help = "Examples:\n  imrs man | man -l -\n  imrs man run | man -l -")]
    Man {
        /// The verb that it is of [default: the command].
        #[arg(value_name = "VERB")]
        verb: Option<String>,
    },
    /// Run one node of a cell, as ordered on standard input. The launcher starts itself with this.
    #[command(hide = true)]
    Node,
}

/// The greatest number of threads of `--jobs`: more threads than the machine has cores make nothing faster, and each
/// takes memory.
const MOST_JOBS: i64 = 256;

/// The form of an answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// For people.
    #[default]
    Text,
    /// For programs.
    Json,
}

/// The value of `--color`, read before anything is parsed, because help and usage errors follow it, too.
pub fn early_color(args: impl IntoIterator<Item = String>) -> ColorChoice {
    let mut args = args.into_iter();
    let mut word = None;
    while let Some(arg) = args.next() {
        if arg == "--" {
            break;
        } else if arg == "--color" {
            word = args.next();
        } else if let Some(value) = arg.strip_prefix("--color=") {
            word = Some(value.to_owned());
        }
    }
    match word.as_deref() {
        Some("always") => ColorChoice::Always,
        Some("never") => ColorChoice::Never,
        Some(_) | None => ColorChoice::Auto,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_is_well_formed_and_every_verb_has_an_example() {
        let command = Cli::command();
        command.clone().debug_assert();
        for verb in command.get_subcommands().filter(|verb| !verb.is_hide_set()) {
            let help = verb.get_after_help().map(ToString::to_string).unwrap_or_default();
            assert!(help.contains("Example"), "`{}` shows no example", verb.get_name());
        }
    }

    #[test]
    fn colour_is_known_before_parsing() {
        let early = |text: &str| early_color(text.split(' ').map(str::to_owned));
        assert_eq!(early("imrs verify --color never"), ColorChoice::Never);
        assert_eq!(early("imrs --color=always demo"), ColorChoice::Always);
        assert_eq!(early("imrs -- --color never"), ColorChoice::Auto);
    }
}
