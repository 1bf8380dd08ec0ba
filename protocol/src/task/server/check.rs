//! The invariants of a server between two inputs.

use super::Server;
use super::inbox::{Held, Inbox, RetryState};
use super::memory::{CommandStatus, DedupEntry};
use crate::ids::TaskId;
use crate::packet::Class;
use crate::rules::{Aging, Memory};
use crate::table::{NodeTable, Port};
use crate::task::interrupts::cap;
use crate::task::own::Own;
use crate::task::violation::Violation;
use crate::ticks::{Instant, Ticks};

impl Server {
    /// Checks all inboxes and the ready set. `open` says whether the running activation can be interrupted.
    ///
    /// # Errors
    /// The first violation found.
    pub(in crate::task) fn check(&self, table: &NodeTable, own: &Own, open: bool) -> Result<(), Violation> {
        self.inboxes.iter().try_for_each(|inbox| inbox.check(table, own, open))?;
        let wrong = self.ready.out_of_order(&self.inboxes, &own.order);
        wrong.map_or(Ok(()), |port| Err(Violation::OutOfOrder(port)))
    }
}

impl Inbox {
    fn check(&self, table: &NodeTable, own: &Own, open: bool) -> Result<(), Violation> {
        let port = table.port(self.port).ok_or(Violation::Overfull(self.port))?;
        if self.queue.len() > usize::from(port.decl.bounded_buffer) {
            return Err(Violation::Overfull(self.port));
        }
        // Some variants extend the deadline of a waiting message beyond its sender's wait and beyond its dedup entry.
        let exact = table.rules().charge_residence && !port.decl.lengthens_ttls();
        for (slot, held) in self.queue.iter() {
            let retry = self.queue.side(slot);
            let (id, source) = (self.port, held.source);
            if held.expires <= own.now {
                return Err(Violation::HoldsExpired(id, source, held.id()));
            }
            if held.class != port.decl.class || !port.admits(source, own.task) {
                return Err(Violation::HoldsForeign(id, source, held.id()));
            }
            let remembers = table.rules().memory == Memory::TtlAndLink && exact;
            if remembers && held.class == Class::Command && !self.remembers(held, own.now) {
                return Err(Violation::NotRemembered(id, source, held.id()));
            }
            check_rejections(table, own, port, (held, retry))?;
            if self.handled && open && retry.not_before <= own.now {
                return Err(Violation::NotOffered(id, source, held.id()));
            }
        }
        for (at, source) in self.sources.iter().enumerate() {
            let open = self.assembly(at).filter(|assembly| assembly.is_open());
            if open.is_some_and(|assembly| assembly.expires <= own.now || port.decl.fragments < 2) {
                return Err(Violation::HoldsFragments(self.port, source.task));
            }
            if exact {
                source.command().into_iter().try_for_each(|command| check_memory(source.task, command))?;
            }
        }
        Ok(())
    }

    fn remembers(&self, held: &Held, now: Instant) -> bool {
        let command = self.source(held.source).and_then(|at| self.sources[at].command());
        command.is_some_and(|c| c.id == held.id() && c.waits(now))
    }
}

/// Checks the number of rejections of a message, and its penalty (D58).
fn check_rejections(
    table: &NodeTable,
    own: &Own,
    port: &Port,
    (held, retry): (&Held, RetryState),
) -> Result<(), Violation> {
    let penalty = port.decl.penalty;
    let counts = table.rules().aging == Aging::Bounded && !port.decl.lengthens_ttls();
    let most = if counts { cap(own.order.rank(port.id, held.source)) } else { 0 };
    let (id, source) = (port.id, held.source);
    if retry.rejections > most {
        return Err(Violation::RejectedTooOften(id, source, held.id()));
    }
    let length = penalty.map_or(table.cell().tick, |penalty| penalty.length).max(Ticks(1));
    if retry.not_before > own.now + length {
        return Err(Violation::RejectedTooLong(id, source, held.id()));
    }
    Ok(())
}

fn check_memory(source: TaskId, command: &DedupEntry) -> Result<(), Violation> {
    let budget_fits = match command.status {
        CommandStatus::Delivered(budget_ends) => budget_ends <= command.sender_until,
        CommandStatus::Held | CommandStatus::Lapsed | CommandStatus::Refused | CommandStatus::Answered(_) => {
            true
        }
    };
    if command.until < command.sender_until || !budget_fits {
        return Err(Violation::MemoryTooShort(source, command.id));
    }
    Ok(())
}
