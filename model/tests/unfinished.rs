//! What a search reports while it runs, and what it says of states that it left because a budget ended.

use crate::cells::{Text, within};
use imrs_model::cell::{Coverage, FoundSoFar, Phase, SearchProgress, SoFar, Times, check_cell_and_tell};
use std::cell::RefCell;
use std::sync::Arc;

/// Two presses whose actions take intervals, and a counter that counts on for ever.
const HALL: &str = "cell hall;\ntick 1 msec;\nnode floor;\nnode office;\nlink floor -- office delay 2 msec;\n\
    task press_a on floor\nuse_port part() usage = send;\nbegin\n\
    loop run press takes 70..110 msec; use_send part(); end;\nend press_a;\n\
    task press_b on floor\nuse_port part() usage = send;\nbegin\n\
    loop run press takes 130..190 msec; use_send part(); end;\nend press_b;\n\
    task counter on office\nport part() usage = receive user_list = {press_a, press_b} time_out = 100 msec \
    bounded_buffer[2];\nvar grams: int16; var none: int16;\nbegin\n\
    loop receive part(); grams := grams + 30; none := 0; end;\nend counter;\n";

/// Records what the search reports.
#[derive(Default)]
struct Told(RefCell<Vec<String>>);

impl SearchProgress for Told {
    fn started(&self, (phase, hypothesis): (Phase, usize), times: Times) {
        self.0.borrow_mut().push(format!("started {phase:?} {hypothesis} {times:?}"));
    }
    fn states(&self, so_far: &SoFar) {
        assert!(so_far.open <= so_far.states, "{so_far:?}");
        let mut told = self.0.borrow_mut();
        if told.last().is_none_or(|last| last != "states") {
            told.push("states".into());
        }
    }
    fn found(&self, found: &FoundSoFar<'_>) {
        assert!(found.place.is_some());
        self.0.borrow_mut().push(format!("found {:?}", found.kind));
    }
    fn finished(&self, coverage: &Coverage) {
        self.0.borrow_mut().push(format!("finished {:?} {}", coverage.phase, coverage.hypothesis));
    }
}

#[test]
fn a_search_that_a_budget_ends_names_what_makes_the_cell_large() {
    let mut hall = Text::new(HALL);
    hall.plan.budget = within(6_000);
    hall.plan.times = Times::Every;
    let verdicts = hall.check();
    let [phase] = &verdicts.phases[..] else { panic!("{:?}", verdicts.phases) };
    let left = phase.unfinished.as_ref().expect("states are left");
    assert!(!phase.complete && 0 < left.open && left.open < phase.states, "{left:?}");
    assert!(0 < left.sampled && left.sampled <= phase.states, "{left:?}");
    assert!(
        0 < left.apart_from_times && left.apart_from_times < left.sampled,
        "times make it large, too: {left:?}"
    );

    for times in [Times::Ends, Times::Zones] {
        hall.plan.times = times;
        let verdicts = hall.check();
        let phase = &verdicts.phases[0];
        let left = phase.unfinished.as_ref().expect("states are left");
        assert!(!phase.complete && 0 < left.open && left.open < phase.states, "{times:?}: {left:?}");
        assert!(left.apart_from_times <= left.sampled, "{times:?}: {left:?}");
        let named: Vec<_> = left.variables.iter().map(|of| (of.task.index(), of.name.as_str())).collect();
        assert_eq!(named, [(2, "grams")], "{times:?}: {left:?}");
        assert!(left.variables[0].values >= 8, "{times:?}: {left:?}");
    }
}

#[test]
fn a_search_by_zones_that_a_budget_ends_says_how_many_of_its_states_it_expanded() {
    let mut hall = Text::new(HALL);
    (hall.plan.budget, hall.plan.times) = (within(500), Times::Zones);
    let verdicts = hall.check();
    let [phase] = &verdicts.phases[..] else { panic!("{:?}", verdicts.phases) };
    let left = phase.unfinished.as_ref().expect("states are left");
    // The budget counts the states that are expanded.
    assert_eq!((phase.states - left.open, phase.whole_depth), (500, 0), "{phase:?}");
}

#[test]
fn a_search_at_the_ends_says_how_far_the_search_by_zones_before_it_came() {
    let mut hall = Text::new(HALL);
    (hall.plan.budget, hall.plan.times) = (within(500), Times::Auto);
    let verdicts = hall.check();
    let [phase] = &verdicts.phases[..] else { panic!("{:?}", verdicts.phases) };
    let finer = phase.finer.as_ref().expect("zones were tried before");
    assert_eq!((phase.times, finer.times, finer.complete), (Times::Ends, Times::Zones, false), "{phase:?}");
    let left = finer.unfinished.as_ref().expect("states are left");
    assert_eq!(finer.states - left.open, 500, "{finer:?}");
}

#[test]
fn a_complete_search_leaves_nothing() {
    let text = HALL.replace("loop receive part(); grams := grams + 30;", "loop receive part(); grams := 30;");
    let mut hall = Text::new(&text);
    hall.plan.times = Times::Ends;
    let verdicts = hall.check();
    assert!(verdicts.phases[0].complete && verdicts.phases[0].unfinished.is_none(), "{:?}", verdicts.phases);
}

#[test]
fn a_search_tells_when_it_begins_what_it_finds_and_when_it_ends() {
    let text = HALL.replace("grams := grams + 30;", "grams := grams + 30; assert grams < 300;");
    let mut hall = Text::new(&(text + "faults loss 1;\n"));
    hall.plan.times = Times::Ends;
    let told = Told::default();
    let verdicts = check_cell_and_tell(&Arc::new(hall.plan), &told);
    assert_eq!(verdicts.phases.len(), 2);
    let told = told.0.into_inner();
    let told: Vec<&str> = told.iter().map(String::as_str).collect();
    let phase = |name: &str| {
        ["started", "states", "found", "states", "finished"].map(|what| match what {
            "started" => format!("started {name} 0 Ends"),
            "found" => "found Assertion".into(),
            "finished" => format!("finished {name} 0"),
            other => other.to_owned(),
        })
    };
    assert_eq!(told, [phase("FaultFree"), phase("Faults")].concat());
}
