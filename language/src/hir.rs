//! The cell with its names resolved and its expressions typed: what the checks read and what lowering turns into the
//! declarations and scripts of [`imrs_protocol`]. Ids are positions, as in [`imrs_protocol::Cell`].

mod whole;

pub use whole::{Check, CheckKind, Couple, CoupleKind, Faults, Pause};

use crate::ast::BranchKind;
use crate::span::Span;
use imrs_protocol::script::{Op, Slot, Type};
use imrs_protocol::{Class, NodeId, PortId, Ranked, TaskId, TimeId, Usage};

/// A duration in microseconds and where it stands.
pub use crate::ast::Duration;

/// A whole cell.
#[derive(Clone, Debug, Default)]
pub struct Hir {
    /// Its name.
    pub name: String,
    /// Whether the paper's own rules hold (D92).
    pub paper: bool,
    /// The declared lateness of timers (D42).
    pub tick: Option<Duration>,
    /// The granularity of the model, where it is coarser.
    pub model_tick: Option<Duration>,
    /// The nodes, by [`NodeId`].
    pub nodes: Vec<Node>,
    /// The links.
    pub links: Vec<Link>,
    /// The records.
    pub records: Vec<Record>,
    /// The tasks, by [`TaskId`].
    pub tasks: Vec<Task>,
    /// The ports, by [`PortId`].
    pub ports: Vec<Port>,
    /// The process classes (D24).
    pub couples: Vec<Couple>,
    /// What may go wrong.
    pub faults: Vec<Faults>,
    /// What must hold.
    pub checks: Vec<Check>,
    /// Where each line of the text begins, in bytes: findings at run time name lines.
    pub lines: Vec<u32>,
}

impl Hir {
    /// The line in which a span begins, from 1.
    #[must_use]
    pub fn line(&self, span: Span) -> usize {
        self.lines.partition_point(|&begin| begin <= span.start).max(1)
    }

    /// The links of the quickest way.
    #[must_use]
    pub fn way(&self, from: NodeId, to: NodeId) -> Vec<usize> {
        let mut best: Vec<Option<(u64, Option<usize>)>> = vec![None; self.nodes.len()];
        // Of a cell with errors a task's node may be missing.
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
    /// Where its name stands.
    pub span: Span,
}

/// A link.
#[derive(Clone, Debug)]
pub struct Link {
    /// One end.
    pub a: NodeId,
    /// The other.
    pub b: NodeId,
    /// Its bound (D20).
    pub delay: Duration,
    /// Where it stands.
    pub span: Span,
}

/// A record.
#[derive(Clone, Debug)]
pub struct Record {
    /// Its name.
    pub name: String,
    /// Its fields.
    pub fields: Vec<Field>,
    /// Where its name stands.
    pub span: Span,
}

/// A field of a record, or a parameter of a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name.
    pub name: String,
    /// Its type.
    pub of: Type,
    /// Where it stands.
    pub span: Span,
}

/// A port (Figure 1), with both ends together.
#[derive(Clone, Debug)]
pub struct Port {
    /// Its name.
    pub name: String,
    /// Who owns it.
    pub owner: TaskId,
    /// The owner's usage; the users have its counterpart (D11).
    pub usage: Usage,
    /// Its users, in the order of the `user_list`, modules taken apart (D32).
    pub users: Vec<User>,
    /// Where its `user_list` stands.
    pub user_list: Option<Span>,
    /// The record of its messages, where it has one.
    pub record: Option<usize>,
    /// What a message holds.
    pub message: Vec<Field>,
    /// What an answer holds: of a query, by default, what a message holds; else nothing.
    pub answer: Vec<Field>,
    /// Its class, declared or by default.
    pub class: Class,
    /// Its time_out.
    pub time_out: Option<Duration>,
    /// `bounded_buffer`.
    pub bounded_buffer: u16,
    /// Where `bounded_buffer` stands.
    pub buffer_span: Option<Span>,
    /// `retry`.
    pub retry: u8,
    /// `resend`.
    pub resend: Option<Duration>,
    /// `penalty`, and whether it is the literal one (D4).
    pub penalty: Option<(Duration, bool)>,
    /// `rate`.
    pub rate: Option<(u16, Duration)>,
    /// `latest`.
    pub latest: bool,
    /// The work couple, by position in [`Hir::couples`], under whose lease it acts (D61, D88): only the couple sends
    /// on it, to others.
    pub guard: Option<usize>,
    /// Where its name stands.
    pub span: Span,
}

impl Port {
    /// What the task does with the port; none where it neither owns nor uses it.
    #[must_use]
    pub fn usage_of(&self, task: TaskId) -> Option<Usage> {
        if task == self.owner {
            return Some(self.usage);
        }
        self.user(task).map(|_| self.usage.counterpart())
    }

    /// The user that is this task.
    #[must_use]
    pub fn user(&self, task: TaskId) -> Option<&User> {
        self.users.iter().find(|user| user.task == task)
    }

    /// The tasks at the other end from `task`: the owner for a user, the users for the owner, all others in a `waitfor`.
    pub fn peers(&self, task: TaskId) -> impl Iterator<Item = TaskId> + '_ {
        let all = self.usage == Usage::Waitfor || task == self.owner;
        let parties = std::iter::once(self.owner).chain(self.users.iter().map(|user| user.task));
        parties.filter(move |&peer| peer != task && (all || peer == self.owner))
    }

    /// The position of a task among the owner and the users.
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
    /// Where its name stands in the `user_list`; in its `use_port` where the port has none.
    pub listed: Span,
    /// Where the name of the port stands in its `use_port`; nowhere while it has none.
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
    /// Whom it stands by for.
    pub standby_of: Option<TaskId>,
    /// Whether a Rust program gives its behaviour.
    pub is_extern: bool,
    /// How often an `extern` task acts at most.
    pub rate: Option<(u16, Duration)>,
    /// Its variables: [`Slot::Task`] is the position. A record's fields stand one after another: `me.height`.
    pub variables: Vec<Variable>,
    /// Its timers: [`TimeId`] is the position.
    pub timers: Vec<Timer>,
    /// Its handlers.
    pub handlers: Vec<Handler>,
    /// What it does.
    pub body: Vec<Statement>,
    /// What it does when it takes over.
    pub takeover: Option<Vec<Statement>>,
    /// What its body and its take-over keep for expressions that ask later.
    pub captures: Vec<Capture>,
    /// Where its name stands.
    pub span: Span,
}

/// Something that a thread keeps in a variable of its own as soon as it is known, because an expression may ask for it
/// only some statements later.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Capture {
    /// What.
    pub what: Captured,
    /// Where: [`Slot::Task`] in a body, [`Slot::Local`] in a handler.
    pub slot: Slot,
}

/// What a thread keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Captured {
    /// `outcome`: how the last statement that asked for something ended.
    Outcome,
    /// `sender`: who sent the message that was received last.
    Sender,
    /// `received`: the port through which it came.
    Received,
    /// `p.answered(t)`: whether the task answered the last message to several on the port.
    Answered(PortId, TaskId),
    /// `p.refused(t)`: whether it refused it.
    Refused(PortId, TaskId),
    /// `p.told(t)`, `p.x(t)`: whether it is known what the task told at the waitfor, or answered; in the slots behind, its
    /// fields.
    Told(PortId, TaskId),
    /// `ticket`: the number of the message that was received last.
    Ticket,
}

/// A variable.
#[derive(Clone, Debug)]
pub struct Variable {
    /// Its name; of a field of a record, with the record's.
    pub name: String,
    /// Its type.
    pub of: Type,
    /// Where it is declared.
    pub span: Span,
}

/// A timer, or the silence of a port that a handler waits for.
#[derive(Clone, Debug)]
pub struct Timer {
    /// Its name.
    pub name: String,
    /// Where it is declared.
    pub span: Span,
}

/// A handler.
#[derive(Clone, Debug)]
pub struct Handler {
    /// What calls it.
    pub trigger: Trigger,
    /// Its variables: [`Slot::Local`]. Those of the message come first.
    pub locals: Vec<Variable>,
    /// How many of them the message is read into: all its fields, or none where the handler does not look at them.
    pub reads: usize,
    /// What it keeps.
    pub captures: Vec<Capture>,
    /// What it does.
    pub body: Vec<Statement>,
    /// Where its head stands.
    pub span: Span,
}

/// What calls a handler.
#[derive(Clone, Debug)]
pub enum Trigger {
    /// A message of this port; it is read into the first of the handler's variables, in their order.
    Message(PortId),
    /// The port was silent for so long while the condition held, without a break.
    Silence {
        /// The port.
        port: PortId,
        /// The timer that measures it.
        timer: TimeId,
        /// How long.
        length: Duration,
        /// The condition; none holds always.
        when: Option<Expr>,
    },
    /// The end of this timer.
    Expiry(TimeId),
    /// The lease was lost (D61).
    Fence,
}

/// A statement.
#[derive(Clone, Debug)]
pub struct Statement {
    /// What it does.
    pub kind: StatementKind,
    /// What happens when it ends otherwise.
    pub branches: Vec<Branch>,
    /// Where it stands, without its branches and the statements in it.
    pub span: Span,
}

/// A branch of a statement.
#[derive(Clone, Debug)]
pub struct Branch {
    /// When it is taken.
    pub when: BranchKind,
    /// What it does.
    pub body: Vec<Statement>,
    /// Where its head stands.
    pub span: Span,
}

/// Who a message is for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Recipients {
    /// All at the other end.
    All,
    /// These.
    These(Vec<TaskId>),
}

/// Which message an answer is for.
#[derive(Clone, Debug)]
pub enum Answered {
    /// The one that the thread received last.
    Last,
    /// The one of this task that was taken before and is not answered.
    Of(TaskId),
    /// One that another task took: through a port of usage `reply` (D11).
    Ticket {
        /// Whose it is.
        asker: TaskId,
        /// Its number.
        number: Expr,
    },
}

/// Where one field of a message or a result goes.
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
    /// SEND, or a query: one value for each field.
    Send {
        /// The port.
        port: PortId,
        /// Who it is for.
        to: Recipients,
        /// The fields, each already of its field's type.
        values: Vec<Expr>,
        /// Where the answer goes; nothing reads it where this is empty.
        into: Vec<Destination>,
        /// A shorter life than the port's.
        within: Option<Duration>,
    },
    /// GET.
    Receive {
        /// The port.
        port: Option<PortId>,
        /// Where the message goes.
        into: Vec<Destination>,
        /// From whom.
        from: Option<TaskId>,
        /// How long.
        within: Option<Duration>,
    },
    /// Answers a message.
    Reply {
        /// The port whose message it answers; a port of usage `reply` for a third party. None where it cannot be told.
        port: Option<PortId>,
        /// Which message it answers.
        to: Answered,
        /// The fields.
        values: Vec<Expr>,
    },
    /// ARRIVE.
    Waitfor {
        /// The port.
        port: PortId,
        /// What the others are told.
        values: Vec<Expr>,
        /// A shorter patience than the port's.
        within: Option<Duration>,
    },
    /// ORDER.
    Order(Vec<Ranked>),
    /// DELAY.
    Delay(Duration),
    /// An action outside.
    Run {
        /// Its name.
        action: String,
        /// Its arguments.
        arguments: Vec<Expr>,
        /// Where its result goes.
        into: Option<Destination>,
        /// The least and the most that its result is.
        range: Option<(i64, i64)>,
        /// How long it takes, at least and at most.
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
    /// No handler comes in between.
    Atomic(Vec<Statement>),
    /// An assignment.
    Assign {
        /// Where, and of which type.
        to: Destination,
        /// What.
        value: Expr,
    },
    /// An assignment of a whole record, without a handler in between.
    AssignAll {
        /// Where, and of which type.
        to: Vec<Destination>,
        /// What.
        values: Vec<Expr>,
    },
    /// What the answers of a beat port carry (D61).
    Publish {
        /// The port.
        port: PortId,
        /// The fields.
        values: Vec<Expr>,
    },
    /// What the partner of the couple published last; where that is nothing, the variables keep their values.
    Published {
        /// The port of the beats.
        port: PortId,
        /// Where it goes.
        into: Vec<Destination>,
    },
    /// `if`.
    If {
        /// Conditions and what is done where they are true.
        arms: Vec<(Expr, Vec<Statement>)>,
        /// What is done where none is.
        otherwise: Vec<Statement>,
    },
    /// `loop`.
    Loop(Vec<Statement>),
    /// `while`.
    While(Expr, Vec<Statement>),
    /// Leaves the innermost loop.
    Exit,
    /// Nothing.
    Skip,
    /// Ends the task.
    Abort(String),
    /// Ends the task where this is false.
    Assert(Expr),
}

/// An expression: the operations that leave its value on the stack, of exactly this type's kind.
#[derive(Clone, Debug)]
pub struct Expr {
    /// Bool, a real, or one of the integers; a constant or a sum is an `int32`.
    pub of: Type,
    /// The operations.
    pub ops: Vec<Op>,
    /// Where it stands.
    pub span: Span,
}
