//! Tests of each kind of finding in a cell: the statement at which the finding points, and cells without that finding.

use crate::cells::{Text, within};
use imrs_model::cell::{CellFaults, Finding, Kind, Phase, Shows, Times, Verdicts, scenes, svg};
use imrs_protocol::TaskId;
use imrs_wire::obs::Liveness;
use std::sync::Arc;

/// A cell of two tasks on two nodes, whose link delays a packet by at most one tick. Task `a` owns the ports in `ports`.
fn two(ports: &str, uses: &str, a: &str, b: &str, rest: &str) -> Text {
    Text::new(&two_text(ports, uses, a, b, rest))
}

fn two_text(ports: &str, uses: &str, a: &str, b: &str, rest: &str) -> String {
    format!(
        "cell two;\ntick 1 msec;\nnode na;  node nb;\nlink na -- nb delay 1 msec;\n\
         type Num is record n: int8; end;\n\
         task a on na\n{ports}\nvar x: int8; var m: Num;\nbegin\n{a}\nend a;\n\
         task b on nb\n{uses}\nvar y: int8; var m: Num;\nbegin\n{b}\nend b;\n{rest}\n"
    )
}

const MEET: &str = "port meet() usage = waitfor user_list = {b} time_out = 50 msec class = 2;";
const USE_MEET: &str = "use_port meet() usage = waitfor time_out = 50 msec;";

const PUT: &str =
    "port put(m: Num) usage = send message_format = Num user_list = {b} time_out = 20 msec class = 2;";
const USE_PUT: &str = "use_port put(m: Num) usage = receive;";
const TAKE: &str = "loop receive put(m); reply(); end;";

pub fn found(kind: Kind, at: &str) -> (Kind, String) {
    (kind, at.into())
}

/// The findings of a complete search of a cell.
pub fn all(text: &Text) -> Vec<(Kind, String)> {
    let verdicts = text.check();
    assert!(verdicts.is_complete());
    for finding in &verdicts.findings {
        let chart = &finding.chart;
        assert!(chart.lines().all(|line| line.chars().count() <= 78), "{chart}");
    }
    text.found(&verdicts)
}

#[test]
fn a_healthy_meeting_has_no_findings() {
    let act = "loop run work takes 5..20 msec; waitfor meet() on time_out do skip; end; end;";
    let cell = two(MEET, USE_MEET, act, act, "");
    let verdicts = cell.check();
    assert!(verdicts.is_complete() && verdicts.findings.is_empty());
    assert_eq!(verdicts.not_exercised.len(), 2, "without a fault no branch is taken");
    let verdicts = two(MEET, USE_MEET, act, act, "faults loss 2;").check();
    assert!(verdicts.is_complete() && verdicts.findings.is_empty());
    assert_eq!((verdicts.phases.len(), verdicts.not_exercised.len()), (2, 0));
}

#[test]
fn a_member_that_comes_too_late_strands_the_other() {
    let a = "loop run work takes 5..20 msec; waitfor meet() on time_out do skip; end; end;";
    let cell = two(
        MEET,
        USE_MEET,
        a,
        "loop run work takes 5..90 msec; waitfor meet() on time_out do skip; end; end;",
        "",
    );
    let verdicts = cell.check();
    let stranded = verdicts.of(Kind::Stranded).next().expect("stranded");
    assert!(cell.source(stranded).starts_with("waitfor meet()"));
    assert_eq!(stranded.cause, "a: waitfor `meet` waits in vain for b");
    assert_eq!((stranded.phase, stranded.at_ticks), (Phase::FaultFree, 55), "{}", stranded.chart);
}

#[test]
fn what_no_branch_takes_ends_the_task_under_faults_only() {
    let send = "loop send put(m); delay 10 msec; end;";
    assert_eq!(all(&two(PUT, USE_PUT, send, TAKE, "")), []);
    let cell = two(PUT, USE_PUT, send, TAKE, "faults loss 1;");
    let verdicts = cell.check();
    let [ends] = &verdicts.findings[..] else { panic!("{:?}", cell.found(&verdicts)) };
    assert_eq!((ends.kind, ends.phase), (Kind::Ends, Phase::Faults));
    assert!(cell.source(ends).starts_with("send put(m)") && ends.chart.contains("LOST"), "{}", ends.chart);
    let names = ["a".to_string(), "b<".to_string()];
    let drawn = svg(&names, ends.steps.iter().flat_map(|step| &step.notes), &ends.cause);
    assert!(drawn.starts_with("<svg") && drawn.contains("b&lt;") && drawn.contains("LOST"));
    let saved = serde_json::to_string(ends).expect("plain data");
    let back: Finding = serde_json::from_str(&saved).expect("what was saved");
    assert_eq!((back.moves, back.at_ticks), (ends.moves.clone(), ends.at_ticks));
}

#[test]
fn who_receives_too_slowly_lets_a_send_time_out() {
    let slow = "loop receive put(m); run work takes 1..40 msec; reply(); end;";
    let send = "loop send put(m) on time_out do skip; end; delay 100 msec; end;";
    let found_here = all(&two(PUT, USE_PUT, send, slow, ""));
    assert_eq!(found_here[0].0, Kind::TimeOut);
    assert!(found_here[0].1.starts_with("send put(m)"), "{found_here:?}");
}

#[test]
fn two_that_wait_for_each_other_are_a_deadlock() {
    let ports = format!(
        "{PUT} port got(m: Num) usage = receive message_format = Num user_list = {{b}} time_out = 20 msec class = 2;"
    );
    let uses = format!("{USE_PUT} use_port got(m: Num) usage = send time_out = 20 msec;");
    let a = "receive got(m); reply(); send put(m);";
    let cell = two(&ports, &uses, a, "receive put(m); reply(); use_send got(m);", "");
    let verdicts = cell.check();
    let deadlock = verdicts.of(Kind::Deadlock).next().expect("a deadlock");
    assert!(cell.source(deadlock).starts_with("receive got(m)"));
    assert_eq!(deadlock.cause, "a waits at receive `got` for b; b waits at receive `put` for a");
    // A server is at rest if it waits for more messages after its sender has ended.
    assert_eq!(all(&two(PUT, USE_PUT, "send put(m);", TAKE, "")), []);
}

#[test]
fn assertions_faults_and_aborts_point_at_their_statement() {
    let send = "loop send put(m) on time_out do skip; end; delay 10 msec; end;";
    let count =
        |body: &str| two(PUT, USE_PUT, send, &format!("loop receive put(m); reply(); {body} end;"), "");
    let kind_of = |body: &str| {
        let found = all(&count(body));
        found.into_iter().find(|(kind, _)| *kind != Kind::TimeOut).expect("a finding")
    };
    assert_eq!(kind_of("y := y + 1; assert y < 3;"), found(Kind::Assertion, "assert y < 3"));
    assert_eq!(kind_of("y := y + 50;").0, Kind::ScriptFault);
    let (kind, at) = kind_of("y := y + 1; if y > 2 then abort \"enough\"; end;");
    assert_eq!((kind, at.starts_with("abort")), (Kind::Aborts, true));
}

#[test]
fn checks_hold_fail_and_say_nothing() {
    let send = "loop x := 1; delay 5 msec; x := 0; send put(m); delay 10 msec; end;";
    let with = |check: &str| two(PUT, USE_PUT, send, TAKE, check);
    assert_eq!(all(&with("check c: never a.x > 1;")), []);
    assert_eq!(all(&with("check c: never a.x = 1;")), [found(Kind::Check, "")]);
    assert_eq!(all(&with("check c: a.x = 1 leads a.x = 0 within 5 msec;")), []);
    assert_eq!(all(&with("check c: a.x = 1 leads a.x = 0 within 4 msec;")), [found(Kind::Check, "")]);
    assert_eq!(all(&with("check c: a.x = 2 leads a.x = 0 within 4 msec;")), [found(Kind::Vacuous, "")]);
}

#[test]
fn a_statement_that_nothing_leads_to_is_unreached() {
    let send = "loop send put(m); if x > 0 then delay 3 msec; end; delay 10 msec; end;";
    let found_here = all(&two(PUT, USE_PUT, send, TAKE, ""));
    assert_eq!(found_here.len(), 1);
    assert!(found_here[0].0 == Kind::Unreached && found_here[0].1.starts_with("delay 3 msec"));
}

/// Results of an action are tried at both ends of their range, and on both sides of the constants with which the results
/// are compared. If a result is also used elsewhere, another value may lead to more statements. Then a statement that no
/// tried value reaches is not reported as superfluous, nor a check as vacuous.
#[test]
fn results_lead_to_every_branch_that_compares_them_and_elsewhere_perhaps() {
    let of = |range: &str, branch: &str, check: &str| {
        Text::new(&format!(
            "cell one;\ntick 1 msec;\nnode na;\ntask a on na\nvar k: int16; var y: bool;\nbegin\n\
             loop run look -> k {range} takes 1 msec; {branch} delay 5 msec; y := false; k := 0; end;\nend a;\n{check}\n"
        ))
    };
    let below = of("", "if k = 5 then skip; elsif k > 5 then skip; else y := true; end;", "");
    assert_eq!(all(&below), []);
    assert_eq!(below.check().not_tried, []);
    let never = of("", "if k = 5 and k > 5 then y := true; end;", "");
    assert!(matches!(&all(&never)[..], [(Kind::Unreached, at)] if at.starts_with("y := true")));
    let leads = "check c: a.k * 3 = 600 leads a.y within 3 msec;";
    let sum = of("in 0 .. 1000", "if k * 2 = 700 then y := true; end;", leads);
    assert_eq!(all(&sum), []);
    assert_eq!(sum.check().not_tried.len(), 1);
    // Both results of the action, 0 and 1, are tried. So the branch and the check that need 350 and 200 are reported.
    let few = of("in 0 .. 1", "if k * 2 = 700 then y := true; end;", leads);
    let kinds: Vec<Kind> = all(&few).into_iter().map(|(kind, _)| kind).collect();
    assert_eq!(kinds, [Kind::Unreached, Kind::Vacuous]);
}

/// A `receive` with a branch for its time_out expects that no message may come, even if the task then ends.
#[test]
fn a_receive_that_says_what_then_may_end_the_task() {
    let put = PUT.replace("class = 2", "class = 1");
    let kinds = |ends: &str| -> Vec<Kind> {
        let take = format!("receive put(m) within 10 msec {ends};");
        let found = all(&two(&put, USE_PUT, "run look takes 1..60 msec; send put(m);", &take, ""));
        found.into_iter().map(|(kind, _)| kind).collect()
    };
    assert_eq!(kinds("on time_out do skip; end"), []);
    assert_eq!(kinds(""), [Kind::TimeOut, Kind::Ends], "nobody says what then");
}

#[test]
fn an_action_that_fails_within_its_budget_ends_its_task() {
    let idle = "loop delay 50 msec; send put(m); end;";
    let b = "loop receive put(m); reply(); run work takes 1..2 msec; end;";
    let cell = two(PUT, USE_PUT, idle, b, "faults fail 1;");
    let found_here = all(&cell);
    assert!(
        found_here.iter().any(|(kind, at)| *kind == Kind::Ends && at.starts_with("run work")),
        "{found_here:?}"
    );
}

#[test]
fn a_node_that_crashes_and_a_link_that_is_cut_are_the_named_ones() {
    let send = "loop send put(m) on time_out do x := 1; delay 1 msec; x := 0; end; delay 10 msec; end;";
    let check = "check c: never a.x = 1;";
    let with = |faults: &str| {
        let verdicts = two(PUT, USE_PUT, send, TAKE, &format!("faults {faults};\n{check}")).check();
        verdicts.of(Kind::Check).next().map(|finding| finding.chart.clone())
    };
    assert!(with("crash nb").expect("b is gone").contains("CRASHES"));
    assert!(with("cut na--nb").expect("b is far").contains("CUT OFF"));
    assert!(with("dup 1").is_none());
}

/// Task `b` is held back for 21 ticks after a restart of its node, because `put` may still be in flight. Task `c` is held
/// back, too, only if it sends a command to `b`.
#[test]
fn after_a_restart_a_task_waits_for_its_own_ports_and_those_that_it_asks() {
    let early = |port: &str, uses: &str, answer: &str, ask: &str| {
        let send = "loop send put(m) on time_out do skip; end; delay 30 msec; end;";
        let rest = format!(
            "task c on nb\n{port}\nvar z: int8; var m: Num;\nbegin\ndelay 5 msec; z := 1; {ask}\nend c;\n\
             faults crash nb;\ncheck together: never c.z = 1 and b.y = 0;"
        );
        let take = format!("{answer} y := 1; {TAKE}");
        two(PUT, &format!("{USE_PUT} {uses}"), send, &take, &rest).check()
    };
    let alone = early("", "", "", "");
    let finding = alone.of(Kind::Check).next().expect("c begins before b").clone();
    assert!(alone.is_complete() && finding.chart.contains("CRASHES"), "{}", finding.chart);
    let ask = PUT.replace("put(", "ask(");
    let uses = "use_port ask(m: Num) usage = receive;";
    let answer = "order ask > self; on receive ask(m) do reply(); end;";
    let asks = early(&ask, uses, answer, "send ask(m) on time_out do skip; end;");
    assert!(asks.is_complete() && asks.of(Kind::Check).next().is_none());
}

#[test]
fn a_budget_that_ends_the_search_gives_a_part() {
    let act = "loop run work takes 5..20 msec; waitfor meet() on time_out do skip; end; end;";
    let mut cell = two(MEET, USE_MEET, act, act, "faults loss 2;");
    cell.plan.budget = within(20);
    let verdicts = cell.check();
    assert!(!verdicts.is_complete());
    let faults = &verdicts.phases[1];
    assert_eq!(faults.ended_by.as_deref(), Some("20 states"));
    assert!(verdicts.not_exercised.is_empty() && verdicts.of(Kind::Unreached).next().is_none());
}

#[test]
fn an_end_between_least_and_most_is_looked_at_without_faults() {
    // The check holds if the action ends after 5 or 60 ticks. It fails if the action ends while `y` is set, after 20 ticks.
    let a = "run work takes 5..60 msec; x := 1; delay 1 msec; x := 0;";
    let b = "delay 20 msec; y := 1; delay 1 msec; y := 0;";
    let mut cell = two(
        PUT,
        USE_PUT,
        &format!("{a} send put(m);"),
        &format!("{b} {TAKE}"),
        "check c: never a.x = 1 and b.y = 1;",
    );
    let has = |cell: &Text| cell.check().of(Kind::Check).next().is_some();
    cell.plan.times = Times::Ends;
    assert!(!has(&cell));
    cell.plan.times = Times::Auto;
    assert!(has(&cell));
}

#[test]
fn a_fixed_time_before_a_collision_needs_every_tick() {
    let a = "run drive takes 0..100 msec; delay 20 msec; x := 1; run pass takes 10 msec; x := 0;";
    let b = "delay 70 msec; y := 1; run pass takes 10 msec; y := 0;";
    let check = "check c: never a.x = 1 and b.y = 1;";
    let mut cell = two(PUT, USE_PUT, &format!("{a} send put(m);"), &format!("{b} {TAKE}"), check);
    let mut has = |times: Times, step: u32| {
        (cell.plan.times, cell.plan.step) = (times, step);
        let verdicts = cell.check();
        (verdicts.of(Kind::Check).next().is_some(), verdicts.phases[0].times)
    };
    assert_eq!(has(Times::Between, 1), (false, Times::Between));
    assert_eq!(has(Times::Every, 1), (true, Times::Every));
    assert_eq!(has(Times::Every, 5), (true, Times::Every), "45 is a multiple");
    assert_eq!(has(Times::Every, 50), (true, Times::Every), "50 is one, and meets at its end");
    assert_eq!(has(Times::Auto, 1), (true, Times::Every));
}

#[test]
fn a_packet_that_comes_sooner_than_its_bound_is_looked_at_without_faults() {
    let text = "cell early;\ntick 1 msec;\nnode na; node nb;\nlink na -- nb delay 20 msec;\n\
        task a on na\nport put() usage = send user_list = {b} time_out = 80 msec class = 2;\nbegin\n\
        send put() on time_out do skip; end;\nend a;\n\
        task b on nb\nuse_port put() usage = receive;\nvar ready, early: bool;\nbegin\n\
        on receive put() do early := not ready; reply(); end;\norder put > self;\n\
        delay 10 msec; ready := true; delay 100 msec;\nend b;\ncheck c: never b.early;\n";
    let mut cell = Text::new(text);
    let mut has = |times: Times| {
        cell.plan.times = times;
        cell.check().of(Kind::Check).next().is_some()
    };
    assert!(has(Times::Auto));
    assert!(!has(Times::Ends), "after 20 ticks it is ready");
}

#[test]
fn a_finding_replays() {
    let send = "loop send put(m); delay 10 msec; end;";
    let cell = two(PUT, USE_PUT, send, TAKE, "faults loss 1;");
    let (one, two) = (cell.check(), cell.check());
    let moves = |verdicts: &Verdicts| verdicts.findings.iter().map(|f| f.moves.clone()).collect::<Vec<_>>();
    assert_eq!(moves(&one), moves(&two));
    let ends = one.of(Kind::Ends).next().expect("it ends");
    assert_eq!(ends.moves.len(), ends.steps.len());
    assert_eq!(ends.steps.last().map(|step| step.tick), Some(ends.at_ticks));
    assert!(ends.steps.last().is_some_and(|step| step.tasks[0].does == "has ended"));
}

#[test]
fn a_query_may_not_last_longer_than_its_answer_takes() {
    let ports = "port ask(m: Num) -> Num usage = query message_format = Num user_list = {b} time_out = 20 msec class = 2;";
    let uses = "use_port ask(m: Num) -> Num usage = response time_out = 20 msec;";
    let a = "loop query ask(m) -> m on time_out do skip; end; delay 50 msec; end;";
    let b = "on query ask(q) do run look takes 1..30 msec; response(m); end;\nloop delay 10 msec; end;";
    let found_here = all(&two(ports, uses, a, b, ""));
    assert!(
        found_here.iter().any(|(kind, at)| *kind == Kind::TimeOut && at.starts_with("query ask")),
        "{found_here:?}"
    );
}

/// Other members read the values that a member brings to a meeting, even if a handler ran while they waited.
#[test]
fn what_members_bring_to_a_meeting_is_what_the_others_read() {
    let meet = MEET.replace("meet()", "meet(h: int8)");
    let uses = USE_MEET.replace("meet()", "meet(h: int8)");
    let tells = "run work takes 1..20 msec; waitfor meet(5) on time_out do skip; end;";
    let reads = "waitfor meet(7) on time_out do skip; end; if meet.told(b) and meet.h(b) = 5 then abort \"it knows\"; end; abort \"it does not\";";
    let verdicts = two(&meet, &uses, reads, tells, "").check();
    let [knows] = &verdicts.findings[..] else { panic!("{:?}", verdicts.findings) };
    assert_eq!(knows.kind, Kind::Aborts);
    assert!(knows.cause.contains("it knows"), "{}", knows.cause);

    let reads = format!(
        "var held: timer;\nbegin\non expiry held do run look takes 10 msec; end;\nstart held 15 msec; {reads}"
    );
    let text = two_text(&meet, &uses, "skip;", tells, "").replace("begin\nskip;", &reads);
    let verdicts = Text::new(&text).check();
    let told: Vec<&str> = verdicts.findings.iter().map(|finding| finding.cause.as_str()).collect();
    assert!(told.iter().any(|cause| cause.contains("it knows")), "{told:?}");
    assert!(!told.iter().any(|cause| cause.contains("it does not")), "{told:?}");
}

#[test]
fn faults_that_nobody_notices_change_no_finding() {
    let send = "loop send put(m) on time_out do x := 1; delay 1 msec; x := 0; end; delay 10 msec; end;";
    let meet = "loop run work takes 5..20 msec; waitfor meet() on time_out do x := 1; skip; end; end;";
    let other = meet.replace('x', "y");
    let cells = |faults: &str| {
        let rest = format!("faults {faults};\ncheck c: a.x = 1 leads b.y = 1 within 60 msec;");
        [two(PUT, USE_PUT, send, TAKE, &rest), two(MEET, USE_MEET, meet, &other, &rest)]
    };
    let (mut with, mut without) = (0, 0);
    for faults in ["loss 2", "crash nb", "cut na--nb", "loss 1 crash nb", "loss 1 cut na--nb"] {
        for mut cell in cells(faults) {
            cell.plan.budget = within(60_000);
            cell.plan.times = Times::Ends;
            let reduced = cell.check();
            cell.plan.everything = true;
            let whole = cell.check();
            if whole.is_complete() {
                assert_eq!(cell.found(&reduced), cell.found(&whole), "{faults}");
                assert_eq!(reduced.statements, whole.statements, "{faults}");
            }
            if whole.is_complete() {
                with += reduced.phases[1].moves;
                without += whole.phases[1].moves;
            }
        }
    }
    assert!(with < without, "{with} moves with the reductions, {without} without");
}

#[test]
fn a_packet_overtakes_the_one_before_it_as_often_as_it_may() {
    let put = PUT.replace("class = 2", "class = 1");
    let a = "m.n := 1; send put(m); delay 1 msec; m.n := 2; send put(m);";
    let b = "receive put(m); y := m.n; receive put(m); assert m.n > y;";
    let mut cell =
        Text::new(&two_text(&put, USE_PUT, a, b, "").replace("delay 1 msec;\ntype", "delay 3 msec;\ntype"));
    assert_eq!(all(&cell), []);
    cell.plan.faults = vec![CellFaults { reorder: 1, ..CellFaults::default() }];
    let verdicts = cell.check();
    let [assertion] = &verdicts.findings[..] else { panic!("{:?}", cell.found(&verdicts)) };
    assert_eq!((assertion.kind, assertion.phase), (Kind::Assertion, Phase::Faults));
    assert!(assertion.chart.contains("OVERTAKES"), "{}", assertion.chart);

    let scenes = scenes(&Arc::new(cell.plan), assertion);
    assert_eq!(scenes.len(), assertion.moves.len() + 1);
    let overtakes = scenes.iter().find(|scene| {
        scene
            .happened
            .iter()
            .any(|happened| matches!(happened, Shows::Said(word) if word.contains("OVERTAKES")))
    });
    assert!(overtakes.expect("the step is told").odd);
    let last = scenes.last().expect("steps");
    let b = &last.nodes[1].snapshot.as_ref().expect("up").tasks[0];
    assert_eq!(b.liveness, Liveness::Crashed);
    assert_eq!(b.view.ports[0].counters.delivered, 2, "both were taken: {:?}", b.view);
    assert!(scenes[0].nodes.iter().all(|node| node.snapshot.is_some()));
}

#[test]
fn what_monitors_see_of_a_finding_is_what_the_checker_saw() {
    let send = "loop send put(m) on time_out do x := 1; delay 1 msec; x := 0; end; delay 10 msec; end;";
    for faults in ["crash nb", "cut na--nb", "loss 2"] {
        let rest = format!("faults {faults};\ncheck c: never a.x = 1;");
        let cell = two(PUT, USE_PUT, send, TAKE, &rest);
        let verdicts = cell.check();
        let plan = Arc::new(cell.plan.clone());
        for finding in &verdicts.findings {
            let scenes = scenes(&plan, finding);
            assert_eq!(scenes.len(), finding.steps.len() + 1, "{faults}");
            assert!(scenes.iter().any(|scene| scene.odd), "{faults}");
            for (scene, step) in scenes[1..].iter().zip(&finding.steps) {
                assert_eq!((scene.tick, &scene.tasks), (step.tick, &step.tasks), "{faults}");
                for (node, task) in scene.nodes.iter().zip(&step.tasks) {
                    assert_eq!(node.snapshot.is_some(), task.up, "{faults}: one task on each node");
                    let ports = node.snapshot.iter().flat_map(|seen| &seen.tasks[0].view.ports);
                    let queues: Vec<_> = ports.map(|port| (port.port, port.len)).collect();
                    assert_eq!(queues, task.queues, "{faults}");
                }
            }
        }
    }
}

/// A cell in which several tasks query one task, which answers with the received number plus one.
const ASKERS: &str = "cell askers;
tick 1 msec;
node na; node nb; node nt;
link na -- nt delay 1 msec; link nb -- nt delay 1 msec;
type Part is record x: int16; ok: bool; speed: real; end;
task tool on nt
  port grab(p: Part) -> int16 usage = response user_list = {a, b} time_out = 40 msec bounded_buffer[2];
  port near(n: int16) -> int16 usage = query user_list = {mate} time_out = 40 msec;
  var p: Part; var k: int16;
begin
  loop
    receive grab(p);
    query near(p.x) -> k on time_out do skip; end;
    response(k);
  end;
end tool;
task mate on nt
  use_port near(n: int16) usage = response;
begin on query near(n) do response(n + 1); end; end mate;
task a on na
  use_port grab(p: Part) usage = query;
  var p: Part; var got: int16;
begin
  p.x := 300; p.ok := true; p.speed := 0.5;
  query grab(p) -> got on time_out do skip; end;
  assert got < 301;
end a;
";

fn asker(name: &str, x: i32) -> String {
    format!(
        "task {name} on nb
  use_port grab(p: Part) usage = query;
  var p: Part; var got: int16;
begin
  p.x := {x}; p.ok := true; p.speed := 0.5;
  query grab(p) -> got on time_out do skip; end;
  assert got < 301;
end {name};
"
    )
}

#[test]
fn a_chart_says_the_line_and_the_values_of_each_step() {
    let verdicts = Text::new(&format!("{ASKERS}{}", asker("b", -1))).check();
    let finding = verdicts.of(Kind::Assertion).next().expect("the assertion of a");
    let chart = &finding.chart;
    let row = |what: &str| {
        let row = chart.lines().position(|line| line.contains(what));
        row.unwrap_or_else(|| panic!("{what}: {chart}"))
    };
    let lines: Vec<&str> = chart.lines().collect();
    let column = lines[0].find("line").expect("a column for lines") + "line".len();
    for (line, what) in [
        (25, "a -> tool: QUERY grab #0 (300,"),
        (12, "tool: takes grab #0 of a"),
        (13, "tool: sends near #0"),
        (19, "mate: takes near #1 of tool (300)"),
        (19, "mate: answers near #1"),
        (13, "tool: gets the answer (301)"),
        (14, "tool -> a: RESPONSE grab #0 (301)"),
        (25, "a: gets the answer"),
        (26, "a: ASSERTION FAILS"),
    ] {
        let shown = lines[row(what)][..column].trim_end().rsplit([' ', '|', '*', '-', '>', '<']).next();
        assert_eq!(shown, Some(&line.to_string()[..]), "{what}: {chart}");
    }
    assert!(lines[row("QUERY grab") + 1].trim_end().ends_with("true, 0.5)"), "{chart}");
    assert!(lines.iter().all(|line| line.chars().count() <= 78), "{chart}");

    let names = ["tool", "mate", "a", "b"].map(str::to_owned);
    let drawn = svg(&names, finding.steps.iter().flat_map(|step| &step.notes), &finding.cause);
    for part in [">line</text>", "text-anchor=\"end\">25</text>", "QUERY grab #0 (300, true, 0.5)"] {
        assert!(drawn.contains(part), "{part}: {drawn}");
    }
}

/// Heartbeats have a layout that the protocol defines: the checker does not take their contents for values of the cell.
#[test]
fn what_heartbeats_carry_is_not_taken_for_values() {
    let text = std::fs::read_to_string("../examples/weld_cell.cell").expect("the example");
    let plan = Text::new(&text).plan;
    let beats = plan.table.cell().ports.iter().position(|port| port.name == "alive").expect("its beats");
    let fields = |at: usize| plan.legend.formats[at].0.fields.len() + plan.legend.formats[at].1.fields.len();
    assert_eq!(fields(beats), 0);
    assert!((0..plan.legend.formats.len()).any(|port| fields(port) > 0));
}

#[test]
fn tasks_with_the_same_statements_have_their_finding_told_once() {
    let assertions = |b: String| -> Vec<(TaskId, Vec<TaskId>)> {
        // Either task may fail first, because the search does not go on after a finding that ends a task.
        let text = format!("{ASKERS}{b}").replace("  query grab", "  run think takes 1..9 msec; query grab");
        let verdicts = Text::new(&text).check();
        let of = |finding: &Finding| (finding.task.expect("a task"), finding.also.clone());
        verdicts.of(Kind::Assertion).map(of).collect()
    };
    let (a, b) = (TaskId(2), TaskId(3));
    assert_eq!(assertions(asker("b", 300)), [(a, vec![b])]);
    // With another value the assertion has another text, and therefore another cause.
    assert_eq!(assertions(asker("b", 301)), [(a, vec![]), (b, vec![])]);
}
