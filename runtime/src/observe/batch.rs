//! Observations that were read from the rings once, for all readers that follow the same state machines.

use imrs_wire::obs::TimedEvent;

/// What one reader read from the rings of all state machines at one time.
#[derive(Default)]
pub(crate) struct Batch {
    /// What was read of each ring. The rings are in the order of the tasks; that of the transit buffer is last.
    pub runs: Vec<Run>,
    /// The observations of the wanted rings, one ring after the other.
    pub events: Vec<TimedEvent>,
}

/// What was read of one ring. Positions count the observations that were ever written to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Run {
    /// The position from which the reader wanted to read.
    pub from: u64,
    /// The position of the first observation that was still there.
    pub begin: u64,
    /// The position after the last observation that was read.
    pub end: u64,
    /// Whether the reader wanted this ring. If not, it went past these observations without reading them.
    pub wanted: bool,
}

/// What one reader takes of a batch.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Share {
    /// The whole batch: this reader's positions are those from which the batch was read.
    All,
    /// These observations, and how many more were overwritten before this reader got them.
    Part(Vec<TimedEvent>, u64),
}

impl Run {
    /// How many observations were overwritten before they were read.
    pub const fn lost(&self) -> u64 {
        if self.wanted { self.begin - self.from } else { 0 }
    }

    /// How many observations were read.
    fn length(&self) -> usize {
        usize::try_from(self.end - self.begin).unwrap_or(usize::MAX)
    }

    /// Whether a reader at `position` would have read the same observations, or the last of them. A reader further
    /// back would have got the same, too, if the run begins with the oldest observation that the ring still had.
    const fn has_all_since(&self, position: u64) -> bool {
        let was_oldest = self.begin > self.from;
        !self.wanted || (position <= self.end && (position >= self.begin || was_oldest))
    }
}

impl Batch {
    /// How many observations were lost to the reader that read the batch.
    pub fn lost(&self) -> u64 {
        self.runs.iter().map(Run::lost).sum()
    }

    /// The share of a reader whose next observations have these positions; `None` if the reader must read the rings
    /// itself.
    pub fn share(&self, positions: &[u64]) -> Option<Share> {
        let mut pairs = self.runs.iter().zip(positions);
        if !pairs.clone().all(|(run, &position)| run.has_all_since(position)) {
            return None;
        }
        if pairs.clone().all(|(run, &position)| run.from == position || !run.wanted) {
            return Some(Share::All);
        }
        let (mut events, mut lost, mut rest) = (Vec::new(), 0, self.events.as_slice());
        for (run, &position) in pairs.by_ref().filter(|(run, _)| run.wanted) {
            let (of_run, others) = rest.split_at_checked(run.length())?;
            let seen = usize::try_from(position.saturating_sub(run.begin)).ok()?;
            events.extend_from_slice(of_run.get(seen..)?);
            lost += run.begin.saturating_sub(position);
            rest = others;
        }
        Some(Share::Part(events, lost))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observe::ring::Ring;
    use imrs_protocol::{Event, Observation, PortId, TaskId, Ticks};
    use proptest::prelude::*;

    fn event(number: u64) -> TimedEvent {
        let what = Observation {
            event: Event::Sent,
            port: PortId(0),
            peer: TaskId(0),
            number: u32::try_from(number).unwrap(),
            remaining: Ticks(1),
        };
        TimedEvent { mono_us: number, task: None, what }
    }

    /// Reads a ring as a reader does.
    fn read(ring: &Ring, from: u64, room: usize) -> (Run, Vec<TimedEvent>) {
        let mut events = Vec::new();
        let (end, gone) =
            ring.read(from, room, |mono_us, what| events.push(TimedEvent { mono_us, task: None, what }));
        (Run { from, begin: from + gone, end, wanted: true }, events)
    }

    proptest! {
        /// A reader that takes a share gets what it would have read itself, up to the end of the batch. No
        /// observation is neither shown nor counted as lost.
        #[test]
        fn what_is_shared_is_what_each_reader_would_have_read(
            written in 0_u64..40,
            from in prop::array::uniform2(0_u64..40),
            others in prop::array::uniform2(0_u64..40),
            room in 1_usize..12,
        ) {
            let mut rings = [Ring::of(8), Ring::of(8)];
            for ring in &mut rings {
                ring.subscribe();
                (0..written).for_each(|number| ring.push(number, event(number).what));
            }
            let from = from.map(|from| from.min(written));
            let others = others.map(|other| other.min(written));
            let mut batch = Batch::default();
            for (ring, from) in rings.iter().zip(from) {
                let (run, events) = read(ring, from, room);
                batch.runs.push(run);
                batch.events.extend(events);
            }
            let all = batch.events.clone();
            let (events, lost) = match batch.share(&others) {
                None => {
                    // The reader's position is before the part of a ring that was read, or after it.
                    let lacks = |(run, other): (&Run, u64)| other < run.begin || other > run.end;
                    prop_assert!(batch.runs.iter().zip(others).any(lacks));
                    return Ok(());
                }
                Some(Share::All) => {
                    prop_assert_eq!(from, others);
                    (all, batch.lost())
                }
                Some(Share::Part(events, lost)) => (events, lost),
            };
            let (mut expected, mut gone) = (Vec::new(), 0);
            for ((ring, run), other) in rings.iter().zip(&batch.runs).zip(others) {
                let (own, of_ring) = read(ring, other, usize::MAX);
                expected.extend(of_ring.into_iter().filter(|event| event.mono_us < run.end));
                gone += own.lost();
            }
            prop_assert_eq!((events, lost), (expected, gone));
        }
    }

    #[test]
    fn a_ring_that_is_not_wanted_loses_nothing() {
        let run = Run { from: 3, begin: 3, end: 9, wanted: false };
        let batch = Batch { runs: vec![run], events: Vec::new() };
        assert_eq!(batch.share(&[5]), Some(Share::All));
        assert_eq!(batch.lost(), 0);
    }
}
