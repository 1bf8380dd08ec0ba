//! Draws a cell as SVG: the nodes in a row with their tasks, and below them one row per port. Arrows follow the
//! messages between the owner and the users; a white head stands for the answer. Nothing overlaps, and the same cell
//! always gives the same picture.

use super::{flow, label, links};
use imrs_language::hir::{Hir, Port};
use std::fmt::Write;

/// About the width of a character, in pixels.
const CHARACTER: usize = 8;
/// The least width of a task's column.
const COLUMN: usize = 110;
const MARGIN: usize = 16;
/// The space between two nodes.
const GAP: usize = 20;
/// The lower edges of the nodes, and of the tasks in them.
const NODES_END: usize = 100;
const TASKS_END: usize = 86;
/// The height of a port's row.
const ROW: usize = 40;

pub(super) fn draw(hir: &Hir) -> String {
    let plan = Plan::new(hir);
    let links: Vec<String> = links(hir).collect();
    let end = NODES_END + hir.ports.len() * ROW + 24;
    let height = end + MARGIN + links.len().min(1) * 20;
    let labels = hir.ports.iter().map(|port| label(port).chars().count());
    let below = format!("links: {}", links.join("; "));
    let longest = labels.chain([if links.is_empty() { 0 } else { below.chars().count() }]).max().unwrap_or(0);
    let width = plan.width.max(longest * CHARACTER + 2 * MARGIN);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
         font-family=\"monospace\" font-size=\"12\">\n<title>{}</title>\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
        escaped(&hir.name)
    );
    boxes(hir, &plan, end, &mut out);
    for (row, port) in hir.ports.iter().enumerate() {
        arrow(port, &plan, NODES_END + (row + 1) * ROW, width, &mut out);
    }
    if !links.is_empty() {
        text(&mut out, (MARGIN, height - 10), "start", &below);
    }
    out.push_str("</svg>\n");
    out
}

/// The horizontal layout of the picture.
struct Plan {
    /// The left and the right edge of each node.
    nodes: Vec<(usize, usize)>,
    /// The middle of each task.
    tasks: Vec<usize>,
    column: usize,
    width: usize,
}

impl Plan {
    fn new(hir: &Hir) -> Self {
        let longest = |names: &mut dyn Iterator<Item = &str>| names.map(|name| name.chars().count()).max();
        let tasks = longest(&mut hir.tasks.iter().map(|task| task.name.as_str()));
        let nodes = longest(&mut hir.nodes.iter().map(|node| node.name.as_str()));
        let column = COLUMN.max((tasks.max(nodes).unwrap_or(0) + 3) * CHARACTER);
        let mut plan = Self { nodes: Vec::new(), tasks: vec![0; hir.tasks.len()], column, width: MARGIN };
        for at in 0..hir.nodes.len() {
            let left = plan.width;
            let here = hir.tasks.iter().enumerate().filter(|(_, task)| task.node.index() == at);
            let mut number = 0;
            for (task, _) in here {
                plan.tasks[task] = left + number * column + column / 2;
                number += 1;
            }
            let right = left + number.max(1) * column;
            plan.nodes.push((left, right));
            plan.width = right + GAP;
        }
        plan.width = plan.width - GAP.min(plan.width) + MARGIN;
        plan
    }
}

fn boxes(hir: &Hir, plan: &Plan, end: usize, out: &mut String) {
    for (node, &(left, right)) in hir.nodes.iter().zip(&plan.nodes) {
        rectangle(out, (left, MARGIN), (right - left, NODES_END - MARGIN), "#eef3f8");
        text(out, ((left + right) / 2, MARGIN + 20), "middle", &node.name);
    }
    for (task, &middle) in hir.tasks.iter().zip(&plan.tasks) {
        let width = plan.column - 16;
        line(out, (middle, TASKS_END), (middle, end), "stroke=\"#999\" stroke-dasharray=\"3 4\"");
        rectangle(out, (middle - width / 2, 50), (width, TASKS_END - 50), "white");
        text(out, (middle, 72), "middle", &task.name);
    }
}

fn arrow(port: &Port, plan: &Plan, y: usize, width: usize, out: &mut String) {
    let owner = plan.tasks[port.owner.index()];
    let users: Vec<usize> = port.users.iter().map(|user| plan.tasks[user.task.index()]).collect();
    let least = users.iter().copied().fold(owner, usize::min);
    let most = users.iter().copied().fold(owner, usize::max);
    line(out, (least, y), (most, y), "stroke=\"black\"");
    let flow = flow(port.usage);
    // The owner gets an arrow head on each side from which messages come.
    let sides = [users.iter().find(|user| **user < owner), users.iter().find(|user| **user > owner)];
    for &user in &users {
        match (flow.to_users, flow.answer_to_owner) {
            (true, _) => head(out, (user, y), owner, "black"),
            (false, Some(false)) => head(out, (user, y), owner, "white"),
            (false, _) => start(out, (user, y)),
        }
    }
    for &user in sides.into_iter().flatten() {
        match (flow.to_owner, flow.answer_to_owner) {
            (true, _) => head(out, (owner, y), user, "black"),
            (false, Some(true)) => head(out, (owner, y), user, "white"),
            (false, _) => start(out, (owner, y)),
        }
    }
    let label = label(port);
    let half = label.chars().count() * CHARACTER / 2 + MARGIN / 2;
    let middle = ((least + most) / 2).min(width.saturating_sub(half)).max(half);
    // A white background keeps the lines away from the letters, because not every program can draw outlined letters.
    let ground = label.chars().count() * CHARACTER;
    let _ = writeln!(
        out,
        "<rect x=\"{}\" y=\"{}\" width=\"{ground}\" height=\"15\" fill=\"white\"/>",
        middle.saturating_sub(ground / 2),
        y - 20
    );
    text(out, (middle, y - 8), "middle", &label);
}

/// The head of an arrow that comes from the horizontal position `from`.
fn head(out: &mut String, (x, y): (usize, usize), from: usize, fill: &str) {
    let tail = if x > from { x.saturating_sub(8) } else { x + 8 };
    let (top, low) = (y - 4, y + 4);
    let _ = writeln!(
        out,
        "<path d=\"M{x} {y} L{tail} {top} L{tail} {low} Z\" fill=\"{fill}\" stroke=\"black\"/>"
    );
}

/// The dot at the beginning of an arrow.
fn start(out: &mut String, (x, y): (usize, usize)) {
    let _ = writeln!(out, "<circle cx=\"{x}\" cy=\"{y}\" r=\"3\"/>");
}

fn rectangle(out: &mut String, (x, y): (usize, usize), (width, height): (usize, usize), fill: &str) {
    let _ = writeln!(
        out,
        "<rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" rx=\"4\" fill=\"{fill}\" stroke=\"#456\"/>"
    );
}

fn line(out: &mut String, (x1, y1): (usize, usize), (x2, y2): (usize, usize), style: &str) {
    let _ = writeln!(out, "<line x1=\"{x1}\" y1=\"{y1}\" x2=\"{x2}\" y2=\"{y2}\" {style}/>");
}

fn text(out: &mut String, (x, y): (usize, usize), anchor: &str, what: &str) {
    let _ = writeln!(out, "<text x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\">{}</text>", escaped(what));
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    #[test]
    fn signs_of_markup_are_text() {
        assert_eq!(super::escaped("a<b & \"c\">"), "a&lt;b &amp; &quot;c&quot;&gt;");
    }
}
