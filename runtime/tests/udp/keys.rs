//! Links with keys on real sockets.

use super::rig::{
    A, B, C, Memory, any_port, digests, encoded, envelope, introduced, link, packet, raw_socket, sealed,
    table,
};
use super::sessions::{drive, taken_on_its_way};
use imrs_protocol::Incarnation;
use imrs_runtime::link::udp::keys::{NodeKeys, draw_cell_key, draw_node_keys};
use imrs_runtime::link::udp::{UdpCount, UdpError, UdpLink, UdpOptions};
use imrs_runtime::link::{Link, LinkDiscard};
use imrs_wire::envelope::Refused;
use imrs_wire::envelope::keyed::{self, Keyed};
use std::collections::BTreeMap;

/// The keys of the three nodes of a cell.
pub fn keys() -> [NodeKeys; 3] {
    let cell = draw_cell_key().unwrap();
    let pairs = [A, B, C].map(|node| (node, draw_node_keys().unwrap()));
    let publics: BTreeMap<_, _> = pairs.iter().map(|(node, (_, public))| (*node, *public)).collect();
    pairs.each_ref().map(|(_, (private, _))| NodeKeys::new(cell.clone(), private.clone(), publics.clone()))
}

pub fn pair(keys: &[NodeKeys; 3]) -> (UdpLink, UdpLink) {
    introduced(link(A).with_keys(&keys[0]).unwrap(), link(B).with_keys(&keys[1]).unwrap())
}

/// Sends packets as a node does: as soon as the link takes them. Returns once all packets have arrived.
pub fn carried(from: &UdpLink, to: &UdpLink, numbers: std::ops::Range<u32>) -> Memory {
    let (at_from, at_to) = (Memory::default(), Memory::default());
    let packets: Vec<_> = numbers.map(packet).collect();
    let mut left = &packets[..];
    drive(&[(from, &at_from), (to, &at_to)], || {
        if !left.is_empty()
            && from.ready(B)
            && let Ok(taken) = from.send(B, left)
        {
            left = &left[taken..];
        }
        at_to.delivered() == packets.len()
    });
    at_to
}

#[test]
fn packets_wait_for_a_session_and_then_come_in_order() {
    let (a, b) = pair(&keys());
    assert!(a.has_keys() && !a.ready(B) && a.send(B, &[packet(1)]).is_err(), "no session yet");
    // These are more packets than one call takes, so that the kernel cuts and merges datagrams.
    let at_b = carried(&a, &b, 1..400);
    let got = at_b.packets.lock().unwrap();
    let ids: Vec<_> = got.iter().map(|(from, packet, _)| (*from, packet.id)).collect();
    assert_eq!(ids, (1..400).map(|number| (A, packet(number).id)).collect::<Vec<_>>());
    assert_eq!(*at_b.peers.lock().unwrap(), [(A, Incarnation(1), false)]);
    assert!(at_b.discards.lock().unwrap().is_empty());
    assert!(a.count(UdpCount::SessionsMade) + b.count(UdpCount::SessionsMade) >= 1);
}

#[test]
fn a_packet_is_not_to_be_seen_and_a_repeated_or_plain_datagram_is_dropped() {
    let (a, b) = pair(&keys());
    carried(&a, &b, 1..2);
    let bytes = taken_on_its_way(&a, &b, packet(2));
    // The first 16 bytes are in clear. This search leaves them out, because their counter has zeros, and an empty part
    // of the packet has zeros, too.
    assert!(!bytes[16..].windows(8).any(|seen| encoded(2).windows(8).any(|sent| sent == seen)));
    let (at_b, forger) = (Memory::default(), raw_socket());
    let throw = |bytes: &[u8]| forger.send_to(bytes, b.local_address()).unwrap();
    let mut changed = bytes.clone();
    changed[40] ^= 1;
    throw(&changed);
    throw(&bytes);
    throw(&bytes);
    throw(&sealed(&envelope(1 << 40), &[encoded(9)]));
    let discards = at_b.take_discards(&b, 3);
    assert_eq!(discards, [LinkDiscard::Forged, LinkDiscard::Replayed, LinkDiscard::Mode]);
    assert_eq!(at_b.delivered(), 1, "the genuine one, over a detour");
    assert_eq!(carried(&a, &b, 3..4).delivered(), 1);
    assert!(b.refusals().is_empty(), "{:?}", b.refusals());
}

#[test]
fn a_node_that_starts_again_is_heard() {
    let keys = keys();
    let (a, b) = pair(&keys);
    carried(&a, &b, 1..5);
    let old = taken_on_its_way(&a, &b, packet(5));
    drop(a);
    // The new link has the same incarnation, as if the node had lost its state.
    let a = link(A).with_keys(&keys[0]).unwrap();
    let (a, b) = introduced(a, b);
    a.greet();
    let at_b = carried(&a, &b, 1..5);
    assert_eq!(*at_b.peers.lock().unwrap(), [(A, Incarnation(1), true)]);
    raw_socket().send_to(&old, b.local_address()).unwrap();
    assert_eq!(at_b.take_discards(&b, 1), [LinkDiscard::StaleSession]);
}

/// The neighbour sends in the session with the node's earlier start until it gets a datagram in the new session.
#[test]
fn a_node_that_only_listens_is_spoken_to_though_its_first_greeting_was_lost() {
    let keys = keys();
    let (a, b) = pair(&keys);
    carried(&a, &b, 1..2);
    drop(b);
    let (b, between) = (link(B).with_keys(&keys[1]).unwrap(), raw_socket());
    between.set_nonblocking(true).unwrap();
    a.set_address(B, Some(b.local_address())).unwrap();
    b.set_address(A, Some(between.local_addr().unwrap())).unwrap();
    b.greet();
    let (at_a, at_b, mut lost, mut number) = (Memory::default(), Memory::default(), 0, 1);
    drive(&[(&a, &at_a), (&b, &at_b)], || {
        let mut bytes = [0; 2_000];
        while let Ok(length) = between.recv(&mut bytes) {
            let bytes = &bytes[..length];
            if lost == 0 && matches!(keyed::read(bytes), Ok(Keyed::Transport { .. })) {
                lost += 1;
            } else {
                between.send_to(bytes, a.local_address()).unwrap();
            }
        }
        number += 1;
        // No socket was bound to the address for a moment, so this send may fail.
        let _ = a.send(B, &[packet(number)]);
        at_b.delivered() > 0
    });
    assert_eq!(lost, 1);
    assert_eq!(*at_a.peers.lock().unwrap(), [(B, Incarnation(1), true)]);
}

#[test]
fn nodes_with_other_keys_or_none_say_so_on_both_sides() {
    let with = |node, keys: Option<&NodeKeys>| match keys {
        Some(keys) => link(node).with_keys(keys).unwrap(),
        None => link(node),
    };
    let (one, other) = (keys(), keys());
    for (of_b, why) in [(Some(&other[1]), Refused::OtherKeys), (None, Refused::OtherMode)] {
        let (a, b) = introduced(with(A, Some(&one[0])), with(B, of_b));
        let (at_a, at_b) = (Memory::default(), Memory::default());
        drive(&[(&a, &at_a), (&b, &at_b)], || {
            a.greet();
            b.greet();
            [&a, &b]
                .iter()
                .all(|link| link.refusals().iter().any(|refusal| refusal.why == why && refusal.here))
        });
        assert!(!a.ready(B) && at_a.delivered() + at_b.delivered() == 0);
        assert_eq!(a.digests(), digests());
    }
}

#[test]
fn a_node_without_the_key_of_a_neighbour_does_not_start() {
    let (private, public) = draw_node_keys().unwrap();
    let keys = NodeKeys::new(draw_cell_key().unwrap(), private, BTreeMap::from([(B, public)]));
    let link = UdpLink::bind(table(A), any_port(), UdpOptions::new(Incarnation(1), false)).unwrap();
    assert!(matches!(link.with_keys(&keys), Err(UdpError::NoKey(node)) if node == C));
    assert!(keys.has(B) && !format!("{keys:?}").contains("private"));
}
