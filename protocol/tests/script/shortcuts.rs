//! Compares the shortcuts of compiled programs with the operations that they replace (D188). Every step of every script in
//! these tests is compared ([`Rig::compared`]). The tests here plant faults into compiled code, which random programs must
//! find.

use super::fake::*;
use super::random::answer;
use super::written::{inputs, of_each_type, operators, programs};
use imrs_protocol::script::code::{Act, Compute, Function, Operand, Send, Shortcut, Then, Unpack};
use imrs_protocol::script::*;
use imrs_protocol::{Target, Ticks};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use std::collections::BTreeMap;

/// Plants a fault into compiled code.
type Planted = fn(&mut Code);

/// Changes every shortcut.
fn each(code: &mut Code, change: impl Fn(&mut Shortcut)) {
    code.shortcuts.iter_mut().for_each(change);
}

/// Changes what every shortcut computes.
fn each_value(code: &mut Code, change: impl Fn(&mut Compute)) {
    each(code, |shortcut| {
        if let Act::Compute(compute) = &mut shortcut.act {
            change(compute);
        }
    });
}

/// The positions of the replies whose shortcuts name the GET that follows.
fn replies(code: &Code) -> Vec<usize> {
    let is_reply =
        |(_, shortcut): &(usize, &Shortcut)| matches!(shortcut.act, Act::Send(_)) && shortcut.next.count == 0;
    code.shortcuts.iter().enumerate().filter(is_reply).map(|(at, _)| at).collect()
}

const FAULTS: [(&str, Planted); 18] = [
    ("an addition subtracts", |code| {
        each_value(code, |value| {
            if value.function == Function::Int(Binary::Add) {
                value.function = Function::Int(Binary::Subtract);
            }
        });
    }),
    ("the operands are exchanged", |code| {
        each_value(code, |value| std::mem::swap(&mut value.a, &mut value.b));
    }),
    ("`not` is forgotten", |code| {
        each_value(code, |value| {
            if value.function == Function::Not {
                value.function = Function::Same;
            }
        });
    }),
    ("a value stays on the stack", |code| {
        each_value(code, |value| value.pops = value.pops.saturating_sub(1));
    }),
    ("a variable takes any value", |code| {
        each_value(code, |value| {
            if let Then::Store(_, of) = &mut value.then {
                *of = Type::Int32;
            }
        });
    }),
    ("a branch goes one operation too far", |code| {
        each_value(code, |value| {
            if let Then::Unless(to) = &mut value.then {
                *to += 1;
            }
        });
    }),
    ("a local variable is one of the task", |code| {
        each_value(code, |value| {
            if let Operand::Local(at) = value.a {
                value.a = Operand::Task(at);
            }
        });
    }),
    ("an operation is not counted", |code| {
        each(code, |shortcut| shortcut.next.count = shortcut.next.count.max(2) - 1);
    }),
    ("an operation of a branch is not counted", |code| {
        code.branches.iter_mut().for_each(|branch| branch.count = branch.count.max(2) - 1);
    }),
    ("a statement begins unnoticed", |code| each(code, |shortcut| shortcut.statement = false)),
    ("the jump after a shortcut is forgotten", |code| {
        for (at, shortcut) in (0..).zip(&mut code.shortcuts) {
            if shortcut.next.count > shortcut.count {
                shortcut.next.to = at + u16::from(shortcut.statement) + u16::from(shortcut.next.count);
            }
        }
    }),
    ("outcomes lead where others should", |code| {
        let by = code.branches.len().min(1);
        code.branches.rotate_right(by);
    }),
    ("a field is sent whatever its value", |code| {
        code.sent.iter_mut().filter(|field| field.of == Type::Int8).for_each(|field| field.of = Type::Int32);
    }),
    ("a field is sent in another place", |code| {
        code.sent.iter_mut().for_each(|field| field.at = field.at.saturating_sub(1));
    }),
    ("a field goes into the next variable", |code| {
        code.read.iter_mut().for_each(|field| {
            let (Slot::Task(at) | Slot::Local(at)) = &mut field.place;
            *at = (*at + 1) % 6;
        });
    }),
    ("a message of another length is read", |code| {
        each(code, |shortcut| {
            if let Act::Unpack(Unpack { len, .. }) = &mut shortcut.act {
                *len = len.saturating_sub(1);
            }
        });
    }),
    ("after a reply comes the GET of another one", |code| {
        let replies = replies(code);
        let next: Vec<_> = replies.iter().map(|&at| code.shortcuts[at].next).collect();
        for (&at, next) in replies.iter().zip(next.into_iter().cycle().skip(1)) {
            code.shortcuts[at].next = next;
        }
    }),
    ("after a reply comes the first GET of the program", |code| {
        let first =
            code.shortcuts.iter().position(|shortcut| !shortcut.statement && shortcut.act == Act::Get);
        for at in replies(code) {
            code.shortcuts[at].next.to = u16::try_from(first.unwrap_or(0)).expect("a short program");
        }
    }),
];

/// The parts of a random expression: its kind, two variables, an operator and a number.
type Expression = (u8, usize, usize, Binary, i64);

/// Programs of random expressions, in the task's own thread and in a handler.
fn expressions() -> impl Strategy<Value = Program> {
    let number = prop_oneof![-2..3_i64, 126..129_i64];
    let expressions = || vec((0..6_u8, 0..6_usize, 0..6_usize, operators(), number.clone()), 1..15);
    (expressions(), expressions()).prop_map(|(own, handler)| {
        let mut b = ProgramBuilder::new("expressions");
        let variables = of_each_type(|name, of| b.variable(name, of));
        own.into_iter().for_each(|one| expression(&mut b, &variables, one));
        // The program ends in a loop that never waits, so that the last operations before the limit of a step
        // are compared, too.
        let (truth, own) = (variables[0].1, b.label());
        b.forever(|b| {
            b.statement().load(truth).op(Op::Term(Term::Not)).store(truth);
            b.on(Outcomes::of(&[StatementOutcome::Done]), own);
            b.put(own);
        });
        b.end();
        b.handler(Trigger::Message(ASK), |b| {
            let variables = of_each_type(|name, of| b.local(name, of));
            handler.into_iter().for_each(|one| expression(b, &variables, one));
        });
        b.finish().expect("well formed")
    })
}

/// Adds a statement: the receiving of a message, or, with an expression of two operands, an assignment, a
/// branch or a sent message.
fn expression(
    b: &mut ProgramBuilder,
    variables: &[(Type, Slot)],
    (kind, x, y, operator, number): Expression,
) {
    let ((of, x), (_, y)) = (variables[x], variables[y]);
    let reals = match operator {
        Binary::Remainder | Binary::And | Binary::Or => Binary::Add,
        operator => operator,
    };
    if number == -2 {
        // Some programs are servers: they answer a message and receive the next one.
        let port = if kind % 2 == 0 { ASK } else { TELL };
        b.receive(TELL, Some(Ticks(3)), &[(of, x)]);
        if kind < 4 {
            b.reply(&[(of, x)]).receive(port, None, &[(of, x)]);
        }
        return;
    }
    b.statement().load(x);
    match kind {
        0 | 1 => b.push(number).int(operator),
        2 => b.load(y).int(operator),
        3 => b.load(x).push(2).int(Binary::Multiply).int(operator),
        4 => b.load(y).op(Op::Term(Term::Real(reals))),
        _ => b.op(Op::Term(Term::Not)),
    };
    match number {
        0 => {
            b.then(|b| {
                b.set(y, 1);
            });
        }
        1 | 126 => {
            let format = b.format(&[Type::Int8, of]);
            b.load(x).op(Op::Send { port: TELL, to: Target::All, format, time_out: None });
        }
        _ => {
            b.store(y);
        }
    }
}

/// Runs at most as many random programs with the code that `plant` changes, until a step differs. Returns how many programs
/// that took.
fn programs_until_found(plant: Planted, most: u32) -> Option<u32> {
    let mut runner = TestRunner::deterministic();
    for number in 1..=most {
        let mut rig = Rig::of(
            prop_oneof![programs(), expressions()].new_tree(&mut runner).expect("a program").current(),
        );
        plant(&mut rig.code);
        let mut input = ScriptInput::Begin;
        for _ in 0..40 {
            if rig.compared(&input).is_err() {
                return Some(number);
            }
            let (pick, any) = (any::<u8>(), inputs()).new_tree(&mut runner).expect("an input").current();
            input = if pick.is_multiple_of(4) { any } else { answer(&rig, pick).unwrap_or(any) };
        }
    }
    None
}

#[test]
fn random_programs_find_faults_in_compiled_code() {
    assert_eq!(programs_until_found(|_| {}, 200), None, "the code itself differs");
    let missed: Vec<_> = FAULTS
        .iter()
        .filter(|(what, plant)| {
            let found = programs_until_found(*plant, 1000);
            println!("{what}: found by program {found:?}");
            found.is_none()
        })
        .map(|(what, _)| what)
        .collect();
    assert!(missed.is_empty(), "{missed:?}");
}

fn is_get(code: &Code, at: u16) -> bool {
    code.shortcuts
        .get(usize::from(at))
        .is_some_and(|shortcut| !shortcut.statement && shortcut.act == Act::Get)
}

/// The comparisons mean something only if the random programs take every kind of shortcut.
#[test]
fn random_programs_have_every_shortcut() {
    let mut runner = TestRunner::deterministic();
    let mut seen = BTreeMap::<&str, u32>::new();
    for _ in 0..300 {
        let code = Code::new(&programs().new_tree(&mut runner).expect("a program").current());
        for Shortcut { statement, act, count, next } in &code.shortcuts {
            let what = match act {
                Act::Plain => "plain",
                Act::Jump => "jump",
                Act::On(_) => "on",
                Act::Compute(Compute { then: Then::Push, .. }) => "push",
                Act::Compute(Compute { then: Then::Store(..), .. }) => "store",
                Act::Compute(Compute { then: Then::Unless(_), .. }) => "unless",
                Act::Send(_) if next.count == 0 && is_get(&code, next.to) => "reply and get",
                Act::Send(Send { pops: 0, .. }) => "send",
                Act::Send(_) => "send from the stack",
                Act::Unpack(_) => "unpack",
                Act::Get => "get",
            };
            *seen.entry(what).or_default() += 1;
            *seen.entry("statement").or_default() += u32::from(*statement);
            *seen.entry("followed jump").or_default() += u32::from(next.count > *count);
        }
    }
    assert_eq!(seen.len(), 13, "{seen:?}");
    assert!(seen.values().all(|&times| times >= 5), "{seen:?}");
}
