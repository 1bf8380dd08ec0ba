//! Each code about names and types, with the place at which its diagnostic points. Each fault is reported once.

use super::{BEAM_LIFT, WELD, compile, found, source, whole};

const HEAD: &str = "cell c; tick 1 msec; node na; node nb; link na -- nb delay 1 msec;
type Pos is record x: int16; ok: bool; end;
";

/// A cell of two tasks: `a` owns the ports, `b` uses them.
fn pair(ports: &str, a: &str, uses: &str, b: &str) -> String {
    format!("{HEAD}task a on na {ports} {a} end a;\ntask b on nb {uses} {b} end b;\n")
}

const SEND: &str = "port p(v: Pos) usage = send user_list = {b} time_out = 50 msec;";
const RECEIVE: &str = "use_port p(v: Pos) usage = receive;";
const ASK: &str = "port q(v: Pos) -> bool usage = response user_list = {b} time_out = 50 msec;";
const QUERY: &str = "use_port q(v: Pos) usage = query;";

#[track_caller]
fn check(text: &str, expected: &[&str]) {
    assert_eq!(found(text), expected, "in:\n{text}");
}

/// Checks the body of task `a`, which owns `p` (send) and `q` (response); a task `b` uses them.
#[track_caller]
fn body(a: &str, expected: &[&str]) {
    check(&pair(&format!("{SEND} {ASK}"), a, &format!("{RECEIVE} {QUERY}"), "begin"), expected);
}

#[track_caller]
fn user(b: &str, expected: &[&str]) {
    check(&pair(&format!("{SEND} {ASK}"), "begin", &format!("{RECEIVE} {QUERY}"), b), expected);
}

#[test]
fn what_is_right_has_no_fault() {
    body(
        "var v: Pos; var t: timer; begin on query q(v) do response(true); end; on expiry t do skip; end; start t 5 msec; send p(v);",
        &[],
    );
    user(
        "var v: Pos; var ok: bool; begin loop receive p(v); query q(v) -> ok on time_out do skip; end; end;",
        &[],
    );
}

#[test]
fn e101_two_things_of_one_name() {
    check(&format!("{HEAD}node na;"), &["E101 `na`"]);
    check(&format!("{HEAD}type Pos is record y: real; end;"), &["E101 `Pos`"]);
    check(&format!("{HEAD}type T is record y: real; y: bool; end;"), &["E101 `y`"]);
    check(&format!("{HEAD}tick 2 msec;"), &["E101 `tick 2 msec`"]);
    check(
        &format!(
            "{HEAD}task a on na begin end a; task a on nb port p() usage = send time_out = 5 msec; begin end a; task b on nb use_port p() usage = receive; begin end b;"
        ),
        &["E101 `a`"],
    );
    body("var x: int8; var x: real; begin", &["E101 `x`"]);
    body("begin on query q(u, u) do response(true); end;", &["E101 `u`"]);
    check(
        &format!("{HEAD}task a on na var x: bool; begin end a; check c: never a.x; check c: always a.x;"),
        &["E101 `c`"],
    );
}

#[test]
fn e102_names_of_nothing() {
    check(&format!("{HEAD}task a on nx begin end a;"), &["E102 `nx`"]);
    check(&format!("{HEAD}link na -- nc delay 1 msec;"), &["E102 `nc`"]);
    check(&format!("{HEAD}task a on na var p: Poss; begin p.x := 1; p.y := 2; end a;"), &["E102 `Poss`"]);
    check(
        &format!("{HEAD}task a on na use_port nil() usage = send; begin use_send nil(); end a;"),
        &["E102 `nil`"],
    );
    check(&format!("{HEAD}couple tight {{a, b}};"), &["E102 `a`", "E102 `b`"]);
    body("begin x := 1;", &["E102 `x`"]);
    body("var v: Pos; begin v.z := 1;", &["E102 `z`"]);
    body("begin send r(1);", &["E102 `r`"]);
    body("begin start t 5 msec;", &["E102 `t`"]);
    body("begin order p > z > self;", &["E102 `z`"]);
    body("begin if sender = z then skip; end;", &["E102 `z`"]);
    body("begin if outcome = lost then skip; end;", &["E102 `lost`"]);
    check(&format!("{HEAD}task a on na begin end a; check c: never a.x;"), &["E102 `x`"]);
    check(&format!("{HEAD}faults cut na--na;"), &["E102 `na--na`"]);
    check(&format!("{HEAD}faults crash zz;"), &["E102 `zz`"]);
    check(&format!("{HEAD}faults pause zz up to 5 msec;"), &["E102 `zz`"]);
    let help = &compile(&source(&format!("{HEAD}task a on ma begin end a;"))).diagnostics[0].help;
    assert_eq!(help[..], ["did you mean `na`?"]);
}

#[test]
fn e103_a_port_of_two_owners() {
    let text =
        pair(SEND, "begin", "port p(v: Pos) usage = receive user_list = {a} time_out = 5 msec;", "begin");
    check(&text, &["E103 `p`"]);
}

#[test]
fn e105_usages_that_do_not_fit() {
    check(
        &pair(SEND, "begin", "use_port p(v: Pos) usage = response;", "begin"),
        &["E105 `usage = response`"],
    );
    check(&pair(ASK, "begin", "use_port q(v: Pos) usage = send;", "begin"), &["E105 `usage = send`"]);
}

#[test]
fn e106_and_e107_lists_and_uses() {
    let text = format!(
        "{HEAD}task a on na {SEND} begin end a; task b on nb {RECEIVE} begin end b; task d on nb {RECEIVE} begin receive p(); end d;"
    );
    check(&text, &["E106 `p`"]);
    check(&pair(SEND, "begin", "", "begin"), &["E107 `b`"]);
    check(
        &pair(SEND, "begin", RECEIVE, "begin")
            .replace("task b", "task e on nb begin receive p(); end e; task b"),
        &["E106 `p`"],
    );
    check(&pair(SEND, "use_port p(v: Pos) usage = receive; begin", RECEIVE, "begin"), &["E106 `p`"]);
    let module = pair(&SEND.replace("{b}", "{m}"), "begin", RECEIVE, "begin")
        .replace("task b on nb", "task b on nb module m");
    check(&module, &[]);
    let more = format!("{module}task d on nb module m begin end d;");
    check(&more, &["E107 `m`"]);
}

#[test]
fn e108_the_ends_disagree() {
    check(&pair(SEND, "begin", "use_port p(v: int8) usage = receive;", "begin"), &["E108 `p`"]);
    check(
        &pair(SEND, "begin", "use_port p(v: Pos) usage = receive class = 2;", "begin"),
        &["E108 `class = 2`"],
    );
    check(&pair(ASK, "begin", "use_port q(v: Pos) -> int8 usage = query;", "begin"), &["E108 `int8`"]);
    let format = "port p(v: int8) usage = send message_format = Pos user_list = {b} time_out = 50 msec;";
    check(&pair(format, "begin", RECEIVE, "begin"), &["E108 `Pos`"]);
}

#[test]
fn e109_too_few_or_too_many() {
    body("begin send p(1);", &["E109 `1`"]);
    body("var v: Pos; begin send p(v, 1);", &["E109 `v, 1`"]);
    body("begin on query q(a, b, d) do response(true); end;", &["E109 `a, b, d`"]);
    body("begin on query q(v) do response(); end;", &["E109 `response()`"]);
    user("var x: int8; begin receive p(x);", &["E109 `x`"]);
}

#[test]
fn e110_messages_that_are_too_long() {
    let fields: String = (0..60).map(|i| format!("f{i}: int32; ")).collect();
    let scan = format!("{HEAD}type Scan is record {fields}end;");
    let text = format!(
        "{scan}task a on na port p(s: Scan) usage = send user_list = {{b}} time_out = 90 msec; begin end a; task b on nb use_port p(s: Scan) usage = receive; begin end b;"
    );
    check(&text, &["E110 `p`"]);
    let meet = "port m(a: int32, b: int32, d: bool) usage = waitfor user_list = {b} time_out = 90 msec;";
    check(
        &pair(meet, "begin", "use_port m(a: int32, b: int32, d: bool) usage = waitfor;", "begin"),
        &["E110 `m`"],
    );
    let query = "port q() -> Scan usage = response user_list = {b} time_out = 90 msec;";
    let text = pair(query, "begin", "use_port q() usage = query;", "begin").replace(HEAD, &scan);
    check(&text, &["E110 `Scan`"]);
}

#[test]
fn e111_options_that_do_not_fit() {
    let port = |options: &str, usage: &str| {
        let (owner, user) = match usage {
            "response" => ("response", "query"),
            "waitfor" => ("waitfor", "waitfor"),
            _ => ("send", "receive"),
        };
        let port = format!("port p() usage = {owner} user_list = {{b}} time_out = 50 msec {options};");
        pair(&port, "begin", &format!("use_port p() usage = {user};"), "begin")
    };
    check(&port("class = 1", "response"), &["E111 `class = 1`"]);
    check(&port("class = 1", "waitfor"), &["E111 `class = 1`"]);
    check(&port("class = 3", "send"), &["E111 `3`"]);
    check(&port("retry = 2", "send"), &["E111 `2`"]);
    check(&port("bounded_buffer[0]", "send"), &["E111 `0`"]);
    check(&port("bounded_buffer[2]", "waitfor"), &["E111 `2`"]);
    check(&port("time_out = 9 msec", "send"), &["E111 `time_out = 9 msec`"]);
    check(&port("rate = 0/1 sec", "send"), &["E111 `0`"]);
    check(
        &pair(SEND, "begin", "use_port p(v: Pos) usage = receive bounded_buffer[2];", "begin"),
        &["E111 `bounded_buffer[2]`"],
    );
    check(&pair(SEND, "begin", "use_port p(v: Pos) usage = receive retry = 2;", "begin"), &["E111 `2`"]);
    check(&format!("{HEAD}model tick 1500 usec;"), &["E111 `1500 usec`"]);
}

#[test]
fn e112_types() {
    body("var x: int8; begin x := 300;", &["E112 `300`"]);
    body("var x: int8; begin x := 100 + 100;", &["E112 `100 + 100`"]);
    body("var x: int8; begin x := 1.5;", &["E112 `1.5`"]);
    body("var x: real; begin x := 3; x := x * 2 + 1;", &[]);
    body("var x: bool; begin x := 1;", &["E112 `1`"]);
    body("var x: int8; begin if x then skip; end;", &["E112 `x`"]);
    body("var x: int8; begin if not x then skip; end;", &["E112 `x`"]);
    body("var x: bool; begin if x > true then skip; end;", &["E112 `x`"]);
    body("var x: int8; begin x := x / (2 - 2);", &["E112 `x / (2 - 2)`"]);
    body("var x: int8; begin x := 7 / (2 - 2);", &["E112 `7 / (2 - 2)`"]);
    body("var v: Pos; begin v := 1;", &["E112 `1`"]);
    body("var v: Pos; begin if v = 1 then skip; end;", &["E112 `v`"]);
    body("var x: int8; begin x.y := 1;", &["E112 `y`"]);
    body("begin send p(true, true);", &["E112 `true`"]);
    user("var r: real; var b: bool; begin receive p(r, b);", &["E112 `r`"]);
    check(&format!("{HEAD}task a on na var x: int8; begin end a; check c: never a.x;"), &["E112 `a.x`"]);
}

#[test]
fn e113_statements_that_cannot_be_here() {
    body("begin query p(1, true);", &["E113 `p`"]);
    body("begin use_send p(1, true);", &["E113 `p`"]);
    user("begin send p(1, true);", &["E113 `p`"]);
    body("begin receive p();", &["E113 `p`"]);
    body("begin waitfor p();", &["E113 `p`"]);
    body("begin reply();", &["E113 `reply()`"]);
    user("begin receive p(); reply();", &["E113 `reply()`"]);
    body("begin exit;", &["E113 `exit`"]);
    body("begin p := 1;", &["E113 `p`"]);
    body("begin send p(a, 1, true);", &["E113 `a`"]);
    body("var t: timer; begin on expiry t do skip; end; t := 4;", &["E113 `t`"]);
    body("begin on receive q(v) do skip; end;", &["E113 `q`"]);
    body("begin on query q() do response(true); end; receive q();", &["E113 `q`"]);
    body("begin on silence p 5 msec do skip; end;", &["E113 `p`"]);
    body("begin send p(1, true) on time_out do skip; end;", &["E113 `on time_out`"]);
    user("begin receive p() on time_out do skip; end;", &["E113 `on time_out`"]);
    user("begin receive p() within 5 msec on time_out do skip; end;", &[]);
    body("begin delay 5 msec on failed do skip; end;", &["E113 `on failed`"]);
    let text = pair(SEND, "begin", RECEIVE, "begin")
        .replace("task b on nb", "task b on nb extern")
        .replace("begin end b", "begin skip; end b");
    check(&text, &["E113 `skip`"]);
}

#[test]
fn e114_one_action_of_two_shapes() {
    body("begin run lift 1; run lift 2, 3;", &["E114 `lift`"]);
    body("var x: bool; var y: int8; begin run look -> x; run look -> y; run look;", &["E114 `look`"]);
}

#[test]
fn e115_two_handlers_for_one_thing() {
    let two = "on query q() do response(true); end;";
    let text = format!("begin {two} {two}");
    let found = found(&pair(&format!("{SEND} {ASK}"), &text, &format!("{RECEIVE} {QUERY}"), "begin"));
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(found[0].starts_with("E115 `on query q()"), "{found:?}");
}

#[test]
fn e116_takeovers_and_couples() {
    body("begin skip; takeover skip;", &["E116 `a`"]);
    check(&WELD.replace(" standby of r1", ""), &["E116 `r2`"]);
    check(
        &format!("{HEAD}task a on na begin end a; task b on nb standby of a begin takeover skip; end b;"),
        &["E116 `a`"],
    );
    let mutual = WELD.replace("r1 -> r2", "r1 <-> r2");
    check(&mutual, &["E116 `r1`"]);
}

#[test]
fn e118_timers() {
    body("var t: timer; begin start t 5 msec;", &["E118 `t`"]);
    let many: String = (0..9).map(|i| format!("var t{i}: timer; ")).collect();
    let handlers: String = (0..9).map(|i| format!("on expiry t{i} do skip; end; ")).collect();
    body(&format!("{many} begin {handlers}"), &["E118 `t8`"]);
}

#[test]
fn e119_orders() {
    body("begin order p > self > p;", &["E119 `p`"]);
    let timers = "var w: timer; var v: timer; begin order ORDER; start w 5 msec; start v 5 msec; on expiry w do skip; end; on expiry v do skip; end;";
    for order in ["timer > p > self", "w > p > self > v", "w > self > timer", "p > TIMER"] {
        body(&timers.replace("ORDER", order), &[]);
    }
    let tasks: String = (0..9).map(|i| format!("task t{i} on na begin end t{i}; ")).collect();
    let order: Vec<String> = (0..9).map(|i| format!("t{i}")).collect();
    check(&format!("{HEAD}{tasks}task a on na begin order {}; end a;", order.join(" > ")), &["E119 `t8`"]);
}

#[test]
fn e120_what_is_missing() {
    check("cell c; node n;", &["E120 `c`"]);
    check(
        &pair("port p() usage = send user_list = {b};", "begin", "use_port p() usage = receive;", "begin"),
        &["E120 `p`"],
    );
    check(
        &pair(
            "port p() user_list = {b} time_out = 5 msec;",
            "begin send p();",
            "use_port p() usage = receive;",
            "begin receive p();",
        ),
        &["E120 `p`"],
    );
    check(
        &format!("{HEAD}task a on na port p() usage = send time_out = 5 msec; begin end a;"),
        &["E120 `p`"],
    );
}

#[test]
fn e121_and_e122_things_that_are_joined() {
    check(&format!("{HEAD}link na -- na delay 1 msec;"), &["E121 `na`"]);
    let again = found(&format!("{HEAD}link nb -- na delay 2 msec;"));
    assert!(matches!(&again[..], [one] if one.starts_with("E121 `link nb")), "{again:?}");
    check(&pair(&SEND.replace("{b}", "{b, b}"), "begin", RECEIVE, "begin"), &["E121 `b`"]);
    check(&WELD.replace("via alive", "via prog"), &["E122 `prog`"]);
    check(
        &WELD.replace(
            "couple loose",
            "couple work r2 -> r1 lease 100 msec takeover 400 msec every 20 msec via alive; couple loose",
        ),
        &["E116 `r1`", "E116 `r1`", "E122 `r2`", "E122 `r1`", "E122 `alive`"],
    );
}

#[test]
fn what_heartbeats_carry_is_assigned() {
    check(&WELD.replace("loop receive prog(p); end;", "loop receive prog(p); p := alive; end;"), &[]);
    check(
        &WELD.replace("loop receive prog(p); end;", "loop receive prog(p); g := alive; end;"),
        &["E109 `g`"],
    );
    check(
        &WELD.replace("loop receive prog(p); end;", "loop receive prog(p); query alive(p) -> p; end;"),
        &["E113 `alive`"],
    );
}

#[test]
fn e123_and_e124_limits_and_intervals() {
    body("begin run x takes 5..3 msec;", &["E124 `5..3`"]);
    body("var x: int8; begin run look -> x in 5 .. 3;", &["E124 `5 .. 3`"]);
    let long = "x := x + 1; ".repeat(14_000);
    body(&format!("var x: int8; begin {long}"), &["E123 `a`"]);
    let deep = format!("{}a.x{}", "(true and ".repeat(40), ")".repeat(40));
    let found = found(&format!("{HEAD}task a on na var x: bool; begin end a; check c: never {deep};"));
    assert!(matches!(&found[..], [one] if one.starts_with("E123 ")), "{found:?}");
}

#[test]
fn what_the_table_refuses_stands_on_its_line() {
    let short = pair(&ASK.replace("50 msec", "2 msec"), "begin", QUERY, "begin");
    check(&short, &["E201 `2 msec`"]);
    let far = pair(SEND, "begin", RECEIVE, "begin").replace("link na -- nb delay 1 msec;", "");
    check(&far, &["E205 `p`"]);
    check(&WELD.replace("lease 100 msec", "lease 40 msec"), &["E306 `40 msec`"]);
    check(&WELD.replace("takeover 400 msec", "takeover 300 msec"), &["E305 `300 msec`"]);
    let wraps = SEND.replace("time_out = 50 msec", "time_out = 60 sec rate = 60000/1 msec");
    check(&pair(&wraps, "begin", RECEIVE, "begin"), &["E304 `1 msec`"]);
    let meet = BEAM_LIFT.replace("resend = 50 msec", "resend = 1200 msec");
    check(&meet, &["E201 `2 sec`"]);
}

#[test]
fn a_fault_is_said_once() {
    // The port itself is wrong, so uses of the port are not reported, too.
    let text = pair(
        "port p(v: Poss) usage = send user_list = {b} time_out = 5 msec;",
        "var x: Poss; begin send p(x); x.y := 1;",
        "use_port p(v: Poss) usage = receive;",
        "begin receive p();",
    );
    assert_eq!(found(&text), ["E102 `Poss`"]);
    // Ten faults in ten places give ten findings.
    let ten = format!(
        "{HEAD}task a on nx begin x := 1; exit; send no(1); delay 5 msec; end a; task b on nb var t: timer; var p: Poss; begin reply(); if 1 then skip; end; run f takes 4..2 sec; assert 5; end b;"
    );
    assert_eq!(found(&ten).len(), 10, "{:?}", found(&ten));
}

#[test]
fn the_examples_compile() {
    whole(BEAM_LIFT);
    whole(WELD);
}
