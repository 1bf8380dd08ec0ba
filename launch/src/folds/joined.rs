//! The summary of a cell whose nodes run on several machines: it is made from the reports of all launchers (D218).

use super::attendance::{Attended, outcomes, waitfors};
use super::report::Report;
use super::summary::{RendezvousSummary, Summary};
use super::trouble::Trouble;
use crate::cells::Loaded;
use imrs_protocol::{CellTable, Port};

/// The summary of a cell from the reports of its machines, and the problems of all.
#[must_use]
pub fn join(loaded: &Loaded, reports: &[Report]) -> (Summary, Vec<Trouble>) {
    let table = &loaded.table;
    let mut summary = Summary::of(table, reports, rendezvous(table, reports));
    let missing: Vec<_> = without_report(table, reports).collect();
    if missing.is_empty() {
        let apart = summary.checks.mark_apart();
        summary.incomplete.extend(apart);
    }
    summary.incomplete.extend(missing.iter().map(|node| format!("node {node} has no report")));
    (summary, reports.iter().flat_map(|report| report.trouble.clone()).collect())
}

/// The names of the nodes of which there is no report.
fn without_report<'a>(table: &'a CellTable, reports: &'a [Report]) -> impl Iterator<Item = &'a str> {
    let is_there = |name: &str| reports.iter().flat_map(|report| &report.nodes).any(|node| node.name == name);
    let names = table.cell().nodes.iter().map(|node| node.name.as_str());
    names.filter(move |name| !is_there(name))
}

fn rendezvous(table: &CellTable, reports: &[Report]) -> Vec<RendezvousSummary> {
    let attended = |port: &Port| -> Vec<&Attended> {
        let all = reports.iter().flat_map(|report| &report.attended);
        all.filter(|attended| attended.port == port.id).collect()
    };
    let one = |port: &Port| {
        let attended = attended(port);
        let members: Vec<_> = port.parties.iter().map(|party| party.task).collect();
        let all = members.iter().all(|task| attended.iter().any(|of| of.task == *task));
        let rounds = outcomes(&members, &attended);
        let false_releases = all.then_some(rounds.false_releases);
        RendezvousSummary { port: port.decl.name.clone(), rounds, false_releases }
    };
    waitfors(table).map(one).collect()
}

#[cfg(test)]
mod tests;
