//! The result of one trial, and the file that keeps the results, so that an interrupted series can go on.

use super::bounds::shown;
use super::evidence::Messages;
use super::net::Ended;
use super::switch::Counts;
use crate::support::number;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// The result of one trial.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Trial {
    pub scene: String,
    pub number: u64,
    /// The facts about messages that the recordings show.
    pub messages: Messages,
    /// How many commands ended in each way, according to the nodes' own counters.
    pub outcomes: BTreeMap<String, u64>,
    /// The number of commands without a counted outcome, of nodes that ended in order. The command for which a sender
    /// still waited at its end is left out.
    pub without_outcome: u64,
    /// How long a task of an older epoch still acted after the first step of a newer epoch, in microseconds; `None` in
    /// a cell without a couple.
    pub two_owners: Option<u64>,
    /// The verdict of the model on the recordings.
    pub model: String,
    /// The counts of the switch.
    pub counts: Counts,
    /// The time that the scene measures, in microseconds.
    pub took: Option<u64>,
}

/// Whether a node counts an alarm about foreign datagrams, or a faulty link.
fn is_warned(node: &Value) -> bool {
    let is_faulty = |link: &Value| number(&link["integrity"]["faults"]) > 0;
    number(&node["security"]["alarms"]) > 0 || node["links"].as_array().into_iter().flatten().any(is_faulty)
}

impl Trial {
    /// The results of a run. Asserts what must hold under any fault.
    pub fn of(ended: &Ended, counts: Counts) -> Self {
        let mut trial = Self { messages: ended.evidence.messages, counts, ..Self::default() };
        for (_, said) in &ended.said {
            let summary = said.last_json();
            // Damaged, repeated and forged datagrams raise an alarm, and the exit code reports it.
            let warned = summary["nodes"].as_array().is_some_and(|nodes| nodes.iter().any(is_warned));
            assert!(said.is_well() || warned && said.code == Some(6), "{said:?}");
            for check in summary["checks"].as_array().into_iter().flatten() {
                assert_ne!(check["outcome"], "broken", "{summary}");
            }
            trial.add(&summary);
        }
        trial.model = judged(&ended.model);
        let Messages { twice, delivered_twice, stale, .. } = trial.messages;
        assert_eq!([twice, delivered_twice, stale], [0; 3], "{trial:?}");
        assert_eq!(trial.without_outcome, 0, "{trial:?}");
        trial
    }

    fn add(&mut self, summary: &Value) {
        let mut ended = 0;
        for (outcome, times) in summary["commands"].as_object().expect("outcomes") {
            ended += number(times);
            *self.outcomes.entry(outcome.clone()).or_default() += number(times);
        }
        let ports = summary["ports"].as_array().expect("ports");
        let sent: u64 =
            ports.iter().filter(|port| port["usage"] == "query").map(|port| number(&port["sent"])).sum();
        assert!(ended <= sent, "{summary}");
        self.without_outcome += (sent - ended).saturating_sub(1);
    }

    pub fn outcome(&self, name: &str) -> u64 {
        self.outcomes.get(name).copied().unwrap_or(0)
    }
}

/// The verdict of `imrs replay --model`. Fails if the run is no path of the model, or breaks a check of the cell.
fn judged(told: &Value) -> String {
    for check in told["checks"].as_array().into_iter().flatten() {
        assert_ne!(check["outcome"], "broken", "{told}");
    }
    match (&told["unexplained"], &told["unknown"], &told["ended_by"]) {
        (Value::Null, Value::Null, Value::Null) if told["path"] == true => "a path".into(),
        (_, _, Value::String(by)) => format!("so far a path: {by}"),
        (_, Value::String(why), _) => format!("unknown: {why}"),
        _ => panic!("no path of the model: {told}"),
    }
}

/// The finished trials of a series.
pub struct Trials(Mutex<(Vec<Trial>, Option<File>)>);

impl Trials {
    /// Opens a series. If the file has results, the series goes on from them.
    pub fn open(file: Option<PathBuf>) -> Self {
        let Some(path) = file else { return Self(Mutex::default()) };
        let text = std::fs::read_to_string(&path).unwrap_or_default();
        // The last line of the file may be truncated, and is then skipped.
        let done = text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
        let file = OpenOptions::new().create(true).append(true).open(path).expect("a file for the trials");
        Self(Mutex::new((done, Some(file))))
    }

    pub fn has(&self, scene: &str, number: u64) -> bool {
        let done = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        done.0.iter().any(|trial| trial.scene == scene && trial.number == number)
    }

    pub fn add(&self, trial: Trial) {
        let mut done = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(file) = &mut done.1 {
            // The line break at the start ends a truncated line.
            let line = serde_json::to_string(&trial).expect("JSON");
            file.write_all(format!("\n{line}\n").as_bytes()).expect("the trial is kept");
        }
        done.0.push(trial);
    }

    pub fn finish(self) -> Vec<Trial> {
        self.0.into_inner().unwrap_or_else(PoisonError::into_inner).0
    }
}

/// A row of the table of `specs/faults.md` about the trials of one scene, without its name.
pub fn row(trials: &[&Trial], took: &str) -> String {
    let sum = |of: fn(&Trial) -> u64| trials.iter().map(|trial| of(trial)).sum::<u64>();
    let executed = sum(|trial| trial.messages.executed);
    let delivered = executed + sum(|trial| trial.messages.delivered);
    let mut parts = vec![format!("{} trials", trials.len())];
    let owners: Vec<u64> = trials.iter().filter_map(|trial| trial.two_owners).collect();
    if !owners.is_empty() {
        let seen = owners.iter().filter(|us| **us > 0).count() as u64;
        parts.push(format!("two owners {}", shown(seen, owners.len() as u64)));
    }
    if executed > 0 {
        let ended = sum(|trial| trial.outcomes.values().sum());
        let without = sum(|trial| trial.without_outcome);
        parts.push(format!("carried out twice {}", shown(sum(|trial| trial.messages.twice), executed)));
        parts.push(format!("delivered too late {}", shown(sum(|trial| trial.messages.stale), delivered)));
        parts.push(format!("without an outcome {}", shown(without, ended + without)));
        let overdue = sum(|trial| trial.messages.overdue);
        parts.push(format!("outcome more than a tick late {}", shown(overdue, ended)));
        let answered = sum(|trial| trial.outcome("replies"));
        parts.push(format!("{:.1} % answered", 100.0 * answered as f64 / ended.max(1) as f64));
    }
    let mut times: Vec<u64> = trials.iter().filter_map(|trial| trial.took).collect();
    times.sort_unstable();
    if let Some(longest) = times.last().filter(|_| !took.is_empty()) {
        let millis = |us: u64| us.div_ceil(1_000);
        let at = |share: usize| millis(times[(times.len() * share / 100).min(times.len() - 1)]);
        parts.push(format!(
            "{took}: {} ms (median), {} ms (99 %), {} ms (longest)",
            at(50),
            at(99),
            millis(*longest)
        ));
    }
    let paths = trials.iter().filter(|trial| trial.model == "a path").count();
    parts.push(format!("{paths} a path of the model, {} unknown", trials.len() - paths));
    parts.join("; ")
}
