//! The mapping layer (§5.2.2): from the logical names of a request to packets with addresses, and back.

use crate::ids::{MessageId, PortId, TaskId};
use crate::packet::{Class, Contents, Kind, MAX_HOPS, Packet};
use crate::request::{Fault, ReplyTo, Target};
use crate::table::{NodeTable, Party, Port};
use crate::ticks::Ticks;

/// The end of a port that `task` has.
pub(crate) fn own_end(table: &NodeTable, port: PortId, task: TaskId) -> Result<(&Port, &Party), Fault> {
    let port = table.port(port).ok_or(Fault::NotYourPort)?;
    let party = port.party(task).ok_or(Fault::NotYourPort)?;
    Ok((port, party))
}

/// The tasks a message goes to: a copy each (§4.3, R39, R40).
pub(crate) fn destinations(
    port: &Port,
    from: TaskId,
    to: Target,
) -> Result<impl Iterator<Item = TaskId> + '_, Fault> {
    let one = match to {
        Target::All => None,
        Target::One(task) => Some(port.peers(from).find(|&peer| peer == task).ok_or(Fault::NotAPeer)?),
    };
    Ok(port.peers(from).filter(move |&peer| one.is_none_or(|task| task == peer)))
}

/// A message packet.
pub(crate) fn message(
    port: &Port,
    from: TaskId,
    to: TaskId,
    id: MessageId,
    remaining: Ticks,
    contents: Contents,
) -> Packet {
    Packet {
        kind: Kind::Send,
        class: port.decl.class,
        more: false,
        resent: false,
        urgent: false,
        hops: MAX_HOPS,
        fragment: 0,
        destination: to,
        source: from,
        port: port.id,
        id,
        remaining,
        contents,
    }
}

/// The answer of `from` to a class-2 message: it carries the request's id (D47).
pub(crate) fn answer(to: ReplyTo, from: TaskId, kind: Kind, remaining: Ticks, contents: Contents) -> Packet {
    Packet {
        kind,
        class: Class::Command,
        more: false,
        resent: false,
        urgent: false,
        hops: MAX_HOPS,
        fragment: 0,
        destination: to.source,
        source: from,
        port: to.port,
        id: to.id,
        remaining,
        contents,
    }
}
