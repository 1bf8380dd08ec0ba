//! Decides from which session of a neighbour datagrams are accepted (D144).
//!
//! A node draws a new session at every start. Sessions have no order. So a datagram of another session than the known
//! one must prove that it was sent later. Its echo is the proof: it names an instant of *this* node's clock before
//! the datagram was sent. If that instant is not before the arrival of the known session's last datagram, the new
//! datagram was sent after that arrival. A node runs only once at a time, so the known session is over.
//!
//! A datagram of an ended session was sent before the current session began, so its echo is never late enough. It
//! cannot replace the current session, however often and whenever it is repeated. If a new session of a neighbour
//! gives no such echo, this node asks the neighbour for one, which takes one exchange of datagrams.
//!
//! The same proof corrects a wrong counter. If a datagram proves that it was sent after the datagram with the
//! greatest counter had arrived, its own counter must be the greater one. So the greatest counter was wrong.

use super::delay::LinkDelay;
use super::integrity::Progress;
use crate::link::LinkDiscard;
use imrs_protocol::{Incarnation, Ticks};
use imrs_wire::envelope::{Envelope, Purpose, ReplayWindow, Session, supersedes};

/// The session of a neighbour from which datagrams are accepted, as the receiving threads know it. Times are of this node's
/// clock.
#[derive(Debug)]
pub(super) struct Known {
    pub(super) session: Session,
    incarnation: Incarnation,
    window: ReplayWindow,
    /// When the datagram with the newest counter arrived.
    newest_at: u64,
    /// When a datagram of the session was last accepted.
    last: u64,
    /// How many datagrams of the session were accepted, except greetings without a counter of their own.
    accepted: u64,
    pub(super) delay: LinkDelay,
}

impl Known {
    /// How many datagrams were accepted, and which counter comes next.
    pub(super) const fn progress(&self) -> Progress {
        Progress { session: Some(self.session), next: self.window.next(), accepted: self.accepted }
    }

    /// Notes a goodbye with this counter.
    ///
    /// # Errors
    /// A newer datagram of the session came before.
    pub(super) fn ends(&mut self, counter: u64) -> Result<(), LinkDiscard> {
        if !self.window.is_newest(counter) {
            return Err(LinkDiscard::Replayed);
        }
        self.window.accept(counter);
        self.accepted += 1;
        Ok(())
    }

    /// Notes a greeting that was encrypted with keys, because such a greeting has a counter of its own.
    pub(super) const fn has_greeted(&mut self) {
        self.accepted += 1;
    }
}

/// How an accepted datagram relates to the earlier datagrams of its sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Contact {
    /// The datagram is from the known session.
    Known,
    /// The datagram is from the known session. The counter that was held to be the session's newest came from a stray
    /// datagram, and has been replaced.
    Resumed,
    /// The datagram is from a session that was not known before. `restarted` says whether an earlier session may have taken
    /// requests.
    New { restarted: bool },
}

/// Why a datagram is dropped, and whether the neighbour is asked for an echo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Unheard {
    pub(super) reason: LinkDiscard,
    /// Whether an echo can decide if the datagram is accepted. If so, this node asks the neighbour for one.
    pub(super) asks: bool,
}

/// Judges a datagram by its sender's session and its counter. The judgement changes no state.
///
/// `sent_after` is an instant before the datagram was sent, if the datagram proves one. With `one_way` no exchange is
/// possible, because nothing can be sent to the neighbour; the order of incarnations then decides (D49).
pub(super) fn judge(
    known: Option<&Known>,
    envelope: &Envelope,
    sent_after: Option<u64>,
    one_way: impl FnOnce() -> bool,
) -> Result<Contact, Unheard> {
    let Some(known) = known else { return Ok(Contact::New { restarted: envelope.restarted }) };
    let is_later_than = |at: u64| sent_after.is_some_and(|sent| sent >= at);
    if known.session == envelope.session {
        let (window, counter) = (&known.window, envelope.counter);
        return if envelope.purpose != Purpose::Packets || window.is_new(counter) {
            Ok(Contact::Known)
        } else if window.is_behind(counter) && is_later_than(known.newest_at) {
            Ok(Contact::Resumed)
        } else {
            Err(Unheard { reason: LinkDiscard::Replayed, asks: window.is_behind(counter) })
        };
    }
    let is_newer = || supersedes(envelope.incarnation, known.incarnation);
    if is_later_than(known.last) || is_newer() && one_way() {
        return Ok(Contact::New { restarted: true });
    }
    let stale = supersedes(known.incarnation, envelope.incarnation);
    let reason = if stale { LinkDiscard::StaleIncarnation } else { LinkDiscard::UnprovenSession };
    Err(Unheard { reason, asks: true })
}

/// Records a datagram that was accepted at the instant `at`. `declared` is the bound of the link.
pub(super) fn admit<'a>(
    known: &'a mut Option<Known>,
    contact: Contact,
    envelope: &Envelope,
    (at, declared): (u64, Ticks),
) -> &'a mut Known {
    if let Contact::New { .. } = contact {
        *known = None;
    }
    let known = known.get_or_insert_with(|| Known {
        session: envelope.session,
        incarnation: envelope.incarnation,
        window: ReplayWindow::new(),
        newest_at: at,
        last: at,
        accepted: 0,
        delay: LinkDelay::new(declared),
    });
    known.last = at;
    if envelope.purpose == Purpose::Packets {
        known.accepted += 1;
        if contact == Contact::Resumed {
            known.window.resume(envelope.counter);
            known.newest_at = at;
        } else {
            if known.window.is_newest(envelope.counter) {
                known.newest_at = at;
            }
            known.window.accept(envelope.counter);
        }
    }
    known
}

#[cfg(test)]
mod tests {
    use super::*;
    use imrs_protocol::NodeId;

    fn envelope(session: u64, incarnation: u8, counter: u64) -> Envelope {
        Envelope {
            sender: NodeId(0),
            receiver: NodeId(1),
            incarnation: Incarnation(incarnation),
            restarted: false,
            session: Session(session),
            counter,
            tx_mono: 0,
            echo: None,
            purpose: Purpose::Packets,
        }
    }

    /// What is known of a neighbour from which the datagrams `(session, incarnation, counter)` were accepted, each at
    /// its time.
    fn heard(datagrams: &[(u64, u8, u64, u64)]) -> Option<Known> {
        let mut known = None;
        for &(session, incarnation, counter, at) in datagrams {
            let envelope = envelope(session, incarnation, counter);
            let new = known.as_ref().is_none_or(|k: &Known| k.session.0 != session);
            let contact = if new { Contact::New { restarted: false } } else { Contact::Known };
            admit(&mut known, contact, &envelope, (at, Ticks(0)));
        }
        known
    }

    fn judged(
        known: &Option<Known>,
        envelope: &Envelope,
        sent_after: Option<u64>,
    ) -> Result<Contact, Unheard> {
        judge(known.as_ref(), envelope, sent_after, || false)
    }

    #[test]
    fn a_new_session_takes_over_when_it_was_sent_after_all_that_came() {
        let known = heard(&[(1, 200, 0, 100), (1, 200, 1, 500)]);
        // The neighbour has lost its state, so it counts its incarnations from the beginning again.
        let again = envelope(2, 0, 0);
        let unproven = |sent_after| judged(&known, &again, sent_after).unwrap_err();
        assert_eq!(unproven(None), Unheard { reason: LinkDiscard::UnprovenSession, asks: true });
        assert_eq!(unproven(Some(499)).reason, LinkDiscard::UnprovenSession);
        assert_eq!(judged(&known, &again, Some(500)), Ok(Contact::New { restarted: true }));
    }

    #[test]
    fn a_dead_session_takes_nothing_over() {
        // In the peer's first session, the peer had heard what this node sent until the instant 400. Then the session
        // ended. Datagrams of the peer's next session are accepted from the instant 600 on.
        let known = heard(&[(1, 3, 9, 410), (2, 4, 0, 600)]);
        for sent_after in [None, Some(0), Some(400), Some(599)] {
            let reason = judged(&known, &envelope(1, 3, 10), sent_after).unwrap_err().reason;
            assert_eq!(reason, LinkDiscard::StaleIncarnation);
        }
    }

    #[test]
    fn without_a_way_back_the_later_incarnation_is_taken() {
        let known = heard(&[(1, 3, 9, 410)]);
        let one_way = |incarnation| judge(known.as_ref(), &envelope(2, incarnation, 0), None, || true);
        assert_eq!(one_way(4), Ok(Contact::New { restarted: true }));
        assert_eq!(one_way(2).unwrap_err().reason, LinkDiscard::StaleIncarnation);
        assert_eq!(one_way(3).unwrap_err().reason, LinkDiscard::UnprovenSession);
    }

    #[test]
    fn a_mistaken_counter_is_mended_by_what_was_sent_after_it() {
        let mut known = heard(&[(1, 0, 7, 100), (1, 0, 1 << 50, 200)]);
        let next = envelope(1, 0, 8);
        assert_eq!(
            judged(&known, &next, Some(199)),
            Err(Unheard { reason: LinkDiscard::Replayed, asks: true })
        );
        assert_eq!(judged(&known, &next, Some(200)), Ok(Contact::Resumed));
        admit(&mut known, Contact::Resumed, &next, (300, Ticks(0)));
        assert_eq!(judged(&known, &envelope(1, 0, 9), None), Ok(Contact::Known));
        for seen in [7, 8] {
            let again = judged(&known, &envelope(1, 0, seen), Some(300));
            assert_eq!(again, Err(Unheard { reason: LinkDiscard::Replayed, asks: false }));
        }
    }
}
