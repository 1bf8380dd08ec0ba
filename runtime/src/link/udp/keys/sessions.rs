//! The sessions with one neighbour: which of them encrypts what this node sends, and which are over.

use super::Live;
use std::sync::Arc;

/// How long a session is kept after a datagram of the neighbour came in a newer one, because datagrams of the older
/// session may still be in flight. In microseconds.
const KEPT: u64 = 10_000_000;
/// How many sessions are kept, at most.
const SESSIONS: usize = 8;

/// The sessions with one neighbour. All sessions in which the neighbour has sent belong to one start of the
/// neighbour.
pub(super) struct Sessions(Vec<Arc<Live>>);

impl Sessions {
    pub(super) fn new() -> Self {
        Self(Vec::with_capacity(SESSIONS))
    }

    pub(super) fn iter(&self) -> std::slice::Iter<'_, Arc<Live>> {
        self.0.iter()
    }

    /// The session whose keys encrypt what this node sends: the newest session of which the neighbour is
    /// known to have the keys.
    pub(super) fn sending(&self) -> Option<&Arc<Live>> {
        self.newest(Live::is_confirmed)
    }

    /// The newest session in which the neighbour has sent. The neighbour sends in the newest session that it knows
    /// this node to have. So it does not use older sessions any more, but may not know yet that this node has a newer
    /// one.
    fn used(&self) -> Option<&Arc<Live>> {
        self.newest(|live| live.heard().is_some())
    }

    fn newest(&self, is_one: impl Fn(&Live) -> bool) -> Option<&Arc<Live>> {
        let ones = self.0.iter().filter(|live| is_one(live));
        ones.reduce(|newest, live| if live.is_after(newest) { live } else { newest })
    }

    /// Whether `live` is one of these sessions.
    pub(super) fn has(&self, live: &Arc<Live>) -> bool {
        self.0.iter().any(|one| Arc::ptr_eq(one, live))
    }

    /// Adds a session. If there are too many, removes the oldest one in which neither node sends. Of the neighbour
    /// this is known only as far as its datagrams show.
    pub(super) fn add(&mut self, live: Live) {
        if self.0.len() == SESSIONS {
            let needed = [self.sending(), self.used()];
            let is_needed = |live: &Arc<Live>| needed.iter().flatten().any(|one| Arc::ptr_eq(one, live));
            let oldest = self.0.iter().position(|live| !is_needed(live));
            self.0.remove(oldest.unwrap_or(0));
        }
        self.0.push(Arc::new(live));
        self.end_earlier_starts();
    }

    /// Notes that the neighbour has sent a datagram in this session. Returns whether this is the first one.
    pub(super) fn confirm(&mut self, live: &Arc<Live>, now: u64) -> bool {
        let is_news = live.heard().is_none() && self.has(live) && live.hear(now);
        if is_news {
            self.end_earlier_starts();
        }
        is_news
    }

    /// Ends the sessions with earlier starts of the neighbour: only one start of a node runs at a time. In each
    /// confirmed session the neighbour has answered this node. So of two starts of the neighbour, the later one is
    /// that whose session this node began later.
    fn end_earlier_starts(&mut self) {
        let confirmed = self.0.iter().filter(|live| live.is_confirmed());
        let latest = confirmed.reduce(|latest, live| if live.is_begun_after(latest) { live } else { latest });
        if let Some(latest) = latest.cloned() {
            self.0.retain(|live| live.bound.sender == latest.bound.sender || live.is_begun_after(&latest));
        }
    }

    /// Forgets sessions that no datagram can need any more.
    pub(super) fn retire(&mut self, now: u64) {
        if self.0.len() < 2 {
            return;
        }
        let Some(used) = self.used().cloned() else { return };
        if used.heard().is_some_and(|at| now.saturating_sub(at) >= KEPT) {
            self.0.retain(|live| live.bound.sender != used.bound.sender || !used.is_after(live));
        }
    }
}
