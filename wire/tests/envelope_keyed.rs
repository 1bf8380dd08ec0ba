//! Tests of mode 1 of the envelope: golden bytes, round trips, and datagrams that must be rejected.

use crate::support::keyed::check;
use imrs_protocol::{Incarnation, NodeId};
use imrs_wire::envelope::keyed::{self, Bound, Handshake, HandshakeBytes, Keyed, MAX_KEYED_BYTES, Step};
use imrs_wire::envelope::{
    Datagram, Digests, Echo, Envelope, EnvelopeError, Greeting, MAX_PACKETS, Purpose, Session, VERSION,
};
use proptest::prelude::*;

const BOUND: Bound = Bound {
    digests: Digests { cell: 0xdead_beef, statements: 0x0bad_cafe },
    sender: (NodeId(0x0102), Session(0x2122)),
    receiver: (NodeId(0x0304), Session(0x3132)),
};

fn envelope(purpose: Purpose) -> Envelope {
    Envelope {
        sender: BOUND.sender.0,
        receiver: BOUND.receiver.0,
        incarnation: Incarnation(7),
        restarted: true,
        session: BOUND.sender.1,
        counter: 0x11_2233_4455_6677,
        tx_mono: 0x0102_0304_0506_0708,
        echo: Some(Echo { session: BOUND.receiver.1, mono: 0x1112_1314_1516_1718 }),
        purpose,
    }
}

/// The bytes of a datagram from a session that copies the bytes instead of encrypting them.
fn sealed(envelope: &Envelope, packets: usize) -> Vec<u8> {
    let mut datagram = Datagram::default();
    (0..packets).for_each(|_| assert!(datagram.push(&[6; 32])));
    let copied = datagram.seal_keyed(envelope, 0x4142_4344, |plain, closed| {
        closed[..plain.len()].copy_from_slice(plain);
        closed[plain.len()..].fill(0xee);
        Ok::<_, ()>(closed.len())
    });
    copied.unwrap().to_vec()
}

#[test]
fn the_layout_of_a_transport_datagram_is_the_documented_one() {
    let bytes = sealed(&envelope(Purpose::Packets), 1);
    #[rustfmt::skip]
    let head = [
        0x9d, 0x4d, 2, 1,
        0x44, 0x43, 0x42, 0x41,
        0x77, 0x66, 0x55, 0x44, 0x33, 0x22, 0x11, 0,
        0b0000_1100, 1, 7, 0,
        0x08, 0x07, 0x06, 0x05, 0x04, 0x03, 0x02, 0x01,
        0x18, 0x17, 0x16, 0x15, 0x14, 0x13, 0x12, 0x11,
    ];
    assert_eq!(bytes[..36], head);
    assert_eq!((&bytes[36..68], &bytes[68..]), (&[6; 32][..], &[0xee; 16][..]));
    assert_eq!(sealed(&envelope(Purpose::Packets), MAX_PACKETS).len(), MAX_KEYED_BYTES);
}

#[test]
fn the_layout_of_a_handshake_is_the_documented_one() {
    let step = |step| {
        let of = Handshake { sender: NodeId(0x0102), receiver: NodeId(0x0304), nonce: [5; 16], step };
        HandshakeBytes::new(&of, |bytes| [u8::try_from(bytes.len()).unwrap(); 16]).to_vec()
    };
    let noise = &[8; 56];
    let expected = |kind: u8, body: &[u8]| {
        let length = u8::try_from(32 + body.len()).unwrap();
        let head = [0x9d, 0x4d, 2, 1, 2, 1, 4, 3, 0, 0, 0, 0, 0, 0, 0, kind];
        [&head[..], &[5; 16], body, &[length; 16]].concat()
    };
    let digests = [0xef, 0xbe, 0xad, 0xde, 0xfe, 0xca, 0xad, 0x0b];
    assert_eq!(step(Step::Hello(BOUND.digests)), expected(1, &digests));
    assert_eq!(step(Step::Cookie([3; 16])), expected(2, &[3; 16]));
    let initiation = Step::Initiation { cookie: [3; 16], index: 0x41, noise };
    assert_eq!(step(initiation), expected(3, &[&[3; 16][..], &[0x41, 0, 0, 0], noise].concat()));
    let response = Step::Response { initiator: 0x41, responder: 0x42, noise };
    assert_eq!(step(response), expected(4, &[&[0x41, 0, 0, 0, 0x42, 0, 0, 0][..], noise].concat()));
    let refusal = Step::Refusal { digests: BOUND.digests, reason: 3 };
    assert_eq!(step(refusal), expected(5, &[&digests[..], &[3]].concat()));
    for of in [Step::Hello(BOUND.digests), Step::Cookie([3; 16]), initiation, response, refusal] {
        let bytes = step(of);
        assert!(
            matches!(keyed::read(&bytes), Ok(Keyed::Handshake(said)) if said.step == of && said.nonce == [5; 16])
        );
        for length in 0..bytes.len() {
            assert!(keyed::read(&bytes[..length]).is_err(), "{length} bytes");
        }
    }
}

#[test]
fn other_versions_and_modes_are_told_by_name() {
    let bytes = sealed(&envelope(Purpose::Packets), 1);
    let with = |at: usize, byte: u8| {
        let mut bytes = bytes.clone();
        bytes[at] = byte;
        keyed::read(&bytes).err()
    };
    assert_eq!(with(0, 0), Some(EnvelopeError::NotImrs));
    assert_eq!(with(2, 9), Some(EnvelopeError::Version(9)));
    assert_eq!(with(3, 0), Some(EnvelopeError::Mode(0)));
    assert_eq!(with(15, 6), Some(EnvelopeError::Purpose(6)));
}

/// Bytes that begin like a datagram of mode 1, of any kind. In most cases they also have the length of a valid
/// datagram.
fn beginnings() -> impl Strategy<Value = Vec<u8>> {
    let lengths = prop_oneof![
        Just(72_usize),
        Just(104),
        Just(56),
        Just(64),
        Just(124),
        Just(112),
        Just(57),
        0..200_usize
    ];
    (lengths, 0..7_u8, proptest::collection::vec(any::<u8>(), 200)).prop_map(|(length, kind, mut bytes)| {
        bytes[..4].copy_from_slice(&[0x9d, 0x4d, VERSION, 1]);
        bytes[15] = kind;
        if kind > 0 {
            bytes[8..15].fill(0);
        }
        bytes.truncate(length);
        bytes
    })
}

proptest! {
    #[test]
    fn what_any_bytes_decode_to_is_encoded_alike(bytes in beginnings(), plain in proptest::collection::vec(any::<u8>(), 0..120)) {
        check(&bytes);
        check(&plain);
        // The content of the datagram begins behind its 16 bytes in clear.
        check(bytes.get(16..bytes.len().saturating_sub(16)).unwrap_or_default());
    }

    #[test]
    fn what_is_sealed_is_read(
        packets in 0..=MAX_PACKETS, remembers in any::<Option<u8>>(), wants_answer: bool, has_echo: bool,
    ) {
        let greeting = Greeting { wants_answer, uncounted: false, remembers: remembers.map(Incarnation) };
        let purpose = if packets == 0 { Purpose::Greeting(greeting) } else { Purpose::Packets };
        let mut sent = envelope(purpose);
        sent.echo = sent.echo.filter(|_| has_echo);
        let bytes = sealed(&sent, packets);
        let Ok(Keyed::Transport { index, counter, closed }) = keyed::read(&bytes) else { panic!("no transport") };
        prop_assert_eq!((index, counter), (0x4142_4344, sent.counter));
        let opened = keyed::open(&closed[..closed.len() - 16], counter, &BOUND).unwrap();
        prop_assert_eq!((opened.envelope, opened.packets.len(), opened.digests), (sent, packets, BOUND.digests));
    }

    #[test]
    fn any_bytes_are_survived(mut bytes in proptest::collection::vec(any::<u8>(), 0..1_600), kind in 0..7_u8) {
        let _ = keyed::open(&bytes, 1, &BOUND);
        if bytes.len() > 16 {
            bytes[..4].copy_from_slice(&[0x9d, 0x4d, 2, 1]);
            bytes[8..15].fill(0);
            bytes[15] = kind;
        }
        if let Ok(Keyed::Transport { closed, .. }) = keyed::read(&bytes) {
            prop_assert_eq!(closed.len() % 32, (20 + 16) % 32);
        }
    }
}
