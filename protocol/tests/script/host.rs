//! Scripts on whole nodes, with their communication tasks.

use super::arm;
use super::written::{Ends, written};
use imrs_protocol::script::*;
use imrs_protocol::*;
use imrs_testkit::{HostInput, ScriptedNode, VirtualCell};
use proptest::prelude::*;
use std::sync::Arc;

pub const A: TaskId = TaskId(0);
pub const B: TaskId = TaskId(1);
const C: TaskId = TaskId(2);

/// A cell with tasks A, B and C, each on a node of its own, joined by links of one tick.
pub fn triangle() -> Cell {
    let mut cell = Cell::new("three", Ticks(1));
    let nodes = ["na", "nb", "nc"].map(|name| cell.node(name));
    for (a, b) in [(0, 1), (0, 2), (1, 2)] {
        cell.link(nodes[a], nodes[b], Ticks(1));
    }
    for (name, node) in ["a", "b", "c"].into_iter().zip(nodes) {
        cell.task(name, node);
    }
    cell
}

pub fn finish(b: ProgramBuilder) -> Program {
    b.finish().expect("a checked program")
}

pub fn bytes(bytes: &[u8]) -> Contents {
    Contents::new(bytes).expect("short")
}

/// The beam lift. A is armL and C is the hoist: the test makes their requests. B is armR, which has a script.
pub fn beam_lift() -> VirtualCell {
    let mut cell = triangle();
    let lift = cell.port(PortDecl::new("lift", A, Usage::Waitfor, &[B, C], Ticks(2000)).resend(Ticks(50), 1));
    let heartbeat = cell.port(PortDecl::new("beat", A, Usage::Query, &[B], Ticks(5)));
    let halt = cell.port(PortDecl::new("halt", A, Usage::Send, &[B], Ticks(10)).bounded_buffer(2));
    let mut virtual_cell =
        VirtualCell::new(cell).begin([(B, arm::right(arm::Ports { lift, heartbeat, halt }))]);
    for task in [A, C] {
        virtual_cell.ask(task, Request::Arrive { port: lift, arguments: [0; 8], time_out: None });
    }
    virtual_cell.results = |_, _| 40;
    assert_eq!(virtual_cell.log(), ["0 b: grip"]);
    virtual_cell.run(299);
    assert_eq!(virtual_cell.told(A), []);
    virtual_cell.run(3);
    assert!(matches!(virtual_cell.told(A)[..], [Signal::Released { .. }]));
    assert!(matches!(virtual_cell.told(C)[..], [Signal::Released { .. }]));
    assert_eq!(virtual_cell.log(), ["300 b: start_lift", "301 b: read_height"]);
    assert_eq!(virtual_cell.var_at(B, arm::MOVING), 1);
    virtual_cell
}

const HEARTBEAT: PortId = PortId(1);
pub const HALT: PortId = PortId(2);

fn ask_heartbeat(virtual_cell: &mut VirtualCell) -> Vec<Signal> {
    virtual_cell.ask(
        A,
        Request::Send { port: HEARTBEAT, to: Target::One(B), contents: bytes(&[1, 0, 1]), time_out: None },
    );
    virtual_cell.run(2);
    virtual_cell.told(A)
}

#[test]
fn the_right_arm_answers_heartbeats_while_it_lifts_and_stops_when_they_end() {
    let mut virtual_cell = beam_lift();
    for _ in 0..5 {
        assert_eq!(ask_heartbeat(&mut virtual_cell), [Signal::Outcome(Outcome::Reply(bytes(&[40, 0, 1])))]);
        virtual_cell.run(4);
    }
    let last = virtual_cell.now() - 5;
    virtual_cell.log();
    virtual_cell.run(5);
    assert_eq!(virtual_cell.log(), [format!("{} b: stop_now at 1", last + 10)], "10 ticks of silence");
    virtual_cell.run(1);
    assert_eq!(virtual_cell.var_at(B, arm::MOVING), 0);
}

#[test]
fn a_halt_interrupts_the_right_arm_at_once() {
    let mut virtual_cell = beam_lift();
    virtual_cell.ask(A, Request::Send { port: HALT, to: Target::All, contents: bytes(&[1]), time_out: None });
    assert_eq!(virtual_cell.told(A), [Signal::Accepted(1)]);
    virtual_cell.run(2);
    assert_eq!(virtual_cell.var_at(B, arm::MOVING), 0);
    assert_eq!(virtual_cell.log(), ["303 b: stop_now at 1"]);
    virtual_cell.run(30);
    assert_eq!(virtual_cell.log(), ["321 b: grip"], "the delay ended in its time, and the arm grips again");
}

#[test]
fn an_arm_whose_partners_never_come_gives_up() {
    let mut cell = triangle();
    let lift = cell.port(PortDecl::new("lift", A, Usage::Waitfor, &[B, C], Ticks(2000)).resend(Ticks(50), 1));
    let heartbeat = cell.port(PortDecl::new("beat", A, Usage::Query, &[B], Ticks(5)));
    let halt = cell.port(PortDecl::new("halt", A, Usage::Send, &[B], Ticks(10)).bounded_buffer(2));
    let mut virtual_cell =
        VirtualCell::new(cell).begin([(B, arm::right(arm::Ports { lift, heartbeat, halt }))]);
    virtual_cell.run(2299);
    assert_eq!(virtual_cell.log(), ["0 b: grip"]);
    virtual_cell.run(1);
    assert_eq!(virtual_cell.log(), ["2300 b: open_grip", "2300 b: ended Aborted(0)"]);
}

const GRAB: PortId = PortId(0);
const FREE: PortId = PortId(1);

/// The script of a tool's administrator. It grants the tool to one task at a time, and reclaims it after 40 ticks.
fn dresser() -> ProgramBuilder {
    let mut b = ProgramBuilder::new("dresser");
    let (busy, no, yes) =
        (b.variable("busy", Type::Bool), b.variable("no", Type::Bool), b.variable("yes", Type::Bool));
    let held = b.timer("held");
    b.set(yes, 1);
    b.forever(|b| {
        b.receive(FREE, None, &[]).set(busy, 0).reply(&[]);
    });
    b.on_message(GRAB, &[("spot", Type::Int8)], |b, _| {
        b.statement().load(busy).either(
            |b| {
                b.reply(&[(Type::Bool, no)]);
            },
            |b| {
                b.set(busy, 1).start(held, Ticks(40)).reply(&[(Type::Bool, yes)]);
            },
        );
    });
    b.handler(Trigger::Timer(held), |b| {
        b.set(busy, 0);
    });
    b
}

/// A robot's script: asks until an answer grants the tool, works for `work`, frees the tool if `honest`, and ends.
fn robot(work: u64, honest: bool) -> ProgramBuilder {
    let mut b = ProgramBuilder::new("robot");
    let (spot, ok, asks) =
        (b.variable("spot", Type::Int8), b.variable("ok", Type::Bool), b.variable("asks", Type::Int8));
    let (top, got) = (b.label(), b.label());
    b.put(top);
    b.statement().load(asks).push(1).int(Binary::Add).store(asks);
    b.send(GRAB, Target::All, &[(Type::Int8, spot)]).unpack(&[(Type::Bool, ok)]);
    b.when(Outcomes::TIME_OUT, |b| {
        b.set(ok, 0);
    });
    b.statement().load(ok).either(
        |b| {
            b.jump(got);
        },
        |b| {
            b.delay(Ticks(7)).jump(top);
        },
    );
    b.put(got);
    b.run("dress", Ticks(work), Ticks(work));
    if honest {
        b.send(FREE, Target::All, &[]);
    }
    b.end();
    b
}

fn tool(work: u64, honest: bool, every: bool) -> VirtualCell {
    let mut cell = triangle();
    cell.port(PortDecl::new("grab", A, Usage::Response, &[B, C], Ticks(20)).bounded_buffer(2));
    cell.port(PortDecl::new("free", A, Usage::Receive, &[B, C], Ticks(20)).command());
    let fusing = if every { Fusing::EveryStatement } else { Fusing::Fused };
    let scripts = [(A, dresser()), (B, robot(work, honest)), (C, robot(1, true))];
    VirtualCell::new(cell).begin(scripts.map(|(task, b)| (task, Program { fusing, ..finish(b) })))
}

#[test]
fn a_shared_tool_goes_to_one_at_a_time() {
    let mut virtual_cell = tool(10, true, false);
    virtual_cell.run(60);
    let log = virtual_cell.log();
    assert_eq!(log, ["2 b: dress", "14 b: ended Finished", "20 c: dress", "23 c: ended Finished"]);
    assert_eq!((virtual_cell.var_at(B, 2), virtual_cell.var_at(C, 2)), (1, 3), "so often each asked");
    assert_eq!(virtual_cell.counts().2, 0, "all commands were answered");
}

#[test]
fn a_timer_frees_the_tool_of_a_dead_holder() {
    let mut virtual_cell = tool(1, false, false);
    virtual_cell.run(41);
    assert_eq!((virtual_cell.var_at(A, 0), virtual_cell.now()), (0, 41), "40 ticks after the grant at 1");
    virtual_cell.run(20);
    assert!(virtual_cell.log().iter().any(|line| line == "47 c: dress"));
}

#[test]
fn fused_and_unfused_statements_do_the_same_in_a_cell() {
    let run = |honest, every| {
        let mut virtual_cell = tool(9, honest, every);
        virtual_cell.run(80);
        let (requests, statements, unanswered) = virtual_cell.counts();
        (virtual_cell.log(), requests, statements, unanswered, virtual_cell.var_at(A, 0))
    };
    for honest in [false, true] {
        assert_eq!(run(honest, false), run(honest, true));
    }
}

#[test]
fn long_messages_and_answers_travel_whole() {
    let mut cell = triangle();
    let port = cell.port(PortDecl::new("scan", A, Usage::Query, &[B], Ticks(20)).fragments(3, 2));
    let words = |b: &mut ProgramBuilder, n: u16| -> Vec<(Type, Slot)> {
        (0..n).map(|i| (Type::Word, b.variable(&format!("w{i}"), Type::Word))).collect()
    };
    let mut asker = ProgramBuilder::new("a");
    let (out, back) = (words(&mut asker, 7), words(&mut asker, 4));
    for (i, &(_, slot)) in (1..).zip(&out) {
        asker.set(slot, i * 1000);
    }
    asker.send(port, Target::One(B), &out).unpack(&back).end();
    let mut answerer = ProgramBuilder::new("b");
    let kept = words(&mut answerer, 7);
    answerer.delay(Ticks(90)).end();
    let fields: Vec<(&str, Type)> = (0..7).map(|_| ("w", Type::Word)).collect();
    answerer.on_message(port, &fields, |b, came| {
        for (&from, &(_, to)) in came.iter().zip(&kept) {
            b.statement().load(from).push(1).int(Binary::Add).store(to);
        }
        b.reply(&kept[3..]);
    });
    let mut virtual_cell = VirtualCell::new(cell).begin([(A, finish(asker)), (B, finish(answerer))]);
    virtual_cell.run(10);
    assert_eq!(
        (0..7).map(|i| virtual_cell.var_at(B, i)).collect::<Vec<_>>(),
        [1001, 2001, 3001, 4001, 5001, 6001, 7001]
    );
    assert_eq!((7..11).map(|i| virtual_cell.var_at(A, i)).collect::<Vec<_>>(), [4001, 5001, 6001, 7001]);
}

/// A asks B, B passes the question on to C, and C answers A in B's place (D11).
#[test]
fn a_third_task_answers() {
    let mut cell = triangle();
    let ask = cell.port(PortDecl::new("ask", A, Usage::Query, &[B], Ticks(20)));
    let pass = cell.port(PortDecl::new("pass", B, Usage::Send, &[C], Ticks(20)));
    let back = cell.port(PortDecl::new("back", C, Usage::Reply, &[A], Ticks(20)));
    let mut a = ProgramBuilder::new("a");
    let (said, outcome) = (a.variable("said", Type::Int8), a.variable("outcome", Type::Int8));
    a.send(ask, Target::All, &[]).op(Op::Outcome).store(outcome).unpack(&[(Type::Int8, said)]).end();
    let mut b = ProgramBuilder::new("b");
    let name = b.format(&[Type::Int16, Type::Word]);
    b.receive(ask, None, &[]).op(Op::ReceivedSource).op(Op::ReceivedId);
    b.op(Op::Send { port: pass, to: Target::All, format: name, time_out: None }).end();
    let mut c = ProgramBuilder::new("c");
    let (source, id) = (c.variable("source", Type::Int16), c.variable("id", Type::Word));
    c.receive(pass, None, &[(Type::Int16, source), (Type::Word, id)]);
    let format = c.format(&[Type::Int8]);
    c.statement().load(source).load(id).push(7).op(Op::ReplyFor { port: back, format }).end();
    let names = finish(b);
    assert!(names.names_messages());
    let mut virtual_cell = VirtualCell::new(cell).begin([(A, finish(a)), (B, names), (C, finish(c))]);
    virtual_cell.run(5);
    assert_eq!([0, 1].map(|i| virtual_cell.var_at(A, i)), [7, StatementOutcome::Reply as i64]);
    assert!(virtual_cell.activities().iter().all(|activity| *activity == Activity::Ended(End::Finished)));
}

/// B takes the questions of A and C, and answers the later question first (D93).
#[test]
fn an_answer_may_come_later() {
    let mut cell = triangle();
    let ask = cell.port(PortDecl::new("ask", B, Usage::Response, &[A, C], Ticks(30)));
    let asker = |name: &str, first: u64| {
        let mut b = ProgramBuilder::new(name);
        let (said, outcome) = (b.variable("said", Type::Int8), b.variable("outcome", Type::Int8));
        b.delay(Ticks(first)).send(ask, Target::All, &[]).op(Op::Outcome).store(outcome);
        b.unpack(&[(Type::Int8, said)]).end();
        finish(b)
    };
    let mut b = ProgramBuilder::new("b");
    let again = b.variable("again", Type::Int8);
    b.receive(ask, None, &[]).receive(ask, None, &[]);
    let format = b.format(&[Type::Int8]);
    for (task, says) in [(C, 3), (A, 1), (A, 9)] {
        b.statement().push(says).op(Op::ReplyOwed { port: ask, task, format });
    }
    b.op(Op::Outcome).store(again).end();
    let answers = finish(b);
    assert!(!answers.names_messages(), "a checker can look at it");
    let mut virtual_cell =
        VirtualCell::new(cell).begin([(A, asker("a", 1)), (B, answers), (C, asker("c", 3))]);
    virtual_cell.run(20);
    assert_eq!([A, C].map(|task| virtual_cell.var_at(task, 0)), [1, 3]);
    assert_eq!([A, C].map(|task| virtual_cell.var_at(task, 1)), [StatementOutcome::Reply as i64; 2]);
    assert_eq!(virtual_cell.var_at(B, 0), StatementOutcome::Unanswerable as i64, "A is answered already");
}

#[test]
fn who_arrives_tells_the_others() {
    let mut cell = triangle();
    let lift = cell.port(PortDecl::new("lift", A, Usage::Waitfor, &[B], Ticks(30)));
    let member = |name: &str, says: i64, other: TaskId| {
        let mut b = ProgramBuilder::new(name);
        let (own, heard) = (b.variable("own", Type::Int16), b.variable("heard", Type::Int16));
        b.set(own, says).waitfor_with(lift, &[(Type::Int16, own)]);
        b.arrival(lift, other, &[(Type::Int16, heard)]).end();
        finish(b)
    };
    let mut virtual_cell = VirtualCell::new(cell).begin([(A, member("a", -3, B)), (B, member("b", 900, A))]);
    virtual_cell.run(5);
    assert_eq!([virtual_cell.var_at(A, 1), virtual_cell.var_at(B, 1)], [900, -3]);
}

#[test]
fn a_query_to_all_brings_the_answer_of_each() {
    let mut cell = triangle();
    let port = cell.port(PortDecl::new("poll", A, Usage::Query, &[B, C], Ticks(9)));
    let mut asker = ProgramBuilder::new("a");
    let said: Vec<Slot> = (0..2).map(|_| asker.variable("said", Type::Int8)).collect();
    let (mask, outcome) = (asker.variable("mask", Type::Word), asker.variable("outcome", Type::Int8));
    asker.send(port, Target::All, &[]);
    asker.op(Op::Outcome).store(outcome).op(Op::Mark(Mark::Answered)).store(mask);
    let format = asker.format(&[Type::Int8]);
    for (task, &slot) in [B, C].into_iter().zip(&said) {
        let into = asker.places(&[slot]);
        asker.op(Op::Answer { port, task }).then(|b| {
            b.op(Op::Unpack { format, into });
        });
    }
    asker.end();
    let mut answerer = ProgramBuilder::new("b");
    let five = answerer.variable("five", Type::Int8);
    answerer.set(five, 5).receive(port, None, &[]).reply(&[(Type::Int8, five)]).end();
    let mut virtual_cell = VirtualCell::new(cell).begin([(A, finish(asker)), (B, finish(answerer))]);
    virtual_cell.run(9);
    assert_eq!([0, 1, 2].map(|i| virtual_cell.var_at(A, i)), [5, 0, 0b10], "C never answers");
    assert_eq!(virtual_cell.var_at(A, 3), StatementOutcome::Incomplete as i64);
}

#[test]
fn a_handler_waits_for_the_end_of_an_atomic_section() {
    let mut cell = triangle();
    let port = cell.port(PortDecl::new("beat", A, Usage::Query, &[B], Ticks(20)));
    let mut b = ProgramBuilder::new("b");
    b.order(&[Ranked::Port(port), Ranked::Own]);
    b.statement()
        .op(Op::Atomic(true))
        .delay(Ticks(6))
        .statement()
        .op(Op::Atomic(false))
        .delay(Ticks(90))
        .end();
    b.on_message(port, &[], |b, _| {
        b.reply(&[]);
    });
    let mut virtual_cell = VirtualCell::new(cell).begin([(B, finish(b))]);
    virtual_cell.ask(A, Request::Send { port, to: Target::All, contents: Contents::EMPTY, time_out: None });
    virtual_cell.run(6);
    assert_eq!(virtual_cell.told(A), []);
    virtual_cell.run(1);
    assert_eq!(
        virtual_cell.told(A),
        [Signal::Outcome(Outcome::Reply(Contents::EMPTY))],
        "at 6, and one tick back"
    );
}

/// The action ends while the first handler runs. When that handler returns, the second one begins before the communication
/// task gets the report that the action has ended.
#[test]
fn a_handler_that_comes_at_once_after_another_crosses_the_end_of_the_action() {
    let mut cell = triangle();
    let port = cell.port(PortDecl::new("first", A, Usage::Query, &[B], Ticks(30)));
    let mut b = ProgramBuilder::new("b");
    let (height, heard) = (b.variable("height", Type::Int8), b.variable("heard", Type::Int8));
    let timer = b.timer("t");
    b.order(&[Ranked::Port(port), Ranked::Timers, Ranked::Own]).start(timer, Ticks(4));
    b.run("weld", Ticks(3), Ticks(3)).op(Op::Value).store(height).end();
    b.on_message(port, &[("x", Type::Int8)], |b, came| {
        b.delay(Ticks(5)).statement().load(came[0]).store(heard).reply(&[(Type::Int8, heard)]);
    });
    b.handler(Trigger::Timer(timer), |b| {
        b.delay(Ticks(5)).set(heard, 9);
    });
    let mut virtual_cell = VirtualCell::new(cell).begin([(B, finish(b))]);
    virtual_cell.results = |_, _| 40;
    virtual_cell.ask(A, Request::Send { port, to: Target::All, contents: bytes(&[7]), time_out: None });
    virtual_cell.run(7);
    assert_eq!(
        virtual_cell.told(A),
        [Signal::Outcome(Outcome::Reply(bytes(&[7])))],
        "at 1 + 5, and one tick back"
    );
    assert_eq!(
        [0, 1].map(|i| virtual_cell.var_at(B, i)),
        [0, 7],
        "the action ended at 3, but the timer's handler runs"
    );
    virtual_cell.run(4);
    assert_eq!([0, 1].map(|i| virtual_cell.var_at(B, i)), [40, 9]);
    assert_eq!(virtual_cell.log(), ["0 b: weld", "11 b: ended Finished"]);
}

#[test]
fn what_can_be_answered_no_more_is_forgotten() {
    let mut cell = triangle();
    let port = cell.port(PortDecl::new("move", A, Usage::Send, &[B], Ticks(9)).command());
    let program = || {
        let mut b = ProgramBuilder::new("b");
        let outcome = b.variable("outcome", Type::Int8);
        b.receive(port, None, &[]).delay(Ticks(20)).reply(&[]).op(Op::Outcome).store(outcome).end();
        finish(b)
    };
    let run = |bury: bool| {
        let mut virtual_cell = VirtualCell::new(cell.clone()).begin([(B, program())]);
        virtual_cell
            .ask(A, Request::Send { port, to: Target::All, contents: Contents::EMPTY, time_out: None });
        let mut forgotten = None;
        for _ in 0..30 {
            virtual_cell.run(1);
            if bury {
                let ScriptedNode { node, scripts, .. } = &mut virtual_cell.nodes[1];
                let (script, task) = (&mut scripts[0].host.script, node.task(B).expect("B"));
                let before = script.clone();
                script.bury(|to| task.can_answer(to));
                if *script != before {
                    forgotten = Some(virtual_cell.now());
                }
            }
        }
        (virtual_cell.var_at(B, 0), virtual_cell.told(A), virtual_cell.log(), forgotten)
    };
    let (outcome, told, log, forgotten) = run(true);
    assert_eq!(outcome, StatementOutcome::Unanswerable as i64);
    assert_eq!(forgotten, Some(8), "sent at 0 for 9, one tick back");
    assert_eq!((outcome, told, log, None), run(false));
}

#[test]
fn a_task_that_never_waits_is_stopped_and_the_node_goes_on() {
    let mut cell = triangle();
    let port = cell.port(PortDecl::new("news", A, Usage::Send, &[B], Ticks(9)));
    let mut b = ProgramBuilder::new("a");
    b.forever(|b| {
        b.send(port, Target::All, &[]);
    });
    let mut virtual_cell = VirtualCell::new(cell).begin([(A, finish(b))]);
    assert_eq!(virtual_cell.log(), ["0 a: ended Fault { fault: Runaway, at: 1 }"]);
    assert_eq!(
        virtual_cell.counts().0,
        HOST_LIMIT as usize + 1,
        "a request for each step, and the last to give all up"
    );
    virtual_cell.run(3);
}

#[test]
fn a_node_says_who_waits_for_a_choice() {
    let program = || {
        let mut b = ProgramBuilder::new("a");
        let n = b.variable("n", Type::Int8);
        b.statement().op(Op::Choose(4)).store(n).end();
        finish(b)
    };
    let mut cell = triangle();
    cell.port(PortDecl::new("news", A, Usage::Send, &[B], Ticks(9)));
    let mut virtual_cell = VirtualCell::new(cell.clone()).begin([(A, program())]);
    assert_eq!(virtual_cell.activities(), [Activity::Chooses(4)]);
    virtual_cell.step(NodeId(0), HostInput::Chosen { task: A, choice: 3 });
    virtual_cell.step(NodeId(0), HostInput::Chosen { task: B, choice: 3 });
    assert_eq!(
        (virtual_cell.var_at(A, 0), virtual_cell.activities()),
        (3, vec![Activity::Ended(End::Finished)])
    );
    let virtual_cell = VirtualCell::new(cell.clone()).choosing(2).begin([(A, program())]);
    assert_eq!(virtual_cell.var_at(A, 0), 2);

    let table = NodeTable::new(Arc::new(CellTable::new(cell).expect("a checked cell")), NodeId(0));
    let node = Node::new(table, Incarnation(0), false, 4);
    let empty = Program::default();
    assert_eq!(
        ScriptedNode::new(node, [(A, Arc::new(empty))]).expect_err("no program"),
        (A, ProgramError::NoSuchAddress(0))
    );
}

/// Two tasks with random scripts and handlers, on one node or on two.
fn random_pair(genes: [&[u8]; 2], together: bool) -> VirtualCell {
    let mut cell = Cell::new("pair", Ticks(1));
    let (na, nb) = (cell.node("na"), cell.node("nb"));
    cell.link(na, nb, Ticks(1));
    let (a, b) = (cell.task("a", na), cell.task("b", if together { na } else { nb }));
    let port = |name, from, usage, to| PortDecl::new(name, from, usage, &[to], Ticks(9)).bounded_buffer(2);
    let mut add = |decl: PortDecl| cell.port(decl.fragments(2, 2));
    let (ask_a, ask_b) = (add(port("qa", a, Usage::Query, b)), add(port("qb", b, Usage::Query, a)));
    add(PortDecl::new("lift", a, Usage::Waitfor, &[b], Ticks(30)).resend(Ticks(5), 1));
    let tell_a = add(port("ta", a, Usage::Send, b).command().retry(2, Ticks(3)));
    let tell_b = add(port("tb", b, Usage::Send, a).command());
    let (news_a, news_b) = (add(port("na", a, Usage::Send, b)), add(port("nb", b, Usage::Send, a).latest()));
    let ends = [
        Ends { asks: [ask_a, news_a], tells: tell_a, hears: tell_b, handled: [ask_b, news_b], real: true },
        Ends { asks: [ask_b, news_b], tells: tell_b, hears: tell_a, handled: [ask_a, news_a], real: true },
    ];
    let programs =
        [a, b].into_iter().zip(genes).zip(ends).map(|((task, genes), ends)| (task, written(genes, ends)));
    let mut virtual_cell = VirtualCell::new(cell).choosing(1);
    virtual_cell.results = |_, _| 40;
    virtual_cell.begin(programs)
}

fn ended_well(activity: Activity) -> bool {
    match activity {
        // Expected faults: a handler asks on a port where an interrupted activation waits; a script never waits.
        Activity::Ended(End::Fault { fault, .. }) => {
            fault == ScriptFault::Request(Fault::Busy) || fault == ScriptFault::Runaway
        }
        Activity::NotBegun => false,
        Activity::Waits | Activity::Acts | Activity::Chooses(_) | Activity::Passive | Activity::Ended(_) => {
            true
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// Tests that scripts and communication tasks agree: no answer is unexpected, whatever interrupts the scripts.
    #[test]
    fn random_tasks_get_along_with_their_communication_tasks(
        a in proptest::collection::vec(any::<u8>(), 0..200),
        b in proptest::collection::vec(any::<u8>(), 0..200),
        together: bool,
    ) {
        let mut virtual_cell = random_pair([&a, &b], together);
        virtual_cell.run(120);
        prop_assert!(virtual_cell.activities().into_iter().all(ended_well), "{:?}", virtual_cell.activities());
    }
}

/// Tests that the random runs reach many states, because otherwise they would prove little.
#[test]
fn random_tasks_come_far() {
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let (mut deepest, mut interrupted, mut alive, mut acted) = (0, 0, 0, 0);
    for i in 0..200 {
        let mut genes = || {
            let strategy = proptest::collection::vec(any::<u8>(), 0..200);
            proptest::strategy::ValueTree::current(&strategy.new_tree(&mut runner).expect("bytes"))
        };
        let mut virtual_cell = random_pair([&genes(), &genes()], i % 2 == 0);
        for _ in 0..120 {
            virtual_cell.run(1);
            let scripts = virtual_cell.nodes.iter().flat_map(|node| &node.scripts);
            let depth = scripts.map(|hosted| hosted.host.script.depth()).max().unwrap_or(0);
            deepest = deepest.max(depth);
            interrupted += u32::from(depth > 0);
        }
        let ended = |activity: &Activity| matches!(activity, Activity::Ended(_));
        alive += usize::from(!virtual_cell.activities().iter().any(ended));
        acted += virtual_cell.log().len();
    }
    assert!(deepest >= 2, "handlers nest: {deepest}");
    assert!(interrupted > 2000, "ticks in which a handler runs: {interrupted}");
    assert!(alive > 50, "runs in which both tasks go on: {alive}");
    assert!(acted > 1000, "actions: {acted}");
}
