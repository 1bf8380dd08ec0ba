//! Draws a cell for Graphviz: a cluster per node, and an edge between the owner of a port and each user, from the
//! sender of the first message to its receiver. A dashed edge stands for the answer.

use super::{flow, label, links};
use imrs_language::hir::Hir;

pub(super) fn write(hir: &Hir) -> String {
    let mut out = format!("digraph {} {{\n  rankdir=LR;\n  node [shape=box];\n", quoted(&hir.name));
    let links: Vec<String> = links(hir).collect();
    if !links.is_empty() {
        out.push_str(&format!("  label={};\n", quoted(&format!("links: {}", links.join("; ")))));
    }
    for (at, node) in hir.nodes.iter().enumerate() {
        out.push_str(&format!("  subgraph cluster_{at} {{\n    label={};\n", quoted(&node.name)));
        let here = hir.tasks.iter().enumerate().filter(|(_, task)| task.node.index() == at);
        for (id, task) in here {
            out.push_str(&format!("    t{id} [label={}];\n", quoted(&task.name)));
        }
        out.push_str("  }\n");
    }
    for port in &hir.ports {
        let text = quoted(&label(port));
        for user in &port.users {
            let (owner, user) = (port.owner.index(), user.task.index());
            let flow = flow(port.usage);
            let (from, to) = if flow.to_users { (owner, user) } else { (user, owner) };
            let both = if flow.to_users && flow.to_owner { ", dir=both" } else { "" };
            out.push_str(&format!("  t{from} -> t{to} [label={text}{both}];\n"));
            if flow.answer_to_owner.is_some() {
                let answer = quoted(&format!("{}: answer", port.name));
                out.push_str(&format!("  t{to} -> t{from} [label={answer}, style=dashed];\n"));
            }
        }
    }
    out.push_str("}\n");
    out
}

/// A quoted string of DOT, with escaped quotes and backslashes.
fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n"))
}

#[cfg(test)]
mod tests {
    #[test]
    fn quotes_do_not_end_a_text() {
        assert_eq!(super::quoted("a\"b\\"), "\"a\\\"b\\\\\"");
    }
}
