//! Tests of the formatter.

use super::{BEAM_LIFT, PAPER, WELD, source};
use imrs_language::format;
use proptest::prelude::*;

use crate::support::bytes::formats;

fn formatted(text: &str) -> String {
    format(&source(text)).unwrap_or_else(|_| panic!("{}", super::rendered(text)))
}

#[test]
fn examples_are_formatted_as_recorded() {
    let mut settings = insta::Settings::clone_current();
    settings.set_snapshot_path("../formatted");
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    let _bound = settings.bind_to_scope();
    for (name, text) in [("beam_lift", BEAM_LIFT), ("weld", WELD), ("paper", PAPER)] {
        formats(&source(text));
        insta::assert_snapshot!(name, formatted(text));
    }
}

#[test]
fn nothing_becomes_a_part_of_a_comment() {
    let text = "cell c; task t on n\n  port p() usage = send user_list = {b // one\n  , d} time_out = 10 msec class = 1;\nbegin\nend t;";
    formats(&source(text));
    assert!(formatted(text).contains("{b,  // one\n"), "{}", formatted(text));
}

#[test]
fn spellings_and_spaces_are_settled() {
    let text = "CELL c ;TASK t ON n\n\n\n\n PORT Rate( a:INT8 ,b )Usage=send user_list=( a,b c )rate = 1 / 2 sec  \
                bounded_buffer [ 3 ] ;\r\nBEGIN\nRate:=- 1-( - - 2)+NOT.x [";
    // This text does not parse, so it is not formatted.
    assert!(format(&source(text)).is_err());
    let text = text.replace(
        "+NOT.x [",
        ";\nRate:=TRUNC ( 2.5 );\nIF a THEN\nrun x TAKES 1 .. 2 sec\nON failed DO\nskip;\nEND;\nEND;\nEND t;",
    );
    let expected = "cell c; task t on n

  port Rate(a: int8, b) usage = send user_list = {a, b, c} rate = 1/2 sec bounded_buffer[3];
begin
  Rate := -1 - (- -2);
  Rate := trunc(2.5);
  if a then
    run x takes 1..2 sec
      on failed do
        skip;
      end;
  end;
end t;
";
    assert_eq!(formatted(&text), expected);
}

#[test]
fn units_of_command_lines_are_written_as_those_of_cells() {
    let text = "cell c; tick 1ms; node a; node b; link a -- b delay 0.5ms; task t on a var s: int8; begin\nloop\ns := 2;\ndelay 500 ms;\ndelay 2s;\ndelay 30MSEC;\nend;\nend t;\n";
    let expected =
        "cell c; tick 1 msec; node a; node b; link a -- b delay 0.5 msec; task t on a var s: int8; begin
  loop
    s := 2;
    delay 500 msec;
    delay 2 sec;
    delay 30 msec;
  end;
end t;
";
    assert_eq!(formatted(text), expected);
    for glued in ["1milli", "1__0ms", "1_.5ms", "1_ms"] {
        assert!(format(&source(&std::format!("cell c; tick {glued};"))).is_err(), "{glued}");
    }
}

#[test]
fn trailing_comments_of_one_column_stay_aligned() {
    let text = "cell c;// alone
task t on n
  var a: bool;     // one column,
    var bc : int16;// though the indentation changes
  var d: bool;   // another column
begin
a := true;        // the longest line
bc := 1;          // a shorter line
d   :=   a;       // a line that loses spaces

d := false;       // behind an empty line
(* two
lines *) a := d;  // behind a comment of two lines
  // a comment without a statement
d := a; (* \u{e4} *) // one column in characters,
a := (* x *) d; // though not in bytes
end t;
";
    let expected = "cell c;  // alone
task t on n
  var a: bool;    // one column,
  var bc: int16;  // though the indentation changes
  var d: bool;  // another column
begin
  a := true;  // the longest line
  bc := 1;    // a shorter line
  d := a;     // a line that loses spaces

  d := false;  // behind an empty line
  (* two
lines *) a := d;  // behind a comment of two lines
  // a comment without a statement
  d := a; (* \u{e4} *)  // one column in characters,
  a := (* x *) d;  // though not in bytes
end t;
";
    assert_eq!(formatted(text), expected);
    formats(&source(text));
}

#[test]
fn texts_with_errors_are_left_alone() {
    let found = format(&source("cell c; node;")).expect_err("an error");
    assert_eq!(found[0].code, "E005");
}

/// Comments and blanks of all kinds.
fn gap() -> impl Strategy<Value = &'static str> {
    proptest::sample::select(vec![
        " ",
        "  ",
        "\n",
        "\n\n\n",
        "\t",
        "\r\n",
        " (* c *) ",
        "\n(* two\n   lines *)\n",
        " // c\n",
        "   // c\n",
        "\n// c\n",
        "/* c */",
    ])
}

/// Replaces the blanks of a text by other blanks and line breaks.
fn regapped(text: &'static str) -> impl Strategy<Value = String> {
    // Texts in quotes stay whole, and comments are removed.
    let lines = text.lines().map(|line| line.split("//").next().unwrap_or_default());
    let plain = lines.collect::<Vec<_>>().join("\n");
    let plain = match (plain.find("/*"), plain.find("*/")) {
        (Some(begin), Some(end)) => format!("{}{}", &plain[..begin], &plain[end + 2..]),
        _ => plain,
    };
    let mut words: Vec<String> = Vec::new();
    for (index, part) in plain.split('"').enumerate() {
        if index % 2 == 1 {
            words.push(format!("\"{part}\""));
        } else {
            words.extend(part.split_whitespace().map(str::to_owned));
        }
    }
    proptest::collection::vec(gap(), words.len())
        .prop_map(move |gaps| words.iter().zip(gaps).flat_map(|(word, gap)| [word.as_str(), gap]).collect())
}

/// A statement of some length, and the spaces in front of its comment.
fn commented() -> impl Strategy<Value = (usize, usize)> {
    (1_usize..5, 0_usize..5)
}

/// The column of the comment of each line, from 0.
fn columns(text: &str) -> Vec<usize> {
    text.lines().filter_map(|line| line.find("// c")).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    /// After formatting, comments of consecutive lines begin in one column exactly if they did so before. Each comment has
    /// at least two spaces in front of it, and exactly two behind the longest line of its group.
    #[test]
    fn comments_below_each_other_move_together(lines in proptest::collection::vec(commented(), 2..6)) {
        let statement = |length: usize| format!("{} := 1;", "x".repeat(length));
        let written = |(length, spaces): &(usize, usize)| format!("{}{}// c\n", statement(*length), " ".repeat(*spaces));
        let body: String = lines.iter().map(written).collect();
        let text = format!("cell c;\ntask t on n\nbegin\n{body}end t;\n");
        formats(&source(&text));
        let (before, after) = (columns(&text), columns(&formatted(&text)));
        let ends: Vec<usize> = lines.iter().map(|(length, _)| 2 + statement(*length).len()).collect();
        let mut from = 0;
        for group in before.chunk_by(|a, b| a == b) {
            let to = from + group.len();
            let expected = ends[from..to].iter().max().expect("a line") + 2;
            prop_assert!(after[from..to].iter().all(|column| *column == expected), "{text}");
            from = to;
        }
    }

    #[test]
    fn any_blanks_and_comments_are_settled(
        text in prop_oneof![regapped(BEAM_LIFT), regapped(WELD), regapped(PAPER)]
    ) {
        formats(&source(&text));
        let marks = |text: &str| text.matches("c *)").count() + text.matches("// c").count() + text.matches("c */").count()
            + text.matches("lines *)").count();
        prop_assert_eq!(marks(&formatted(&text)), marks(&text));
    }
}
