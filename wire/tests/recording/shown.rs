//! Tests of the frames in a recording: golden bytes, and versions that are refused.

use imrs_protocol::TaskId;
use imrs_wire::obs::{DecodeError, Hello, Refusal, Role, SCHEMA, ServerFrame, Table, VERSION, Version};
use imrs_wire::recording::{Doing, Place, Shown, ShownError, Step, Story};
use proptest::prelude::*;

fn hello(schema: u32) -> Hello {
    Hello { schema, pid: 7, build: "imrs 1".into(), mono_us: 9, role: Role::Monitor }
}

/// The schema digest of the observation protocol in the programs that were released with its version 1.0.
const SCHEMA_1_0: u32 = 0x3723_afbb;

/// One value of each variant of [`Shown`].
fn every() -> [Shown; 5] {
    let place = Some(Place { line: 3, column: 4, text: "send a;".into() });
    let story = Story {
        file: "a.cell".into(),
        kind: "deadlock".into(),
        cause: "they wait".into(),
        place,
        bounds: "Without faults".into(),
        tick_us: 1_000,
        steps: 2,
    };
    let doing = Doing { task: TaskId(1), text: "waits".into(), line: Some(12) };
    let step = Step { number: 1, tick: 300, odd: true, happened: vec!["x".into()], tasks: vec![doing] };
    [
        Shown::Attached { version: Version { major: 1, minor: 0 }, hello: hello(SCHEMA_1_0) },
        Shown::Said(ServerFrame::Table(Table::default())),
        Shown::Lost { why: "gone".into() },
        Shown::Story(story),
        Shown::Step(step),
    ]
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Frames that were written once must stay readable for ever.
#[test]
fn each_kind_is_these_bytes() {
    let golden = [
        "000100bbdf8eb9030706696d727320310901",
        "0100000000000000",
        "0204676f6e65",
        "0306612e63656c6c08646561646c6f636b097468657920776169740103040773656e6420613b0e576974686f7574206661756c7473e80702",
        "0401ac02010101780101057761697473010c",
    ];
    for (shown, golden) in every().into_iter().zip(golden) {
        assert_eq!(hex(&shown.encode()), golden);
        assert_eq!(Shown::decode(&shown.encode()), Ok(shown));
    }
}

#[test]
fn other_versions_are_refused_by_their_names() {
    let of = |version, schema| Shown::decode(&Shown::Attached { version, hello: hello(schema) }.encode());
    let newer = Version { major: 2, minor: 0 };
    let refused = of(newer, SCHEMA);
    assert_eq!(refused, Err(ShownError::Refused(Refusal::OtherMajor { node: newer, monitor: VERSION })));
    assert!(matches!(of(VERSION, 1), Err(ShownError::Refused(Refusal::OtherSchema { node: 1, .. }))));
    // A later version may change everything but the version number at the start of its hello.
    let strange = [0, 9, 0, 1, 255, 255];
    assert!(matches!(Shown::decode(&strange), Err(ShownError::Refused(Refusal::OtherMajor { .. }))));
    assert_eq!(Shown::decode(&[9]), Err(ShownError::Decode(DecodeError::UnknownKind(9))));
}

proptest! {
    #[test]
    fn any_bytes_are_a_value_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        if let Ok(shown) = Shown::decode(&bytes) {
            prop_assert_eq!(Shown::decode(&shown.encode()), Ok(shown));
        }
    }
}
