//! The options of `imrs verify`.

use super::{Format, MOST_JOBS};
use clap::{ArgGroup, Args};
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::time::Duration;

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
#[command(group(ArgGroup::new("kept").args(["trace", "save"]).multiple(true)))]
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
    /// Let any nodes pause so many more times, each until one tick after the longest time_out or take-over of the cell.
    #[arg(long, value_name = "N", requires = "cell", default_value_t = 0, value_parser = clap::value_parser!(u8).range(..=8))]
    pub pause: u8,
    /// Allow only the keywords of the paper, and check its own rules.
    #[arg(long, requires = "cell")]
    pub paper: bool,
    /// Let clocks leave out or count twice so many more ticks.
    #[arg(long, value_name = "N", requires = "cell", default_value_t = 0)]
    pub drift: u8,
    /// When actions end, and packets arrive.
    #[arg(long, value_name = "WHEN", requires = "cell", value_enum, default_value_t)]
    pub times: Times,
    /// Give up after so long without faults, and after so long with them, in each independent part of the cell.
    #[arg(long, value_name = "TIME", requires = "cell", default_value = "30s", value_parser = crate::time::parse)]
    pub within: Duration,
    /// Draw a finding as a sequence chart, with all that repeats, into this file: SVG, or text where its name ends in .txt.
    #[arg(long, value_name = "FILE.svg", requires = "cell")]
    pub trace: Option<PathBuf>,
    /// Save a finding as a recording that `imrs monitor --replay FILE` shows step by step.
    #[arg(long, value_name = "FILE", requires = "cell")]
    pub save: Option<PathBuf>,
    /// Replace what the files of --trace and --save hold.
    #[arg(long, requires = "kept")]
    pub force: bool,
    /// Which finding is drawn and saved, counted from 1 [default: the first that steps lead to].
    #[arg(long, value_name = "N", requires = "cell", value_parser = clap::value_parser!(u16).range(1..))]
    pub finding: Option<u16>,
}

/// When the actions of a cell end, and its packets arrive, under the checker.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Times {
    /// The first of `every`, `between` and `ends` that does not take too many states.
    #[default]
    Auto,
    /// Actions at their least or most time, packets at their link's bound.
    Ends,
    /// At both ends, or right after anything that happens between them.
    Between,
    /// At every tick, or every model tick where the cell has one.
    Every,
    /// At every tick of the cell, searched by zones: sets of times at which the same happens.
    Zones,
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
    /// Number of threads [default: the number of cores].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=MOST_JOBS))]
    pub jobs: Option<u16>,
    /// Give up a claim that needs more memory than this [default: 4G].
    #[arg(long, value_name = "SIZE", value_parser = memory)]
    pub memory: Option<u64>,
    /// The form of the answer [default: text].
    #[arg(long, value_enum, value_name = "FORM")]
    pub format: Option<Format>,
}

/// An address that only this machine can reach.
fn loopback(text: &str) -> Result<SocketAddr, String> {
    let example = "write 127.0.0.1:3000 or localhost:3000";
    let mut all = text.to_socket_addrs().map_err(|error| format!("{error}: {example}"))?;
    all.next()
        .filter(|first| first.ip().is_loopback() && all.all(|other| other.ip().is_loopback()))
        .ok_or_else(|| format!("other machines can reach it, and no token is asked for: {example}"))
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
}
