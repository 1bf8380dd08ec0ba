//! The static part of the route layer (§5.2.3): where a packet goes. Pure functions of the table, called by every driver.
//! The [`Transit`](crate::transit::Transit) buffer decides which packet goes next.

mod reverse_path;

use crate::ids::{NodeId, TaskId};
use crate::observe::Reason;
use crate::packet::{Kind, Packet};
use crate::rules::TimeStamp;
use crate::table::NodeTable;
use crate::ticks::Ticks;

/// What to do with a packet that came in over a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// The packet is for this task of this node.
    Local(TaskId, Packet),
    /// The packet is for another node and goes into the transit buffer.
    Relay(Packet),
    /// The packet is dropped, for this reason.
    Discard(Reason, Packet),
}

/// Where a packet of a task of this node goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Departure {
    /// To a task of this node.
    Local(TaskId),
    /// Over the link to this neighbour.
    Link(NodeId),
    /// Nowhere: the table has no route.
    Unroutable,
}

/// Decides what happens to a packet from the neighbour `from`. `charge` is the link delay to take from its remaining time:
/// no less than the link's bound (D20).
#[must_use]
pub fn arrived(table: &NodeTable, from: NodeId, mut packet: Packet, charge: Ticks) -> Arrival {
    let Some(location) = table.location(packet.destination) else {
        return Arrival::Discard(Reason::Unroutable, packet);
    };
    // The insertion rule: only the declared parties of a port send on it, only to each other, and only along the route that
    // the table gives.
    let ends = table.port(packet.port).and_then(|port| port.ends(packet.destination, packet.source));
    let Some(ends) = ends else { return Arrival::Discard(Reason::NotAllowed, packet) };
    let is_here = location == table.node;
    if !(is_here && ends.peer.ingress == Some(from) || reverse_path::can_come(table, from, &packet)) {
        return Arrival::Discard(Reason::NotAllowed, packet);
    }
    if table.rules().time_stamp == TimeStamp::Remaining {
        packet.remaining = packet.remaining - charge;
        // Only the rule variant that accepts late replies accepts a reply after its request has ended.
        let outlives =
            matches!(packet.kind, Kind::Reply | Kind::Response) && !table.rules().refuse_late_replies;
        // At its destination node an expired message goes to its task, which drops it and counts it at the port.
        let message = matches!(packet.kind, Kind::Send | Kind::Query) && is_here;
        if packet.remaining.is_zero() && !outlives && !message {
            return Arrival::Discard(Reason::ExpiredOnTheWay, packet);
        }
    }
    if is_here {
        return Arrival::Local(packet.destination, packet);
    }
    let Some(hops) = packet.hops.checked_sub(1) else {
        return Arrival::Discard(Reason::HopLimit, packet);
    };
    packet.hops = hops;
    Arrival::Relay(packet)
}

/// The neighbour to which a packet goes next.
#[must_use]
pub fn departing(table: &NodeTable, packet: &Packet) -> Departure {
    match table.location(packet.destination) {
        Some(location) if location == table.node => Departure::Local(packet.destination),
        Some(location) => table.next_hop(table.node, location).map_or(Departure::Unroutable, Departure::Link),
        None => Departure::Unroutable,
    }
}
