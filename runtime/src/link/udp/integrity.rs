//! Decides from damaged datagrams whether a link counts as faulty (D205).
//!
//! Damaged datagrams alone prove nothing about a link, because anybody can send garbage with a neighbour's source
//! address. But a link that damages datagrams thereby loses them, and each loss shows as a gap in the neighbour's
//! counters. Garbage of another program makes no gap. So a link counts as faulty if two numbers in one window both
//! exceed [`FAILURES`]: that of damaged datagrams, and that of missing datagrams of the neighbour. If only the first
//! one does, the window counts as unmatched.
//!
//! A faulty link is only a warning: it changes nothing of what the node sends or accepts.

use imrs_wire::envelope::Session;
use imrs_wire::obs::Integrity;

/// More damaged datagrams than this in one [`WINDOW`] are a fault of the link, or an attack.
pub const FAILURES: u64 = 8;
/// The length of a window, in microseconds. It begins with the first damaged datagram.
pub const WINDOW: u64 = 10_000_000;

/// How many datagrams of a neighbour were accepted, and which counter comes next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Progress {
    /// The session of these datagrams; `None` if no datagram was accepted yet.
    pub(super) session: Option<Session>,
    pub(super) next: u64,
    pub(super) accepted: u64,
}

impl Progress {
    /// How many of the datagrams that the neighbour has sent since `earlier` are missing.
    fn missing_since(&self, earlier: &Self) -> u64 {
        if self.session != earlier.session {
            return 0;
        }
        let sent = self.next.saturating_sub(earlier.next);
        sent.saturating_sub(self.accepted.saturating_sub(earlier.accepted))
    }
}

/// What this node knows of the damaged datagrams of one neighbour.
#[derive(Debug, Default)]
pub(super) struct IntegrityWatch {
    told: Integrity,
    window: Option<Window>,
    /// Until when the link counts as faulty.
    faulty_until: u64,
}

#[derive(Clone, Copy, Debug)]
struct Window {
    begun: u64,
    failures: u64,
    /// The progress of the neighbour's datagrams when the window began.
    before: Progress,
    is_faulty: bool,
}

impl IntegrityWatch {
    /// Notes a damaged datagram at the instant `now`.
    pub(super) fn failed(&mut self, now: u64, progress: Progress) {
        self.judge(now, progress);
        let new = Window { begun: now, failures: 0, before: progress, is_faulty: false };
        self.told.failures += 1;
        self.window.get_or_insert(new).failures += 1;
        self.judge(now, progress);
    }

    /// The report about the link at the instant `now`.
    pub(super) fn report(&mut self, now: u64, progress: Progress) -> Integrity {
        self.judge(now, progress);
        Integrity { is_faulty: now < self.faulty_until, ..self.told }
    }

    fn judge(&mut self, now: u64, progress: Progress) {
        let Some(window) = &mut self.window else { return };
        let is_much = window.failures > FAILURES;
        if is_much && !window.is_faulty && progress.missing_since(&window.before) > FAILURES {
            window.is_faulty = true;
            self.told.faults += u64::from(now >= self.faulty_until);
            // The link counts as faulty until a whole window has passed without a fault.
            self.faulty_until = window.begun.saturating_add(2 * WINDOW);
        }
        if now.saturating_sub(window.begun) >= WINDOW {
            self.told.unmatched += u64::from(is_much && !window.is_faulty);
            self.window = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The progress of a neighbour that has sent `next` datagrams, of which this node has accepted
    /// `accepted`.
    fn progress(next: u64, accepted: u64) -> Progress {
        Progress { session: Some(Session(1)), next, accepted }
    }

    #[test]
    fn a_link_that_damages_what_the_neighbour_sends_is_faulty_until_it_has_been_well_for_a_window() {
        let mut watch = IntegrityWatch::default();
        for number in 0..=FAILURES {
            assert_eq!(
                watch.report(number, progress(number, 0)),
                Integrity { failures: number, ..Integrity::default() }
            );
            watch.failed(number, progress(number, 0));
        }
        // The next datagram that arrives whole shows that all datagrams before it are missing.
        let told = watch.report(20, progress(FAILURES + 2, 1));
        assert_eq!(told, Integrity { failures: FAILURES + 1, is_faulty: true, faults: 1, unmatched: 0 });
        let later = progress(500, 499 - FAILURES);
        assert!(watch.report(2 * WINDOW - 1, later).is_faulty);
        let told = watch.report(2 * WINDOW, later);
        assert_eq!(told, Integrity { failures: FAILURES + 1, is_faulty: false, faults: 1, unmatched: 0 });
    }

    #[test]
    fn garbage_beside_a_healthy_link_makes_it_not_faulty() {
        let mut watch = IntegrityWatch::default();
        for number in 0..10_000 {
            watch.failed(number, progress(number, number));
        }
        assert_eq!(watch.report(WINDOW - 1, progress(9_999, 9_999)).unmatched, 0, "not judged yet");
        let told = watch.report(WINDOW, progress(9_999, 9_999));
        assert_eq!(told, Integrity { failures: 10_000, is_faulty: false, faults: 0, unmatched: 1 });
    }

    #[test]
    fn few_failures_losses_alone_and_another_session_are_no_fault() {
        let mut watch = IntegrityWatch::default();
        (0..FAILURES).for_each(|at| watch.failed(at, progress(0, 0)));
        assert_eq!(watch.report(WINDOW, progress(900, 0)).faults, 0, "few failures");
        (0..100).for_each(|at| watch.failed(3 * WINDOW + at, progress(900, 0)));
        assert_eq!(watch.report(3 * WINDOW + 100, progress(900 + FAILURES, 0)).faults, 0, "few missing");
        let restarted = Progress { session: Some(Session(2)), next: 900_000, accepted: 1 };
        assert_eq!(watch.report(3 * WINDOW + 101, restarted).faults, 0, "of another session");
    }
}
