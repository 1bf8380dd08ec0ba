//! Properties that hold for any bytes of the observation protocol. The fuzz target `obs` checks them, too.

use imrs_protocol::Reason;
use imrs_wire::obs::{
    ClientFrame, Count, Delta, FrameReader, Handshake, LinkView, MAX_FRAME, ServerFrame, Snapshot,
};
use serde::Serialize;

/// Decodes the bytes as every kind of frame, and as a stream of frames whose deltas are applied in order.
pub fn check(bytes: &[u8]) {
    server(bytes);
    if let Ok(frame) = ClientFrame::decode(bytes) {
        again(&frame, |bytes| ClientFrame::decode(bytes).expect("what was encoded"));
    }
    if let Ok((version, handshake)) = Handshake::decode(bytes) {
        let (_, decoded) = Handshake::decode(&handshake.encode(version)).expect("what was encoded");
        assert_eq!(decoded, handshake);
    }
    let mut reader = FrameReader::new(bytes, MAX_FRAME);
    let mut states = [Snapshot::default(), beginning()];
    while let Ok(frame) = reader.read_frame() {
        match server(frame) {
            Some(ServerFrame::Delta(delta)) => states.iter_mut().for_each(|state| change(state, &delta)),
            Some(ServerFrame::Snapshot(snapshot)) => {
                // There is a delta from any state to any other state.
                let [first, second] = &mut states;
                leads(first, &snapshot);
                *second = std::mem::replace(first, snapshot);
            }
            _ => {}
        }
    }
}

fn server(bytes: &[u8]) -> Option<ServerFrame> {
    let frame = ServerFrame::decode(bytes).ok()?;
    again(&frame, |bytes| ServerFrame::decode(bytes).expect("what was encoded"));
    let _ = (frame.since(), frame.costs());
    Some(frame)
}

/// Checks that encoding a value and decoding it gives the same value.
fn again<T: Serialize + PartialEq + std::fmt::Debug>(value: &T, decode: impl FnOnce(&[u8]) -> T) {
    let bytes = postcard::to_allocvec(value).expect("a value that can be encoded");
    assert_eq!(decode(&bytes), *value);
}

/// Applies a delta. An error leaves the state unchanged. Otherwise the delta that is computed between both states gives
/// the same state.
fn change(state: &mut Snapshot, delta: &Delta) {
    let before = state.clone();
    if state.apply(delta).is_err() {
        assert_eq!(*state, before);
        // The same delta is applied again, with this state as its base.
        let delta = Delta { base_us: delta.base_us.map(|_| state.mono_us), ..delta.clone() };
        if state.apply(&delta).is_err() {
            assert_eq!(*state, before);
        }
    }
    leads(&before, state);
}

fn leads(from: &Snapshot, to: &Snapshot) {
    for delta in [Delta::between(from, to), Delta::whole(to)] {
        let mut got = from.clone();
        assert_eq!(got.apply(&delta), Ok(()));
        assert_eq!(got, *to);
    }
}

/// A state with parts of every kind that a delta can change, except tasks.
fn beginning() -> Snapshot {
    let link = LinkView { peer: imrs_protocol::NodeId(1), heard_us: Some(9), sent: 2, received: 1 };
    let count = |reason: &Reason| Count { name: reason.name().into(), count: 1 };
    Snapshot {
        mono_us: 1_000,
        links: vec![link; 2],
        discards: Reason::ALL.iter().map(count).collect(),
        ..Snapshot::default()
    }
}
