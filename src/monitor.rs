//! `imrs monitor`: merges the command line with the user's configuration file, and starts nodes for `--demo`.

use crate::args::{Format, MonitorArgs};
use crate::exit::Exit;
use crate::failure::Failure;
use crate::output::Color;
use crate::output::Output;
use crate::token;
use crate::{cell_file, demo, replay};
use imrs_launch::cells;
use imrs_monitor::config::{self, Config, EXAMPLE};
use imrs_monitor::judge::{FollowSession, Judge};
use imrs_monitor::query::Filter;
use imrs_monitor::theme::Theme;
use imrs_monitor::{Options, Verdict};
use imrs_wire::obs::place;
use rustix::process::{Pid, Signal, kill_process, setpriority_process};
use std::fmt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

/// How long the nodes of `--demo` may take to appear.
const READY_WITHIN: Duration = Duration::from_secs(20);
/// The niceness of the thread that judges recordings, so that nodes run before it.
const LEAST_PRIORITY: i32 = 19;
/// How long the nodes of `--demo` may take to stop.
const STOP_WITHIN: Duration = Duration::from_secs(5);

/// Runs the monitor.
///
/// # Errors
/// [`Failure`].
pub fn run(mut args: MonitorArgs, color: Color, out: &mut Output) -> Result<Exit, Failure> {
    if args.config_example {
        out.text(EXAMPLE)?;
        return Ok(Exit::Well);
    }
    if args.config_schema {
        out.json(&Config::schema())?;
        return Ok(Exit::Well);
    }
    let config = Config::load(args.config.as_deref(), |name| std::env::var(name).ok());
    let config = config.map_err(|error| Failure::Usage(error.to_string()))?;
    let stage = args.demo.then(Stage::start).transpose()?;
    let base = stage.as_ref().map(Stage::base);
    if let Some(stage) = &stage {
        args.judge.get_or_insert_with(|| stage.cell());
    }
    match imrs_monitor::run(&options(args, &config, color, base)?)? {
        Verdict::Healthy => Ok(Exit::Well),
        Verdict::Finding => Ok(Exit::Finding),
    }
}

fn options(
    args: MonitorArgs,
    config: &Config,
    color: Color,
    base: Option<PathBuf>,
) -> Result<Options, Failure> {
    let given = args.theme.as_deref().map(str::parse::<Theme>).transpose().map_err(Failure::Usage)?;
    let theme = given.or_else(|| config.theme.as_ref().map(|theme| theme.0));
    if let Some(filter) = &args.filter {
        Filter::parse(filter).map_err(|error| Failure::Usage(format!("--filter {filter}: {error}")))?;
    }
    let connect = if args.connect.is_empty() && base.is_none() { config.endpoints() } else { args.connect };
    let token = args.token.as_deref().or(config.token.as_deref());
    Ok(Options {
        connect,
        token: token.map(token::read).transpose()?,
        base,
        cell: args.cell.or_else(|| config.cell.clone()),
        judge: Some(validator(args.judge.as_deref())?),
        filter: args.filter.or_else(|| config.filter.as_ref().map(|filter| filter.0.0.clone())),
        once: args.once,
        watch: args.watch,
        text: args.text,
        format: match args.format {
            Format::Text => imrs_monitor::Format::Text,
            Format::Json => imrs_monitor::Format::Json,
        },
        color: match color {
            Color::Auto => imrs_monitor::ColorChoice::Auto,
            Color::Always => imrs_monitor::ColorChoice::Always,
            Color::Never => imrs_monitor::ColorChoice::Never,
        },
        ascii: args.ascii,
        theme,
        remember: config::memory(|name| std::env::var(name).ok()),
        lines: config::lines(|name| std::env::var(name).ok()),
        palette: config.palette,
        keys: config.keys.clone(),
        columns: config.columns.iter().map(|column| column.0).collect(),
        mouse: !args.no_mouse && config.mouse.unwrap_or(true),
        reduced_motion: args.reduced_motion || config.reduced_motion.unwrap_or(false),
        replay: args.replay,
        at: args.at,
        speed: args.speed,
        record: args.record,
        force: args.force,
        length: args.length,
        assertions: args.assertions,
    })
}

/// Makes the judge that replays recordings of nodes: with the cell of this file, or with the cells of the demos.
fn validator(cell: Option<&Path>) -> Result<Arc<dyn Judge>, Failure> {
    let known = match cell {
        Some(path) => vec![cells::open(path, false)?.1],
        None => demo::cells().collect(),
    };
    Ok(Arc::new(Validator(replay::Cells::new(known, cell.map(cell_file::shown)))))
}

struct Validator(replay::Cells);

impl fmt::Debug for Validator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Validator").field("given", &self.0.given()).finish_non_exhaustive()
    }
}

impl Judge for Validator {
    fn sit(&self) -> Box<dyn FollowSession + '_> {
        // This sets the priority of the judging thread alone. That thread must not take a core from the nodes, even if
        // it is far behind.
        let _ = setpriority_process(None, LEAST_PRIORITY);
        Box::new(self.0.follow())
    }
}

/// The nodes of `--demo`: arms, a hoist, a camera and a press. The press gets more parts than it can take and rejects
/// questions, packets are lost, and one node after another is killed and restarted. So each screen of the monitor has
/// something to show within ten seconds. The nodes use a folder of their own, and stop when this value is dropped.
struct Stage {
    nodes: Child,
    folder: PathBuf,
}

/// The text of the cell of the monitored nodes.
const CELL: &str = include_str!("demo/assembly.cell");
/// The number of nodes in the monitored cell.
const NODES: usize = 5;
/// The name of the cell file in the folder of the monitored nodes.
const FILE: &str = "assembly.cell";
/// The tasks whose nodes are killed, one after the other.
const MORTALS: [&str; 3] = ["hoist", "vision", "armL"];
/// The share of the packets that are lost.
const LOSS: &str = "8%";
/// The time of the first kill, the time between kills, and how long each node stays dead: long enough for the other
/// tasks to give up and wait again.
const FAULTS: (Duration, Duration, Duration) =
    (Duration::from_secs(4), Duration::from_secs(20), Duration::from_secs(12));
/// The number of kills in a run.
const DEATHS: u32 = 90;

impl Stage {
    fn start() -> Result<Self, Failure> {
        let failed =
            |error: std::io::Error| Failure::Usage(format!("cannot start the demonstration: {error}"));
        let folder = std::env::temp_dir().join(format!("imrs-demo-{}", std::process::id()));
        std::fs::create_dir_all(&folder).map_err(failed)?;
        let (cell, (first, apart, away)) = (folder.join(FILE), FAULTS);
        std::fs::write(&cell, CELL).map_err(failed)?;
        let mut command = Command::new(std::env::current_exe().map_err(failed)?);
        command
            .arg("run")
            .arg(&cell)
            .args(["--for", "30m", "--seed", "3", "--loss", LOSS, "--format", "json"]);
        for (death, who) in (0..DEATHS).zip(MORTALS.iter().cycle()) {
            let dies = (first + apart * death).as_secs();
            command.args(["--kill", &format!("{who}@{dies}s")]);
            command.args(["--restart", &format!("{who}@{}s", dies + away.as_secs())]);
        }
        // With recordings, the monitor can judge whether the nodes conform to the verified state machine.
        command.arg("--record").arg(folder.join("assembly"));
        command.env("XDG_RUNTIME_DIR", &folder).env("XDG_STATE_HOME", &folder);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        let nodes = command.spawn().map_err(failed)?;
        let mut stage = Self { nodes, folder };
        let end = Instant::now() + READY_WITHIN;
        while place::sockets_in(&stage.base()).map_or(0, |found| found.len()) < NODES {
            if stage.nodes.try_wait().is_ok_and(|ended| ended.is_some()) || Instant::now() > end {
                return Err(Failure::Usage(
                    "the nodes of the demonstration did not start: `imrs demo beam-lift` may say why".into(),
                ));
            }
            thread::sleep(Duration::from_millis(20));
        }
        Ok(stage)
    }

    /// The cell file of the nodes.
    fn cell(&self) -> PathBuf {
        self.folder.join(FILE)
    }

    /// The folder of the nodes' observer sockets.
    fn base(&self) -> PathBuf {
        self.folder.join(Path::new("imrs"))
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        if let Some(pid) = i32::try_from(self.nodes.id()).ok().and_then(Pid::from_raw) {
            // If this fails, the launcher of the nodes has already ended.
            let _ = kill_process(pid, Signal::TERM);
        }
        let end = Instant::now() + STOP_WITHIN;
        while self.nodes.try_wait().is_ok_and(|ended| ended.is_none()) {
            if Instant::now() > end {
                let _ = self.nodes.kill();
                let _ = self.nodes.wait();
                break;
            }
            thread::sleep(Duration::from_millis(10));
        }
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}
