//! Messages and answers longer than one packet: the fragments share one id and one deadline. If a fragment is missing at the
//! deadline, all are dropped (D28).

#[cfg(feature = "checker")]
mod walk;

use crate::ids::MessageId;
use crate::packet::{Contents, Packet};
use crate::ticks::Instant;
use alloc::boxed::Box;
use alloc::vec;
use serde::{Deserialize, Serialize};

/// The fragments of a message after the first. Allocates nothing if the format takes one packet.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Parts(Option<Box<Room>>);

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Room {
    /// A bit mask of the fragments that have come: bit `i` is fragment `i + 1`.
    have: u16,
    parts: Box<[Contents]>,
}

impl Parts {
    /// Room for a message of up to `fragments` packets.
    pub fn new(fragments: u8) -> Self {
        let room = usize::from(fragments.saturating_sub(1));
        let parts = || vec![Contents::EMPTY; room].into_boxed_slice();
        Self((room > 0).then(|| Box::new(Room { have: 0, parts: parts() })))
    }

    /// The capacity in fragments.
    pub fn room(&self) -> usize {
        self.0.as_ref().map_or(0, |room| room.parts.len())
    }

    #[cfg(feature = "checker")]
    pub fn has_room(&self) -> bool {
        self.0.is_some()
    }

    /// A bit mask of the fragments that have come: bit `i` is fragment `i + 1`.
    pub fn have(&self) -> u16 {
        self.0.as_ref().map_or(0, |room| room.have)
    }

    /// Stores fragment `index`, counted from 1; false if there is no room for it.
    pub fn put(&mut self, index: u8, contents: Contents) -> bool {
        let Some(room) = &mut self.0 else { return false };
        let at = usize::from(index).checked_sub(1);
        let Some(slot) = at.and_then(|at| room.parts.get_mut(at)) else { return false };
        *slot = contents;
        room.have |= 1 << (index - 1);
        true
    }

    /// The number of packets of the message; `None` if a fragment before a later one is missing.
    pub fn fragments(&self) -> Option<u8> {
        let have = self.have();
        let whole = have & have.wrapping_add(1) == 0;
        whole.then(|| 1 + u8::try_from(have.trailing_ones()).unwrap_or(0))
    }

    /// Fragment `index`, counted from 1.
    pub fn get(&self, index: u8) -> Option<&Contents> {
        let room = self.0.as_ref()?;
        let at = index.checked_sub(1).filter(|&at| at < 16 && room.have & (1 << at) != 0)?;
        room.parts.get(usize::from(at))
    }

    /// Copies the fragments of `from`, as far as there is room.
    pub fn copy(&mut self, from: &Self) {
        match &from.0 {
            Some(room) => self.fill(room.have, room.parts.iter()),
            None => self.clear(),
        }
    }

    /// Copies fragments from 1 on; `have` says which of them are valid.
    pub fn fill<'a>(&mut self, have: u16, from: impl Iterator<Item = &'a Contents>) {
        let Some(room) = &mut self.0 else { return };
        let all = 1_u32.checked_shl(u32::try_from(room.parts.len()).unwrap_or(16)).unwrap_or(0);
        room.have = have & u16::try_from(all.wrapping_sub(1) & 0xffff).unwrap_or(u16::MAX);
        for (slot, contents) in room.parts.iter_mut().zip(from) {
            *slot = *contents;
        }
    }

    pub fn clear(&mut self) {
        if let Some(room) = &mut self.0 {
            room.have = 0;
        }
    }

    /// Validates deserialised fragments: their capacity is that of `new`, and every fragment is within that capacity.
    pub fn has_room_of(&self, new: &Self) -> bool {
        self.room() == new.room() && is_within(self.have(), self.room())
    }
}

/// An incomplete message or answer, whose fragments are being received.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Assembly {
    pub id: MessageId,
    /// A bit mask of the fragments that have come: bit `i` is fragment `i`. Zero means that no message is being received.
    pub have: u16,
    /// The number of fragments of the message, which is known once the last fragment is here.
    pub fragments: Option<u8>,
    /// The earliest deadline of the fragments that have come. For a command, the link delay of the reply is subtracted.
    pub expires: Instant,
    pub contents: Box<[Contents]>,
}

/// What a fragment changes in an assembly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Progress {
    /// Other fragments are missing.
    Waits,
    /// A copy: the fragment was here already.
    Again,
    /// The fragment contradicts the others, and all are dropped.
    Broken,
    /// The message is complete, with this many fragments.
    Whole(u8),
}

impl Assembly {
    /// Room for a message of up to `fragments` packets.
    pub fn new(fragments: u8) -> Self {
        Self { contents: vec![Contents::EMPTY; usize::from(fragments)].into_boxed_slice(), ..Self::default() }
    }

    /// Whether any fragments have come.
    pub const fn is_open(&self) -> bool {
        self.have != 0
    }

    /// Drops all fragments, and from now on expects those of the message `id`.
    #[inline]
    pub fn begin(&mut self, id: MessageId) {
        (self.id, self.have, self.fragments, self.expires) = (id, 0, None, Instant::NEVER);
    }

    /// Drops the fragments of the message `id`. Returns whether there were any.
    pub fn close(&mut self, id: MessageId) -> bool {
        let closes = self.have != 0 && self.id == id;
        if closes {
            self.have = 0;
        }
        closes
    }

    /// Stores a fragment that fits the room.
    pub fn put(&mut self, packet: &Packet, expires: Instant) -> Progress {
        if self.have == 0 && self.fragments.is_none() && packet.fragment == 0 && !packet.more {
            let Some(slot) = self.contents.first_mut() else { return Progress::Broken };
            *slot = packet.contents;
            (self.have, self.fragments, self.expires) = (1, Some(1), self.expires.min(expires));
            return Progress::Whole(1);
        }
        let Some(slot) = self.contents.get_mut(usize::from(packet.fragment)) else { return Progress::Broken };
        let bit = 1_u16.checked_shl(u32::from(packet.fragment)).unwrap_or(0);
        let ends = (!packet.more).then_some(packet.fragment + 1);
        let highest = 16 - self.have.leading_zeros();
        let broken = match (ends, self.fragments) {
            (Some(end), Some(known)) => end != known,
            (Some(end), None) => highest >= u32::from(end),
            (None, Some(known)) => packet.fragment + 1 >= known,
            (None, None) => false,
        };
        if broken {
            self.have = 0;
            return Progress::Broken;
        }
        self.expires = self.expires.min(expires);
        self.fragments = self.fragments.or(ends);
        if self.have & bit != 0 {
            return Progress::Again;
        }
        *slot = packet.contents;
        self.have |= bit;
        match self.fragments {
            Some(fragments) if self.have.trailing_ones() == u32::from(fragments) => {
                Progress::Whole(fragments)
            }
            Some(_) | None => Progress::Waits,
        }
    }

    /// Fragment `index`, if it has come.
    pub fn get(&self, index: u8) -> Option<&Contents> {
        let here = index < 16 && self.have & (1 << index) != 0;
        self.contents.get(usize::from(index)).filter(|_| here)
    }

    /// Validates a deserialised assembly: its capacity is that of `new`, and every fragment is within that capacity.
    pub fn has_room_of(&self, new: &Self) -> bool {
        let most = self.contents.len();
        let known = self.fragments.is_none_or(|fragments| usize::from(fragments) <= most.max(1));
        most == new.contents.len() && is_within(self.have, most) && known
    }
}

/// Whether only bits below `most` are set in `have`.
fn is_within(have: u16, most: usize) -> bool {
    u32::from(have).checked_shr(u32::try_from(most).unwrap_or(u32::MAX)).unwrap_or(0) == 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::TaskId;
    use crate::ticks::Ticks;
    use proptest::prelude::*;

    proptest! {
        /// Fragments may come in any order and as copies. The message becomes complete exactly when the last missing
        /// fragment comes.
        #[test]
        fn a_message_is_whole_when_every_fragment_came(fragments in 1..=16_u8, order in proptest::collection::vec(0..16_u8, 0..60)) {
            let mut assembly = Assembly::new(16);
            assembly.begin(MessageId::default());
            let mut here = 0_u16;
            for index in order.into_iter().map(|i| i % fragments) {
                let packet = fragment(index, index + 1 < fragments);
                let again = here & (1 << index) != 0;
                here |= 1 << index;
                let whole = here.trailing_ones() == u32::from(fragments);
                let expected = if again { Progress::Again } else if whole { Progress::Whole(fragments) } else { Progress::Waits };
                prop_assert_eq!(assembly.put(&packet, Instant(50 + u64::from(index))), expected);
                prop_assert_eq!(assembly.get(index).map(|c| c.as_bytes()[0]), Some(index));
            }
        }
    }

    fn fragment(index: u8, more: bool) -> Packet {
        let contents = Contents::new(&[index]).unwrap();
        Packet { more, fragment: index, source: TaskId(1), remaining: Ticks(9), contents, ..Packet::BLANK }
    }

    #[test]
    fn fragments_that_contradict_each_other_are_dropped_together() {
        for (first, second) in [
            ((1, false), (2, false)),
            ((2, true), (1, false)),
            ((1, false), (1, true)),
            ((1, false), (3, true)),
        ] {
            let mut assembly = Assembly::new(4);
            assembly.begin(MessageId::default());
            assert_eq!(assembly.put(&fragment(first.0, first.1), Instant(9)), Progress::Waits);
            assert_eq!(
                assembly.put(&fragment(second.0, second.1), Instant(9)),
                Progress::Broken,
                "{first:?} {second:?}"
            );
            assert!(!assembly.is_open());
        }
        assert_eq!(Assembly::new(2).put(&fragment(2, false), Instant(9)), Progress::Broken, "no room");
    }

    #[test]
    fn parts_are_whole_without_gaps() {
        let mut parts = Parts::new(4);
        assert_eq!((parts.fragments(), parts.get(1)), (Some(1), None));
        assert!(
            parts.put(2, Contents::EMPTY) && !parts.put(4, Contents::EMPTY) && !parts.put(0, Contents::EMPTY)
        );
        assert_eq!(parts.fragments(), None);
        assert!(parts.put(1, Contents::EMPTY));
        assert_eq!(parts.fragments(), Some(3));
        let mut small = Parts::new(2);
        small.copy(&parts);
        assert_eq!((small.fragments(), small.have()), (Some(2), 1));
        let mut long = Parts::new(16);
        assert!(long.put(15, Contents::EMPTY) && !long.put(16, Contents::EMPTY));
        assert_eq!((long.fragments(), long.have()), (None, 1 << 14));
        let mut none = Parts::new(1);
        none.copy(&parts);
        assert_eq!((none.have(), none.has_room()), (0, false));
    }
}
