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
#[cfg(feature = "zenoh")]
mod zenoh;

pub use bench::BenchArgs;
pub use cell::{CheckArgs, ExplainArgs, FmtArgs, GraphArgs, Picture};
pub use export::{ExportArgs, ExportForm};
pub use keygen::KeygenArgs;
pub use monitor::MonitorArgs;
pub use run::{DemoArgs, LaunchArgs, ReplayArgs, RunArgs, SummaryArgs};
pub use simulate::{STEPS, SimulateArgs};
pub use unit::UnitArgs;
pub use verify::{CellFaultArgs, Times, VerifyArgs, VerifyVerb};
#[cfg(feature = "zenoh")]
pub use zenoh::ZenohArgs;

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
    /// The verb: what the program is to do.
    #[command(subcommand)]
    pub verb: Option<Verb>,
    /// The flags of `verify`, for when no verb is given.
    #[command(flatten)]
    pub verify: VerifyArgs,
}

/// The verbs.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Try every order of events in a cell, within stated bounds; without a cell, check the protocol's claims.
    ///
    /// With a cell file, the scripts of that cell are checked, first without faults, then with the faults that the cell
    /// declares. A finding is a deadlock, a wait that nothing can end, a task that ends badly, or a check that does not
    /// hold. Each finding has its line and the shortest path to it. If a search ends before it has covered everything,
    /// the answer says so.
    ///
    /// Without a cell file, the protocol's claims are checked. Each claim has an expected outcome: under the decided
    /// rules it holds, and under each rejected reading of the paper it fails, with a shortest counterexample. A run
    /// succeeds if every outcome is the expected one.
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
    /// Run a cell at random on the protocol's state machine, with faults drawn from those that the cell declares.
    ///
    /// This is for cells that are too large for `imrs verify`, and for longer runs than its search reaches. Each seed
    /// is one run: it decides which packets are lost, when nodes stop and how long actions take. A run with a finding
    /// is shrunk to the fewest faults and choices that show the finding. If no run has a finding, that proves nothing
    /// about other runs.
    ///
    /// With --plan a file gives the faults. If --save wrote the file, it also gives the choices; otherwise each seed
    /// draws its own choices. In such a file, times are counted from the start, and packets and actions from 1.
    #[command(after_help = "\
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
  imrs simulate cell.cell --format json | jq '.findings[].again'")]
    Simulate(SimulateArgs),
    /// Compile a cell file and say everything that can be known without running it.
    #[command(after_help = "\
Examples:
  imrs check examples/beam_lift.cell
  imrs check --paper cell.cell               only the paper's keywords and its literal rules
  imrs check cell.cell --format json | jq '.diagnostics[].code'
  imrs check --load cell.cell                the traffic on each link, by rates and time_outs
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
    /// Make the keys with which the nodes of a cell encrypt and authenticate their packets.
    ///
    /// Each node gets a file with its own key, the public keys of the other nodes, and a key of the cell. Nodes whose
    /// keys were made together can communicate; no other process can read, forge or repeat their packets. The files are
    /// secret: keep each file on the machine of its node only. To replace keys, make all of them anew and start all
    /// nodes again.
    #[command(after_help = "\
Examples:
  imrs keygen cell.cell                   into the folder cell.keys
  imrs run cell.cell --node nl            with the keys in that folder
  imrs run cell.cell --node nl --keys /etc/imrs/cell")]
    Keygen(KeygenArgs),
    /// Run a cell, one process per node over loopback UDP.
    ///
    /// The cell's actions are simulated: each takes a time from its interval, and the same --seed gives the same times.
    /// With --action an action executes a command instead, without a shell: the action's arguments follow the command's
    /// own. Exit code 0 means success, and the first line of standard output is the result. A command is killed, with
    /// everything that it started, when the action is cut short or takes 2 s longer than declared, when the lease of
    /// the task ends, and when the node ends, for whatever reason. What a command has started is also killed when the
    /// command itself ends. The command's environment has IMRS_DEADLINE_US (the instant by which the command must have
    /// ended, in microseconds of CLOCK_BOOTTIME) and, under a lease, IMRS_EPOCH. Its standard input gets a line
    /// `deadline N` at once and at each renewal of the lease. When its standard input ends, the command must stop.
    ///
    /// The cell's checks (`never`, `always`, `leads`) are judged by what happens in the run. A check that does not hold
    /// is reported with its line and values, and the exit code is 1. With --node only checks about tasks of that node
    /// are judged. If evidence is missing, the answer is `incomplete`, with exit code 5: for example, a check has a
    /// task that reported nothing, or a node could not report everything.
    ///
    /// A run ends when all of its tasks have ended. A task that serves for ever (`loop` without `exit`, or handlers
    /// only) keeps the run going. When only such tasks are left, imrs says so, and with --until-idle the run ends.
    ///
    /// The run does not wait for a slow reader of its output: lines that the reader does not take in time are left out
    /// and counted. Only the summary waits for the reader, for at most 5 s; a second Ctrl-C ends that wait.
    ///
    /// With --node only one node of the cell runs here, at the address that the cell declares for it (`node n at
    /// "10.0.0.11" port 7000;`), and sends to the other nodes at their declared addresses. The node stores its
    /// incarnation in $XDG_STATE_HOME/imrs. It takes the keys that `imrs keygen` made, so that no other process can
    /// read or forge its packets. Without --node the run makes its own keys, and forgets them at its end.
    ///
    /// With --rt the nodes run under SCHED_FIFO with their memory locked, each on one core. If the kernel refuses a
    /// part of this, the nodes run without that part: imrs reports it once, and the monitor shows `NO RT`.
    #[command(after_help = "\
Examples:
  imrs run examples/beam_lift.cell                    until Ctrl-C
  imrs run cell.cell --for 10s --in-process           in one process
  imrs run cell.cell --until-idle                     until only servers are left
  imrs run cell.cell --loss 10% --kill hoist@2s       with faults
  imrs run cell.cell --kill hoist@2s --restart hoist@3s  and started again
  imrs run cell.cell --node nl --rt                   one node, on its robot
  imrs run cell.cell --node nl --report nl.json       to `imrs summary cell.cell *.json`
  imrs run cell.cell --observe 0.0.0.0:7100 --observe-token FILE  watched over TCP, by who has the file
  imrs run cell.cell --action 'grip=./grip --hard'    a robot's own command
  imrs run cell.cell --record run.imrs                to `imrs replay run.NODE.imrs --cell cell.cell`")]
    Run(RunArgs),
    /// Make one summary of a cell whose nodes ran on several machines.
    ///
    /// Each machine runs its node with `imrs run CELL --node NAME --report FILE`. Copy the files to one machine, and name all of them
    /// here. If a node was started several times, each start has a file.
    ///
    /// The summary and the exit code are those of a run on one machine, with two differences: the machines share no clock, so
    /// there is no start skew, and a check about tasks of several machines is not judged. Then, or if a node has no report, the answer
    /// is `incomplete`, with exit code 5.
    #[command(after_help = "\
Examples:
  imrs run line.cell --node feeding --report feeding.json      on each machine, with its node
  imrs summary line.cell feeding.json pressing.json watching.json
  imrs summary line.cell *.json --format json | jq '.commands'")]
    Summary(SummaryArgs),
    /// Print a systemd unit that runs one node of a cell, and starts it again after a failure or a reboot.
    ///
    /// The unit runs this program with `run CELL --node NAME` and the options behind `--`, as the user of --user. `imrs
    /// run` reports to systemd when its node is up, and then sends pings. If the node is silent for 3 s, systemd starts
    /// it again, in its next incarnation. When the unit is stopped, the node ends its tasks in order. The data that the
    /// node must keep is in /var/lib/imrs, and the sockets for monitors are in /run/imrs.
    ///
    /// The unit is printed only if the cell, the options and the keys pass the checks of `imrs run`. So run this verb
    /// on the machine of the node.
    #[command(after_help = "\
Examples:
  imrs unit /etc/imrs/line.cell --node feeding
  imrs unit line.cell --node feeding --user robot -- --rt --action 'pick=./pick --gently'
  imrs unit line.cell --node feeding | sudo tee /etc/systemd/system/imrs-line-feeding.service
  sudo systemctl daemon-reload && sudo systemctl enable --now imrs-line-feeding")]
    Unit(UnitArgs),
    /// Run a built-in cell with a fault, one process per node over loopback UDP, and explain what happened.
    ///
    /// Every demo injects a fault of its own at the worst moment. A demo ends with an explanation of the outcome, and
    /// with exit code 1 if the promise of the demo was not kept. It takes all flags of `run`. If you give faults
    /// yourself, they replace the demo's own fault.
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
    /// Watch the nodes that run on this machine: which task waits for which, and how long it can still wait.
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
    /// Run the recorded inputs of a node through the state machine again, and compare every output.
    ///
    /// A recording that was cut off, or that misses inputs, is judged as far as it goes. If nothing differs up to
    /// there, the answer is `incomplete`, with exit code 5. With --model the answer is also `incomplete` if a node was
    /// restarted (the model follows a node only up to its end), or if nodes acted late and there are more ways to round
    /// their times than were tried.
    #[command(after_help = "\
Examples:
  imrs demo beam-lift --record run.imrs
  imrs replay run.nl.imrs
  imrs replay run.*.imrs --cell cell.cell --model    was this run a path of the model?")]
    Replay(ReplayArgs),
    /// Convert a recording of `imrs monitor` for other tools: MCAP, lines of JSON, a sequence chart, an asciicast.
    #[command(after_help = "\
Examples:
  imrs monitor --record run.imrs --for 30s
  imrs export run.imrs --to mcap                     Foxglove and PlotJuggler open run.mcap
  imrs export run.imrs --to jsonl -o - | jq 'select(.event == \"timed out\")'
  imrs export run.imrs --to svg --last 200           a sequence chart
  imrs export run.imrs --to asciicast --keys 3       the rendezvous, as the screen showed them")]
    Export(ExportArgs),
    /// Measure the runtime on this machine, side by side with hand-written baselines.
    ///
    /// The default build leaves this out: `cargo run --release --features bench -- bench` builds it and measures.
    ///
    /// Cases are measured in turns, round by round, and only ratios of values from one round are judged, because times
    /// on a shared machine vary by a factor of two. The package `imrs-bench` also measures channels, actors and links
    /// of other libraries.
    #[command(after_help = "\
Examples:
  imrs bench --quick                         that it runs: half a minute
  imrs bench threads network --rounds 15     hand-overs between threads and nodes
  imrs bench --format json > ratios.json; imrs bench --list")]
    Bench(BenchArgs),
    /// Carry the datagrams of a node over zenoh, to machines that one network does not reach.
    ///
    /// The cell declares each node at a port of 127.0.0.1. On each machine the node takes its own port, and the
    /// gateway takes the ports of the node's neighbours. The nodes' keys protect the datagrams from one node to the other: the gateway has no
    /// keys. Zenoh may drop or delay a datagram; a late one is dropped by its receiver.
    #[cfg(feature = "zenoh")]
    #[command(after_help = "\
Examples:
  imrs zenoh cell.cell --node arm
  imrs zenoh cell.cell --node arm --config zenoh.json5")]
    Zenoh(ZenohArgs),
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
        /// The verb of the manual page [default: the page of the whole command].
        #[arg(value_name = "VERB")]
        verb: Option<String>,
    },
    /// Run one node of a cell, as ordered on standard input. The launcher starts this program again with this verb.
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
            // The terminal wraps each paragraph, so a line break inside one would make ragged lines.
            let about = verb.get_long_about().map(ToString::to_string).unwrap_or_default();
            assert!(
                !about.replace("\n\n", "").contains('\n'),
                "`{}` breaks a paragraph into lines",
                verb.get_name()
            );
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
