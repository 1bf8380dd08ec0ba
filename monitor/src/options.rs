//! The options of the monitor.

use crate::column::OverviewColumn;
use crate::judge::Judge;
use crate::keymap::Keymap;
use crate::query::Assertion;
use crate::replay::At;
use crate::theme::{Own, Theme};
use imrs_wire::obs::Token;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// The address at which a node serves monitors.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Endpoint {
    /// The path of a Unix socket.
    Unix(PathBuf),
    /// A TCP address as `HOST:PORT`.
    Tcp(String),
}

/// The error that a text is not the address of a node.
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

/// The output format.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Format {
    /// Text for people.
    #[default]
    Text,
    /// JSON for programs: one document per sample, on one line.
    Json,
}

/// When to use colour.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ColorChoice {
    /// Use colour on a terminal, unless `NO_COLOR` is set and not empty.
    #[default]
    Auto,
    /// Use colour always.
    Always,
    /// Use no colour.
    Never,
}

/// The options of the monitor.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// The nodes to attach to; if empty, all nodes in the socket folder.
    pub connect: Vec<Endpoint>,
    /// The token for nodes that require one.
    pub token: Option<Token>,
    /// The folder to search for nodes instead of [`imrs_wire::obs::place::base_dir`].
    pub base: Option<PathBuf>,
    /// Show only the cell of this name.
    pub cell: Option<String>,
    /// Print one sample and exit.
    pub once: bool,
    /// Print a sample in each period.
    pub watch: Option<Duration>,
    /// Print lines instead of drawing a screen, for pipes and screen readers.
    pub text: bool,
    /// Show this recording instead of running nodes.
    pub replay: Option<PathBuf>,
    /// The position in the recording at the start. Default: the end if the recording is printed, otherwise the beginning.
    pub at: Option<At>,
    /// The playback speed; at 1 a counterexample plays one step per second. Default: 1.
    pub speed: Option<f64>,
    /// Record the arriving frames to this file.
    pub record: Option<PathBuf>,
    /// Replace an existing file with the name of the recording.
    pub force: bool,
    /// How long to record without a screen, or how long to check `assertions`.
    pub length: Option<Duration>,
    /// Conditions that the cells must fulfil. They are checked once or, with `length`, at every sample. They imply printing.
    pub assertions: Vec<Assertion>,
    /// The output format. JSON implies printing.
    pub format: Format,
    /// When to use colour.
    pub color: ColorChoice,
    /// Draw with nothing but ASCII.
    pub ascii: bool,
    /// The theme, whatever the terminal can show.
    pub theme: Option<Theme>,
    /// The file in which the theme is stored that the user chose last.
    pub remember: Option<PathBuf>,
    /// The file that keeps the typed lines between runs.
    pub lines: Option<PathBuf>,
    /// The user's own colours.
    pub palette: Own,
    /// The user's own keys.
    pub keys: Keymap,
    /// The columns of the overview, as the user chose them. If empty, the terminal's width decides which columns are shown.
    pub columns: Vec<OverviewColumn>,
    /// Use the mouse.
    pub mouse: bool,
    /// Redraw only once a second, and after input.
    pub reduced_motion: bool,
    /// The validator for recordings of nodes; `None` for no validation.
    pub judge: Option<Arc<dyn Judge>>,
    /// The initial filter.
    pub filter: Option<String>,
}

/// The result of a run of the monitor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// There is no critical finding, or the user closed the screen.
    Healthy,
    /// There is a critical finding, or an assertion fails.
    Finding,
}

impl Verdict {
    /// The exit code of the command.
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
