//! One frame of every kind that versions 1.2 to 1.4 of the observation protocol added.

use imrs_protocol::{NodeId, TaskId, Ticks};
use imrs_wire::obs::{
    Challenge, ClientFrame, Delays, HeldBack, HeldTask, Integrity, LinkReport, LinkReports, Proof,
    ServerFrame,
};

/// Every kind of frame that version 1.2 added.
pub fn samples_1_2() -> Vec<(&'static str, Vec<u8>)> {
    let tasks = vec![
        HeldTask { task: TaskId(1), remaining: Ticks(61_400_000) },
        HeldTask { task: TaskId(513), remaining: Ticks(0) },
    ];
    let held = ServerFrame::HeldBack(HeldBack { mono_us: 300, tasks });
    let none = ServerFrame::HeldBack(HeldBack { mono_us: 301, tasks: Vec::new() });
    let bytes = |frame: &ServerFrame| postcard::to_allocvec(frame).unwrap();
    vec![("held_back", bytes(&held)), ("held_back_none", bytes(&none))]
}

/// Every kind of frame that version 1.3 added.
pub fn samples_1_3() -> Vec<(&'static str, Vec<u8>)> {
    let challenge = ServerFrame::Challenge(Challenge([7; 32]));
    let proof = ClientFrame::Proof(Proof([9; 32]));
    vec![
        ("challenge", postcard::to_allocvec(&challenge).unwrap()),
        ("proof", postcard::to_allocvec(&proof).unwrap()),
    ]
}

/// Every kind of frame that version 1.4 added.
pub fn samples_1_4() -> Vec<(&'static str, Vec<u8>)> {
    let delays = |count| Delays { count, late: 3, p50_us: 180, p99_us: 1_900, max_us: 70_000 };
    let link = |peer, integrity| LinkReport {
        peer: NodeId(peer),
        delay: delays(812_000),
        recent: delays(4_000),
        recent_us: 7_200_000,
        unmeasured: 41,
        integrity,
        has_stopped: peer == 2,
    };
    let faulty = Integrity { failures: 300, is_faulty: true, faults: 2, unmatched: 1 };
    let links = vec![link(1, Integrity::default()), link(2, faulty)];
    let frame = ServerFrame::Links(LinkReports { mono_us: 77, links });
    vec![("links", postcard::to_allocvec(&frame).unwrap())]
}
