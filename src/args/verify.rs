//! The options of `imrs verify`.

use super::{Format, MOST_JOBS};
use clap::{ArgGroup, Args};
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::time::Duration;

/// The arguments of `imrs verify`.
#[derive(Args, Clone, Debug)]
pub struct VerifyVerb {
    /// The cell file; without one the protocol's own claims are checked.
    #[arg(value_name = "CELL", conflicts_with_all = ["full", "claim", "explore"])]
    pub cell: Option<PathBuf>,
    /// The flags for the protocol's claims and for a cell.
    #[command(flatten)]
    pub verify: VerifyArgs,
    /// The flags for a cell only.
    #[command(flatten)]
    pub faults: CellFaultArgs,
}

/// Faults in addition to those that a cell declares, and options for the search and its findings.
#[derive(Args, Clone, Debug)]
#[command(group(ArgGroup::new("kept").args(["trace", "save"]).multiple(true)))]
pub struct CellFaultArgs {
    /// Lose this many more packets than the cell declares.
    #[arg(long, value_name = "N", requires = "cell", default_value_t = 0)]
    pub loss: u8,
    /// Deliver this many more packets twice.
    #[arg(long, value_name = "N", requires = "cell", default_value_t = 0)]
    pub dup: u8,
    /// Let packets overtake the packet before them on their link this many times [default: 1].
    #[arg(long, value_name = "N", requires = "cell", num_args = 0..=1, default_value_t = 0, default_missing_value = "1")]
    pub reorder: u8,
    /// Let this node, or the node of this task, crash once.
    #[arg(long, value_name = "NAME", requires = "cell")]
    pub crash: Vec<String>,
    /// Let any nodes pause this many more times, each until one tick after the longest time_out or take-over of the
    /// cell.
    #[arg(long, value_name = "N", requires = "cell", default_value_t = 0, value_parser = clap::value_parser!(u8).range(..=8))]
    pub pause: u8,
    /// Allow only the keywords of the paper, and check its own rules.
    #[arg(long, requires = "cell")]
    pub paper: bool,
    /// Let clocks leave out or count twice this many more ticks.
    #[arg(long, value_name = "N", requires = "cell", default_value_t = 0)]
    pub drift: u8,
    /// The times at which actions may end and packets may arrive.
    #[arg(long, value_name = "WHEN", requires = "cell", value_enum, default_value_t)]
    pub times: Times,
    /// Give up a search after this time: once for the search without faults, once for those with faults, in each
    /// independent part of the cell.
    #[arg(long, value_name = "TIME", requires = "cell", default_value = "30s", value_parser = crate::time::parse)]
    pub within: Duration,
    /// Draw a finding as a complete sequence chart into this file: as SVG, or as text if the name ends in .txt.
    #[arg(long, value_name = "FILE.svg", requires = "cell")]
    pub trace: Option<PathBuf>,
    /// Save a finding as a recording that `imrs monitor --replay FILE` shows step by step.
    #[arg(long, value_name = "FILE", requires = "cell")]
    pub save: Option<PathBuf>,
    /// Replace existing files of --trace and --save.
    #[arg(long, requires = "kept")]
    pub force: bool,
    /// The finding that is drawn and saved, counted from 1 [default: the first finding with a path].
    #[arg(long, value_name = "N", requires = "cell", value_parser = clap::value_parser!(u16).range(1..))]
    pub finding: Option<u16>,
}

/// The times at which the actions of a cell may end, and its packets may arrive, in the search.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Times {
    /// Every tick: `every` if that needs few states, else `zones`. A search that does not end in three quarters of
    /// --within goes on with `ends`. With pauses or drift: the first of `every`, `between` and `ends` that needs few
    /// enough states.
    #[default]
    Auto,
    /// Actions end at their least or most time, packets arrive at their link's bound.
    Ends,
    /// Actions and packets have both ends of their interval, or any instant in between right after another event.
    Between,
    /// Actions end and packets arrive at every tick, or at every model tick if the cell declares one.
    Every,
    /// Actions end and packets arrive at every tick of the cell, searched by zones: sets of times with the same
    /// behaviour.
    Zones,
}

/// The flags for the protocol's claims, and those that a cell shares with them.
#[derive(Args, Clone, Debug, Default, PartialEq, Eq)]
pub struct VerifyArgs {
    /// Check the large bounds instead of the smoke bounds.
    #[arg(long)]
    pub full: bool,
    /// Check this claim only, and show its counterexamples in full.
    #[arg(long, value_name = "NAME")]
    pub claim: Option<String>,
    /// Serve the first state space of the claim to a browser on this machine, to walk through it by hand.
    #[arg(long, value_name = "HOST:PORT", requires = "claim", value_parser = loopback)]
    pub explore: Option<SocketAddr>,
    /// Number of threads [default: the number of cores].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=MOST_JOBS))]
    pub jobs: Option<u16>,
    /// Give up a claim whose search needs more memory than this [default: 4G].
    #[arg(long, value_name = "SIZE", value_parser = memory)]
    pub memory: Option<u64>,
    /// The form of the answer [default: text].
    #[arg(long, value_enum, value_name = "FORM")]
    pub format: Option<Format>,
}

/// Parses an address that only this machine can reach.
fn loopback(text: &str) -> Result<SocketAddr, String> {
    let example = "write 127.0.0.1:3000 or localhost:3000";
    let mut all = text.to_socket_addrs().map_err(|error| format!("{error}: {example}"))?;
    all.next()
        .filter(|first| first.ip().is_loopback() && all.all(|other| other.ip().is_loopback()))
        .ok_or_else(|| format!("other machines can reach it, and no token is asked for: {example}"))
}

/// Parses a size in bytes: `512M`, `4G`; units are powers of 1024.
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
