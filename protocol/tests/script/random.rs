//! Tests that no program and no input panics, that every state comes back from its packed form, and that a shift of ids
//! changes nothing.

use super::fake::*;
use super::written::{inputs, programs, well_formed};
use imrs_protocol::script::*;
use imrs_protocol::*;
use proptest::collection::vec;
use proptest::prelude::*;

/// An answer to the wait of the script, if the script waits. With such answers runs reach many states. `pick` chooses among
/// the possible answers.
pub fn answer(rig: &Rig, pick: u8) -> Option<ScriptInput> {
    let signal = match rig.script.activity() {
        Activity::Acts => {
            return Some(ScriptInput::Acted {
                level: rig.script.depth(),
                ok: pick.is_multiple_of(2),
                value: i32::from(pick),
            });
        }
        Activity::Chooses(among) => return Some(ScriptInput::Chosen(u16::from(pick) % among)),
        Activity::NotBegun | Activity::Passive | Activity::Ended(_) => return None,
        Activity::Waits => match rig.said.requests.last()? {
            Request::Get { .. } if pick.is_multiple_of(3) => Signal::Nothing,
            Request::Get { port, .. } => {
                Signal::Message(message(port.unwrap_or(TELL), Class::Command, u32::from(pick), &[pick & 1]))
            }
            Request::Send { .. } if pick.is_multiple_of(2) => replied(&[pick & 1]),
            Request::Send { .. } => Signal::Outcome(Outcome::TimedOutUnknown),
            Request::Arrive { port, .. } => {
                Signal::Released { port: *port, round: Round(1), by: ReleasedBy::AllArrived }
            }
            Request::Delay { id, .. } => Signal::TimeOut(*id),
            Request::Abandon => Signal::Cancelled,
            Request::Lease => Signal::Granted(1),
            Request::Part { .. }
            | Request::Reply { .. }
            | Request::Order(_)
            | Request::Handle { .. }
            | Request::Start { .. }
            | Request::Stop { .. }
            | Request::Boundary
            | Request::Work
            | Request::Done
            | Request::Return
            | Request::Atomic(_)
            | Request::Publish(_)
            | Request::End
            | Request::Cancel => Signal::Accepted(1),
        },
    };
    Some(ScriptInput::Signal(signal))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 3000, failure_persistence: None, ..ProptestConfig::default() })]

    /// The programs may be malformed and the inputs senseless. [`Rig::step`] packs and unpacks every state.
    #[test]
    fn no_program_and_no_input_panics(program in programs(), inputs in vec((any::<u8>(), inputs()), 1..60)) {
        let _ = program.check();
        let mut rig = Rig::of(program);
        rig.begin();
        for (pick, input) in inputs {
            let input = if pick.is_multiple_of(4) { input } else { answer(&rig, pick).unwrap_or(input) };
            rig.step(input);
            if let Activity::Ended(end) = rig.script.activity() {
                rig.step(input);
                prop_assert_eq!(rig.script.activity(), Activity::Ended(end), "an end is one");
            }
        }
    }

    /// A program that passes its check never turns out to be malformed, whatever signals its communication task gives.
    #[test]
    fn a_checked_program_is_well_formed(
        program in prop_oneof![well_formed(), programs()],
        inputs in vec((any::<u8>(), inputs()), 1..60),
    ) {
        if program.check().is_err() {
            return Ok(());
        }
        let mut rig = Rig::of(program);
        rig.begin();
        for (pick, input) in inputs {
            rig.step(answer(&rig, pick).unwrap_or(input));
            let malformed = matches!(
                rig.script.activity(),
                Activity::Ended(End::Fault { fault: ScriptFault::Malformed, .. })
            );
            prop_assert!(!malformed, "{:?}", rig.script);
        }
    }

    /// A shift of all ids of a source changes no packed bytes, and any bytes are loaded without a panic (D51).
    #[test]
    fn packed_states_are_relative_and_total(
        program in programs(),
        inputs in vec((any::<u8>(), inputs()), 1..40),
        by: u32,
        bytes in vec(any::<u8>(), 0..80),
    ) {
        struct Shift(u32);
        impl Walk for Shift {
            const PASS: Pass = Pass::Change;

            fn sequence(&mut self, _: TaskId, sequence: &mut Seq24) {
                *sequence = sequence.plus(self.0);
            }
        }
        let mut rig = Rig::of(program);
        rig.begin();
        for (pick, input) in inputs {
            rig.step(answer(&rig, pick).unwrap_or(input));
        }
        let plain = same_when_packed(&rig.program, &rig.script);
        let mut shifted = rig.script.clone();
        shifted.walk(&rig.program, &mut Shift(by));
        let frame = Frame { rounds: &[], sequences: &[Frame::SEQUENCE.plus(by); 16], incarnations: true };
        prop_assert_eq!(Encode::bytes(&frame, |w| shifted.walk(&rig.program, w)), Ok(plain));
        Decode::read(&bytes, true, |r| rig.script.walk(&rig.program, r));
        for input in [ScriptInput::Signal(Signal::Accepted(1)), ScriptInput::Chosen(0), ScriptInput::Begin] {
            rig.script.step(&rig.program, &rig.code, &input, &mut Requests::default(), &mut rig.said);
        }
    }
}

/// Accepts boundaries until the script makes another request. Returns all other effects in words. Stops a script that never
/// waits, as a node does.
fn past_boundaries(rig: &mut Rig, mut said: Vec<String>) -> Vec<String> {
    let mut all = Vec::new();
    for _ in 0..STEP_LIMIT {
        let boundary = said.last().is_some_and(|last| last == "boundary");
        all.extend(said.into_iter().filter(|words| words != "boundary"));
        if !boundary {
            return all;
        }
        said = rig.accept();
    }
    rig.script.stop(&rig.program, ScriptFault::Runaway, &mut Requests::default(), &mut rig.said);
    std::mem::take(&mut rig.said.words)
}

/// Whether a script was stopped because it never waited.
fn ran_away(rig: &Rig) -> bool {
    matches!(rig.script.activity(), Activity::Ended(End::Fault { fault: ScriptFault::Runaway, .. }))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, failure_persistence: None, ..ProptestConfig::default() })]

    /// If no boundary calls a handler, the number of boundaries does not matter (D45).
    #[test]
    fn fused_statements_reach_the_same_states(program in well_formed(), inputs in vec((any::<u8>(), inputs()), 1..60)) {
        let rig = |fusing| Rig::of(Program { fusing, ..program.clone() });
        let (mut fused, mut every) = (rig(Fusing::Fused), rig(Fusing::EveryStatement));
        let (one, other) = (fused.begin(), every.begin());
        let (one, other) = (past_boundaries(&mut fused, one), past_boundaries(&mut every, other));
        prop_assert!(one == other || (ran_away(&fused) && ran_away(&every)));
        for (pick, input) in inputs {
            let input = if pick.is_multiple_of(4) { input } else { answer(&fused, pick).unwrap_or(input) };
            let (one, other) = (fused.step(input), every.step(input));
            let (one, other) = (past_boundaries(&mut fused, one), past_boundaries(&mut every, other));
            if ran_away(&fused) {
                prop_assert!(ran_away(&every));
                return Ok(());
            }
            prop_assert_eq!(one, other);
            prop_assert_eq!(&fused.script, &every.script);
        }
    }
}

/// Tests that the random runs reach many states, because otherwise they would prove little.
#[test]
fn random_programs_reach_what_they_are_for() {
    use proptest::strategy::ValueTree;
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let mut seen = std::collections::BTreeMap::<String, u32>::new();
    for _ in 0..3000 {
        let program = programs().new_tree(&mut runner).expect("a program").current();
        let checked = program.check().is_ok();
        *seen.entry(format!("checked {checked}")).or_default() += 1;
        let mut rig = Rig::of(program);
        let mut said = rig.begin();
        for _ in 0..40 {
            let (pick, input) = (any::<u8>(), inputs()).new_tree(&mut runner).expect("an input").current();
            for words in said.drain(..) {
                *seen.entry(words.split(' ').next().expect("a word").into()).or_default() += 1;
            }
            *seen.entry(format!("depth {}", rig.script.depth())).or_default() += 1;
            said = rig.step(if pick.is_multiple_of(4) { input } else { answer(&rig, pick).unwrap_or(input) });
        }
    }
    let wanted = [
        "checked true",
        "checked false",
        "depth 1",
        "depth 2",
        "send",
        "part",
        "get",
        "reply",
        "arrive",
        "order",
        "delay",
        "start",
        "stop",
        "run",
        "work",
        "done",
        "return",
        "boundary",
        "atomic",
        "publish",
        "lease",
        "choose",
        "abandon",
        "unanswered",
        "cut",
        "handle",
    ];
    for word in wanted {
        assert!(seen.get(word).is_some_and(|&times| times >= 5), "{word}: {seen:?}");
    }
}
