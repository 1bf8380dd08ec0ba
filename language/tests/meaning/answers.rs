//! Values of other tasks, in meetings, answers and heartbeats; replies that a task gives later; and replies of third
//! parties (D93).

use super::{all_found, begun, found, virtual_cell, whole};
use imrs_language::lower::Behaviour;
use imrs_language::{Options, Source, Unit, compile_with};
use imrs_protocol::{Rules, Ticks};

const HEAD: &str = "cell c; tick 1 msec; node na; node nb; node nd; link na -- nb delay 1 msec;
link na -- nd delay 1 msec; link nb -- nd delay 1 msec;\n";

#[test]
fn who_meets_hears_what_the_others_tell() {
    let text = format!(
        "{HEAD}task a on na
  port lift(height: int16; ready: bool) usage = waitfor user_list = {{b, d}} time_out = 1 sec;
  var h: int16; var all: bool;
begin
  waitfor lift(3, true) on time_out do skip; end;
  h := lift.height(b) + lift.height(d);  all := lift.told(b) and lift.told(d) and lift.ready(b) and not lift.ready(d);
  delay 1 sec;
  waitfor lift(3, true) on time_out do h := lift.height(b); all := lift.told(b); end;
  delay 9 sec;
end a;
task b on nb use_port lift(height: int16; ready: bool) usage = waitfor; begin waitfor lift(40, true) on time_out do skip; end; delay 9 sec; end b;
task d on nd use_port lift(height: int16; ready: bool) usage = waitfor; begin waitfor lift(-500, false) on time_out do skip; end; delay 9 sec; end d;
"
    )
    .replace("height: int16; ready: bool", "height: int16, ready: bool");
    let mut virtual_cell = virtual_cell(&text);
    virtual_cell.run(100);
    assert_eq!((virtual_cell.var("a", "h"), virtual_cell.var("a", "all")), (-460, 1));
    virtual_cell.run(3_000);
    assert_eq!(
        (virtual_cell.var("a", "h"), virtual_cell.var("a", "all")),
        (0, 0),
        "nobody else came the second time"
    );
}

#[test]
fn each_answer_of_several_can_be_read() {
    let text = format!(
        "{HEAD}type Pos is record x: int16; ok: bool; end;
task a on na
  port ask(n: int8) -> Pos usage = query user_list = {{b, d}} time_out = 50 msec;
  var x, y: int16; var good: bool;
begin
  query ask(7) on time_out do x := ask.x(b); y := ask.x(d); good := ask.answered(b) and not ask.answered(d); end;
  query ask(b, 1) on time_out do skip; end;
  x := x + ask.x(b) * 100;
  y := ask.x(d);
  delay 1 sec;
end a;
task b on nb use_port ask(n: int8) -> Pos usage = response; begin on query ask(n) do response(n + 20, true); end; end b;
task d on nd use_port ask(n: int8) -> Pos usage = response; begin delay 9 sec; receive ask(); response(0, false); end d;
"
    );
    let mut virtual_cell = virtual_cell(&text);
    virtual_cell.run(500);
    assert_eq!(
        [virtual_cell.var("a", "x"), virtual_cell.var("a", "y"), virtual_cell.var("a", "good")],
        [2_127, 0, 1]
    );
}

#[test]
fn questions_about_what_was_told_have_to_fit() {
    let text = |expression: &str| {
        format!(
            "{HEAD}task a on na
  port lift(height: int16) usage = waitfor user_list = {{b}} time_out = 1 sec;
  port s(x: int8) usage = send user_list = {{b}} time_out = 1 sec;
  var h: bool;
begin waitfor lift(1); send s(1); h := {expression}; end a;
task b on nb use_port lift(height: int16) usage = waitfor; use_port s(x: int8) usage = receive;
begin waitfor lift(2); receive s(); end b;
task d on nd begin end d;
"
        )
    };
    assert_eq!(found(&text("lift.height(b) > 3 and lift.told(b)")), [""; 0]);
    assert_eq!(found(&text("lift.hight(b) > 3")), ["E102 `hight`"]);
    assert_eq!(found(&text("lift.height(d) > 3")), ["E113 `d`"]);
    assert_eq!(found(&text("s.x(b) > 3")), ["E102 `x`"], "class 1 is not answered");
    let in_handler = text("true").replace(
        "begin waitfor lift(1);",
        "var t: timer; begin on expiry t do h := lift.told(b); end; start t 1 sec; waitfor lift(1);",
    );
    assert_eq!(found(&in_handler), ["E113 `lift.told(b)`"], "the handler meets nobody");
}

#[test]
fn an_answer_may_come_later() {
    let text = format!(
        "{HEAD}task tool on na
  port grab(n: int8) -> int8 usage = response user_list = {{b, d}} time_out = 200 msec bounded_buffer[2];
  var late: bool;
begin
  order grab > self;
  on query grab(n) do if sender = d then response(n); end; end;
  delay 60 msec;
  reply grab(50) for b;
  reply grab(51) for b on failed do late := true; end;
  delay 1 sec;
end tool;
task b on nb use_port grab(n: int8) usage = query; var got: int8; begin query grab(1) -> got on time_out do got := -1; end; delay 1 sec; end b;
task d on nd use_port grab(n: int8) usage = query; var got: int8; begin query grab(2) -> got on time_out do got := -1; end; delay 1 sec; end d;
"
    );
    let mut virtual_cell = virtual_cell(&text);
    virtual_cell.run(30);
    assert_eq!(
        [virtual_cell.var("b", "got"), virtual_cell.var("d", "got")],
        [0, 2],
        "one is answered at once"
    );
    virtual_cell.run(100);
    assert_eq!([virtual_cell.var("b", "got"), virtual_cell.var("tool", "late")], [50, 1]);
    assert!(!all_found(&text).iter().any(|found| found.starts_with("E209") || found.starts_with("W308")));
}

#[test]
fn somebody_else_may_answer() {
    let text = format!(
        "{HEAD}task asker on na
  port ask() -> int8 usage = query user_list = {{clerk}} time_out = 200 msec;
  use_port back(n: int8) usage = receive;
  var got: int8;
begin query ask() -> got on time_out do got := -1; end; delay 1 sec; end asker;
task clerk on nb
  use_port ask() usage = response;
  port pass(ticket: word) usage = send user_list = {{expert}} time_out = 100 msec class = 2;
begin loop receive ask(); send pass(ticket) on time_out do skip; end; end; end clerk;
task expert on nd
  use_port pass(ticket: word) usage = receive;
  port back(n: int8) usage = reply user_list = {{asker}} time_out = 100 msec;
  var n: word;
begin loop receive pass(n); reply(); reply back(42) for asker ticket n; end; end expert;
"
    );
    let compiled = whole(&text);
    let lowered = compiled.lower(Unit::Ticks).expect("a whole cell");
    let Behaviour::Script(clerk) = &lowered.tasks[1] else { panic!("a script") };
    assert!(clerk.program.names_messages());
    let mut virtual_cell = begun(&lowered);
    virtual_cell.run(100);
    assert_eq!(virtual_cell.var("asker", "got"), 42);
    for (from, to, code) in [
        (" ticket n;", ";", "E113 `asker`"),
        (" for asker ticket n;", ";", "E113 `reply back(42)`"),
        ("reply back(42)", "reply pass(42)", "E113 `asker`"),
        ("for asker ticket", "for clerk ticket", "E113 `clerk`"),
        ("ticket n;", "ticket true;", "E112 `true`"),
    ] {
        assert_eq!(found(&text.replace(from, to)), [code], "{from}");
    }
}

#[test]
fn reals_are_cut_off_on_demand() {
    let text = |value: &str| {
        format!(
            "{HEAD}task a on na var r: real; var n: int16; begin r := 0.0 - 2.9; n := {value}; delay 1 sec; end a;"
        )
    };
    let mut virtual_cell = virtual_cell(&text("trunc(r * 10.0) + trunc(3.99)"));
    virtual_cell.run(10);
    assert_eq!(virtual_cell.var("a", "n"), -26);
    assert_eq!(found(&text("r")), ["E112 `r`"]);
    assert_eq!(found(&text("trunc(3)")), ["E112 `3`"]);
    assert_eq!(found(&text("trunc(3.0e9)")), ["E112 `trunc(3.0e9)`"]);
    assert_eq!(found(&text("trunc(40000.0)")), ["E112 `trunc(40000.0)`"]);
    let named = "var trunc: int16; begin trunc := 3; n := trunc + trunc(1.5);";
    assert_eq!(found(&text("1").replace("begin", named)), [""; 0]);
}

#[test]
fn a_standby_reads_what_the_primary_published() {
    let text = format!(
        "{HEAD}type Prog is record spot: int8; phase: int8; end;
task r1 on na
  port alive(p: Prog) usage = response user_list = {{r2}} time_out = 15 msec;
  var p: Prog;
begin
  loop p.spot := p.spot + 1; p.phase := 7; alive := p; delay 50 msec; end;
end r1;
task r2 on nb standby of r1
  use_port alive(p: Prog) usage = query time_out = 15 msec;
  var p, now: Prog;
begin
  loop delay 10 msec; p := alive; end;
takeover now := alive; delay 9 sec;
end r2;
couple work r1 -> r2 lease 100 msec takeover 400 msec every 20 msec via alive;
"
    );
    let mut virtual_cell = virtual_cell(&text);
    virtual_cell.run(420);
    let spot = virtual_cell.var("r1", "p.spot");
    assert!((4..=10).contains(&spot), "{spot}");
    let read = virtual_cell.var("r2", "p.spot");
    assert!(read == spot || read == spot - 1, "{read} of {spot}");
    assert_eq!(virtual_cell.var("r2", "p.phase"), 7);
    virtual_cell.crash(virtual_cell.node("na"));
    virtual_cell.run(1_000);
    assert_eq!(virtual_cell.var("r2", "now.phase"), 7, "and after the take-over");
}

#[test]
fn with_roles_that_change_both_publish_and_both_read() {
    let text = |arrow: &str| {
        format!(
            "{HEAD}task r1 on na
  port alive(n: int8) usage = response user_list = {{r2}} time_out = 15 msec;
  var n, got: int8;
begin loop n := 5; alive := n; got := alive; assert got >= 0; delay 20 msec; end;
takeover loop got := alive; assert got >= 0; delay 20 msec; end; end r1;
task r2 on nb standby of r1
  use_port alive(n: int8) usage = query time_out = 15 msec;
  var n, got: int8;
begin loop got := alive; delay 20 msec; end;
takeover loop n := 9; alive := n; assert got >= 0; delay 20 msec; end; end r2;
couple work r1 {arrow} r2 lease 100 msec takeover 400 msec every 20 msec via alive;
"
        )
    };
    let said = |text: &str| {
        all_found(text).into_iter().filter(|found| found.starts_with("W317")).collect::<Vec<_>>()
    };
    assert_eq!(said(&text("<->")), [""; 0]);
    let one_way = text("->")
        .replace("takeover loop got := alive; assert got >= 0; delay 20 msec; end; end r1;", "end r1;");
    assert_eq!(said(&one_way), ["W317 `got := alive`", "W317 `alive := n`"]);
    let mut virtual_cell = virtual_cell(&text("<->"));
    virtual_cell.run(300);
    assert_eq!(virtual_cell.var("r2", "got"), 5);
}

#[test]
fn figure_1_is_compiled_as_it_is_printed() {
    let text = include_str!("../cells/paper.cell").replace("node n1;", "tick 1 msec; node n1;");
    let text = text.replace("response();", "response(number, speed);");
    let source = Source::new(text.as_bytes()).expect("a text");
    let compiled = compile_with(&source, Options { paper: true });
    let codes: Vec<&str> = compiled.diagnostics.iter().map(|found| found.code).collect();
    assert!(compiled.hir.is_some(), "{:?}", compiled.diagnostics);
    assert!(codes.iter().all(|code| !code.starts_with('E')), "{codes:?}");
    let lowered = compiled.lower(Unit::Ticks).expect("a whole cell");
    assert_eq!(lowered.cell.rules, Rules::PAPER);
    // By the paper's rules a rejection always has a penalty. If the port declares none, the penalty is a tick.
    let penalty = lowered.cell.ports[0].penalty.expect("a penalty");
    assert_eq!((penalty.length, penalty.literal), (Ticks(1), true));
    let plain = compile_with(&source, Options::default()).lower(Unit::Ticks).expect("a whole cell");
    assert_eq!((plain.cell.rules, plain.cell.ports[0].penalty), (Rules::DEFAULT, None));
}

#[test]
fn a_penalty_may_be_the_papers_on_one_port_alone() {
    let text = format!(
        "{HEAD}task a on na
  port p() usage = receive user_list = {{b}} time_out = 90 msec penalty = paper 5 msec;
  port q() usage = receive user_list = {{b}} time_out = 90 msec penalty = 5 msec;
begin receive p(); receive q(); end a;
task b on nb use_port p() usage = send; use_port q() usage = send; begin use_send p(); use_send q(); end b;
"
    );
    let lowered = whole(&text).lower(Unit::Ticks).expect("a whole cell");
    let literal: Vec<_> = lowered.cell.ports.iter().map(|port| port.penalty.expect("one").literal).collect();
    assert_eq!((literal, lowered.cell.rules), (vec![true, false], Rules::DEFAULT));
}

#[test]
fn a_meeting_by_the_papers_rules_has_no_margin() {
    let text = format!(
        "{HEAD}task a on na port m() usage = waitfor user_list = {{b}} time_out = 90 msec; begin waitfor m(); end a;
task b on nb use_port m() usage = waitfor; begin waitfor m(); end b;
"
    );
    let source = Source::new(text.as_bytes()).expect("a text");
    let lowered = compile_with(&source, Options { paper: true }).lower(Unit::Ticks).expect("a whole cell");
    let port = &lowered.cell.ports[0];
    assert_eq!((port.margin, port.resend, port.losses), (Some(Ticks::ZERO), Ticks::FAR, 0));
    let mut virtual_cell = begun(&lowered);
    virtual_cell.run(30);
    assert!(virtual_cell.log().iter().all(|line| line.ends_with("Finished")), "both met");
}

#[test]
fn who_says_no_order_hears_of_it() {
    let text = |order: &str| {
        format!(
            "{HEAD}task a on na
  port q() -> int8 usage = response user_list = {{b}} time_out = 90 msec penalty = 20 msec;
begin
  {order}
  on query q() do response(1); end;
  delay 1 sec;
end a;
task b on nb use_port q() usage = query; var n: int8; begin query q() -> n on time_out do n := -1; end; delay 1 sec; end b;
"
        )
    };
    let notes = |text: &str| all_found(text).into_iter().filter(|found| found.starts_with("N202")).count();
    let answered = |text: &str, by| {
        let mut virtual_cell = virtual_cell(text);
        virtual_cell.run(by);
        virtual_cell.var("b", "n") == 1
    };
    let (unsaid, first, last) = (text(""), text("order q > self;"), text("order self > q;"));
    assert_eq!([&unsaid, &first, &last].map(|text| notes(text)), [1, 0, 0]);
    assert_eq!([&unsaid, &first, &last].map(|text| answered(text, 10)), [false, true, false]);
    assert_eq!([&unsaid, &last].map(|text| answered(text, 40)), [true, true], "after the penalty");
}

#[test]
fn handlers_alone_are_served_for_ever() {
    let text = format!(
        "{HEAD}task a on na
  port q() -> int8 usage = response user_list = {{b}} time_out = 90 msec;
begin on query q() do response(1); end; end a;
task b on nb use_port q() usage = query; var n: int8; begin
  delay 100 msec; query q() -> n; delay 2 sec; query q() -> n; n := n + 10; delay 1 sec; end b;
"
    );
    let mut virtual_cell = virtual_cell(&text);
    virtual_cell.run(2_300);
    assert_eq!(virtual_cell.var("b", "n"), 11);
}
