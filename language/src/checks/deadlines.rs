//! Checks that time_outs cover the link delays, and the work that an answer takes.
//!
//! A time_out that is certainly too short is an error. Each link subtracts its whole delay from a message's TTL (D20). The
//! delay of the answer's way back is reserved (D18). No answer comes before the actions that precede it end. A node may act
//! up to a tick late, but need not (D42). If a time_out is too short only when nodes act late and actions are slow, that is
//! a warning (D99).

use super::messages::{carries_heartbeats, senders, sends_to};
use super::work::{self, Work};
use super::{LEAST_TICKS, task, tasks, time};
use crate::codes::{DEADLINE, TIGHT_DEADLINE};
use crate::diagnostic::Diagnostic;
use crate::hir::{Duration, Hir, Port, Recipients, StatementKind};
use crate::walk;
use imrs_protocol::margin::least_margin;
use imrs_protocol::{Class, PortId, TaskId, Ticks, Usage};

pub(super) fn check(hir: &Hir, found: &mut Vec<Diagnostic>) {
    for (at, port) in hir.ports.iter().enumerate() {
        let needs = needs(hir, PortId::from_index(at));
        let mut ttls: Vec<Duration> = needs.iter().filter_map(|need| ttl(port, need.from)).collect();
        ttls.sort_by_key(|ttl| ttl.span.start);
        ttls.dedup();
        for ttl in ttls {
            let own: Vec<&Need> =
                needs.iter().filter(|need| self::ttl(port, need.from) == Some(ttl)).collect();
            found.extend(too_short(hir, port, ttl, &own));
        }
    }
    for (from, sender) in tasks(hir) {
        walk::of_task(sender, &mut |statement| {
            let StatementKind::Send { port, to, within: Some(within), .. } = &statement.kind else { return };
            let needs = needs(hir, *port);
            let own = needs.iter().filter(|need| match to {
                Recipients::All => need.from == from,
                Recipients::These(tasks) => need.from == from && tasks.contains(&need.to),
            });
            found.extend(too_short(hir, &hir.ports[port.index()], *within, &own.collect::<Vec<_>>()));
        });
    }
}

/// The least time_out of a port in microseconds, a whole number of ticks, that no check reports: neither E206 (too few
/// ticks), E201 (shorter than delays and work) nor W318 (too short if nodes act late). With `of`, only messages with the
/// time_out `of` count.
pub(crate) fn least(hir: &Hir, id: PortId, of: Option<Duration>) -> u64 {
    let tick = tick(hir);
    let port = &hir.ports[id.index()];
    let least = match port.usage {
        Usage::Waitfor => meeting(hir, port),
        _ => needs(hir, id)
            .iter()
            .filter(|need| of.is_none() || ttl(port, need.from) == of)
            .map(|need| after(need.enough(hir), tick))
            .max()
            .unwrap_or_default(),
    };
    least.max(tick.saturating_mul(LEAST_TICKS))
}

/// The least time_out of a `waitfor`: more than its margin and the longest delay between members (D56). If the port
/// declares no `resend`, the margin grows with the time_out.
fn meeting(hir: &Hir, port: &Port) -> u64 {
    let tick = tick(hir);
    let parties: Vec<TaskId> = port.parties().collect();
    let way = |a: &TaskId, b: &TaskId| delay(hir, &hir.way(task(hir, *a).node, task(hir, *b).node));
    let farthest =
        parties.iter().flat_map(|a| parties.iter().map(move |b| way(a, b))).max().unwrap_or_default();
    let losses = port.users.iter().filter_map(|user| user.retry).fold(port.retry, u8::max);
    let needed = |time_out: u64| {
        let resend = port.resend.map_or(time_out / (u64::from(losses) + 1), |resend| resend.usec);
        let margin = least_margin(Ticks(farthest), losses, Ticks(resend), Ticks(tick)).0;
        after(if hir.paper { farthest } else { margin.saturating_add(farthest) }, tick)
    };
    let mut least = needed(0);
    for _ in 0..ROUNDS {
        let more = needed(least);
        if more <= least {
            break;
        }
        least = more;
    }
    least
}

/// Most iterations of the search for the least time_out of a `waitfor`. The margin grows with the time_out; even a margin
/// for 255 losses has converged after so many iterations.
const ROUNDS: usize = 10_000;

/// The first whole tick after a time.
fn after(usec: u64, tick: u64) -> u64 {
    (usec / tick).saturating_add(1).saturating_mul(tick)
}

fn tick(hir: &Hir) -> u64 {
    hir.tick.map_or(1, |tick| tick.usec.max(1))
}

/// The time_out of the messages that `from` sends on this port.
fn ttl(port: &Port, from: TaskId) -> Option<Duration> {
    port.user(from).and_then(|user| user.time_out).or(port.time_out)
}

/// The time that a message from one sender to one receiver needs, with its answer.
struct Need {
    from: TaskId,
    to: TaskId,
    /// The total delay of the links on the route, and their number.
    way: u64,
    links: u64,
    /// Whether an answer comes back.
    answered: bool,
    work: Work,
}

impl Need {
    fn ways(&self) -> u64 {
        if self.answered { 2 } else { 1 }
    }

    /// The time that message and answer take in any case. A shorter time_out always ends before the answer comes.
    fn certain(&self) -> u64 {
        self.way.saturating_mul(self.ways()).saturating_add(self.work.least)
    }

    /// The time that message and answer may take without faults: in the worst case each node on the route acts a tick late,
    /// and the actions are slow.
    fn enough(&self, hir: &Hir) -> u64 {
        let ticks = self.links.saturating_mul(tick(hir));
        let way = self.way.saturating_add(ticks).saturating_mul(self.ways());
        way.saturating_add(self.work.slow)
    }

    /// The route there and back, as text: `a -> b -> a`.
    fn round(&self, hir: &Hir) -> String {
        let (from, to) = (&task(hir, self.from).name, &task(hir, self.to).name);
        if self.answered { format!("{from} -> {to} -> {from}") } else { format!("{from} -> {to}") }
    }

    /// The parts of the time, as text: `2 x 3 msec on the links`, with `more` added for each link, and then `work`.
    fn parts(&self, more: u64, work: u64) -> String {
        let ways = if self.answered { "2 x " } else { "" };
        let tick = match more {
            0 => String::new(),
            more => format!(" + {ways}{} for the ticks of its nodes", time(more.saturating_mul(self.links))),
        };
        let work = if work == 0 { String::new() } else { format!(" + {} for the answer", time(work)) };
        format!("{ways}{} on the links{tick}{work}", time(self.way))
    }
}

/// How much time the messages of a port need, for each sender and receiver that a route joins.
fn needs(hir: &Hir, id: PortId) -> Vec<Need> {
    let port = &hir.ports[id.index()];
    let mut needs = Vec::new();
    if port.usage == Usage::Waitfor {
        return needs;
    }
    for from in senders(port) {
        for to in port.peers(from) {
            let (a, b) = (task(hir, from).node, task(hir, to).node);
            let links = hir.way(a, b);
            if links.is_empty() && a != b {
                continue;
            }
            let answered = port.class == Class::Command && port.usage != Usage::Reply;
            // Communication tasks answer heartbeats themselves (D61). A task to which no task sends a message has no work.
            let works = answered && !carries_heartbeats(hir, id) && sends_to(hir, id, from, to);
            let work = if works { work::of(hir, to, id) } else { Work::default() };
            needs.push(Need { from, to, way: delay(hir, &links), links: links.len() as u64, answered, work });
        }
    }
    needs
}

/// The total delay of `links`.
fn delay(hir: &Hir, links: &[usize]) -> u64 {
    links.iter().fold(0, |sum: u64, &link| sum.saturating_add(hir.links[link].delay.usec))
}

/// The diagnostic for a time_out, or for a `within`, that is too short for messages with these needs.
fn too_short(hir: &Hir, port: &Port, ttl: Duration, needs: &[&Need]) -> Option<Diagnostic> {
    let enough = needs.iter().map(|need| need.enough(hir)).max()?;
    let tick = tick(hir);
    let least = after(enough, tick).max(tick.saturating_mul(LEAST_TICKS));
    let help = format!("give it {} or more", time(least));
    let worst = needs.iter().max_by_key(|need| need.certain())?;
    let has = time(ttl.usec);
    if ttl.usec <= worst.certain() {
        let needed = time(worst.certain());
        let message = format!(
            "deadline cannot be met: `{}` {} takes {needed}, it has {has}",
            port.name,
            worst.round(hir)
        );
        let mut label = format!("must exceed {}", worst.parts(0, worst.work.least));
        if label.contains(" x ") || label.contains(" + ") {
            label = format!("{label} = {needed}");
        }
        let found = Diagnostic::error(DEADLINE, ttl.span, message).label(label).also(port.span, "the port");
        return Some(found.help(help));
    }
    let worst = needs.iter().max_by_key(|need| need.enough(hir))?;
    if ttl.usec > enough || ttl.usec < tick.saturating_mul(LEAST_TICKS) {
        return None;
    }
    let message = format!("`{}` {} may take {}, it has {has}", port.name, worst.round(hir), time(enough));
    let label = format!("should exceed {}", worst.parts(tick, worst.work.slow));
    let found = Diagnostic::warning(TIGHT_DEADLINE, ttl.span, message).label(label);
    Some(found.also(port.span, "the port").help(help))
}
