//! Handlers: they interrupt a script, nest, and let it resume; statements say at which points handlers may run (R16, D15).

use super::fake::*;
use imrs_protocol::script::*;
use imrs_protocol::*;

const SECOND: PortId = PortId(4);
const HELD: TimeId = TimeId(0);

/// A script with handlers for `ASK`, for a timer and for `SECOND`. The handler for `ASK` keeps the message, and answers
/// with its contents after a delay.
fn with_handlers(fusing: Fusing, body: impl FnOnce(&mut ProgramBuilder)) -> Rig {
    let mut b = ProgramBuilder::new("test");
    let heard = b.variable("heard", Type::Int8);
    b.timer("held");
    body(&mut b);
    b.end();
    b.on_message(ASK, &[("b", Type::Int8)], |b, fields| {
        b.delay(Ticks(2)).statement().load(fields[0]).store(heard).reply(&[(Type::Int8, fields[0])]);
    });
    b.handler(Trigger::Timer(HELD), |b| {
        b.set(heard, 99);
    });
    b.on_message(SECOND, &[("x", Type::Int16), ("y", Type::Bool)], |b, _| {
        b.run("stop_now", Ticks(1), Ticks(8));
    });
    Rig::of(Program { fusing, ..b.finish().expect("a checked program") })
}

fn fused(body: impl FnOnce(&mut ProgramBuilder)) -> Rig {
    with_handlers(Fusing::Fused, body)
}

/// Accepts the registrations of the handlers, and the first boundary (the point between two statements where
/// handlers may run).
fn begun(rig: &mut Rig) -> Vec<String> {
    assert_eq!(rig.begin(), ["handle P0 true"]);
    assert_eq!(rig.accept(), ["handle P4 true"]);
    assert_eq!(rig.accept(), ["boundary"]);
    rig.accept()
}

#[test]
fn a_handler_runs_while_the_thread_waits_and_the_wait_goes_on() {
    let mut rig = fused(|b| {
        b.receive(TELL, None, &[]);
    });
    assert_eq!(begun(&mut rig), ["get P1"]);
    assert_eq!(rig.tell(call(ASK, 1, &[5])), ["delay 2 2"], "its delay is not the thread's");
    assert_eq!((rig.script.depth(), rig.script.position()), (1, 7));
    assert_eq!(rig.tell(Signal::TimeOut(TimeId(2))), ["boundary"]);
    assert_eq!(rig.accept(), ["reply P0 T7 [5]"]);
    assert_eq!(rig.accept(), ["return"]);
    assert_eq!((rig.script.depth(), rig.script.var(0)), (0, Some(5)));
    assert_eq!(rig.tell(status(&[])), ["abandon", "ended Finished"]);
}

#[test]
fn a_variable_of_a_handler_begins_at_its_first_value_each_time() {
    let mut b = ProgramBuilder::new("test");
    let seen = b.variable("seen", Type::Int8);
    b.timer("held");
    b.delay(Ticks(50)).end();
    b.handler(Trigger::Timer(HELD), |b| {
        let own = b.local("own", Type::Int8);
        b.load(own).store(seen).set(own, 1);
    });
    let mut program = b.finish().expect("a checked program");
    program.handlers[0].locals[0].initial = 7;
    let mut rig = Rig::of(program);
    rig.begin();
    rig.accept();
    for _ in 0..2 {
        assert_eq!(rig.tell(Signal::Interrupt(Call::Timer(HELD))), ["return"]);
        assert_eq!(rig.script.var(0), Some(7));
    }
}

#[test]
fn handlers_nest_with_variables_of_their_own() {
    let mut rig = fused(|b| {
        b.delay(Ticks(50));
    });
    begun(&mut rig);
    rig.tell(call(ASK, 1, &[5]));
    assert_eq!(rig.tell(call(ASK, 2, &[6])), ["delay 3 2"], "the same handler again, above itself");
    assert_eq!(rig.tell(Signal::Interrupt(Call::Timer(HELD))), ["return"]);
    assert_eq!((rig.script.depth(), rig.script.var(0)), (2, Some(99)));
    rig.tell(Signal::TimeOut(TimeId(3)));
    assert_eq!(rig.accept(), ["reply P0 T7 [6]"]);
    assert_eq!((rig.accept(), rig.script.var(0)), (vec!["return".into()], Some(6)));
    rig.tell(Signal::TimeOut(TimeId(2)));
    rig.accept();
    assert_eq!((rig.accept(), rig.script.var(0)), (vec!["return".into()], Some(5)));
    assert_eq!(rig.tell(Signal::TimeOut(TimeId(1))), ["abandon", "ended Finished"]);
}

#[test]
fn a_call_may_come_at_a_boundary_and_another_after_it() {
    let mut rig = fused(|b| {
        b.delay(Ticks(1));
    });
    rig.begin();
    rig.accept();
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.tell(Signal::Interrupt(Call::Timer(HELD))), ["return"]);
    assert_eq!(rig.tell(Signal::Interrupt(Call::Timer(HELD))), ["return"]);
    assert_eq!(rig.accept(), ["delay 1 1"], "the statement begins once");
    let statements = &rig.said.statements;
    assert_eq!(statements.iter().filter(|&&at| at == 0).count(), 1, "{statements:?}");
}

#[test]
fn an_action_goes_on_while_a_handler_runs() {
    let mut rig = fused(|b| {
        b.run("weld", Ticks(9), Ticks(9)).delay(Ticks(1));
    });
    assert_eq!(begun(&mut rig), ["work", "run 0 [] at 0 takes 9..9"]);
    assert_eq!(rig.tell(call(SECOND, 1, &[1, 0, 1])), ["work", "run 1 [] at 1 takes 1..8"]);
    assert_eq!(rig.acted(0, true, 3), [""; 0], "kept");
    assert_eq!(rig.acted(1, true, 0), ["done"]);
    assert_eq!(rig.accept(), ["unanswered T7", "return", "done"]);
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["delay 1 1"]);
}

#[test]
fn the_end_of_an_action_and_a_call_may_cross() {
    let mut rig = fused(|b| {
        b.run("weld", Ticks(9), Ticks(9)).delay(Ticks(1));
    });
    begun(&mut rig);
    assert_eq!(rig.acted(0, true, 3), ["done"]);
    assert_eq!(rig.tell(call(ASK, 1, &[4])), [""; 0], "the handler begins when Done was turned away");
    assert_eq!(rig.tell(Signal::Fault(Fault::Busy)), ["delay 2 2"]);
    rig.tell(Signal::TimeOut(TimeId(2)));
    assert_eq!(rig.accept(), ["reply P0 T7 [4]"]);
    assert_eq!(rig.accept(), ["return", "done"]);
    // The second handler is called at once, before the activation below the first one runs.
    assert_eq!(rig.tell(Signal::Interrupt(Call::Timer(HELD))), [""; 0]);
    assert_eq!(rig.tell(Signal::Fault(Fault::Busy)), ["return", "done"]);
    assert_eq!(rig.accept(), ["boundary"]);
}

#[test]
fn fused_statements_ask_after_waits_and_what_changes_ranks() {
    let body = |b: &mut ProgramBuilder| {
        let x = b.variable("x", Type::Int8);
        b.set(x, 1).set(x, 2).order(&[Ranked::Own]).set(x, 3).delay(Ticks(1)).set(x, 4);
        b.send(TELL, Target::All, &[]).set(x, 5);
        b.statement().op(Op::Atomic(true)).set(x, 6).statement().op(Op::Atomic(false)).set(x, 7);
    };
    let answer = |rig: &mut Rig| {
        let (mut all, mut last) = (Vec::new(), rig.begin());
        while rig.script.activity() == Activity::Waits {
            let signal = if last == ["delay 1 1"] { Signal::TimeOut(TimeId(1)) } else { Signal::Accepted(0) };
            all.extend(last);
            last = rig.tell(signal);
        }
        all
    };
    let asked = answer(&mut fused(body));
    let after = ["boundary", "order [Own]", "boundary", "delay 1 1", "boundary", "send P1 All []"];
    assert_eq!(asked[2..8], after);
    assert_eq!(asked[8..], ["atomic true", "atomic false", "boundary"]);
    let every = answer(&mut with_handlers(Fusing::EveryStatement, body));
    let outside = |said: &[String]| said.iter().filter(|s| *s != "boundary").cloned().collect::<Vec<_>>();
    assert_eq!(outside(&every), outside(&asked));
    assert_eq!(every.iter().filter(|s| *s == "boundary").count(), 10, "all but the two in the section");
}

#[test]
fn without_handlers_no_statement_asks() {
    let mut rig = Rig::new(|b| {
        b.delay(Ticks(1)).delay(Ticks(1));
    });
    assert_eq!(rig.begin(), ["delay 0 1"]);
    assert_eq!(rig.tell(Signal::TimeOut(TimeId(0))), ["delay 0 1"]);
}

#[test]
fn an_abort_in_a_handler_ends_the_whole_task() {
    let mut b = ProgramBuilder::new("test");
    b.run("weld", Ticks(1), Ticks(9)).end();
    b.on_message(ASK, &[], |b, _| {
        b.abort("halt");
    });
    let mut rig = Rig::of(b.finish().expect("a checked program"));
    rig.begin();
    rig.accept();
    rig.accept();
    assert_eq!(rig.tell(call(ASK, 1, &[])), ["cut short 0", "unanswered T7", "abandon", "ended Aborted(0)"]);
    assert_eq!(rig.tell(Signal::Cancelled), [""; 0]);
}

#[test]
fn handlers_nest_only_so_deep() {
    let mut rig = fused(|b| {
        b.delay(Ticks(50));
    });
    begun(&mut rig);
    for _ in 1..MAX_THREADS {
        assert!(rig.tell(call(ASK, 1, &[5]))[0].starts_with("delay"));
    }
    let said = rig.tell(call(ASK, 1, &[5]));
    assert!(said.last().expect("said").contains("TooDeep"), "{said:?}");
}

#[test]
fn a_message_of_another_format_ends_the_task() {
    let mut rig = fused(|b| {
        b.delay(Ticks(50));
    });
    begun(&mut rig);
    assert_eq!(rig.tell(call(ASK, 1, &[5, 6]))[2], "ended Fault { fault: WrongContents, at: 5 }");
}
