//! The recently arrived frames, kept in memory. While the screen is paused, the user can move back in the present run
//! as in a recording.
//!
//! Arrivals are kept in segments (reels) of half a minute. Each segment begins with the state of all nodes, so the
//! oldest segment can be dropped at any time. So the memory is bounded, however much arrives.

use crate::clock::Moment;
use crate::replay::{Film, Reel, Trouble, Troubles};
use crate::source::{Arrival, Feed, SourceId};
use crate::store::{NodeIncarnation, Store};
pub use crate::verdicts::LENGTH;
use crate::verdicts::Verdicts;
use imrs_wire::obs::{Delta, Hello, NodeIdentity, Role, SCHEMA, ServerFrame, VERSION};
use imrs_wire::recording::Shown;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

/// The greatest memory of the history, in bytes. If a cell sends much, the history covers less time.
pub const BUDGET: usize = 46 << 20;
/// How much time a segment of the history covers.
const REEL: Duration = Duration::from_secs(30);
/// The greatest number of incarnations of nodes that the history keeps, ended ones included.
const INCARNATIONS: usize = 256;

/// The recently arrived frames, in segments.
#[derive(Clone, Debug, Default)]
pub struct History {
    closed: VecDeque<Piece>,
    open: Piece,
    /// All incarnations that were attached so far, in the order of attachment: a replay attaches them in this order.
    known: Vec<Known>,
    /// The memory of the closed segments, in bytes.
    weight: usize,
    /// How many bytes of the budget [`Self::reserve`] left to the stores that are shown while the screen is paused.
    reserved: usize,
    verdicts: Verdicts,
    troubles: Troubles,
}

#[derive(Clone, Debug, Default)]
struct Piece {
    /// The state of all nodes at the start of the segment.
    opening: Arc<Reel>,
    /// The arrivals of the segment, after that state.
    reel: Arc<Reel>,
    last: Moment,
}

impl Piece {
    fn weight(&self) -> usize {
        self.opening.weight() + self.reel.weight()
    }
}

/// An incarnation of a node.
#[derive(Clone, Debug)]
struct Known {
    source: SourceId,
    identity: NodeIdentity,
    pid: u32,
    attached: Arc<[u8]>,
    table: Option<Arc<[u8]>>,
    lost: Option<Arc<[u8]>>,
}

impl History {
    /// Adds an arrival from a source. `before` is the store before that arrival.
    pub fn take(&mut self, arrival: &Arrival, before: &Store) {
        self.verdicts.take(arrival);
        let Arrival { at, source, feed } = arrival;
        let Ok(number) = u16::try_from(source.0) else { return };
        if self.open.reel.began().is_none_or(|began| at.saturating_sub(began) >= REEL) {
            self.turn(*at, before);
        }
        let (bytes, trouble) = match feed {
            Feed::Attached { identity, pid, build } => {
                (self.attached(*source, identity, *pid, build), Trouble::None)
            }
            Feed::Frame(frame) => {
                let shown = Shown::Said((**frame).clone());
                let bytes: Arc<[u8]> = shown.encode().into();
                if matches!(**frame, ServerFrame::Table(_))
                    && let Some(known) = self.present(*source)
                {
                    known.table = Some(Arc::clone(&bytes));
                }
                (bytes, self.troubles.of(&shown, *source, *at, before))
            }
            Feed::Lost { why } => {
                let shown = Shown::Lost { why: why.clone() };
                let bytes: Arc<[u8]> = shown.encode().into();
                if let Some(known) = self.present(*source) {
                    known.lost = Some(Arc::clone(&bytes));
                }
                (bytes, self.troubles.of(&shown, *source, *at, before))
            }
            Feed::Judged { .. } | Feed::Failed { .. } | Feed::Left | Feed::Stale { .. } => return,
        };
        self.open.last = *at;
        Arc::make_mut(&mut self.open.reel).put(*at, number, trouble, &bytes);
        // A large segment is closed early, so that dropping a segment loses only a small part of the history.
        if self.open.reel.weight() >= BUDGET / 16 {
            self.close();
        }
        self.forget(*at);
    }

    /// The history as a recording that can be shown; `None` if nothing has arrived.
    #[must_use]
    pub fn film(&self) -> Option<Film> {
        let open = Some(&self.open).filter(|open| open.reel.began().is_some());
        let mut pieces = self.closed.iter().chain(open);
        let first = pieces.next()?;
        let reels = std::iter::once(first).chain(pieces).map(|piece| Arc::clone(&piece.reel)).collect();
        let cell = self.known.last().map_or_else(String::new, |known| known.identity.cell.clone());
        Some(Film::of(cell, Arc::clone(&first.opening), reels))
    }

    /// For each incarnation, the latest verdict of the validator before a moment.
    pub fn verdicts(&self, moment: Moment) -> impl Iterator<Item = Arrival> {
        self.verdicts.at(moment)
    }

    /// The memory that the history takes, in bytes.
    #[must_use]
    pub fn weight(&self) -> usize {
        self.weight + self.open.weight()
    }

    fn attached(&mut self, source: SourceId, identity: &NodeIdentity, pid: u32, build: &str) -> Arc<[u8]> {
        let role = Role::Node(identity.clone());
        let hello = Hello { schema: SCHEMA, pid, build: build.to_owned(), mono_us: 0, role };
        let bytes: Arc<[u8]> = Shown::Attached { version: VERSION, hello }.encode().into();
        let same = |known: &&mut Known| (&known.identity, known.pid) == (identity, pid);
        match self.known.iter_mut().find(same) {
            Some(known) => (known.source, known.lost) = (source, None),
            None => self.known.push(Known {
                source,
                identity: identity.clone(),
                pid,
                attached: Arc::clone(&bytes),
                table: None,
                lost: None,
            }),
        }
        if self.known.len() > INCARNATIONS
            && let Some(gone) = self.known.iter().position(|known| known.lost.is_some())
        {
            self.known.remove(gone);
        }
        bytes
    }

    /// The incarnation to which a source is attached at present.
    fn present(&mut self, source: SourceId) -> Option<&mut Known> {
        self.known.iter_mut().rfind(|known| known.source == source)
    }

    /// Ends the present segment of the history, and starts the next one.
    fn turn(&mut self, at: Moment, before: &Store) {
        self.close();
        let mut opening = Reel::default();
        for known in &self.known {
            let Ok(number) = u16::try_from(known.source.0) else { continue };
            opening.put(at, number, Trouble::None, &known.attached);
            if let Some(table) = &known.table {
                opening.put(at, number, Trouble::None, table);
            }
            if let Some(state) = state_of(known, before) {
                opening.put(at, number, Trouble::None, &Shown::Said(ServerFrame::Delta(state)).encode());
            }
            if let Some(lost) = &known.lost {
                opening.put(at, number, Trouble::None, lost);
            }
        }
        opening.close();
        self.open = Piece { opening: Arc::new(opening), reel: Arc::default(), last: at };
    }

    fn close(&mut self) {
        let mut piece = std::mem::take(&mut self.open);
        if piece.reel.began().is_none() {
            return;
        }
        Arc::make_mut(&mut piece.reel).close();
        self.weight += piece.weight();
        self.closed.push_back(piece);
    }

    /// Leaves `bytes` of the budget to the store of a past moment that is shown beside the present. In a very large cell this
    /// drops the oldest segments.
    pub fn reserve(&mut self, bytes: usize) {
        self.reserved = bytes;
        while self.closed.len() > 1 && self.weight() > self.budget() {
            self.drop_oldest();
        }
    }

    const fn budget(&self) -> usize {
        BUDGET.saturating_sub(self.reserved)
    }

    fn drop_oldest(&mut self) {
        if let Some(first) = self.closed.pop_front() {
            self.weight -= first.weight();
        }
    }

    fn forget(&mut self, now: Moment) {
        let too_old = |piece: &Piece| now.saturating_sub(piece.last) > LENGTH;
        while let Some(first) = self.closed.front() {
            if !too_old(first) && self.weight() <= self.budget() {
                return;
            }
            self.drop_oldest();
        }
    }
}

/// The last state of a node, as a whole delta.
fn state_of(known: &Known, store: &Store) -> Option<Delta> {
    let id = &known.identity;
    let same = |incarnation: &&NodeIncarnation| {
        incarnation.names.cell.raw() == id.cell
            && incarnation.node.raw() == id.node
            && (incarnation.number, incarnation.pid) == (id.incarnation.0, known.pid)
    };
    let incarnation = store.incarnations().iter().find(same)?;
    Some(Delta::whole(&incarnation.last.as_ref()?.snapshot))
}
