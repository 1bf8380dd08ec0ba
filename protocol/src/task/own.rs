//! State that all parts of a communication task share: identity, clock, order of service, and ports.

#[cfg(feature = "checker")]
mod walk;

use super::counts::Counts;
use super::fragments::Parts;
use crate::cell::{CoupleDecl, Usage};
use crate::ids::{Incarnation, MessageId, PortId, Seq24, TaskId};
use crate::packet::{Class, Contents};
use crate::request::{Fault, ServiceOrder, Signal};
use crate::table::{NodeTable, Peer, Port};
use crate::ticks::Instant;
use alloc::boxed::Box;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};

/// The task's use of a port, with the position of the state that belongs to this use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) enum Role {
    /// The task sends class-1 messages, which are not answered.
    Sends,
    /// The task sends class-2 messages. The client keeps the outstanding request at this position.
    Asks(u16),
    /// The task receives messages into this inbox of the server.
    Receives(u16),
    /// The task takes part in this rendezvous.
    Meets(u16),
    /// The task sends third-party replies (D11).
    Replies,
    /// The task receives third-party replies.
    Hears,
    /// The port carries the heartbeats between this task, a primary or standby, and its partner (D61).
    Heartbeats,
}

/// An endpoint: the task's side of one port.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Endpoint {
    pub port: PortId,
    pub role: Role,
    pub counters: Counts,
    /// Fragments that the task has handed over for its next message or answer, which is not sent yet (D28).
    pub staged: Parts,
}

impl Endpoint {
    fn new(port: &Port, role: Role) -> Self {
        let fragments = match role {
            Role::Receives(_) | Role::Replies => port.decl.answer_fragments,
            Role::Sends | Role::Asks(_) | Role::Meets(_) | Role::Hears | Role::Heartbeats => {
                port.decl.fragments
            }
        };
        Self { port: port.id, role, counters: Counts::default(), staged: Parts::new(fragments) }
    }
}

/// The state that the parts share.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Own {
    pub task: TaskId,
    pub incarnation: Incarnation,
    pub restarted: bool,
    /// The task's clock, to which all its instants belong.
    pub now: Instant,
    pub next_sequence: Seq24,
    /// Until this instant a restarted task takes no commands and arrivals from other nodes: they may be for its earlier
    /// incarnation (D49).
    pub quarantine_until: Instant,
    /// The ranks that the task has set (D16).
    pub order: ServiceOrder,
    /// The endpoints of the task, ascending by port.
    pub endpoints: Box<[Endpoint]>,
}

impl Own {
    /// The shared state of a task at the start of an incarnation of its node.
    pub fn new(table: &NodeTable, task: TaskId, incarnation: Incarnation, restarted: bool) -> Self {
        let (mut endpoints, [mut requests, mut inboxes]) = (Vec::new(), [0; 2]);
        for &id in table.ports_of(task) {
            let Some((port, party)) = table.port(id).and_then(|port| Some((port, port.party(task)?))) else {
                continue;
            };
            let next = |count: &mut usize| {
                *count += 1;
                index(*count - 1)
            };
            let role = match party.usage {
                Usage::Query | Usage::Response if couple_of(table, id, task).is_some() => Role::Heartbeats,
                Usage::Send | Usage::Query if port.decl.class == Class::Command => {
                    Role::Asks(next(&mut requests))
                }
                Usage::Send | Usage::Query => Role::Sends,
                Usage::Receive if port.decl.usage == Usage::Reply => Role::Hears,
                Usage::Receive | Usage::Response => Role::Receives(next(&mut inboxes)),
                Usage::Reply => Role::Replies,
                Usage::Waitfor => Role::Meets(party.meeting),
            };
            endpoints.push(Endpoint::new(port, role));
        }
        Self {
            task,
            incarnation,
            restarted,
            now: Instant::START,
            next_sequence: Seq24::default(),
            quarantine_until: if restarted {
                Instant::START + table.quarantine(task)
            } else {
                Instant::START
            },
            order: ServiceOrder::default(),
            endpoints: endpoints.into(),
        }
    }

    /// The id of the task's next message.
    pub const fn coming_id(&self) -> MessageId {
        MessageId { incarnation: self.incarnation, sequence: self.next_sequence }
    }

    /// The ports that the task has in a role for which `has` is true, each with its endpoint's position.
    pub fn ports<'a>(
        &self,
        table: &'a NodeTable,
        has: impl Fn(Role) -> bool,
    ) -> impl Iterator<Item = (u16, &'a Port)> {
        let mine = self.endpoints.iter().enumerate().filter(move |(_, endpoint)| has(endpoint.role));
        mine.filter_map(|(place, endpoint)| Some((index(place), table.port(endpoint.port)?)))
    }

    /// Whether a message of `source` may have been meant for an earlier incarnation of the task (D49). Tasks of the same
    /// node restarted together with this task, so their messages are new (D157).
    pub fn turns_away(&self, table: &NodeTable, source: &Peer) -> bool {
        self.now < self.quarantine_until && table.rules().quarantine && source.ingress.is_some()
    }

    /// The position of the endpoint of a port.
    #[inline]
    pub fn place(&self, port: PortId) -> Option<usize> {
        self.endpoints.binary_search_by_key(&port, |endpoint| endpoint.port).ok()
    }

    pub fn endpoint(&mut self, port: PortId) -> Option<&mut Endpoint> {
        let at = self.place(port)?;
        self.endpoints.get_mut(at)
    }

    #[inline]
    pub fn role(&self, port: PortId) -> Option<Role> {
        Some(self.endpoints[self.place(port)?].role)
    }

    /// The position of the inbox of a port; `None` if the task does not receive on it.
    pub fn inbox(&self, port: PortId) -> Option<u16> {
        self.receiving(port).ok()
    }

    /// The position of the request of a port; `None` if the task does not ask on it.
    pub fn request(&self, port: PortId) -> Option<u16> {
        if let Role::Asks(request) = self.role(port)? { Some(request) } else { None }
    }

    /// The position of the task's rendezvous on a port; `None` for a port with another usage.
    pub fn meeting(&self, port: PortId) -> Option<u16> {
        if let Role::Meets(meeting) = self.role(port)? { Some(meeting) } else { None }
    }

    /// The inbox of a port; or the fault that answers a request on a port without an inbox.
    #[inline]
    pub fn receiving(&self, port: PortId) -> Result<u16, Fault> {
        let Some(role) = self.role(port) else { return Err(Fault::NotYourPort) };
        if let Role::Receives(inbox) = role { Ok(inbox) } else { Err(Fault::WrongUsage) }
    }

    /// Checks that the task has handed over all fragments of its next message. If one is missing, drops them all.
    pub fn staged(&mut self, endpoint: usize) -> Result<(), Fault> {
        let staged = &mut self.endpoints[endpoint].staged;
        if staged.fragments().is_some() {
            return Ok(());
        }
        staged.clear();
        Err(Fault::WrongLength)
    }

    /// Stages one more fragment of the next message or answer on a port.
    pub fn stage(&mut self, port: PortId, index: u8, contents: Contents) -> Result<Signal, Fault> {
        let endpoint = self.endpoint(port).ok_or(Fault::NotYourPort)?;
        match endpoint.role {
            Role::Sends | Role::Asks(_) | Role::Receives(_) | Role::Replies => {}
            Role::Hears | Role::Meets(_) | Role::Heartbeats => return Err(Fault::WrongUsage),
        }
        if endpoint.staged.put(index, contents) {
            return Ok(Signal::Accepted(0));
        }
        // Either all fragments of a message are sent or none. A fragment that stays here would end up in the next message
        // (D28).
        endpoint.staged.clear();
        Err(Fault::WrongLength)
    }

    pub fn unstage(&mut self, port: PortId) {
        if let Some(endpoint) = self.endpoint(port) {
            endpoint.staged.clear();
        }
    }

    /// How often GETs may serve other ports although this port has a message, before this port is served first (D58).
    pub fn bypass_limit(&self) -> u16 {
        index(self.endpoints.len() + self.order.ranked().len()).max(4)
    }

    /// Validates deserialised shared state: its endpoints must match those of a new state.
    pub fn is_like(&self, new: &Self) -> bool {
        are_alike(&self.endpoints, &new.endpoints, |read, new| {
            (read.port, read.role) == (new.port, new.role) && read.staged.has_room_of(&new.staged)
        })
    }
}

/// The couple whose heartbeats `port` carries, with its position in the cell; `None` if the port carries no heartbeats.
pub(crate) fn couple_of(table: &NodeTable, port: PortId, task: TaskId) -> Option<(u8, &CoupleDecl)> {
    let couples = table.cell().couples.iter().enumerate();
    let mine = |c: &CoupleDecl| c.via == port && (c.primary == task || c.standby == task);
    couples.filter(|(_, c)| mine(c)).find_map(|(i, c)| Some((u8::try_from(i).ok()?, c)))
}

/// Whether a deserialised list matches a new list: both have the same length, and each element is like its counterpart.
pub(crate) fn are_alike<T>(read: &[T], new: &[T], is_like: impl Fn(&T, &T) -> bool) -> bool {
    read.len() == new.len() && read.iter().zip(new).all(|(read, new)| is_like(read, new))
}

/// Narrows a position in one of the task's lists; a cell has at most 65,536 ports.
#[expect(clippy::cast_possible_truncation, reason = "a cell has at most 65,536 ports")]
pub(crate) const fn index(i: usize) -> u16 {
    i as u16
}
