//! Duplicate detection: what a receiver remembers of messages, so that the task executes none of them twice (D6, D52).

use crate::cell::PortDecl;
use crate::ids::{MessageId, Seq24, TaskId};
use crate::packet::{Class, Contents};
use crate::ticks::Instant;
use serde::{Deserialize, Serialize};

/// The status of a received command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) enum CommandStatus {
    /// The command waits in the port's buffer.
    Held,
    /// The command expired in the buffer, before the task took it. The command did not run, so a later copy with time left
    /// is taken in as a new command. A copy may have more time left, because a link charges only an upper bound (D20).
    Lapsed,
    /// The task has taken the command and has not answered it yet. The execution budget ends at this instant.
    Delivered(Instant),
    /// The command was refused; a copy is refused again.
    Refused,
    /// The command was answered; a copy gets the same answer.
    Answered(Contents),
}

/// The dedup entry of the last command of one source on one port. One entry is enough, because a task has at most one
/// outstanding request per port (D75).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) struct DedupEntry {
    pub id: MessageId,
    pub status: CommandStatus,
    /// The latest instant at which the sender's wait may end, on this task's clock.
    pub sender_until: Instant,
    /// When the entry ends: TTL and link delay have passed by then, so that no copy can arrive any more.
    pub until: Instant,
}

impl DedupEntry {
    /// Whether the command of the entry waits in the port's buffer.
    pub fn waits(&self, now: Instant) -> bool {
        self.status == CommandStatus::Held && self.until > now
    }
}

/// A sliding window over the received class-1 messages of one source: the newest number and the 64 numbers before it.
///
/// A source numbers all its messages in one sequence, on all ports and to all receivers; a send to `n` tasks takes `n`
/// numbers (D6). So a message that later messages have overtaken is taken if the source sent at most 63 messages in
/// between; otherwise the message is dropped as a duplicate. Class 1 allows that loss (R53, D75).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) struct Window {
    pub newest: Option<Seq24>,
    /// A bit mask of the messages before the newest: bit `i` says that the message `i + 1` numbers before it was seen.
    pub seen: u64,
    /// When no copy of any of these messages can arrive any more. At that instant the window is cleared, before sequence
    /// numbers repeat (D6).
    pub until: Instant,
}

impl Window {
    /// Records a message of which no copy can arrive after `until`. Returns false if the message is a duplicate, or is too
    /// old for the window.
    pub fn admit(&mut self, sequence: Seq24, now: Instant, until: Instant) -> bool {
        if self.until <= now {
            *self = Self::default();
        }
        let until = self.until.max(until);
        let admitted = self.note(sequence);
        self.until = until;
        admitted
    }

    /// Whether a message is a duplicate, or is too old for the window.
    pub fn has(&self, sequence: Seq24, now: Instant) -> bool {
        let newest = self.newest.filter(|_| self.until > now);
        newest.is_some_and(|newest| {
            !sequence.is_newer_than(newest) && {
                let back = newest.steps_from(sequence);
                back == 0 || back > 64 || self.seen & (1 << (back - 1)) != 0
            }
        })
    }

    fn note(&mut self, sequence: Seq24) -> bool {
        let Some(newest) = self.newest else {
            *self = Self { newest: Some(sequence), ..*self };
            return true;
        };
        if sequence.is_newer_than(newest) {
            let steps = sequence.steps_from(newest);
            let shifted = self.seen.checked_shl(steps).unwrap_or(0);
            let old_newest = 1_u64.checked_shl(steps - 1).unwrap_or(0);
            *self = Self { newest: Some(sequence), seen: shifted | old_newest, ..*self };
            return true;
        }
        let back = newest.steps_from(sequence);
        if back == 0 || back > 64 {
            return false;
        }
        let bit = 1_u64 << (back - 1);
        let fresh = self.seen & bit == 0;
        self.seen |= bit;
        fresh
    }
}

/// The duplicate detection for one source on one port (D75).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Source {
    pub task: TaskId,
    pub memory: Memory,
}

/// The dedup state of a source, by the class of the port.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Memory {
    Command(Option<DedupEntry>),
    Status(Window),
}

/// The result of looking up a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Seen {
    /// The message is new, or known only by copies that expired before the task took them.
    New,
    /// The message is a copy of the command of the dedup entry.
    Again(CommandStatus),
    /// The message is a duplicate status, or a command older than the command of the dedup entry: its sender has given it
    /// up.
    Older,
}

impl Source {
    pub fn new(task: TaskId, port: &PortDecl) -> Self {
        let memory = match port.class {
            Class::Command => Memory::Command(None),
            Class::Status => Memory::Status(Window::default()),
        };
        Self { task, memory }
    }

    /// The dedup entry of the source's last command.
    #[inline]
    pub fn command(&self) -> Option<&DedupEntry> {
        match &self.memory {
            Memory::Command(command) => command.as_ref(),
            Memory::Status(_) => None,
        }
    }

    /// As [`command`](Self::command), but mutable.
    #[inline]
    pub fn command_mut(&mut self) -> Option<&mut DedupEntry> {
        match &mut self.memory {
            Memory::Command(command) => command.as_mut(),
            Memory::Status(_) => None,
        }
    }

    /// Sets or clears the dedup entry.
    pub fn remember(&mut self, new: Option<DedupEntry>) {
        match &mut self.memory {
            Memory::Command(command) => *command = new,
            Memory::Status(_) => {}
        }
    }

    /// Records a class-1 message of which no copy can arrive after `until`.
    pub fn admit(&mut self, sequence: Seq24, now: Instant, until: Instant) {
        match &mut self.memory {
            Memory::Status(window) => {
                window.admit(sequence, now, until);
            }
            Memory::Command(_) => {}
        }
    }

    /// Forgets the earlier incarnation of the source's node.
    pub fn forget(&mut self) {
        match &mut self.memory {
            Memory::Command(command) => *command = None,
            Memory::Status(window) => *window = Window::default(),
        }
    }

    /// Clears entries that have ended by `now`.
    #[cfg(feature = "checker")]
    pub fn bury(&mut self, now: Instant) {
        match &mut self.memory {
            Memory::Command(command) => *command = command.filter(|c| c.until > now),
            Memory::Status(window) if window.until <= now => *window = Window::default(),
            Memory::Status(_) => {}
        }
    }

    /// Clears entries of messages of which no copy can arrive any more. `copies` gives the numbers of the copies that may
    /// still come.
    #[cfg(feature = "checker")]
    pub fn bury_seen<I: Iterator<Item = Seq24>>(&mut self, copies: impl Fn() -> I) {
        // The entry matters only for copies that are not newer than the newest received message. A newer copy is accepted
        // with and without the entry.
        let may_come = |newest: Seq24| copies().any(|copy| !copy.is_newer_than(newest));
        match &mut self.memory {
            Memory::Command(command) => {
                let is_settled = |c: &DedupEntry| {
                    matches!(
                        c.status,
                        CommandStatus::Refused | CommandStatus::Answered(_) | CommandStatus::Lapsed
                    )
                };
                *command = command.filter(|c| !is_settled(c) || may_come(c.id.sequence));
            }
            Memory::Status(window) => {
                let Some(newest) = window.newest.filter(|&newest| may_come(newest)) else {
                    *window = Window::default();
                    return;
                };
                let backs = copies().map(|copy| newest.steps_from(copy));
                let bits = backs.filter(|back| (1..=64).contains(back));
                window.seen &= bits.fold(0, |bits, back| bits | 1 << (back - 1));
            }
        }
    }

    /// Whether a message of the source's present incarnation is new, while no command of the source waits.
    #[inline(always)]
    pub fn is_next(&self, id: MessageId, now: Instant) -> bool {
        match &self.memory {
            Memory::Command(Some(last)) if last.until > now => match last.status {
                CommandStatus::Held => false,
                CommandStatus::Lapsed if last.id == id => true,
                _ => last.id != id && !last.id.sequence.is_newer_than(id.sequence),
            },
            Memory::Command(_) => true,
            Memory::Status(window) => !window.has(id.sequence, now),
        }
    }

    /// Looks up a message of the source's present incarnation.
    pub fn look_up(&self, id: MessageId, now: Instant) -> Seen {
        let command = match &self.memory {
            Memory::Status(window) if window.has(id.sequence, now) => return Seen::Older,
            Memory::Status(_) => return Seen::New,
            Memory::Command(command) => command.as_ref(),
        };
        match command.filter(|c| c.until > now) {
            None => Seen::New,
            Some(c) if c.id == id && c.status == CommandStatus::Lapsed => Seen::New,
            Some(c) if c.id == id => Seen::Again(c.status),
            Some(c) if c.id.sequence.is_newer_than(id.sequence) => Seen::Older,
            Some(_) => Seen::New,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::collections::BTreeSet;
    use proptest::prelude::*;

    proptest! {
        /// Compares the window with a set of all received numbers. The window must admit no number twice, and must admit
        /// every new number within its range, wherever the sequence wraps.
        #[test]
        fn the_window_admits_each_message_once(base in 0..Seq24::MODULUS, offsets in proptest::collection::vec(0..200_u32, 1..80)) {
            let mut window = Window::default();
            let mut seen = BTreeSet::new();
            let mut newest = None;
            for offset in offsets {
                let had = window.has(Seq24::new(base).plus(offset), Instant(1));
                let admitted = window.admit(Seq24::new(base).plus(offset), Instant(1), Instant(9));
                let recent = newest.is_none_or(|n| offset + 64 >= n);
                prop_assert_eq!(admitted, recent && !seen.contains(&offset));
                prop_assert_eq!(had, !admitted);
                if admitted { seen.insert(offset); }
                newest = newest.max(Some(offset));
            }
        }
    }
}
