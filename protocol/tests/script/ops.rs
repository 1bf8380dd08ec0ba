//! Operations that make no request, and the contents of messages.

use super::fake::*;
use imrs_protocol::script::*;
use imrs_protocol::*;

#[test]
fn a_script_runs_from_its_beginning_to_its_end() {
    let mut n = Slot::Task(0);
    let mut rig = Rig::new(|b| {
        n = b.variable("n", Type::Int8);
        b.set(n, 3).statement().load(n).push(4).int(Binary::Multiply).store(n);
        b.statement().push(1).op(Op::Pop);
    });
    assert_eq!(rig.script.activity(), Activity::NotBegun);
    assert_eq!(rig.tell(Signal::Nothing), [""; 0], "not before it begins");
    assert_eq!(rig.begin(), ["abandon", "ended Finished"]);
    assert_eq!((rig.var(n), rig.said.statements.clone()), (12, vec![0, 3, 8]));
    assert_eq!(rig.script.activity(), Activity::Ended(End::Finished));
    assert_eq!(rig.begin(), [""; 0], "once only");
    assert_eq!(rig.script.var(9), None);
}

#[test]
fn what_a_variable_cannot_hold_ends_the_script_and_is_not_stored() {
    for (of, value) in [(Type::Bool, 2), (Type::Int8, 128), (Type::Word, -1), (Type::Int16, 1 << 15)] {
        let mut slot = Slot::Task(0);
        let mut rig = Rig::new(|b| {
            slot = b.variable("x", of);
            b.push(value).store(slot);
        });
        assert_eq!(rig.begin(), ["abandon", "ended Fault { fault: Overflow, at: 1 }"]);
        assert_eq!((rig.var(slot), rig.script.position()), (0, 1));
    }
}

#[test]
fn branches_and_loops() {
    let (mut n, mut sum, mut more) = (Slot::Task(0), Slot::Task(0), Slot::Task(0));
    let mut rig = Rig::new(|b| {
        n = b.variable("n", Type::Int32);
        sum = b.variable("sum", Type::Int32);
        more = b.variable("more", Type::Bool);
        b.set(n, 5).set(more, 1);
        b.while_true(more, |b| {
            b.load(sum).load(n).int(Binary::Add).store(sum);
            b.load(n).push(1).int(Binary::Subtract).store(n);
            b.load(n).push(0).int(Binary::Greater);
            b.either(
                |b| {
                    b.set(more, 1);
                },
                |b| {
                    b.set(more, 0);
                },
            );
        });
        b.load(sum).push(15).int(Binary::Equal).then(|b| {
            b.set(n, 77);
        });
    });
    rig.begin();
    assert_eq!((rig.var(sum), rig.var(n)), (15, 77));
}

#[test]
fn a_script_that_never_waits_is_stopped() {
    let mut rig = Rig::new(|b| {
        b.forever(|b| {
            b.statement();
        });
    });
    let said = rig.begin();
    assert!(said[1].starts_with("ended Fault { fault: Runaway"), "{said:?}");
}

#[test]
fn assertions_and_aborts_end_it() {
    let mut rig = Rig::new(|b| {
        b.push(1).op(Op::Assert).push(0).op(Op::Assert);
    });
    assert_eq!(rig.begin(), ["abandon", "ended Assertion(3)"]);
    assert_eq!(rig.script.position(), 3);
    let mut rig = Rig::new(|b| {
        b.abort("partner missing");
    });
    assert_eq!(rig.begin(), ["abandon", "ended Aborted(0)"]);
    assert_eq!(rig.program.reasons, ["partner missing"]);
}

#[test]
fn the_driver_chooses_at_once_or_later() {
    let mut n = Slot::Task(0);
    let program = |n: &mut Slot| {
        Rig::new(|b| {
            *n = b.variable("n", Type::Int8);
            b.push(10).op(Op::Choose(3)).int(Binary::Add).store(*n);
        })
    };
    let mut rig = program(&mut n);
    assert_eq!(rig.begin(), ["choose 3"]);
    assert_eq!(rig.script.activity(), Activity::Chooses(3));
    assert_eq!(rig.acted(0, true, 1), [""; 0], "no action runs");
    assert_eq!(rig.step(ScriptInput::Chosen(2)), ["abandon", "ended Finished"]);
    assert_eq!(rig.var(n), 12);

    let mut rig = program(&mut n);
    rig.said.choice = Some(1);
    assert_eq!(rig.begin(), ["abandon", "ended Finished"]);
    assert_eq!(rig.var(n), 11);

    let mut rig = program(&mut n);
    rig.begin();
    assert_eq!(rig.step(ScriptInput::Chosen(3))[1], "ended Fault { fault: Unexpected, at: 1 }");
    let mut rig = program(&mut n);
    rig.said.choice = Some(3);
    assert_eq!(rig.begin()[1], "ended Fault { fault: Unexpected, at: 1 }");
}

#[test]
fn records_are_packed_little_endian() {
    let types = [Type::Bool, Type::Int8, Type::Int16, Type::Real, Type::Word];
    let mut rig = Rig::new(|b| {
        let format = b.format(&types);
        b.push(1).push(-2).push(0x0304).push(real(1.0).expect("finite")).push(0x0506_0708);
        b.op(Op::Send { port: TELL, to: Target::One(PEER), format, time_out: Some(Ticks(5)) });
    });
    assert_eq!(rig.begin(), ["send P1 One(TaskId(7)) [1, 254, 4, 3, 0, 0, 128, 63, 8, 7, 6, 5] for 5"]);
    assert_eq!(rig.accept(), ["abandon", "ended Finished"]);
}

#[test]
fn a_field_out_of_range_is_never_sent() {
    let mut rig = Rig::new(|b| {
        let format = b.format(&[Type::Int8]);
        b.push(300).op(Op::Send { port: TELL, to: Target::All, format, time_out: None });
    });
    assert_eq!(rig.begin(), ["abandon", "ended Fault { fault: Overflow, at: 1 }"]);
}

/// Adds seven variables of type word: 28 bytes, three packets.
fn long(b: &mut ProgramBuilder) -> Vec<(Type, Slot)> {
    (0..7).map(|i| (Type::Word, b.variable(&format!("w{i}"), Type::Word))).collect()
}

#[test]
fn long_messages_go_in_parts() {
    let mut rig = Rig::new(|b| {
        let fields = long(b);
        for (i, &(_, slot)) in (0..).zip(&fields) {
            b.set(slot, i);
        }
        b.send(TELL, Target::All, &fields);
    });
    assert_eq!(rig.begin(), ["part P1 1 [3, 0, 0, 0, 4, 0, 0, 0, 5, 0, 0, 0]"]);
    assert_eq!(rig.accept(), ["part P1 2 [6, 0, 0, 0]"]);
    assert_eq!(rig.accept(), ["send P1 All [0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]"]);
    assert_eq!(rig.accept(), ["abandon", "ended Finished"]);
}

#[test]
fn a_part_that_is_not_taken_ends_the_statement() {
    let send = |b: &mut ProgramBuilder| {
        let fields = long(b);
        b.send(TELL, Target::All, &fields);
        b.op(Op::Outcome).store(fields[0].1);
    };
    let mut rig = Rig::new(send);
    rig.begin();
    rig.tell(Signal::Fault(Fault::Fenced));
    assert_eq!(rig.var(Slot::Task(0)), StatementOutcome::Fenced as i64);
    let mut rig = Rig::new(send);
    rig.begin();
    let said = rig.tell(Signal::Fault(Fault::WrongLength));
    assert!(said[1].starts_with("ended Fault { fault: Request(WrongLength)"), "{said:?}");
    let mut rig = Rig::new(send);
    rig.begin();
    let said = rig.tell(replied(&[]));
    assert!(said[1].starts_with("ended Fault { fault: Unexpected"), "{said:?}");
}

#[test]
fn long_messages_are_read_whole_or_not_at_all() {
    let receive = || {
        let mut rig = Rig::new(|b| {
            let fields = long(b);
            b.receive(TELL, None, &fields);
        });
        rig.begin();
        rig
    };
    let contents = |bytes: &[u8]| Contents::new(bytes).expect("short");
    let mut rig = receive();
    rig.said.fragments.extend([(1, contents(&[1; 12])), (2, contents(&[2; 4]))]);
    rig.tell(status(&[0; 12]));
    assert_eq!(
        [0, 2, 3, 5, 6].map(|i| rig.var(Slot::Task(i))),
        [0, 0, 0x0101_0101, 0x0101_0101, 0x0202_0202]
    );

    for last in [None, Some(3), Some(5)] {
        let mut rig = receive();
        rig.said.fragments.insert(1, contents(&[1; 12]));
        rig.said.fragments.extend(last.map(|len| (2, contents(&vec![2; len]))));
        let said = rig.tell(status(&[7; 12]));
        assert_eq!(said[1], "ended Fault { fault: WrongContents, at: 4 }", "{last:?}");
        assert_eq!(rig.var(Slot::Task(0)), 0, "nothing is read in part");
    }
}

#[test]
fn what_is_no_value_of_its_type_is_not_read() {
    let mut rig = Rig::new(|b| {
        let on = b.variable("on", Type::Bool);
        b.receive(TELL, None, &[(Type::Bool, on)]);
    });
    rig.begin();
    assert_eq!(rig.tell(status(&[2]))[1], "ended Fault { fault: WrongContents, at: 4 }");
    let mut rig = Rig::new(|b| {
        b.op(Op::ReceivedPort).op(Op::Pop);
    });
    assert_eq!(rig.begin()[1], "ended Fault { fault: NothingReceived, at: 0 }");
}

#[test]
fn a_handler_may_come_after_a_choice_that_the_driver_gives_later() {
    let mut b = ProgramBuilder::new("test");
    let n = b.variable("n", Type::Int8);
    b.statement().op(Op::Choose(3)).store(n).set(n, 0).end();
    b.on_message(ASK, &[], |b, _| {
        b.reply(&[]);
    });
    let mut rig = Rig::of(b.finish().expect("a checked program"));
    rig.begin();
    assert_eq!(rig.accept(), ["boundary"]);
    assert_eq!(rig.accept(), ["choose 3"]);
    assert_eq!(rig.step(ScriptInput::Chosen(2)), ["boundary"]);
    assert_eq!(rig.var(n), 2);
    assert_eq!(rig.tell(call(ASK, 1, &[])), ["reply P0 T7 []"]);
}
