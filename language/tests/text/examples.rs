//! Texts without faults, and their syntax trees.

use super::{BEAM_LIFT, PAPER, WELD, diagnostics, rendered, source, tree};
use imrs_language::ast::{ExprKind, Item, StatementKind, TaskDecl};
use imrs_language::{Word, parse};

fn tasks(text: &str) -> Vec<TaskDecl> {
    assert_eq!(diagnostics(text), [], "{}", rendered(text));
    let items = parse(&source(text)).file.items.into_iter();
    items.filter_map(|item| if let Item::Task(task) = item { Some(task) } else { None }).collect()
}

/// For each task: its ports, options, variables, handlers, statements of the body, and statements of `takeover`.
fn sizes(text: &str) -> Vec<(String, [usize; 6])> {
    let size = |task: TaskDecl| {
        let options = task.ports.iter().map(|port| port.options.len()).sum();
        let takeover = task.takeover.map_or(0, |body| body.len());
        let sizes =
            [task.ports.len(), options, task.variables.len(), task.handlers.len(), task.body.len(), takeover];
        (task.name.text, sizes)
    };
    tasks(text).into_iter().map(size).collect()
}

#[test]
fn the_beam_lift_is_read_whole() {
    let expected =
        [("armL", [3, 16, 2, 0, 1, 0]), ("armR", [3, 5, 1, 3, 2, 0]), ("hoist", [2, 3, 0, 1, 2, 0])];
    assert_eq!(sizes(BEAM_LIFT), expected.map(|(name, sizes)| (name.to_owned(), sizes)));
    assert_eq!(parse(&source(BEAM_LIFT)).file.items.len(), 1 + 3 + 3 + 2 + 3 + 1 + 1 + 2);
}

#[test]
fn the_weld_cell_is_read_whole() {
    let expected =
        [("dresser", [2, 11, 2, 2, 1, 0]), ("r1", [4, 15, 2, 0, 1, 0]), ("r2", [4, 7, 2, 0, 1, 2])];
    assert_eq!(sizes(WELD), expected.map(|(name, sizes)| (name.to_owned(), sizes)));
    assert_eq!(parse(&source(WELD)).file.items.len(), 1 + 3 + 2 + 3 + 3 + 2 + 1 + 2);
}

#[test]
fn figure_1_is_read_as_it_is_printed() {
    let expected = [("Ta", [1, 6, 0, 0, 1, 0]), ("Tb", [1, 2, 2, 1, 0, 0]), ("Tc", [1, 2, 2, 1, 0, 0])];
    assert_eq!(sizes(PAPER), expected.map(|(name, sizes)| (name.to_owned(), sizes)));
}

#[test]
fn everything_of_the_grammar_can_be_written() {
    let text = "cell all; tick 500 usec; model tick 0.5 sec;
        node a at \"h\" port 4000;
        task t on a module m standby of u extern rate = 20/1 sec
          port p(x, y: int8, z: R) -> R usage = reply user_list = (a b) retry = 3 resend = 2 msec
            penalty = paper 20 msec rate = 1_000/1 sec latest;
          var a, b: timer;
        begin
          order p > self;
          on fence do stop a; end;
          on expiry a do exit; end;
          send p({}) ;
        end t;";
    // Braces around a set of receivers are an error: the receivers are written as plain arguments.
    assert_eq!(super::codes(text), ["E005"]);
    let text = text.replace(
        "send p({}) ;",
        "
          use_send p(u, 1) within 3 msec on refused do skip; end;
          receive; receive within 3 msec; receive p(a.b, c) from u within 3 msec;
          reply p(1); response(); waitfor p(1) within 1 sec;
          run go; run go(); run go(1, 2) -> a in -1 .. 5 takes 5 msec on failed do abort \"x\"; end;
          run go (a) + 1, 2 takes 1 msec..2 sec;
          atomic x := -1 + 2 * 3 mod 4; assert not a and (b or 1.5e3 >= c); end;
          if a then elsif b then else end;",
    );
    let parsed = parse(&source(&text));
    assert_eq!(parsed.diagnostics, [], "{}", rendered(&text));
    let faults = "cell f; faults loss 1 dup 2 fail 3 drift 4 crash t pause t pause t up to 3 msec cut a -- b;
        couple serial a -> b; couple work a <-> b lease 1 sec takeover 2 sec every 3 msec via p;
        check c: always x; check d: x; check never: never never.x;";
    assert_eq!(diagnostics(faults), [], "{}", rendered(faults));
}

#[test]
fn operators_bind_as_in_structured_text() {
    let value = |expression: &str| {
        let text = format!("cell c; task t on n begin x := {expression}; end t;");
        tree(&text)
    };
    assert_eq!(value("a + b * c - d"), value("(a + (b * c)) - d"));
    assert_eq!(value("a or b and not (c = d)"), value("a or (b and (not (c = d)))"));
    assert_eq!(value("- a * b < c + d and e"), value("(((- a) * b) < (c + d)) and e"));
    assert_ne!(value("a - (b - c)"), value("a - b - c"));
}

#[test]
fn a_long_range_is_no_real_number() {
    let text = "cell c; task t on n begin run go takes 2..3 sec; x := 2.5; end t;";
    let body = &tasks(text)[0].body;
    assert!(matches!(&body[0].kind, StatementKind::Run { takes: Some((a, b)), .. }
        if a.usec == 2_000_000 && b.usec == 3_000_000));
    assert!(matches!(&body[1].kind, StatementKind::Assign { value, .. }
        if value.kind == ExprKind::Real("2.5".to_owned())));
}

#[test]
fn comments_nest_and_words_of_a_place_are_names_elsewhere() {
    let text = "(* a (* b *) c *) cell rate; /* a /* b */ c */ node link; // end
        task class on link begin rate := tick.model; tick := 1; end class;";
    assert_eq!(diagnostics(text), [], "{}", rendered(text));
    assert_eq!(tree("\u{feff}cell c;\r\nnode n;\r\n"), tree("cell c; node n;"));
}

#[test]
fn the_reference_lists_the_words_and_its_examples_can_be_read() {
    let page = include_str!("../../../specs/language/grammar.md");
    let quotes: Vec<Vec<&str>> = page
        .split("\n\n")
        .filter(|paragraph| paragraph.starts_with("> "))
        .map(|paragraph| paragraph.split_whitespace().filter(|word| *word != ">").collect())
        .collect();
    let sorted = |words: &[Word]| {
        let mut texts: Vec<&str> = words.iter().map(|word| word.text()).collect();
        texts.sort_unstable();
        texts
    };
    assert_eq!(quotes, [sorted(Word::RESERVED), sorted(Word::FREE)]);
    let examples: Vec<&str> = page.split("```cell\n").skip(1).collect();
    assert!(!examples.is_empty());
    for example in examples {
        let text = example.split("```").next().expect("an end");
        assert_eq!(diagnostics(text), [], "{}", rendered(text));
    }
}

#[test]
fn words_that_may_be_names_are_words_only_in_their_places() {
    for word in Word::FREE {
        let name = word.text();
        let text = format!(
            "cell {name}; node {name}; type {name} is record {name}: int8; end;
            task {name} on {name} port {name}({name}: {name}) usage = send user_list = {{{name}, {name}}};
            var {name}: {name};
            begin {name} := {name}.{name}; send {name}({name}); run {name} {name}; end {name};
            couple tight {{{name}, {name}}};"
        );
        assert_eq!(diagnostics(&text), [], "{}", rendered(&text));
    }
    for word in Word::RESERVED {
        assert_eq!(super::codes(&format!("cell c; node {};", word.text())), ["E009"], "{}", word.text());
    }
}
