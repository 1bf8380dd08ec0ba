//! The abstract syntax tree (AST) of a cell file, by `specs/language/grammar.md`: names are not resolved, nothing is checked.

use crate::span::Span;
use imrs_protocol::Usage;
use imrs_protocol::script::{Binary, Type};

/// A name, and its span: where it stands in the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Name {
    /// The name, as written.
    pub text: String,
    /// The name's span.
    pub span: Span,
}

/// A duration such as `20 msec`, in microseconds, the unit of the runtime (D34, D42).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Duration {
    /// The duration in microseconds.
    pub usec: u64,
    /// The duration's span.
    pub span: Span,
}

/// A whole number, as in `class = 2` or `retry = 3`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Number {
    /// The number's value.
    pub value: u32,
    /// The number's span.
    pub span: Span,
}

/// A whole file. The parser has reported the parts that it could not parse, and left them out.
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

/// `tick` or `model tick`: how late a node's timers may fire, or the step of time in the checker (D42, D133).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TickDecl {
    /// Whether the declaration is `model tick`, not `tick`.
    pub model: bool,
    /// The duration of one tick.
    pub length: Duration,
    /// The declaration's span.
    pub span: Span,
}

/// A link between two nodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LinkDecl {
    /// The node at one end of the link.
    pub a: Name,
    /// The node at the other end.
    pub b: Name,
    /// The longest delay of a packet that is not lost (D20).
    pub delay: Duration,
    /// How many packets the link carries at most in each period.
    pub capacity: Option<Rate>,
    /// The link's span.
    pub span: Span,
}

/// A node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeDecl {
    /// The node's name.
    pub name: Name,
    /// The node's host, with its span.
    pub at: Option<(String, Span)>,
    /// The node's UDP port.
    pub port: Option<Number>,
    /// The node's span.
    pub span: Span,
}

/// A record: the format of a message, or the type of a variable.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TypeDecl {
    /// The record's name.
    pub name: Name,
    /// The record's fields.
    pub fields: Vec<Field>,
    /// The record's span.
    pub span: Span,
}

/// A field of a record, or a parameter of a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// The field's name.
    pub name: Name,
    /// The field's type. A parameter without a type takes it from the port's record, or is a `word` (C7, D93).
    pub of: Option<TypeName>,
}

/// The name of a type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TypeName {
    /// `bool`, `int8`, `int16`, `int32`, `integer`, `word`, `real`.
    Plain(Type, Span),
    /// `timer`: for variables only.
    Timer(Span),
    /// The name of a record type.
    Record(Name),
}

/// A task.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TaskDecl {
    /// The task's name.
    pub name: Name,
    /// `on n`: the node that runs the task.
    pub on: Name,
    /// `module m`: the module that the task belongs to (D32).
    pub module: Option<Name>,
    /// `standby of t`: the primary whose standby this task is (D30).
    pub standby_of: Option<Name>,
    /// `extern`: a Rust program is the task's behaviour.
    pub is_extern: Option<Span>,
    /// `rate = n/dur` of an `extern` task.
    pub rate: Option<Rate>,
    /// The task's ports.
    pub ports: Vec<PortDecl>,
    /// The task's variables and timers.
    pub variables: Vec<VarDecl>,
    /// The task's handlers, in the order of the file.
    pub handlers: Vec<Handler>,
    /// The task's body. Handlers and statements may alternate. An `order` in front of the handlers is its first statement.
    pub body: Vec<Statement>,
    /// `takeover ...`: what the task runs when it takes over from its primary (D61).
    pub takeover: Option<Vec<Statement>>,
    /// The span of the task's head: `task armL on nl`.
    pub span: Span,
    /// The name after `end`.
    pub end: Option<Name>,
}

/// `n/dur`: at most `n` messages in each `dur` (D53).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rate {
    /// `n`: the number of messages.
    pub count: Number,
    /// `dur`: the period.
    pub per: Duration,
}

/// `port` or `use_port` (Figure 1).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortDecl {
    /// Whether the declaration is `port`, by the owner, not `use_port`, by a user.
    pub owner: bool,
    /// The port's name.
    pub name: Name,
    /// The port's parameters. A single parameter of a record type stands for the record's fields.
    pub parameters: Vec<Field>,
    /// `-> type`: the type of an answer.
    pub answer: Option<TypeName>,
    /// The port's options, in the order of the file.
    pub options: Vec<PortOption>,
    /// The port's span.
    pub span: Span,
}

/// An option of a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortOption {
    /// The option with the value that is set.
    pub kind: PortOptionKind,
    /// The option's span.
    pub span: Span,
}

/// The options of a port: those of Figures 1 and 2 of the paper of 1987, and this project's own.
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
        /// Whether the option says `paper`: each penalty then lengthens the message's time_out, as in the paper (D4).
        literal: bool,
        /// How long a rejected message waits until it is offered again.
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
    /// The names of the variables.
    pub names: Vec<Name>,
    /// The type of the variables.
    pub of: TypeName,
    /// The declaration's span.
    pub span: Span,
}

/// `on ... do ... end;`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Handler {
    /// The event that runs the handler.
    pub trigger: Trigger,
    /// The handler's statements.
    pub body: Vec<Statement>,
    /// The span of the handler's head.
    pub span: Span,
}

/// The event that runs a handler.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Trigger {
    /// `on query p(a)`, `on receive p(a)`
    Message {
        /// Whether the trigger is `on query`, not `on receive`.
        query: bool,
        /// The port whose message runs the handler.
        port: Name,
        /// The variables for the message's fields.
        variables: Vec<Name>,
    },
    /// `on silence p 10 msec when expr`: no message came through the port for this long.
    Silence {
        /// The port whose silence runs the handler.
        port: Name,
        /// For how long no message must come.
        length: Duration,
        /// The condition that must hold during the whole silence.
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
    /// What the statement does.
    pub kind: StatementKind,
    /// What runs if the statement times out, is refused or fails: `on time_out do ... end`.
    pub branches: Vec<Branch>,
    /// The statement's span, without its branches and inner statements.
    pub span: Span,
}

/// A branch of a statement: `on time_out do ... end`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Branch {
    /// The outcome of the statement for which this branch runs.
    pub when: BranchKind,
    /// The branch's statements.
    pub body: Vec<Statement>,
    /// The span of the branch's head.
    pub span: Span,
}

/// The outcomes of a statement for which branches can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BranchKind {
    /// `on time_out`: the wait timed out. Also runs for a command that was never sent, or whose peer restarted.
    TimeOut,
    /// `on refused`
    Refused,
    /// `on failed`: of a `run`, or of a reply that comes too late.
    Failed,
}

/// What a statement does.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StatementKind {
    /// `send p({t,} args)`, `use_send p(args)`, `query p({t,} args) -> vars`. Tasks or modules named in front of the
    /// arguments are the recipients; name resolution tells them from arguments.
    Send {
        /// The keyword: `send`, `use_send` or `query`.
        verb: Verb,
        /// The port through which the message goes.
        port: Name,
        /// The recipients and the values.
        arguments: Vec<Expr>,
        /// The variables for the answer.
        into: Vec<Place>,
        /// A TTL below the port's time_out.
        within: Option<Duration>,
    },
    /// `receive`, `receive p(vars)`, `receive p(vars) from t`
    Receive {
        /// The port; without a port, the statement takes the most urgent message of all ports that have no handler.
        port: Option<Name>,
        /// The variables for the message.
        into: Vec<Place>,
        /// The only sender whose messages the statement takes.
        from: Option<Name>,
        /// The longest wait. The time_out of the port is a limit, too. With neither limit the statement waits for ever.
        within: Option<Duration>,
    },
    /// `reply(args)` and `response(args)` answer the last message. `reply p(args) for t` answers an earlier one.
    /// `reply p(args) for t ticket n` answers a message that another task received, through a port of usage `reply` (D11).
    Reply {
        /// Whether the keyword is `response`, not `reply`.
        response: bool,
        /// The port whose message is answered.
        port: Option<Name>,
        /// The values of the answer.
        arguments: Vec<Expr>,
        /// The task whose message the reply answers.
        asker: Option<Name>,
        /// The number of the message that another task received.
        ticket: Option<Expr>,
    },
    /// `waitfor p(args)`
    Waitfor {
        /// The port of the rendezvous.
        port: Name,
        /// The values that this task sends to the other members.
        arguments: Vec<Expr>,
        /// How long the task waits at most, if less than the port's time_out.
        within: Option<Duration>,
    },
    /// `order a > b > self`
    Order(Vec<Name>),
    /// `delay 3 msec`
    Delay(Duration),
    /// `run weld p.spot -> x takes 2..3 sec`
    Run {
        /// The action that runs.
        action: Name,
        /// The action's arguments.
        arguments: Vec<Expr>,
        /// The variables that get the action's result.
        into: Vec<Place>,
        /// `in 0 .. 1000`: the least and the greatest result.
        range: Option<(Expr, Expr)>,
        /// The action's shortest and longest duration; without them, the action takes no time.
        takes: Option<(Duration, Duration)>,
    },
    /// `start held 4 sec`
    Start {
        /// The timer to start.
        timer: Name,
        /// How long the timer runs until it expires.
        length: Duration,
    },
    /// `stop held`
    Stop(Name),
    /// `atomic ... end`
    Atomic(Vec<Statement>),
    /// `place := expr`. If the place is a heartbeat port, the answers to its heartbeats carry the value (D61).
    Assign {
        /// The variable or the port.
        place: Place,
        /// The value that the variable gets.
        value: Expr,
    },
    /// `if .. then .. elsif .. else .. end`
    If {
        /// The conditions, each with the statements that run if it holds.
        arms: Vec<(Expr, Vec<Statement>)>,
        /// The statements that run if no condition holds.
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

/// The keyword of a sending statement (R43).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Verb {
    /// `send`: by the owner.
    Send,
    /// `use_send`: by a user.
    UseSend,
    /// `query`
    Query,
}

/// A variable, or a field of a variable: `me.height`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The names, outermost first.
    pub path: Vec<Name>,
    /// The place's span.
    pub span: Span,
}

/// An expression.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Expr {
    /// The expression's kind.
    pub kind: ExprKind,
    /// The expression's span.
    pub span: Span,
}

/// The kinds of expressions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ExprKind {
    /// `true`, `false`
    Bool(bool),
    /// `900`
    Int(i64),
    /// `0.5`: its digits as text.
    Real(String),
    /// `me.height`, `outcome`, `refused`, `sender`, `armL.me.moving` or `r1.active` in a check.
    Path(Place),
    /// `trunc(x)`: the whole part of a real.
    Trunc(Box<Expr>),
    /// A question about a task. In a check: `lift.arrived(armR)`, `r2.asked(grab)`. After a query to several tasks:
    /// `grab.answered(r1)`. After a waitfor or an answer: `lift.height(armR)`, a value that `armR` sent.
    Call {
        /// The question: `lift.arrived`.
        of: Place,
        /// The task or port that the question is about.
        argument: Name,
    },
    /// `not x`
    Not(Box<Expr>),
    /// `-x`
    Negate(Box<Expr>),
    /// `x + y` or another operator. The parser marks every operator as one on integers, because it knows no types yet.
    Binary(Binary, Box<Expr>, Box<Expr>),
}

/// `couple ...`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CoupleDecl {
    /// The process class (Table 1), and the coupled tasks.
    pub kind: CoupleKind,
    /// The declaration's span.
    pub span: Span,
}

/// The process classes of Table 1. Each turns on checks of its own (D24).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CoupleKind {
    /// `loose {a, b} over t`
    Loose {
        /// The tasks that share something.
        tasks: Vec<Name>,
        /// The task that administers what the other tasks of the couple share.
        over: Name,
    },
    /// `tight {a, b}`
    Tight(Vec<Name>),
    /// `serial a -> b`
    Serial(Name, Name),
    /// `work a -> b lease .. takeover .. every .. via p` (D61)
    Work {
        /// The task that acts first.
        primary: Name,
        /// The task that takes over.
        standby: Name,
        /// Whether primary and standby swap roles at a take-over: `<->`.
        mutual: bool,
        /// How long the primary may act after it sent an answer that the standby echoes.
        lease: Duration,
        /// How long after the last answer from the primary the standby takes over.
        takeover: Duration,
        /// The period of the heartbeats.
        every: Duration,
        /// The port of the heartbeats.
        via: Name,
    },
}

/// `faults ...;`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FaultsDecl {
    /// The faults, in the order of the file.
    pub faults: Vec<Fault>,
    /// The declaration's span.
    pub span: Span,
}

/// A fault, and how often it occurs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fault {
    /// `loss n`: up to `n` packets are lost.
    Loss(Number),
    /// `dup n`: up to `n` packets arrive twice.
    Dup(Number),
    /// `fail n`: up to `n` actions fail.
    Fail(Number),
    /// `drift n`: up to `n` ticks are skipped or counted twice by some clock.
    Drift(Number),
    /// `crash t`: the node of the task crashes. The node may start again.
    Crash(Name),
    /// `pause t up to 300 msec`: the node of the task takes no step for a while, at most this long.
    Pause(Name, Option<Duration>),
    /// `cut a--b`: the link passes no packets for a while.
    Cut(Name, Name),
}

/// `check name: never expr;`
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CheckDecl {
    /// The check's name.
    pub name: Name,
    /// The property that must hold.
    pub kind: CheckKind,
    /// The check's span.
    pub span: Span,
}

/// A property to check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CheckKind {
    /// `never expr`
    Never(Expr),
    /// `always expr`, `expr`
    Always(Expr),
    /// `expr leads expr within 25 msec`
    Leads {
        /// The premise of the property.
        when: Expr,
        /// The consequence: whenever the premise is true, it must be true then or later.
        then: Expr,
        /// The longest time from the premise to the consequence.
        within: Duration,
    },
}
