//! The goodbye of a node that has stopped in order (D205), and how its neighbours handle it.
//!
//! A goodbye is the last datagram of a session. It counts only if it belongs to the session that this node
//! knows, and is newer than all other datagrams of that session. With keys only the neighbour can make such a
//! datagram. A goodbye needs no answer, and a lost one changes nothing: the neighbours then learn by their
//! time_outs that the node has stopped.

use super::UdpLink;
use super::keys::Live;
use super::peer::{Heard, Peer};
use super::receive::Together;
use super::session::{Contact, judge};
use super::statistics::UdpCount;
use crate::link::LinkDiscard;
use crate::lock::lock;
use imrs_wire::envelope::{Envelope, Purpose};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::Duration;

/// How many copies of a goodbye are sent, because a datagram may be lost.
const COPIES: u32 = 3;
/// The time between two copies.
const PAUSE: Duration = Duration::from_millis(5);

impl UdpLink {
    /// Tells every neighbour with which this node has talked that this node has stopped. Takes some 10 ms,
    /// whether the neighbours receive the goodbye or not.
    pub(super) fn say_goodbye(&self) {
        let met = |peer: &&Peer| peer.met.load(Ordering::Relaxed);
        for copy in 0..COPIES {
            if copy > 0 {
                thread::sleep(PAUSE);
            }
            for peer in self.peers.iter().filter(met) {
                let heard = *lock(&peer.heard);
                self.send_bare(peer, Purpose::Goodbye, heard);
            }
        }
    }
}

impl Together<'_> {
    /// Handles a goodbye. The first goodbye of the neighbour's session is reported to the sink.
    ///
    /// # Errors
    /// The reason for which the goodbye is dropped: this node does not know its session, and its echo does not prove
    /// when it was sent; or a newer datagram of its session came before.
    pub(super) fn hears_goodbye(
        &mut self,
        peer: &Peer,
        envelope: &Envelope,
        at: u64,
        by: Option<&Arc<Live>>,
    ) -> Result<(), LinkDiscard> {
        let link = self.link;
        let mut known = lock(&peer.known);
        let sent_after =
            link.proof(peer, known.as_ref(), envelope, by).or_else(|| link.sent_after(envelope, at));
        let contact =
            judge(known.as_ref(), envelope, sent_after, || false).map_err(|unheard| unheard.reason)?;
        // The decoded packets that were not handed over yet were sent before the goodbye, so they go first.
        self.hand_over();
        if let Contact::New { .. } = contact {
            if sent_after.is_none() {
                return Err(LinkDiscard::UnprovenSession);
            }
            self.enter(peer, &mut known, (envelope, contact), at);
        }
        if let Some(known) = known.as_mut() {
            known.ends(envelope.counter)?;
        }
        drop(known);
        *lock(&peer.heard) = Some(Heard::of(envelope, at));
        if !peer.has_stopped.swap(true, Ordering::AcqRel) {
            link.statistics.add(UdpCount::GoodbyesReceived, 1);
            self.sink.stopped(peer.node);
        }
        Ok(())
    }
}
