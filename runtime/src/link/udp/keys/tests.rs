//! Sessions between two nodes: under loss, at renewals, after restarts, and with other keys.

use super::rig::{DIGESTS, ENDS, End, MS, acquainted, end, ends, keys};
use super::*;
use crate::link::LinkDiscard;
use imrs_wire::envelope::keyed::{self, Keyed};
use imrs_wire::envelope::{Digests, Refused};

/// Runs two nodes for some milliseconds, with a network that loses, repeats and reorders datagrams.
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
        // This round begins just before a session becomes too old; a datagram is sent every 2 ms.
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
        let is_new = |live: &Arc<Live>| !live.is_old(4 * 3_600_000 * MS + 1_000 * MS, 0, live::REPLACE_AFTER);
        assert!(ends[me].channel.sending().is_some_and(is_new));
    }
}

#[test]
fn first_datagrams_that_were_damaged_do_not_say_that_keys_differ() {
    let mut ends = ends(&keys());
    for at in 0..20 {
        let at = at * 10_000 * MS;
        let mut hello = ends[0].knock(at).unwrap();
        // Flips one bit: of the digest of the declarations, or of the authentication tag.
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
    a.channel.tried = None;
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
