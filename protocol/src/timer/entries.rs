//! The entries of a Timer, and the small unsorted set of the entries that were armed last.

use crate::ids::TaskId;
use crate::queue;
use crate::request::TimeId;
use crate::ticks::Instant;

#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    pub owner: TaskId,
    pub id: TimeId,
    pub turn: u8,
    pub expires: Instant,
    /// Counts the arming calls. The count breaks ties: of entries that end together, the entry that was armed first goes
    /// first.
    pub armed: u64,
}

impl queue::Entry for Entry {
    type Side = ();

    fn key(&self) -> queue::Key {
        (self.expires, self.armed)
    }

    fn due(&self, (): &()) -> Instant {
        self.expires
    }

    fn yields(&self) -> bool {
        false
    }
}

pub(super) fn name(owner: TaskId, id: TimeId) -> u32 {
    (u32::from(owner.0) << 8) | u32::from(id.0)
}

/// The capacity of the unsorted set.
pub(super) const FRESH: usize = 4;
/// The name of the entry in an empty place.
pub(super) const NOBODY: u32 = u32::MAX;

/// The entries that were armed last, unsorted. Most of them are disarmed soon, and so never need a place in the queue
/// (D123).
#[derive(Clone, Debug)]
pub(super) struct Fresh {
    pub names: [u32; FRESH],
    /// The entries by place. An empty place has an entry that never ends.
    pub entries: [Entry; FRESH],
    /// The place whose entry moves to the queue next, modulo the number of places.
    pub next: u8,
}

impl Fresh {
    pub const HOLE: Entry =
        Entry { owner: TaskId(0), id: TimeId(0), turn: 0, expires: Instant::NEVER, armed: u64::MAX };
    pub const NONE: Self = Self { names: [NOBODY; FRESH], entries: [Self::HOLE; FRESH], next: 0 };

    pub fn find(&self, name: u32) -> Option<usize> {
        self.names.iter().position(|&known| known == name)
    }

    pub fn put(&mut self, at: usize, entry: Entry) {
        (self.names[at], self.entries[at]) = (name(entry.owner, entry.id), entry);
    }

    pub fn remove(&mut self, at: usize) -> Entry {
        self.names[at] = NOBODY;
        core::mem::replace(&mut self.entries[at], Self::HOLE)
    }

    /// The instant at which the first of these entries ends.
    pub fn end(&self) -> Instant {
        self.entries.iter().map(|entry| entry.expires).fold(Instant::NEVER, Instant::min)
    }

    pub fn first(&self) -> Option<(usize, &Entry)> {
        self.iter().min_by_key(|(_, entry)| queue::Entry::key(*entry))
    }

    pub fn iter(&self) -> impl Iterator<Item = (usize, &Entry)> {
        self.entries.iter().enumerate().filter(|&(at, _)| self.names[at] != NOBODY)
    }
}
