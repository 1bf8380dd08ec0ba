//! Properties that hold for any bytes of mode 1 of the envelope. The fuzz target `keyed` checks them, too.

use imrs_protocol::NodeId;
use imrs_wire::envelope::keyed::{self, Bound, HandshakeBytes, Keyed, MAX_KEYED_BYTES, TAG_BYTES};
use imrs_wire::envelope::{COUNTER_END, Datagram, Digests, Session};

const BOUND: Bound = Bound {
    digests: Digests { cell: 1, statements: 2 },
    sender: (NodeId(3), Session(4)),
    receiver: (NodeId(5), Session(6)),
};
const COUNTER: u64 = 7;

/// Decodes the bytes as a datagram, and as the decrypted bytes of a session. Encoding the decoded value gives the same
/// bytes again.
pub fn check(bytes: &[u8]) {
    match keyed::read(bytes) {
        Ok(Keyed::Transport { index, counter, closed }) => {
            assert!(bytes.len() <= MAX_KEYED_BYTES && counter < COUNTER_END);
            assert_eq!((&bytes[4..8], closed), (&index.to_le_bytes()[..], &bytes[keyed::CLEAR_BYTES..]));
            assert_eq!(bytes[8..15], counter.to_le_bytes()[..7]);
        }
        Ok(Keyed::Handshake(said)) => {
            let (_, hash) = bytes.split_last_chunk::<TAG_BYTES>().expect("it is closed");
            assert_eq!(&*HandshakeBytes::new(&said, |_| *hash), bytes);
        }
        Err(_) => {}
    }
    content(bytes);
}

fn content(plain: &[u8]) {
    let Ok(opened) = keyed::open(plain, COUNTER, &BOUND) else { return };
    assert_eq!((opened.envelope.sender, opened.envelope.receiver), (BOUND.sender.0, BOUND.receiver.0));
    let mut datagram = Datagram::default();
    opened.packets.iter().for_each(|packet| assert!(datagram.push(packet)));
    let copied = datagram.seal_keyed(&opened.envelope, 9, |plain, closed| {
        closed[..plain.len()].copy_from_slice(plain);
        Ok::<_, ()>(closed.len())
    });
    let again = copied.expect("it is copied")[keyed::CLEAR_BYTES..].to_vec();
    let again = &again[..again.len() - TAG_BYTES];
    // Some bytes have no meaning in some datagrams, so this compares the values of a second decoding.
    let second = keyed::open(again, COUNTER, &BOUND).expect("what was encoded");
    assert_eq!((second.envelope, second.packets), (opened.envelope, opened.packets));
}
