//! Two nodes with keys and a network between them, without sockets.

use super::*;
use crate::link::LinkDiscard;
use imrs_protocol::Incarnation;
use imrs_wire::envelope::keyed::{self, Keyed, MAX_KEYED_BYTES};
use imrs_wire::envelope::{COUNTER_END, Datagram, Digests, Envelope, Purpose, Refused, Session};

const DIGESTS: Digests = Digests { cell: 7, statements: 8 };
const ENDS: [NodeId; 2] = [NodeId(0), NodeId(1)];
const MS: u64 = 1_000;

/// One of the two nodes.
struct End {
    me: usize,
    channel: Channel,
    counter: u64,
    /// The counters that it opened, in order.
    opened: Vec<u64>,
}

/// The keys of both nodes of a cell.
fn keys() -> [NodeKeys; 2] {
    let cell = draw_cell_key().unwrap();
    let pairs = [0, 1].map(|_| draw_node_keys().unwrap());
    [0, 1].map(|me| {
        let publics = BTreeMap::from([(ENDS[1 - me], pairs[1 - me].1)]);
        NodeKeys::new(cell.clone(), pairs[me].0.clone(), publics)
    })
}

fn end(keys: &[NodeKeys; 2], me: usize, session: u64, digests: Digests) -> End {
    let ends = (ENDS[me], ENDS[1 - me]);
    let channel = Channel::new(&keys[me], ends, Session(session), digests, 3).unwrap().unwrap();
    End { me, channel, counter: 0, opened: Vec::new() }
}

fn ends(keys: &[NodeKeys; 2]) -> [End; 2] {
    [0, 1].map(|me| end(keys, me, 10 + me as u64, DIGESTS))
}

impl End {
    /// A datagram with one packet, if there is a session.
    fn datagram(&mut self) -> Option<Vec<u8>> {
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

    /// Takes a datagram in as the link does. Returns the answer.
    fn take(&mut self, bytes: &[u8], now: u64) -> Result<Option<Vec<u8>>, LinkDiscard> {
        match keyed::read(bytes)? {
            Keyed::Transport { index, counter, closed } => {
                let live = self.channel.find(index).cloned().ok_or(LinkDiscard::StaleSession)?;
                let mut room = [0; MAX_KEYED_BYTES];
                let opened = live.open(counter, closed, &mut room)?;
                assert_eq!((opened.envelope.sender, opened.packets), (ENDS[1 - self.me], &[[9; 32]][..]));
                self.channel.confirm(&live);
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

    fn knock(&mut self, now: u64) -> Option<Vec<u8>> {
        let wants = self.channel.wants(now, self.counter);
        wants.then(|| self.channel.knock(now)).flatten().map(|hello| hello.to_vec())
    }
}

/// Makes a session without any loss, asked for by the first end. Returns all datagrams.
fn acquainted(ends: &mut [End; 2], now: u64) -> Vec<(usize, Vec<u8>)> {
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

/// Some milliseconds of both nodes, with a network that loses, repeats and overtakes.
struct Net {
    random: fastrand::Rng,
    /// When, to whom, what.
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
        // Both ask at once, and each sends as soon as it can.
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
        // Just before a session is old, with a datagram each 2 ms.
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

/// All that a datagram might change.
fn state(end: &End) -> String {
    let Channel { sessions, making, tried, answered, .. } = &end.channel;
    let windows: Vec<_> = sessions.iter().map(|live| (live, live.state())).collect();
    format!("{windows:?} {:?} {tried:?} {} {:?}", making.is_some(), answered.len(), end.opened)
}

#[test]
fn a_forger_with_the_format_changes_nothing() {
    let count = std::env::var("IMRS_FORGERIES").ok().and_then(|count| count.parse().ok()).unwrap_or(100_000);
    let keys = keys();
    let mut ends = ends(&keys);
    let mut known = acquainted(&mut ends, 0);
    for _ in 0..50 {
        for me in [0, 1] {
            let bytes = ends[me].datagram().unwrap();
            ends[1 - me].take(&bytes, 0).unwrap();
            known.push((1 - me, bytes));
        }
    }
    // What the forger has of another cell, and of an earlier start of this one.
    let mut others = self::ends(&self::keys());
    let of_others = acquainted(&mut others, 0);
    let mut earlier = self::ends(&keys);
    let of_earlier = acquainted(&mut earlier, 0);
    let next = ends[0].datagram().unwrap();
    let before = ends.each_ref().map(state);
    let mut random = fastrand::Rng::with_seed(3);
    let now = 15_000 * MS;
    let mut taken = 0;
    for number in 0..count {
        let me = random.usize(..2);
        let of = match random.u8(..4) {
            0 => &of_others,
            1 => &of_earlier,
            _ => &known,
        };
        let (to, mut bytes) = of[random.usize(..of.len())].clone();
        let me = match number % 8 {
            // Repeated as it was, at whom it was for; reflected.
            0 => to,
            1 => 1 - to,
            // The next counter, and the last one there can be.
            2 | 3 => {
                let counter = if number % 8 == 2 { ends[1 - me].counter + 1 } else { COUNTER_END - 1 };
                bytes[8..15].copy_from_slice(&counter.to_le_bytes()[..7]);
                me
            }
            // Another kind, node or index; some bit; another length.
            4 => {
                bytes[random.usize(4..16)] = random.u8(..);
                me
            }
            5 | 6 => {
                let at = random.usize(..bytes.len());
                bytes[at] ^= 1 << random.u8(..8);
                me
            }
            _ => {
                bytes.truncate(random.usize(..bytes.len()));
                me
            }
        };
        taken += usize::from(ends[me].take(&bytes, now).is_ok_and(|reply| reply.is_none()));
    }
    assert_eq!(taken, 0, "none was taken in");
    assert_eq!(ends.each_ref().map(state), before);
    ends[1].take(&next, now).unwrap();
    assert_eq!(ends[1].take(&next, now), Err(LinkDiscard::Replayed));
}

#[test]
fn a_neighbour_that_starts_again_ends_its_earlier_session_and_no_old_one_comes_back() {
    let keys = keys();
    let mut ends = ends(&keys);
    acquainted(&mut ends, 0);
    let [old, late] = [0, 1].map(|_| ends[0].datagram().unwrap());
    ends[1].take(&old, MS).unwrap();
    // An attempt of the first start, whose answer is under way when it ends.
    let hello = ends[0].channel.knock(MS).unwrap();
    let cookie = ends[1].take(&hello, MS).unwrap().unwrap();
    let initiation = ends[0].take(&cookie, MS).unwrap().unwrap();
    ends[0] = end(&keys, 0, 77, DIGESTS);
    acquainted(&mut ends, 2 * MS);
    assert_eq!(ends[1].take(&late, 3 * MS), Err(LinkDiscard::StaleSession));
    let now = ends[1].channel.sending().unwrap().index;
    // Its answer comes to nothing: the first start is over, and the second has not asked for it.
    let response = ends[1].take(&initiation, 3 * MS).unwrap().unwrap();
    assert_eq!(ends[0].take(&response, 3 * MS), Err(LinkDiscard::StaleSession));
    assert_eq!(ends[1].channel.sending().unwrap().index, now);
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
    assert_eq!(refused(&mut a, &mut b), Refused::OtherKeys, "of the cell");
    // Who has the cell's key and not the node's gets no session either.
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
