//! The `imrs` command: it reads the command line, calls the crate that has the answer, and prints the answer.
//!
//! A robot's program does not link this package, which brings the model checker and the terminal monitor along. To run
//! nodes of a cell file, it links [`imrs_client`], whose front page is for the author of such a program. To have its
//! cell compiled in, it links `imrs-runtime` and `imrs-macros`. All of `imrs_client` that a program uses is re-exported
//! here: `imrs::Program` is [`imrs_client::Program`].
#![forbid(unsafe_code)]

mod args;
mod bench;
mod cell_file;
mod check;
mod checks;
mod demo;
mod exit;
mod explain;
mod export;
mod failure;
mod faults;
mod fmt;
mod graph;
mod kept;
mod keygen;
mod monitor;
mod names;
mod node;
mod output;
mod panics;
mod replay;
mod run;
mod simulate;
mod summary;
mod time;
mod token;
mod unit;
mod verify;
#[cfg(feature = "zenoh")]
mod zenoh;

pub use imrs_client::{
    Call, Context, PlaceError, Program, ProgramError, Rendezvous, Sent, TaskEnd, TaskError,
};

use args::{Cli, Verb, VerifyArgs, early_color};
use clap::{ColorChoice, CommandFactory, FromArgMatches};
use exit::Exit;
use failure::Failure;
use output::{Color, Output, complain, complain_in_full};
use signal_hook::consts::SIGABRT;
use std::any::Any;
use std::panic::catch_unwind;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Runs the `imrs` command with the command line of this process. Returns its exit code.
#[doc(hidden)]
#[must_use]
pub fn command() -> ExitCode {
    // A node starts this executable again as a guard, one for each command of an action.
    if let Some(code) = imrs_runtime::guard::entry() {
        return code;
    }
    let panics = panics::report();
    end_without_memory(panics.sound());
    let exit = catch_unwind(answer).unwrap_or_else(|panic| {
        if panic_text(&*panic).is_some_and(exit::says_exhausted) {
            complain("the system has no memory, file descriptor or thread left for this: see `ulimit -a`");
            return Exit::System.into();
        }
        complain(format_args!(
            "this is a fault of imrs {}. Please report the lines above and the command:\n  {}",
            env!("CARGO_PKG_VERSION"),
            arguments().collect::<Vec<_>>().join(" ")
        ));
        Exit::Internal.into()
    });
    panics.untold().into_iter().for_each(complain);
    output::settle_complaints();
    exit
}

/// The message of a panic.
fn panic_text(panic: &(dyn Any + Send)) -> Option<&str> {
    panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied())
}

/// Gives an abort for lack of memory an exit code of its own. For lack of memory, the standard library only prints a
/// message and aborts. While `sound` is false, a thread has panicked for another reason, and an abort counts as a fault
/// of this program.
fn end_without_memory(sound: Arc<AtomicBool>) {
    // If the handler cannot be registered, an abort ends the process by its signal, as usual.
    let _ = signal_hook::flag::register_conditional_shutdown(SIGABRT, Exit::System as i32, sound);
}

/// The arguments of this process, made printable.
fn arguments() -> impl Iterator<Item = String> {
    std::env::args_os().map(|argument| argument.to_string_lossy().into_owned())
}

fn answer() -> ExitCode {
    let command = Cli::command().color(early_color(arguments()));
    let parsed = command.try_get_matches().and_then(|matches| Cli::from_arg_matches(&matches));
    let cli = match parsed {
        Ok(cli) => cli,
        Err(error) => {
            if error.use_stderr() {
                // The message quotes the arguments, which may contain terminal escapes. `complain_in_full` makes the
                // escapes harmless.
                let color = match early_color(arguments()) {
                    ColorChoice::Always => Color::Always,
                    ColorChoice::Never => Color::Never,
                    ColorChoice::Auto => Color::Auto,
                };
                complain_in_full(color, &error.render().ansi().to_string());
                return Exit::Usage.into();
            }
            let _ = error.print();
            return Exit::Well.into();
        }
    };
    match run(cli) {
        Ok(exit) => exit.into(),
        Err(failure) => {
            complain(&failure);
            failure.exit().into()
        }
    }
}

fn run(cli: Cli) -> Result<Exit, Failure> {
    if cli.verb.is_some() && cli.verify != VerifyArgs::default() {
        return Err(Failure::Usage("put the flags behind the verb they are for".into()));
    }
    let mut out = Output::new(cli.color);
    let Some(verb) = cli.verb else { return verify::run(&cli.verify, &mut out) };
    match verb {
        Verb::Verify(args) => verify::run_verb(&args, &mut out),
        Verb::Simulate(args) => simulate::run(&args, &mut out),
        Verb::Check(args) => check::run(&args, &mut out),
        Verb::Fmt(args) => fmt::run(&args, &mut out),
        Verb::Explain(args) => explain::run(&args, &mut out),
        Verb::Graph(args) => graph::run(&args, &mut out),
        Verb::Keygen(args) => keygen::run(&args, &mut out),
        Verb::Run(args) => run::run(&args, &mut out),
        Verb::Summary(args) => summary::run(&args, &mut out),
        Verb::Unit(args) => unit::run(&args, &mut out),
        Verb::Demo(args) => demo::run(&args, &mut out),
        Verb::Monitor(args) => monitor::run(args, cli.color, &mut out),
        Verb::Replay(args) => replay::run(&args, &mut out),
        Verb::Export(args) => export::run(&args, &mut out),
        Verb::Bench(args) => bench::run(&args, &mut out),
        #[cfg(feature = "zenoh")]
        Verb::Zenoh(args) => zenoh::run(&args, &mut out),
        Verb::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "imrs", &mut script);
            out.line(String::from_utf8_lossy(&script).trim_end())?;
            Ok(Exit::Well)
        }
        Verb::Man { verb } => manual(verb.as_deref(), &mut out),
        Verb::Node => {
            imrs_launch::run_node(&node::NodeProgram)?;
            Ok(Exit::Well)
        }
    }
}

fn manual(verb: Option<&str>, out: &mut Output) -> Result<Exit, Failure> {
    let mut command = Cli::command();
    command.build();
    let of = match verb {
        None => command,
        Some(name) => {
            let verbs: Vec<&str> = command.get_subcommands().map(clap::Command::get_name).collect();
            let hint = names::did_you_mean(name, verbs);
            let found = command.find_subcommand(name).cloned();
            found.ok_or_else(|| Failure::Usage(format!("there is no verb `{name}`{hint}")))?
        }
    };
    let mut page = Vec::new();
    clap_mangen::Man::new(of).render(&mut page).map_err(Failure::Output)?;
    out.line(String::from_utf8_lossy(&page).trim_end())?;
    Ok(Exit::Well)
}
