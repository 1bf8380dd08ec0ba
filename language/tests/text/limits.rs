//! Tests that a text which exceeds a limit is refused, quickly and without a stack overflow.

use super::{codes, diagnostics, source};
use imrs_language::{LONGEST_FILE, Source, format};
use std::time::{Duration, Instant};

fn in_task(body: &str) -> String {
    format!("cell c; task t on n begin {body} end t;")
}

/// A cell with too many nodes gives one finding, and the compiler searches no routes between the nodes.
#[test]
fn nodes_have_a_bound() {
    let cell = |nodes: usize, links: &dyn Fn(usize) -> String| {
        let nodes = (0..nodes).map(|i| format!("node n{i}; {}", links(i)));
        format!("cell c; tick 1 msec; {}task t on n0 begin skip; end t;", nodes.collect::<String>())
    };
    let line =
        |i: usize| if i > 0 { format!("link n{} -- n{i} delay 1 msec; ", i - 1) } else { String::new() };
    let star = |i: usize| if i > 0 { format!("link n0 -- n{i} delay 1 msec; ") } else { String::new() };
    let kinds: [&dyn Fn(usize) -> String; 3] = [&line, &star, &|_| String::new()];
    for links in kinds {
        let found = imrs_language::compile(&source(&cell(6_000, links))).diagnostics;
        assert_eq!(found.iter().map(|found| found.code).collect::<Vec<_>>(), ["E123"]);
        assert!(found[0].is_limit() && found[0].message == "more than 512 nodes", "{found:?}");
        let found = imrs_language::compile(&source(&cell(512, links))).diagnostics;
        assert!(found.iter().all(|found| found.code != "E123"), "{found:?}");
    }
}

#[test]
fn nesting_has_a_bound() {
    let blocks = |n: usize| in_task(&format!("{}{}", "loop ".repeat(n), "end; ".repeat(n)));
    assert_eq!(codes(&blocks(63)), [""; 0]);
    assert_eq!(codes(&blocks(64)), ["E012"]);
    let parentheses = |n: usize| in_task(&format!("x := {}1{};", "(".repeat(n), ")".repeat(n)));
    assert_eq!(codes(&parentheses(64)), [""; 0]);
    assert_eq!(codes(&parentheses(65)), ["E012"]);
    for sign in ["not ", "- "] {
        let signs = |n: usize| in_task(&format!("x := {}y;", sign.repeat(n)));
        assert_eq!(codes(&signs(64)), [""; 0]);
        assert_eq!(codes(&signs(65)), ["E012"]);
    }
    let mixed = format!("x := {}1{};", "(- - not ".repeat(60), ")".repeat(60));
    assert!(!codes(&in_task(&mixed)).is_empty());
}

#[test]
fn expressions_and_names_have_a_bound() {
    let sum = |n: usize| in_task(&format!("x := 1{};", " + 1".repeat(n)));
    assert_eq!(codes(&sum(256)), [""; 0]);
    assert_eq!(codes(&sum(257)), ["E012"]);
    assert_eq!(codes(&format!("cell {};", "n".repeat(64))), [""; 0]);
    assert_eq!(codes(&format!("cell {};", "n".repeat(65))), ["E012"]);
}

#[test]
fn blocks_without_do_are_bounded_too() {
    let found = codes(&in_task(&"while x ".repeat(1000)));
    assert!(found.contains(&"E012"), "{found:?}");
}

#[test]
fn a_hundred_errors_are_shown_and_the_others_counted() {
    let found = diagnostics(&format!("cell c; {}", "node 1; ".repeat(107)));
    assert_eq!(found.len(), 101);
    assert_eq!((found[100].code, found[100].message.as_str()), ("E016", "7 more errors are not shown"));
    let found = diagnostics(&format!("cell c; {}", "node 1; ".repeat(100)));
    assert_eq!(found.len(), 100);
}

#[test]
fn files_have_a_bound() {
    let text = " ".repeat(LONGEST_FILE + 1);
    assert_eq!(Source::new(text.as_bytes()).expect_err("too long").code, "E012");
}

/// How much of `length` a test uses, and the time limit of the test. With `IMRS_LONGEST` the test uses the whole length,
/// otherwise a sixteenth. The limits are generous: a phase that takes more than linear time would take minutes for the
/// longest text.
fn part_of(length: usize, limit: Duration) -> (usize, Duration) {
    if std::env::var_os("IMRS_LONGEST").is_some() {
        (length, limit)
    } else {
        (length / 16, Duration::from_secs(120))
    }
}

#[test]
fn the_longest_rubbish_is_refused_quickly() {
    let kinds = [
        "x",
        "x;",
        ";",
        "(",
        "(*",
        "\"",
        "§",
        "§x",
        "loop ",
        "end ",
        "end;",
        "if x then ",
        "a + ",
        "not ",
        "1.",
        "'",
        "/*",
        "cell c;",
        "task ",
        "on ",
        "waitfro x;",
        "begin x;",
        "x := 1 ",
        "port p() ",
        "on x do ",
        "while x ",
        "{ ",
    ];
    let (length, limit) = part_of(LONGEST_FILE, Duration::from_secs(20));
    for kind in kinds {
        let begin = Instant::now();
        let text = format!("cell c; task t on n begin {}", kind.repeat((length - 100) / kind.len()));
        let found = diagnostics(&text);
        assert!(!found.is_empty() && found.len() <= 101, "{kind}: {}", found.len());
        let took = begin.elapsed();
        println!("{kind:?}: {took:?}");
        assert!(took < limit, "{kind}: {took:?}");
    }
}

#[test]
fn a_long_text_without_faults_is_read_and_formatted_quickly() {
    let (statements, limit) = part_of(40_000, Duration::from_secs(30));
    let text = in_task(&"send p(x + 1, y.z) on time_out do skip; end;\n".repeat(statements));
    let begin = Instant::now();
    let source = Source::new(text.as_bytes()).expect("a text");
    let formatted = format(&source).expect("no error");
    println!("{} bytes in {:?}", text.len(), begin.elapsed());
    assert!(formatted.len() > text.len() && begin.elapsed() < limit);
}

/// Tests that the checks do not visit a nested loop twice for each loop around it.
#[test]
fn loops_in_loops_are_checked_quickly() {
    let loops = |begin: &str, inside: &str| format!("{} {inside} {}", begin.repeat(58), "end; ".repeat(58));
    for (begin, inside) in [
        ("loop receive q(); ", "response(); exit;"),
        ("while x do ", "response(); x := false;"),
        ("loop if x then exit; end; ", "receive q(); delay 5 msec; response();"),
    ] {
        let text = format!(
            "cell c; tick 1 msec; node n;
            task a on n port q() usage = query user_list = {{b}} time_out = 90 msec; begin query q() on time_out do skip; end; end a;
            task b on n use_port q() usage = response; var x: bool;
            begin run look -> x; order q > self; {} end b;",
            loops(begin, inside)
        );
        let begun = Instant::now();
        let _ = imrs_language::compile(&source(&text));
        let handled = text.replace(&loops(begin, inside), "").replace(
            "end b;",
            &format!("on query q() do {} end; end b;", loops(begin, inside).replace("receive q();", "skip;")),
        );
        let _ = imrs_language::compile(&source(&handled));
        // If the checks visited each loop twice for every loop around it, they would never end.
        assert!(begun.elapsed().as_secs() < 120, "{begin}");
    }
}
