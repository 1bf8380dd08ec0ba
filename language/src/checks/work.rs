//! Computes how long an answer takes at its receiver: the time from the arrival of a message to its answer, as far as the
//! statements between the two declare it.

use crate::hir::{Answered, Hir, Statement, StatementKind, Task, Trigger};
use imrs_protocol::{Class, PortId, TaskId, Usage};
use std::cell::Cell;

/// The greatest number of statements that one search visits.
const STEPS: u32 = 100_000;
/// The greatest number of answers in a chain in which each waits for the next. An answer further down the chain counts as
/// taking no time.
const DEEPEST: usize = 8;

/// The least time between a message's arrival in a task and its answer, in microseconds, on the quickest path through the
/// statements. Zero if no path is known: for answers that a task gives later, from other tasks or from a Rust program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Work {
    /// The time if each `run` is as quick as declared: no answer comes sooner.
    pub least: u64,
    /// The time if each `run` is as slow as declared: an answer may take this long, whatever the values are.
    pub slow: u64,
}

/// The work of `task` for an answer on `port`.
pub(super) fn of(hir: &Hir, task: TaskId, port: PortId) -> Work {
    let search = |slow| {
        let steps = Cell::new(STEPS);
        let answer = Search { hir, slow, depth: 0, steps: &steps }.answer(task, port);
        // If the search ran out of steps, it may have missed a quicker path.
        answer.filter(|_| steps.get() > 0).unwrap_or_default()
    };
    Work { least: search(false), slow: search(true) }
}

/// One search for the quickest path from a message to its answer.
#[derive(Clone, Copy)]
struct Search<'h> {
    hir: &'h Hir,
    /// Whether actions are as slow as declared.
    slow: bool,
    /// How many answers wait, in a chain, for the answer of this search.
    depth: usize,
    /// How many statements may still be visited. Nested loops are visited again and again.
    steps: &'h Cell<u32>,
}

/// The least time for which a message has been open at some point of the statements; `None` if no path reaches the point
/// with an open message.
type Open = Option<u64>;

/// The times at which paths leave statements: at their end, by `exit`, or with an answer.
#[derive(Clone, Copy, Default)]
struct Left {
    next: Open,
    exit: Open,
    /// The time of the quickest answer.
    answer: Open,
}

fn quicker(a: Open, b: Open) -> Open {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (one, None) | (None, one) => one,
    }
}

impl Search<'_> {
    fn answer(self, id: TaskId, port: PortId) -> Option<u64> {
        let task = &self.hir.tasks[id.index()];
        if task.is_extern || self.depth >= DEEPEST || self.is_answered_elsewhere(task, id, port) {
            return None;
        }
        let mut best = None;
        for handler in &task.handlers {
            if matches!(handler.trigger, Trigger::Message(of) if of == port) {
                best = quicker(best, self.statements(&handler.body, Some(0), None).answer);
            }
        }
        for body in [Some(&task.body), task.takeover.as_ref()].into_iter().flatten() {
            best = quicker(best, self.statements(body, None, Some(port)).answer);
        }
        best
    }

    /// Whether a message may be answered later, or by another task (D11, D93).
    fn is_answered_elsewhere(self, task: &Task, id: TaskId, port: PortId) -> bool {
        let declared = &self.hir.ports[port.index()];
        super::answers::answers_later(task, port)
            || super::answers::answered_by_others(self.hir, id, declared)
    }

    /// Follows paths through the statements. A `receive` of the port `receives` opens a message.
    fn statements(self, statements: &[Statement], from: Open, receives: Option<PortId>) -> Left {
        let mut left = Left { next: from, ..Left::default() };
        for statement in statements {
            let Some(rest) = self.steps.get().checked_sub(1) else { return Left::default() };
            self.steps.set(rest);
            let step = self.through(statement, left.next, receives);
            left = Left {
                next: step.next,
                exit: quicker(left.exit, step.exit),
                answer: quicker(left.answer, step.answer),
            };
        }
        left
    }

    fn through(self, statement: &Statement, from: Open, receives: Option<PortId>) -> Left {
        let plain = |next| Left { next, ..Left::default() };
        let mut left = match &statement.kind {
            StatementKind::Reply { to: Answered::Last, .. } => Left { answer: from, ..Left::default() },
            StatementKind::Receive { port, .. }
                if receives.is_some_and(|of| port.is_none_or(|p| p == of)) =>
            {
                plain(Some(0))
            }
            StatementKind::Abort(_) => Left::default(),
            StatementKind::Exit => Left { exit: from, ..Left::default() },
            StatementKind::Atomic(body) => self.statements(body, from, receives),
            StatementKind::Loop(body) => {
                let turned = self.turned(body, from, receives);
                Left { next: turned.exit, exit: None, answer: turned.answer }
            }
            StatementKind::While(_, body) => {
                let turned = self.turned(body, from, receives);
                let next = quicker(quicker(from, turned.next), turned.exit);
                Left { next, exit: None, answer: turned.answer }
            }
            StatementKind::If { arms, otherwise } => {
                let arms = arms.iter().map(|(_, body)| self.statements(body, from, receives));
                arms.fold(self.statements(otherwise, from, receives), either)
            }
            kind => plain(from.map(|open| open.saturating_add(self.takes(kind)))),
        };
        for branch in &statement.branches {
            // A statement may fail at once, so its branches begin without the statement's own time.
            left = either(left, self.statements(&branch.body, from, receives));
        }
        left
    }

    /// Follows the paths through the body of a loop. A path enters the body from before the loop, or from the end of the
    /// body.
    fn turned(self, body: &[Statement], from: Open, receives: Option<PortId>) -> Left {
        let once = self.statements(body, from, receives);
        let head = quicker(from, once.next);
        if head == from { once } else { self.statements(body, head, receives) }
    }

    /// The least time that a statement takes if it succeeds. Packets in flight count as taking no time: the delay of a link
    /// is only an upper bound.
    fn takes(self, kind: &StatementKind) -> u64 {
        match kind {
            StatementKind::Run { takes, .. } => {
                if self.slow {
                    takes.1.usec
                } else {
                    takes.0.usec
                }
            }
            StatementKind::Delay(length) => length.usec,
            StatementKind::Send { port, .. } if self.hir.ports[port.index()].class == Class::Command => {
                let declared = &self.hir.ports[port.index()];
                let takers =
                    std::iter::once(declared.owner).chain(declared.users.iter().map(|user| user.task));
                let answers = takers.filter(|&task| {
                    matches!(declared.usage_of(task), Some(Usage::Receive | Usage::Response))
                });
                let deeper = Self { depth: self.depth + 1, ..self };
                // If a message goes to any of several receivers, the receiver that can answer most quickly counts.
                answers.map(|task| deeper.answer(task, *port).unwrap_or_default()).min().unwrap_or_default()
            }
            _ => 0,
        }
    }
}

fn either(a: Left, b: Left) -> Left {
    Left { next: quicker(a.next, b.next), exit: quicker(a.exit, b.exit), answer: quicker(a.answer, b.answer) }
}
