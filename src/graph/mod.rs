//! `imrs graph`: draws a cell.

mod dot;
mod svg;

use crate::args::{GraphArgs, Picture};
use crate::cell_file::{read, shown};
use crate::exit::{Exit, turned_down};
use crate::failure::Failure;
use crate::output::{Output, complain_in_full, span};
use imrs_language::hir::{Hir, Port};
use imrs_language::{compile, render};
use imrs_protocol::{Class, Usage};

/// Draws a cell in the form that the user chose.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &GraphArgs, out: &mut Output) -> Result<Exit, Failure> {
    let source = read(&args.cell)?;
    let compiled = compile(&source);
    let Some(hir) = &compiled.hir else {
        let found =
            render::text(&compiled.diagnostics, &shown(&args.cell), Some(&source), render::Style::Coloured);
        complain_in_full(out.color, &found);
        return Ok(turned_down(&compiled.diagnostics));
    };
    out.text(&match args.to {
        Picture::Svg => svg::draw(hir),
        Picture::Dot => dot::write(hir),
    })?;
    Ok(Exit::Well)
}

/// The label of a port's arrow. It names the usage of the task that sends first: `beat: query, class 2, 5 ms`.
fn label(port: &Port) -> String {
    let class = match port.class {
        Class::Status => 1,
        Class::Command => 2,
    };
    let ttl = port.time_out.map(|length| format!(", {}", span(length.usec))).unwrap_or_default();
    let begins = if flow(port.usage).to_users { port.usage } else { port.usage.counterpart() };
    format!("{}: {begins}, class {class}{ttl}", port.name)
}

/// The directions of messages between the owner of a port and each user.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Flow {
    /// Whether the first message goes to the users, and whether it goes to the owner.
    to_users: bool,
    to_owner: bool,
    /// Whether the answer goes to the owner; `None` if there is no answer.
    answer_to_owner: Option<bool>,
}

const fn flow(usage: Usage) -> Flow {
    let (to_users, to_owner, answer_to_owner) = match usage {
        Usage::Send | Usage::Reply => (true, false, None),
        Usage::Receive => (false, true, None),
        Usage::Query => (true, false, Some(true)),
        Usage::Response => (false, true, Some(false)),
        // At a waitfor, every party tells all other parties that it has arrived.
        Usage::Waitfor => (true, true, None),
    };
    Flow { to_users, to_owner, answer_to_owner }
}

/// The links as text, one line each: `na -- nb, 1.0 ms`.
fn links(hir: &Hir) -> impl Iterator<Item = String> + '_ {
    hir.links.iter().map(|link| {
        let name = |node: imrs_protocol::NodeId| hir.nodes[node.index()].name.as_str();
        format!("{} -- {}, {}", name(link.a), name(link.b), span(link.delay.usec))
    })
}
