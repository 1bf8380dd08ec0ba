//! The options of `imrs monitor`.

use super::Format;
use clap::{ArgGroup, Args};
use std::path::PathBuf;
use std::time::Duration;

/// The arguments of `imrs monitor`.
#[derive(Args, Clone, Debug)]
#[command(group(ArgGroup::new("lasting").args(["record", "assertions"]).multiple(true)))]
pub struct MonitorArgs {
    /// Attach to this node; may be given several times [default: all nodes on this machine].
    #[arg(long, short, value_name = "ADDR")]
    pub connect: Vec<imrs_monitor::Endpoint>,
    /// The file with the token, for nodes that require one.
    #[arg(long, value_name = "FILE", conflicts_with = "replay")]
    pub token: Option<PathBuf>,
    /// Show only the cell of this name.
    #[arg(long, value_name = "NAME")]
    pub cell: Option<String>,
    /// Begin with this filter: `slack<20ms and class=2`, or a part of a name.
    #[arg(long, value_name = "CONDITION")]
    pub filter: Option<String>,
    /// Judge the recordings of the nodes' inputs by this cell's file [default: by the cells of the demos].
    #[arg(long, value_name = "CELL")]
    pub judge: Option<PathBuf>,
    /// Start nodes to look at: an overloaded press, lost packets, and nodes that die and come back, one after another.
    #[arg(long, conflicts_with_all = ["connect", "replay"])]
    pub demo: bool,
    /// Print one sample and end.
    #[arg(long)]
    pub once: bool,
    /// Print a sample again and again, after each such time.
    #[arg(long, value_name = "TIME", value_parser = crate::time::parse)]
    pub watch: Option<Duration>,
    /// Print lines instead of drawing a screen: for pipes and screen readers. For a replayed finding, print every step.
    #[arg(long)]
    pub text: bool,
    /// Draw with nothing but ASCII.
    #[arg(long)]
    pub ascii: bool,
    /// Show a recording instead of running nodes: one of `--record`, or a finding that `imrs verify CELL --save` saved.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["connect", "watch", "record"])]
    pub replay: Option<PathBuf>,
    /// Begin the replay at this time: `3s`, `-30s` (before the end), or a tick of a finding.
    #[arg(long, value_name = "TIME", requires = "replay", allow_hyphen_values = true)]
    pub at: Option<imrs_monitor::At>,
    /// Play this many times as fast as usual; a finding usually plays at one step a second.
    #[arg(long, value_name = "N", requires = "replay", value_parser = speed)]
    pub speed: Option<f64>,
    /// Record what the nodes show. If there is no terminal, record without a screen.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["once", "watch", "text"])]
    pub record: Option<PathBuf>,
    /// Replace an existing file that has the recording's name.
    #[arg(long, requires = "record")]
    pub force: bool,
    /// Record or assert for this time, without a screen, and end.
    #[arg(long = "for", value_name = "TIME", requires = "lasting", value_parser = crate::time::parse)]
    pub length: Option<Duration>,
    /// End with exit code 1 unless this condition holds, now or (with --for) all the time: `expired==0 and
    /// min_slack>5ms`, `count(class=2 and fill>80%) == 0`, `missing==0`, `critical==0`.
    #[arg(long = "assert", value_name = "CONDITION", conflicts_with = "record")]
    pub assertions: Vec<imrs_monitor::query::Assertion>,
    /// The theme: colour, light, contrast, mono, ascii, colour-ascii [default: what the terminal can show].
    #[arg(long, value_name = "NAME")]
    pub theme: Option<String>,
    /// Leave mouse clicks and the wheel to the terminal.
    #[arg(long)]
    pub no_mouse: bool,
    /// Move only the countdowns, once a second.
    #[arg(long)]
    pub reduced_motion: bool,
    /// Read this file instead of $XDG_CONFIG_HOME/imrs/monitor.toml.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Print a file for --config in which every key is explained, and end.
    #[arg(long)]
    pub config_example: bool,
    /// Print the JSON Schema of the file for --config, and end.
    #[arg(long)]
    pub config_schema: bool,
    /// The form of the printed answer; JSON means printing instead of drawing a screen.
    #[arg(long, value_enum, value_name = "FORM", default_value_t = Format::Text)]
    pub format: Format,
}

/// Parses how many times as fast a recording is played.
fn speed(text: &str) -> Result<f64, String> {
    let speed = text.trim_end_matches('x').parse::<f64>().ok();
    speed
        .filter(|speed| (0.001..=1000.0).contains(speed))
        .ok_or_else(|| "write a number from 0.001 to 1000".to_owned())
}
