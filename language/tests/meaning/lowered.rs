//! The operations to which statements are lowered.

use super::{BEAM_LIFT, WELD, whole};
use imrs_language::lower::{Behaviour, CheckKind, Script};
use imrs_language::{Lowered, Unit};
use imrs_protocol::script::{Op, Predicate, Term};
use imrs_protocol::{CellTable, PortId, TaskId, Ticks};

fn script<'l>(lowered: &'l Lowered, task: &str) -> &'l Script {
    let at = lowered.cell.tasks.iter().position(|decl| decl.name == task).expect("a task");
    match &lowered.tasks[at] {
        Behaviour::Script(script) => script,
        Behaviour::Extern(_) => panic!("`{task}` is extern"),
    }
}

/// The operations of a task, one a line. In front of the operations of a statement stands the first source line of that
/// statement.
fn listing(text: &str, unit: Unit, task: &str) -> String {
    let lowered = whole(text).lower(unit).expect("a whole cell");
    let script = script(&lowered, task);
    assert_eq!(script.spans.len(), script.program.code.len(), "a span for each operation");
    script.program.check().expect("a program");
    let mut lines = Vec::new();
    for (at, (op, span)) in script.program.code.iter().zip(&script.spans).enumerate() {
        let handler = script.program.handlers.iter().find(|handler| usize::from(handler.entry) == at);
        if let Some(handler) = handler {
            lines.push(format!("-- {:?}", handler.trigger));
        }
        if script.program.takeover.map(usize::from) == Some(at) {
            lines.push(String::from("-- takeover"));
        }
        let shown = match op {
            Op::Statement => text[span.range()].lines().next().unwrap_or_default().trim().to_owned(),
            other => format!("{at:>5} {other:?}"),
        };
        lines.push(shown);
    }
    lines.join("\n")
}

/// Compares a listing with `snapshots/meaning__lowered__NAME.snap`.
fn same_as_recorded(name: &str, listing: &str) {
    insta::with_settings!({ prepend_module_to_snapshot => false, omit_expression => true }, {
        insta::assert_snapshot!(format!("meaning__lowered__{name}"), listing);
    });
}

fn small(a: &str) -> String {
    format!(
        "cell c; tick 1 msec; node na; node nb; link na -- nb delay 1 msec;
type Pos is record x: int16; ok: bool; end;
task a on na
  port p(v: Pos) usage = send user_list = {{b, d}} time_out = 50 msec class = 2;
  port q(v: Pos) -> bool usage = response user_list = {{b, d}} time_out = 50 msec;
  port m() usage = waitfor user_list = {{b}} time_out = 90 msec;
{a}
end a;
task b on nb use_port p(v: Pos) usage = receive; use_port q(v: Pos) usage = query; use_port m() usage = waitfor; begin end b;
task d on nb use_port p(v: Pos) usage = receive; use_port q(v: Pos) usage = query; begin end d;
"
    )
}

#[test]
fn loops_conditions_and_branches() {
    let text = small(
        "  var v: Pos; begin
  loop
    waitfor m() on time_out do skip; end;
    run look v.x -> v.x in 0 .. 9 takes 1..2 msec;
    while v.ok do atomic if v.x > 3 then exit; elsif v.x < 1 then v.x := 2; else skip; end; end; end;
    send p(b, v) on refused do abort \"no\"; end;
  end;",
    );
    same_as_recorded("loops_conditions_and_branches", &listing(&text, Unit::Ticks, "a"));
}

#[test]
fn handlers_words_and_silences() {
    let text = small(
        "  var v: Pos; var lost: bool; begin
  order q > self;
  on query q(w) do if sender = b then response(true); else response(w.ok); end; v := w; end;
  on silence q 10 msec when v.ok do v.ok := false; end;
  send p(v) on time_out do if p.answered(d) and outcome = incomplete then lost := true; end; end;",
    );
    same_as_recorded("handlers_words_and_silences", &listing(&text, Unit::Microseconds, "a"));
}

#[test]
fn a_primary_waits_for_its_lease_and_a_standby_takes_over() {
    let lowered = whole(WELD).lower(Unit::Ticks).expect("a whole cell");
    let primary = &script(&lowered, "r1").program;
    assert_eq!(primary.code[0], Op::Lease);
    assert!(primary.code.iter().any(|op| matches!(op, Op::Publish { .. })));
    assert!(primary.takeover.is_none());
    let standby = &script(&lowered, "r2").program;
    assert!(standby.takeover.is_some() && !standby.code.contains(&Op::Lease));
    // The ports on which the couple commands other tasks are under its lease. The ports between the couple's own tasks are
    // not.
    let guards: Vec<_> = lowered.cell.ports.iter().map(|port| (port.name.as_str(), port.guard)).collect();
    assert_eq!(guards, [("grab", Some(0)), ("free", Some(0)), ("prog", None), ("alive", None)]);
}

#[test]
fn durations_are_rounded_to_the_tick_and_said() {
    let text = small("  var t: timer; begin on expiry t do skip; end; run go takes 12500..18500 usec; delay 12500 usec; start t 1 msec;")
        .replace("tick 1 msec;", "tick 1 msec; model tick 5 msec;")
        .replace("time_out = 90 msec", "time_out = 90500 usec");
    let compiled = whole(&text);
    let lowered = compiled.lower(Unit::Ticks).expect("a whole cell");
    let code = &script(&lowered, "a").program.code;
    assert!(
        code.iter().any(|op| matches!(op, Op::Run { least: Ticks(12), most: Ticks(19), .. })),
        "{code:?}"
    );
    assert!(code.contains(&Op::Delay(Ticks(13))));
    assert!(code.iter().any(|op| matches!(op, Op::Start { length: Ticks(1), .. })));
    assert_eq!(lowered.cell.ports[2].time_out, Ticks(90));
    // The notes are about the least and the most time of the action, the delay and the time_out. The `model tick` rounds
    // nothing.
    assert_eq!(lowered.notes.len(), 4, "{:?}", lowered.notes);
    let usec = compiled.lower(Unit::Microseconds).expect("a whole cell");
    assert!(usec.notes.is_empty());
    assert_eq!(usec.cell.ports[2].time_out, Ticks(90_500));
    assert_eq!(usec.cell.tick, Ticks(1_000));
}

#[test]
fn a_cell_has_a_table_in_both_units() {
    for text in [BEAM_LIFT, WELD] {
        for unit in [Unit::Microseconds, Unit::Ticks] {
            let lowered = whole(text).lower(unit).expect("a whole cell");
            assert!(lowered.notes.is_empty(), "{:?}", lowered.notes);
            CellTable::new(lowered.cell).expect("a table");
        }
    }
}

#[test]
fn actions_say_what_they_take_and_what_is_worth_trying() {
    let lowered = whole(BEAM_LIFT).lower(Unit::Ticks).expect("a whole cell");
    let actions = &script(&lowered, "armL").actions;
    let read = actions.iter().find(|action| action.name == "read_height").expect("an action");
    // The value of `me.height > 900` changes between 900 and 901.
    assert_eq!((read.values.clone(), read.arguments.len()), (vec![900, 901], 0));
    let lowered = whole(WELD).lower(Unit::Ticks).expect("a whole cell");
    let actions = &script(&lowered, "r1").actions;
    let shapes: Vec<_> = actions.iter().map(|a| (a.name.as_str(), a.arguments.len(), a.result)).collect();
    assert_eq!(shapes, [("dress", 0, None), ("inspect", 0, None), ("weld", 1, None)]);
}

#[test]
fn checks_are_expressions_over_the_cell() {
    let lowered = whole(BEAM_LIFT).lower(Unit::Ticks).expect("a whole cell");
    let CheckKind::Always(terms) = &lowered.checks[0].kind else { panic!("never is always not") };
    let arrived = Predicate::Arrived { port: PortId(0), task: TaskId(1) };
    assert!(terms.contains(&Term::Is(arrived)), "{terms:?}");
    assert!(terms.contains(&Term::Of { task: TaskId(0), variable: 1 }), "{terms:?}");
    assert_eq!(terms.last(), Some(&Term::Not));
    assert!(matches!(lowered.checks[1].kind, CheckKind::Leads { within: Ticks(25), .. }));
}

#[test]
fn one_variable_may_hold_several_silences() {
    let text = small(
        "  var v: Pos; var w: Pos; begin
  order q > self;
  on silence q 10 msec when v.ok do v.ok := false; end;
  on silence q 20 msec when v.ok and v.x > 3 do w := v; end;
  receive q(v) within 5 msec on time_out do if received = q then skip; end; end;
  response(v.ok);
  v := w; v.x := 4;",
    );
    // Both conditions are computed before and after each store, and the stack is empty when a timer starts.
    let listing = listing(&text, Unit::Ticks, "a");
    assert_eq!(listing.matches("Start { timer: TimeId(1)").count(), 6, "{listing}");
}

#[test]
fn both_tasks_of_a_mutual_couple_have_a_takeover() {
    let text = WELD
        .replace("r1 -> r2", "r1 <-> r2")
        .replace(
            "end r1;",
            "takeover loop receive free() within 5 msec on time_out do skip; end; end; end r1;",
        )
        .replace("receive free() within 5 msec on time_out do skip; end;", "delay 5 msec;");
    let lowered = whole(&text).lower(Unit::Ticks).expect("a whole cell");
    assert!(lowered.cell.couples[0].mutual);
    assert!(["r1", "r2"].iter().all(|task| script(&lowered, task).program.takeover.is_some()));
}
