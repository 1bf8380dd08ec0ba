//! The high-level intermediate representation (HIR) of a cell: names are resolved, expressions are typed. The checks read it;
//! lowering turns it into declarations and scripts of [`imrs_protocol`]. Ids are positions, as in [`imrs_protocol::Cell`].

mod whole;

pub use whole::{Check, CheckKind, Couple, CoupleKind, Faults, Link, Pause};

use crate::ast::BranchKind;
use crate::span::Span;
use imrs_protocol::script::{Op, Slot, Type};
use imrs_protocol::{Class, NodeId, PortId, Ranked, TaskId, TimeId, Usage};

/// A duration in microseconds, with its span.
pub use crate::ast::Duration;

/// A whole cell.
#[derive(Clone, Debug, Default)]
pub struct Hir {
    /// The cell's name.
    pub name: String,
    /// Whether the paper's own rules replace this project's decisions (D92).
    pub paper: bool,
    /// How late a timer may fire (D42).
    pub tick: Option<Duration>,
    /// The step in which the checker tries the durations between the least and the most of an action (D133).
    pub model_tick: Option<Duration>,
    /// The nodes, by [`NodeId`].
    pub nodes: Vec<Node>,
    /// The links of the cell.
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

    /// The route with the least total delay: positions in [`Hir::links`], last link first; empty if no route exists.
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
    /// The node's name.
    pub name: String,
    /// The node's host.
    pub host: Option<String>,
    /// The node's UDP port.
    pub port: Option<u16>,
    /// The span of the node's name.
    pub span: Span,
}

/// A record.
#[derive(Clone, Debug)]
pub struct Record {
    /// The record's name.
    pub name: String,
    /// The record's fields.
    pub fields: Vec<Field>,
    /// The span of the record's name.
    pub span: Span,
}

/// A field of a record, or a parameter of a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// The field's name.
    pub name: String,
    /// The field's type.
    pub of: Type,
    /// The field's span.
    pub span: Span,
}

/// A port (Figure 1): its owner's and its users' declarations in one.
#[derive(Clone, Debug)]
pub struct Port {
    /// The port's name.
    pub name: String,
    /// The owning task.
    pub owner: TaskId,
    /// The owner's usage; the users have its counterpart (D11).
    pub usage: Usage,
    /// The port's users, in the order of the `user_list`. A module is replaced by its tasks (D32).
    pub users: Vec<User>,
    /// The span of the port's `user_list`.
    pub user_list: Option<Span>,
    /// The record type of the port's messages, by position in [`Hir::records`], if they have one.
    pub record: Option<usize>,
    /// The fields of a message.
    pub message: Vec<Field>,
    /// The fields of an answer. By default a query's answer has the fields of the message, any other answer has none.
    pub answer: Vec<Field>,
    /// The port's class, declared or by default.
    pub class: Class,
    /// The port's time_out.
    pub time_out: Option<Duration>,
    /// The value of `bounded_buffer`: how many messages the port's buffer holds.
    pub bounded_buffer: u16,
    /// The span of `bounded_buffer`.
    pub buffer_span: Option<Span>,
    /// The value of `retry`: how often a message of class 2 is retransmitted.
    pub retry: u8,
    /// The value of `resend`: the time between two transmissions.
    pub resend: Option<Duration>,
    /// `penalty`: the time, and whether the paper's literal rule applies (D4).
    pub penalty: Option<(Duration, bool)>,
    /// The value of `rate`: at most this many messages in each period of this length.
    pub rate: Option<(u16, Duration)>,
    /// Whether the port has the option `latest`.
    pub latest: bool,
    /// The work couple whose lease covers this port, by position in [`Hir::couples`] (D61, D88). Only the couple's tasks send
    /// on such a port, and only to tasks outside of the couple.
    pub guard: Option<usize>,
    /// The span of the port's name.
    pub span: Span,
}

impl Port {
    /// The task's usage of the port; `None` if the task neither owns nor uses it.
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

    /// The tasks that own or use the port: the owner first, then the users.
    pub fn parties(&self) -> impl Iterator<Item = TaskId> + '_ {
        std::iter::once(self.owner).chain(self.users.iter().map(|user| user.task))
    }

    /// The tasks at the other end: the owner for a user, the users for the owner, all other members for a `waitfor`.
    pub fn peers(&self, task: TaskId) -> impl Iterator<Item = TaskId> + '_ {
        let all = self.usage == Usage::Waitfor || task == self.owner;
        self.parties().filter(move |&peer| peer != task && (all || peer == self.owner))
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
    /// The task that uses the port.
    pub task: TaskId,
    /// The user's own time_out.
    pub time_out: Option<Duration>,
    /// The user's own rate.
    pub rate: Option<(u16, Duration)>,
    /// The user's own `retry`.
    pub retry: Option<u8>,
    /// The span of the task's name in the `user_list`, or in its `use_port` if the port has no such list.
    pub listed: Span,
    /// The span of the port's name in the task's `use_port`; `None` until name resolution has found that declaration.
    pub span: Option<Span>,
}

/// A task.
#[derive(Clone, Debug)]
pub struct Task {
    /// The task's name.
    pub name: String,
    /// The task's node.
    pub node: NodeId,
    /// The task's module.
    pub module: Option<String>,
    /// If this task is a standby: the task from which it takes over.
    pub standby_of: Option<TaskId>,
    /// Whether a Rust program provides the task's behaviour.
    pub is_extern: bool,
    /// The highest rate at which an `extern` task acts.
    pub rate: Option<(u16, Duration)>,
    /// The task's variables, by the position in [`Slot::Task`]. The fields of a record are adjacent: `me.height`.
    pub variables: Vec<Variable>,
    /// The task's timers, by [`TimeId`].
    pub timers: Vec<Timer>,
    /// The task's handlers.
    pub handlers: Vec<Handler>,
    /// The task's statements.
    pub body: Vec<Statement>,
    /// The statements that a standby runs when it takes over.
    pub takeover: Option<Vec<Statement>>,
    /// The values that the task's body and take-over save for later expressions.
    pub captures: Vec<Capture>,
    /// The span of the task's name.
    pub span: Span,
}

/// A value that a thread saves in a hidden variable as soon as the value is known, because an expression may read it
/// several statements later.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Capture {
    /// The saved value.
    pub what: Captured,
    /// The hidden variable: [`Slot::Task`] in a body, [`Slot::Local`] in a handler.
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
    /// `p.refused(t)`: whether the task refused the last message that this thread sent on the port.
    Refused(PortId, TaskId),
    /// `p.told(t)`, `p.x(t)`: whether this thread knows the values that the task brought to the waitfor or sent in its
    /// answer. The slots after this one hold these values, one for each field.
    Told(PortId, TaskId),
    /// `ticket`: the number of the last received message.
    Ticket,
}

/// A variable.
#[derive(Clone, Debug)]
pub struct Variable {
    /// The variable's name. A field of a record is called `record.field`.
    pub name: String,
    /// The variable's type.
    pub of: Type,
    /// The span of the variable's declaration.
    pub span: Span,
}

/// A timer: a declared timer, or one that measures a silence.
#[derive(Clone, Debug)]
pub struct Timer {
    /// The timer's name.
    pub name: String,
    /// The span of the timer's declaration.
    pub span: Span,
}

/// A handler.
#[derive(Clone, Debug)]
pub struct Handler {
    /// The event that runs the handler.
    pub trigger: Trigger,
    /// The handler's variables, by the position in [`Slot::Local`]. The variables for the message's fields come first.
    pub locals: Vec<Variable>,
    /// The number of variables that take fields of the message: all fields, or none if the handler ignores them.
    pub reads: usize,
    /// The values that the handler saves.
    pub captures: Vec<Capture>,
    /// The handler's statements.
    pub body: Vec<Statement>,
    /// The span of the handler's head.
    pub span: Span,
}

/// The event that runs a handler.
#[derive(Clone, Debug)]
pub enum Trigger {
    /// A message of this port. The message's fields go into the handler's first variables, in order.
    Message(PortId),
    /// No message came through the port for this long, while the condition held all the time.
    Silence {
        /// The port whose silence runs the handler.
        port: PortId,
        /// The timer that measures the silence.
        timer: TimeId,
        /// For how long no message must come.
        length: Duration,
        /// The condition; `None` stands for one that always holds.
        when: Option<Expr>,
    },
    /// The handler runs when this timer has expired.
    Expiry(TimeId),
    /// The task has lost its lease (D61).
    Fence,
}

/// A statement.
#[derive(Clone, Debug)]
pub struct Statement {
    /// What the statement does.
    pub kind: StatementKind,
    /// What runs if the statement times out, is refused or fails.
    pub branches: Vec<Branch>,
    /// The span of the statement, without its branches and inner statements.
    pub span: Span,
}

/// A branch of a statement.
#[derive(Clone, Debug)]
pub struct Branch {
    /// How the statement must have ended for this branch to run.
    pub when: BranchKind,
    /// The branch's statements.
    pub body: Vec<Statement>,
    /// The span of the branch's head.
    pub span: Span,
}

/// The recipients of a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Recipients {
    /// All tasks at the other end.
    All,
    /// Only these tasks.
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
    /// The variable, or the first field of the record, that gets the value.
    pub slot: Slot,
    /// The variable's type.
    pub of: Type,
}

/// What a statement does.
#[derive(Clone, Debug)]
pub enum StatementKind {
    /// SEND, or a query, with one value for each field.
    Send {
        /// The port through which the message goes.
        port: PortId,
        /// The message's recipients.
        to: Recipients,
        /// The values, each converted to the type of its field.
        values: Vec<Expr>,
        /// The variables for the answer; empty if the answer is not read.
        into: Vec<Destination>,
        /// A TTL below the port's time_out.
        within: Option<Duration>,
    },
    /// A `receive` statement: GET.
    Receive {
        /// The port; `None` for a plain `receive`, which takes messages of all ports without a handler.
        port: Option<PortId>,
        /// The variables for the message.
        into: Vec<Destination>,
        /// The only sender whose messages the statement takes.
        from: Option<TaskId>,
        /// How long the statement waits at most.
        within: Option<Duration>,
    },
    /// Answers a message.
    Reply {
        /// The answered message's port; of usage `reply` for a third party's answer. `None` if several ports are possible.
        port: Option<PortId>,
        /// The message that this statement answers.
        to: Answered,
        /// The value of each field of the answer.
        values: Vec<Expr>,
    },
    /// A `waitfor` statement: ARRIVE.
    Waitfor {
        /// The port of the rendezvous.
        port: PortId,
        /// The values that this task sends to the other members.
        values: Vec<Expr>,
        /// How long the task waits, if less than the port's time_out.
        within: Option<Duration>,
    },
    /// An `order` statement: ORDER.
    Order(Vec<Ranked>),
    /// A `delay` statement: DELAY.
    Delay(Duration),
    /// An action of a robot or another machine.
    Run {
        /// The action's name.
        action: String,
        /// The action's arguments.
        arguments: Vec<Expr>,
        /// The variable that gets the action's result.
        into: Option<Destination>,
        /// The least and the greatest result.
        range: Option<(i64, i64)>,
        /// The action's shortest and its longest duration.
        takes: (Duration, Duration),
    },
    /// Starts a timer.
    Start {
        /// The timer to start.
        timer: TimeId,
        /// How long the timer runs until it expires.
        length: Duration,
    },
    /// Stops a timer.
    Stop(TimeId),
    /// Statements that no handler interrupts.
    Atomic(Vec<Statement>),
    /// An assignment.
    Assign {
        /// The variable that gets the value.
        to: Destination,
        /// The variable's new value.
        value: Expr,
    },
    /// An assignment of a whole record. No handler interrupts it.
    AssignAll {
        /// The variables and their types.
        to: Vec<Destination>,
        /// The new values, one for each variable.
        values: Vec<Expr>,
    },
    /// Sets the values that the answers to this port's heartbeats carry (D61).
    Publish {
        /// The port of the heartbeats.
        port: PortId,
        /// The values that the answers carry, one for each field.
        values: Vec<Expr>,
    },
    /// Reads what the couple's partner published last. The variables keep their values if it has published nothing.
    Published {
        /// The port of the heartbeats.
        port: PortId,
        /// The variables that get the published values.
        into: Vec<Destination>,
    },
    /// An `if` statement.
    If {
        /// The conditions, each with the statements that run if it holds.
        arms: Vec<(Expr, Vec<Statement>)>,
        /// The statements that run if no condition holds.
        otherwise: Vec<Statement>,
    },
    /// A `loop` statement, with its body.
    Loop(Vec<Statement>),
    /// A `while` statement, with its condition and its body.
    While(Expr, Vec<Statement>),
    /// Leaves the innermost loop.
    Exit,
    /// Does nothing.
    Skip,
    /// Ends the task.
    Abort(String),
    /// Ends the task if this expression is false.
    Assert(Expr),
}

/// A typed expression: operations in postfix order that leave its value on the stack.
#[derive(Clone, Debug)]
pub struct Expr {
    /// The type of the value: bool, real or an integer type. A constant or a sum of integers is an `int32`.
    pub of: Type,
    /// The operations that compute the value.
    pub ops: Vec<Op>,
    /// The expression's span.
    pub span: Span,
}
