//! What packed scripts must hold (D51), the sets of outcomes that branches name, and drivers without optional callbacks.

use super::fake::*;
use imrs_protocol::script::*;
use imrs_protocol::*;

/// Accepts the requests of a script until one of its effects begins with `word`.
fn until(rig: &mut Rig, mut said: Vec<String>, word: &str) -> Vec<String> {
    for _ in 0..1000 {
        if said.iter().any(|words| words.starts_with(word)) {
            return said;
        }
        said = rig.accept();
    }
    panic!("no {word}, but {said:?}")
}

#[test]
fn more_truths_than_a_byte_holds_are_kept_apart() {
    let mut b = ProgramBuilder::new("test");
    let truths: Vec<Slot> = (0..17).map(|i| b.variable(&format!("b{i}"), Type::Bool)).collect();
    let number = b.variable("n", Type::Int16);
    for (i, &truth) in (0..).zip(&truths) {
        b.set(truth, i64::from([0, 1, 7, 8, 10, 16].contains(&i)));
    }
    b.set(number, -300).delay(Ticks(9)).end();
    let mut rig = Rig::of(b.finish().expect("a checked program"));
    // Every step of the rig packs the script, reads it back and compares.
    let said = rig.begin();
    until(&mut rig, said, "delay");
    let read: Vec<i64> = truths.iter().map(|&truth| rig.var(truth)).collect();
    assert_eq!(read, [1, 1, 0, 0, 0, 0, 0, 1, 1, 0, 1, 0, 0, 0, 0, 0, 1]);
    assert_eq!(rig.var(number), -300);
    let eight: Vec<u8> = same_when_packed(&rig.program, &rig.script);
    let truths = [0b1000_0011, 0b0000_0101, 0b0000_0001];
    assert!(eight.windows(3).any(|bytes| bytes == truths), "{eight:x?}");
}

#[test]
fn a_long_program_keeps_its_place() {
    let mut rig = Rig::new(|b| {
        let n = b.variable("n", Type::Int16);
        for i in 0..100 {
            b.set(n, i);
        }
        b.delay(Ticks(7)).delay(Ticks(8));
    });
    assert!(rig.program.code.len() > 256);
    let said = rig.begin();
    assert!(until(&mut rig, said, "delay")[0].ends_with(" 7"));
    assert!(rig.script.position() > 256, "at {}", rig.script.position());
    let bytes = same_when_packed(&rig.program, &rig.script);
    let mut loaded = Script::new(&rig.program);
    Decode::read(&bytes, true, |r| loaded.walk(&rig.program, r));
    rig.script = loaded;
    let Some(Request::Delay { id, .. }) = rig.said.requests.last().copied() else { panic!("it delays") };
    let said = rig.tell(Signal::TimeOut(id));
    assert!(until(&mut rig, said, "delay")[0].ends_with(" 8"), "it goes on there");
}

/// A rig of a script that runs an action for a command that it must answer.
fn serving() -> Rig {
    let mut rig = Rig::new(|b| {
        let n = b.variable("n", Type::Int32);
        b.receive(TELL, None, &[(Type::Int32, n)]).run("weld", Ticks(1), Ticks(2)).reply(&[]);
    });
    let said = rig.begin();
    until(&mut rig, said, "get");
    let said = rig.tell(command(&[1, 2, 3, 4]));
    until(&mut rig, said, "run");
    rig
}

#[test]
fn a_state_that_does_not_fit_is_refused_and_not_cut() {
    let mut rig = serving();
    let mut packed = |sequence: u32| {
        let sequences = [Seq24::new(sequence); 16];
        let frame = Frame { rounds: &[], sequences: &sequences, incarnations: true };
        Encode::bytes(&frame, |w| rig.script.walk(&rig.program, w))
    };
    // The command's number is one less than the frame's sequence number.
    let home = Frame::SEQUENCE.get();
    assert!(packed(home).is_ok());
    assert!(packed(home + 254).is_ok());
    assert_eq!(packed(home + 255), Err(Overflow), "too far back for a byte");
}

#[derive(Default)]
struct Seen(Vec<(TaskId, u32)>);

impl Walk for Seen {
    const PASS: Pass = Pass::Look;

    fn sequence(&mut self, source: TaskId, sequence: &mut Seq24) {
        self.0.push((source, sequence.get()));
    }
}

#[test]
fn the_number_of_a_command_to_answer_is_seen_and_forgotten_with_it() {
    let mut rig = serving();
    let program = rig.program.clone();
    let seen = |script: &mut Script| {
        let mut seen = Seen::default();
        script.walk(&program, &mut seen);
        seen.0
    };
    assert_eq!(seen(&mut rig.script), [(PEER, Frame::SEQUENCE.get() - 1)]);
    rig.script.bury(|to| to.source == PEER);
    assert_eq!(seen(&mut rig.script).len(), 1, "it can still be answered");
    rig.script.bury(|_| false);
    assert_eq!(seen(&mut rig.script), []);
}

#[test]
fn every_way_to_end_keeps_its_form_when_packed() {
    let mut abort = Rig::new(|b| {
        b.abort("broken");
    });
    let said = abort.begin();
    until(&mut abort, said, "ended");
    assert_eq!(abort.script.activity(), Activity::Ended(End::Aborted(0)));
    let fault = Rig::new(|b| {
        b.delay(Ticks(1));
    });
    let mut said = Said::default();
    let mut script = fault.script.clone();
    script.stop(&fault.program, ScriptFault::Runaway, &mut Requests::default(), &mut said);
    let end = End::Fault { fault: ScriptFault::Runaway, at: 0 };
    assert_eq!(script.activity(), Activity::Ended(end));
    same_when_packed(&fault.program, &script);
    // A script that has ended does not end again.
    script.stop(&fault.program, ScriptFault::Overflow, &mut Requests::default(), &mut said);
    assert_eq!(script.activity(), Activity::Ended(end));
}

#[test]
fn a_branch_takes_the_outcomes_that_its_words_say() {
    use StatementOutcome::{
        Done, Failed, Fenced, GaveUp, Incomplete, Message, Nothing, PeerRestarted, Refused, Released, Reply,
        TimedOutUnknown, TimedOutUnsent, Unanswerable,
    };
    let all = [
        Done,
        Reply,
        Refused,
        TimedOutUnsent,
        TimedOutUnknown,
        PeerRestarted,
        Incomplete,
        Message,
        Nothing,
        Released,
        GaveUp,
        Failed,
        Unanswerable,
        Fenced,
    ];
    let taken = |set: Outcomes| all.into_iter().filter(|&outcome| set.has(outcome)).collect::<Vec<_>>();
    let no_answer = [TimedOutUnsent, TimedOutUnknown, PeerRestarted, Incomplete, Nothing, GaveUp];
    assert_eq!(taken(Outcomes::TIME_OUT), no_answer);
    assert_eq!(taken(Outcomes::REFUSED), [Refused]);
    assert_eq!(taken(Outcomes::BRINGS), [Reply, Message]);
    let good = [Done, Reply, Message, Released];
    assert!(all.into_iter().all(|outcome| Outcomes::BAD.has(outcome) != good.contains(&outcome)));
    for outcome in all {
        assert_eq!(taken(Outcomes::of(&[outcome])), [outcome]);
    }
    assert_eq!(taken(Outcomes::of(&[])), []);
}

/// A driver that records only how the script ended.
#[derive(Default)]
struct Bare {
    ended: Option<End>,
}

impl ScriptOutbox for Bare {
    fn communication(&self) -> Option<(&CommTask, &NodeTable)> {
        None
    }
    fn run(&mut self, _: Action<'_>) {}
    fn cut_short(&mut self, _: u8) {}
    fn choose(&mut self, _: u16) -> Option<u16> {
        None
    }
    fn ended(&mut self, end: End) {
        self.ended = Some(end);
    }
}

#[test]
fn a_long_message_whose_rest_the_driver_does_not_keep_ends_the_task() {
    let run = |answer: bool| {
        let mut b = ProgramBuilder::new("test");
        let words: Vec<_> = (0..5).map(|i| (Type::Word, b.variable(&format!("w{i}"), Type::Word))).collect();
        if answer {
            b.send(ASK, Target::One(PEER), &[]).unpack(&words);
        } else {
            b.receive(TELL, None, &words);
        }
        b.end();
        let program = b.finish().expect("a checked program");
        let (mut host, mut out) = (ScriptHost::new(program.into()), Bare::default());
        host.tell(ScriptInput::Begin);
        while let Some(asked) = host.next(&mut out).filter(|_| out.ended.is_none()) {
            let signal = match asked {
                Request::Send { .. } => replied(&[7; 12]),
                Request::Get { .. } => command(&[7; 12]),
                _ => Signal::Accepted(1),
            };
            host.tell(ScriptInput::Signal(signal));
        }
        out.ended
    };
    for answer in [false, true] {
        let ended = run(answer);
        assert!(
            matches!(ended, Some(End::Fault { fault: ScriptFault::WrongContents, .. })),
            "{answer}: {ended:?}"
        );
    }
}

#[test]
fn reals_are_reckoned_as_reals() {
    let reals = |operator, a: f32, b: f32| {
        let push = |x| Term::Push(real(x).expect("finite"));
        eval(&[push(a), push(b), Term::Real(operator)], |_| None)
    };
    for (operator, expected) in
        [(Binary::Add, 6.5), (Binary::Subtract, 5.5), (Binary::Multiply, 3.0), (Binary::Divide, 12.0)]
    {
        assert_eq!(reals(operator, 6.0, 0.5), Ok(real(expected).expect("finite")), "6 {operator:?} 0.5");
    }
    assert_eq!(reals(Binary::Divide, f32::MAX, 0.5), Err(ScriptFault::NotFinite));
}

/// The first packet of a long message holds only some of its fields completely.
#[test]
fn values_are_read_as_far_as_they_stand_whole() {
    let format = Format { fields: vec![Type::Int16, Type::Bool, Type::Real, Type::Word, Type::Int32] };
    let mut bytes =
        [&(-300_i16).to_le_bytes()[..], &[1], &0.5_f32.to_le_bytes(), &7_u32.to_le_bytes()].concat();
    let read = |bytes: &[u8]| format.values(bytes).map(|(_, value)| value).collect::<Vec<_>>();
    assert_eq!(read(&bytes), [-300, 1, i64::from(0.5_f32.to_bits()), 7]);
    bytes.extend([0xff; 3]);
    assert_eq!(read(&bytes).len(), 4, "a byte of the last one is missing");
    bytes.push(0xff);
    assert_eq!(read(&bytes)[4..], [-1]);
    bytes[2] = 2;
    assert_eq!(read(&bytes), [-300], "two is no truth value");
}
