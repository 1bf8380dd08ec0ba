//! Tests of conditions: their meaning for rows and cells, and the errors for invalid texts.

use crate::common::{Stage, ms};
use imrs_monitor::name::Name;
use imrs_monitor::query::{Assertion, EventRow, FIELDS, Filter, PortRow, Row, Scope, Value};
use imrs_monitor::store::Store;
use imrs_monitor::store::health::findings;
use imrs_monitor::theme::Theme;
use proptest::prelude::*;
use std::time::Duration;

const NOW: Duration = ms(1_000);

/// The ports that match a filter, as `node.task.port`.
fn taken(store: &Store, text: &str) -> Vec<String> {
    let filter = Filter::parse(text).unwrap().unwrap();
    let found = findings(store, &Name::new("beam-lift"), NOW);
    let mut taken = Vec::new();
    for incarnation in store.incarnations() {
        for task in incarnation.tasks() {
            for port in &task.view.ports {
                let row = PortRow { store, incarnation, task, port, findings: &found, now: NOW };
                if filter.takes(&row) {
                    let task = incarnation.names.task(task.view.task);
                    taken.push(format!(
                        "{}.{task}.{}",
                        incarnation.node,
                        incarnation.names.port_name(port.port)
                    ));
                }
            }
        }
    }
    taken
}

/// The table of fields says which fields rows and events have. Exactly these fields have values.
#[test]
fn a_field_has_values_where_its_scope_says() {
    let mut stage = Stage::busy(Theme::ASCII);
    stage.lose(NOW, 2);
    let store = stage.app.store();
    let events = store.journal().lines(true, "");
    for info in FIELDS {
        let is_there = |value: Value<'_>| value != Value::Missing;
        let of_events = events.iter().any(|&entry| is_there(EventRow { entry, now: NOW }.field(info.field)));
        let of_rows = store.incarnations().iter().any(|incarnation| {
            incarnation.tasks().iter().any(|task| {
                task.view.ports.iter().any(|port| {
                    let row = PortRow { store, incarnation, task, port, findings: &[], now: NOW };
                    is_there(row.field(info.field))
                })
            })
        });
        // In the sample cell no port has served enough for a service time, and nothing is wrong with one.
        let of_rows = of_rows || matches!(info.name, "service" | "rate" | "code");
        let known = match info.scope {
            Scope::Rows => (true, false),
            Scope::Events => (false, true),
            Scope::Both => (true, true),
        };
        assert_eq!((of_rows, of_events), known, "{}", info.name);
    }
}

#[test]
fn filters_pick_ports_by_what_they_have() {
    let stage = Stage::cell(Theme::ASCII);
    let store = stage.app.store();
    assert_eq!(taken(store, "slack<20ms and class=2"), ["nr.armR.beat"]);
    assert_eq!(taken(store, "fill>30%"), ["nr.armR.beat"]);
    assert_eq!(taken(store, "usage=send and node=nl"), ["nl.armL.beat"]);
    assert_eq!(
        taken(store, "usage = send or (usage = receive and node = nl)"),
        ["nl.armL.beat", "nl.armL.halt", "nh.hoist.halt"]
    );
    assert_eq!(taken(store, "not task~arm"), ["nh.hoist.lift", "nh.hoist.halt"]);
    assert_eq!(taken(store, "beat"), ["nl.armL.beat", "nr.armR.beat"]);
    assert_eq!(taken(store, "armr && !lift"), ["nr.armR.beat", "nr.armR.halt"]);
    assert_eq!(taken(store, "health=warning"), ["nr.armR.beat"]);
    // A missing slack is less than no value, and unequal to every value.
    assert_eq!(taken(store, "slack<10s"), ["nr.armR.beat"]);
    assert_eq!(taken(store, "slack!=7ms").len(), 7);
    assert_eq!(Filter::parse("  ").unwrap(), None);
}

#[test]
fn what_is_no_condition_is_told_where_and_what_would_be_right() {
    let error = |text: &str| Filter::parse(text).unwrap_err().to_string();
    assert_eq!(
        error("slack<20"),
        "at column 7: `20` cannot be compared with `slack`: write a time, as 20ms, 5us or 1.5s"
    );
    assert_eq!(
        error("len<5ms"),
        "at column 5: `5ms` cannot be compared with `len`: write a number, as 3 or 80%"
    );
    assert_eq!(error("slak<20ms"), "at column 1: no field `slak`: did you mean `slack`?");
    assert!(error("colour=3").contains("there are cell, node, task"));
    assert_eq!(error("len>"), "at column 5: what `len` is compared with was expected here");
    assert_eq!(error("(len>3"), "at column 7: `)` is missing here");
    assert_eq!(error("len>3 len<9"), "at column 7: `and`, `or` or the end was expected here");
    assert_eq!(error("len~3"), "at column 5: `~` looks into texts, and `len` is none");
    assert_eq!(error("node=\"nl"), "at column 6: a text that begins here is not closed");
    assert_eq!(error("a and"), "at column 6: a condition was expected here");
    assert!(error(&"(".repeat(100)).contains("nested too deeply"));
    let error = |text: &str| text.parse::<Assertion>().unwrap_err().to_string();
    assert_eq!(error("node=nl"), "at column 1: `node` is a text of each row: write count(node=...)");
    assert_eq!(error("up"), "at column 3: a comparison was expected here, as in `up < 3`");
}

#[test]
fn assertions_speak_of_whole_cells() {
    let mut stage = Stage::cell(Theme::ASCII);
    let beam = [Name::new("beam-lift")];
    let held = |stage: &Stage, text: &str, at: Duration| {
        let held = text.parse::<Assertion>().unwrap().holds(stage.app.store(), &beam, at);
        (held.holds, held.values.join(", "))
    };
    assert_eq!(held(&stage, "up>=3 and nodes=3", NOW), (true, "up = 3, nodes = 3".to_owned()));
    assert_eq!(held(&stage, "min_slack>5ms", NOW), (true, "min(slack) = 7ms".to_owned()));
    assert!(!held(&stage, "min(slack)>5ms", ms(1_004)).0);
    assert_eq!(held(&stage, "expired==0", NOW), (false, "expired = 16".to_owned()));
    assert!(held(&stage, "max(len)=3 and sum(len)=3", NOW).0);
    assert_eq!(held(&stage, "count(class=2 and fill>30%)=1", NOW), (true, "count(...) = 1".to_owned()));
    assert!(held(&stage, "critical=0 or findings=0", NOW).0);
    stage.lose(ms(1_050), 2);
    assert_eq!(held(&stage, "up>=3", ms(1_060)), (false, "up = 2".to_owned()));
    assert!(!held(&stage, "critical=0", ms(1_060)).0);
    // Without queued messages the least slack counts as infinite.
    let nothing = "min_slack>5ms".parse::<Assertion>().unwrap().holds(&Store::default(), &[], NOW);
    assert_eq!((nothing.holds, nothing.values.join(", ")), (true, "min(slack) = nothing".to_owned()));
}

#[test]
fn every_field_can_be_asked_for_under_its_name() {
    for info in FIELDS {
        let literal = match info.kind {
            imrs_monitor::query::Kind::Number => "1",
            imrs_monitor::query::Kind::Time => "1ms",
            imrs_monitor::query::Kind::Text => "word",
        };
        assert!(Filter::parse(&format!("{}={literal}", info.name)).is_ok(), "{}", info.name);
    }
}

proptest! {
    #[test]
    fn no_text_makes_the_parser_panic(text in "\\PC{0,40}") {
        let _ = Filter::parse(&text);
        let _ = text.parse::<Assertion>();
    }

    #[test]
    fn no_words_of_the_language_make_it_panic(words in proptest::collection::vec("and|or|not|\\(|\\)|len|slack|=|<|3|5ms|nl|count", 0..12)) {
        let text = words.join(" ");
        let _ = Filter::parse(&text);
        let _ = text.parse::<Assertion>();
    }
}
