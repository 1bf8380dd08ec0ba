//! The mapping layer (§5.2.2): from the logical names of a request to packets with addresses, and back.

use crate::cell::Usage;
use crate::ids::{MessageId, PortId, TaskId};
use crate::packet::{Class, Contents, Control, Kind, Packet};
use crate::request::{Fault, ReplyTo, Target};
use crate::table::{NodeTable, Party, Peer, Port};
use crate::task::Parts;
use crate::ticks::Ticks;

/// The task's end of a port: the port, and the task as a party of it.
#[inline]
pub(crate) fn own_end(table: &NodeTable, port: PortId, task: TaskId) -> Result<(&Port, &Party), Fault> {
    let port = table.port(port).ok_or(Fault::NotYourPort)?;
    let party = port.party(task).ok_or(Fault::NotYourPort)?;
    Ok((port, party))
}

/// The tasks to which a message goes, each with its position among the recipients; each of them gets a copy (§4.3, R39,
/// R40). For a message that can have only one recipient, see [`only_peer`].
pub(crate) fn destinations(
    port: &Port,
    from: TaskId,
    to: Target,
) -> Result<impl Iterator<Item = (usize, TaskId)> + '_, Fault> {
    let wanted = match to {
        Target::All => None,
        // `only_peer` has handled a message to one peer, so the target named here is no peer.
        Target::One(_) => return Err(Fault::NotAPeer),
        Target::Some(named) => Some(named),
    };
    let bit = |task: TaskId| {
        port.party_index(task).and_then(|i| 1_u64.checked_shl(u32::try_from(i).ok()?)).unwrap_or(0)
    };
    if let Some(wanted) = wanted {
        let peers = port.peers(from).fold(0, |mask, peer| mask | bit(peer));
        if wanted == 0 || wanted & !peers != 0 {
            return Err(Fault::NotAPeer);
        }
    }
    let is_wanted = move |&(_, peer): &(usize, TaskId)| wanted.is_none_or(|wanted| wanted & bit(peer) != 0);
    Ok(port.peers(from).enumerate().filter(is_wanted))
}

/// The only destination of a message, if port and target allow only one. It is found without a scan of the parties.
#[inline]
pub(crate) fn only_peer(own: &Party, to: Target) -> Option<&Peer> {
    match (&*own.peers, to) {
        ([only], Target::All) => Some(only),
        (_, Target::One(task)) => own.peer(task),
        (_, Target::All | Target::Some(_)) => None,
    }
}

/// The packet kind of a message on this port, given by the port's usage (D17).
pub(crate) const fn message_kind(port: &Port) -> Kind {
    match port.decl.usage {
        Usage::Query | Usage::Response => Kind::Query,
        Usage::Send | Usage::Receive | Usage::Reply | Usage::Waitfor => Kind::Send,
    }
}

/// The packet kind of an answer on this port.
pub(crate) const fn answer_kind(port: &Port) -> Kind {
    match port.decl.usage {
        Usage::Query | Usage::Response => Kind::Response,
        Usage::Send | Usage::Receive | Usage::Reply | Usage::Waitfor => Kind::Reply,
    }
}

/// The packet of a message.
pub(crate) fn message(
    port: &Port,
    from: TaskId,
    to: TaskId,
    id: MessageId,
    remaining: Ticks,
    contents: Contents,
) -> Packet {
    Packet {
        kind: message_kind(port),
        class: port.decl.class,
        destination: to,
        source: from,
        port: port.id,
        id,
        remaining,
        contents,
        ..Packet::BLANK
    }
}

/// The packet with which `from` answers a class-2 message. It carries the request's id (D47).
pub(crate) fn answer(to: ReplyTo, from: TaskId, kind: Kind, remaining: Ticks, contents: Contents) -> Packet {
    Packet {
        kind,
        class: Class::Command,
        destination: to.source,
        source: from,
        port: to.port,
        id: to.id,
        remaining,
        contents,
        ..Packet::BLANK
    }
}

/// The packet with which the communication task of `from` itself answers a class-2 message.
pub(crate) fn control(to: ReplyTo, from: TaskId, control: Control, remaining: Ticks) -> Packet {
    answer(to, from, Kind::Control, remaining, control.to_contents())
}

/// The address for an answer to a message.
pub(crate) const fn reply_to(message: &Packet) -> ReplyTo {
    ReplyTo { port: message.port, source: message.source, id: message.id }
}

/// The packets of a message: the first one and its further fragments (D28).
pub(crate) fn in_fragments<'a>(
    first: Packet,
    parts: impl Into<Option<&'a Parts>>,
    mut transmit: impl FnMut(Packet),
) {
    let Some(parts) = parts.into().filter(|parts| parts.have() != 0) else { return transmit(first) };
    let fragments = parts.fragments().unwrap_or(1);
    transmit(Packet { more: fragments > 1, ..first });
    for index in 1..fragments {
        let contents = parts.get(index).copied().unwrap_or_default();
        transmit(Packet { contents, fragment: index, more: index + 1 < fragments, ..first });
    }
}
