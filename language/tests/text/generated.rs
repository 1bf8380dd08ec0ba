//! Texts made from the grammar: they parse without findings, and formatting them changes no meaning.

use super::{diagnostics, rendered, source};
use crate::support::bytes::formats;
use proptest::prelude::*;

/// Names in upper and lower case. Some of them are keywords that a cell may also use as names.
fn name() -> impl Strategy<Value = &'static str> {
    proptest::sample::select(vec![
        "a", "B2", "armL", "x_1", "Rate", "class", "stop", "FROM", "within", "order", "Silence",
    ])
}

fn duration() -> impl Strategy<Value = String> {
    (1..500_u32, proptest::sample::select(vec!["usec", "msec", "SEC"]))
        .prop_map(|(n, unit)| format!("{n} {unit}"))
}

fn expr() -> BoxedStrategy<String> {
    let place = (name(), name()).prop_map(|(a, b)| format!("{a}.{b}"));
    let leaf = prop_oneof![
        name().prop_map(str::to_owned),
        place,
        Just("1_000".to_owned()),
        Just("2.5e1".to_owned()),
        Just("TRUE".to_owned())
    ];
    let operators = ["+", "-", "*", "/", " mod ", "=", "<>", "<", "<=", ">", ">=", " and ", " or "];
    let more = move |inner: BoxedStrategy<String>| {
        prop_oneof![
            (inner.clone(), proptest::sample::select(operators.to_vec()), inner.clone())
                .prop_map(|(a, operator, b)| format!("({a}){operator}({b})")),
            (inner.clone(), inner.clone()).prop_map(|(a, b)| format!("({a})+-({b})*- -1 <2")),
            inner.prop_map(|a| format!("(NOT({a}))")),
        ]
    };
    leaf.prop_recursive(3, 12, 2, more).boxed()
}

fn statement() -> BoxedStrategy<String> {
    let e = expr;
    let simple = prop_oneof![
        (name(), e(), e()).prop_map(|(a, b, c)| format!("send {a}({b},{c})")),
        (name(), name(), duration()).prop_map(|(a, b, c)| format!("Query {a}()->{b}.c,d within {c}")),
        (name(), name(), duration()).prop_map(|(a, b, c)| format!("receive {a}(x) from {b} within {c}")),
        Just("receive".to_owned()),
        (name(), e()).prop_map(|(a, b)| format!("reply {a}({b})")),
        e().prop_map(|a| format!("response({a})")),
        (name(), duration()).prop_map(|(a, b)| format!("waitfor {a}() within {b}")),
        (name(), name()).prop_map(|(a, b)| format!("ORDER {a}>SELF>{b}")),
        duration().prop_map(|a| format!("delay {a}")),
        (name(), e(), e()).prop_map(|(a, b, c)| format!("run {a} {b},{c} -> x in -1..5 takes 1..2 sec")),
        (name(), e(), e()).prop_map(|(a, b, c)| format!("run {a}({b},{c}) takes 5 msec .. 1 sec")),
        (name(), duration()).prop_map(|(a, b)| format!("start {a} {b}")),
        name().prop_map(|a| format!("stop {a}")),
        (name(), e()).prop_map(|(a, b)| format!("{a}:={b}")),
        Just("abort \"a  b\"".to_owned()),
        e().prop_map(|a| format!("assert {a}")),
    ];
    simple
        .prop_map(|text| text + ";")
        .prop_recursive(3, 24, 3, |inner| {
            let body = proptest::collection::vec(inner, 0..3).prop_map(|body| body.join("\n"));
            prop_oneof![
                (expr(), body.clone(), body.clone()).prop_map(|(a, b, c)| format!(
                    "if {a} then\n{b} elsif {a} then {c}\nelse\n\n\n{b}\nend;"
                )),
                (expr(), body.clone()).prop_map(|(a, b)| format!("WHILE {a}\ndo {b}\nend;")),
                body.clone().prop_map(|a| format!("loop\n{a} // c\nend;")),
                body.clone().prop_map(|a| format!("atomic {a} end;")),
                (name(), body).prop_map(|(a, b)| format!(
                    "send {a}()\non time_out do {b} end on Refused do\n{b}\nend;"
                )),
            ]
        })
        .boxed()
}

fn port() -> impl Strategy<Value = String> {
    let option = prop_oneof![
        Just("Usage=query".to_owned()),
        Just("usage = SEND".to_owned()),
        name().prop_map(|a| format!("message_format={a}")),
        (name(), name()).prop_map(|(a, b)| format!("user_list=({a} {b})")),
        (name(), name()).prop_map(|(a, b)| format!("user_list\n= {{ {a},{b} , }}")),
        duration().prop_map(|a| format!("time_out = {a}")),
        duration().prop_map(|a| format!("penalty = PAPER {a}")),
        duration().prop_map(|a| format!("rate = 3/ {a}")),
        Just("bounded_buffer [ 2 ]".to_owned()),
        Just("class=2 retry=1".to_owned()),
        Just("latest".to_owned()),
    ];
    let options = proptest::collection::vec(option, 0..5).prop_map(|options| options.join("\n"));
    (name(), name(), options).prop_map(|(a, b, options)| format!("PORT {a}({b}:int8,c)->{b} {options};\n"))
}

fn file() -> impl Strategy<Value = String> {
    let body = proptest::collection::vec(statement(), 0..6).prop_map(|body| body.join(" "));
    let ports = proptest::collection::vec(port(), 0..4).prop_map(|ports| ports.concat());
    let handler = prop_oneof![
        (name(), statement()).prop_map(|(a, b)| format!("on query {a}(x,y) do {b} end;")),
        (name(), expr(), statement())
            .prop_map(|(a, b, c)| format!("on silence {a} 3 msec when {b}\ndo\n{c}\nend;")),
        (name(), statement()).prop_map(|(a, b)| format!("on expiry {a} do {b} end; on fence do end;")),
    ];
    let check =
        (name(), expr(), expr()).prop_map(|(a, b, c)| format!("check {a}:({b})leads ({c})within 1 sec;"));
    (name(), name(), ports, handler, body.clone(), body, check).prop_map(
        |(task, node, ports, handler, body, takeover, check)| {
            format!(
                "cell c;type T is\nrecord number integer;\nx,y:Real;end task {task} ON {node}\n{ports}var a,b:timer;\n\
                 begin {handler}\n{body}\nTakeover {takeover}\nend {task};\n{check}"
            )
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn generated_texts_are_read_and_formatted(text in file()) {
        prop_assert_eq!(diagnostics(&text), [], "{}{}", rendered(&text), text);
        formats(&source(&text));
    }
}
