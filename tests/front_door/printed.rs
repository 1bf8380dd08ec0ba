//! Compares the output that the README quotes with the present output of the command.

use super::{blocks, read};
use crate::support::program::one_after_the_other;
use crate::support::{is_well, run, run_until, runtime_dir};

/// The text block of the README that contains these words.
fn printed(words: &str) -> Vec<String> {
    let readme = read("README.md");
    let blocks = blocks(&readme);
    let found =
        blocks.iter().find(|block| block.kind == "text" && block.lines.iter().any(|l| l.contains(words)));
    found
        .unwrap_or_else(|| panic!("no block with {words}"))
        .lines
        .iter()
        .map(|&line| line.to_owned())
        .collect()
}

#[test]
fn the_printed_verdicts_are_those_of_today() {
    // A line is compared without its last two words, which are the time and its unit.
    let plain = |line: &str| {
        let words: Vec<&str> = line.split_whitespace().collect();
        words[..words.len().saturating_sub(2)].join(" ")
    };
    let said = run(&["verify", "--claim", "pairing"]);
    assert_eq!(said.code, Some(0), "{said:?}");
    let today: Vec<String> = said.out.lines().map(plain).collect();
    for line in printed("pairing") {
        assert!(today.contains(&plain(&line)), "`{line}` is not in\n{}", said.out);
    }
}

/// A line without its numbers (except line numbers of the cell), and with all units of time replaced by one.
fn shape(line: &str) -> String {
    let mut words: Vec<String> = Vec::new();
    for word in line.split_whitespace() {
        let before = words.last().map_or("", String::as_str);
        let kept = word.trim_start_matches(|c: char| c.is_ascii_digit() || c == '.');
        words.push(match word.trim_end_matches(['.', ',', ';']) {
            _ if kept.len() < word.len() && !before.ends_with("line") => format!("#{kept}"),
            "us" | "ms" if before == "#" => format!("s{}", &word[2..]),
            _ => word.to_owned(),
        });
    }
    words.join(" ")
}

/// The line number of the cell in a printed line.
fn line_of(text: &str) -> Option<usize> {
    let (_, digits) = text.split_once("line ")?;
    digits.split(|c: char| !c.is_ascii_digit()).next()?.parse().ok()
}

#[test]
fn the_lines_of_the_printed_run_are_those_of_its_cell() {
    let (cell, block) = (read("examples/beam_lift.cell"), printed("fault: nothing passes"));
    let cell: Vec<&str> = cell.lines().collect();
    let mut checked = 0;
    for line in &block {
        let Some(at) = line_of(line) else { continue };
        let (_, what) = line.split_once(&format!("line {at}")).expect("its number");
        if what.starts_with(')') {
            // For a sentence of the summary, the block must also have the event of this arm's stop.
            let arm = line.split_whitespace().next().expect("an arm");
            let stop = format!("{arm} line {at} begins stop_now");
            assert!(block.iter().any(|line| shape(line).ends_with(&stop)), "nothing says `{stop}`");
        } else {
            let named = what.split('`').nth(1).or_else(|| what.split_whitespace().last()).expect("a name");
            assert!(cell[at - 1].contains(named), "line {at} of the cell has no {named}: {}", cell[at - 1]);
        }
        checked += 1;
    }
    assert!(checked >= 5, "only {checked} lines were found");
}

/// The events of a printed run: the time in seconds, the task, and the text.
fn events(out: &str) -> Vec<(f64, &str, &str)> {
    let lines = out.lines().filter_map(|line| {
        let (seconds, rest) = line.trim_start().split_once(" s ")?;
        let (task, what) = rest.split_once(' ')?;
        Some((seconds.parse().ok()?, task, what))
    });
    lines.collect()
}

/// Whether the cut came while both arms moved, whether each arm then stopped by itself, and whether both lifted again.
/// On a busy machine an arm may have stopped before the cut, or not have noticed it; such a run is not compared.
fn is_evidence(out: &str) -> bool {
    let (cell, events) = (read("examples/beam_lift.cell"), events(out));
    let Some(cut) = events.iter().find(|(_, task, _)| *task == "fault:").map(|(at, ..)| *at) else {
        return false;
    };
    let of = |arm: &'static str| events.iter().filter(move |(_, task, _)| *task == arm);
    let moved = |arm| {
        let last = of(arm).take_while(|(at, ..)| *at < cut).last();
        last.is_some_and(|(_, _, what)| what.ends_with("ends start_lift"))
    };
    let after = |arm, what: &'static str| of(arm).find(move |(at, _, did)| *at > cut && did.contains(what));
    let (Some(unheard), Some(left), Some(right)) =
        (after("armL", "`beat`"), after("armL", "begins stop_now"), after("armR", "begins stop_now"))
    else {
        return false;
    };
    // This is the heading of the handler in which the arm began to stop.
    let head = |line| cell.lines().take(line).filter(|text: &&str| text.starts_with("  on ")).last();
    let by_itself = line_of(right.2).and_then(head).is_some_and(|head| head.contains("silence"));
    let lifts = of("armL").filter(|(_, _, what)| what.ends_with("ends start_lift")).count();
    lifts > 2 && moved("armL") && moved("armR") && unheard.0 <= left.0 && by_itself
}

#[test]
fn the_printed_run_is_a_run_of_today() {
    let gone_on = &["nothing passes", "reach each other again", "ends start_lift", "ends start_lift"];
    let dir = runtime_dir();
    let said = run_until(dir.path(), &["demo", "beam-lift", "--seed", "3"], one_after_the_other(gone_on));
    // On a very late machine the second lift never begins. The output then says so, and a task may have given up.
    let never_came = said.out.contains("The fault never came");
    let gave_up = |line: &str| line.starts_with("imrs: task ") && line.contains(" aborted");
    let complaints: Vec<&str> = said.err.lines().filter(|line| !(never_came && gave_up(line))).collect();
    let code = if complaints.is_empty() && never_came { Some(0) } else { said.code };
    assert!(is_well(code, &complaints.join("\n")), "{said:?}");
    let today: Vec<String> = said.out.lines().map(shape).collect();
    let is_whole = said.code == Some(0) && !said.out.contains("too busy") && is_evidence(&said.out);
    if !is_whole {
        eprintln!("the machine was late: of this run only what comes before the cut is compared");
    }
    let always = if never_came { &["What happened"][..] } else { &["fault:", "What happened", "went dead"] };
    for line in printed("fault: nothing passes").iter().filter(|line| *line != "...") {
        if is_whole || always.iter().any(|words| line.contains(words)) {
            assert!(today.contains(&shape(line)), "`{line}` is not said in\n{}", said.out);
        }
    }
}
