//! The sessions with one neighbour, whatever handshakes made them: which one closes what is sent, and which are over.

use super::Live;
use std::sync::Arc;

/// How long a session is kept after the neighbour was heard in a newer one, for datagrams that are under way.
const KEPT: u64 = 10_000_000;
/// How many sessions are kept, at most.
const SESSIONS: usize = 8;

/// Sessions with one neighbour. All that are confirmed have one start of it.
pub(super) struct Sessions(Vec<Arc<Live>>);

impl Sessions {
    pub(super) fn new() -> Self {
        Self(Vec::with_capacity(SESSIONS))
    }

    pub(super) fn iter(&self) -> std::slice::Iter<'_, Arc<Live>> {
        self.0.iter()
    }

    /// The session that closes what this node sends: the newest one that the neighbour has.
    pub(super) fn sending(&self) -> Option<&Arc<Live>> {
        self.newest(Live::is_confirmed)
    }

    /// The newest session in which the neighbour was heard. The neighbour sends in the newest one that it knows this node to have, so
    /// it uses no older one any more. A newer one it may not know yet.
    fn used(&self) -> Option<&Arc<Live>> {
        self.newest(|live| live.heard().is_some())
    }

    fn newest(&self, is_one: impl Fn(&Live) -> bool) -> Option<&Arc<Live>> {
        let ones = self.0.iter().filter(|live| is_one(live));
        ones.reduce(|newest, live| if live.is_after(newest) { live } else { newest })
    }

    /// Whether this is one of them.
    pub(super) fn has(&self, live: &Arc<Live>) -> bool {
        self.0.iter().any(|one| Arc::ptr_eq(one, live))
    }

    /// Adds one. If there are too many, the oldest goes that neither this node nor the neighbour is known to send in.
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

    /// The neighbour has closed a datagram with this one. Returns whether that is news.
    pub(super) fn confirm(&mut self, live: &Arc<Live>, now: u64) -> bool {
        let is_news = live.heard().is_none() && self.has(live) && live.hear(now);
        if is_news {
            self.end_earlier_starts();
        }
        is_news
    }

    /// A node runs once at a time: sessions with an earlier start of the neighbour are over. In each confirmed session the neighbour
    /// has answered this node's part, so of two starts that one is later in whose session this node did its part later.
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
