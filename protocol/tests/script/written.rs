//! Random programs, well formed and not, and random inputs.

use super::fake::*;
use imrs_protocol::script::*;
use imrs_protocol::*;
use proptest::collection::vec;
use proptest::prelude::*;

fn slots() -> impl Strategy<Value = Slot> {
    prop_oneof![(0..6_u16).prop_map(Slot::Task), (0..3_u16).prop_map(Slot::Local)]
}

pub fn operators() -> impl Strategy<Value = Binary> {
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

/// Any operation; most of them name entries that exist.
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
        Op::ReceivedId,
        Op::Published,
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
        (port(), small()).prop_map(|(port, format)| Op::ReplyFor { port, format }),
        (port(), small()).prop_map(|(port, format)| Op::ReplyOwed { port, task: PEER, format }),
        (port(), small()).prop_map(|(port, format)| Op::Arrival { port, task: PEER, format }),
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
const HELD: TimeId = TimeId(0);

/// The ports that a random program uses.
#[derive(Clone, Copy)]
pub struct Ends {
    pub asks: [PortId; 2],
    pub tells: PortId,
    pub hears: PortId,
    pub handled: [PortId; 2],
    /// Whether the program is for a real node. On a real node both ends of a port must agree on formats, loops must wait,
    /// and no couple is declared.
    pub real: bool,
}

/// The ports of a script that has no node.
const ALONE: Ends =
    Ends { asks: [ASK, ASK], tells: TELL, hears: TELL, handled: [ASK, PortId(3)], real: false };

/// Writes a program whose statements random bytes choose. The program is always well formed.
struct Writer<'a> {
    genes: std::slice::Iter<'a, u8>,
    variables: Vec<(Type, Slot)>,
    ends: Ends,
}

impl Writer<'_> {
    fn gene(&mut self, below: u8) -> u8 {
        self.genes.next().map_or(0, |gene| gene % below)
    }

    fn variable(&mut self) -> (Type, Slot) {
        let at = usize::from(self.gene(6)).min(self.variables.len() - 1);
        self.variables[at]
    }

    /// The fields of a message of one, two or three packets.
    fn fields(&mut self) -> Vec<(Type, Slot)> {
        if self.ends.real {
            return vec![self.variables[4]; 4];
        }
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
                let port = self.ends.asks[usize::from(self.gene(2))];
                b.send(port, Target::All, &fields);
            }
            1 => {
                let (fields, answer) = (self.fields(), self.fields());
                b.send(self.ends.tells, Target::All, &fields).unpack(&answer);
            }
            2 => {
                let fields = self.fields();
                b.receive(self.ends.hears, Some(time), &fields);
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
                b.order(&[Ranked::Port(self.ends.handled[0]), Ranked::Timers, Ranked::Own]);
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
                if !self.ends.real && self.gene(3) == 0 {
                    let format = b.format(&[Type::Bool]);
                    b.statement().push(1).op(Op::Publish { format });
                }
                if !self.ends.real && self.gene(3) == 0 {
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
                b.while_true(slot, |b| self.turn(b, depth + 1));
            }
            _ => {
                b.forever(|b| self.turn(b, depth + 1));
            }
        }
    }

    /// Writes the body of a loop.
    fn turn(&mut self, b: &mut ProgramBuilder, depth: u8) {
        if self.ends.real {
            b.delay(Ticks(1));
        }
        self.block(b, depth);
    }
}

pub fn of_each_type(mut add: impl FnMut(&str, Type) -> Slot) -> Vec<(Type, Slot)> {
    VARIABLES.into_iter().map(|of| (of, add("v", of))).collect()
}

/// A well formed program of random statements.
pub fn written(genes: &[u8], ends: Ends) -> Program {
    let mut b = ProgramBuilder::new("random");
    let variables = of_each_type(|name, of| b.variable(name, of));
    let mut writer = Writer { genes: genes.iter(), variables, ends };
    let features = writer.gene(16);
    b.timer("held");
    writer.block(&mut b, 0);
    b.forever(|b| writer.turn(b, 0));
    let mut handler = |b: &mut ProgramBuilder, trigger| {
        b.handler(trigger, |b| {
            writer.variables = of_each_type(|name, of| b.local(name, of));
            writer.block(b, 1);
        });
    };
    ends.handled.into_iter().for_each(|port| handler(&mut b, Trigger::Message(port)));
    handler(&mut b, Trigger::Timer(HELD));
    if features & 1 != 0 {
        handler(&mut b, Trigger::Fenced);
    }
    writer.variables.truncate(0);
    writer.variables.extend((0..6).map(|i| (VARIABLES[usize::from(i)], Slot::Task(i))));
    if features & 2 != 0 {
        b.takeover(|b| writer.block(b, 0));
    }
    let fusing = if features & 8 == 0 { Fusing::Fused } else { Fusing::EveryStatement };
    Program { fusing, ..b.finish().expect("well formed") }
}

pub fn well_formed() -> impl Strategy<Value = Program> {
    vec(any::<u8>(), 0..200).prop_map(|genes| written(&genes, ALONE))
}

/// Programs with random operations in random places.
pub fn programs() -> impl Strategy<Value = Program> {
    (well_formed(), vec((any::<prop::sample::Index>(), ops()), 0..4)).prop_map(|(mut program, changes)| {
        for (at, op) in changes {
            let at = at.index(program.code.len());
            program.code[at] = op;
        }
        program
    })
}

/// Inputs that a communication task may give, and inputs that it never gives.
pub fn inputs() -> impl Strategy<Value = ScriptInput> {
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
