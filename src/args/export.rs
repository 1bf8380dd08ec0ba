//! The options of `imrs export`.

use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// The arguments of `imrs export`.
#[derive(Args, Clone, Debug)]
pub struct ExportArgs {
    /// The recording: one of `imrs monitor --record`, or a finding that `imrs verify CELL --save` saved.
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// The form of the export.
    #[arg(long, value_enum, value_name = "FORM")]
    pub to: ExportForm,
    /// The output file [default: beside the recording, with the ending of the form; never an existing file]; `-` is
    /// standard output.
    #[arg(long, short, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Replace an existing file of --out.
    #[arg(long, requires = "out")]
    pub force: bool,
    /// For an asciicast: columns and rows.
    #[arg(long, value_name = "WxH", default_value = "120x40", value_parser = size)]
    pub size: (u16, u16),
    /// For an asciicast: keys that are pressed before it begins, such as `3` for the screen of the rendezvous.
    #[arg(long, value_name = "KEYS", default_value = "")]
    pub keys: String,
    /// For an asciicast: the most frames a second.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u16).range(1..=60))]
    pub fps: u16,
    /// For a chart: how many of the last events it shows.
    #[arg(long, value_name = "N", default_value_t = 400, value_parser = clap::value_parser!(u32).range(1..=20_000))]
    pub last: u32,
}

/// The form of an export.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ExportForm {
    /// A file for Foxglove and PlotJuggler.
    Mcap,
    /// A line of JSON for each event.
    Jsonl,
    /// A sequence chart.
    Svg,
    /// The monitor's screen, for asciinema and its players.
    Asciicast,
}

impl ExportForm {
    /// The ending of the names of files in this form.
    pub const fn ending(self) -> &'static str {
        match self {
            Self::Mcap => "mcap",
            Self::Jsonl => "jsonl",
            Self::Svg => "svg",
            Self::Asciicast => "cast",
        }
    }
}

fn size(text: &str) -> Result<(u16, u16), String> {
    let (width, height) = text.split_once('x').ok_or("write columns and rows, as 120x40")?;
    let (width, height) = (width.parse().unwrap_or(0), height.parse().unwrap_or(0));
    if (1..=500).contains(&width) && (1..=200).contains(&height) {
        Ok((width, height))
    } else {
        Err("write at most 500 columns and 200 rows, as 120x40".to_owned())
    }
}
