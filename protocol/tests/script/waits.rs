//! Every statement that makes a request, and every outcome that it can have.

use super::fake::*;
use imrs_protocol::script::StatementOutcome as Ended;
use imrs_protocol::script::*;
use imrs_protocol::*;

/// Runs one statement and answers it. Returns its request, its outcome and its value.
fn end_of(op: impl FnOnce(&mut ProgramBuilder), signal: Signal) -> (String, i64, i64) {
    let mut rig = Rig::new(|b| {
        let (outcome, value) = (b.variable("outcome", Type::Int8), b.variable("value", Type::Int32));
        op(b);
        b.op(Op::Outcome).store(outcome).op(Op::Value).store(value);
    });
    let asked = rig.begin().remove(0);
    let said = rig.tell(signal);
    assert_eq!(said, ["abandon", "ended Finished"], "{asked} {signal:?}");
    (asked, rig.var(Slot::Task(0)), rig.var(Slot::Task(1)))
}

fn send(b: &mut ProgramBuilder) {
    b.send(ASK, Target::All, &[]);
}

#[test]
fn a_message_ends_in_one_of_the_outcomes_of_its_class() {
    let cases = [
        (Signal::Accepted(3), Ended::Done, 3),
        (replied(&[]), Ended::Reply, 0),
        (Signal::Outcome(Outcome::Refused), Ended::Refused, 0),
        (Signal::Outcome(Outcome::TimedOutUnsent), Ended::TimedOutUnsent, 0),
        (Signal::Outcome(Outcome::TimedOutUnknown), Ended::TimedOutUnknown, 0),
        (Signal::Outcome(Outcome::PeerRestarted), Ended::PeerRestarted, 0),
        (Signal::Fault(Fault::Fenced), Ended::Fenced, 0),
    ];
    for (signal, outcome, value) in cases {
        assert_eq!(end_of(send, signal), ("send P0 All []".into(), outcome as i64, value), "{signal:?}");
    }
}

#[test]
fn a_message_to_several_tells_who_answered() {
    let answers =
        |answered| Answers { asked: 0b1110, answered, refused: 0b100, restarted: 0b1000, unsent: 0 };
    let whole =
        Signal::Answers { port: ASK, answers: Answers { asked: 6, answered: 6, ..Answers::default() } };
    assert_eq!(end_of(send, whole).1, Ended::Reply as i64);
    let mut rig = Rig::new(|b| {
        let masks: Vec<Slot> = (0..5).map(|_| b.variable("mask", Type::Word)).collect();
        let (came, said) = (b.variable("came", Type::Bool), b.variable("said", Type::Int16));
        b.send(ASK, Target::Some(0b1110), &[]);
        let marks = [Mark::Asked, Mark::Answered, Mark::Refused, Mark::Restarted, Mark::Unsent];
        for (mark, slot) in marks.into_iter().zip(masks) {
            b.op(Op::Mark(mark)).store(slot);
        }
        let format = b.format(&[Type::Int16]);
        let into = b.places(&[said]);
        b.op(Op::Answer { port: ASK, task: TaskId(8) }).store(came);
        b.op(Op::Answer { port: ASK, task: PEER });
        b.then(|b| {
            b.op(Op::Unpack { format, into });
        });
    });
    assert_eq!(rig.begin(), ["send P0 Some(14) []"]);
    rig.said.answers.insert((Some(PEER), 0), Contents::new(&[5, 1]).expect("short"));
    rig.tell(Signal::Answers { port: ASK, answers: answers(0b10) });
    assert_eq!(
        [0, 1, 2, 3, 4, 5, 6].map(|i| rig.var(Slot::Task(i))),
        [0b1110, 0b10, 0b100, 0b1000, 0, 0, 261]
    );
    let some = Signal::Answers { port: ASK, answers: answers(0b10) };
    assert_eq!(end_of(send, some).1, Ended::Incomplete as i64);
}

#[test]
fn an_answer_is_read_into_variables_and_a_time_out_leaves_them() {
    let query = |answer| {
        let mut rig = Rig::new(|b| {
            let (height, late) = (b.variable("height", Type::Int16), b.variable("late", Type::Bool));
            b.send(ASK, Target::One(PEER), &[(Type::Int16, height)]).unpack(&[(Type::Int16, height)]);
            b.when(Outcomes::TIME_OUT, |b| {
                b.set(late, 1);
            });
        });
        assert_eq!(rig.begin(), ["send P0 One(TaskId(7)) [0, 0]"]);
        rig.tell(answer);
        [0, 1].map(|i| rig.var(Slot::Task(i)))
    };
    assert_eq!(query(replied(&[44, 1])), [300, 0]);
    assert_eq!(query(Signal::Outcome(Outcome::TimedOutUnknown)), [0, 1]);
}

#[test]
fn a_long_answer_is_fetched_from_the_communication_task() {
    let mut rig = Rig::new(|b| {
        let fields: Vec<_> = (0..4).map(|_| (Type::Word, b.variable("w", Type::Word))).collect();
        b.send(ASK, Target::One(PEER), &[]).unpack(&fields);
    });
    rig.begin();
    rig.said.answers.insert((None, 1), Contents::new(&[9, 0, 0, 0]).expect("short"));
    rig.tell(replied(&[1; 12]));
    assert_eq!([2, 3].map(|i| rig.var(Slot::Task(i))), [0x0101_0101, 9]);
}

#[test]
fn a_get_ends_in_a_message_or_in_nothing() {
    let get = |port, source, time_out| {
        move |b: &mut ProgramBuilder| {
            b.op(Op::Get { port, source, time_out });
        }
    };
    assert_eq!(
        end_of(get(Some(TELL), Some(PEER), Some(Ticks(4))), status(&[1])),
        ("get P1 from T7 for 4".into(), Ended::Message as i64, 0)
    );
    assert_eq!(end_of(get(None, None, None), Signal::Nothing), ("get any".into(), Ended::Nothing as i64, 0));
}

#[test]
fn a_message_says_where_it_came_from() {
    let mut rig = Rig::new(|b| {
        let (port, source) = (b.variable("port", Type::Word), b.variable("source", Type::Word));
        b.op(Op::Get { port: None, source: None, time_out: None });
        b.op(Op::ReceivedPort).store(port).op(Op::ReceivedSource).store(source);
    });
    rig.begin();
    rig.tell(status(&[]));
    assert_eq!([0, 1].map(|i| rig.var(Slot::Task(i))), [1, 7]);
}

#[test]
fn a_command_is_answered_once() {
    let mut rig = Rig::new(|b| {
        let (word, twice) = (b.variable("word", Type::Int8), b.variable("twice", Type::Int8));
        b.set(word, 5).receive(TELL, None, &[]).reply(&[(Type::Int8, word)]);
        b.reply(&[(Type::Int8, word)]).op(Op::Outcome).store(twice);
        b.delay(Ticks(1));
    });
    assert_eq!(rig.begin(), ["get P1"]);
    assert_eq!(rig.tell(command(&[])), ["reply P1 T7 [5]"]);
    assert_eq!(rig.accept(), ["delay 0 1"], "the second one has nothing to answer and asks for nothing");
    assert_eq!(rig.var(Slot::Task(1)), Ended::Unanswerable as i64);
}

#[test]
fn what_is_never_answered_is_noted() {
    let mut rig = Rig::new(|b| {
        b.receive(TELL, None, &[]).receive(TELL, None, &[]);
    });
    rig.begin();
    assert_eq!(rig.tell(command(&[])), ["get P1"]);
    assert_eq!(rig.tell(command(&[])), ["unanswered T7", "unanswered T7", "abandon", "ended Finished"]);
    let mut rig = Rig::new(|b| {
        b.receive(TELL, None, &[]).reply(&[]).receive(TELL, None, &[]);
    });
    rig.begin();
    rig.tell(command(&[]));
    rig.tell(Signal::Fault(Fault::Late));
    assert_eq!(rig.tell(status(&[])), ["abandon", "ended Finished"], "an answer that was late was one");
}

#[test]
fn answers_that_come_too_late_are_an_outcome() {
    for fault in [Fault::Late, Fault::NothingToAnswer] {
        let mut rig = Rig::new(|b| {
            let outcome = b.variable("outcome", Type::Int8);
            b.receive(TELL, None, &[]).reply(&[]).op(Op::Outcome).store(outcome);
        });
        rig.begin();
        rig.tell(command(&[]));
        rig.tell(Signal::Fault(fault));
        assert_eq!(rig.var(Slot::Task(0)), Ended::Unanswerable as i64);
    }
}

#[test]
fn a_waitfor_releases_or_is_given_up() {
    let arrive = |b: &mut ProgramBuilder| {
        let format = b.format(&[Type::Int16]);
        b.push(513).op(Op::Arrive { port: LIFT, format, time_out: Some(Ticks(9)) });
    };
    let asked = "arrive P2 [1, 2, 0, 0, 0, 0, 0, 0] for 9";
    let released = Signal::Released { port: LIFT, round: Round(4), by: ReleasedBy::AllArrived };
    assert_eq!(end_of(arrive, released), (asked.into(), Ended::Released as i64, 0));
    let gave_up = Signal::GaveUp { port: LIFT, round: Round(4), missing: 0b101 };
    assert_eq!(end_of(arrive, gave_up), (asked.into(), Ended::GaveUp as i64, 5));
}

#[test]
fn the_other_requests_are_accepted() {
    let order = |b: &mut ProgramBuilder| {
        b.order(&[Ranked::Port(ASK), Ranked::Own]);
    };
    assert_eq!(end_of(order, Signal::Accepted(0)).0, "order [Port(PortId(0)), Own]");
    let publish = |b: &mut ProgramBuilder| {
        let format = b.format(&[Type::Int8]);
        b.push(-1).op(Op::Publish { format });
    };
    assert_eq!(end_of(publish, Signal::Accepted(0)).0, "publish [255]");
    let stop = |b: &mut ProgramBuilder| {
        let timer = b.timer("held");
        b.op(Op::Stop(timer));
    };
    assert_eq!(end_of(stop, Signal::Accepted(0)).0, "stop 0");
    let lease = |b: &mut ProgramBuilder| {
        b.op(Op::Lease);
    };
    assert_eq!(end_of(lease, Signal::Granted(6)), ("lease".into(), Ended::Done as i64, 0));
    let delay = |b: &mut ProgramBuilder| {
        b.delay(Ticks(3));
    };
    assert_eq!(end_of(delay, Signal::TimeOut(TimeId(0))).0, "delay 0 3");
}

#[test]
fn delays_are_named_behind_the_timers() {
    let mut rig = Rig::new(|b| {
        b.timer("held");
        b.delay(Ticks(3));
    });
    assert_eq!(rig.begin(), ["delay 1 3"]);
    assert_eq!(rig.tell(Signal::TimeOut(TimeId(0)))[1], "ended Fault { fault: Unexpected, at: 1 }");
}

#[test]
fn an_action_brings_a_result_or_fails() {
    let mut rig = Rig::new(|b| {
        let (height, failed) = (b.variable("height", Type::Int16), b.variable("failed", Type::Bool));
        let action = b.action("read_height");
        b.push(4).push(5).op(Op::Run { action, arguments: 2, least: Ticks(1), most: Ticks(2) });
        b.op(Op::Value).store(height).when(Outcomes::BAD, |b| {
            b.set(failed, 1);
        });
        b.run("grip", Ticks(3), Ticks(5)).when(Outcomes::BAD, |b| {
            b.set(failed, 1);
        });
    });
    assert_eq!(rig.begin(), ["work", "run 0 [4, 5] at 0 takes 1..2"]);
    assert_eq!(rig.script.activity(), Activity::Acts);
    assert_eq!(rig.acted(3, true, 1), [""; 0], "no such thread");
    assert_eq!(rig.acted(0, true, -300), ["done"]);
    assert_eq!(rig.acted(0, true, 5), [""; 0], "it has ended already");
    assert_eq!(rig.accept(), ["work", "run 1 [] at 0 takes 3..5"]);
    assert_eq!([0, 1].map(|i| rig.var(Slot::Task(i))), [-300, 0]);
    rig.acted(0, false, 0);
    rig.accept();
    assert_eq!(rig.var(Slot::Task(1)), 1);
}

#[test]
fn atomic_sections_nest() {
    let mut rig = Rig::new(|b| {
        for opens in [true, true, false, false] {
            b.op(Op::Atomic(opens));
        }
    });
    let mut said = rig.begin();
    for _ in 0..3 {
        said.extend(rig.accept());
    }
    assert_eq!(said, ["atomic true", "atomic true", "atomic true", "atomic false"]);
}

#[test]
fn a_request_at_fault_ends_the_script() {
    for fault in [Fault::NotYourPort, Fault::WrongUsage, Fault::NotAPeer, Fault::Busy, Fault::NotInterrupted]
    {
        let mut rig = Rig::new(send);
        rig.begin();
        let said = rig.tell(Signal::Fault(fault));
        assert_eq!(said, ["abandon".into(), format!("ended Fault {{ fault: Request({fault:?}), at: 1 }}")]);
    }
    let mut rig = Rig::new(|b| {
        b.run("grip", Ticks(1), Ticks(1));
    });
    rig.begin();
    let said = rig.tell(Signal::Fault(Fault::WrongUsage));
    assert_eq!(said[..2], ["cut short 0", "abandon"]);
}

#[test]
fn an_answer_to_another_question_ends_the_script() {
    let wrong = [
        Signal::Nothing,
        Signal::Cancelled,
        Signal::Granted(1),
        Signal::TimeOut(TimeId(0)),
        status(&[]),
        Signal::Interrupt(Call::Timer(TimeId(0))),
        Signal::Interrupt(Call::TakeOver(1)),
        call(ASK, 1, &[]),
    ];
    for signal in wrong {
        let mut rig = Rig::new(send);
        rig.begin();
        assert_eq!(rig.tell(signal)[1], "ended Fault { fault: Unexpected, at: 1 }", "{signal:?}");
        assert_eq!(rig.accept(), [""; 0]);
    }
}
