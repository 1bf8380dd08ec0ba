//! Tests with hostile nodes: no frame makes the monitor panic, and no text of a frame reaches the terminal unescaped.

use crate::common::{Stage, events, identity, ms, observed, snapshot, table};
use imrs_monitor::report;
use imrs_monitor::source::Feed;
use imrs_monitor::theme::Theme;
use imrs_protocol::{Event, Incarnation, PortId};
use imrs_wire::obs::{NodeIdentity, ServerFrame};
use proptest::prelude::*;

/// A frame with some bytes changed; `None` if it cannot be decoded any more.
fn damaged(which: usize, damage: &[(usize, u8)]) -> Option<ServerFrame> {
    let list = [observed(Event::GaveUp, PortId(0), 2, 7), observed(Event::TimedOut, PortId(1), 1, 8)];
    let frame = match which {
        0 => ServerFrame::Table(table()),
        1 => ServerFrame::Events(events(0, &list)),
        node => ServerFrame::Snapshot(snapshot(node - 2)),
    };
    let mut bytes = postcard::to_allocvec(&frame).unwrap();
    for (at, value) in damage {
        let at = at % bytes.len();
        bytes[at] = *value;
    }
    ServerFrame::decode(&bytes).ok()
}

/// A damaged frame that a source sends: the source, the kind of frame, and the changed bytes with their positions.
type Sent = (usize, usize, Vec<(usize, u8)>);

fn frames() -> impl Strategy<Value = Vec<Sent>> {
    let damage = proptest::collection::vec((any::<usize>(), any::<u8>()), 0..4);
    proptest::collection::vec((0..3_usize, 0..5_usize, damage), 1..24)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn damaged_frames_are_borne(
        frames in frames(),
        ids in proptest::collection::vec((any::<u16>(), any::<u64>(), "\\PC{0,8}"), 3),
        keys in "[1236?jkhlgGsit/ae c]{0,12}",
        size in (0..90_u16, 0..30_u16),
    ) {
        let mut stage = Stage::new(Theme::COLOUR);
        for (source, (id, tick_us, build)) in ids.into_iter().enumerate() {
            let own = if source == 0 { source as u16 } else { id };
            let identity = NodeIdentity { id: own, tick_us, incarnation: Incarnation(1), ..identity(source, 1) };
            stage.feed(ms(900), source, Feed::Attached { identity, pid: 1, build });
            stage.frame(ms(900), source, ServerFrame::Table(table()));
        }
        for (i, (source, which, damage)) in frames.into_iter().enumerate() {
            if let Some(frame) = damaged(which, &damage) {
                stage.frame(ms(1_000 + i as u64), source, frame);
            }
        }
        stage.lose(ms(1_050), 1);
        let now = ms(1_100);
        for key in keys.chars() {
            stage.keys(now, &key.to_string());
            let drawn = stage.text(now, size.0, size.1);
            prop_assert!(drawn.chars().all(|c| c == '\n' || !c.is_control()));
        }
        let text = report::text(stage.app.live(), None, now);
        prop_assert!(text.chars().all(|c| c == '\n' || !c.is_control()));
        let json = report::json(stage.app.live(), None, now);
        prop_assert!(serde_json::from_str::<serde_json::Value>(&json).is_ok());
    }
}
