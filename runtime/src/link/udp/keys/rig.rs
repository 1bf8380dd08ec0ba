//! Two nodes with keys and a network between them, without sockets, for the tests and the fuzz target `keys`.

use super::*;
use crate::link::LinkDiscard;
use imrs_protocol::Incarnation;
use imrs_wire::envelope::keyed::{self, Keyed, MAX_KEYED_BYTES};
use imrs_wire::envelope::{Datagram, Digests, Envelope, Purpose, Session};

pub(super) const DIGESTS: Digests = Digests { cell: 7, statements: 8 };
pub(super) const ENDS: [NodeId; 2] = [NodeId(0), NodeId(1)];
pub(super) const MS: u64 = 1_000;

/// One of the two nodes.
pub(super) struct End {
    pub(super) me: usize,
    pub(super) channel: Channel,
    pub(super) counter: u64,
    /// The counters of the datagrams that this node opened, in order.
    pub(super) opened: Vec<u64>,
}

/// The keys of both nodes of a cell.
pub(super) fn keys() -> [NodeKeys; 2] {
    let cell = draw_cell_key().unwrap();
    let pairs = [0, 1].map(|_| draw_node_keys().unwrap());
    [0, 1].map(|me| {
        let publics = BTreeMap::from([(ENDS[1 - me], pairs[1 - me].1)]);
        NodeKeys::new(cell.clone(), pairs[me].0.clone(), publics)
    })
}

pub(super) fn end(keys: &[NodeKeys; 2], me: usize, session: u64, digests: Digests) -> End {
    let ends = (ENDS[me], ENDS[1 - me]);
    let channel = Channel::new(&keys[me], ends, Session(session), digests, 3).unwrap().unwrap();
    End { me, channel, counter: 0, opened: Vec::new() }
}

pub(super) fn ends(keys: &[NodeKeys; 2]) -> [End; 2] {
    [0, 1].map(|me| end(keys, me, 10 + me as u64, DIGESTS))
}

impl End {
    /// A datagram with one packet, if there is a session.
    pub(super) fn datagram(&mut self) -> Option<Vec<u8>> {
        let live = self.channel.sending()?;
        let envelope = Envelope {
            sender: ENDS[self.me],
            receiver: ENDS[1 - self.me],
            incarnation: Incarnation(1),
            restarted: false,
            session: Session(0),
            counter: self.counter,
            tx_mono: 5,
            echo: None,
            purpose: Purpose::Packets,
        };
        self.counter += 1;
        let mut datagram = Datagram::default();
        datagram.push(&[9; 32]);
        live.seal(&mut datagram, &envelope).unwrap();
        Some(datagram.sealed().to_vec())
    }

    /// Handles a datagram as the link does. Returns the answer.
    pub(super) fn take(&mut self, bytes: &[u8], now: u64) -> Result<Option<Vec<u8>>, LinkDiscard> {
        match keyed::read(bytes)? {
            Keyed::Transport { index, counter, closed } => {
                let live = self.channel.find(index).cloned().ok_or(LinkDiscard::StaleSession)?;
                let mut room = [0; MAX_KEYED_BYTES];
                let opened = live.open(counter, closed, &mut room)?;
                assert_eq!((opened.envelope.sender, opened.packets), (ENDS[1 - self.me], &[[9; 32]][..]));
                self.channel.confirm(&live, now);
                self.opened.push(counter);
                Ok(None)
            }
            Keyed::Handshake(said) if said.sender != ENDS[1 - self.me] => Err(LinkDiscard::UnknownNode),
            Keyed::Handshake(said) => Ok(match self.channel.heard(bytes, &said, now)? {
                Answer::Nothing => None,
                Answer::Send(reply) => Some(reply.to_vec()),
                Answer::Made => self.datagram(),
                Answer::Refused { reply, .. } => reply.map(|reply| reply.to_vec()),
            }),
        }
    }

    /// The greeting that the polling thread repeats until the neighbour has answered.
    pub(super) fn greeting(&mut self, now: u64) -> Option<Vec<u8>> {
        self.channel.greets_again(now).then(|| self.datagram()).flatten()
    }

    pub(super) fn knock(&mut self, now: u64) -> Option<Vec<u8>> {
        let wants = self.channel.wants(now, self.counter);
        wants.then(|| self.channel.knock(now)).flatten().map(|hello| hello.to_vec())
    }
}

#[cfg(test)]
impl Channel {
    /// Everything that a datagram might change in this channel, except the hints for people.
    pub(in crate::link::udp) fn state(&self) -> String {
        let windows: Vec<_> = self.sessions.iter().map(|live| (live, live.state())).collect();
        let making =
            self.making.as_ref().map(|making| (making.nonce, making.noise.as_ref().map(|noise| noise.1)));
        let (asked, answered) = ((self.tried, self.greeted, self.indices), self.answered.len());
        format!("{windows:?} {making:?} {asked:?} {answered}")
    }
}

/// Makes a session without any loss; the first node asks for it. Returns all datagrams.
#[cfg(test)]
pub(super) fn acquainted(ends: &mut [End; 2], now: u64) -> Vec<(usize, Vec<u8>)> {
    let mut sent = vec![(1, ends[0].knock(now).unwrap())];
    let mut at = 0;
    while let Some((to, bytes)) = sent.get(at).cloned() {
        if let Some(reply) = ends[to].take(&bytes, now).unwrap() {
            sent.push((1 - to, reply));
        }
        at += 1;
    }
    assert!(ends.iter().all(|end| end.channel.sending().is_some()));
    sent
}
