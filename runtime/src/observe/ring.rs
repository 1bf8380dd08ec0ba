//! The observations of one state machine, for its subscribers: a bounded ring that many readers follow, each with its
//! own position. A slow reader loses the oldest observations, and learns how many.

use crate::clock::Micros;
use imrs_protocol::Observation;

/// How many observations the ring of one state machine keeps.
const KEPT: usize = 1024;

pub(crate) struct Ring {
    /// The latest observations. They are kept only after the first subscription.
    kept: Vec<(Micros, Observation)>,
    /// How many observations were ever written.
    written: u64,
    readers: usize,
    /// How many observations are kept at most.
    room: usize,
    /// Whether overwritten observations are read as if they were still there: a planted bug that a test must find.
    #[cfg(test)]
    pub forgets_the_loss: bool,
}

impl Ring {
    pub fn new() -> Self {
        Self::of(KEPT)
    }

    /// A ring that keeps `room` observations.
    pub fn of(room: usize) -> Self {
        Self {
            kept: Vec::new(),
            written: 0,
            readers: 0,
            room,
            #[cfg(test)]
            forgets_the_loss: false,
        }
    }

    /// Records an observation, if there is a subscriber.
    #[inline]
    pub fn push(&mut self, at: Micros, observation: Observation) {
        if self.readers > 0 {
            self.keep(at, observation);
        }
    }

    #[cold]
    fn keep(&mut self, at: Micros, observation: Observation) {
        let entry = (at, observation);
        if self.kept.len() < self.room {
            self.kept.push(entry);
        } else {
            let at = self.position(self.written);
            self.kept[at] = entry;
        }
        self.written += 1;
    }

    /// Begins to follow the ring. Returns the position from which the reader reads.
    pub fn subscribe(&mut self) -> u64 {
        self.kept.reserve_exact(self.room.saturating_sub(self.kept.len()));
        self.readers += 1;
        self.written
    }

    /// Ends following the ring.
    pub fn unsubscribe(&mut self) {
        self.readers = self.readers.saturating_sub(1);
    }

    /// Passes the observations since the position `from` to `each`, oldest first, at most `room` of them. Returns the
    /// position from which to read on, and how many observations were overwritten before they were read.
    pub fn read(&self, from: u64, room: usize, mut each: impl FnMut(Micros, Observation)) -> (u64, u64) {
        let oldest = self.written - self.kept.len() as u64;
        let begin = from.max(oldest);
        #[cfg(test)]
        let begin = if self.forgets_the_loss { from } else { begin };
        let end = self.written.min(begin.saturating_add(room as u64));
        for number in begin..end {
            let (at, observation) = self.kept[self.position(number)];
            each(at, observation);
        }
        (end, begin - from)
    }

    #[expect(clippy::cast_possible_truncation, reason = "the remainder is below `room`")]
    fn position(&self, number: u64) -> usize {
        (number % self.room as u64) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use imrs_protocol::{Event, PortId, TaskId, Ticks};

    fn numbered(number: u32) -> Observation {
        Observation { event: Event::Sent, port: PortId(0), peer: TaskId(0), number, remaining: Ticks(1) }
    }

    fn read(ring: &Ring, from: u64, room: usize) -> (Vec<u32>, (u64, u64)) {
        let mut seen = Vec::new();
        let end = ring.read(from, room, |_, o| seen.push(o.number));
        (seen, end)
    }

    #[test]
    fn nothing_is_kept_while_nobody_reads() {
        let mut ring = Ring::new();
        ring.push(0, numbered(1));
        let from = ring.subscribe();
        ring.push(1, numbered(2));
        assert_eq!(read(&ring, from, 9), (vec![2], (1, 0)));
        ring.unsubscribe();
        ring.push(2, numbered(3));
        assert_eq!(read(&ring, 1, 9), (vec![], (1, 0)));
    }

    #[test]
    fn a_slow_reader_loses_the_oldest_and_knows_how_many() {
        let mut ring = Ring::new();
        let from = ring.subscribe();
        let many = u32::try_from(KEPT).unwrap() + 10;
        (0..many).for_each(|n| ring.push(0, numbered(n)));
        let (first, (next, lost)) = read(&ring, from, 3);
        assert_eq!((first, next, lost), (vec![10, 11, 12], 13, 10));
        let (rest, (end, lost)) = read(&ring, next, usize::MAX);
        assert_eq!(
            (rest.first(), rest.last(), end, lost),
            (Some(&13), Some(&(many - 1)), u64::from(many), 0)
        );
    }
}
