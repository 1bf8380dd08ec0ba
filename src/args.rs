//! The command line: what can be asked for, and how it is explained.

use crate::demo::Scene;
use crate::launch::{ActionCommand, Cut, Kill, Rate, Restart};
use clap::{Args, ColorChoice, Parser, Subcommand, ValueEnum};
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::time::Duration;

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
4 out of the given budget with a partial answer, 70 an internal fault."
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
    /// vain, tasks that end badly, checks that do not hold: each on its line, with the shortest way there. A search
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
  imrs verify cell.cell --save found.imrs    then `imrs monitor --replay found.imrs`
  imrs verify --full --memory 8G     the large bounds
  imrs verify --format json | jq '.claims[] | select(.as_expected | not)'")]
    Verify(VerifyVerb),
    /// Compile a cell file and say everything that can be known without running it.
    #[command(after_help = "\
Examples:
  imrs check examples/beam_lift.cell
  imrs check --paper cell.cell               only the paper's words and its literal rules
  imrs check cell.cell --format json | jq '.diagnostics[].code'
  imrs explain E104                          what a code means, with examples

A cell with warnings ends with 0, one with errors with 1, a file that cannot be read with 2.")]
    Check(CheckArgs),
    /// Write cell files the one way: indentation, spaces, small letters, one spelling of each option.
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
    /// Run a cell, one process per node over loopback UDP.
    ///
    /// What the cell calls actions is simulated: each takes a time of its interval, the same under the same --seed. An
    /// action bound by --action is a command to execute: the action's arguments follow the command's own, without a
    /// shell; exit code 0 is success, the first line of standard output the result.
    ///
    /// With --node one node of the cell runs here, at the address that the cell declares for it (`node n at "10.0.0.11"
    /// port 7000;`), and sends to the others at theirs. Which of its lives this is it remembers in
    /// $XDG_STATE_HOME/imrs. Nothing authenticates packets yet: off the loopback that takes --insecure.
    ///
    /// With --rt the nodes run under SCHED_FIFO with their memory locked; a kernel that does not allow it is an error.
    #[command(after_help = "\
Examples:
  imrs run examples/beam_lift.cell                    until Ctrl-C
  imrs run cell.cell --for 10s --in-process           in one process
  imrs run cell.cell --loss 10% --kill hoist@2s       with faults
  imrs run cell.cell --kill hoist@2s --restart hoist@3s  and started again
  imrs run cell.cell --node nl --insecure --rt        one node, on its robot
  imrs run cell.cell --observe 127.0.0.1:7100         watched over TCP, too
  imrs run cell.cell --action 'grip=./grip --hard'    a robot's own command
  imrs run cell.cell --record run.imrs                to `imrs replay run.NODE.imrs --cell cell.cell`")]
    Run(RunArgs),
    /// Run a built-in cell with a fault, one process per node over loopback UDP, and explain what happened.
    ///
    /// Every demo brings a fault of its own, at the moment when it hurts. It ends with what came of it, in words, and
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
  imrs demo beam-lift --kill hoist@2s        with a node killed: nobody starts without it
  imrs demo failover-weld --cut n1--nt@2s+1s with a link interrupted

While it runs, `imrs monitor` in another terminal shows the nodes.")]
    Demo(DemoArgs),
    /// Watch the nodes that run on this machine: who waits for whom, and how long they still can.
    #[command(after_help = "\
Examples:
  imrs monitor                          the nodes that run on this machine
  imrs monitor --once --format json     one sample, for programs
  imrs monitor --connect unix:/run/user/1000/imrs/beam_lift/nl-812.sock
  imrs monitor --record run.imrs --for 60s     without a screen
  imrs monitor --replay run.imrs --at -30s --speed 4
  imrs verify cell.cell --save found.imrs; imrs monitor --replay found.imrs")]
    Monitor(MonitorArgs),
    /// Run the state machine again on what a node recorded, and compare every output.
    #[command(after_help = "\
Examples:
  imrs demo beam-lift --record run.imrs
  imrs replay run.nl.imrs
  imrs replay run.*.imrs --cell cell.cell --model    was this run a path of the model?")]
    Replay(ReplayArgs),
    /// Measure the runtime on this machine, side by side with hand-written floors.
    ///
    /// Cases are measured in turns, round by round, and only ratios of one round are judged: times of a shared machine move
    /// by a factor of two. The package `imrs-bench` adds the channels, actors and links that people would pick instead.
    #[command(after_help = "\
Examples:
  imrs bench --quick                         that it runs: half a minute
  imrs bench threads network --rounds 15     hand-overs between threads and nodes
  imrs bench --format json > ratios.json; imrs bench --list")]
    Bench(imrs_bench::BenchArgs),
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
    /// Run one node of a cell, as told on standard input. The launcher starts itself with this.
    #[command(hide = true)]
    Node,
}

/// What `verify` can be asked: about the protocol, or about a cell.
#[derive(Args, Clone, Debug)]
pub struct VerifyVerb {
    /// The cell file; without one the protocol's own claims are checked.
    #[arg(value_name = "CELL", conflicts_with_all = ["full", "claim", "explore"])]
    pub cell: Option<PathBuf>,
    /// The flags of both.
    #[command(flatten)]
    pub verify: VerifyArgs,
    /// The flags of a cell.
    #[command(flatten)]
    pub faults: CellFaultArgs,
}

/// Faults beside those that a cell declares, and what to do with what is found.
#[derive(Args, Clone, Debug)]
pub struct CellFaultArgs {
    /// Lose so many more packets than the cell declares.
    #[arg(long, value_name = "N", requires = "cell", default_value_t = 0)]
    pub loss: u8,
    /// Deliver so many more packets twice.
    #[arg(long, value_name = "N", requires = "cell", default_value_t = 0)]
    pub dup: u8,
    /// Let packets overtake the one before them on their link so many times [default: 1].
    #[arg(long, value_name = "N", requires = "cell", num_args = 0..=1, default_value_t = 0, default_missing_value = "1")]
    pub reorder: u8,
    /// Let this node, or the node of this task, crash once.
    #[arg(long, value_name = "NAME", requires = "cell")]
    pub crash: Vec<String>,
    /// Allow only the words of the paper, and check its own rules.
    #[arg(long, requires = "cell")]
    pub paper: bool,
    /// Let clocks leave out or count twice so many more ticks.
    #[arg(long, value_name = "N", requires = "cell", default_value_t = 0)]
    pub drift: u8,
    /// Give up after so long without faults, and after so long with them.
    #[arg(long, value_name = "TIME", requires = "cell", default_value = "30s", value_parser = humantime::parse_duration)]
    pub within: Duration,
    /// Draw a finding as a sequence chart into this file.
    #[arg(long, value_name = "FILE.svg", requires = "cell")]
    pub trace: Option<PathBuf>,
    /// Save a finding as a recording that `imrs monitor --replay FILE` shows step by step.
    #[arg(long, value_name = "FILE", requires = "cell")]
    pub save: Option<PathBuf>,
    /// Which finding is drawn and saved, counted from 1 [default: the first that steps lead to].
    #[arg(long, value_name = "N", requires = "cell", value_parser = clap::value_parser!(u16).range(1..))]
    pub finding: Option<u16>,
}

/// What `verify` can be asked.
#[derive(Args, Clone, Debug, Default, PartialEq, Eq)]
pub struct VerifyArgs {
    /// Check the large bounds instead of the smoke bounds.
    #[arg(long)]
    pub full: bool,
    /// Check this claim only, and show its counterexamples in full.
    #[arg(long, value_name = "NAME")]
    pub claim: Option<String>,
    /// Serve the claim's first world to a browser, to walk through by hand: on this machine only.
    #[arg(long, value_name = "HOST:PORT", requires = "claim", value_parser = loopback)]
    pub explore: Option<SocketAddr>,
    /// Use so many threads [default: as many as there are cores].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub jobs: Option<u16>,
    /// Give up a claim that needs more memory than this [default: 4G].
    #[arg(long, value_name = "SIZE", value_parser = memory)]
    pub memory: Option<u64>,
    /// The form of the answer [default: text].
    #[arg(long, value_enum, value_name = "FORM")]
    pub format: Option<Format>,
}

/// What `check` can be asked.
#[derive(Args, Clone, Debug)]
pub struct CheckArgs {
    /// The cell file; `-` is standard input.
    #[arg(value_name = "CELL")]
    pub cell: PathBuf,
    /// Allow only the words of the paper, and look at its own rules.
    #[arg(long)]
    pub paper: bool,
    /// The form of the answer.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Format::Text)]
    pub format: Format,
}

/// What `fmt` can be asked.
#[derive(Args, Clone, Debug)]
pub struct FmtArgs {
    /// The cell files; `-` is standard input, written to standard output.
    #[arg(value_name = "CELL", required = true)]
    pub cells: Vec<PathBuf>,
    /// Change nothing; say what would be changed.
    #[arg(long)]
    pub check: bool,
}

/// What `explain` can be asked.
#[derive(Args, Clone, Debug)]
pub struct ExplainArgs {
    /// The code [default: list them all].
    #[arg(value_name = "CODE")]
    pub code: Option<String>,
    /// The form of the answer.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Format::Text)]
    pub format: Format,
}

/// What `graph` can be asked.
#[derive(Args, Clone, Debug)]
pub struct GraphArgs {
    /// The cell file; `-` is standard input.
    #[arg(value_name = "CELL")]
    pub cell: PathBuf,
    /// The form of the picture.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Picture::Svg)]
    pub to: Picture,
}

/// What `demo` can be asked.
#[derive(Args, Clone, Debug)]
pub struct DemoArgs {
    /// Which cell.
    #[arg(value_enum, value_name = "NAME")]
    pub cell: Scene,
    /// Run without the demo's own fault; faults of your own take its place, too.
    #[arg(long)]
    pub no_fault: bool,
    /// How it is run.
    #[command(flatten)]
    pub launch: LaunchArgs,
}

/// What `run` can be asked.
#[derive(Args, Clone, Debug)]
pub struct RunArgs {
    /// The cell.
    #[arg(value_name = "CELL")]
    pub cell: PathBuf,
    /// Allow only the words of the paper, and run its own rules.
    #[arg(long)]
    pub paper: bool,
    /// Execute a command for an action; may be given several times.
    #[arg(long, value_name = "NAME=CMD")]
    pub action: Vec<ActionCommand>,
    /// How it is run.
    #[command(flatten)]
    pub launch: LaunchArgs,
}

/// How a cell is run.
#[derive(Args, Clone, Debug)]
pub struct LaunchArgs {
    /// Run all nodes in this process, joined without sockets.
    #[arg(long, conflicts_with = "node")]
    pub in_process: bool,
    /// Run this node only, at the address that the cell declares; the others run elsewhere.
    #[arg(long, value_name = "NAME")]
    pub node: Option<String>,
    /// Let packets leave this machine though nothing authenticates them, and let others watch.
    #[arg(long)]
    pub insecure: bool,
    /// Serve monitors over TCP, too; of several nodes each takes the next port.
    #[arg(long, value_name = "ADDR:PORT")]
    pub observe: Option<SocketAddr>,
    /// Run the nodes under SCHED_FIFO, with their memory locked.
    #[arg(long)]
    pub rt: bool,
    /// How long to run [default: a demo about 10s, a cell until its tasks end or Ctrl-C].
    #[arg(long = "for", value_name = "TIME", value_parser = humantime::parse_duration)]
    pub length: Option<Duration>,
    /// Lose this share of all datagrams.
    #[arg(long, value_name = "RATE", default_value = "0%")]
    pub loss: Rate,
    /// Kill a node, or the node of a task, after a while.
    #[arg(long, value_name = "NAME@TIME")]
    pub kill: Vec<Kill>,
    /// Start a killed node again after a while (counted from the start), in its next life.
    #[arg(long, value_name = "NAME@TIME")]
    pub restart: Vec<Restart>,
    /// Interrupt the link between two nodes after a while, for a while.
    #[arg(long, value_name = "A--B@TIME+TIME")]
    pub cut: Vec<Cut>,
    /// Record what goes into every communication task; each node writes a file of its own beside this name.
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
    /// Seeds the lost packets and the lengths of the tasks' work [default: from the clock].
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// The form of the answer; JSON ends with one line, the summary.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Format::Text)]
    pub format: Format,
}

/// What `monitor` can be asked.
#[derive(Args, Clone, Debug)]
pub struct MonitorArgs {
    /// Attach to this node; may be given several times [default: all nodes on this machine].
    #[arg(long, short, value_name = "ADDR")]
    pub connect: Vec<imrs_monitor::Endpoint>,
    /// Show only the cell of this name.
    #[arg(long, value_name = "NAME")]
    pub cell: Option<String>,
    /// Print one sample and end.
    #[arg(long)]
    pub once: bool,
    /// Print a sample every so often.
    #[arg(long, value_name = "TIME", value_parser = humantime::parse_duration)]
    pub watch: Option<Duration>,
    /// Print lines instead of drawing a screen: for pipes and screen readers.
    #[arg(long)]
    pub text: bool,
    /// Draw with nothing but ASCII.
    #[arg(long)]
    pub ascii: bool,
    /// Show a recording instead of running nodes: of `--record`, or a finding of `imrs verify CELL --save`.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["connect", "watch", "record"])]
    pub replay: Option<PathBuf>,
    /// Begin here: `3s`, `-30s` (before the end), or a tick of a finding.
    #[arg(long, value_name = "TIME", requires = "replay", allow_hyphen_values = true)]
    pub at: Option<imrs_monitor::At>,
    /// Play so many times as fast; a finding plays a step a second.
    #[arg(long, value_name = "N", requires = "replay", value_parser = speed)]
    pub speed: Option<f64>,
    /// Record what the nodes show; without a terminal, without a screen.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["once", "watch", "text"])]
    pub record: Option<PathBuf>,
    /// Record for so long, without a screen, and end.
    #[arg(long = "for", value_name = "TIME", requires = "record", value_parser = humantime::parse_duration)]
    pub record_for: Option<Duration>,
    /// The form of what is printed; JSON implies printing.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Format::Text)]
    pub format: Format,
}

/// What `replay` can be asked.
#[derive(Args, Clone, Debug)]
pub struct ReplayArgs {
    /// The recordings of nodes.
    #[arg(value_name = "FILE", required = true)]
    pub files: Vec<PathBuf>,
    /// The cell that was run [default: the cell of a demo].
    #[arg(long, value_name = "CELL")]
    pub cell: Option<PathBuf>,
    /// It was run with `--paper`.
    #[arg(long, requires = "cell")]
    pub paper: bool,
    /// Say whether the whole run is a path of the model that `imrs verify` explores: takes the recordings of all nodes.
    #[arg(long, requires = "cell")]
    pub model: bool,
    /// Give up following the model after so long.
    #[arg(long, value_name = "TIME", requires = "model", default_value = "30s", value_parser = humantime::parse_duration)]
    pub within: Duration,
    /// The form of the answer.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Format::Text)]
    pub format: Format,
}

/// The form of an answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// For people.
    #[default]
    Text,
    /// For programs.
    Json,
}

/// The form of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Picture {
    /// For a browser.
    Svg,
    /// For Graphviz.
    Dot,
}

/// When to use colour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Color {
    /// On a terminal, unless NO_COLOR is set.
    #[default]
    Auto,
    /// Always.
    Always,
    /// Never.
    Never,
}

impl From<Color> for anstream::ColorChoice {
    fn from(color: Color) -> Self {
        match color {
            Color::Auto => Self::Auto,
            Color::Always => Self::Always,
            Color::Never => Self::Never,
        }
    }
}

/// What `--color` says, before anything is parsed: help and usage errors obey it too.
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

/// An address that only this machine can reach.
fn loopback(text: &str) -> Result<SocketAddr, String> {
    let example = "write 127.0.0.1:3000 or localhost:3000";
    let mut all = text.to_socket_addrs().map_err(|error| format!("{error}: {example}"))?;
    all.next()
        .filter(|first| first.ip().is_loopback() && all.all(|other| other.ip().is_loopback()))
        .ok_or_else(|| format!("others can reach it, and nobody is asked who they are: {example}"))
}

/// How many times as fast.
fn speed(text: &str) -> Result<f64, String> {
    let speed = text.trim_end_matches('x').parse::<f64>().ok();
    speed
        .filter(|speed| (0.001..=1000.0).contains(speed))
        .ok_or_else(|| "write a number from 0.001 to 1000".to_owned())
}

/// A size in bytes: `512M`, `4G`; units are powers of 1024.
fn memory(text: &str) -> Result<u64, String> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let shift = match &text[digits.len()..] {
        "" | "B" => 0,
        "K" | "KiB" => 10,
        "M" | "MiB" => 20,
        "G" | "GiB" => 30,
        "T" | "TiB" => 40,
        unit => return Err(format!("unknown unit `{unit}`: write 512M or 4G")),
    };
    let number: u64 = digits.parse().map_err(|_| "write a whole number and a unit: 512M or 4G".to_owned())?;
    number.checked_mul(1 << shift).filter(|&bytes| bytes > 0).ok_or_else(|| "out of range".to_owned())
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
    fn only_this_machine_explores() {
        assert_eq!(loopback("127.0.0.1:3000").map(|address| address.port()), Ok(3000));
        assert!(loopback("[::1]:0").is_ok());
        for text in ["0.0.0.0:3000", "192.0.2.1:80", "127.0.0.1", "3000", ""] {
            assert!(loopback(text).is_err(), "{text}");
        }
    }

    #[test]
    fn sizes_have_units() {
        assert_eq!((memory("4G"), memory("512M"), memory("7")), (Ok(4 << 30), Ok(512 << 20), Ok(7)));
        for text in ["", "G", "4X", "-1G", "0", "99999999999T"] {
            assert!(memory(text).is_err(), "{text}");
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
