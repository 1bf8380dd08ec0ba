//! Decodes bytes into programs and their inputs, for the fuzz target `script`.

use super::fake::Rig;
use super::random::answer;
use super::written::{inputs, programs, well_formed};
use imrs_protocol::script::*;
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::{RngAlgorithm, TestRng, TestRunner};

/// The value that a proptest strategy draws with this seed.
fn drawn<T>(strategy: impl Strategy<Value = T>, seed: [u8; 4]) -> T {
    let seed = std::array::from_fn::<u8, 16, _>(|i| seed[i % 4].wrapping_add(u8::try_from(i).unwrap_or(0)));
    let rng = TestRng::from_seed(RngAlgorithm::XorShift, &seed);
    let mut runner = TestRunner::new_with_rng(ProptestConfig::default(), rng);
    strategy.new_tree(&mut runner).expect("it rejects nothing").current()
}

/// Runs a program with inputs, both read from `data`: the seeds of two random programs, how their operations are mixed, and
/// each input. Checks that every state packs and unpacks ([`Rig::step`]), that a program that passes its check is never
/// malformed, and that an ended script stays ended.
pub fn script(data: &[u8]) {
    let mut rest = data.iter().copied();
    let mut word = || std::array::from_fn::<u8, 4, _>(|_| rest.next().unwrap_or(0));
    let seed = word();
    let mut program = if seed[0] & 1 == 0 { drawn(well_formed(), seed) } else { drawn(programs(), seed) };
    let other = drawn(programs(), word());
    for _ in 0..seed[1] % 8 {
        graft(&mut program, &other, word());
    }
    let checked = program.check().is_ok();
    let mut rig = Rig::of(program);
    rig.begin();
    for _ in 0..data.len().min(800) / 4 {
        let [pick, a, b, c] = word();
        let senseless = !checked && pick.is_multiple_of(4);
        let input = answer(&rig, pick).filter(|_| !senseless);
        rig.step(input.unwrap_or_else(|| drawn(inputs(), [a, b, c, 0])));
        if let Activity::Ended(end) = rig.script.activity() {
            let malformed = matches!(end, End::Fault { fault: ScriptFault::Malformed, .. });
            assert!(!(checked && malformed), "{:?}", rig.script);
            rig.step(ScriptInput::Begin);
            assert_eq!(rig.script.activity(), Activity::Ended(end), "an end is one");
            return;
        }
    }
}

/// Mutates a program: inserts, replaces or removes an operation, or changes its handlers.
fn graft(program: &mut Program, other: &Program, [what, at, from, to]: [u8; 4]) {
    let (at, from) = (usize::from(at), usize::from(from));
    let code = &mut program.code;
    let other = other.code.get(from % other.code.len().max(1)).copied();
    let own = code.get(from % code.len().max(1)).copied();
    let at = at % (code.len() + 1);
    match (what % 4, other, own) {
        (0, Some(op), _) | (1, _, Some(op)) => code.insert(at, op),
        (2, Some(op), _) if at < code.len() => code[at] = op,
        (3, ..) if at < code.len() => drop(code.remove(at)),
        _ => program.takeover = None,
    }
    let count = program.handlers.len();
    if to & 1 == 1 && count > 1 {
        program.handlers.swap(at % count, from % count);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_bytes_are_programs(data in proptest::collection::vec(any::<u8>(), 0..600)) {
        script(&data);
    }
}

#[test]
fn kept_programs_are_harmless() {
    crate::fuzzing::replay("script", script);
}
