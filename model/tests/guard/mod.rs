//! Compares the checker with random runs of the same cells: see [`compare_with_walks`].

mod cells;
mod crowd;
mod outside;
mod statements;

use crate::cells::{Text, within};
use crate::support::walk::Dice;
use imrs_language::{Source, Unit, compile};
use imrs_model::cell::{Agreement, Disagreement, Effort, Times, compare_with_walks};
use imrs_model::compared;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

/// A seeded generator of random numbers. It spreads the seed over all bits, and sets the lowest one, because zero would stay
/// zero.
pub const fn dice(seed: u64) -> Dice {
    Dice(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
}

/// Compares the search of a cell, with at most `states` states for each fault hypothesis, with random walks through the
/// cell.
fn compare(text: &str, seed: u64, states: u64, effort: Effort) -> Result<Agreement, Disagreement> {
    let mut cell = Text::new(text);
    cell.plan.budget = within(states);
    let mut dice = dice(seed);
    let plan = Arc::new(cell.plan);
    // A panic of the state machine counts as a disagreement, so that it is reported with a seed and a smallest cell, too.
    let walked =
        std::panic::AssertUnwindSafe(|| compare_with_walks(&plan, effort, &mut |limit| dice.below(limit)));
    std::panic::catch_unwind(walked).unwrap_or_else(|panic| {
        let said = panic.downcast_ref::<String>().cloned();
        let said = said.or_else(|| panic.downcast_ref::<&str>().map(|&said| said.to_owned()));
        let what = format!("it panics: {}", said.unwrap_or_default());
        Err(Disagreement { what, moves: Vec::new() })
    })
}

#[test]
fn the_examples_run_as_they_are_searched() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples");
    let mut all = Agreement::default();
    for entry in std::fs::read_dir(folder).expect("the examples") {
        let path = entry.expect("an entry").path();
        if path.extension().is_none_or(|extension| extension != "cell") {
            continue;
        }
        let text = std::fs::read_to_string(&path).expect("a cell");
        let effort = Effort { walks: 4, length: 1_000, times: Times::Ends };
        let one = compare(&text, 1, states(), effort).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        println!("{}: {one:?}", path.display());
        all += one;
    }
    assert!(all.steps > 10_000 && all.looked_up > 1_000, "{all:?}");
}

/// The number of random bytes for one cell.
const TAPE: usize = 300;
/// How many states a search may keep. `.ci/long` allows 20,000: then two more of the 475 searches are complete.
fn states() -> u64 {
    number("IMRS_STATES", 5_000)
}

/// The number in an environment variable, or `usual` if it is not set.
pub fn number(variable: &str, usual: u64) -> u64 {
    std::env::var(variable).map_or(usual, |text| text.parse().unwrap_or_else(|e| panic!("{variable}: {e}")))
}

fn tape(seed: u64) -> Vec<u8> {
    let mut dice = dice(seed);
    (0..TAPE).map(|_| u8::try_from(dice.below(256)).expect("a byte")).collect()
}

/// Whether the compiler accepts a cell.
pub fn is_sound(text: &str) -> bool {
    let source = Source::new(text.as_bytes()).expect("text");
    compile(&source).lower(Unit::Ticks).is_some()
}

/// The text of the random cell of this seed, whether the compiler accepts it or not.
pub fn random_text(seed: u64) -> String {
    cells::cell(&tape(seed))
}

/// The random cell of this seed; `None` if the compiler does not accept it.
pub fn random_cell(seed: u64) -> Option<Text> {
    let text = random_text(seed);
    is_sound(&text).then(|| Text::new(&text))
}

/// Compares the search of one random cell with random walks. Every second cell is searched at every tick. The other cells,
/// and cells that are too large for this, are searched only at the ends of their times.
fn random(tape: &[u8], seed: u64) -> Result<Agreement, Disagreement> {
    let text = cells::cell(tape);
    outside::covers(tape, &self::tape(seed + BODIES), states())?;
    let effort = |times| Effort { walks: 6, length: 150, times };
    if !seed.is_multiple_of(2) {
        let every = compare(&text, seed, states() / 4, effort(Times::Every))?;
        if every.complete == every.searches {
            return Ok(every);
        }
    }
    compare(&text, seed, states(), effort(Times::Ends))
}

/// The seeds from this one on are for the bytes of extern tasks' bodies.
const BODIES: u64 = 1 << 32;

/// Shrinks the bytes of a cell for which the search and the random walks disagree, as long as fewer bytes, or bytes with
/// more zeros, disagree, too.
fn shrink(mut tape: Vec<u8>, seed: u64) -> Vec<u8> {
    let differs = |tape: &[u8]| is_sound(&cells::cell(tape)) && random(tape, seed).is_err();
    let mut part = tape.len() / 2;
    while part > 0 {
        let mut at = 0;
        while at < tape.len() {
            let end = (at + part).min(tape.len());
            let shorter = [&tape[..at], &tape[end..]].concat();
            let mut smaller = tape.clone();
            smaller[at..end].fill(0);
            if differs(&shorter) {
                tape = shorter;
            } else {
                if smaller != tape && differs(&smaller) {
                    tape = smaller;
                }
                at = end;
            }
        }
        part /= 2;
    }
    tape
}

/// After this many random cells, one crowd is tested.
const CELLS_FOR_A_CROWD: u64 = 5;

/// `IMRS_CELLS` is the number of cells: 20,000 in `.ci/long`. `IMRS_SEED` is the first seed. With `IMRS_WORD` only cells
/// with this word are tested: in `.ci/long` a second run takes the cells with a `pause`.
#[test]
fn random_cells_run_as_they_are_searched() {
    let (cells, first) = (number("IMRS_CELLS", 300), number("IMRS_SEED", 1));
    let word = std::env::var("IMRS_WORD").unwrap_or_default();
    let (mut all, mut meets, mut sound, mut walked) = (Agreement::default(), 0, 0, 0);
    let mut crowded = 0;
    for seed in first..first + cells {
        if word.is_empty() && seed.is_multiple_of(CELLS_FOR_A_CROWD) {
            let text = crowd::cell(&tape(seed));
            assert!(is_sound(&text), "{text}");
            match walk(&text, seed) {
                Ok(one) => crowded += one.steps,
                Err(how) => panic!("IMRS_SEED={seed} IMRS_CELLS=1 differs:\n{text}\n{how}"),
            }
        }
        let text = cells::cell(&tape(seed));
        if !is_sound(&text) {
            continue;
        }
        sound += 1;
        if !text.contains(&word) {
            continue;
        }
        walked += 1;
        meets += u64::from(text.contains("    waitfor ") && text.contains("\nfaults "));
        match random(&tape(seed), seed) {
            Ok(one) => all += one,
            Err(_) => {
                let small = shrink(tape(seed), seed);
                let text = cells::cell(&small);
                let how = random(&small, seed).expect_err("it differs");
                panic!("IMRS_SEED={seed} IMRS_CELLS=1 differs; the smallest such cell:\n{text}\n{how}");
            }
        }
    }
    println!(
        "Done {cells} runs in all: cells from seed {first}, {sound} of them sound, {walked} walked, {meets} with a waitfor and a fault; {all:?}; {crowded} steps of crowds"
    );
    assert!(sound * 10 >= cells * 9, "{sound} of {cells} are cells");
    assert!(all.complete * 10 >= all.searches * 8, "{all:?}");
    assert!(meets * 10 >= walked * 3, "{meets} of {walked}");
    assert!(all.pauses * 4 >= walked && all.wakes * 2 >= all.pauses, "{all:?}");
    let fused = compared();
    println!("in fused steps, each compared with its small steps: {fused:?}");
    let often = |count: u64| count * 300 >= 1_000 * cells;
    let most_kinds = [
        fused.messages,
        fused.answers,
        fused.queries,
        fused.responses,
        fused.arrivals,
        fused.gets,
        fused.pairs,
    ];
    // Few random cells complete a `waitfor` within a node, so half as many of these are enough.
    let met = often(2 * fused.meetings);
    assert!(!word.is_empty() || most_kinds.into_iter().all(often) && met, "{fused:?}");
}

/// Makes random walks through a crowd without a meaningful search: the search keeps only one state, because a crowd is too
/// large.
fn walk(crowd: &str, seed: u64) -> Result<Agreement, Disagreement> {
    compare(crowd, seed, 1, Effort { walks: 2, length: 300, times: Times::Ends })
}

/// The words of the language, as its grammar lists them. Another test checks that list.
fn language() -> impl Iterator<Item = &'static str> {
    let grammar = include_str!("../../../specs/language/grammar.md");
    grammar.lines().filter_map(|line| line.strip_prefix("> ")).flat_map(str::split_whitespace)
}

/// Words that no random cell has. The checker refuses a cell that uses the number of a message for an answer (D93), and the
/// capacity of a link changes nothing that a cell does.
const ELSEWHERE: [&str; 2] = ["ticket", "capacity"];

/// The words of the language that are not in `words`.
fn missing(words: &BTreeSet<&str>) -> Vec<&'static str> {
    language().filter(|word| !words.contains(word) && !ELSEWHERE.contains(word)).collect()
}

/// The random cells must use the whole language; in `.ci/long` every two words must also occur together in one cell.
#[test]
fn random_cells_use_the_whole_language() {
    let whole = number("IMRS_CELLS", 0) > 0;
    let mut words = BTreeSet::new();
    let mut pairs = BTreeSet::new();
    for seed in 0..if whole { 60_000 } else { 3_000 } {
        let text = cells::cell(&tape(seed));
        if !is_sound(&text) {
            continue;
        }
        let split = |c: char| !(c.is_ascii_alphanumeric() || c == '_');
        let used: BTreeSet<&str> = text.split(split).collect();
        let used: BTreeSet<&str> = language().filter(|word| used.contains(word)).collect();
        if whole {
            for a in &used {
                pairs.extend(used.iter().map(|b| (*a, *b)));
            }
        }
        words.extend(used);
        // Every word has been seen, so more cells can show no more words.
        if !whole && missing(&words).is_empty() {
            return;
        }
    }
    let missing = missing(&words);
    assert!(missing.is_empty(), "{missing:?}");
    if whole {
        let alone = words.iter().flat_map(|a| words.iter().map(move |b| (*a, *b)));
        let alone: Vec<_> = alone.filter(|pair| !pairs.contains(pair)).collect();
        println!("{} of {} pairs", pairs.len(), words.len() * words.len());
        assert!(alone.is_empty(), "{alone:?}");
    }
}

/// The arrival of a packet lets a running action end, even if the packet has no other effect, and a cut link could drop it
/// without any other difference.
#[test]
fn a_packet_that_nobody_misses_is_still_an_event() {
    let text = "cell late; tick 1 msec; node n0; node n1; link n0 -- n1 delay 1 msec;
        task ta on n0
          use_port meet() usage = waitfor;
        begin
          waitfor meet() on time_out do skip; end;
          run turn takes 1..4 msec;
        end ta;
        task tb on n1
          port meet() usage = waitfor user_list = {ta} time_out = 30 msec class = 2;
        begin
          waitfor meet() on time_out do skip; end;
          delay 10 msec;
        end tb;
        faults cut n0 -- n1;";
    let effort = Effort { walks: 200, length: 150, times: Times::Every };
    let one = compare(text, 1, 20_000, effort).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(one.complete, one.searches, "{one:?}");
}
