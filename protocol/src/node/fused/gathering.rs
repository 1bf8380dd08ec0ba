//! Fused arrivals: a task reaches a `waitfor`, and the other members, all on its node, hear of it in the same step (D193).
//!
//! In small steps the task sends ARRIVE to each of the others. If it is the last one, each member is released and sends
//! CONFIRM to all others, n (n - 1) in all, each an input of its own. In the fused step every member hears of the arrival
//! by the same functions, and takes no packet: the CONFIRMs would only find that their receivers are released.

use crate::cell::Usage;
use crate::ids::TaskId;
use crate::observe::Observation;
use crate::request::Request;
use crate::table::{NodeTable, Party, Port};
use crate::task::{CommTask, Outbox};
use crate::ticks::Ticks;

/// The communication tasks of a node, of which some are members of a `waitfor`.
pub trait Members {
    /// The communication task at this position among the node's tasks, ascending by task, and the outbox of its step. The outbox
    /// delivers no packet: all are for members that take part in the same step.
    fn at(&mut self, place: usize) -> (&mut CommTask, impl Outbox);

    /// As [`at`](Self::at), for a part of the step that only observes.
    fn hearing(&mut self, place: usize) -> (&mut CommTask, impl FnOnce(Observation));

    /// Whether the step may release the members. If so, it makes no CONFIRM, which each member would take as an input in small
    /// steps.
    fn may_release(&self) -> bool {
        true
    }

    /// Whether the task at this position may take its part in the step: its clock then shows the time of the arriving task, and
    /// it has taken all that was sent to it before.
    fn takes_part(&mut self, _place: usize) -> bool {
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
        let port = table.port(port).filter(|_| table.is_decided())?;
        let is_whole = port.decl.usage == Usage::Waitfor && port.node == Some(table.node);
        let from = port.party_index(task).filter(|_| is_whole)?;
        let patience = port.parties[from].time_out_of(time_out);
        Some(Self { table, port, from, arguments, patience })
    }

    /// The positions of the other members among the node's tasks.
    pub fn others(&self) -> impl Iterator<Item = usize> + use<'a> {
        let Self { port, from, .. } = *self;
        others(port, from).map(|(_, party)| party.local.into())
    }

    /// Carries out the arrival. Returns whether it released the members. Returns `None`, and changes nothing, if small steps are
    /// needed.
    pub fn step(&self, members: &mut impl Members) -> Option<bool> {
        let Self { table, port, from, arguments, patience } = *self;
        let own = usize::from(port.parties[from].local);
        let arrival = members.at(own).0.may_reach((port, from), arguments, patience)?;
        if arrival.releases() && !members.may_release() {
            return None;
        }
        for (member, party) in others(port, from) {
            let place = party.local.into();
            if !(members.takes_part(place) && members.at(place).0.may_hear((port, party, member), &arrival)) {
                return None;
            }
        }
        {
            let (own, mut out) = members.at(own);
            own.reach_fused(table, (port, from), &arrival, &mut out);
        }
        for (member, party) in others(port, from) {
            let (other, observe) = members.hearing(party.local.into());
            other.hear_fused(party, &arrival, observe);
            if arrival.releases() {
                let (other, mut out) = members.at(party.local.into());
                other.release_fused(table, (port, member), &mut out);
            }
        }
        Some(arrival.releases())
    }
}

/// The members except `from`, each with its position.
fn others(port: &Port, from: usize) -> impl Iterator<Item = (usize, &Party)> {
    port.parties.iter().enumerate().filter(move |&(member, _)| member != from)
}
