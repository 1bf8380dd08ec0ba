//! `imrs simulate CELL`: runs a cell at random on the protocol's state machine, with the faults that it declares.

mod answer;
mod file;
mod tell;

use crate::args::{Format, STEPS, SimulateArgs};
use crate::cell_file;
use crate::exit::Exit;
use crate::failure::Failure;
use crate::kept;
use crate::output::{Output, complain, count, grouped};
use crate::verify::{Subject, quoted};
use file::Names;
use imrs_model::cell::{Fault, Found, Refused, Schedule, Simulated, Simulator};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use signal_hook::consts::SIGINT;
use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// The number of seeds if the user gives no `--seeds`.
const SEEDS: u64 = 1000;
/// Seeds from the clock are below this bound. They have at most nine digits, because a person may type them again.
const SEEDS_OF_THE_CLOCK: u128 = 1_000_000_000;

/// The runs that the user asked for.
enum What {
    /// Runs `count` seeds, from `first` on, with the given faults or, without these, with faults that each seed draws.
    Seeds { first: u64, count: u64, faults: Option<Vec<Fault>> },
    /// Runs the one schedule of a file.
    Schedule(Schedule),
}

/// The user's request and its result, which are shown together.
struct Report<'a> {
    subject: &'a Subject,
    names: &'a Names<'a>,
    args: &'a SimulateArgs,
    what: &'a What,
    /// Why the cell was not simulated; `None` if it was.
    refused: Option<&'a Refused>,
    all: &'a Simulated,
    /// Whether the selected finding was saved.
    saved: bool,
    /// The chart of a single run without findings.
    chart: Option<String>,
}

/// Runs a cell at random, or one schedule of a file.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &SimulateArgs, out: &mut Output) -> Result<Exit, Failure> {
    let format = args.format.unwrap_or_default();
    let subject = match Subject::open(&args.cell, args.paper, format, out)? {
        Ok(subject) => subject,
        Err(exit) => return Ok(exit),
    };
    let names = Names { table: &subject.table, tick_us: subject.tick_us };
    let what = what(args, &names)?;
    args.save.as_deref().map_or(Ok(()), |path| kept::check(path, args.force))?;
    let simulator = match Simulator::new(&Arc::new(subject.declared(args.jobs)), args.steps) {
        Ok(simulator) => simulator.stopped_by(&stop_at_ctrl_c()),
        Err(refused) => {
            let (all, refused) = (&Simulated::default(), Some(&refused));
            let report = Report {
                subject: &subject,
                names: &names,
                args,
                what: &what,
                refused,
                all,
                saved: false,
                chart: None,
            };
            report.show(format, out)?;
            return Ok(Exit::Budget);
        }
    };
    let text = format == Format::Text;
    let started = Instant::now();
    let all = match &what {
        What::Seeds { first, count, faults } => {
            let line = progress(*count, text);
            let all = simulator.seeds((*first, *count), faults.as_deref(), &mut |runs, found| {
                line.set_position(runs);
                line.set_message(self::count(found as u64, "finding"));
            });
            line.finish_and_clear();
            all
        }
        What::Schedule(schedule) => simulator.schedule(schedule, args.shrink),
    };
    let seconds = started.elapsed().as_secs_f64();
    let chart = match &what {
        _ if !all.found.is_empty() || all.interrupted => None,
        What::Seeds { first, count: 1, faults } => Some(simulator.chart_of_seed(*first, faults.as_deref())),
        What::Schedule(schedule) => Some(simulator.chart_of(schedule)),
        What::Seeds { .. } => None,
    };
    // The findings are shown even if saving them fails.
    let kept = keep(args, &subject, &names, &all);
    let saved = matches!(kept, Ok(true));
    let report = Report {
        subject: &subject,
        names: &names,
        args,
        what: &what,
        refused: None,
        all: &all,
        saved,
        chart,
    };
    report.show(format, out)?;
    if text {
        // The speed goes to standard error, because the answer must not depend on this machine.
        let speed = grouped((all.steps as f64 / seconds.max(1e-9)) as u64);
        let line = format!("{} in {seconds:.2} s, {speed} steps a second", count(all.runs, "run"));
        let _ = writeln!(io::stderr(), "{line}");
    }
    kept?;
    Ok(match (all.found.is_empty(), all.interrupted) {
        (false, _) => Exit::Finding,
        (true, true) => Exit::Budget,
        (true, false) => Exit::Well,
    })
}

fn what(args: &SimulateArgs, names: &Names<'_>) -> Result<What, Failure> {
    let faults = match &args.plan {
        None => None,
        Some(path) => match file::read(path, names)? {
            (faults, Some(tape)) => {
                if args.seed.is_some() || args.seeds.is_some() {
                    let text = format!(
                        "{}: it has choices of its own: leave out --seed and --seeds",
                        path.display()
                    );
                    return Err(Failure::Usage(text));
                }
                return Ok(What::Schedule(Schedule { faults, tape }));
            }
            (faults, None) => Some(faults),
        },
    };
    let count = args.seeds.unwrap_or(if args.seed.is_some() { 1 } else { SEEDS });
    let clock = || {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        u64::try_from(since.as_micros() % SEEDS_OF_THE_CLOCK).unwrap_or(0)
    };
    Ok(What::Seeds { first: args.seed.unwrap_or_else(clock), count, faults })
}

/// A flag that Ctrl-C sets. A second Ctrl-C ends the process.
fn stop_at_ctrl_c() -> Arc<AtomicBool> {
    let (stop, once) = (Arc::default(), Arc::default());
    // Each Ctrl-C runs these three actions in this order: it sets `stop`; it ends the process if `once` is set; it sets
    // `once`. So only the second Ctrl-C ends the process. If no action can be registered, the first does.
    let _ = signal_hook::flag::register(SIGINT, Arc::clone(&stop));
    let _ = signal_hook::flag::register_conditional_default(SIGINT, Arc::clone(&once));
    let _ = signal_hook::flag::register(SIGINT, once);
    stop
}

/// A progress bar, if standard error is a terminal.
fn progress(seeds: u64, text: bool) -> ProgressBar {
    let target = if text { ProgressDrawTarget::stderr_with_hz(5) } else { ProgressDrawTarget::hidden() };
    let line = ProgressBar::with_draw_target(Some(seeds), target);
    match ProgressStyle::with_template("{wide_bar} {pos} of {len} runs, {msg}") {
        Ok(style) => line.with_style(style),
        // The template is malformed. Then the default style is used, which shows less.
        Err(_) => line,
    }
}

/// Saves the selected finding. Returns false if there is no finding, or the user named no file.
fn keep(args: &SimulateArgs, subject: &Subject, names: &Names<'_>, all: &Simulated) -> Result<bool, Failure> {
    let found = all.found.get(usize::from(args.finding) - 1);
    let missed = || format!("--finding {}: there are {}", args.finding, all.found.len());
    let (path, found) = match (&args.save, found) {
        (Some(path), Some(found)) => (path, found),
        (Some(_), None) if !all.found.is_empty() => return Err(Failure::Usage(missed())),
        (None, None) if !all.found.is_empty() => {
            complain(missed());
            return Ok(false);
        }
        _ => return Ok(false),
    };
    let text = file::text(&found.schedule, &format!("{} --plan FILE", command(subject, args)), names);
    kept::keep_text(path, args.force, &text)?;
    Ok(true)
}

/// The command that the user gave, without seeds and plan.
fn command(subject: &Subject, args: &SimulateArgs) -> String {
    let file = if cell_file::is_stdin(&args.cell) { "-" } else { &subject.file };
    let mut command = format!("imrs simulate {}", quoted(file));
    if args.paper {
        command.push_str(" --paper");
    }
    if args.steps != STEPS {
        let _ = write!(command, " --steps {}", args.steps);
    }
    command
}

impl Report<'_> {
    /// The message that nothing was saved, if the user named a file and there is no finding.
    fn unsaved(&self) -> Option<String> {
        let path = self.args.save.as_ref().filter(|_| self.all.found.is_empty())?;
        let why = if self.refused.is_some() { "the cell was not simulated" } else { "nothing was found" };
        Some(kept::nothing_kept(path, why))
    }

    fn is_saved(&self, number: usize) -> bool {
        self.saved && usize::from(self.args.finding) == number + 1
    }

    /// The command that runs this finding again and shows its whole chart.
    fn again(&self, number: usize, found: &Found) -> String {
        let mut command = command(self.subject, self.args);
        let saved = self.args.save.as_ref().filter(|_| self.is_saved(number));
        if let Some(path) = saved.or(self.args.plan.as_ref()) {
            let _ = write!(command, " --plan {}", quoted(&cell_file::shown(path)));
        }
        if let Some(seed) = found.seed.filter(|_| saved.is_none()) {
            let _ = write!(command, " --seed {seed}");
        }
        if self.args.shrink && saved.is_none() {
            command.push_str(" --shrink");
        }
        match saved.map_or(found.number, |_| found.number_of_schedule) {
            1 => {}
            number => _ = write!(command, " --finding {number}"),
        }
        command
    }
}
