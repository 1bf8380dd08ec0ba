//! The static checks: what each one finds and where, and what it does not report.

use super::{BEAM_LIFT, WELD, all_found, source};
use imrs_language::{Diagnostic, Options, Severity, compile, compile_with};
use std::path::Path;

const HEAD: &str = "cell c; tick 1 msec; node na; node nb; link na -- nb delay 1 msec;\n";

/// A cell of two tasks.
fn pair(a: &str, b: &str) -> String {
    format!("{HEAD}task a on na {a} end a;\ntask b on nb {b} end b;\n")
}

#[track_caller]
fn check(text: &str, expected: &[&str]) {
    assert_eq!(all_found(text), expected, "in:\n{text}");
}

/// The warnings and errors about a text, without the notes.
fn serious(text: &str) -> Vec<Diagnostic> {
    let found = compile(&source(text)).diagnostics;
    found.into_iter().filter(|found| found.severity != Severity::Note).collect()
}

#[test]
fn the_examples_have_only_notes() {
    for text in [BEAM_LIFT, WELD] {
        assert_eq!(serious(text), []);
    }
    check(BEAM_LIFT, &["N201 `5 msec`", "N201 `10 msec`"]);
    check(WELD, &["N201 `15 msec`"]);
}

/// Each file in `examples/faulty`, `examples/faulty/inside` and `examples/rules` lists its findings in the first line: `(* finds: E104 9:45 *)`. The
/// faults of a file without such a line are found by the model checker.
#[test]
fn faulty_cells_are_found_out_where_they_say() {
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples");
    let files = |folder| std::fs::read_dir(examples.join(folder)).expect("a folder of cells").flatten();
    let mut codes = Vec::new();
    let mut surprising = Vec::new();
    let cells = ["faulty", "faulty/inside", "rules"].into_iter().flat_map(files);
    for entry in cells.filter(|entry| entry.path().extension().is_some_and(|name| name == "cell")) {
        let text = std::fs::read_to_string(entry.path()).expect("a cell file");
        let first = text.lines().next().unwrap_or_default();
        let Some(said) = first.strip_prefix("(* finds: ").and_then(|rest| rest.strip_suffix(" *)")) else {
            assert_eq!(serious(&text), [], "{}", entry.path().display());
            continue;
        };
        let source = source(&text);
        let found: Vec<String> = serious(&text)
            .iter()
            .map(|found| {
                let (line, column) = source.position(found.primary.span.start);
                format!("{} {line}:{column}", found.code)
            })
            .collect();
        if found.join(", ") != said {
            surprising.push(format!("{}: {}, not {said}", entry.path().display(), found.join(", ")));
        }
        codes.extend(serious(&text).iter().map(|found| found.code));
    }
    assert!(surprising.is_empty(), "{}", surprising.join("\n"));
    codes.sort_unstable();
    codes.dedup();
    assert!(codes.len() >= 20, "only {codes:?}");
}

#[test]
fn meetings() {
    let meet = "port m() usage = waitfor user_list = {b} time_out = 1 sec;";
    let wait = "waitfor m() on time_out do abort \"\"; end;";
    let uses = "use_port m() usage = waitfor;";
    check(&pair(&format!("{meet} begin {wait}"), &format!("{uses} begin {wait}")), &[]);
    // In this cell the owner of the waitfor does not reach it.
    check(&pair(&format!("{meet} begin skip;"), &format!("{uses} begin {wait}")), &["E104 `m`"]);
    check(&pair(&format!("{meet} begin {wait}"), &format!("{uses} begin skip;")), &["E104 `b`"]);
    // In the first cell a task has no statements yet; in the second one a Rust program is its behaviour.
    check(&pair(&format!("{meet} begin {wait}"), &format!("{uses} begin")), &["W316 `b`"]);
    let program = pair(&format!("{meet} begin {wait}"), &format!("{uses} begin"));
    check(&program.replace("task b on nb", "task b on nb extern"), &[]);
    check(
        &pair(&format!("{meet} begin waitfor m();"), &format!("{uses} begin {wait}")),
        &["E208 `waitfor m()`"],
    );
    // Both tasks reach the waitfor under some condition, which may be the same for both.
    let sometimes = format!("var x: bool; begin run look -> x; if x then {wait} end;");
    check(&pair(&format!("{meet} {sometimes}"), &format!("{uses} {sometimes}")), &[]);
}

#[test]
fn rings_of_meetings_and_of_calls() {
    let port = |name: &str| format!("port {name}() usage = waitfor user_list = {{b}} time_out = 1 sec;");
    let wait = |name: &str| format!("waitfor {name}() on time_out do abort \"\"; end;");
    let a = format!("{} {} begin {} {}", port("m"), port("n"), wait("m"), wait("n"));
    let uses = "use_port m() usage = waitfor; use_port n() usage = waitfor; begin";
    check(&pair(&a, &format!("{uses} loop {} {} end;", wait("m"), wait("n"))), &[]);
    check(&pair(&a, &format!("{uses} loop {} {} end;", wait("n"), wait("m"))), &["E203 `waitfor m()`"]);
    // A statement behind an `abort`, or behind a loop without an `exit`, is not certain to run. Behind a loop with an
    // `exit` it is certain to run.
    let b = format!("{uses} loop {} {} end;", wait("n"), wait("m"));
    let head = format!("{} {} begin", port("m"), port("n"));
    let (m, n) = (wait("m"), wait("n"));
    let never = ["W309 `waitfor n()`", "W314 `waitfor n()`"];
    check(&pair(&format!("{head} {m} abort \"off\"; {n}"), &b), &never);
    check(&pair(&format!("{head} loop {m} end; {n}"), &b), &never);
    check(&pair(&format!("{head} loop {m} exit; end; {n}"), &b), &["E203 `waitfor m()`"]);
    // Tasks that ask each other at different times, one after the other, form no ring.
    let a = "port p() usage = query user_list = {b} time_out = 50 msec; use_port q() usage = response; begin loop query p() on time_out do skip; end; receive q(); response(); end;";
    let b = "use_port p() usage = response; port q() usage = query user_list = {a} time_out = 50 msec; begin";
    let ask = "query q() on time_out do skip; end;";
    check(&pair(a, &format!("{b} loop receive p(); response(); {ask} end;")), &[]);
    check(&pair(a, &format!("{b} loop {ask} receive p(); response(); end;")), &["E202 `query p()`"]);
    check(&pair(a, &format!("{b} order p > self; on query p() do response(); end; loop {ask} end;")), &[]);
}

#[test]
fn answers_on_every_way() {
    let ask = "port q() usage = query user_list = {b} time_out = 50 msec; begin query q() on time_out do skip; end;";
    let answer = |body: &str| {
        let b = format!(
            "use_port q() usage = response; var x: bool; begin run look -> x; assert x; on query q() do {body} end;"
        );
        let found = all_found(&pair(ask, &b));
        found.iter().map(|found| found[..4].to_owned()).collect::<Vec<_>>().join(" ")
    };
    assert_eq!(answer("skip;"), "E209");
    assert_eq!(answer("response();"), "");
    assert_eq!(answer("if x then response(); end;"), "W308");
    assert_eq!(answer("if x then response(); elsif not x then skip; else response(); end;"), "W308");
    assert_eq!(answer("if x then response(); else abort \"\"; end;"), "");
    assert_eq!(answer("loop if x then exit; end; end; response();"), "");
    assert_eq!(answer("loop if x then response(); exit; end; end;"), "");
    assert_eq!(answer("while x do response(); x := false; end;"), "W308");
    assert_eq!(answer("atomic response(); end;"), "");
    assert_eq!(answer("run work on failed do exit; end; response();"), "E113");
    assert_eq!(answer("run work on failed do abort \"\"; end; response();"), "");
    assert_eq!(answer("loop run work on failed do exit; end; response(); exit; end;"), "W308");
    let asks = "run work on failed do skip; end; if outcome = done then response(); end;";
    assert_eq!(answer(asks), "W308", "a handler has its message, whatever an action came to");
}

#[test]
fn nothing_is_said_of_an_answer_that_somebody_else_may_give() {
    let text = format!(
        "{HEAD}task a on na port q() usage = query user_list = {{b}} time_out = 50 msec; use_port r() usage = receive;
        begin on receive r() do skip; end; query q() on time_out do skip; end; end a;
        task b on nb use_port q() usage = response; begin on query q() do skip; end; end b;
        task d on nb port r() usage = reply user_list = {{a}} time_out = 50 msec; begin delay 1 sec; end d;"
    );
    check(&text, &["W310 `r`"]);
}

#[test]
fn long_work_keeps_messages_waiting() {
    let ask = "port q() usage = query user_list = {b} time_out = 50 msec; begin query q() on time_out do skip; end;";
    let b = |body: &str| pair(ask, &format!("use_port q() usage = response; begin {body}"));
    let handler = "order q > self; on query q() do response(); end;";
    check(&b("loop run work takes 1..50 msec; receive q(); response(); end;"), &[]);
    check(
        &b("loop run work takes 1..51 msec; receive q(); response(); end;"),
        &["W303 `run work takes 1..51 msec`"],
    );
    // A handler that does not outrank `self` is offered its message again and again until it interrupts (D58), but not
    // inside of `atomic`.
    check(&b(&format!("{handler} loop delay 1 sec; end;")), &[]);
    check(&b(&format!("{handler} loop atomic delay 1 sec; end; end;")), &["W303 `delay 1 sec`"]);
}

/// The W308 findings about the `receive`s of a task that takes messages of `q`, a query, and of `go`, a class-2 message.
fn received(variables: &str, body: &str) -> Vec<String> {
    let asks = "port q(n: int8) usage = query user_list = {b} time_out = 500 msec;
  port go() usage = send user_list = {b} time_out = 500 msec class = 2;
begin loop query q(1) on time_out do skip; end; send go() on time_out do skip; end; end;";
    let takes = format!(
        "use_port q(n: int8) usage = response; use_port go() usage = receive; var n: int8; {variables} begin {body}"
    );
    let text = pair(asks, &takes.replace("response()", "response(n)"));
    let serious = serious(&text);
    // Some bodies take messages of only one port.
    let wrong = |found: &&Diagnostic| found.severity == Severity::Error && found.code != "E204";
    let errors: Vec<_> = serious.iter().filter(wrong).collect();
    assert!(errors.is_empty(), "{errors:?}");
    all_found(&text).into_iter().filter(|found| found.starts_with("W308")).collect()
}

#[test]
fn what_a_body_receives_is_answered_on_every_path() {
    let forgets = |body: &str| received("", body);
    let (q, go) = ("W308 `receive q(n)`", "W308 `receive go()`");
    // In each of these bodies some path leaves the message unanswered: at the next iteration, at the end of the task, when
    // another message comes, or in a loop that never answers.
    assert_eq!(forgets("loop receive q(n); if n > 0 then response(); end; end;"), [q]);
    assert_eq!(forgets("receive q(n); if n > 0 then response(); end;"), [q]);
    assert_eq!(forgets("loop receive q(n); receive go(); reply(); end;"), [q]);
    assert_eq!(forgets("receive q(n); if n > 0 then response(); end; loop delay 1 sec; end;"), [q]);
    assert_eq!(forgets("while n < 9 do receive go(); if n > 0 then reply(); end; n := n + 1; end;"), [go]);
    assert_eq!(
        forgets("loop receive q(n); if n > 0 then exit; end; response(); end; receive q(n); response();"),
        [q]
    );
    assert_eq!(forgets("loop receive q(n); run work on failed do exit; end; response(); end;"), [q]);
    assert_eq!(
        forgets("loop receive q(n); while n > 0 do response(); n := 0; end; receive go(); reply(); end;"),
        [q]
    );
    let asks =
        "loop receive q(n); run work on failed do skip; end; if outcome = done then response(); end; end;";
    assert_eq!(forgets(asks), [q], "this `receive` cannot end without a message");
    // The body answers the first message, and does not answer the second.
    assert_eq!(forgets("receive q(n); response(); loop receive go(); end;"), [go]);
    for whole in [
        "loop receive q(n); if n > 0 then response(); else response(); end; end;",
        "loop receive q(n); response(); receive go(); reply(); end;",
        "loop receive q(n); loop delay 5 msec; if n > 0 then exit; end; n := n + 1; end; response(); end;",
        "loop receive q(n) within 20 msec on time_out do skip; end; response() on failed do skip; end; end;",
        "receive q(n); if n > 3 then abort \"too many\"; end; response();",
        "loop receive q(n); exit; end; response(); receive go(); reply();",
        // The message that the body receives at the end of one iteration is answered in the next iteration.
        "receive q(n); loop response(); receive q(n); end;",
    ] {
        assert_eq!(forgets(whole), [""; 0], "{whole}");
    }
}

/// If a task asks how the `receive` ended, the task knows whether there is a message to answer.
#[test]
fn a_receive_that_brought_nothing_needs_no_answer() {
    let forgets = |body: &str| received("var got: bool;", body);
    for whole in [
        "loop receive q(n) within 20 msec on time_out do skip; end; if outcome = message then response(); end; end;",
        "loop got := true; receive q(n) within 20 msec on time_out do got := false; end; if got then response(); end; end;",
        "while not got do got := true; receive q(n) within 20 msec on time_out do got := false; end; end; response();",
    ] {
        assert_eq!(forgets(whole), [""; 0], "{whole}");
    }
    let neither = "loop got := true; receive q(n) within 20 msec on time_out do got := false; end;
if got then if n > 0 then response(); end; end; end;";
    assert_eq!(forgets(neither), ["W308 `receive q(n) within 20 msec`"]);
}

#[test]
fn what_a_handler_receives_is_answered_on_every_path() {
    let handler = |body: &str| {
        received(
            "var t: timer; var m: int8;",
            &format!("on expiry t do {body} end; start t 1 sec; receive go(); reply();"),
        )
    };
    assert_eq!(handler("receive q(m); if m > 0 then response(); end;"), ["W308 `receive q(m)`"]);
    assert_eq!(handler("receive q(m); response();"), [""; 0]);
}

/// If a `reply` failed, there was no message to answer.
#[test]
fn a_handler_that_looks_whether_its_answer_left_has_answered() {
    let b = "use_port q() usage = response; var late: bool; begin order q > self;
on query q() do response() on failed do late := true; end; end; delay 1 sec; assert not late;";
    let text = pair(
        "port q() usage = query user_list = {b} time_out = 50 msec; begin query q() on time_out do skip; end;",
        b,
    );
    assert_eq!(serious(&text), []);
}

#[test]
fn a_handlers_variable_hides_the_tasks() {
    let text = |variables: &str, head: &str| {
        let b = format!(
            "use_port q(x: int8; up: bool) usage = receive; {variables} begin order q > self; on receive q({head}) do skip; end; loop delay 1 sec; end;"
        );
        pair("port q(x: int8; up: bool) usage = send user_list = {b} time_out = 50 msec; begin send q(1, true);", &b)
            .replace("x: int8; up", "x: int8, up")
    };
    let hidden = |variables: &str, head: &str| -> Vec<String> {
        all_found(&text(variables, head)).into_iter().filter(|found| found.starts_with("W319")).collect()
    };
    assert_eq!(hidden("var x, y: int8;", "x, y"), ["W319 `x`", "W319 `y`"]);
    assert_eq!(hidden("var x: timer;", "x, y"), ["W319 `x`"]);
    assert_eq!(hidden("var z: int8;", "x, y"), [""; 0]);
    assert_eq!(hidden("var x: int8;", ""), [""; 0], "nothing is bound");
    let record = text("var p: Pose;", "p")
        .replace("task a on", "type Pose is record x: int8; up: bool; end;\ntask a on");
    let record = record
        .replace("q(x: int8, up: bool)", "q(p: Pose)")
        .replace("q(1, true)", "q(mine)")
        .replace("begin send", "var mine: Pose; begin send");
    let found = serious(&record);
    let hides = found.iter().find(|found| found.code == "W319").expect("the record is hidden");
    assert_eq!(hides.message, "`p` hides the task's variable `p` in this handler");
    let source = source(&record);
    assert_eq!(source.slice(hides.secondary[0].span), "p");
    assert!(hides.secondary[0].span.start < hides.primary.span.start);
}

#[test]
fn of_a_work_couple_one_sends_at_a_time() {
    assert!(
        WELD.contains("port free()       usage = receive   user_list = {r1, r2}"),
        "two senders, one place"
    );
    let apart =
        WELD.replace("couple work r1 -> r2 lease 100 msec takeover 400 msec every 20 msec via alive;", "");
    let apart =
        apart.replace(" standby of r1", "").replace("takeover                 ", "                         ");
    let apart = apart.replace("alive := p; ", "").replace("loop receive prog(p); end;", "receive prog(p);");
    let apart = apart.replace("check one_active: never r1.active and r2.active;", "");
    let found: Vec<_> = serious(&apart).iter().map(|found| found.code).collect();
    assert!(found.contains(&"W302"), "{found:?}");
}

#[test]
fn statements_that_are_never_reached() {
    let body =
        |body: &str| format!("{HEAD}task a on na var x: bool; begin run look -> x; assert x; {body} end a;");
    check(&body("abort \"\"; delay 5 msec;"), &["W309 `delay 5 msec`"]);
    check(&body("loop if x then exit; end; end; delay 5 msec;"), &[]);
    check(&body("loop loop exit; end; end; delay 5 msec;"), &["W309 `delay 5 msec`"]);
    check(&body("while true do delay 1 msec; end; skip;"), &["W309 `skip`"]);
    check(&body("loop exit; skip; end;"), &["W309 `skip`"]);
    check(&body("if x then abort \"\"; else abort \"\"; end; skip;"), &["W309 `skip`"]);
    check(&body("if x then abort \"\"; end; skip;"), &[]);
    check(&body("run go on failed do abort \"\"; end; skip;"), &[]);
}

#[test]
fn what_a_table_refuses_is_said_with_its_arithmetic() {
    let ask = |time_out: &str| {
        let port = format!("port q() usage = query user_list = {{b}} time_out = {time_out};");
        let text = pair(&format!("{port} begin"), "use_port q() usage = response; begin");
        serious(&text).remove(0)
    };
    let short = ask("2 msec");
    assert_eq!(
        (short.code, &short.primary.text[..]),
        ("E201", "must exceed 2 x 1 msec on the links = 2 msec")
    );
    assert_eq!(short.help, ["give it 5 msec or more"]);
    assert_eq!(ask("3 msec").code, "E206");
    let often = ask("300 sec  rate = 30/1 msec");
    assert_eq!(often.code, "E304");
    assert_eq!(often.primary.text, "30 in 1 msec x 1 at the other end x 300 sec = 9000000 > 2^23");
}

#[test]
fn a_take_over_is_said_with_its_parts() {
    let found = serious(&WELD.replace("takeover 400 msec", "takeover 300 msec")).remove(0);
    let parts =
        "must reach 301080 usec: lease 100 msec + 200 msec of `grab` + 1080 usec for the tick and the drift";
    assert_eq!((found.code, &found.primary.text[..]), ("E305", parts));
    // The check accepts the advised value, although the clocks drift apart further in a longer take-over.
    assert!(found.help[0].starts_with("give it 302 msec, or shorten"), "{:?}", found.help);
    assert!(serious(&WELD.replace("takeover 400 msec", "takeover 302 msec")).is_empty());
    // The sum of the couple's times exceeds 64 bits.
    let endless = serious(&WELD.replace("lease 100 msec", "lease 18446744073709551 msec")).remove(0);
    assert_eq!(endless.code, "E305");
}

#[test]
fn the_paper_alone() {
    let found = |text: &str| -> Vec<String> {
        let source = source(text);
        let found = compile_with(&source, Options { paper: true }).diagnostics;
        let errors = found.iter().filter(|found| found.severity == Severity::Error);
        errors.map(|found| format!("{} `{}`", found.code, source.slice(found.primary.span))).collect()
    };
    let meet = pair(
        "port m() usage = waitfor user_list = {b} time_out = 1 sec retry = 1; begin waitfor m();",
        "use_port m() usage = waitfor; begin waitfor m(); run go;",
    );
    assert_eq!(found(&meet), ["E117 `retry = 1`", "E117 `run go`"]);
    let short = pair("begin delay 500ms; delay 2 s; delay 3msec;", "begin skip;");
    assert_eq!(found(&short), ["E117 `ms`", "E117 `s`"]);
    let words = found(WELD);
    for word in
        ["penalty = 20 msec", "couple loose {r1, r2} over dresser", "check one_active", "start held 4 sec"]
    {
        assert!(words.iter().any(|found| found.contains(word)), "{word}: {words:?}");
    }
    let figure_1 = pair(
        "port p(number, speed) usage = query user_list = (b) time_out = 50 msec class = 2 bounded_buffer[2]; begin QUERY p(1, 2);",
        "use_port p(number, speed) usage = response; begin order p > self; on query p(n, s) do response(n, s); end;",
    );
    assert_eq!(found(&figure_1), [""; 0]);
}
