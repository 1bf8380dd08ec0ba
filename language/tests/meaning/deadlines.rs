//! Tests of deadlines: link delays, the work for an answer, and help lines that satisfy all checks of durations.

use super::{all_found, source};
use imrs_language::compile;
use imrs_protocol::CellTable;
use proptest::prelude::*;

/// `a` asks `b`, whose node is `links` links of 2 msec away. The tick is 1 msec.
fn asks(links: usize, port: &str, a: &str, b: &str) -> String {
    let nodes = ["na", "nr", "ns", "nb"];
    let on = if links == 0 { "na" } else { nodes[links] };
    let mut text = String::from("cell c; tick 1 msec;");
    nodes.iter().for_each(|node| text += &format!(" node {node};"));
    nodes.windows(2).for_each(|ends| text += &format!(" link {} -- {} delay 2 msec;", ends[0], ends[1]));
    text + &format!(
        "\ntask a on na port q() {port} user_list = {{b}}; begin {a} end a;\n\
         task b on {on} use_port q() usage = {}; {b} end b;\n",
        if port.contains("query") { "response" } else { "receive" }
    )
}

const ASK: &str = "loop query q() on time_out do skip; end on refused do skip; end; end;";

/// The findings about durations, for a query with this time_out and with this answer.
fn of_query(links: usize, time_out: u64, answer: &str) -> Vec<String> {
    let text = asks(links, &format!("usage = query time_out = {time_out} msec"), ASK, answer);
    all_found(&text).into_iter().filter(|found| !found.starts_with("N201")).collect()
}

/// The least time_out without E201, and the least time_out without both E201 and W318.
#[track_caller]
fn limits(links: usize, answer: &str) -> (u64, u64) {
    let first = |code: &str| {
        let is = |found: &String| found.starts_with(code) || found.starts_with("E");
        (1..200).find(|&t| !of_query(links, t, answer).iter().any(is)).expect("a time_out that is enough")
    };
    let certain =
        (1..200).find(|&t| !of_query(links, t, answer).iter().any(|found| found.starts_with("E201")));
    (certain.expect("a time_out that is long enough"), first("W318"))
}

#[test]
fn the_way_counts_with_each_link_and_ticks_only_warn() {
    let handler = "begin order q > self; on query q() do response(); end;";
    // The route takes 2, 4 or 6 msec in each direction. On each link, in each direction, a node may also act a tick late,
    // but need not.
    assert_eq!([1, 2, 3].map(|links| limits(links, handler)), [(5, 7), (9, 13), (13, 19)]);
    // Within one node there is no link delay: the least time_out is four ticks.
    assert_eq!(limits(0, handler), (1, 4));
}

#[test]
fn the_work_of_an_answer_counts() {
    let on = |body: &str| {
        limits(
            1,
            &format!(
                "var x: bool; begin order q > self; on query q() do {body} end; loop run turn -> x takes 5 msec; end;"
            ),
        )
    };
    assert_eq!(on("run look takes 10..30 msec; response();"), (15, 37));
    assert_eq!(on("delay 10 msec; run look takes 1..2 msec; response();"), (16, 19));
    // Statements that come after the answer, or in an optional branch, do not count.
    assert_eq!(on("response(); run look takes 10..30 msec;"), (5, 7));
    assert_eq!(on("if x then run look takes 10..30 msec; end; response();"), (5, 7));
    assert_eq!(on("if x then delay 9 msec; response(); else delay 12 msec; response(); end;"), (14, 16));
    assert_eq!(on("while x do delay 50 msec; end; response();"), (5, 7));
    assert_eq!(on("loop delay 8 msec; if x then exit; end; end; response();"), (13, 15));
    assert_eq!(on("run look takes 10..30 msec on failed do skip; end; response();"), (5, 7));
    assert_eq!(on("atomic delay 8 msec; end; response();"), (13, 15));
}

#[test]
fn what_a_receive_takes_is_answered_behind_it() {
    let body =
        |body: &str| limits(1, &format!("var x: bool; begin loop run turn -> x takes 1 msec; {body} end;"));
    assert_eq!(body("receive q(); delay 10 msec; response();"), (15, 17));
    assert_eq!(body("receive; delay 10 msec; response();"), (15, 17));
    assert_eq!(body("receive q(); if x then delay 10 msec; end; response();"), (5, 7));
    // The message is answered in the next iteration of the loop.
    assert_eq!(body("if x then response(); end; receive q(); delay 10 msec;"), (16, 18));
    assert_eq!(body("receive q(); response q() for a; delay 10 msec;"), (5, 7), "answered whenever it likes");
}

#[test]
fn an_answer_that_asks_somebody_waits_for_that() {
    let text = |time_out: u64| {
        format!(
            "cell c; tick 1 msec; node na; node nb; link na -- nb delay 2 msec;
            task a on na port q() usage = query user_list = {{b}} time_out = {time_out} msec;
            begin {ASK} end a;
            task b on nb use_port q() usage = response;
            port r() usage = query user_list = {{d}} time_out = 90 msec;
            begin order q > self; on query q() do query r(); response(); end; end b;
            task d on na use_port r() usage = response;
            begin order r > self; on query r() do delay 20 msec; response(); end; end d;"
        )
    };
    let short = |time_out| all_found(&text(time_out)).iter().any(|found| found.starts_with("E201"));
    // The links between b and d may be quicker than declared: only the `delay` is certain.
    assert_eq!([24, 25].map(short), [true, false]);
    let nobody = text(90).replace(
        "on query r() do delay 20 msec; response(); end;",
        "on query r() do query q2(); response(); end;",
    );
    let ring = nobody
        .replace("use_port r()", "port q2() usage = query user_list = {b} time_out = 90 msec; use_port r()");
    let ring = ring.replace(
        "use_port q() usage = response;",
        "use_port q() usage = response; use_port q2() usage = response;",
    );
    let ring =
        ring.replace("order q > self;", "order q > self; on query q2() do query r(); response(); end;");
    assert!(!all_found(&ring).iter().any(|found| found.starts_with("E201")), "{:?}", all_found(&ring));
}

#[test]
fn a_status_needs_the_way_there_and_within_is_a_time_out() {
    let send = |time_out: u64| {
        let text = asks(
            3,
            &format!("usage = send time_out = {time_out} msec"),
            "loop send q(); delay 9 msec; end;",
            "begin loop receive q(); end;",
        );
        all_found(&text).into_iter().filter(|found| !found.starts_with("N201")).collect::<Vec<_>>()
    };
    assert_eq!(send(6), ["E201 `6 msec`"]);
    assert_eq!(send(7), ["W318 `7 msec`"]);
    assert_eq!(send(9), ["W318 `9 msec`"]);
    assert_eq!(send(10), [""; 0]);
    let within = ASK.replace("q()", "q() within 14 msec");
    let text = asks(
        1,
        "usage = query time_out = 90 msec",
        &within,
        "begin order q > self; on query q() do run look takes 10 msec; response(); end;",
    );
    assert_eq!(all_found(&text), ["E201 `14 msec`"]);
    assert_eq!(all_found(&text.replace("14 msec", "17 msec")), [""; 0]);
}

#[test]
fn the_shortest_time_out_of_a_sender_is_meant() {
    let text = "cell c; tick 1 msec; node na; node nb; link na -- nb delay 2 msec;
        task a on na port q() usage = response user_list = {b, d} time_out = 90 msec;
        begin order q > self; on query q() do delay 20 msec; response(); end; end a;
        task b on nb use_port q() usage = query time_out = 24 msec; begin loop query q() on time_out do skip; end on refused do skip; end; end; end b;
        task d on nb use_port q() usage = query; begin loop query q() on time_out do skip; end on refused do skip; end; end; end d;";
    assert_eq!(all_found(text), ["E201 `24 msec`"]);
    let found = compile(&source(text)).diagnostics.remove(0);
    assert_eq!(found.message, "deadline cannot be met: `q` b -> a -> b takes 24 msec, it has 24 msec");
    assert_eq!(found.primary.text, "must exceed 2 x 2 msec on the links + 20 msec for the answer = 24 msec");
    assert_eq!(found.help, ["give it 27 msec or more"]);
}

#[test]
fn who_is_never_asked_needs_no_time() {
    let text = |asked: &str| {
        format!(
            "cell c; tick 1 msec; node na; node nb; link na -- nb delay 1 msec;
            task a on na port q() usage = query user_list = {{b, d}} time_out = 40 msec;
            begin loop query q({asked}) on time_out do skip; end; end; end a;
            task b on nb use_port q() usage = response; begin order q > self; on query q() do response(); end; end b;
            task d on nb use_port q() usage = response;
            begin order q > self; on query q() do run look takes 50 msec; response(); end; end d;"
        )
    };
    assert_eq!(all_found(&text("b")), [""; 0]);
    assert_eq!(all_found(&text("d")), ["E201 `40 msec`"]);
    assert_eq!(all_found(&text("")), ["E201 `40 msec`"]);
}

/// The duration that a help line such as `give it 27 msec or more` offers, and the duration that it replaces.
fn offered(text: &str) -> Option<(String, String)> {
    let source = source(text);
    let found = compile(&source).diagnostics;
    let found = found.iter().find(|found| ["E201", "E206", "W318"].contains(&found.code))?;
    let help = found.help.iter().find_map(|help| help.strip_prefix("give it ")?.split(" or ").next())?;
    Some((source.slice(found.primary.span).to_owned(), help.to_owned()))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    /// A user who follows the help is done: no check of a time_out reports the changed cell, and the protocol's table
    /// accepts it.
    #[test]
    fn who_follows_the_help_is_done(
        (tick, delay, least) in (1_u64..3_000, 0_u64..9_000, 0_u64..9_000),
        (time_out, retry, resend) in (1_u64..60_000, 0_u8..4, prop::option::of(1_u64..9_000)),
        usage in prop::sample::select(vec!["query", "waitfor", "send", "send class = 2"]),
    ) {
        let other = match usage { "query" => "response", "waitfor" => "waitfor", _ => "receive" };
        let (a, b) = match usage {
            "query" => ("query q() on time_out do skip; end;", "on query q() do run look takes LEAST usec; response(); end;"),
            "waitfor" => ("waitfor q() on time_out do skip; end;", "waitfor q() on time_out do skip; end;"),
            "send" => ("send q();", "on receive q() do skip; end;"),
            _ => ("send q() on time_out do skip; end;", "on receive q() do delay LEAST usec; reply(); end;"),
        };
        let repeats = match (usage, resend) {
            ("send", _) => String::new(),
            (_, None) => format!("retry = {retry}"),
            (_, Some(resend)) => format!("retry = {retry} resend = {resend} usec"),
        };
        let b = b.replace("LEAST", &least.to_string());
        let text = format!(
            "cell c; tick {tick} usec; node na; node nb; link na -- nb delay {delay} usec;
            task a on na port q() usage = {usage} user_list = {{b}} time_out = {time_out} usec {repeats}; begin {a} end a;
            task b on nb use_port q() usage = {other}; begin {b} end b;"
        );
        let Some((wrong, right)) = offered(&text) else { return Ok(()) };
        let mended = text.replacen(&format!("time_out = {wrong}"), &format!("time_out = {right}"), 1);
        prop_assert!(mended != text, "{}", text);
        prop_assert_eq!(offered(&mended), None, "{} became {}", text, right);
        let compiled = compile(&source(&mended));
        let lowered = compiled.lower(imrs_language::Unit::Microseconds);
        prop_assert!(lowered.is_some_and(|lowered| CellTable::new(lowered.cell).is_ok()), "{}", mended);
    }
}
