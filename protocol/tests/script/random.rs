//! No program and no input panics, every state comes back from its packed form, and a shift of ids changes nothing.

use super::fake::*;
use imrs_protocol::script::*;
use imrs_protocol::*;
use proptest::collection::vec;
use proptest::prelude::*;

fn slots() -> impl Strategy<Value = Slot> {
    prop_oneof![(0..6_u16).prop_map(Slot::Task), (0..3_u16).prop_map(Slot::Local)]
}

fn operators() -> impl Strategy<Value = Binary> {
    use Binary::{
        Add, And, Divide, Equal, Greater, GreaterOrEqual, Less, LessOrEqual, Multiply, NotEqual, Or,
        Remainder, Subtract,
    };
    prop::sample::select(vec![
        Add,
        Subtract,
        Multiply,
        Divide,
        Remainder,
        Equal,
        NotEqual,
        Less,
        LessOrEqual,
        Greater,
        GreaterOrEqual,
        And,
        Or,
    ])
}

fn terms() -> impl Strategy<Value = Term> {
    let edges = prop::sample::select(vec![i64::MIN, -1, 0, 1, 255, 0x7f80_0000, i64::MAX]);
    prop_oneof![
        4 => (-3..300_i64).prop_map(Term::Push),
        1 => edges.prop_map(Term::Push),
        3 => slots().prop_map(Term::Load),
        3 => operators().prop_map(Term::Int),
        1 => operators().prop_map(Term::Real),
        1 => prop::sample::select(vec![Term::Negate, Term::NegateReal, Term::Not, Term::ToReal, Term::ToInt]),
        1 => Just(Term::Of { task: PEER, variable: 0 }),
        1 => Just(Term::Is(Predicate::Active(PEER))),
    ]
}

/// Every operation, most of them naming what exists.
fn ops() -> impl Strategy<Value = Op> {
    let port = || (0..4_u16).prop_map(PortId);
    let small = || 0..5_u16;
    let ticks = || (0..9_u64).prop_map(Ticks);
    let address = || 0..40_u16;
    let timer = || (0..4_u8).prop_map(TimeId);
    let time_out = || prop::option::of(ticks());
    let target = prop_oneof![Just(Target::All), Just(Target::One(PEER)), any::<u64>().prop_map(Target::Some)];
    let plain = prop::sample::select(vec![
        Op::Statement,
        Op::Pop,
        Op::Outcome,
        Op::Value,
        Op::Mark(Mark::Asked),
        Op::Mark(Mark::Answered),
        Op::ReceivedPort,
        Op::ReceivedSource,
        Op::Atomic(true),
        Op::Atomic(false),
        Op::Lease,
        Op::Assert,
        Op::HandlerEnd,
        Op::End,
        Op::Abort(0),
    ]);
    let jumps = prop_oneof![
        address().prop_map(Op::Jump),
        address().prop_map(Op::Unless),
        (any::<u16>(), address()).prop_map(|(set, to)| Op::On { outcomes: Outcomes(set), to }),
    ];
    let asks = prop_oneof![
        (port(), target, small(), time_out()).prop_map(|(port, to, format, time_out)| Op::Send {
            port,
            to,
            format,
            time_out
        }),
        (prop::option::of(port()), time_out()).prop_map(|(port, time_out)| Op::Get {
            port,
            source: None,
            time_out
        }),
        small().prop_map(|format| Op::Reply { format }),
        small().prop_map(|format| Op::Publish { format }),
        (port(), small(), time_out()).prop_map(|(port, format, time_out)| Op::Arrive {
            port,
            format,
            time_out
        }),
        (0..3_u16).prop_map(Op::Order),
        ticks().prop_map(Op::Delay),
        (timer(), ticks()).prop_map(|(timer, length)| Op::Start { timer, length }),
        timer().prop_map(Op::Stop),
        (small(), 0..3_u8).prop_map(|(action, arguments)| Op::Run {
            action,
            arguments,
            least: Ticks(1),
            most: Ticks(2)
        }),
    ];
    prop_oneof![
        4 => plain,
        6 => terms().prop_map(Op::Term),
        4 => slots().prop_map(Op::Store),
        2 => jumps,
        6 => asks,
        1 => (0..4_u16).prop_map(Op::Choose),
        1 => port().prop_map(|port| Op::Answer { port, task: PEER }),
        2 => (small(), 0..6_u16).prop_map(|(format, into)| Op::Unpack { format, into }),
    ]
}

/// The variables of a task and of each handler: one of each type.
const VARIABLES: [Type; 6] = [Type::Bool, Type::Int8, Type::Int16, Type::Int32, Type::Word, Type::Real];
const HANDLED: [PortId; 2] = [ASK, PortId(3)];
const HELD: TimeId = TimeId(0);

/// Writes statements as random bytes say; what they say is always well formed.
struct Writer<'a> {
    genes: std::slice::Iter<'a, u8>,
    variables: Vec<(Type, Slot)>,
}

impl Writer<'_> {
    fn gene(&mut self, below: u8) -> u8 {
        self.genes.next().map_or(0, |gene| gene % below)
    }

    fn variable(&mut self) -> (Type, Slot) {
        let at = usize::from(self.gene(6)).min(self.variables.len() - 1);
        self.variables[at]
    }

    /// So many fields that one, two or three packets are needed.
    fn fields(&mut self) -> Vec<(Type, Slot)> {
        let count = [0, 1, 1, 4, 9][usize::from(self.gene(5))];
        (0..count).map(|_| self.variable()).collect()
    }

    fn block(&mut self, b: &mut ProgramBuilder, depth: u8) {
        for _ in 0..=self.gene(3) {
            self.statement(b, depth);
        }
    }

    fn statement(&mut self, b: &mut ProgramBuilder, depth: u8) {
        let time = Ticks(u64::from(self.gene(5)));
        let kind = self.gene(if depth < 3 { 20 } else { 15 });
        match kind {
            0 => {
                let fields = self.fields();
                b.send(ASK, Target::All, &fields);
            }
            1 => {
                let (fields, answer) = (self.fields(), self.variable());
                b.send(TELL, Target::One(PEER), &fields).unpack(&[answer]);
            }
            2 => {
                let fields = self.fields();
                b.receive(TELL, Some(time), &fields);
            }
            3 => {
                b.statement().op(Op::Get { port: None, source: None, time_out: None });
            }
            4 | 5 => {
                let fields = self.fields();
                b.reply(&fields);
            }
            6 => {
                b.waitfor(LIFT);
            }
            7 => {
                b.delay(time);
            }
            8 => {
                b.start(HELD, time);
            }
            9 => {
                b.statement().op(Op::Stop(HELD));
            }
            10 | 11 => {
                b.run("act", time, Ticks(9));
            }
            12 => {
                b.order(&[Ranked::Port(ASK), Ranked::Own]);
            }
            13 => {
                let (_, slot) = self.variable();
                b.statement().op(Op::Choose(2)).store(slot);
            }
            14 => {
                let (of, slot) = self.variable();
                if of != Type::Real {
                    b.statement()
                        .load(slot)
                        .push(1)
                        .int(Binary::Add)
                        .push(2)
                        .int(Binary::Remainder)
                        .store(slot);
                }
                if self.gene(3) == 0 {
                    let format = b.format(&[Type::Bool]);
                    b.statement().push(1).op(Op::Publish { format });
                }
                if self.gene(3) == 0 {
                    b.statement().op(Op::Lease);
                }
            }
            15 => {
                b.statement().op(Op::Atomic(true));
                self.block(b, depth + 1);
                b.statement().op(Op::Atomic(false));
            }
            16 => {
                b.when(Outcomes::BAD, |b| self.block(b, depth + 1));
            }
            17 => {
                let (_, slot) = self.variable();
                b.statement().load(slot).then(|b| self.block(b, depth + 1));
            }
            18 => {
                let (_, slot) = self.variable();
                b.while_true(slot, |b| self.block(b, depth + 1));
            }
            _ => {
                b.forever(|b| self.block(b, depth + 1));
            }
        }
    }
}

fn of_each_type(mut add: impl FnMut(&str, Type) -> Slot) -> Vec<(Type, Slot)> {
    VARIABLES.into_iter().map(|of| (of, add("v", of))).collect()
}

/// A well formed program of random statements.
fn written(genes: &[u8]) -> Program {
    let mut b = ProgramBuilder::new("random");
    let variables = of_each_type(|name, of| b.variable(name, of));
    let mut writer = Writer { genes: genes.iter(), variables };
    let features = writer.gene(16);
    if features & 8 != 0 {
        b = b.every_statement();
    }
    b.timer("held");
    writer.block(&mut b, 0);
    b.forever(|b| writer.block(b, 0));
    let mut handler = |b: &mut ProgramBuilder, trigger| {
        b.handler(trigger, |b| {
            writer.variables = of_each_type(|name, of| b.local(name, of));
            writer.block(b, 1);
        });
    };
    HANDLED.into_iter().for_each(|port| handler(&mut b, Trigger::Message(port)));
    handler(&mut b, Trigger::Timer(HELD));
    if features & 1 != 0 {
        handler(&mut b, Trigger::Fenced);
    }
    writer.variables.truncate(0);
    writer.variables.extend((0..6).map(|i| (VARIABLES[usize::from(i)], Slot::Task(i))));
    if features & 2 != 0 {
        b.takeover(|b| writer.block(b, 0));
    }
    b.finish().expect("well formed")
}

fn well_formed() -> impl Strategy<Value = Program> {
    vec(any::<u8>(), 0..200).prop_map(|genes| written(&genes))
}

/// Programs with random operations in random places.
fn programs() -> impl Strategy<Value = Program> {
    (well_formed(), vec((any::<prop::sample::Index>(), ops()), 0..4)).prop_map(|(mut program, changes)| {
        for (at, op) in changes {
            let at = at.index(program.code.len());
            program.code[at] = op;
        }
        program
    })
}

/// What a communication task may say, and what it never would.
fn inputs() -> impl Strategy<Value = ScriptInput> {
    let bytes = || vec(0..3_u8, 0..=12);
    let port = || (0..4_u16).prop_map(PortId);
    let class = || prop::sample::select(vec![Class::Command, Class::Status]);
    let delivery = move || {
        (port(), class(), 0..9_u32, bytes())
            .prop_map(|(port, class, age, bytes)| message(port, class, age, &bytes))
    };
    let outcome = prop_oneof![
        bytes().prop_map(|bytes| replied(&bytes)),
        prop::sample::select(vec![
            Signal::Outcome(Outcome::Refused),
            Signal::Outcome(Outcome::TimedOutUnsent),
            Signal::Outcome(Outcome::TimedOutUnknown),
            Signal::Outcome(Outcome::PeerRestarted),
        ]),
    ];
    let fault = prop::sample::select(vec![Fault::Busy, Fault::Fenced, Fault::Late, Fault::WrongUsage]);
    let released = Signal::Released { port: LIFT, round: Round(1), by: ReleasedBy::AllArrived };
    let plain = prop::sample::select(vec![
        Signal::Nothing,
        Signal::Cancelled,
        Signal::Granted(2),
        released,
        Signal::GaveUp { port: LIFT, round: Round(1), missing: u64::MAX },
        Signal::Answers { port: ASK, answers: Answers { asked: 3, answered: 1, ..Answers::default() } },
        Signal::Interrupt(Call::Fenced),
        Signal::Interrupt(Call::TakeOver(1)),
    ]);
    let signal = prop_oneof![
        12 => (0..3_u16).prop_map(Signal::Accepted),
        3 => delivery().prop_map(Signal::Message),
        4 => delivery().prop_map(|d| Signal::Interrupt(Call::Message(d))),
        2 => (0..4_u8).prop_map(|timer| Signal::Interrupt(Call::Timer(TimeId(timer)))),
        3 => (0..5_u8).prop_map(|id| Signal::TimeOut(TimeId(id))),
        3 => outcome,
        2 => fault.prop_map(Signal::Fault),
        4 => plain,
    ];
    prop_oneof![
        12 => signal.prop_map(ScriptInput::Signal),
        4 => (0..3_u8, any::<bool>(), -9..300_i32)
            .prop_map(|(level, ok, value)| ScriptInput::Acted { level, ok, value }),
        2 => (0..4_u16).prop_map(ScriptInput::Chosen),
        1 => Just(ScriptInput::Begin),
    ]
}

/// Answers what the script waits for, where that is possible: so that random runs come far. `pick` chooses among answers.
fn answer(rig: &Rig, pick: u8) -> Option<ScriptInput> {
    let signal = match rig.script.activity() {
        Activity::Acts => {
            return Some(ScriptInput::Acted {
                level: rig.script.depth(),
                ok: pick.is_multiple_of(2),
                value: i32::from(pick),
            });
        }
        Activity::Chooses(among) => return Some(ScriptInput::Chosen(u16::from(pick) % among)),
        Activity::NotBegun | Activity::Passive | Activity::Ended(_) => return None,
        Activity::Waits => match rig.said.requests.last()? {
            Request::Get { .. } if pick.is_multiple_of(3) => Signal::Nothing,
            Request::Get { port, .. } => {
                Signal::Message(message(port.unwrap_or(TELL), Class::Command, u32::from(pick), &[pick & 1]))
            }
            Request::Send { .. } if pick.is_multiple_of(2) => replied(&[pick & 1]),
            Request::Send { .. } => Signal::Outcome(Outcome::TimedOutUnknown),
            Request::Arrive { port, .. } => {
                Signal::Released { port: *port, round: Round(1), by: ReleasedBy::AllArrived }
            }
            Request::Delay { id, .. } => Signal::TimeOut(*id),
            Request::Abandon => Signal::Cancelled,
            Request::Lease => Signal::Granted(1),
            Request::Part { .. }
            | Request::Reply { .. }
            | Request::Order(_)
            | Request::Handle { .. }
            | Request::Start { .. }
            | Request::Stop { .. }
            | Request::Boundary
            | Request::Work
            | Request::Done
            | Request::Return
            | Request::Atomic(_)
            | Request::Publish(_)
            | Request::Cancel => Signal::Accepted(1),
        },
    };
    Some(ScriptInput::Signal(signal))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 3000, failure_persistence: None, ..ProptestConfig::default() })]

    /// Malformed programs and senseless inputs included. [`Rig::step`] packs and unpacks every state.
    #[test]
    fn no_program_and_no_input_panics(program in programs(), inputs in vec((any::<u8>(), inputs()), 1..60)) {
        let _ = program.check();
        let mut rig = Rig::of(program);
        rig.begin();
        for (pick, input) in inputs {
            let input = if pick.is_multiple_of(4) { input } else { answer(&rig, pick).unwrap_or(input) };
            rig.step(input);
            if let Activity::Ended(end) = rig.script.activity() {
                rig.step(input);
                prop_assert_eq!(rig.script.activity(), Activity::Ended(end), "an end is one");
            }
        }
    }

    /// A program that passes its check never turns out to be malformed, whatever its communication task says.
    #[test]
    fn a_checked_program_is_well_formed(program in prop_oneof![well_formed(), programs()], inputs in vec((any::<u8>(), inputs()), 1..60)) {
        if program.check().is_err() {
            return Ok(());
        }
        let mut rig = Rig::of(program);
        rig.begin();
        for (pick, input) in inputs {
            rig.step(answer(&rig, pick).unwrap_or(input));
            let malformed = matches!(
                rig.script.activity(),
                Activity::Ended(End::Fault { fault: ScriptFault::Malformed, .. })
            );
            prop_assert!(!malformed, "{:?}", rig.script);
        }
    }

    /// D51: a shift of the ids of a source changes no bytes, and any bytes are loaded without a panic.
    #[test]
    fn packed_states_are_relative_and_total(
        program in programs(),
        inputs in vec((any::<u8>(), inputs()), 1..40),
        by: u32,
        bytes in vec(any::<u8>(), 0..80),
    ) {
        struct Shift(u32);
        impl VisitMut for Shift {
            fn instant(&mut self, _: &mut Ticks) {}
            fn round(&mut self, _: PortId, _: &mut Round) {}
            fn sequence(&mut self, _: TaskId, sequence: &mut Seq24) {
                *sequence = sequence.plus(self.0);
            }
        }
        let mut rig = Rig::of(program);
        rig.begin();
        for (pick, input) in inputs {
            rig.step(answer(&rig, pick).unwrap_or(input));
        }
        let plain = same_when_packed(&rig.program, &rig.script);
        let mut shifted = rig.script.clone();
        shifted.visit_mut(&mut Shift(by));
        let frame = Frame { rounds: &[], sequences: &[Frame::SEQUENCE.plus(by); 16], lives: true };
        let mut room = [0; 4096];
        let len = shifted.store(&rig.program, &frame, &mut room).expect("fits");
        prop_assert_eq!(&room[..len], &plain[..]);
        for short in 0..len {
            prop_assert_eq!(shifted.store(&rig.program, &frame, &mut room[..short]), Err(Overflow));
        }
        rig.script.load(&rig.program, true, &bytes);
        for input in [ScriptInput::Signal(Signal::Accepted(1)), ScriptInput::Chosen(0), ScriptInput::Begin] {
            rig.script.step(&rig.program, input, &mut rig.said);
        }
    }
}

/// The next request that is no boundary, and what was said besides. A task that runs on and on is stopped, as a node
/// does it.
fn past_boundaries(rig: &mut Rig, mut said: Vec<String>) -> Vec<String> {
    let mut all = Vec::new();
    for _ in 0..STEP_LIMIT {
        let boundary = said.last().is_some_and(|last| last == "boundary");
        all.extend(said.into_iter().filter(|words| words != "boundary"));
        if !boundary {
            return all;
        }
        said = rig.accept();
    }
    rig.script.stop(&rig.program, ScriptFault::Runaway, &mut rig.said);
    std::mem::take(&mut rig.said.words)
}

/// Whether a script was stopped because it never waited.
fn ran_away(rig: &Rig) -> bool {
    matches!(rig.script.activity(), Activity::Ended(End::Fault { fault: ScriptFault::Runaway, .. }))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, failure_persistence: None, ..ProptestConfig::default() })]

    /// D45: where no handler is called at a boundary, it does not matter how many there are.
    #[test]
    fn fused_statements_reach_the_same_states(program in well_formed(), inputs in vec((any::<u8>(), inputs()), 1..60)) {
        let rig = |fusing| Rig::of(Program { fusing, ..program.clone() });
        let (mut fused, mut every) = (rig(Fusing::Fused), rig(Fusing::EveryStatement));
        let (one, other) = (fused.begin(), every.begin());
        let (one, other) = (past_boundaries(&mut fused, one), past_boundaries(&mut every, other));
        prop_assert!(one == other || (ran_away(&fused) && ran_away(&every)));
        for (pick, input) in inputs {
            let input = if pick.is_multiple_of(4) { input } else { answer(&fused, pick).unwrap_or(input) };
            let (one, other) = (fused.step(input), every.step(input));
            let (one, other) = (past_boundaries(&mut fused, one), past_boundaries(&mut every, other));
            if ran_away(&fused) {
                prop_assert!(ran_away(&every));
                return Ok(());
            }
            prop_assert_eq!(one, other);
            prop_assert_eq!(&fused.script, &every.script);
        }
    }
}

/// Random runs are worth something only if they come far.
#[test]
fn random_programs_reach_what_they_are_for() {
    use proptest::strategy::ValueTree;
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let mut seen = std::collections::BTreeMap::<String, u32>::new();
    for _ in 0..3000 {
        let program = programs().new_tree(&mut runner).expect("a program").current();
        let checked = program.check().is_ok();
        *seen.entry(format!("checked {checked}")).or_default() += 1;
        let mut rig = Rig::of(program);
        let mut said = rig.begin();
        for _ in 0..40 {
            let (pick, input) = (any::<u8>(), inputs()).new_tree(&mut runner).expect("an input").current();
            for words in said.drain(..) {
                *seen.entry(words.split(' ').next().expect("a word").into()).or_default() += 1;
            }
            *seen.entry(format!("depth {}", rig.script.depth())).or_default() += 1;
            said = rig.step(if pick.is_multiple_of(4) { input } else { answer(&rig, pick).unwrap_or(input) });
        }
    }
    let wanted = [
        "checked true",
        "checked false",
        "depth 1",
        "depth 2",
        "send",
        "part",
        "get",
        "reply",
        "arrive",
        "order",
        "delay",
        "start",
        "stop",
        "run",
        "work",
        "done",
        "return",
        "boundary",
        "atomic",
        "publish",
        "lease",
        "choose",
        "abandon",
        "unanswered",
        "cut",
        "handle",
    ];
    for word in wanted {
        assert!(seen.get(word).is_some_and(|&times| times >= 5), "{word}: {seen:?}");
    }
}
