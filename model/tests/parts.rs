//! Compares searches of the independent parts of a cell with searches of the same cells as a whole.

use crate::cells::{Text, within};
use crate::guard::{is_sound, number, random_text};
use imrs_model::cell::{Finding, Kind, Phase, Times, Verdicts, drawn, scenes};
use imrs_protocol::TaskId;
use std::collections::BTreeSet;
use std::sync::Arc;

/// A part of a cell: a feeder puts parts on a belt, over a relay. All names end with the letter `of`. The feeder does not
/// handle the loss of an answer.
fn line(of: char) -> String {
    format!(
        "node f{of}; node r{of}; node b{of};\nlink f{of} -- r{of} delay 1 msec;\nlink r{of} -- b{of} delay 1 msec;\n\
         task feeder_{of} on f{of}\n\
         port put_{of}() usage = send user_list = {{belt_{of}}} time_out = 20 msec class = 2;\n\
         var n: int8;\nbegin\n\
         loop run pick takes 5..9 msec; send put_{of}(); n := n + 1; if n = 3 then exit; end; end;\n\
         run rest takes 5 msec;\nend feeder_{of};\n\
         task belt_{of} on b{of}\nuse_port put_{of}() usage = receive;\nvar n: int8;\nbegin\n\
         loop receive put_{of}(); n := n + 1; reply(); end;\nend belt_{of};\n\
         check few_{of}: never belt_{of}.n > 3;\n"
    )
}

/// Another part of a cell: two arms that meet once, or give up.
const MEETING: &str = "node l; node r;\nlink l -- r delay 1 msec;\n\
    task left on l\nport lift() usage = waitfor user_list = {right} time_out = 30 msec class = 2;\n\
    var up: bool;\nbegin\nrun grip takes 1..8 msec; waitfor lift() on time_out do abort \"alone\"; end; up := true;\n\
    end left;\n\
    task right on r\nuse_port lift() usage = waitfor;\nvar up: bool;\nbegin\n\
    waitfor lift() on time_out do abort \"alone\"; end; up := true;\nend right;\n\
    check together: never left.up and not lift.arrived(right);\n";

const HEAD: &str = "cell lines;\ntick 1 msec;\n";

/// Adds checks that are true in every state. Each reads tasks of several parts, so that it joins these parts.
fn joined(text: &str, tasks: &[&str]) -> String {
    let pairs = tasks.windows(2).enumerate();
    let checks: Vec<String> = pairs
        .map(|(at, pair)| {
            let [one, other] = pair else { return String::new() };
            format!("check join{at}: always {one}.active or not {one}.active or {other}.active;\n")
        })
        .collect();
    format!("{text}{}", checks.concat())
}

fn cell(text: &str, times: Times) -> Text {
    let mut cell = Text::new(text);
    cell.plan.times = times;
    cell.plan.budget = within(3_000_000);
    cell
}

type Key = (Kind, Phase, Vec<TaskId>, Option<u16>, Option<usize>, Option<usize>);

/// The findings, each as a text by which it can be compared. Starvation counts as a time_out, because the search
/// examines only one path to decide between the two.
fn keys(verdicts: &Verdicts) -> BTreeSet<String> {
    let key = |finding: &Finding| -> Key {
        let kind = if finding.kind == Kind::Starves { Kind::TimeOut } else { finding.kind };
        let mut tasks = [finding.task.as_slice(), &finding.also].concat();
        tasks.sort_unstable();
        (kind, finding.phase, tasks, finding.address, finding.check, finding.couple)
    };
    verdicts.findings.iter().map(|finding| format!("{:?}", key(finding))).collect()
}

fn states(verdicts: &Verdicts) -> u64 {
    verdicts.phases.iter().map(|phase| phase.states).sum()
}

fn parts(verdicts: &Verdicts) -> Vec<u32> {
    verdicts.phases.iter().map(|phase| phase.parts).collect()
}

/// Compares the searches of the parts and of the whole, with a loss, a crash and a cut in turn: for two copies of a line,
/// and for a line beside a different part.
#[test]
fn parts_by_themselves_show_what_the_whole_shows() {
    let lines = format!("{HEAD}{}{}", line('x'), line('y'));
    let mixed = format!("{HEAD}{}{MEETING}", line('x'));
    let cases = [
        (&lines, ["belt_x", "feeder_y"], "faults loss 1;\nfaults crash belt_y;\n"),
        (&lines, ["belt_x", "feeder_y"], "faults cut fx -- rx;\nfaults fail 1;\n"),
        (&mixed, ["belt_x", "left"], "faults loss 1;\nfaults crash right;\n"),
        (&mixed, ["belt_x", "left"], "faults loss 1 crash bx;\nfaults cut l -- r dup 1;\n"),
    ];
    let (mut by_parts, mut at_once) = (0, 0);
    for (text, tasks, faults) in cases {
        let text = format!("{text}{faults}");
        for times in [Times::Ends, Times::Every] {
            let apart = cell(&text, times).check();
            let whole = cell(&joined(&text, &tasks), times).check();
            assert!(apart.is_complete() && whole.is_complete(), "{times:?} {text}");
            assert_eq!((parts(&apart), parts(&whole)), (vec![2; 3], vec![1; 3]));
            assert_eq!(keys(&apart), keys(&whole), "{text}");
            assert_eq!(apart.statements, whole.statements, "{text}");
            assert_eq!(apart.not_exercised, whole.not_exercised, "{text}");
            assert!(!apart.findings.is_empty(), "each case shows something");
            println!("{times:?}: {} states, as a whole {}", states(&apart), states(&whole));
            assert!(states(&apart) < states(&whole));
            (by_parts, at_once) = (by_parts + states(&apart), at_once + states(&whole));
        }
    }
    assert!(by_parts * 10 < at_once, "{by_parts} states, as a whole {at_once}");
}

/// Without reductions the cell is searched as a whole, with the same findings.
#[test]
fn the_plain_form_finds_the_same() {
    let short = |of: char| line(of).replace("if n = 3", "if n = 2");
    let text = format!("{HEAD}{}{}faults loss 1;\nfaults crash belt_y;\n", short('x'), short('y'));
    let mut cell = cell(&text, Times::Ends);
    let apart = cell.check();
    cell.plan.everything = true;
    let whole = cell.check();
    assert!(apart.is_complete() && whole.is_complete());
    assert_eq!((parts(&apart), parts(&whole)), (vec![2; 3], vec![1; 3]));
    assert_eq!(keys(&apart), keys(&whole));
    assert_eq!(apart.statements, whole.statements);
    println!("{} states, without reductions {}", states(&apart), states(&whole));
    assert!(states(&apart) * 5 < states(&whole));
}

/// Two tasks that share a node, a relay or a check are in one part. Otherwise they are in two parts.
#[test]
fn what_is_shared_joins() {
    let two = format!("{HEAD}{}{}", line('x'), line('y')).replace("n > 3", "n > 1");
    let relay = two.replace(" node ry;", "").replace("-- ry ", "-- rx ").replace("link ry", "link rx");
    let node =
        two.replace("task feeder_y on fy", "task feeder_y on fx").replace("link fy -- ry", "link fx -- ry");
    let check = joined(&two, &["belt_x", "belt_y"]);
    let cases = [(&two, 2), (&relay, 1), (&node, 1), (&check, 1)];
    for (text, expected) in cases {
        let verdicts = cell(text, Times::Ends).check();
        assert!(verdicts.is_complete());
        assert_eq!(parts(&verdicts), [expected], "{text}");
        let kinds: Vec<(Kind, Vec<TaskId>)> = verdicts
            .findings
            .iter()
            .map(|finding| (finding.kind, [finding.task.as_slice(), &finding.also].concat()))
            .collect();
        // Both checks are broken, and no request ends by its time_out, because every packet is routed.
        assert_eq!(kinds, [(Kind::Check, Vec::new()), (Kind::Check, Vec::new())], "{text}");
    }
}

/// How far a clock drifts between two events depends on all events of the cell, so the cell is searched as a whole.
#[test]
fn with_drift_a_cell_is_searched_as_a_whole() {
    let short = |of: char| line(of).replace("if n = 3", "if n = 1").replace("5..9 msec", "5 msec");
    let text = format!("{HEAD}{}{}faults drift 1;\n", short('x'), short('y'));
    let verdicts = cell(&text, Times::Ends).check();
    assert!(verdicts.is_complete());
    assert_eq!(parts(&verdicts), [2, 1]);
}

/// A deadlock is found even if another part goes on for ever, by parts and as a whole.
#[test]
fn a_part_at_its_end_is_seen_beside_one_that_goes_on() {
    let ring = "node a; node b;\nlink a -- b delay 1 msec;\n\
        task one on a\nport go() usage = send user_list = {two} time_out = 9 msec class = 1;\n\
        use_port come() usage = receive;\nbegin\nreceive come(); send go();\nend one;\n\
        task two on b\nport come() usage = send user_list = {one} time_out = 9 msec class = 1;\n\
        use_port go() usage = receive;\nbegin\nreceive go(); send come();\nend two;\n\
        node c;\ntask clock on c\nbegin\nloop delay 10 msec; end;\nend clock;\n";
    let text = format!("{HEAD}{ring}");
    let [apart, whole] =
        [text.clone(), joined(&text, &["one", "clock"])].map(|text| cell(&text, Times::Ends).check());
    assert_eq!(apart.of(Kind::Deadlock).count(), 1);
    assert_eq!(whole.of(Kind::Deadlock).count(), 1);
}

/// An `abort` ends all paths of the search without faults, and no path of a search with a fault. So a finding that needs no
/// fault, but comes after an `abort` of another part, needs a fault in the search of the whole cell. The searches of the
/// parts show the finding without a fault.
#[test]
fn what_comes_after_an_abort_of_another_part_is_said_to_need_no_fault() {
    let text = "cell two;\ntick 1 msec;\nnode na; node nb; node nc;\nlink na -- nb delay 1 msec;\n\
        task a on na\nport put() usage = send user_list = {b} time_out = 20 msec class = 2;\n\
        begin\nsend put();\nend a;\n\
        task b on nb\nuse_port put() usage = receive;\nbegin\ndelay 100 msec; receive put(); reply();\nend b;\n\
        task c on nc\nbegin\ndelay 4 msec; abort \"so\";\nend c;\n\
        faults crash b;\n";
    let ends = |verdicts: &Verdicts| {
        assert!(verdicts.is_complete());
        verdicts.of(Kind::Ends).map(|finding| finding.phase).collect::<Vec<_>>()
    };
    let apart = cell(text, Times::Ends).check();
    let whole = cell(&joined(text, &["a", "c"]), Times::Ends).check();
    assert_eq!((ends(&apart), ends(&whole)), (vec![Phase::FaultFree], vec![Phase::Faults]));
    assert_eq!(whole.phases.iter().map(|phase| phase.pruned).collect::<Vec<_>>(), [true, false]);
    assert_eq!(difference(&apart, &whole), None);
}

/// The chart of a finding has the lanes of its part, and its moves are replayed within the part.
#[test]
fn a_finding_is_drawn_and_replayed_within_its_part() {
    let text = format!("{HEAD}{}{}faults loss 1;\n", line('x'), line('y').replace("n > 3", "n > 1"));
    let cell = cell(&text, Times::Ends);
    let verdicts = cell.check();
    let broken = verdicts.of(Kind::Check).next().expect("the belt of the second line holds two");
    let saved = serde_json::to_string(broken).expect("plain data");
    let broken: Finding = serde_json::from_str(&saved).expect("what was saved");
    assert_eq!(broken.part, Some(1));
    let head = broken.chart.lines().next().expect("a head");
    let names: Vec<&str> =
        head.split_whitespace().filter(|word| word.ends_with("_x") || word.ends_with("_y")).collect();
    assert_eq!(names, ["feeder_y", "belt_y"], "{}", broken.chart);
    assert!(!broken.chart.contains("_x"), "{}", broken.chart);
    let plan = Arc::new(cell.plan);
    let notes = broken.steps.iter().flat_map(|step| step.notes.clone()).collect();
    let (names, notes) = drawn(&plan, broken.part, notes);
    assert_eq!(names, ["feeder_y", "belt_y", "ry"]);
    assert!(!notes.is_empty());
    let scenes = scenes(&plan, &broken);
    assert_eq!(scenes.len(), broken.moves.len() + 1);
    let last = scenes.last().expect("a scene");
    assert_eq!(last.tick, broken.at_ticks);
    // The tasks of the other part do not change, and the scenes show their nodes in the initial state.
    assert!(scenes.iter().all(|scene| scene.nodes.iter().all(|node| node.snapshot.is_some())));
    assert!(scenes.iter().all(|scene| scene.tasks[0] == scenes[0].tasks[0]));
    let counts = |scene: &imrs_model::cell::Scene| scene.tasks[3].variables.clone();
    assert_ne!(counts(last), counts(&scenes[0]), "the belt has counted");
}

/// The text of a random cell without its head and with other names, so that it can be joined to another cell.
fn renamed(text: &str) -> String {
    let mut out = String::new();
    let mut word = String::new();
    for c in text.chars().chain([' ']) {
        if c.is_alphanumeric() || c == '_' {
            word.push(c);
            continue;
        }
        let (first, rest) = word.split_at(word.len().min(1));
        let counted = !rest.is_empty() && rest.bytes().all(|byte| byte.is_ascii_digit());
        let other = match first {
            "n" if counted => "k",
            "p" if counted => "q",
            "c" if counted => "d",
            _ => "",
        };
        match word.as_str() {
            "ta" | "tb" | "tc" => out.push_str(&word.replace('t', "u")),
            "alive" | "crew" => out.push_str(&format!("{word}2")),
            _ if !other.is_empty() => out.push_str(&format!("{other}{rest}")),
            _ => out.push_str(&word),
        }
        out.push(c);
        word.clear();
    }
    let is_head = |line: &&str| ["cell ", "tick ", "type "].iter().any(|word| line.starts_with(word));
    out.lines().filter(|line| !is_head(line)).map(|line| format!("{line}\n")).collect()
}

/// Two texts from the seed: a cell with two random cells as separate parts, and the same cell with a check that joins the
/// parts. `None` if the two cannot be separate parts, or if the compiler refuses the cell.
fn pair(seed: u64) -> Option<[String; 2]> {
    let [one, other] = [random_text(2 * seed + 1), random_text(2 * seed + 2)];
    let unlike =
        |text: &str| ["model tick", " at \"", "drift", "pause"].iter().any(|word| text.contains(word));
    let text = format!("{one}{}", renamed(&other));
    let whole = joined(&text, &["ta", "ua"]);
    (!unlike(&one) && !unlike(&other) && is_sound(&whole)).then_some([text, whole])
}

/// The findings of this phase, each as a text with its task. Deadlocks are left out, because one part may have a deadlock
/// while another part goes on.
fn judged(verdicts: &Verdicts, phase: Phase) -> BTreeSet<String> {
    let mut verdicts = verdicts.clone();
    verdicts.findings.retain(|finding| finding.kind != Kind::Deadlock && finding.phase == phase);
    for at in 0..verdicts.findings.len() {
        for task in std::mem::take(&mut verdicts.findings[at].also) {
            verdicts.findings.push(Finding { task: Some(task), ..verdicts.findings[at].clone() });
        }
    }
    keys(&verdicts)
}

/// How the findings of the parts and of the whole differ; `None` if they agree.
///
/// In the search of the whole cell, a finding that ends paths in one part hides later findings of the other part. If no
/// path of a phase is ended in this way (pruned), the searches of the parts show the same in that phase. If the phase
/// without faults is pruned, the search of the whole cell may need a fault for a finding that the searches of the parts
/// show without one.
fn difference(apart: &Verdicts, whole: &Verdicts) -> Option<String> {
    let hides = |phase: Phase| whole.phases.iter().any(|one| one.phase == phase && one.pruned);
    let hidden = [Phase::FaultFree, Phase::Faults].map(hides);
    let [[plain, faulty], [whole_plain, whole_faulty]] =
        [apart, whole].map(|verdicts| [Phase::FaultFree, Phase::Faults].map(|phase| judged(verdicts, phase)));
    let with_a_fault = |key: &String| key.replacen("FaultFree", "Faults", 1);
    let without: BTreeSet<String> = plain.iter().map(with_a_fault).collect();
    let is_shown = |key: &String| faulty.contains(key) || hidden[0] && without.contains(key);
    let missing: Vec<&String> =
        whole_plain.difference(&plain).chain(whole_faulty.iter().filter(|key| !is_shown(key))).collect();
    let beyond: Vec<&String> = [(&plain, &whole_plain, hidden[0]), (&faulty, &whole_faulty, hidden[1])]
        .into_iter()
        .filter(|(.., hidden)| !hidden)
        .flat_map(|(mine, others, _)| mine.difference(others))
        .collect();
    if !missing.is_empty() || !beyond.is_empty() {
        return Some(format!("the parts lack {missing:?} and have beyond the whole {beyond:?}"));
    }
    if apart.of(Kind::Deadlock).count() < whole.of(Kind::Deadlock).count() {
        return Some("a deadlock of the whole is none of its parts".into());
    }
    let hidden = hidden[0] || hidden[1];
    let mut reached = apart.statements.iter().zip(&whole.statements);
    let agree = reached.all(|(mine, other)| if hidden { mine >= other } else { mine == other });
    (!agree).then(|| format!("reached {:?}, as a whole {:?}", apart.statements, whole.statements))
}

/// The verdicts on a pair of random cells, by parts and as a whole; `None` if the whole is too large to search.
fn searched(text: &str, whole: &str) -> Option<[Verdicts; 2]> {
    let check = |text: &str| {
        let mut cell = Text::new(text);
        cell.plan.times = Times::Ends;
        cell.plan.budget = within(number("PAIR_STATES", 6_000));
        cell.check()
    };
    let whole = check(whole);
    whole.is_complete().then(|| [check(text), whole])
}

/// Seeds of pairs whose whole is pruned, although the searches of the parts are complete. With the first seed, an `abort`
/// of one part hides a finding without a fault, which the search of the whole shows only with a fault. With the second
/// seed, one part overflows its packed states after a broken check of the other part. With the third seed, only a search
/// with faults sees the states after an `abort`.
const HIDDEN: [u64; 3] = [243, 409, 531];

/// Compares pairs of random cells, by parts and joined by a check. `PAIRS` is the number of pairs, `PAIR_SEED` the first
/// seed, `PAIR_STATES` how many states a search keeps: 600 pairs and 20,000 states in `.ci/long`.
#[test]
fn random_cells_beside_each_other() {
    let (mut compared, mut shown, mut whole_seen, mut apart_states, mut whole_states) = (0, 0, 0, 0, 0);
    let mut differing = Vec::new();
    let (pairs, first) = (number("PAIRS", 60), number("PAIR_SEED", 0));
    for seed in (first..first + pairs).chain(HIDDEN) {
        let Some([text, joined]) = pair(seed) else { continue };
        let Some([apart, whole]) = searched(&text, &joined) else { continue };
        let pruned = whole.phases.iter().any(|phase| phase.pruned);
        // If the whole cell can be searched, so can its parts, because the parts together have no more states. But if
        // the search of the whole cell is pruned, a part may be too large.
        assert!(apart.is_complete() || pruned, "PAIR_SEED={seed}:\n{text}");
        if !apart.is_complete() {
            continue;
        }
        compared += 1;
        shown += usize::from(!apart.findings.is_empty());
        (apart_states, whole_states) = (apart_states + states(&apart), whole_states + states(&whole));
        whole_seen += usize::from(!pruned);
        if let Some(what) = difference(&apart, &whole) {
            println!("{text}");
            differing.push(format!("PAIR_SEED={seed} PAIRS=1: {what}"));
        }
    }
    println!(
        "{compared} pairs, {whole_seen} seen whole, {shown} with findings: {apart_states} states, as a whole {whole_states}"
    );
    assert!(differing.is_empty(), "{}", differing.join("\n"));
    // A single pair need not have a finding, so the counts of a few pairs are not judged.
    if pairs < 60 {
        return;
    }
    assert!(whole_seen >= 5 && shown >= 2, "{compared} {whole_seen} {shown}");
    assert!(apart_states * 2 < whole_states, "{apart_states} {whole_states}");
}
