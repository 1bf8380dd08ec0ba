//! Turns the errors of a cell's table into diagnostics on the lines that cause them.

use super::Unit;
use crate::checks::least_time_out;
use crate::codes::{
    COUPLE, DEADLINE, DISAGREE, DUPLICATE, LEASE_TOO_SHORT, MISSING, NO_LINK, OPTION, RATE,
    TAKEOVER_TOO_SOON, TOO_LONG, TOO_MANY, TWICE, UNKNOWN_NAME, WRAPS,
};
use crate::diagnostic::Diagnostic;
use crate::hir::{CoupleKind, Duration, Hir, Port};
use crate::span::Span;
use imrs_protocol::margin::{DRIFT_PPM, takeover_margin};
use imrs_protocol::{CellError, PortId, Ticks};

/// The diagnostics for the errors of [`CellTable::new`](imrs_protocol::CellTable::new) on a lowered cell. `unit` is the unit
/// of that cell.
#[must_use]
pub fn table_errors(hir: &Hir, unit: Unit, errors: &[CellError]) -> Vec<Diagnostic> {
    errors.iter().map(|error| Mapping { hir, usec: unit.usec(hir) }.error(error)).collect()
}

struct Mapping<'h> {
    hir: &'h Hir,
    usec: u64,
}

impl Mapping<'_> {
    fn error(&self, error: &CellError) -> Diagnostic {
        match error {
            CellError::MarginTooLong { port, time_out, least } => {
                self.deadline(port, *time_out, *least, true)
            }
            CellError::DeadlineTooShort { port, time_out, least } => {
                self.deadline(port, *time_out, *least, false)
            }
            CellError::LeaseTooShort { couple, lease, least } => self.lease(couple, *lease, *least),
            CellError::TakeoverTooSoon { couple, takeover, least } => {
                self.takeover(couple, *takeover, *least)
            }
            CellError::SequenceWraps(port) => {
                let at = self.port(port).and_then(|port| port.rate).map(|(_, per)| per.span);
                let at = at.unwrap_or_else(|| self.port_span(port));
                let message = format!("message numbers of `{port}` may repeat within its time_out");
                Diagnostic::error(WRAPS, at, message)
                    .label(self.numbers(port))
                    .also(self.port_span(port), "the port")
                    .help("lower its rate or its time_out")
            }
            CellError::Unreachable(port, a, b) => {
                let message = format!("port `{port}` joins `{a}` and `{b}`, but no links join their nodes");
                Diagnostic::error(NO_LINK, self.port_span(port), message)
                    .label("no route of at most 8 links")
                    .also(self.task_span(a), "one task")
                    .also(self.task_span(b), "the other")
                    .help("add `link .. -- .. delay ..;`")
            }
            CellError::CannotBeServed { port, per, least } => self.rate(port, *per, *least),
            CellError::NoUsers(port)
            | CellError::NoRoomForEpoch(port)
            | CellError::OtherClass(port, _)
            | CellError::OtherFormat(port, _)
            | CellError::NoTimeOut(port)
            | CellError::NoBuffer(port)
            | CellError::NeedsClass2(port)
            | CellError::Fragments(port, _)
            | CellError::TooManyMembers(port)
            | CellError::TooManyAsked(port)
            | CellError::ListedTwice(port, _)
            | CellError::UnknownModule(port, _)
            | CellError::NotForHeartbeats(port)
            | CellError::NotOfTheCouple(port) => {
                let found = Diagnostic::error(code(error), self.port_span(port), error.to_string());
                found.label("this port")
            }
            CellError::CoupledTwice(couple) => {
                Diagnostic::error(COUPLE, self.couple_span(couple), error.to_string()).label("the second one")
            }
            CellError::LinkToItself(_)
            | CellError::DuplicateName(..)
            | CellError::Dangling(_)
            | CellError::TooMany(..) => {
                Diagnostic::error(code(error), self.whole(), error.to_string()).label("in this cell")
            }
        }
    }

    fn deadline(&self, name: &str, time_out: Ticks, least: Ticks, waitfor: bool) -> Diagnostic {
        let (has, needs) = (self.time(time_out), self.time(least));
        // The party of the port that declares the shortest time_out.
        let own = self.port(name).and_then(|port| {
            let ends = port.users.iter().filter_map(|user| user.time_out).chain(port.time_out);
            ends.min_by_key(|length| length.usec)
        });
        let at = own.map_or_else(|| self.port_span(name), |length| length.span);
        let (message, label) = if waitfor {
            (
                format!(
                    "no task is ever released from `{name}`: its time_out of {has} is used up by its margin"
                ),
                format!("must exceed {needs}: the margin for lost packets, and the link delays"),
            )
        } else {
            // This error occurs only with durations in ticks. In microseconds the static checks have already reported
            // the fault, with more detail.
            (
                format!("deadline cannot be met: `{name}` takes {needs}, its time_out is {has}"),
                format!("must exceed {needs}: the links on its route, in ticks"),
            )
        };
        let enough = self.hir.ports.iter().position(|port| port.name == name);
        let enough = enough.map_or(0, |at| least_time_out(self.hir, PortId::from_index(at), None));
        let more = needs_more(least.0.saturating_mul(self.usec), enough, self.hir);
        Diagnostic::error(DEADLINE, at, message)
            .label(label)
            .also(self.port_span(name), "the port")
            .help(format!("give it {} or more", self.time(Ticks(more.div_ceil(self.usec)))))
    }

    /// The number of messages that exceeds the sequence numbers, as text: `60 in 1 msec x 1 at the other end x 200 sec =
    /// 12000000 > 2^23`.
    fn numbers(&self, name: &str) -> String {
        let said = self.port(name).and_then(|port| {
            let ttls = port.users.iter().filter_map(|user| user.time_out).chain(port.time_out);
            let ttl = ttls.map(|ttl| ttl.usec).max()?;
            let rates = port.users.iter().filter_map(|user| Some((user.rate?, 1)));
            let own = port.rate.map(|rate| (rate, port.users.len()));
            let sent = |((count, per), to): ((u16, Duration), usize)| {
                u128::from(count) * to as u128 * u128::from(ttl) / u128::from(per.usec.max(1))
            };
            let ((count, per), to) = own.into_iter().chain(rates).max_by_key(|&rate| sent(rate))?;
            let all = sent(((count, per), to));
            let (per, ttl) = (self.time(Ticks(per.usec / self.usec)), self.time(Ticks(ttl / self.usec)));
            Some(format!("{count} in {per} x {to} at the other end x {ttl} = {all} > 2^23"))
        });
        said.unwrap_or_else(|| "too often".to_owned())
    }

    fn rate(&self, name: &str, per: Ticks, least: Ticks) -> Diagnostic {
        let rates =
            self.port(name).map(|port| port.users.iter().filter_map(|user| user.rate).chain(port.rate));
        let at = rates
            .and_then(|mut rates| rates.next())
            .map_or_else(|| self.port_span(name), |(_, per)| per.span);
        let message = format!("the rate of `{name}` cannot be served");
        Diagnostic::error(RATE, at, message)
            .label(format!("in {}, but there and back they take {}", self.time(per), self.time(least)))
            .also(self.port_span(name), "the port")
            .help("lower the rate: a class-2 message blocks its sender for the link delays there and back")
    }

    fn lease(&self, couple: &str, lease: Ticks, least: Ticks) -> Diagnostic {
        let (has, needs) = (self.time(lease), self.time(least));
        let at = self.work(couple).map_or_else(|| self.couple_span(couple), |(lease, _)| lease);
        Diagnostic::error(LEASE_TOO_SHORT, at, format!("lease {has} ends before it is renewed"))
            .label(format!("must reach {needs}: two heartbeat periods, the link delay and a tick"))
            .help(format!("give it {needs}, or shorten the period of the heartbeats"))
    }

    fn takeover(&self, couple: &str, takeover: Ticks, least: Ticks) -> Diagnostic {
        let (has, needs) = (self.time(takeover), self.time(least));
        // The longer the take-over, the more the clocks drift apart meanwhile, and so the longer the take-over must be.
        // After four repetitions the difference is below a microsecond.
        let drift = |length| takeover_margin(Ticks::ZERO, length, DRIFT_PPM, Ticks::ZERO, Ticks::ZERO);
        let enough = (0..4).fold(least, |enough, _| least + drift(enough - takeover));
        let whole = enough.0.checked_next_multiple_of((1_000 / self.usec).max(1));
        let enough = self.time(whole.map_or(enough, Ticks));
        let at = self.work(couple).map_or_else(|| self.couple_span(couple), |(_, takeover)| takeover);
        Diagnostic::error(TAKEOVER_TOO_SOON, at, format!("takeover {has}: both tasks can act at a time"))
            .label(format!("must reach {needs}: {}", self.parts(couple, least)))
            .help(format!(
                "give it {enough}, or shorten the lease or the time_outs of what the couple orders"
            ))
    }

    /// The parts of a take-over as text, if they are known: `lease 100 msec + 200 msec of grab + 3 msec for the tick and
    /// the drift`.
    fn parts(&self, couple: &str, least: Ticks) -> String {
        let known = self.work(couple).and_then(|(span, _)| {
            let (at, lease) =
                self.hir.couples.iter().enumerate().find_map(|(at, couple)| match couple.kind {
                    CoupleKind::Work { lease, .. } if lease.span == span => Some((at, lease.usec)),
                    CoupleKind::Work { .. }
                    | CoupleKind::Loose { .. }
                    | CoupleKind::Tight(_)
                    | CoupleKind::Serial(..) => None,
                })?;
            let guarded = self.hir.ports.iter().filter(|port| port.guard == Some(at));
            let ttls = guarded.filter_map(|port| {
                let ends = port.users.iter().filter_map(|user| user.time_out).chain(port.time_out);
                Some((ends.map(|ttl| ttl.usec).max()?, port.name.as_str()))
            });
            let (ttl, port) = ttls.max()?;
            let time = |usec: u64| self.time(Ticks(usec / self.usec));
            let rest = (least.0.saturating_mul(self.usec)).checked_sub(lease.saturating_add(ttl))?;
            Some(format!(
                "lease {} + {} of `{port}` + {} for the tick and the drift",
                time(lease),
                time(ttl),
                time(rest)
            ))
        });
        known.unwrap_or_else(|| "lease, drift, a tick and what was ordered last".to_owned())
    }

    fn time(&self, ticks: Ticks) -> String {
        let usec = ticks.0.saturating_mul(self.usec);
        if usec.is_multiple_of(1_000_000) && usec > 0 {
            format!("{} sec", usec / 1_000_000)
        } else if usec.is_multiple_of(1_000) {
            format!("{} msec", usec / 1_000)
        } else {
            format!("{usec} usec")
        }
    }

    fn port(&self, name: &str) -> Option<&Port> {
        self.hir.ports.iter().find(|port| port.name == name)
    }

    fn port_span(&self, name: &str) -> Span {
        self.port(name).map_or_else(|| self.whole(), |port| port.span)
    }

    fn task_span(&self, name: &str) -> Span {
        let task = self.hir.tasks.iter().find(|task| task.name == name);
        task.map_or_else(|| self.whole(), |task| task.span)
    }

    /// The spans of the lease and the take-over of a couple. The couple's name is `a -> b`.
    fn work(&self, name: &str) -> Option<(Span, Span)> {
        self.hir.couples.iter().find_map(|couple| match couple.kind {
            CoupleKind::Work { primary, standby, lease, takeover, .. } => {
                let task = |id: imrs_protocol::TaskId| self.hir.tasks[id.index()].name.as_str();
                let is = format!("{} -> {}", task(primary), task(standby)) == name;
                is.then_some((lease.span, takeover.span))
            }
            CoupleKind::Loose { .. } | CoupleKind::Tight(_) | CoupleKind::Serial(..) => None,
        })
    }

    fn couple_span(&self, name: &str) -> Span {
        self.work(name).map_or_else(|| self.whole(), |(lease, takeover)| lease.to(takeover))
    }

    /// The span for errors about the whole cell: its `tick`.
    fn whole(&self) -> Span {
        self.hir.tick.map_or_else(Span::default, |tick| tick.span)
    }
}

/// The longer of two times: the table's least time plus a tick, and the least time that all checks accept.
fn needs_more(least: u64, enough: u64, hir: &Hir) -> u64 {
    let tick = hir.tick.map_or(1, |tick| tick.usec.max(1));
    enough.max(least.saturating_add(tick))
}

const fn code(error: &CellError) -> &'static str {
    match error {
        CellError::NoUsers(_) | CellError::NoTimeOut(_) => MISSING,
        CellError::NoBuffer(_) | CellError::NeedsClass2(_) => OPTION,
        CellError::Fragments(..) | CellError::NoRoomForEpoch(_) => TOO_LONG,
        CellError::TooManyMembers(_) | CellError::TooManyAsked(_) | CellError::TooMany(..) => TOO_MANY,
        CellError::ListedTwice(..) | CellError::LinkToItself(_) => TWICE,
        CellError::OtherClass(..) | CellError::OtherFormat(..) => DISAGREE,
        CellError::UnknownModule(..) | CellError::Dangling(_) => UNKNOWN_NAME,
        CellError::DuplicateName(..) => DUPLICATE,
        CellError::NotForHeartbeats(_) | CellError::NotOfTheCouple(_) | CellError::CoupledTwice(_) => COUPLE,
        CellError::MarginTooLong { .. } | CellError::DeadlineTooShort { .. } => DEADLINE,
        CellError::Unreachable(..) => NO_LINK,
        CellError::SequenceWraps(_) => WRAPS,
        CellError::CannotBeServed { .. } => RATE,
        CellError::LeaseTooShort { .. } => LEASE_TOO_SHORT,
        CellError::TakeoverTooSoon { .. } => TAKEOVER_TOO_SOON,
    }
}
