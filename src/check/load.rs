//! `imrs check --load`: shows the estimated traffic on the links of a cell, and where tasks are better placed.

use crate::failure::Failure;
use crate::output::{BAD, FAINT, NOTE, Output, Styled, grouped};
use imrs_language::hir::{self, Hir};
use imrs_language::load::{self, LinkLoad};
use imrs_protocol::NodeId;
use serde::Serialize;

/// The load of a cell's links, in packets a second.
#[derive(Debug, Serialize)]
pub struct Shown {
    links: Vec<Link>,
    moves: Vec<Move>,
}

/// The load of one link, in both directions together.
#[derive(Debug, Serialize)]
struct Link {
    a: String,
    b: String,
    /// The greatest traffic by the declared rates, in packets a second.
    declared: f64,
    /// Further traffic, estimated from time_outs, in packets a second.
    estimated: f64,
    /// How many packets a second the link carries.
    capacity: f64,
    is_congested: bool,
}

/// A task that would cause less traffic on another node.
#[derive(Debug, Serialize)]
struct Move {
    task: String,
    from: String,
    to: String,
    /// How many packets a second fewer all links together would carry.
    saves: f64,
}

impl Shown {
    /// The load of this cell.
    pub fn of(hir: &Hir) -> Self {
        let name = |node: NodeId| hir.nodes[node.index()].name.clone();
        let link = |(link, load): (&hir::Link, LinkLoad)| Link {
            a: name(link.a),
            b: name(link.b),
            declared: load.declared,
            estimated: load.estimated,
            capacity: load.capacity,
            is_congested: load.is_congested(),
        };
        let better = |better: load::Move| {
            let task = &hir.tasks[better.task.index()];
            Move { task: task.name.clone(), from: name(task.node), to: name(better.to), saves: better.saves }
        };
        Self {
            links: hir.links.iter().zip(load::of_links(hir)).map(link).collect(),
            moves: load::moves(hir).into_iter().map(better).collect(),
        }
    }
}

/// Prints the load of the links as a table, with advice.
///
/// # Errors
/// [`Failure::Output`].
pub fn table(hir: &Hir, out: &mut Output) -> Result<(), Failure> {
    let load = Shown::of(hir);
    out.line("")?;
    if load.links.is_empty() {
        return out.line("The cell has no links.");
    }
    let names: Vec<String> = load.links.iter().map(|link| format!("{} -- {}", link.a, link.b)).collect();
    let width = names.iter().map(|name| name.chars().count()).max().unwrap_or(0).max(16);
    let head = format!(
        "{:<width$}  {:>9}  {:>13}  {:>8}  {:>6}",
        "packets a second", "by rates", "by time_outs", "capacity", "used"
    );
    out.line(Styled(FAINT, head))?;
    for (name, link) in names.iter().zip(&load.links) {
        let used = 100.0 * (link.declared + link.estimated) / link.capacity;
        let used = Styled(if link.is_congested { BAD } else { NOTE }, format!("{used:>4.1} %"));
        let [declared, estimated, capacity] = [link.declared, link.estimated, link.capacity].map(shown);
        out.line(format!("{name:<width$}  {declared:>9}  {estimated:>13}  {capacity:>8}  {used}"))?;
    }
    for better in &load.moves {
        out.line(format!(
            "`{}` has no actions, and could run on {} instead of {}: {} packets a second fewer on the links",
            better.task,
            better.to,
            better.from,
            shown(better.saves)
        ))?;
    }
    Ok(())
}

/// A number of packets a second; below ten with one decimal.
fn shown(packets: f64) -> String {
    // Numbers of packets are far below 2^63.
    if packets < 9.95 { format!("{packets:.1}") } else { grouped(packets.round() as u64) }
}
