//! What a cell file says, as written: one type per production of the grammar (`specs/language/grammar.md`). Names are
//! not resolved here, and nothing is checked. Every node knows where it stands.

use crate::span::Span;
use imrs_protocol::Usage;
use imrs_protocol::script::{Binary, Type};

/// A name and where it stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Name {
    /// The name, as written.
    pub text: String,
    /// Where.
    pub span: Span,
}

/// A duration: `20 msec`. In microseconds, the unit of the runtime (D34, D42).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Duration {
    /// How long.
    pub usec: u64,
    /// Where.
    pub span: Span,
}

/// A number as an option takes it: `class = 2`, `retry = 3`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Number {
    /// Its value.
    pub value: u32,
    /// Where.
    pub span: Span,
}

/// A whole file. What could not be parsed is missing; the parser has said so.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct File {
    /// `cell name;`
    pub name: Option<Name>,
    /// The declarations, in the order of the file.
    pub items: Vec<Item>,
}

/// A declaration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Item {
    /// `tick 1 msec;`, `model tick 5 msec;`
    Tick(TickDecl),
    /// `link a -- b delay 1 msec;`
    Link(LinkDecl),
    /// `node n at "10.0.0.1" port 4000;`
    Node(NodeDecl),
    /// `type t is record ... end;`
    Type(TypeDecl),
    /// `task t on n ... end t;`
    Task(TaskDecl),
    /// `couple ...;`
    Couple(CoupleDecl),
    /// `faults loss 2 crash hoist;`
    Faults(FaultsDecl),
    /// `check c: never ...;`
    Check(CheckDecl),
}

/// The lateness of timers, or the granularity of the model (D42).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TickDecl {
    /// Whether it is the model's.
    pub model: bool,
    /// How long.
    pub length: Duration,
    /// Where.
    pub span: Span,
}

/// A link between two nodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LinkDecl {
    /// One end.
    pub a: Name,
    /// The other.
    pub b: Name,
    /// The longest time of a packet that is not lost (D20).
    pub delay: Duration,
    /// Where.
    pub span: Span,
}

/// A node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeDecl {
    /// Its name.
    pub name: Name,
    /// Its host, and where that stands.
    pub at: Option<(String, Span)>,
    /// Its UDP port.
    pub port: Option<Number>,
    /// Where.
    pub span: Span,
}

/// A record: the format of a message, or the type of a variable.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TypeDecl {
    /// Its name.
    pub name: Name,
    /// Its fields.
    pub fields: Vec<Field>,
    /// Where.
    pub span: Span,
}

/// A field of a record, or a parameter of a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name.
    pub name: Name,
    /// Its type; a parameter may have none, and is one word then (C7).
    pub of: Option<TypeName>,
}

/// The name of a type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TypeName {
    /// `bool`, `int8`, `int16`, `int32`, `integer`, `word`, `real`.
    Plain(Type, Span),
    /// `timer`: of a variable only.
    Timer(Span),
    /// A record.
    Record(Name),
}

/// A task.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TaskDecl {
    /// Its name.
    pub name: Name,
    /// `on n`.
    pub on: Name,
    /// `module m` (D32).
    pub module: Option<Name>,
    /// `standby of t` (D30).
    pub standby_of: Option<Name>,
    /// `extern`: its behaviour is a Rust program.
    pub is_extern: Option<Span>,
    /// `rate = n/dur` of an `extern` task.
    pub rate: Option<Rate>,
    /// Its ports.
    pub ports: Vec<PortDecl>,
    /// Its variables and timers.
    pub variables: Vec<VarDecl>,
    /// Its handlers, in the order of the file.
    pub handlers: Vec<Handler>,
    /// Its body. Handlers and statements may alternate in the text; an `order` in front of the handlers is the first
    /// statement of the body.
    pub body: Vec<Statement>,
    /// `takeover ...` (D61).
    pub takeover: Option<Vec<Statement>>,
    /// Where its head stands: `task armL on nl`.
    pub span: Span,
    /// The name after `end`.
    pub end: Option<Name>,
}

/// `n/dur`: so many in so much time (D53).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rate {
    /// How many.
    pub count: Number,
    /// In how much time.
    pub per: Duration,
}

/// `port` or `use_port` (Figure 1).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortDecl {
    /// Whether it is the owner's: `port`.
    pub owner: bool,
    /// Its name.
    pub name: Name,
    /// Its parameters; a single one with a record's type stands for the record's fields.
    pub parameters: Vec<Field>,
    /// `-> type`: what an answer holds.
    pub answer: Option<TypeName>,
    /// Its options, in the order of the file.
    pub options: Vec<PortOption>,
    /// Where.
    pub span: Span,
}

/// An option of a port and where it stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortOption {
    /// Which.
    pub kind: PortOptionKind,
    /// Where.
    pub span: Span,
}

/// The options of Figures 1 and 2, and ours.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PortOptionKind {
    /// `usage = query`
    Usage(Usage),
    /// `message_format = Beat`
    MessageFormat(Name),
    /// `user_list = {armR, hoist}`
    UserList(Vec<Name>),
    /// `time_out = 5 msec`
    TimeOut(Duration),
    /// `class = 2`
    Class(Number),
    /// `bounded_buffer[2]`
    BoundedBuffer(Number),
    /// `retry = 3`
    Retry(Number),
    /// `resend = 2 msec`
    Resend(Duration),
    /// `penalty = 20 msec`, `penalty = paper 20 msec`
    Penalty {
        /// Whether the rule is the paper's literal one (D4).
        literal: bool,
        /// How long.
        length: Duration,
    },
    /// `rate = 20/1 sec`
    Rate(Rate),
    /// `latest`
    Latest,
}

/// `var a, b: int8;`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VarDecl {
    /// Their names.
    pub names: Vec<Name>,
    /// Their type.
    pub of: TypeName,
    /// Where.
    pub span: Span,
}

/// `on ... do ... end;`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Handler {
    /// What calls it.
    pub trigger: Trigger,
    /// What it does.
    pub body: Vec<Statement>,
    /// Where its head stands.
    pub span: Span,
}

/// What calls a handler.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Trigger {
    /// `on query p(a)`, `on receive p(a)`
    Message {
        /// Whether it says `query`.
        query: bool,
        /// The port.
        port: Name,
        /// Its variables.
        variables: Vec<Name>,
    },
    /// `on silence p 10 msec when expr`: no message came through the port for so long.
    Silence {
        /// The port.
        port: Name,
        /// For how long.
        length: Duration,
        /// While this is true.
        when: Option<Expr>,
    },
    /// `on expiry t`
    Expiry(Name),
    /// `on fence` (D61)
    Fence,
}

/// A statement.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Statement {
    /// What it does.
    pub kind: StatementKind,
    /// What happens when it ends otherwise than hoped for: `on time_out do ... end`.
    pub branches: Vec<Branch>,
    /// Where, without its branches and the statements in it.
    pub span: Span,
}

/// `on time_out do ... end` and its like, after a statement.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Branch {
    /// When it is taken.
    pub when: BranchKind,
    /// What it does.
    pub body: Vec<Statement>,
    /// Where its head stands.
    pub span: Span,
}

/// When a branch of a statement is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BranchKind {
    /// `on time_out`: also unsent, unknown, and the restart of the peer.
    TimeOut,
    /// `on refused`
    Refused,
    /// `on failed`: of `run`.
    Failed,
}

/// What a statement does.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StatementKind {
    /// `send p({t,} args)`, `use_send p(args)`, `query p({t,} args) -> vars`. Names of tasks or modules in front say
    /// who; name resolution tells them from arguments.
    Send {
        /// The word: `send`, `use_send` or `query`.
        verb: Verb,
        /// The port.
        port: Name,
        /// Who, and what.
        arguments: Vec<Expr>,
        /// Where the answer goes.
        into: Vec<Place>,
        /// A shorter life than the port's.
        within: Option<Duration>,
    },
    /// `receive`, `receive p(vars)`, `receive p(vars) from t`
    Receive {
        /// The port; without one, the most urgent message of all that have no handler.
        port: Option<Name>,
        /// Where the message goes.
        into: Vec<Place>,
        /// From whom.
        from: Option<Name>,
        /// How long it waits; without it, as long as the port's time_out says, or without end.
        within: Option<Duration>,
    },
    /// `reply(args)`, `response(args)`; `reply p(args) for t` answers a message taken before; `reply p(args) for t ticket
    /// n` one that another task took, through a port of usage `reply` (D11).
    Reply {
        /// Whether it says `response`.
        response: bool,
        /// The port.
        port: Option<Name>,
        /// The answer.
        arguments: Vec<Expr>,
        /// Whose message it answers.
        asker: Option<Name>,
        /// The number of the message.
        ticket: Option<Expr>,
    },
    /// `waitfor p(args)`
    Waitfor {
        /// The port.
        port: Name,
        /// What the others are told.
        arguments: Vec<Expr>,
        /// A shorter patience than the port's.
        within: Option<Duration>,
    },
    /// `order a > b > self`
    Order(Vec<Name>),
    /// `delay 3 msec`
    Delay(Duration),
    /// `run weld p.spot -> x takes 2..3 sec`
    Run {
        /// The action.
        action: Name,
        /// Its arguments.
        arguments: Vec<Expr>,
        /// Where its result goes.
        into: Vec<Place>,
        /// `in 0 .. 1000`: the least and the most that its result is.
        range: Option<(Expr, Expr)>,
        /// How long it takes, at least and at most; without it, no time.
        takes: Option<(Duration, Duration)>,
    },
    /// `start held 4 sec`
    Start {
        /// The timer.
        timer: Name,
        /// How long.
        length: Duration,
    },
    /// `stop held`
    Stop(Name),
    /// `atomic ... end`
    Atomic(Vec<Statement>),
    /// `place := expr`; of a beat port: what the beats' answers carry (D61).
    Assign {
        /// Where.
        place: Place,
        /// What.
        value: Expr,
    },
    /// `if .. then .. elsif .. else .. end`
    If {
        /// Conditions and what is done where they are true.
        arms: Vec<(Expr, Vec<Statement>)>,
        /// What is done where none is.
        otherwise: Option<Vec<Statement>>,
    },
    /// `loop .. end`
    Loop(Vec<Statement>),
    /// `while .. do .. end`
    While(Expr, Vec<Statement>),
    /// `exit`: leaves the innermost loop.
    Exit,
    /// `skip`
    Skip,
    /// `abort "reason"`
    Abort(String),
    /// `assert expr`
    Assert(Expr),
}

/// The word of a sending statement (R43).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Verb {
    /// `send`: by the owner.
    Send,
    /// `use_send`: by a user.
    UseSend,
    /// `query`
    Query,
}

/// A variable or a field of one: `me.height`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The names, outermost first.
    pub path: Vec<Name>,
    /// Where.
    pub span: Span,
}

/// An expression.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Expr {
    /// What it is.
    pub kind: ExprKind,
    /// Where.
    pub span: Span,
}

/// What an expression is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ExprKind {
    /// `true`, `false`
    Bool(bool),
    /// `900`
    Int(i64),
    /// `0.5`: the text, which is a number.
    Real(String),
    /// `me.height`, `outcome`, `refused`, `sender`, `armL.me.moving` or `r1.active` in a check.
    Path(Place),
    /// `trunc(x)`: the whole part of a real.
    Trunc(Box<Expr>),
    /// `lift.arrived(armR)`, `r2.asked(grab)`: in a check; `grab.answered(r1)`: after a query to several; `lift.height(armR)`:
    /// what `armR` told there.
    Call {
        /// What is asked: `lift.arrived`.
        of: Place,
        /// About whom.
        argument: Name,
    },
    /// `not x`
    Not(Box<Expr>),
    /// `-x`
    Negate(Box<Expr>),
    /// `x + y` and its like; of integers, until types are known.
    Binary(Binary, Box<Expr>, Box<Expr>),
}

/// `couple ...`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CoupleDecl {
    /// The class (Table 1).
    pub kind: CoupleKind,
    /// Where.
    pub span: Span,
}

/// The process classes of Table 1, which turn on checks (D24).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CoupleKind {
    /// `loose {a, b} over t`
    Loose {
        /// Who shares.
        tasks: Vec<Name>,
        /// The task that administers what they share.
        over: Name,
    },
    /// `tight {a, b}`
    Tight(Vec<Name>),
    /// `serial a -> b`
    Serial(Name, Name),
    /// `work a -> b lease .. takeover .. every .. via p` (D61)
    Work {
        /// Who acts first.
        primary: Name,
        /// Who takes over.
        standby: Name,
        /// Whether they exchange roles then: `<->`.
        mutual: bool,
        /// How long the primary may act after an answer that was echoed.
        lease: Duration,
        /// When the standby takes over.
        takeover: Duration,
        /// The period of the beats.
        every: Duration,
        /// Their port.
        via: Name,
    },
}

/// `faults ...;`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FaultsDecl {
    /// The faults, in the order of the file.
    pub faults: Vec<Fault>,
    /// Where.
    pub span: Span,
}

/// What may go wrong, and how often.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fault {
    /// `loss n`: so many packets are lost.
    Loss(Number),
    /// `dup n`: so many packets arrive twice.
    Dup(Number),
    /// `fail n`: so many actions fail.
    Fail(Number),
    /// `drift n`: so many ticks are left out or counted twice by some clock.
    Drift(Number),
    /// `crash t`: the node of the task stops, and starts again or not.
    Crash(Name),
    /// `pause t up to 300 msec`: the node of the task takes no step for a while, at most so long.
    Pause(Name, Option<Duration>),
    /// `cut a--b`: the link passes nothing for a while.
    Cut(Name, Name),
}

/// `check name: never expr;`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CheckDecl {
    /// Its name.
    pub name: Name,
    /// What must hold.
    pub kind: CheckKind,
    /// Where.
    pub span: Span,
}

/// What must hold.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CheckKind {
    /// `never expr`
    Never(Expr),
    /// `always expr`, `expr`
    Always(Expr),
    /// `expr leads expr within 25 msec`
    Leads {
        /// Whenever this is true,
        when: Expr,
        /// this is, then or later,
        then: Expr,
        /// within so much time.
        within: Duration,
    },
}
