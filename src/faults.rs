//! Parses the faults of the command line, and schedules them: `--loss 10%`, `--kill hoist@2s`, `--cut nl--nr@1s+40ms`.

use crate::names::did_you_mean;
use crate::time::TimeError;
use imrs_launch::Fault;
use imrs_protocol::{Cell, NodeId};
use std::fmt;
use std::str::FromStr;
use std::time::Duration;

/// A fraction from 0 to 1, written `10%` or `0.1`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate(pub f64);

/// Kills a node, named by itself or by a task on it, at a certain time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Kill {
    /// The name of the node or the task.
    pub name: String,
    /// The time of the kill, counted from the start.
    pub at: Duration,
}

/// Restarts a killed node at a certain time, in its next incarnation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Restart(pub Kill);

impl FromStr for Restart {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        text.parse().map(Self)
    }
}

/// Cuts a link for a while: no packet passes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cut {
    /// The names of the two nodes, or of tasks on them.
    pub ends: [String; 2],
    /// The time of the cut, counted from the start.
    pub at: Duration,
    /// How long the link stays cut.
    pub length: Duration,
}

/// The command to execute for an action: `NAME=CMD`. Words are split at blanks; there is no shell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ActionCommand {
    /// The name of the action.
    pub name: String,
    /// The program and its first arguments.
    pub words: Vec<String>,
}

impl FromStr for ActionCommand {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let (name, command) = text.split_once('=').ok_or(FaultError::Action)?;
        let words: Vec<String> = command.split_whitespace().map(str::to_owned).collect();
        if name.is_empty() || words.is_empty() {
            return Err(FaultError::Action);
        }
        Ok(Self { name: name.into(), words })
    }
}

/// What is wrong with a fault as the user wrote it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FaultError {
    /// The text is not a fraction.
    #[error("write a share from 0% to 100%: 10% or 0.1")]
    Rate,
    /// The text is a number of packets, as `imrs verify` takes it.
    #[error(
        "write a share: 10% or 0.1, and 100% for all (`imrs verify --loss {0}` takes a number of packets)"
    )]
    Packets(u32),
    /// The text does not have the form `NAME@TIME`.
    #[error("write what and when: hoist@2s")]
    Kill,
    /// The text does not have the form `NAME=CMD`.
    #[error("write which action and which command: grip=./grip")]
    Action,
    /// The text does not have the form `A--B@TIME+TIME`.
    #[error("write which link, when and for how long: nl--nr@1s+40ms")]
    Cut,
    /// The time in the text cannot be read.
    #[error("`{text}`: {error}")]
    Time {
        /// The text of the time.
        text: String,
        /// Why the text is not a time.
        error: TimeError,
    },
    /// The cell has neither a node nor a task of this name.
    #[error("the cell has no node or task `{name}`{hint}")]
    NoNode {
        /// The unknown name.
        name: String,
        /// A name that the user may have meant.
        hint: String,
    },
    /// No link joins the two nodes.
    #[error("no link joins `{0}` and `{1}`")]
    NoLink(String, String),
    /// A node that should be restarted is not killed before.
    #[error("`{0}` is not killed before it is started again: add --kill {1}@TIME")]
    NotKilled(String, String),
    /// The fault concerns nodes that this launcher does not start.
    #[error("`{0}` is not run here: --node runs one node only")]
    NotHere(String),
    /// The fault comes after the end of the run.
    #[error("`{0}` comes after the end of the run: make --for longer")]
    TooLate(String),
}

impl FromStr for Rate {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        if let Some(packets) = text.parse().ok().filter(|packets| *packets > 0) {
            return Err(FaultError::Packets(packets));
        }
        let (digits, unit) = text.strip_suffix('%').map_or((text, 1.0), |digits| (digits, 100.0));
        let share = digits.parse::<f64>().map_err(|_| FaultError::Rate)? / unit;
        if (0.0..=1.0).contains(&share) { Ok(Self(share)) } else { Err(FaultError::Rate) }
    }
}

impl fmt::Display for Rate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The share is rounded, so that 0.07 is not shown as 7.000000000000001%.
        write!(f, "{}%", (self.0 * 1e6).round() / 1e4)
    }
}

impl FromStr for Kill {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let (name, at) = text.split_once('@').filter(|(name, _)| !name.is_empty()).ok_or(FaultError::Kill)?;
        Ok(Self { name: name.into(), at: time(at)? })
    }
}

impl fmt::Display for Kill {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}", self.name, humantime::format_duration(self.at))
    }
}

impl FromStr for Cut {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let (ends, span) = text.split_once('@').ok_or(FaultError::Cut)?;
        let (a, b) = ends.split_once("--").ok_or(FaultError::Cut)?;
        let (at, length) = span.split_once('+').ok_or(FaultError::Cut)?;
        if a.is_empty() || b.is_empty() {
            return Err(FaultError::Cut);
        }
        Ok(Self { ends: [a.into(), b.into()], at: time(at)?, length: time(length)? })
    }
}

impl fmt::Display for Cut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b] = &self.ends;
        let (at, length) = (humantime::format_duration(self.at), humantime::format_duration(self.length));
        write!(f, "{a}--{b}@{at}+{length}")
    }
}

fn time(text: &str) -> Result<Duration, FaultError> {
    crate::time::parse(text).map_err(|error| FaultError::Time { text: text.into(), error })
}

/// The faults that the user asked for.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wanted<'a> {
    /// Nodes that are killed.
    pub kill: &'a [Kill],
    /// Nodes that are started again.
    pub restart: &'a [Restart],
    /// Links that are cut.
    pub cut: &'a [Cut],
}

/// All faults of a run, by time since the start.
///
/// # Errors
/// An error for a name that the cell does not have, two nodes without a link, a restart of a node that runs, or a time
/// past the end of the run.
pub fn schedule(
    cell: &Cell,
    length: Duration,
    wanted: &Wanted<'_>,
) -> Result<Vec<(Duration, Fault)>, FaultError> {
    let mut faults = Vec::new();
    let in_time = |at: Duration, fault: &dyn fmt::Display| {
        if at < length { Ok(()) } else { Err(FaultError::TooLate(fault.to_string())) }
    };
    // Names are resolved before times are checked: an unknown name is reported first.
    for kill in wanted.kill {
        let at = node(cell, &kill.name)?;
        in_time(kill.at, kill)?;
        faults.push((kill.at, Fault::Kill(at)));
    }
    for Restart(again) in wanted.restart {
        let at = node(cell, &again.name)?;
        in_time(again.at, again)?;
        faults.push((again.at, Fault::Restart(at)));
    }
    for cut in wanted.cut {
        let (a, b) = (node(cell, &cut.ends[0])?, node(cell, &cut.ends[1])?);
        in_time(cut.at, cut)?;
        if !cell.links.iter().any(|l| (l.a, l.b) == (a, b) || (l.a, l.b) == (b, a)) {
            return Err(FaultError::NoLink(cut.ends[0].clone(), cut.ends[1].clone()));
        }
        faults.push((cut.at, Fault::Cut(a, b)));
        faults.push((cut.at + cut.length, Fault::Heal(a, b)));
    }
    faults.sort_by_key(|(at, _)| *at);
    for Restart(again) in wanted.restart {
        let id = node(cell, &again.name)?;
        let before = faults.iter().take_while(|fault| **fault != (again.at, Fault::Restart(id)));
        let of_it =
            |fault: &&(Duration, Fault)| matches!(fault.1, Fault::Kill(n) | Fault::Restart(n) if n == id);
        if !matches!(before.filter(of_it).last(), Some((_, Fault::Kill(_)))) {
            return Err(FaultError::NotKilled(again.to_string(), again.name.clone()));
        }
    }
    Ok(faults)
}

/// Checks that all faults concern the only node that this launcher runs.
///
/// # Errors
/// [`FaultError::NotHere`].
pub fn here(cell: &Cell, only: NodeId, faults: &[(Duration, Fault)]) -> Result<(), FaultError> {
    for (_, fault) in faults {
        match *fault {
            Fault::Kill(node) | Fault::Restart(node) | Fault::Pause(node) | Fault::Resume(node)
                if node != only =>
            {
                return Err(FaultError::NotHere(cell.nodes[node.index()].name.clone()));
            }
            Fault::Cut(a, b) | Fault::Heal(a, b) if a != only && b != only => {
                return Err(FaultError::NotHere(cell.nodes[a.index()].name.clone()));
            }
            Fault::Kill(_)
            | Fault::Restart(_)
            | Fault::Cut(..)
            | Fault::Heal(..)
            | Fault::Pause(_)
            | Fault::Resume(_) => {}
        }
    }
    Ok(())
}

/// The node of this name, or the node of the task of this name.
pub fn node(cell: &Cell, name: &str) -> Result<NodeId, FaultError> {
    let as_node = cell.nodes.iter().position(|n| n.name == name).map(NodeId::from_index);
    let as_task = || cell.tasks.iter().find(|t| t.name == name).map(|t| t.node);
    as_node.or_else(as_task).ok_or_else(|| {
        let names =
            cell.nodes.iter().map(|n| n.name.as_str()).chain(cell.tasks.iter().map(|t| t.name.as_str()));
        FaultError::NoNode { name: name.into(), hint: did_you_mean(name, names) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::beam_lift;

    #[test]
    fn rates_are_shares() {
        for (text, share) in [("10%", 0.1), ("0", 0.0), ("1.0", 1.0), ("100%", 1.0), ("7%", 0.07)] {
            assert_eq!(text.parse(), Ok(Rate(share)), "{text}");
        }
        for text in ["", "%", "x", "-1%", "101%", "2.0", "NaN", "inf"] {
            assert_eq!(text.parse::<Rate>(), Err(FaultError::Rate), "{text}");
        }
        // `imrs verify` takes a number of packets. If `1` were read as a share here, every packet would be lost.
        assert_eq!("1".parse::<Rate>(), Err(FaultError::Packets(1)));
        assert_eq!(Rate(0.07).to_string(), "7%");
        assert_eq!(Rate(0.125).to_string(), "12.5%");
    }

    #[test]
    fn faults_are_read_and_shown() {
        for text in ["hoist@2s", "nl@40ms"] {
            assert_eq!(text.parse::<Kill>().unwrap().to_string(), text);
        }
        for text in ["nl--nr@1s+40ms", "armL--hoist@0s+2s"] {
            assert_eq!(text.parse::<Cut>().unwrap().to_string(), text);
        }
        for text in ["", "hoist", "@2s", "hoist@", "hoist@2"] {
            assert!(text.parse::<Kill>().is_err(), "{text}");
        }
        for text in ["nl--nr", "nl@1s+2s", "nl--nr@1s", "--nr@1s+1s", "nl--@1s+1s", "nl--nr@1+1"] {
            assert!(text.parse::<Cut>().is_err(), "{text}");
        }
    }

    #[test]
    fn faults_come_in_the_order_of_their_times_and_only_where_they_can() {
        let cell = beam_lift();
        let cell = cell.cell();
        let second = Duration::from_secs(1);
        let of = |kills: &[&str], cuts: &[&str]| {
            let kills: Vec<Kill> = kills.iter().map(|k| k.parse().unwrap()).collect();
            let cuts: Vec<Cut> = cuts.iter().map(|c| c.parse().unwrap()).collect();
            schedule(cell, 3 * second, &Wanted { kill: &kills, restart: &[], cut: &cuts })
        };
        let (nl, nr, nh) = (NodeId(0), NodeId(1), NodeId(2));
        assert_eq!(
            of(&["hoist@2s"], &["armL--nr@1s+5s"]),
            Ok(vec![
                (second, Fault::Cut(nl, nr)),
                (2 * second, Fault::Kill(nh)),
                (6 * second, Fault::Heal(nl, nr))
            ])
        );
        let late = of(&["hoit@9s"], &[]).unwrap_err();
        assert!(matches!(late, FaultError::NoNode { .. }), "{late}");
        let error = of(&["hoit@2s"], &[]).unwrap_err();
        assert_eq!(error.to_string(), "the cell has no node or task `hoit`: did you mean `hoist`?");
        let again = |kill: &str, restart: &str| {
            let (kill, restart) = ([kill.parse().unwrap()], [restart.parse().unwrap()]);
            schedule(cell, 3 * second, &Wanted { kill: &kill, restart: &restart, cut: &[] })
        };
        assert_eq!(again("hoist@1s", "nh@2s").unwrap()[1], (2 * second, Fault::Restart(nh)));
        assert_eq!(again("nh@2s", "nh@1s"), Err(FaultError::NotKilled("nh@1s".into(), "nh".into())));
        assert_eq!(again("nl@1s", "nh@2s"), Err(FaultError::NotKilled("nh@2s".into(), "nh".into())));
        assert_eq!(of(&["nl@3s"], &[]), Err(FaultError::TooLate("nl@3s".into())));
        assert_eq!(of(&[], &["nl--armL@1s+1s"]), Err(FaultError::NoLink("nl".into(), "armL".into())));
    }
}
