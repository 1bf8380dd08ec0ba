//! The high-level intermediate representation (HIR) of a cell: names are resolved, expressions are typed. The checks read it;
//! lowering turns it into declarations and scripts of [`imrs_protocol`]. Ids are positions, as in [`imrs_protocol::Cell`].

mod whole;

pub use whole::{Check, CheckKind, Couple, CoupleKind, Faults, Pause};

use crate::ast::BranchKind;
use crate::span::Span;
use imrs_protocol::script::{Op, Slot, Type};
use imrs_protocol::{Class, NodeId, PortId, Ranked, TaskId, TimeId, Usage};

/// A duration in microseconds, with its span.
pub use crate::ast::Duration;

/// A whole cell.
#[derive(Clone, Debug, Default)]
pub struct Hir {
    /// Its name.
    pub name: String,
    /// Whether the paper's own rules replace this project's decisions (D92).
    pub paper: bool,
    /// How late a timer may fire (D42).
    pub tick: Option<Duration>,
    /// The step in which the checker tries the durations between the least and the most of an action (D133).
    pub model_tick: Option<Duration>,
    /// The nodes, by [`NodeId`].
    pub nodes: Vec<Node>,
    /// The links.
    pub links: Vec<Link>,
    /// The record types.
    pub records: Vec<Record>,
    /// The tasks, by [`TaskId`].
    pub tasks: Vec<Task>,
    /// The ports, by [`PortId`].
    pub ports: Vec<Port>,
    /// The process classes (D24).
    pub couples: Vec<Couple>,
    /// The fault hypotheses.
    pub faults: Vec<Faults>,
    /// The properties that must hold.
    pub checks: Vec<Check>,
    /// The byte offset at which each line of the text begins: findings at run time name lines.
    pub lines: Vec<u32>,
}

impl Hir {
    /// The line in which a span begins, from 1.
    #[must_use]
    pub fn line(&self, span: Span) -> usize {
        self.lines.partition_point(|&begin| begin <= span.start).max(1)
    }

    /// The route with the least total delay: positions in [`Hir::links`], last link first; empty if there is none.
    #[must_use]
    pub fn way(&self, from: NodeId, to: NodeId) -> Vec<usize> {
        let mut best: Vec<Option<(u64, Option<usize>)>> = vec![None; self.nodes.len()];
        // In a cell with errors a task's node may be missing.
        if from.index().max(to.index()) >= best.len() {
            return Vec::new();
        }
        best[from.index()] = Some((0, None));
        for _ in 0..self.nodes.len() {
            for (at, link) in self.links.iter().enumerate() {
                for (a, b) in [(link.a, link.b), (link.b, link.a)] {
                    let Some((before, _)) = best[a.index()] else { continue };
                    let length = before.saturating_add(link.delay.usec.max(1));
                    if best[b.index()].is_none_or(|(known, _)| length < known) {
                        best[b.index()] = Some((length, Some(at)));
                    }
                }
            }
        }
        let (mut way, mut at) = (Vec::new(), to);
        while let Some((_, Some(link))) = best[at.index()] {
            way.push(link);
            at = if self.links[link].a == at { self.links[link].b } else { self.links[link].a };
        }
        way
    }
}

/// A node.
#[derive(Clone, Debug)]
pub struct Node {
    /// Its name.
    pub name: String,
    /// Its host.
    pub host: Option<String>,
    /// Its UDP port.
    pub port: Option<u16>,
    /// The span of the node's name.
    pub span: Span,
}

/// A link.
#[derive(Clone, Debug)]
pub struct Link {
    /// One end.
    pub a: NodeId,
    /// The other.
    pub b: NodeId,
    /// The longest delay of a packet that is not lost (D20).
    pub delay: Duration,
    /// Its span.
    pub span: Span,
}

/// A record.
#[derive(Clone, Debug)]
pub struct Record {
    /// Its name.
    pub name: String,
    /// Its fields.
    pub fields: Vec<Field>,
    /// The span of the record's name.
    pub span: Span,
}

/// A field of a record, or a parameter of a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name.
    pub name: String,
    /// Its type.
    pub of: Type,
    /// Its span.
    pub span: Span,
}

/// A port (Figure 1): its owner's and its users' declarations in one.
#[derive(Clone, Debug)]
pub struct Port {
    /// Its name.
    pub name: String,
    /// The owning task.
    pub owner: TaskId,
    /// The owner's usage; the users have its counterpart (D11).
    pub usage: Usage,
    /// Its users, in the order of the `user_list`. A module is replaced by its tasks (D32).
    pub users: Vec<User>,
    /// The span of its `user_list`.
    pub user_list: Option<Span>,
    /// The record type of its messages, by position in [`Hir::records`], if they have one.
    pub record: Option<usize>,
    /// The fields of a message.
    pub message: Vec<Field>,
    /// The fields of an answer. By default a query's answer has the fields of the message, any other answer has none.
    pub answer: Vec<Field>,
    /// Its class, declared or by default.
    pub class: Class,
    /// Its time_out.
    pub time_out: Option<Duration>,
    /// `bounded_buffer`.
    pub bounded_buffer: u16,
    /// The span of `bounded_buffer`.
    pub buffer_span: Option<Span>,
    /// `retry`.
    pub retry: u8,
    /// `resend`.
    pub resend: Option<Duration>,
    /// `penalty`: the time, and whether the paper's literal rule applies (D4).
    pub penalty: Option<(Duration, bool)>,
    /// `rate`.
    pub rate: Option<(u16, Duration)>,
    /// `latest`.
    pub latest: bool,
    /// The work couple whose lease covers this port, by position in [`Hir::couples`] (D61, D88). Only the couple's tasks send
    /// on such a port, and only to tasks outside of the couple.
    pub guard: Option<usize>,
    /// The span of the port's name.
    pub span: Span,
}

impl Port {
    /// The task's usage of the port; none if the task neither owns nor uses it.
    #[must_use]
    pub fn usage_of(&self, task: TaskId) -> Option<Usage> {
        if task == self.owner {
            return Some(self.usage);
        }
        self.user(task).map(|_| self.usage.counterpart())
    }

    /// The declaration of this task as a user.
    #[must_use]
    pub fn user(&self, task: TaskId) -> Option<&User> {
        self.users.iter().find(|user| user.task == task)
    }

    /// The tasks at the other end: the owner for a user, the users for the owner, all other members for a `waitfor`.
    pub fn peers(&self, task: TaskId) -> impl Iterator<Item = TaskId> + '_ {
        let all = self.usage == Usage::Waitfor || task == self.owner;
        let parties = std::iter::once(self.owner).chain(self.users.iter().map(|user| user.task));
        parties.filter(move |&peer| peer != task && (all || peer == self.owner))
    }

    /// The position of a task among the parties: 0 is the owner, the users follow.
    #[must_use]
    pub fn party(&self, task: TaskId) -> Option<usize> {
        if task == self.owner {
            return Some(0);
        }
        self.users.iter().position(|user| user.task == task).map(|at| at + 1)
    }
}

/// A user of a port.
#[derive(Clone, Debug)]
pub struct User {
    /// The task.
    pub task: TaskId,
    /// Its own time_out.
    pub time_out: Option<Duration>,
    /// Its own rate.
    pub rate: Option<(u16, Duration)>,
    /// Its own `retry`.
    pub retry: Option<u8>,
    /// The span of its name in the `user_list`, or in its `use_port` if the port has no such list.
    pub listed: Span,
    /// The span of the port's name in the task's `use_port`; none until that is found.
    pub span: Option<Span>,
}

/// A task.
#[derive(Clone, Debug)]
pub struct Task {
    /// Its name.
    pub name: String,
    /// Its node.
    pub node: NodeId,
    /// Its module.
    pub module: Option<String>,
    /// The task whose standby it is.
    pub standby_of: Option<TaskId>,
    /// Whether a Rust program provides its behaviour.
    pub is_extern: bool,
    /// The highest rate at which an `extern` task acts.
    pub rate: Option<(u16, Duration)>,
    /// Its variables, by the position in [`Slot::Task`]. The fields of a record are adjacent: `me.height`.
    pub variables: Vec<Variable>,
    /// Its timers, by [`TimeId`].
    pub timers: Vec<Timer>,
    /// Its handlers.
    pub handlers: Vec<Handler>,
    /// Its statements.
    pub body: Vec<Statement>,
    /// The statements that it runs when it takes over.
    pub takeover: Option<Vec<Statement>>,
    /// The values that its body and its take-over save for later expressions.
    pub captures: Vec<Capture>,
    /// The span of the task's name.
    pub span: Span,
}

/// A value that a thread saves in a hidden variable as soon as it is known, because an expression may read it several
/// statements later.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Capture {
    /// Which value.
    pub what: Captured,
    /// The variable: [`Slot::Task`] in a body, [`Slot::Local`] in a handler.
    pub slot: Slot,
}

/// The values that a thread can save.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Captured {
    /// `outcome`: how the last statement with an outcome ended.
    Outcome,
    /// `sender`: the task that sent the last received message.
    Sender,
    /// `received`: the port of the last received message.
    Received,
    /// `p.answered(t)`: whether the task answered the last message that this thread sent on the port.
    Answered(PortId, TaskId),
    /// `p.refused(t)`: whether the task refused that message.
    Refused(PortId, TaskId),
    /// `p.told(t)`, `p.x(t)`: whether the values are known that the task brought to the waitfor or sent in its answer. Its
    /// fields are in the slots behind.
    Told(PortId, TaskId),
    /// `ticket`: the number of the last received message.
    Ticket,
}

/// A variable.
#[derive(Clone, Debug)]
pub struct Variable {
    /// Its name. A field of a record is called `record.field`.
    pub name: String,
    /// Its type.
    pub of: Type,
    /// The span of its declaration.
    pub span: Span,
}

/// A timer: a declared one, or the one that measures a silence.
#[derive(Clone, Debug)]
pub struct Timer {
    /// Its name.
    pub name: String,
    /// The span of its declaration.
    pub span: Span,
}

/// A handler.
#[derive(Clone, Debug)]
pub struct Handler {
    /// The event that runs it.
    pub trigger: Trigger,
    /// Its variables, by the position in [`Slot::Local`]. Those of the message come first.
    pub locals: Vec<Variable>,
    /// The number of variables that take fields of the message: all fields, or none if the handler ignores them.
    pub reads: usize,
    /// The values that it saves.
    pub captures: Vec<Capture>,
    /// Its statements.
    pub body: Vec<Statement>,
    /// The span of its head.
    pub span: Span,
}

/// The event that runs a handler.
#[derive(Clone, Debug)]
pub enum Trigger {
    /// A message of this port. Its fields go into the handler's first variables, in order.
    Message(PortId),
    /// No message came through the port for this long, while the condition held all the time.
    Silence {
        /// The port.
        port: PortId,
        /// The timer that measures the silence.
        timer: TimeId,
        /// How long.
        length: Duration,
        /// The condition; none means that it always holds.
        when: Option<Expr>,
    },
    /// This timer expired.
    Expiry(TimeId),
    /// The lease was lost (D61).
    Fence,
}

/// A statement.
#[derive(Clone, Debug)]
pub struct Statement {
    /// What it does.
    pub kind: StatementKind,
    /// What runs if it times out, is refused or fails.
    pub branches: Vec<Branch>,
    /// Its span, without its branches and inner statements.
    pub span: Span,
}

/// A branch of a statement.
#[derive(Clone, Debug)]
pub struct Branch {
    /// How the statement must have ended for this branch to run.
    pub when: BranchKind,
    /// Its statements.
    pub body: Vec<Statement>,
    /// The span of its head.
    pub span: Span,
}

/// The recipients of a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Recipients {
    /// All tasks at the other end.
    All,
    /// Only these.
    These(Vec<TaskId>),
}

/// The message that a reply answers.
#[derive(Clone, Debug)]
pub enum Answered {
    /// The last message that the thread received.
    Last,
    /// A message that this task sent earlier, and that is not answered yet.
    Of(TaskId),
    /// A message that another task received, answered through a port of usage `reply` (D11).
    Ticket {
        /// The task that sent the message.
        asker: TaskId,
        /// The message's number.
        number: Expr,
    },
}

/// The variable for one field of a message or a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Destination {
    /// The variable.
    pub slot: Slot,
    /// Its type.
    pub of: Type,
}

/// What a statement does.
#[derive(Clone, Debug)]
pub enum StatementKind {
    /// SEND, or a query, with one value for each field.
    Send {
        /// The port.
        port: PortId,
        /// Its recipients.
        to: Recipients,
        /// The values, each converted to the type of its field.
        values: Vec<Expr>,
        /// The variables for the answer; empty if the answer is not read.
        into: Vec<Destination>,
        /// A TTL below the port's time_out.
        within: Option<Duration>,
    },
    /// GET.
    Receive {
        /// The port.
        port: Option<PortId>,
        /// The variables for the message.
        into: Vec<Destination>,
        /// The only sender from which it receives.
        from: Option<TaskId>,
        /// How long it waits at most.
        within: Option<Duration>,
    },
    /// Answers a message.
    Reply {
        /// The port of the answered message; one of usage `reply` for a third party. None if several ports are possible.
        port: Option<PortId>,
        /// The message that it answers.
        to: Answered,
        /// The fields.
        values: Vec<Expr>,
    },
    /// ARRIVE.
    Waitfor {
        /// The port.
        port: PortId,
        /// The values that the other members are told.
        values: Vec<Expr>,
        /// A wait below the port's time_out.
        within: Option<Duration>,
    },
    /// ORDER.
    Order(Vec<Ranked>),
    /// DELAY.
    Delay(Duration),
    /// An action of a robot or another machine.
    Run {
        /// Its name.
        action: String,
        /// Its arguments.
        arguments: Vec<Expr>,
        /// The variable for its result.
        into: Option<Destination>,
        /// The least and the greatest result.
        range: Option<(i64, i64)>,
        /// Its shortest and its longest duration.
        takes: (Duration, Duration),
    },
    /// Starts a timer.
    Start {
        /// Which.
        timer: TimeId,
        /// How long.
        length: Duration,
    },
    /// Stops a timer.
    Stop(TimeId),
    /// Statements that no handler interrupts.
    Atomic(Vec<Statement>),
    /// An assignment.
    Assign {
        /// The variable and its type.
        to: Destination,
        /// Its new value.
        value: Expr,
    },
    /// An assignment of a whole record. No handler interrupts it.
    AssignAll {
        /// The variables and their types.
        to: Vec<Destination>,
        /// Their new values.
        values: Vec<Expr>,
    },
    /// Sets the values that the answers to this port's heartbeats carry (D61).
    Publish {
        /// The port.
        port: PortId,
        /// The fields.
        values: Vec<Expr>,
    },
    /// Reads what the couple's partner published last. The variables keep their values if it has published nothing.
    Published {
        /// The port of the heartbeats.
        port: PortId,
        /// The variables.
        into: Vec<Destination>,
    },
    /// `if`.
    If {
        /// The conditions, each with the statements that run if it holds.
        arms: Vec<(Expr, Vec<Statement>)>,
        /// The statements that run if no condition holds.
        otherwise: Vec<Statement>,
    },
    /// `loop`.
    Loop(Vec<Statement>),
    /// `while`.
    While(Expr, Vec<Statement>),
    /// Leaves the innermost loop.
    Exit,
    /// Does nothing.
    Skip,
    /// Ends the task.
    Abort(String),
    /// Ends the task if this is false.
    Assert(Expr),
}

/// A typed expression: operations in postfix order that leave its value on the stack.
#[derive(Clone, Debug)]
pub struct Expr {
    /// Bool, real or an integer type. A constant or a sum of integers is an `int32`.
    pub of: Type,
    /// The operations.
    pub ops: Vec<Op>,
    /// Its span.
    pub span: Span,
}
