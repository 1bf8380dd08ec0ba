//! Tests of the ticks of the scrub bar: which stops of the history show trouble, and how grave it is.

use crate::common::{BEAT, Stage, at, left, ms, snapshot};
use imrs_monitor::replay::Trouble;
use imrs_monitor::source::Feed;
use imrs_monitor::store::conformance::{Conformance, Verdict};
use imrs_monitor::theme::Theme;
use imrs_protocol::{Event, NodeId};
use imrs_wire::obs::{Bye, Goodbye, LinkView, Liveness, ServerFrame, Snapshot};

/// A second of ordinary traffic, in which a request times out in every period.
fn overloaded() -> Stage {
    let mut stage = Stage::cell(Theme::ASCII);
    go_on(&mut stage, 1_000, 2_000, |_, state| Some(state));
    stage
}

/// Ten periods a second: each node whose state `change` returns sends it, and a request of the left arm times out.
fn go_on(stage: &mut Stage, from: u64, to: u64, change: impl Fn(usize, Snapshot) -> Option<Snapshot>) {
    for moment in (from..to).step_by(100) {
        for node in 0..3 {
            let state = Snapshot { mono_us: 1_000 * (4_000 + moment), ..snapshot(node) };
            if let Some(state) = change(node, state) {
                stage.frame(ms(moment), node, ServerFrame::Snapshot(state));
            }
        }
        let late = [(4_000 + moment, left(Event::TimedOut, BEAT, 1, 7, 0))];
        stage.frame(ms(moment), 0, ServerFrame::Events(at(0, &late)));
    }
}

/// The moments of the stops with grave trouble, in milliseconds, and how many stops show slight trouble.
fn ticks(mut stage: Stage, now: u64) -> (Vec<u128>, usize) {
    stage.keys(ms(now), " [");
    let stops = stage.app.gone_back().expect("a history").film().stops();
    let of = |trouble: Trouble| stops.iter().filter(move |stop| stop.trouble == trouble);
    (of(Trouble::Grave).map(|stop| stop.at.as_millis()).collect(), of(Trouble::Slight).count())
}

#[test]
fn time_outs_are_slight_trouble() {
    assert_eq!(ticks(overloaded(), 2_000), (Vec::new(), 10));
}

#[test]
fn a_death_is_grave_trouble_and_an_orderly_stop_is_none() {
    let mut stage = overloaded();
    stage.lose(ms(2_050), 2);
    assert_eq!(ticks(stage, 2_100).0, [2_050]);
    let mut stage = overloaded();
    stage.frame(ms(2_040), 2, ServerFrame::Bye(Bye { reason: Goodbye::Stopping }));
    stage.lose(ms(2_050), 2);
    assert_eq!(ticks(stage, 2_100).0, []);
}

#[test]
fn a_crashed_task_a_silent_node_and_a_violation_are_grave_trouble_once() {
    let mut stage = overloaded();
    go_on(&mut stage, 2_000, 3_000, |node, mut state| {
        if node == 2 {
            state.tasks[0].liveness = Liveness::Crashed;
        }
        Some(state)
    });
    assert_eq!(ticks(stage, 3_000).0, [2_100], "seen at the next stop");
    let mut stage = overloaded();
    go_on(&mut stage, 2_000, 4_000, |node, state| (node != 2).then_some(state));
    let (grave, _) = ticks(stage, 4_000);
    assert!(matches!(grave[..], [2_800..=3_200]), "{grave:?}");
    let mut stage = overloaded();
    let violates = Verdict::Violates { step: 3, what: "another queue".into() };
    let said = Box::new(Conformance { verdict: violates, steps: 40 });
    let (cell, node) = ("beam-lift".to_owned(), "nl".to_owned());
    stage.feed(ms(2_000), 0, Feed::Judged { cell, node, incarnation: 1, said });
    go_on(&mut stage, 2_000, 3_000, |_, state| Some(state));
    assert_eq!(ticks(stage, 3_000).0, [2_000]);
}

#[test]
fn a_cut_link_is_grave_trouble_once_for_each_direction() {
    let mut stage = overloaded();
    for moment in (2_000..9_000_u64).step_by(100) {
        go_on(&mut stage, moment, moment + 100, |node, state| {
            // The left arm's node sends three packets a second, and from the third second on none arrives.
            let silent = if node == 1 { moment.saturating_sub(3_000) } else { 20 };
            let link = LinkView {
                peer: NodeId(u16::from(node == 0)),
                heard_us: Some(1_000 * silent),
                sent: 3 * moment / 1_000,
                received: 9,
            };
            Some(Snapshot { links: if node < 2 { vec![link] } else { Vec::new() }, ..state })
        });
    }
    let (grave, _) = ticks(stage, 9_000);
    assert!(matches!(grave[..], [5_000..=9_000]), "{grave:?}");
}

/// `}` goes from one grave trouble to the next, past all time-outs, and only behind the last one to a slight one.
#[test]
fn the_keys_prefer_grave_trouble() {
    let mut stage = overloaded();
    stage.lose(ms(2_050), 2);
    go_on(&mut stage, 2_100, 3_000, |node, state| (node != 2).then_some(state));
    stage.keys(ms(3_000), " [");
    let moment = |stage: &Stage| stage.app.gone_back().expect("in the past").moment();
    stage.keys(ms(3_000), "{");
    assert_eq!(moment(&stage), ms(2_050));
    stage.keys(ms(3_000), "{");
    assert_eq!(moment(&stage), ms(1_900), "there is only a time-out before it");
    stage.keys(ms(3_000), "}");
    assert_eq!(moment(&stage), ms(2_050));
    let bar = stage.text(ms(3_000), 120, 24);
    let bar = bar.lines().find(|line| line.contains("{ } trouble")).expect("a bar").to_owned();
    assert!(bar.contains(':') && bar.matches('!').count() <= 1, "{bar}");
}
