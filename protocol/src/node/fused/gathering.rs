//! Fused arrivals: a task reaches a `waitfor`, and the other members, all on its node, hear of it in the same step (D193).
//!
//! In small steps the task sends ARRIVE to each of the others. If it is the last one, each member is released and sends
//! CONFIRM to all others, n (n - 1) in all, each an input of its own. In the fused step every member hears of the arrival
//! by the same functions, and takes no packet: the CONFIRMs would only find that their receivers are released.

use crate::cell::Usage;
use crate::ids::TaskId;
use crate::mapping;
use crate::request::Request;
use crate::table::{NodeTable, Port};
use crate::task::{CommTask, Outbox};
use crate::ticks::Ticks;

/// The communication tasks of a node, of which some are members of a `waitfor`.
pub trait Members {
    /// The communication task at this position among the node's tasks, ascending by task, and the outbox of its step. The outbox
    /// delivers no packet: all are for members that take part in the same step.
    fn at(&mut self, place: usize) -> (&mut CommTask, impl Outbox);

    /// Whether the step may release the members. Then it leaves out the CONFIRMs that they would take as inputs.
    fn may_release(&self) -> bool {
        true
    }
}

/// A task's arrival at a `waitfor` that one fused step may carry out for all members.
#[derive(Clone, Copy, Debug)]
pub struct Gathering<'a> {
    table: &'a NodeTable,
    port: &'a Port,
    /// The position of the arriving task among the members.
    from: usize,
    arguments: [u8; 8],
    patience: Ticks,
}

impl<'a> Gathering<'a> {
    /// The arrival that `task` requests. `None` if `request` is no arrival, or if a member is on another node.
    #[must_use]
    pub fn of(table: &'a NodeTable, task: TaskId, request: &Request) -> Option<Self> {
        let Request::Arrive { port, arguments, time_out } = *request else { return None };
        let (port, own) = mapping::own_end(table, port, task).ok().filter(|_| table.is_decided())?;
        let is_whole = port.decl.usage == Usage::Waitfor
            && port.parties.iter().all(|party| table.place(party.task).is_some());
        let from = port.party_index(task).filter(|_| is_whole)?;
        Some(Self { table, port, from, arguments, patience: own.time_out_of(time_out) })
    }

    /// The positions of the other members among the node's tasks.
    pub fn others(&self) -> impl Iterator<Item = usize> + use<'a> {
        let Self { table, port, from, .. } = *self;
        let others = port.parties.iter().enumerate().filter(move |&(member, _)| member != from);
        others.filter_map(|(_, party)| table.place(party.task))
    }

    /// Takes the step. The clocks of all members must show the same time, and the other members must have taken all that
    /// was sent to them before. Returns false, and changes nothing, if the arrival needs small steps.
    pub fn step(&self, members: &mut impl Members) -> bool {
        let Self { table, port, from, arguments, patience } = *self;
        let at = |member: usize| table.place(port.parties[member].task).unwrap_or_default();
        let (own, _) = members.at(at(from));
        let Some(arrival) = own.may_reach((port, from), arguments, patience) else { return false };
        if arrival.releases() && !members.may_release() {
            return false;
        }
        let others = || (0..port.parties.len()).filter(|&member| member != from);
        if !others().all(|member| members.at(at(member)).0.may_hear((port, member), &arrival)) {
            return false;
        }
        {
            let (own, mut out) = members.at(at(from));
            own.reach_fused(table, (port, from), &arrival, &mut out);
        }
        for member in others() {
            let (other, mut out) = members.at(at(member));
            other.hear_fused(table, (port, member), &arrival, &mut out);
        }
        true
    }
}
