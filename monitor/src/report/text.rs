//! The text of `imrs monitor --once`.

use super::{cells, found, real_time};
use crate::clock::{Moment, Span};
use crate::name::shown_line;
use crate::store::health::{findings, held_back_words};
use crate::store::journal::Severity;
use crate::store::meeting::{Meeting, Standing, meetings, state};
use crate::store::{NodeIncarnation, Store, Unseen, unseen};
use imrs_protocol::{PortView, Usage};
use imrs_wire::obs::{Liveness, TaskSnapshot};
use std::fmt::Write as _;

/// The selected cells as text, one fact per line.
#[must_use]
pub fn text(store: &Store, only: Option<&str>, now: Moment) -> String {
    let mut out = String::new();
    for cell in cells(store, only) {
        let _ = writeln!(out, "cell {cell}");
        for incarnation in store.incarnations_of(&cell) {
            text_node(incarnation, now, &mut out);
        }
        for Unseen { name, is_killed, .. } in unseen(store, &cell) {
            let _ = writeln!(out, "  node {name}: {}", if is_killed { "DEAD" } else { "not seen here" });
        }
        for meeting in meetings(store, &cell, now) {
            text_meeting(&meeting, &mut out);
        }
        for finding in findings(store, &cell, now) {
            let place = found(store, &cell, &finding);
            let place: Vec<_> = [place.node, place.task, place.port].into_iter().flatten().collect();
            let place = crate::name::shown(&place.join("."));
            let level = if finding.level == Severity::Bad { "CRITICAL" } else { "warning" };
            let text = shown_line(finding.text.as_ref());
            let _ = writeln!(out, "  {level} {place}: {text} [{}]", finding.code);
        }
    }
    for trouble in store.troubles() {
        let _ = writeln!(out, "cannot attach: {}", shown_line(trouble));
    }
    out
}

fn text_node(incarnation: &NodeIncarnation, now: Moment, out: &mut String) {
    let (presence, last) = (incarnation.presence(now), incarnation.last.as_ref());
    let pid = if incarnation.pid == 0 { String::new() } else { format!(", pid {}", incarnation.pid) };
    let _ = write!(out, "  node {}: {presence}{pid}, incarnation {}", incarnation.node, incarnation.number);
    let _ = write!(out, ", ran {}", Span::micros(last.map_or(0, |s| s.snapshot.uptime_us)));
    let real_time = last.and_then(|s| real_time(s.snapshot.real_time));
    out.extend(real_time.map(|how| format!(", real time {how}")));
    out.push_str(if last.is_some_and(|s| s.snapshot.insecure) { ", INSECURE\n" } else { "\n" });
    for link in incarnation.measured(now) {
        let (from, recent) = (incarnation.names.node(link.report.peer), link.report.recent);
        let _ = writeln!(
            out,
            "    link from {from}: {} in {}",
            recent.beside(link.bound_us),
            Span::micros(link.report.recent_us)
        );
    }
    for task in incarnation.tasks() {
        let does = match task.liveness {
            Liveness::Crashed => "CRASHED".to_owned(),
            Liveness::Ended => "ended".to_owned(),
            Liveness::Alive => match incarnation.task_held_back(task.view.task, now) {
                Some(us) => held_back_words(us),
                None => state(incarnation, &task.view.state),
            },
        };
        let _ = writeln!(out, "    task {}: {does}", incarnation.names.task(task.view.task));
        for port in &task.view.ports {
            text_port(incarnation, task, port, now, out);
        }
    }
}

fn text_port(
    incarnation: &NodeIncarnation,
    task: &TaskSnapshot,
    port: &PortView,
    now: Moment,
    out: &mut String,
) {
    let c = &port.counters;
    let name = incarnation.names.port_name(port.port);
    let _ = write!(out, "      port {name}: {}", port.usage);
    if port.usage != Usage::Waitfor && port.capacity > 0 {
        let _ = write!(out, ", {} of {} waiting", port.len, port.capacity);
    }
    if let Some(left) = port.min_slack.map(|s| incarnation.left(s, task.age_us, now)) {
        let _ = write!(out, ", most urgent {left}");
    }
    let counters = [
        ("sent", c.sent),
        ("in", c.enqueued),
        ("served", c.delivered),
        ("expired", c.expired),
        ("refused", c.refused),
        ("evicted", c.evicted),
        ("timed out", c.timed_out),
        ("duplicates", c.duplicates),
    ];
    for (name, count) in counters.into_iter().filter(|(_, count)| *count > 0) {
        let _ = write!(out, ", {name} {count}");
    }
    out.push('\n');
}

fn text_meeting(meeting: &Meeting, out: &mut String) {
    let _ = write!(out, "  waitfor {} {}", meeting.name, meeting.round);
    if !meeting.is_waiting() {
        out.push_str(": none waiting\n");
        return;
    }
    let _ = write!(out, ": {} of {} arrived", meeting.arrived(), meeting.members.len());
    if let Some(left) = meeting.left {
        let _ = write!(out, ", {left} left");
    }
    let missing =
        meeting.members.iter().filter(|m| matches!(m.standing, Standing::Missing | Standing::Unknown));
    let missing: Vec<_> = missing.map(|m| format!("{}@{} ({})", m.name, m.node, m.doing)).collect();
    if !missing.is_empty() {
        let _ = write!(out, ", missing {}", missing.join(", "));
    }
    out.push('\n');
}
