//! Tests of scripts that are fenced or take over (D61).

use super::fake::*;
use imrs_protocol::script::*;
use imrs_protocol::*;
use imrs_testkit::VirtualCell;

const FENCED: Signal = Signal::Interrupt(Call::Fenced);
const TAKE_OVER: Signal = Signal::Interrupt(Call::TakeOver(3));

fn welder(fence: bool, takeover: bool) -> Rig {
    let mut b = ProgramBuilder::new("test");
    let spot = b.variable("spot", Type::Int8);
    b.statement().op(Op::Lease).set(spot, 4).run("weld", Ticks(9), Ticks(9)).delay(Ticks(1)).end();
    b.on_message(ASK, &[], |b, _| {
        b.run("stop_now", Ticks(1), Ticks(1));
    });
    if fence {
        b.handler(Trigger::Fenced, |b| {
            b.run("retract", Ticks(2), Ticks(2));
        });
    }
    if takeover {
        b.takeover(|b| {
            b.run("recheck", Ticks(5), Ticks(5));
        });
    }
    let mut rig = Rig::of(b.finish().expect("a checked program"));
    let mut said = rig.begin();
    while said[0] != "lease" {
        said = rig.accept();
    }
    assert_eq!(rig.tell(Signal::Granted(2)), ["handle P0 true"], "its handler acts, and the lease is there");
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["work", "run 0 [] at 0 takes 9..9"]);
    rig
}

#[test]
fn who_waits_for_its_first_lease_does_not_act_in_handlers() {
    let mut rig = attentive(false);
    assert_eq!(rig.begin(), ["handle P0 true"]);
    assert_eq!(rig.accept(), ["handle P1 false"], "its handler acts");
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["lease"]);
    assert_eq!(rig.tell(call(ASK, 1, &[4])), ["start 0 3"], "it takes notice");
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["reply P0 T7 []"]);
    assert_eq!(rig.accept(), ["return"]);
    assert_eq!(rig.tell(Signal::Interrupt(Call::Timer(TimeId(0)))), ["return"], "no action begins");
    assert_eq!(rig.var(Slot::Task(1)), StatementOutcome::Fenced as i64);
    assert_eq!(rig.tell(Signal::Granted(2)), ["handle P1 true"], "with the lease it acts");
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["work", "run 0 [] at 0 takes 9..9"]);
}

#[test]
fn a_fence_cuts_the_action_short_and_the_thread_does_not_go_on() {
    let mut rig = welder(true, false);
    assert_eq!(rig.tell(FENCED), ["cut short 0", "work", "run 2 [] at 1 takes 2..2"]);
    assert_eq!(rig.acted(0, true, 0), [""; 0], "a late word of what was cut short");
    assert_eq!(rig.acted(1, true, 0), ["done"]);
    assert_eq!(rig.accept(), ["abandon", "ended Fenced"]);
}

#[test]
fn a_fence_without_a_handler_ends_the_task() {
    let mut rig = welder(false, false);
    assert_eq!(rig.tell(FENCED), ["cut short 0", "abandon", "ended Fenced"]);
}

#[test]
fn a_fence_stops_the_actions_of_handlers_too() {
    let mut rig = welder(false, false);
    assert_eq!(rig.tell(call(ASK, 1, &[])), ["work", "run 1 [] at 1 takes 1..1"]);
    assert_eq!(rig.tell(FENCED), ["cut short 0", "cut short 1", "unanswered T7", "abandon", "ended Fenced"]);
}

#[test]
fn who_can_take_over_waits_for_that_when_fenced() {
    let mut rig = welder(true, true);
    rig.tell(FENCED);
    rig.acted(1, true, 0);
    assert_eq!(rig.accept(), ["abandon"]);
    assert_eq!(rig.accept(), [""; 0], "what was asked before");
    assert_eq!(rig.tell(Signal::Cancelled), ["handle P0 false"], "its handler acts");
    assert_eq!(rig.accept(), ["lease"]);
    assert_eq!(rig.script.activity(), Activity::Passive);
    assert_eq!(rig.tell(TAKE_OVER), ["abandon"]);
    assert_eq!(rig.tell(Signal::Cancelled), ["handle P0 true"]);
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["work", "run 3 [] at 0 takes 5..5"]);
    assert_eq!(rig.script.var(0), Some(4), "variables stay: where to go on");
    rig.acted(0, true, 0);
    assert_eq!(rig.accept(), ["abandon", "ended Finished"]);
}

/// The script of a task of a work couple. Its handler for ASK records the message and starts a timer. Its handlers for TELL
/// and for the timer begin actions.
fn attentive(takeover: bool) -> Rig {
    let mut b = ProgramBuilder::new("test");
    let (said, outcome) = (b.variable("said", Type::Int8), b.variable("outcome", Type::Int8));
    let timer = b.timer("timer");
    b.statement().op(Op::Lease).run("weld", Ticks(9), Ticks(9)).end();
    b.on_message(ASK, &[("spot", Type::Int8)], |b, came| {
        b.statement().load(came[0]).store(said).start(timer, Ticks(3)).reply(&[]);
    });
    b.on_message(TELL, &[], |b, _| {
        b.statement().push(0).then(|b| {
            b.run("shout", Ticks(1), Ticks(1));
        });
    });
    b.handler(Trigger::Timer(timer), |b| {
        let action = b.action("beep");
        b.statement().push(7).op(Op::Run { action, arguments: 1, least: Ticks(1), most: Ticks(1) });
        b.op(Op::Outcome).store(outcome);
    });
    if takeover {
        b.takeover(|b| {
            b.run("recheck", Ticks(5), Ticks(5));
        });
    }
    Rig::of(b.finish().expect("a checked program"))
}

/// A rig of the script of a task that has been fenced, in a mutual couple.
fn passive() -> Rig {
    let mut rig = attentive(true);
    let mut said = rig.begin();
    while said[0] != "lease" {
        said = rig.accept();
    }
    rig.tell(Signal::Granted(2));
    rig.accept();
    rig.accept();
    assert_eq!(rig.tell(FENCED), ["cut short 0", "abandon"]);
    assert_eq!(rig.tell(Signal::Cancelled), ["handle P0 true"]);
    assert_eq!(rig.accept(), ["handle P1 false"]);
    assert_eq!(rig.accept(), ["lease"]);
    rig
}

#[test]
fn who_is_fenced_takes_notice_but_does_not_act() {
    let mut rig = passive();
    assert_eq!(rig.tell(call(ASK, 1, &[4])), ["start 0 3"]);
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["reply P0 T7 []"]);
    assert_eq!(rig.accept(), ["return"]);
    assert_eq!(rig.var(Slot::Task(0)), 4);
    assert_eq!(rig.tell(Signal::Interrupt(Call::Timer(TimeId(0)))), ["return"], "no action begins");
    assert_eq!(rig.var(Slot::Task(1)), StatementOutcome::Fenced as i64);
    assert_eq!(rig.script.activity(), Activity::Passive);
}

#[test]
fn who_was_fenced_acts_again_with_its_lease() {
    let mut rig = passive();
    assert_eq!(rig.tell(Signal::Granted(4)), ["abandon"]);
    assert_eq!(rig.tell(Signal::Cancelled), ["handle P0 true"]);
    assert_eq!(rig.accept(), ["handle P1 true"]);
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["work", "run 3 [] at 0 takes 5..5"]);
}

#[test]
fn who_will_never_hold_a_lease_again_ends() {
    let mut rig = passive();
    assert_eq!(rig.tell(Signal::Fault(Fault::Fenced)), ["abandon", "ended Fenced"]);
}

#[test]
fn a_fence_ends_an_atomic_section() {
    let mut b = ProgramBuilder::new("test");
    b.statement().op(Op::Lease).op(Op::Atomic(true)).run("weld", Ticks(9), Ticks(9));
    b.statement().op(Op::Atomic(false)).end();
    b.handler(Trigger::Fenced, |b| {
        b.run("retract", Ticks(2), Ticks(2));
    });
    let mut rig = Rig::of(b.finish().expect("a checked program"));
    rig.begin();
    rig.accept();
    rig.tell(Signal::Granted(2));
    assert_eq!(rig.accept(), ["work", "run 0 [] at 0 takes 9..9"]);
    assert_eq!(rig.tell(FENCED), ["cut short 0", "work", "run 1 [] at 1 takes 2..2"]);
    rig.acted(1, true, 0);
    assert_eq!(rig.accept(), ["abandon", "ended Fenced"]);
}

#[test]
fn a_take_over_drops_every_thread_whatever_it_does() {
    let mut rig = welder(false, true);
    rig.tell(call(ASK, 1, &[]));
    rig.acted(1, true, 0);
    assert_eq!(rig.tell(TAKE_OVER), ["cut short 0", "unanswered T7", "abandon"]);
    assert_eq!(rig.tell(Signal::Fault(Fault::Busy)), [""; 0], "of the Done that it crossed");
    assert_eq!(rig.tell(Signal::Cancelled), ["handle P0 true"]);
    assert_eq!(rig.script.depth(), 0);
}

#[test]
fn a_fence_without_a_handler_leaves_who_can_take_over() {
    let mut rig = welder(false, true);
    assert_eq!(rig.tell(FENCED), ["cut short 0", "abandon"]);
    rig.tell(Signal::Cancelled);
    assert_eq!(rig.accept(), ["lease"]);
    assert_eq!(rig.script.activity(), Activity::Passive);
}

const A: TaskId = TaskId(0);
const B: TaskId = TaskId(1);

/// Two robots of a mutual couple: each robot welds for ever while it may act. After a take-over a robot reads what the
/// other one published.
fn robots() -> VirtualCell {
    let mut cell = Cell::new("couple", Ticks(1));
    let nodes = ["na", "nb"].map(|name| cell.node(name));
    cell.link(nodes[0], nodes[1], Ticks(1));
    let [a, b] = [("a", nodes[0]), ("b", nodes[1])].map(|(name, node)| cell.task(name, node));
    let via = cell.port(PortDecl::new("alive", a, Usage::Response, &[b], Ticks(6)));
    cell.couples.push(CoupleDecl {
        primary: a,
        standby: b,
        lease: Ticks(14),
        takeover: Ticks(32),
        every: Ticks(4),
        via,
        trusted: false,
        mutual: true,
    });
    let welder = |name: &str, first: bool| {
        let mut b = ProgramBuilder::new(name);
        b.statement().op(if first { Op::Lease } else { Op::Delay(Ticks(9000)) });
        let (spot, said) = (b.variable("spot", Type::Int8), b.variable("said", Type::Int8));
        let spots = b.format(&[Type::Int8]);
        b.forever(|b| {
            b.run("weld", Ticks(5), Ticks(5)).set(spot, 4);
            b.statement().load(spot).op(Op::Publish { format: spots });
        });
        b.takeover(|b| {
            b.published(&[(Type::Int8, said)]);
            b.forever(|b| {
                b.run("weld on", Ticks(5), Ticks(5));
            });
        });
        b.finish().expect("a checked program")
    };
    let mut virtual_cell = VirtualCell::new(cell).begin([(A, welder("a", true)), (B, welder("b", false))]);
    virtual_cell.run(40);
    assert_eq!([A, B].map(|task| virtual_cell.task(task).is_active()), [true, false]);
    virtual_cell
}

#[test]
fn who_gets_its_lease_back_before_the_other_took_over_goes_on() {
    let mut virtual_cell = robots();
    virtual_cell.cut(NodeId(0), NodeId(1));
    virtual_cell.run(20);
    assert_eq!([A, B].map(|task| virtual_cell.task(task).is_active()), [false, false]);
    virtual_cell.mend();
    virtual_cell.log();
    virtual_cell.run(30);
    assert_eq!([A, B].map(|task| virtual_cell.task(task).is_active()), [true, false]);
    let log = virtual_cell.log();
    assert!(log.iter().any(|line| line.ends_with("a: weld on")), "who holds the lease works: {log:?}");
}

#[test]
fn the_roles_go_back_and_forth() {
    let mut virtual_cell = robots();
    for (acts, name, round) in [(B, "b", 1), (A, "a", 2), (B, "b", 3)] {
        virtual_cell.cut(NodeId(0), NodeId(1));
        virtual_cell.run(60);
        virtual_cell.log();
        virtual_cell.run(10);
        let log = virtual_cell.log();
        assert!(log.iter().all(|line| line.contains(&format!("{name}: weld on"))), "round {round}: {log:?}");
        assert!(!log.is_empty(), "round {round}");
        assert_eq!(virtual_cell.var_at(B, 1), 4, "what A published last");
        virtual_cell.mend();
        virtual_cell.run(60);
        assert!(virtual_cell.task(acts).is_active(), "round {round}");
    }
}
