//! Tests of the faults that `Program::check` finds, and of their texts.

use super::fake::*;
use imrs_protocol::script::*;
use imrs_protocol::*;

fn fault(write: impl FnOnce(&mut ProgramBuilder)) -> ProgramError {
    let mut b = ProgramBuilder::new("test");
    write(&mut b);
    b.finish().expect_err("a fault")
}

/// The result of `Program::check` for a program that has only this code.
fn raw(code: &[Op]) -> Result<usize, ProgramError> {
    Program { code: code.into(), ..Program::default() }.check()
}

#[test]
fn every_position_exists() {
    assert_eq!(raw(&[]), Err(ProgramError::NoSuchAddress(0)));
    assert_eq!(raw(&[Op::Statement]), Err(ProgramError::NoSuchAddress(1)));
    assert_eq!(raw(&[Op::Jump(7)]), Err(ProgramError::NoSuchAddress(7)));
    let out = Outcomes::TIME_OUT;
    assert_eq!(raw(&[Op::On { outcomes: out, to: 7 }, Op::End]), Err(ProgramError::NoSuchAddress(7)));
    assert_eq!(
        fault(|b| {
            let nowhere = b.label();
            b.jump(nowhere);
        }),
        ProgramError::NoSuchAddress(0)
    );
    assert_eq!(raw(&[Op::End, Op::Jump(99)]), Ok(0), "what is never reached may be anything");
}

#[test]
fn every_entry_exists() {
    let time = Ticks(1);
    let missing = [
        Op::Term(Term::Load(Slot::Task(0))),
        Op::Term(Term::Load(Slot::Local(0))),
        Op::Unpack { format: 0, into: 0 },
        Op::Send { port: ASK, to: Target::All, format: 0, time_out: None },
        Op::Reply { format: 0 },
        Op::Arrive { port: LIFT, format: 0, time_out: None },
        Op::Publish { format: 0 },
        Op::Order(0),
        Op::Stop(TimeId(0)),
        Op::Run { action: 0, arguments: 0, least: time, most: time },
        Op::Abort(0),
    ];
    for op in missing {
        assert_eq!(raw(&[op, Op::End]), Err(ProgramError::NoSuchEntry(0)), "{op:?}");
    }
    assert_eq!(raw(&[Op::Start { timer: TimeId(0), length: time }]), Err(ProgramError::Unhandled(0)));
    let arguments = fault(|b| {
        let format = b.format(&[Type::Word, Type::Word, Type::Bool]);
        b.push(0).push(0).push(0).op(Op::Arrive { port: LIFT, format, time_out: None }).end();
    });
    assert_eq!(arguments, ProgramError::NoSuchEntry(3), "a waitfor carries 8 bytes");
}

#[test]
fn some_operations_are_for_checks_or_handlers_only() {
    let time = |t| Ticks(t);
    let misplaced = [
        Op::Term(Term::Of { task: PEER, variable: 0 }),
        Op::Term(Term::Is(Predicate::Active(PEER))),
        Op::Term(Term::Real(Binary::And)),
        Op::HandlerEnd,
        Op::Choose(0),
        Op::Run { action: 0, arguments: 0, least: time(2), most: time(1) },
    ];
    for op in misplaced {
        assert_eq!(raw(&[op, Op::End]), Err(ProgramError::Misplaced(0)), "{op:?}");
    }
}

#[test]
fn operands_balance() {
    let push = Op::Term(Term::Push(1));
    assert_eq!(raw(&[Op::Pop, Op::End]), Err(ProgramError::Operands(0)));
    assert_eq!(
        raw(&[push, Op::Delay(Ticks(1)), Op::End]),
        Err(ProgramError::Operands(1)),
        "nothing lies below a wait"
    );
    assert_eq!(raw(&[push, Op::End]), Err(ProgramError::Operands(1)));
    assert_eq!(raw(&[push, Op::Jump(0)]), Err(ProgramError::Operands(0)), "a loop that piles up");
    assert_eq!(raw(&vec![push; MAX_OPERANDS + 1]), Err(ProgramError::Operands(224)));
    assert_eq!(raw(&[push, push, Op::Pop, Op::Pop, Op::End]), Ok(2));
}

#[test]
fn atomic_sections_balance() {
    let push = Op::Term(Term::Push(1));
    assert_eq!(raw(&[Op::Atomic(false), Op::End]), Err(ProgramError::Atomic(0)));
    assert_eq!(raw(&[Op::Atomic(true), Op::Jump(0)]), Err(ProgramError::Atomic(0)));
    assert_eq!(raw(&[push, Op::Unless(3), Op::Atomic(true), Op::End]), Err(ProgramError::Atomic(3)));
    let open = fault(|b| {
        b.end();
        b.on_message(ASK, &[], |b, _| {
            b.op(Op::Atomic(true));
        });
    });
    assert_eq!(open, ProgramError::Atomic(2));
}

#[test]
fn tables_are_sound() {
    let twice = fault(|b| {
        b.end();
        b.on_message(ASK, &[], |_, _| ()).on_message(ASK, &[], |_, _| ());
    });
    assert_eq!(twice, ProgramError::SameTrigger(Trigger::Message(ASK)));
    let long = Program {
        code: vec![Op::End],
        formats: vec![Format { fields: vec![Type::Word; 49] }],
        ..Program::default()
    };
    assert_eq!(long.check(), Err(ProgramError::Format(0)));
    let mut most = long;
    most.formats[0].fields.pop();
    assert_eq!((most.check(), most.formats[0].fragments()), (Ok(0), 16));
    let initial = Variable { name: "x".into(), of: Type::Bool, initial: 2 };
    let odd = Program { code: vec![Op::End], variables: vec![initial], ..Program::default() };
    assert_eq!((odd.check(), Script::new(&odd).var(0)), (Err(ProgramError::Initial), Some(0)));
    let large = Program { code: vec![Op::End; 70_000], ..Program::default() };
    assert_eq!(large.check(), Err(ProgramError::TooLarge));
}

#[test]
fn a_task_publishes_no_more_than_an_answer_to_a_heartbeat_carries() {
    let publish = |bytes: usize| Program {
        code: vec![Op::Term(Term::Push(0)); bytes]
            .into_iter()
            .chain([Op::Publish { format: 0 }, Op::End])
            .collect(),
        formats: vec![Format { fields: vec![Type::Int8; bytes] }],
        ..Program::default()
    };
    assert_eq!(publish(PUBLISHED_BYTES).check(), Ok(PUBLISHED_BYTES));
    let above = PUBLISHED_BYTES + 1;
    assert_eq!(publish(above).check(), Err(ProgramError::NoSuchEntry(u16::try_from(above).expect("few"))));
}

#[test]
fn a_handlers_variables_are_its_own() {
    let mut other = Slot::Local(0);
    let foreign = fault(|b| {
        b.end();
        b.handler(Trigger::Fenced, |b| other = b.local("mine", Type::Bool));
        b.handler(Trigger::Message(ASK), |b| {
            b.load(other).op(Op::Pop);
        });
    });
    assert_eq!(foreign, ProgramError::NoSuchEntry(2));
    let mut b = ProgramBuilder::new("test");
    assert_eq!(b.local("outside", Type::Bool), Slot::Task(0));
}

#[test]
fn faults_are_told_in_words() {
    let all = [
        (ProgramError::TooLarge, "the program is too large"),
        (ProgramError::Initial, "a variable begins with a value that is not of its type"),
        (ProgramError::Format(2), "format 2 takes more than 16 packets"),
        (ProgramError::SameTrigger(Trigger::Fenced), "two handlers for Fenced"),
        (ProgramError::NoSuchAddress(3), "there is no operation 3"),
        (ProgramError::NoSuchEntry(3), "operation 3 names what does not exist or does not fit"),
        (ProgramError::Unhandled(3), "operation 3 starts a timer without a handler"),
        (ProgramError::Operands(3), "the operands of operation 3 do not balance"),
        (ProgramError::Atomic(3), "the atomic sections at operation 3 do not balance"),
        (ProgramError::Misplaced(3), "operation 3 is out of place"),
    ];
    for (fault, words) in all {
        assert_eq!(fault.to_string(), words);
    }
    let faults = [
        (ScriptFault::Overflow, "a value is out of the range of its type"),
        (ScriptFault::DivisionByZero, "a division by zero"),
        (ScriptFault::NotFinite, "a real that is not finite"),
        (ScriptFault::Malformed, "the program is malformed"),
        (ScriptFault::Runaway, "the task runs on and on without waiting"),
        (ScriptFault::TooDeep, "too many handlers interrupt each other"),
        (ScriptFault::Unexpected, "an answer without a request"),
        (ScriptFault::WrongContents, "a message is not of the declared format"),
        (ScriptFault::NothingReceived, "no message or answer came"),
        (
            ScriptFault::Request(Fault::Busy),
            "the request is at fault: another request of the task is not over",
        ),
    ];
    for (fault, words) in faults {
        assert_eq!(fault.to_string(), words);
    }
}
