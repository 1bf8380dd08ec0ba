//! What the user asked for.

use crate::judge::Judge;
use crate::query::Assertion;
use crate::replay::At;
use crate::theme::Theme;
use imrs_wire::obs::Token;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// Where a node serves monitors.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Endpoint {
    /// A Unix socket.
    Unix(PathBuf),
    /// `HOST:PORT`.
    Tcp(String),
}

/// A text that names no endpoint.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`{0}` names no endpoint: write unix:PATH or tcp:HOST:PORT")]
pub struct EndpointError(String);

impl FromStr for Endpoint {
    type Err = EndpointError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let error = || EndpointError(crate::name::shown(text));
        match text.split_once(':').ok_or_else(error)? {
            ("unix", path) if !path.is_empty() => Ok(Self::Unix(path.into())),
            ("tcp", address)
                if address.rsplit_once(':').is_some_and(|(_, port)| port.parse::<u16>().is_ok()) =>
            {
                Ok(Self::Tcp(address.to_owned()))
            }
            _ => Err(error()),
        }
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unix(path) => write!(f, "unix:{}", crate::name::shown(&path.display().to_string())),
            Self::Tcp(address) => write!(f, "tcp:{}", crate::name::shown(address)),
        }
    }
}

/// The form of what is printed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Format {
    /// For people.
    #[default]
    Text,
    /// For programs: one JSON document per sample, on one line.
    Json,
}

/// When to use colour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ColorChoice {
    /// On a terminal, unless `NO_COLOR` is set to anything.
    #[default]
    Auto,
    /// Always.
    Always,
    /// Never.
    Never,
}

/// What the user asked for.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// The nodes to attach to; empty: all that the socket folder has.
    pub connect: Vec<Endpoint>,
    /// What nodes that ask for it are shown.
    pub token: Option<Token>,
    /// The folder to look for nodes in instead of [`imrs_wire::obs::place::base_dir`].
    pub base: Option<PathBuf>,
    /// Show only the cell of this name.
    pub cell: Option<String>,
    /// Print one sample and end.
    pub once: bool,
    /// Print a sample every so often.
    pub watch: Option<Duration>,
    /// Print lines instead of drawing a screen, for pipes and screen readers.
    pub text: bool,
    /// Show this recording instead of running nodes.
    pub replay: Option<PathBuf>,
    /// Where in the recording to begin: at its end where it is printed, else at its beginning.
    pub at: Option<At>,
    /// How many times as fast a recording plays; at 1 a counterexample plays a step a second. `None`: 1.
    pub speed: Option<f64>,
    /// Record what comes in to this file.
    pub record: Option<PathBuf>,
    /// Replace a file of the recording's name.
    pub force: bool,
    /// Record, or hold `assertions` against what comes in, for so long without a screen.
    pub length: Option<Duration>,
    /// What must hold of the cells: without `length` once, else at every sample. Implies printing.
    pub assertions: Vec<Assertion>,
    /// The form of what is printed. JSON implies printing.
    pub format: Format,
    /// When to use colour.
    pub color: ColorChoice,
    /// Draw with nothing but ASCII.
    pub ascii: bool,
    /// How it looks, whatever the terminal can do.
    pub theme: Option<Theme>,
    /// Clicks and the wheel act.
    pub mouse: bool,
    /// Only countdowns move, once a second.
    pub reduced_motion: bool,
    /// Who judges the recordings that nodes write; nobody does without.
    pub judge: Option<Arc<dyn Judge>>,
    /// The filter to begin with.
    pub filter: Option<String>,
}

/// How the monitor ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Nothing critical is shown, or the user closed the screen.
    Healthy,
    /// Something critical is shown, or an assertion does not hold.
    Finding,
}

impl Verdict {
    /// The exit code of a command that ends so.
    #[must_use]
    pub const fn exit_code(self) -> u8 {
        match self {
            Self::Healthy => 0,
            Self::Finding => 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endpoints_are_read_and_shown() {
        for text in ["unix:/run/x.sock", "tcp:localhost:9000", "tcp:[::1]:9000"] {
            assert_eq!(text.parse::<Endpoint>().unwrap().to_string(), text);
        }
        for text in ["", "unix:", "tcp:host", "tcp:host:99999", "udp:x:1", "/run/x.sock"] {
            assert!(text.parse::<Endpoint>().is_err(), "{text}");
        }
    }
}
