//! Whether a state that was read from a file is one that the machine of its task can work on. A keyframe of a recording
//! is bytes that anybody may have written: what is out of bounds in it is refused before the machine sees it.

use super::desk::Desk;
use super::fragments::{is_assembly, is_room};
use super::heads::Heads;
use super::inbox::Inbox;
use super::levels::{DEPTH, Finished, Level};
use super::memory::Memory;
use super::rendezvous::Rendezvous;
use super::{CommTask, Local, Pending};
use crate::table::NodeTable;

/// Counts grow by one an input: from here on there is room for more inputs than any recording has.
const MOST: u64 = 1 << 62;

impl CommTask {
    /// Whether a state that was read from a file has the lists of a new machine of its task, of the same lengths and for the
    /// same ports and tasks, and every position in it names something that is there. Then no input makes it panic.
    /// [`invariants::check`](crate::invariants::check) says what else must hold.
    #[must_use]
    pub fn is_whole(&self, table: &NodeTable) -> bool {
        if table.location(self.task).is_none() {
            return false;
        }
        let new = Self::new(table, self.task, self.incarnation, self.restarted);
        let lists = same(&self.locals, &new.locals, is_local)
            && same(&self.desks, &new.desks, is_desk)
            && same(&self.inboxes, &new.inboxes, is_inbox)
            && same(&self.meetings, &new.meetings, is_meeting)
            && same(&self.lives, &new.lives, |a, b| a.task == b.task)
            && same(&self.guards, &new.guards, |a, b| a.couple == b.couple);
        let lease = match (&self.lease, &new.lease) {
            (Some(a), Some(b)) => (a.couple, a.primary, a.partner) == (b.couple, b.primary, b.partner),
            (None, None) => true,
            (Some(_), None) | (None, Some(_)) => false,
        };
        let counts = [self.arrivals, self.rejections, self.served].into_iter().all(|count| count < MOST);
        lists
            && lease
            && counts
            && self.are_levels()
            && self.are_heads()
            && is_room(&self.taken.1, &new.taken.1)
    }

    fn are_levels(&self) -> bool {
        let named = |level: &Level| {
            let waits = match level.pending {
                Pending::Reply(desk) => usize::from(desk) < self.desks.len(),
                Pending::Meeting(meeting) => usize::from(meeting) < self.meetings.len(),
                Pending::Lease => self.lease.is_some(),
                Pending::Nothing
                | Pending::Get { .. }
                | Pending::Delay(..)
                | Pending::Work
                | Pending::Boundary => true,
            };
            let ended = match level.finished {
                Some(Finished::Answers(desk) | Finished::Long(desk)) => usize::from(desk) < self.desks.len(),
                _ => true,
            };
            waits && ended
        };
        self.levels.len() == DEPTH + 1 && usize::from(self.depth) <= DEPTH && self.levels.iter().all(named)
    }

    fn are_heads(&self) -> bool {
        let Heads { urgent, eldest, offers, ends, meetings } = &self.heads;
        let ports = self.inboxes.len();
        urgent.is_whole(ports)
            && eldest.is_whole(ports)
            && [offers, ends].into_iter().all(|order| order.is_whole(ports) || order.is_whole(0))
            && meetings.is_whole(self.meetings.len())
    }
}

fn same<T>(read: &[T], new: &[T], is_like: impl Fn(&T, &T) -> bool) -> bool {
    read.len() == new.len() && read.iter().zip(new).all(|(read, new)| is_like(read, new))
}

fn is_local(read: &Local, new: &Local) -> bool {
    (read.port, read.role) == (new.port, new.role) && is_room(&read.staged, &new.staged)
}

fn is_desk(read: &Desk, new: &Desk) -> bool {
    (read.port, read.local) == (new.port, new.local)
        && is_room(&read.parts, &new.parts)
        && same(&read.asked, &new.asked, |a, b| {
            (a.task, a.party) == (b.task, b.party) && is_assembly(&a.contents, &b.contents)
        })
}

fn is_inbox(read: &Inbox, new: &Inbox) -> bool {
    let long = match (&read.long, &new.long) {
        (Some(read), Some(new)) => read.is_like(new),
        (None, None) => true,
        (Some(_), None) | (None, Some(_)) => false,
    };
    let status = |memory: &Memory| matches!(memory, Memory::Status(_));
    (read.port, read.local, read.latest) == (new.port, new.local, new.latest)
        && read.queue.is_whole(new.queue.capacity())
        && read.queue.iter().all(|(_, held)| read.source(held.source).is_some())
        && same(&read.sources, &new.sources, |a, b| {
            a.task == b.task && status(&a.memory) == status(&b.memory)
        })
        && read.since < MOST
        && long
}

fn is_meeting(read: &Rendezvous, new: &Rendezvous) -> bool {
    (read.port, read.numbered, read.members.len()) == (new.port, new.numbered, new.members.len())
}
