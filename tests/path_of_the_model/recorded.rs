//! A recorded run of a cell, and its comparison with the model.

use super::{BEAM, WELD};
use crate::support::{Said, example, excused, run_in, run_until, runtime_dir, tape, wait_until};
use imrs_wire::recording::Record;
use serde_json::Value;
use std::path::PathBuf;

/// A recorded run.
pub struct Recorded {
    pub folder: tempfile::TempDir,
    pub cell: String,
    pub nodes: &'static [&'static str],
    /// The output of the run.
    pub said: String,
}

impl Recorded {
    /// Runs an example until `is_enough` accepts a line.
    pub fn of(name: &str, args: &[&str], is_enough: impl FnMut(&str) -> bool) -> Self {
        let nodes = if name == BEAM { &["nl", "nr", "nh"] } else { &["n1", "n2", "nt"] };
        Self::with(runtime_dir(), example(name), nodes, args, is_enough)
    }

    /// Runs a cell of one node.
    pub fn of_text(text: &str, is_enough: impl FnMut(&str) -> bool) -> Self {
        let folder = runtime_dir();
        let cell = folder.path().join("own.cell");
        std::fs::write(&cell, text).expect("the cell is written");
        Self::with(folder, cell.to_str().expect("UTF-8").into(), &["n"], &[], is_enough)
    }

    pub fn with(
        folder: tempfile::TempDir,
        cell: String,
        nodes: &'static [&'static str],
        args: &[&str],
        is_enough: impl FnMut(&str) -> bool,
    ) -> Self {
        let file = folder.path().join("run.imrs");
        let file = file.to_str().expect("UTF-8");
        let said = run_until(folder.path(), &[&["run", &cell, "--record", file], args].concat(), is_enough);
        // With injected faults a task may abort, which is a finding of the run.
        assert!(matches!(said.code, Some(0 | 1 | 5)), "{said:?}");
        Self { folder, cell, nodes, said: said.out }
    }

    /// A run in which this node is killed and restarted. It ends when the second incarnation has recorded something.
    pub fn restarted(
        folder: tempfile::TempDir,
        cell: String,
        nodes: &'static [&'static str],
        node: &str,
        how: &[&str],
    ) -> Self {
        let [kill, restart] = ["500ms", "1s"].map(|at| format!("{node}@{at}"));
        let again = format!(" node {node} is started again");
        let second = folder.path().join(format!("run.{node}-2.imrs"));
        let args = [how, &["--kill", &kill, "--restart", &restart]].concat();
        Self::with(folder, cell, nodes, &args, |line| {
            let is_again = line.contains(&again);
            if is_again {
                wait_until("the second start records", || tape::has_begun(&second));
            }
            is_again
        })
    }

    /// A recorded run of the weld cell, whose relay is killed and restarted.
    pub fn restarted_weld(how: &[&str]) -> Self {
        Self::restarted(runtime_dir(), example(WELD), &["n1", "n2", "nt"], "nt", how)
    }

    pub fn file(&self, node: &str) -> PathBuf {
        self.folder.path().join(format!("run.{node}.imrs"))
    }

    pub fn files(&self) -> Vec<PathBuf> {
        self.nodes.iter().map(|node| self.file(node)).collect()
    }

    pub fn follow(&self, files: &[PathBuf]) -> Said {
        let files: Vec<&str> = files.iter().map(|file| file.to_str().expect("UTF-8")).collect();
        let how = ["--cell", &self.cell, "--model", "--within", "300s", "--format", "json"];
        run_in(self.folder.path(), &[&["replay"], &files[..], &how[..]].concat())
    }

    /// Writes an altered copy of a node's recording. Returns the recordings of all nodes, with the copy in its place.
    pub fn change(&self, node: &str, change: impl FnOnce(&mut Vec<Record>)) -> Vec<PathBuf> {
        let changed = self.folder.path().join(format!("changed.{node}.imrs"));
        tape::change(&self.file(node), &changed, change);
        let of = |other: &&str| if *other == node { changed.clone() } else { self.file(other) };
        self.nodes.iter().map(of).collect()
    }
}

pub fn is_path(said: &Said) -> Value {
    let told = said.last_json();
    assert_eq!(said.code, Some(code_of_checks(&told)), "{said:?}");
    assert_eq!(told["path"], true, "{told}");
    assert_eq!(told["unexplained"], Value::Null, "{told}");
    told
}

/// The exit code of a replay that explains everything. On a late machine a check may be broken.
pub fn code_of_checks(told: &Value) -> i32 {
    let checks = told["checks"].as_array().expect("checks");
    let are = |outcome: &str| checks.iter().any(|check| check["outcome"] == outcome);
    if are("broken") {
        1
    } else if are("unknown") {
        5
    } else {
        0
    }
}

/// The answer about the path of a whole run. `None` if this machine was so late that the result is unknown: within one
/// tick, the times of a late node may be rounded in more ways than the replay tries, or than it has time for (D97).
pub fn path_of(run: &Recorded) -> Option<Value> {
    let said = run.follow(&run.files());
    let told = said.last_json();
    let is_cut_short = told["ended_by"] != Value::Null;
    if told["complete"] == false && (is_cut_short || told["unexplained"] != Value::Null) {
        let incomplete = if is_cut_short { 4 } else { 5 };
        let expected = if code_of_checks(&told) == 1 { 1 } else { incomplete };
        assert_eq!(said.code, Some(expected), "{said:?}");
        let is_late = told["unknown"].as_str().is_some_and(|why| why.starts_with("nodes acted late"));
        assert!(is_cut_short || is_late, "{told}");
        excused(&format!("no path was found: {told}"));
        return None;
    }
    Some(is_path(&said))
}

/// The first event that no path explains: its node, its task, and the reason for which it is impossible.
pub fn no_path(said: &Said) -> [String; 3] {
    assert_eq!(said.code, Some(1), "{said:?}");
    let told = said.last_json();
    assert_eq!(told["path"], false, "{told}");
    let at = &told["unexplained"];
    ["node", "task", "why"].map(|key| at[key].as_str().expect("text").to_owned())
}

pub fn number(told: &Value, name: &str) -> u64 {
    told[name].as_u64().unwrap_or_else(|| panic!("no `{name}` in {told}"))
}
