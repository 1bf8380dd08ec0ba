//! Sessions between two nodes: under loss, at renewals, after restarts, with other keys, and against a forger.

use super::rig::{DIGESTS, ENDS, End, MS, acquainted, end, ends, keys};
use super::*;
use crate::link::LinkDiscard;
use imrs_protocol::{
    Class, Contents, Incarnation, Kind, MAX_HOPS, MessageId, Packet, PortId, Seal, Seq24, TaskId, Ticks,
};
use imrs_wire::envelope::keyed::{self, Keyed};
use imrs_wire::envelope::{COUNTER_END, Datagram, Digests, Echo, Envelope, Purpose, Refused, Session};

/// Some milliseconds of both nodes, with a network that loses, repeats and reorders datagrams.
struct Net {
    random: fastrand::Rng,
    /// The datagrams in flight: the time of arrival, the receiving node, the bytes.
    flying: Vec<(u64, usize, Vec<u8>)>,
    loss: f64,
    copies: f64,
}

impl Net {
    fn send(&mut self, now: u64, to: usize, bytes: &[u8]) {
        for share in [1.0, self.copies] {
            if self.random.f64() < share && self.random.f64() >= self.loss {
                self.flying.push((now + self.random.u64(0..20) * MS, to, bytes.to_vec()));
            }
        }
    }

    fn arrive(&mut self, ends: &mut [End; 2], now: u64) {
        let (due, later) = std::mem::take(&mut self.flying).into_iter().partition(|(at, ..)| *at <= now);
        self.flying = later;
        let mut due: Vec<(u64, usize, Vec<u8>)> = due;
        self.random.shuffle(&mut due);
        for (_, to, bytes) in due {
            if let Ok(Some(reply)) = ends[to].take(&bytes, now) {
                self.send(now, 1 - to, &reply);
            }
        }
    }
}

#[test]
fn a_session_is_made_though_datagrams_are_lost_repeated_and_overtaken() {
    let keys = keys();
    for seed in 0..40 {
        let mut ends = ends(&keys);
        let random = fastrand::Rng::with_seed(seed);
        let mut net = Net { random, flying: Vec::new(), loss: 0.3, copies: 0.3 };
        let mut now = 0;
        // Both nodes ask for a session at once, and each sends as soon as it can.
        while ends.iter().any(|end| end.opened.is_empty()) {
            for me in [0, 1] {
                let hello = ends[me].knock(now);
                let datagram = ends[me].datagram();
                hello.iter().chain(&datagram).for_each(|bytes| net.send(now, 1 - me, bytes));
            }
            net.arrive(&mut ends, now);
            now += 10 * MS;
            assert!(now < 120_000 * MS, "seed {seed}: no session");
        }
        for end in &ends {
            let mut once = end.opened.clone();
            once.sort_unstable();
            once.dedup();
            assert_eq!(once.len(), end.opened.len(), "seed {seed}: a copy was taken in");
        }
    }
}

#[test]
fn a_new_session_under_traffic_loses_nothing() {
    let keys = keys();
    let mut ends = ends(&keys);
    acquainted(&mut ends, 0);
    let mut net = Net { random: fastrand::Rng::with_seed(1), flying: Vec::new(), loss: 0.0, copies: 0.2 };
    let mut sessions = std::collections::BTreeSet::new();
    for round in 1..=4 {
        // The round begins just before a session is old; a datagram is sent each 2 ms.
        let from = round * 3_600_000 * MS - 100 * MS;
        for now in (from..from + 400 * MS).step_by(2_000) {
            for me in [0, 1] {
                let hello = ends[me].knock(now);
                sessions.insert(ends[0].channel.sending().unwrap().index);
                let datagram = ends[me].datagram().unwrap();
                hello.iter().chain([&datagram]).for_each(|bytes| net.send(now, 1 - me, bytes));
            }
            net.arrive(&mut ends, now);
        }
        net.arrive(&mut ends, from + 1_000 * MS);
    }
    assert_eq!(sessions.len(), 5, "one in each round");
    for me in [0, 1] {
        let sent = ends[1 - me].counter;
        ends[me].opened.sort_unstable();
        assert_eq!(ends[me].opened, (0..sent).collect::<Vec<_>>());
        assert!(ends[me].channel.sending().is_some_and(|live| !live.is_old(net.random.u64(..1), 0)));
    }
}

/// Everything in a node that a datagram might change, as text.
fn state(end: &End) -> String {
    let Channel { sessions, making, tried, answered, .. } = &end.channel;
    let windows: Vec<_> = sessions.iter().map(|live| (live, live.state())).collect();
    format!("{windows:?} {:?} {tried:?} {} {:?}", making.is_some(), answered.len(), end.opened)
}

/// A forger without the key of the cell, who can do anything else: read and hold back datagrams, and run a cell of their own.
struct Forger {
    random: fastrand::Rng,
    /// All datagrams that were ever sent, with their receivers: those of this run, of an earlier start of its nodes,
    /// and of the forger's cell.
    sent: [Vec<(usize, Vec<u8>)>; 3],
    /// Both nodes of the forger's cell, which has the same nodes as the attacked cell.
    own: [End; 2],
    /// The indices of the attacked session at both nodes, which are sent in clear.
    indices: [u32; 2],
}

impl Forger {
    /// Makes the next forged datagram, one kind after another, with the node that gets it. `next` has the counters that
    /// the nodes have not used yet.
    fn datagram(&mut self, number: u64, next: [u64; 2]) -> (usize, Vec<u8>) {
        let of = [0, 0, 1, 2][self.random.usize(..4)];
        let (to, mut bytes) = self.sent[of][self.random.usize(..self.sent[of].len())].clone();
        let me = self.random.usize(..2);
        let me = match number % 11 {
            // A recorded datagram, also of a handshake: repeated unchanged to its receiver, or reflected to its sender.
            0 => to,
            1 => 1 - to,
            // A recorded datagram with the next counter, or with the greatest possible counter.
            2 | 3 => {
                let counter = if number % 11 == 2 { next[1 - me] + 1 } else { COUNTER_END - 1 };
                bytes[8..15].copy_from_slice(&counter.to_le_bytes()[..7]);
                me
            }
            // A recorded datagram with another kind, node or index, with one bit changed, or with another length.
            4 => {
                bytes[self.random.usize(4..16)] = self.random.u8(..);
                me
            }
            5 | 6 => {
                let at = self.random.usize(..bytes.len());
                bytes[at] ^= 1 << self.random.u8(..8);
                me
            }
            7 => {
                bytes.truncate(self.random.usize(..bytes.len()));
                me
            }
            // A datagram that the neighbour never sent, closed with the keys of the forger's cell, or without keys.
            8 | 9 => {
                bytes = self.closed(me, next[1 - me]);
                me
            }
            _ => {
                let envelope = self.envelope(me, next[1 - me]);
                let mut datagram = Datagram::default();
                datagram.push(&self.packet());
                bytes = datagram.seal(&envelope, DIGESTS).to_vec();
                me
            }
        };
        (me, bytes)
    }

    /// An envelope with the next incarnation, a clock that is far ahead, an echo of a time that never was, or the end
    /// of the counters.
    fn envelope(&mut self, to: usize, next: u64) -> Envelope {
        let clocks = [0, 5, 1 << 40, u64::MAX];
        let session = Session(10 + self.random.u64(..4));
        Envelope {
            sender: ENDS[1 - to],
            receiver: ENDS[to],
            incarnation: Incarnation(1 + self.random.u8(..3)),
            restarted: self.random.bool(),
            session,
            counter: [next, next + 1, COUNTER_END - 1][self.random.usize(..3)],
            tx_mono: clocks[self.random.usize(..4)],
            echo: self.random.bool().then(|| Echo { session, mono: clocks[self.random.usize(..4)] }),
            purpose: Purpose::Packets,
        }
    }

    /// A CONFIRM packet. If a node accepted it, it would release the members of a rendezvous.
    fn packet(&self) -> [u8; 32] {
        let confirm = Packet {
            kind: Kind::Confirm,
            class: Class::Command,
            more: false,
            resent: false,
            hops: MAX_HOPS,
            fragment: 0,
            destination: TaskId(1),
            source: TaskId(0),
            port: PortId(0),
            id: MessageId { incarnation: Incarnation(1), sequence: Seq24::new(1) },
            remaining: Ticks(60_000_000),
            contents: Contents::EMPTY,
            seal: Seal::NONE,
        };
        confirm.encode(DIGESTS.cell, 0)
    }

    fn closed(&mut self, to: usize, next: u64) -> Vec<u8> {
        let envelope = self.envelope(to, next);
        let mut datagram = Datagram::default();
        datagram.push(&self.packet());
        let own = self.own[1 - to].channel.sending().unwrap();
        own.seal(&mut datagram, &envelope).unwrap();
        let mut bytes = datagram.sealed().to_vec();
        bytes[4..8].copy_from_slice(&self.indices[to].to_le_bytes());
        bytes
    }
}

#[test]
fn a_forger_with_the_format_changes_nothing() {
    let count = std::env::var("IMRS_FORGERIES").map_or(100_000, |count| count.parse().expect("a number"));
    let keys = keys();
    let mut ends = ends(&keys);
    let mut sent = acquainted(&mut ends, 0);
    for _ in 0..50 {
        for me in [0, 1] {
            let bytes = ends[me].datagram().unwrap();
            ends[1 - me].take(&bytes, 0).unwrap();
            sent.push((1 - me, bytes));
        }
    }
    let mut earlier = rig::ends(&keys);
    let mut own = rig::ends(&rig::keys());
    let sent = [sent, acquainted(&mut earlier, 0), acquainted(&mut own, 0)];
    let indices = ends.each_ref().map(|end| end.channel.sending().unwrap().index);
    let mut forger = Forger { random: fastrand::Rng::with_seed(3), sent, own, indices };
    let late = ends[0].datagram().unwrap();
    let (before, next) = (ends.each_ref().map(state), ends.each_ref().map(|end| end.counter));
    let (mut taken, mut reasons) = (0, BTreeMap::<String, u64>::new());
    for number in 0..count {
        let (to, bytes) = forger.datagram(number, next);
        // The forged datagram arrives while the cookies of the handshake are valid, or later.
        let outcome = ends[to].take(&bytes, forger.random.u64(..30_000) * MS);
        taken += usize::from(matches!(outcome, Ok(None)));
        let reason = outcome.map_or_else(|reason| format!("{reason:?}"), |_| "answered".into());
        *reasons.entry(reason).or_default() += 1;
        if number % 4_096 == 0 {
            assert_eq!(ends.each_ref().map(state), before, "datagram {number}");
        }
    }
    assert_eq!(taken, 0, "none was taken in");
    assert_eq!(ends.each_ref().map(state), before);
    println!("total: {count} forged datagrams, none taken in: {reasons:?}");
    for reason in ["Forged", "Mode", "Replayed", "OtherKeys", "StaleSession", "answered"] {
        assert!(reasons.contains_key(reason), "{reason} was not put to the test: {reasons:?}");
    }
    // The node accepts the genuine datagram that was held back all the time, and accepts it once.
    ends[1].take(&late, 15_000 * MS).unwrap();
    assert_eq!(ends[1].take(&late, 15_000 * MS), Err(LinkDiscard::Replayed));
}

#[test]
fn first_datagrams_that_were_damaged_do_not_say_that_keys_differ() {
    let mut ends = ends(&keys());
    for at in 0..20 {
        let at = at * 10_000 * MS;
        let mut hello = ends[0].knock(at).unwrap();
        // One bit of the digest of the declarations, or of the tag.
        let last = hello.len() - 1 - usize::from(at.is_multiple_of(3));
        hello[last] ^= 1;
        assert_eq!(ends[1].take(&hello, at), Err(LinkDiscard::OtherKeys));
        let hello = ends[0].knock(at + 5_000 * MS).unwrap();
        assert!(ends[1].take(&hello, at + 5_000 * MS).unwrap().is_some(), "the cookie");
    }
}

#[test]
fn other_cells_and_other_keys_are_refused_by_name_on_both_sides() {
    let refused = |a: &mut End, b: &mut End| {
        let hello = a.channel.knock(0).unwrap();
        let of = |end: &mut End, bytes: &[u8]| {
            let Ok(Keyed::Handshake(said)) = keyed::read(bytes) else { panic!("no handshake") };
            match end.channel.heard(bytes, &said, 0).unwrap() {
                Answer::Refused { why, here, reply, .. } => (why, here, reply),
                other => panic!("{other:?}"),
            }
        };
        let (why, here, reply) = of(b, &hello);
        let (there, not_here, none) = of(a, &reply.unwrap());
        assert!(here && !not_here && none.is_none() && there == why);
        why
    };
    let same = keys();
    for (digests, why) in [
        (Digests { cell: 9, ..DIGESTS }, Refused::OtherCell),
        (Digests { statements: 9, ..DIGESTS }, Refused::OtherStatements),
    ] {
        let (mut a, mut b) = (end(&same, 0, 1, DIGESTS), end(&same, 1, 2, digests));
        assert_eq!(refused(&mut a, &mut b), why);
    }
    let (mut a, mut b) = (end(&same, 0, 1, DIGESTS), end(&keys(), 1, 2, DIGESTS));
    for at in [0, 50 * MS] {
        let hello = a.knock(at).unwrap();
        assert_eq!(b.take(&hello, at), Err(LinkDiscard::OtherKeys), "it may have been damaged");
    }
    a.channel.ask_now();
    assert_eq!(refused(&mut a, &mut b), Refused::OtherKeys, "of the cell");
    // A node that has the cell's key but not the private key of a node of the cell gets no session either.
    let cell = draw_cell_key().unwrap();
    let lone = |me: usize| {
        let (private, _) = draw_node_keys().unwrap();
        let (_, public) = draw_node_keys().unwrap();
        NodeKeys::new(cell.clone(), private, BTreeMap::from([(ENDS[1 - me], public)]))
    };
    let strange = [lone(0), lone(1)];
    let (mut a, mut b) = (end(&strange, 0, 1, DIGESTS), end(&strange, 1, 2, DIGESTS));
    let hello = a.channel.knock(0).unwrap();
    let cookie = b.take(&hello, 0).unwrap().unwrap();
    let initiation = a.take(&cookie, 0).unwrap().unwrap();
    let refusal = b.take(&initiation, 0).unwrap().unwrap();
    assert!(matches!(keyed::read(&refusal), Ok(Keyed::Handshake(said)) if said.nonce == hello[16..32]));
    assert!(a.channel.sending().is_none() && b.channel.sending().is_none());
}
