//! Drives a run from its start to its exit code, and shows its lines meanwhile.

use super::lines::show;
use super::plan::DemoPlan;
use super::report;
use super::service::Service;
use crate::args::{Format, LaunchArgs};
use crate::exit::Exit;
use crate::failure::Failure;
use crate::kept;
use crate::node::NodeProgram;
use crate::output::{Output, Untaken, complain, count, notice};
use imrs_launch::{Launcher, Run, StartedNode, rt};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use std::time::{Duration, Instant};

/// How often new lines are shown.
const SHOW_EVERY: Duration = Duration::from_millis(50);
/// How often the progress line is redrawn.
const PROGRESS_EVERY: Duration = Duration::from_millis(250);
/// How long the summary waits for a slow reader of standard output.
const READ_WITHIN: Duration = Duration::from_secs(5);

/// The first line of `--format json`: which nodes and tasks run, and where.
#[derive(Serialize)]
struct Started<'a> {
    version: u32,
    started: Vec<StartedNode<'a>>,
}

/// Runs a cell according to the plan `run`.
///
/// # Errors
/// [`Failure`].
pub fn run(
    mut run: Run<'_>,
    args: &LaunchArgs,
    demo: Option<DemoPlan>,
    out: &mut Output,
) -> Result<Exit, Failure> {
    let notice = if args.format == Format::Json { json_notice } else { notice };
    out.step_aside(notice, progress_line(args.format))?;
    let refused = if args.rt { rt::refused() } else { Vec::new() };
    for refused in &refused {
        complain(format_args!("--rt: {refused}; the nodes run without it"));
    }
    run.rt_refused = !refused.is_empty();
    run.observe_token = args.observe_token.as_deref().map(crate::token::read).transpose()?;

    let mut launcher = Launcher::start(&run, &NodeProgram)?;
    // Even if following the run fails, its nodes are stopped in order and its summary is shown.
    let mut service = Service::ready(&run, &launcher);
    let followed = announce(&run, args, demo, &launcher, out)
        .and_then(|()| follow(&run, &mut launcher, &mut service, out));
    service.stopping();
    let interrupts = launcher.interrupts();
    let mut ended = launcher.finish();
    if let Some(demo) = demo {
        ended.explain(|story| demo.outcome(story));
    }
    let summary = &ended.summary;
    let shown = match args.format {
        Format::Json => out.json(summary),
        Format::Text => report::summary(summary, &run.loaded.table, Some((args, demo)), out),
    };
    // A report that cannot be written must not keep the summary from being shown.
    let reported = args
        .report
        .as_deref()
        .map_or(Ok(()), |path| kept::keep_text(path, args.force, &ended.report.text(run.loaded)));
    let interrupted = interrupts.count();
    let untaken = out.settle(READ_WITHIN, || interrupts.count() > interrupted);
    report::complain_of(&ended.report.trouble, summary);
    let exit = Exit::from(ended.verdict());
    let is_written = told(&untaken);
    followed.and(shown)?;
    reported?;
    Ok(if exit == Exit::Well && !is_written { Exit::Usage } else { exit })
}

/// Complains about lines of the answer that no reader took. Returns false if writing failed. A slow reader, or one that
/// has exited, is no error.
fn told(untaken: &Untaken) -> bool {
    let lines = count(untaken.lines, "line");
    match untaken {
        Untaken { lines: 0, .. } => return true,
        Untaken { failed: None, .. } => {
            complain(format_args!("{lines} of the answer were not read, and are left out"));
            return true;
        }
        Untaken { failed: Some(why), .. } => {
            complain(format_args!("cannot write the answer: {why}: {lines} of it are missing"));
        }
    }
    false
}

/// The notice about dropped lines, in the form for `--format json`.
fn json_notice(lines: u64, why: &str) -> String {
    serde_json::json!({ "version": 1, "not_shown": lines, "why": why }).to_string()
}

/// The progress line on standard error; hidden in JSON runs.
fn progress_line(format: Format) -> ProgressBar {
    let target = match format {
        Format::Text => ProgressDrawTarget::stderr(),
        Format::Json => ProgressDrawTarget::hidden(),
    };
    ProgressBar::with_draw_target(None, target).with_style(ProgressStyle::default_spinner())
}

fn announce(
    run: &Run<'_>,
    args: &LaunchArgs,
    demo: Option<DemoPlan>,
    launcher: &Launcher<'_>,
    out: &mut Output,
) -> Result<(), Failure> {
    let started: Vec<StartedNode<'_>> = launcher.nodes().collect();
    match args.format {
        Format::Json => out.json(&Started { version: 1, started }),
        Format::Text => report::started(run, args, demo, &started, out),
    }
}

/// Follows the run until its end. Shows every pending line, however the run ends.
fn follow(
    run: &Run<'_>,
    launcher: &mut Launcher<'_>,
    service: &mut Service,
    out: &mut Output,
) -> Result<(), Failure> {
    let followed = follow_until_the_end(run, launcher, service, out);
    out.progress(None);
    followed.and(show(&launcher.last_lines(), run, out))
}

fn follow_until_the_end(
    run: &Run<'_>,
    launcher: &mut Launcher<'_>,
    service: &mut Service,
    out: &mut Output,
) -> Result<(), Failure> {
    let of = run.length.map(|all| format!(" of {}", humantime::format_duration(all))).unwrap_or_default();
    let mut progress_at = Instant::now();
    while launcher.advance()? {
        let shows = launcher.has_lines();
        if shows {
            show(&launcher.lines(), run, out)?;
        }
        if progress_at <= Instant::now() {
            let met = launcher.released().map(|met| format!(": {met} rounds")).unwrap_or_default();
            out.progress(Some(&format!("{} s{of}{met}", launcher.elapsed().as_secs())));
            progress_at = Instant::now() + PROGRESS_EVERY;
        }
        service.ping(launcher.silent_for());
        let show_at = shows.then(|| Instant::now() + SHOW_EVERY);
        launcher.wait(show_at.map_or(progress_at, |at| at.min(progress_at)));
    }
    Ok(())
}
