//! A link with injected faults, around any other link: it loses datagrams at random, from a seed, and cuts neighbours off.
//!
//! Faults act on the sending side, so each end of a link has faults of its own. Packets that the faults drop are
//! counted apart from real losses. A lost send loses its whole datagram, as on a network.

use super::{Leading, Link, LinkBusy, PollEnd, Sink};
use crate::lock::lock;
use imrs_protocol::{NodeId, Packet};
use imrs_wire::envelope::MAX_PACKETS;
use imrs_wire::obs::LinkReport;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard};
use std::time::Instant;

/// A link that drops some of the packets that it should send.
#[derive(Debug)]
pub struct FaultyLink<L> {
    inner: L,
    faults: Mutex<Faults>,
    lost_packets: AtomicU64,
    cut_packets: AtomicU64,
}

#[derive(Debug)]
struct Faults {
    random: fastrand::Rng,
    loss: f64,
    cut: Vec<NodeId>,
    cuts_to_come: Vec<(NodeId, Range<Instant>)>,
}

/// How many packets the faults have dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Injected {
    /// Packets lost by chance.
    pub lost_packets: u64,
    /// Packets to neighbours that were cut off.
    pub cut_packets: u64,
}

impl<L> FaultyLink<L> {
    /// Wraps the link `inner`; there are no faults yet. Two links with the same seed lose the same sends.
    #[must_use]
    pub fn new(inner: L, seed: u64) -> Self {
        let random = fastrand::Rng::with_seed(seed);
        let faults = Faults { random, loss: 0.0, cut: Vec::new(), cuts_to_come: Vec::new() };
        Self {
            inner,
            faults: Mutex::new(faults),
            lost_packets: AtomicU64::new(0),
            cut_packets: AtomicU64::new(0),
        }
    }

    /// The wrapped link, which has no injected faults.
    pub const fn inner(&self) -> &L {
        &self.inner
    }

    /// Sets the probability (0 to 1) with which the link loses each datagram from now on.
    pub fn set_loss(&self, probability: f64) {
        self.faults().loss = probability;
    }

    /// Cuts a neighbour off, so that the link sends nothing to it; with `cut` false, ends the cut.
    pub fn set_cut(&self, neighbour: NodeId, cut: bool) {
        let mut faults = self.faults();
        faults.cut.retain(|&node| node != neighbour);
        if cut {
            faults.cut.push(neighbour);
        }
    }

    /// Sends nothing to `neighbour` during `span`, whatever [`set_cut`](Self::set_cut) says.
    pub fn cut_during(&self, neighbour: NodeId, span: Range<Instant>) {
        self.faults().cuts_to_come.push((neighbour, span));
    }

    /// How many packets the faults have dropped so far.
    #[must_use]
    pub fn injected(&self) -> Injected {
        Injected {
            lost_packets: self.lost_packets.load(Ordering::Relaxed),
            cut_packets: self.cut_packets.load(Ordering::Relaxed),
        }
    }

    fn faults(&self) -> MutexGuard<'_, Faults> {
        lock(&self.faults)
    }
}

impl<L: Link> FaultyLink<L> {
    fn send_or_lose(&self, next: NodeId, packets: &[Packet], at: Instant) -> Result<usize, LinkBusy> {
        let (cut, lost) = {
            let mut faults = self.faults();
            let cut = faults.cuts(next);
            (cut, !cut && faults.loses())
        };
        if !cut && !lost {
            return self.inner.send_at(next, packets, at);
        }
        // If the inner link would not take the packets, no loss is drawn for them, because the node keeps
        // them.
        if !self.inner.ready(next) {
            return Err(LinkBusy);
        }
        let taken = packets.len().min(self.at_once());
        let counter = if cut { &self.cut_packets } else { &self.lost_packets };
        counter.fetch_add(taken as u64, Ordering::Relaxed);
        Ok(taken)
    }
}

impl Faults {
    fn cuts(&mut self, next: NodeId) -> bool {
        if !self.cuts_to_come.is_empty() {
            let now = Instant::now();
            self.cuts_to_come.retain(|(_, span)| now < span.end);
            if self.cuts_to_come.iter().any(|(node, span)| *node == next && span.contains(&now)) {
                return true;
            }
        }
        self.cut.contains(&next)
    }

    fn loses(&mut self) -> bool {
        self.loss > 0.0 && self.random.f64() < self.loss
    }
}

impl<L: Link> Link for FaultyLink<L> {
    fn ready(&self, next: NodeId) -> bool {
        self.inner.ready(next)
    }

    fn at_once(&self) -> usize {
        self.inner.at_once()
    }

    fn send_at(&self, next: NodeId, packets: &[Packet], at: Instant) -> Result<usize, LinkBusy> {
        if self.faults().loss <= 0.0 {
            return self.send_or_lose(next, packets, at);
        }
        // The loss is drawn for each datagram, so that the datagrams of one call are not all lost together.
        let mut taken = 0;
        for datagram in packets[..packets.len().min(self.at_once())].chunks(MAX_PACKETS) {
            match self.send_or_lose(next, datagram, at) {
                Ok(all) if all == datagram.len() => taken += all,
                Ok(some) => return Ok(taken + some),
                Err(LinkBusy) if taken > 0 => break,
                Err(LinkBusy) => return Err(LinkBusy),
            }
        }
        Ok(taken)
    }

    fn poll(&self, sink: &dyn Sink, until: Option<Instant>) -> PollEnd {
        self.inner.poll(sink, until)
    }

    fn wake(&self) {
        self.inner.wake();
    }

    fn failures(&self) -> Vec<(&'static str, u64)> {
        self.inner.failures()
    }

    fn evidence(&self) -> Vec<(&'static str, u64)> {
        self.inner.evidence()
    }

    /// Says goodbye through the inner link, but not while any neighbour is cut off, because that neighbour must not
    /// hear it.
    fn goodbye(&self) {
        let now = Instant::now();
        let is_cut = {
            let faults = self.faults();
            !faults.cut.is_empty() || faults.cuts_to_come.iter().any(|(_, span)| span.contains(&now))
        };
        if !is_cut {
            self.inner.goodbye();
        }
    }

    fn health(&self) -> Vec<LinkReport> {
        self.inner.health()
    }

    fn leading(&self) -> Option<&dyn Leading> {
        self.inner.leading()
    }
}
