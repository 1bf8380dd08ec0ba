//! Fences and take-overs (D61).

use super::fake::*;
use imrs_protocol::script::*;
use imrs_protocol::*;

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
    rig.tell(Signal::Granted(2));
    assert_eq!(rig.accept(), ["work", "run 0 [] at 0 takes 9..9"]);
    rig
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
    assert_eq!(rig.tell(Signal::Cancelled), ["handle P0 true"]);
    assert_eq!(rig.accept(), ["work"]);
    assert_eq!(rig.script.activity(), Activity::Passive);
    // Its handlers still run.
    assert_eq!(rig.tell(call(ASK, 1, &[])), ["work", "run 1 [] at 1 takes 1..1"]);
    rig.acted(1, true, 0);
    assert_eq!(rig.accept(), ["unanswered T7", "return"]);
    assert_eq!(rig.script.activity(), Activity::Passive);
    assert_eq!(rig.tell(TAKE_OVER), ["abandon"]);
    assert_eq!(rig.tell(Signal::Cancelled), ["handle P0 true"]);
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["work", "run 3 [] at 0 takes 5..5"]);
    assert_eq!(rig.script.var(0), Some(4), "variables stay: where to go on");
    rig.acted(0, true, 0);
    assert_eq!(rig.accept(), ["abandon", "ended Finished"]);
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
    assert_eq!(rig.accept(), ["work"]);
    assert_eq!(rig.script.activity(), Activity::Passive);
}
