//! Prints the start and the summary of a run, for people.

use super::plan::DemoPlan;
use crate::args::LaunchArgs;
use crate::checks;
use crate::failure::Failure;
use crate::faults::Restart;
use crate::output::{BAD, FAINT, GOOD, HEAD, NOTE, Output, Styled, complain, count, grouped, span};
use imrs_launch::{Keys, NodeSummary, RendezvousSummary, Run, StartedNode, Summary, Trouble, link_warnings};
use imrs_protocol::{CellTable, Usage};
use std::collections::BTreeMap;

/// Prints which nodes and tasks run, and how to watch them.
///
/// # Errors
/// [`Failure::Output`].
pub fn started(
    run: &Run<'_>,
    args: &LaunchArgs,
    demo: Option<DemoPlan>,
    nodes: &[StartedNode<'_>],
    out: &mut Output,
) -> Result<(), Failure> {
    out.line(format!(
        "{}: {}, {}",
        Styled(HEAD, &run.loaded.table.cell().name),
        count(nodes.len() as u64, "node"),
        how(run),
    ))?;
    if !run.in_process && run.keys == Keys::Checksums {
        let words = "INSECURE: any process that reaches these addresses can forge the packets (--insecure)";
        out.line(format!("  {}", Styled(BAD, words)))?;
    }
    let tasks = |node: &StartedNode<'_>| match &node.tasks[..] {
        [] => "nothing: it relays".to_owned(),
        tasks => format!("runs {}", tasks.join(", ")),
    };
    let width = nodes.iter().map(|node| tasks(node).chars().count()).max().unwrap_or(0);
    for node in nodes {
        let tasks = tasks(node);
        let address = node.address.map(|address| address.to_string()).unwrap_or_default();
        let watch = node.observe.map(|at| format!("  watched at tcp:{at}")).unwrap_or_default();
        let line = format!("  {:<4} {tasks:<width$} pid {:<8} {address}{watch}", node.name, node.pid);
        out.line(line.trim_end())?;
    }
    if run.rt && !run.rt_refused {
        out.line("Real time: SCHED_FIFO, memory locked, each node on one core.")?;
    }
    if let Some(demo) = demo {
        out.line("")?;
        out.line(demo.introduction)?;
    }
    for fault in faults(args, run.seed) {
        out.line(format!("{} {fault}", Styled(NOTE, "fault:")))?;
    }
    if let Some(moment) = demo.and_then(|demo| demo.moment) {
        out.line(format!("{} {} (--no-fault runs without)", Styled(NOTE, "fault:"), moment.words))?;
    }
    out.line("To watch: `imrs monitor` in another terminal. Ctrl-C ends the run early.")?;
    out.line("")
}

fn how(run: &Run<'_>) -> &'static str {
    match (run.only, &run.keys) {
        (None, _) if run.in_process => "all in this process",
        (None, Keys::Checksums) => "one process each, over loopback UDP",
        (None, _) => "one process each, over loopback UDP, with keys of this run",
        (Some(_), Keys::Checksums) => "the only one of the cell here, over UDP",
        (Some(_), _) => "the only one of the cell here, over UDP, with its keys",
    }
}

fn faults(args: &LaunchArgs, seed: u64) -> Vec<String> {
    let mut faults = Vec::new();
    if args.loss.0 > 0.0 {
        faults.push(format!("{} of all datagrams are lost (--seed {seed})", args.loss));
    }
    for kill in &args.kill {
        let at = humantime::format_duration(kill.at);
        faults.push(format!("the node of `{}` is killed after {at}", kill.name));
    }
    for Restart(again) in &args.restart {
        let at = humantime::format_duration(again.at);
        faults.push(format!(
            "the node of `{}` is started again after {at}, in its next incarnation",
            again.name
        ));
    }
    for cut in &args.cut {
        let (at, length) = (humantime::format_duration(cut.at), humantime::format_duration(cut.length));
        faults.push(format!(
            "nothing passes between {} and {} for {length}, after {at}",
            cut.ends[0], cut.ends[1]
        ));
    }
    faults
}

/// Prints the summary of a run. `asked` has the options of the run, if they are known.
///
/// # Errors
/// [`Failure::Output`].
pub fn summary(
    summary: &Summary,
    table: &CellTable,
    asked: Option<(&LaunchArgs, Option<DemoPlan>)>,
    out: &mut Output,
) -> Result<(), Failure> {
    out.line(Styled(HEAD, format!("After {:.1} s", summary.seconds)))?;
    for rendezvous in &summary.rendezvous {
        meetings(rendezvous, out)?;
    }
    // In a cell without ports there are no counters of messages.
    if !summary.ports.is_empty() {
        commands(summary, out)?;
        ports(summary, out)?;
    }
    for node in &summary.nodes {
        out.line(node_line(node, relays(table, &node.name)))?;
        links(node, out)?;
        for refusal in &node.refusals {
            out.line(format!("    {}", Styled(BAD, refusal.words(&node.name))))?;
        }
    }
    checks::show(&summary.checks, out)?;
    for missing in &summary.incomplete {
        out.line(Styled(NOTE, format!("  incomplete: {missing}")))?;
    }
    let words = in_words(summary, table, asked);
    if !words.is_empty() {
        out.line("")?;
    }
    for line in words {
        out.line(line)?;
    }
    let Some(outcome) = &summary.outcome else { return Ok(()) };
    out.line("")?;
    out.line(Styled(HEAD, "What happened"))?;
    for words in &outcome.words {
        wrapped(words, out)?;
    }
    match outcome.held {
        Some(true) => out.line(format!("  {}", Styled(GOOD, "As promised."))),
        Some(false) => out.line(format!("  {}", Styled(BAD, "NOT as promised."))),
        None => out.line(format!("  {}", Styled(NOTE, "Not put to the test in this run."))),
    }
}

/// Complains about the problems of a run, and about what could not be observed.
pub fn complain_of(trouble: &[Trouble], summary: &Summary) {
    trouble.iter().for_each(|trouble| complain(&trouble.what));
    summary.incomplete.iter().for_each(|missing| complain(format_args!("incomplete: {missing}")));
}

/// Wraps a sentence or two for a narrow terminal.
fn wrapped(words: &str, out: &mut Output) -> Result<(), Failure> {
    let mut line = String::from(" ");
    for word in words.split(' ') {
        if line.chars().count() + word.chars().count() >= 96 {
            out.line(&line)?;
            line = String::from(" ");
        }
        line.push(' ');
        line.push_str(word);
    }
    out.line(line)
}

fn meetings(rendezvous: &RendezvousSummary, out: &mut Output) -> Result<(), Failure> {
    let r = &rendezvous.rounds;
    let mut line = format!(
        "  waitfor {}: {}; {} released all, {} released none, {} released some only",
        rendezvous.port,
        count(r.rounds, "round"),
        Styled(GOOD, grouped(r.released)),
        grouped(r.timed_out),
        grouped(r.divergent),
    );
    if r.unknown > 0 {
        line += &format!(", {} unknown (reports of a member are missing)", grouped(r.unknown));
    }
    out.line(line)?;
    match rendezvous.false_releases {
        Some(0) => out.line(format!("    false releases: {}", Styled(GOOD, "0")))?,
        Some(n) => out.line(format!("    false releases: {}", Styled(BAD, grouped(n))))?,
        None => return out.line("    false releases and start skew: not known for some of the nodes"),
    }
    match r.start_skew_us {
        Some(skew) => out.line(format!(
            "    start skew: {} p50, {} p99, {} at most",
            span(skew.p50),
            span(skew.p99),
            span(skew.max)
        )),
        None if r.released > 0 => out.line("    start skew: not known, because the machines share no clock"),
        None => out.line("    start skew: no task started"),
    }
}

fn commands(summary: &Summary, out: &mut Output) -> Result<(), Failure> {
    let c = &summary.commands;
    let sent = c.replies + c.refused + c.timed_out_unsent + c.timed_out_unknown + c.peer_restarted;
    let mut parts = vec![format!("{} answered", grouped(c.replies))];
    let others = [
        (c.refused, "refused"),
        (c.timed_out_unsent, "timed out and never left"),
        (c.timed_out_unknown, "timed out and may have run"),
        (c.peer_restarted, "met a restarted peer"),
    ];
    let named = others.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{} {what}", grouped(*n)));
    parts.extend(named);
    out.line(format!("  commands: {} ended: {}", grouped(sent), parts.join(", ")))
}

fn ports(summary: &Summary, out: &mut Output) -> Result<(), Failure> {
    let head =
        ["port", "usage", "sent", "resent", "delivered", "expired", "refused", "timed out", "duplicates"];
    let mut rows = vec![head.map(str::to_owned)];
    for p in &summary.ports {
        let numbers =
            [p.sent, p.resent, p.delivered, p.expired, p.refused, p.timed_out, p.duplicates].map(grouped);
        let mut cells = numbers.into_iter();
        rows.push(std::array::from_fn(|i| match i {
            0 => p.name.clone(),
            1 => p.usage.to_owned(),
            _ => cells.next().unwrap_or_default(),
        }));
    }
    let width = |column: usize| rows.iter().map(|row| row[column].len()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    for (i, row) in rows.iter().enumerate() {
        let cell = |(column, text): (usize, &String)| match column {
            0 | 1 => format!("{text:<0$}", widths[column]),
            _ => format!("{text:>0$}", widths[column]),
        };
        let line = row.iter().enumerate().map(cell).collect::<Vec<_>>().join("  ");
        if i == 0 { out.line(format!("  {}", Styled(FAINT, line)))? } else { out.line(format!("  {line}"))? }
    }
    Ok(())
}

/// Whether this node relays packets: two of its neighbours have no link to each other.
fn relays(table: &CellTable, name: &str) -> bool {
    let Some(node) = table.cell().nodes.iter().position(|node| node.name == name) else { return false };
    let neighbours: Vec<_> = table.neighbours(imrs_protocol::NodeId::from_index(node)).collect();
    let joined = |a, b| table.neighbours(a).any(|next| next == b);
    neighbours.iter().any(|&a| neighbours.iter().any(|&b| a != b && !joined(a, b)))
}

fn node_line(node: &NodeSummary, relays: bool) -> String {
    let mut parts = vec![node.exit.clone()];
    if node.incarnations > 1 {
        parts.push(format!("{} incarnations", node.incarnations));
    }
    if relays && node.forwarded > 0 {
        parts.push(format!("{} sent or passed on", count(node.forwarded, "packet")));
    }
    if node.lost_on_purpose > 0 {
        parts.push(format!("{} lost on purpose", count(node.lost_on_purpose, "packet")));
    }
    if node.cut_off > 0 {
        parts.push(format!("{} held back by a cut", count(node.cut_off, "packet")));
    }
    for (what, counts) in [("dropped", &node.discards), ("dropped by the link", &node.link_discards)] {
        if !counts.is_empty() {
            parts.push(format!("{what}: {}", listed(counts)));
        }
    }
    format!("  node {:<4} {}", node.name, parts.join("; "))
}

/// Prints how long datagrams took on the links to a node, against the declared bounds, and what is wrong with the links.
fn links(node: &NodeSummary, out: &mut Output) -> Result<(), Failure> {
    for link in &node.links {
        out.line(format!("    link from {}: {}", link.from, link.delay.beside(link.bound_us)))?;
        let ink = if link.integrity.faults > 0 { BAD } else { NOTE };
        for words in link_warnings(link, &node.name) {
            out.line(format!("    {}", Styled(ink, words)))?;
        }
    }
    node.security.warning(&node.name).map_or(Ok(()), |words| out.line(format!("    {}", Styled(BAD, words))))
}

fn listed(counts: &BTreeMap<String, u64>) -> String {
    let one = |(name, n): (&String, &u64)| format!("{name} {}", grouped(*n));
    counts.iter().map(one).collect::<Vec<_>>().join(", ")
}

/// The events of the run, in sentences.
fn in_words(
    summary: &Summary,
    table: &CellTable,
    asked: Option<(&LaunchArgs, Option<DemoPlan>)>,
) -> Vec<String> {
    let mut words = Vec::new();
    if let Some((args, demo)) = asked.filter(|_| summary.checks.is_broken()) {
        words.push(match &args.record {
            Some(_) => "Whether links and nodes were in time, as the cell declares them: `imrs replay` with `--model`.".into(),
            None => "With --record, `imrs replay` with `--model` says whether links and nodes were in time.".into(),
        });
        if !faults(args, summary.seed).is_empty() || demo.is_some_and(|demo| demo.moment.is_some()) {
            words.push(
                "Faults came in this run: a cell's checks are promised with those that its `faults` declare."
                    .into(),
            );
        }
    }
    for rendezvous in &summary.rendezvous {
        let r = &rendezvous.rounds;
        match rendezvous.false_releases {
            Some(0) if r.released > 0 => {
                words.push(format!("No task ever started at `{}` before all had arrived.", rendezvous.port));
            }
            Some(0) => {
                words
                    .push(format!("No task started at `{}`, because not all ever arrived.", rendezvous.port));
            }
            Some(n) => {
                let fault = Styled(BAD, "FAULT");
                words.push(format!("{fault}: {} happened before all had arrived.", count(n, "release")));
            }
            None => {}
        }
        if let Some(margin) = margin(table, &rendezvous.port).filter(|_| r.divergent > 0) {
            words.push(format!(
                "In {} some started and others gave up: more packets were lost, or later, than the margin of {} covers.",
                count(r.divergent, "round"),
                span(margin)
            ));
        }
    }
    for after in &summary.after_kill {
        let late = after.waited_us.saturating_sub(after.time_out_us);
        words.push(format!(
            "{} waited in vain for {} and got TIME_OUT after {} ({} + {} of this machine), {} after the kill.",
            after.task,
            after.killed,
            span(after.waited_us),
            span(after.time_out_us),
            span(late),
            span(after.after_kill_us),
        ));
    }
    if summary.loss > 0.0 && summary.ports.iter().any(|p| p.resent > 0) {
        let again: u64 = summary.ports.iter().map(|p| p.resent).sum();
        words.push(format!(
            "Lost packets were made up for by {} within the same time_outs.",
            count(again, "copy").replace("copys", "copies")
        ));
    }
    words
}

fn margin(table: &CellTable, port: &str) -> Option<u64> {
    let of = |p: &&imrs_protocol::Port| p.decl.name == port && p.decl.usage == Usage::Waitfor;
    table.ports().iter().find(of).map(|p| p.margin.0)
}
