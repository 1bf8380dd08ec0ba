//! Finds paths on which a message of class 2 stays unanswered: a data-flow analysis over the statements of one thread.

use crate::hir::{Answered, Capture, Captured, Expr, Statement, StatementKind};
use crate::walk::{self, is_true};
use imrs_protocol::PortId;
use imrs_protocol::script::{Op, Slot, Term};

/// The message that the analysis follows.
#[derive(Clone, Copy)]
pub(super) enum Question<'h> {
    /// The message that called the handler.
    OfHandler,
    /// The messages that this statement takes from this port.
    Of(&'h Statement, PortId),
}

/// Whether some path forgets the message. Such a path leads to the next `receive` of the message's port, to the end of the
/// thread, or into an endless loop, and no `reply` on it answers the message.
pub(super) fn forgets(body: &[Statement], captures: &[Capture], question: Question<'_>) -> bool {
    let mut paths = Paths { question, tells: tells(question, captures), forgets: false };
    let from = match question {
        Question::OfHandler => States::OPEN,
        Question::Of(..) => States::NONE,
    };
    let end = paths.through_all(body, from).next;
    paths.forgets || end.unanswered()
}

/// The variables from which the thread can tell whether it has the message: the saved `received`. If the `receive` can
/// fail, also the saved `outcome` and the variables that its branches assign. A handler always has its message.
fn tells(question: Question<'_>, captures: &[Capture]) -> Vec<Slot> {
    let Question::Of(receive, _) = question else { return Vec::new() };
    let fails = !receive.branches.is_empty();
    let kept = captures
        .iter()
        .filter(|kept| kept.what == Captured::Received || (fails && kept.what == Captured::Outcome));
    let mut slots: Vec<Slot> = kept.map(|kept| kept.slot).collect();
    for branch in &receive.branches {
        walk::each(&branch.body, &mut |statement| match &statement.kind {
            StatementKind::Assign { to, .. } => slots.push(to.slot),
            StatementKind::AssignAll { to, .. } => slots.extend(to.iter().map(|to| to.slot)),
            _ => {}
        });
    }
    slots
}

/// The states that the message can have at one point of the thread, over all paths to that point.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
struct States {
    /// The thread does not have the message: the thread has not received it yet, or has answered it.
    none: bool,
    /// The thread received the message last: a `reply` answers this message.
    open: bool,
    /// The thread has received another message since: a `reply` answers the later message.
    buried: bool,
}

impl States {
    const NONE: Self = Self { none: true, open: false, buried: false };
    const OPEN: Self = Self { none: false, open: true, buried: false };

    fn or(self, other: Self) -> Self {
        Self {
            none: self.none || other.none,
            open: self.open || other.open,
            buried: self.buried || other.buried,
        }
    }

    fn any(self) -> bool {
        self.none || self.unanswered()
    }

    fn unanswered(self) -> bool {
        self.open || self.buried
    }
}

/// The states of the message where paths leave some statements: at the end of the statements, or by `exit`.
#[derive(Clone, Copy, Default)]
struct Left {
    next: States,
    exit: States,
}

impl Left {
    fn by_end(next: States) -> Self {
        Self { next, exit: States::default() }
    }

    fn or(self, other: Self) -> Self {
        Self { next: self.next.or(other.next), exit: self.exit.or(other.exit) }
    }
}

struct Paths<'h> {
    question: Question<'h>,
    tells: Vec<Slot>,
    /// Whether some path has lost the message unanswered before the end of the thread.
    forgets: bool,
}

impl Paths<'_> {
    fn through_all(&mut self, statements: &[Statement], from: States) -> Left {
        let mut left = Left::by_end(from);
        for statement in statements {
            let step = self.through(statement, left.next);
            left = Left { next: step.next, exit: left.exit.or(step.exit) };
        }
        left
    }

    fn through(&mut self, statement: &Statement, from: States) -> Left {
        // No path reaches this statement. Without this return, a `receive` behind `abort` would count as taking messages.
        if !from.any() {
            return Left::default();
        }
        let mut left = match &statement.kind {
            StatementKind::Reply { to: Answered::Last, .. } => {
                Left::by_end(States { none: from.none || from.open, open: false, buried: from.buried })
            }
            StatementKind::Receive { port, .. } => Left::by_end(self.takes(statement, *port, from)),
            StatementKind::Abort(_) => Left::default(),
            StatementKind::Exit => Left { next: States::default(), exit: from },
            StatementKind::Atomic(body) => self.through_all(body, from),
            StatementKind::Loop(body) => self.endless(body, from),
            StatementKind::While(condition, body) if is_true(condition) => self.endless(body, from),
            StatementKind::While(_, body) => {
                // The result joins two cases: the body does not run, or it runs once. Further passes are left out, because
                // the condition may ask whether the thread still has the message.
                let once = self.through_all(body, from);
                Left::by_end(from.or(once.next).or(once.exit))
            }
            StatementKind::If { arms, otherwise } => self.choice(arms, otherwise, from),
            _ => Left::by_end(from),
        };
        // A `reply` fails if there is no message to answer, so its branches begin without the message. The branches of
        // other statements begin in the states before the statement.
        let failed = match statement.kind {
            StatementKind::Reply { .. } => left.next,
            _ => from,
        };
        for branch in &statement.branches {
            left = left.or(self.through_all(&branch.body, failed));
        }
        left
    }

    fn takes(&mut self, statement: &Statement, port: Option<PortId>, from: States) -> States {
        let (here, own) = match self.question {
            Question::OfHandler => (false, false),
            Question::Of(at, own) => (std::ptr::eq(at, statement), port == Some(own)),
        };
        self.forgets |= own && from.unanswered();
        if here {
            States::OPEN
        } else if own {
            States::NONE
        } else {
            States { none: from.none, open: false, buried: from.unanswered() }
        }
    }

    fn endless(&mut self, body: &[Statement], from: States) -> Left {
        let mut head = from;
        let left = loop {
            let turn = self.through_all(body, head);
            let again = head.or(turn.next);
            if again == head {
                break turn;
            }
            head = again;
        };
        // A path stays in the loop with the message, and no `reply` in the loop can answer it.
        self.forgets |= left.next.unanswered() && !replies(body) && !left.exit.any();
        Left::by_end(left.exit)
    }

    fn choice(&mut self, arms: &[(Expr, Vec<Statement>)], otherwise: &[Statement], from: States) -> Left {
        let asks = arms.iter().any(|(condition, _)| self.asks(condition));
        let lefts: Vec<Left> = arms
            .iter()
            .map(|(_, body)| &body[..])
            .chain([otherwise])
            .map(|body| self.through_all(body, from))
            .collect();
        let mut all = lefts.iter().fold(Left::default(), |all, left| all.or(*left));
        if asks && from.open && lefts.iter().any(|left| left.next.any() && !left.next.open) {
            // If the condition asks whether there is a message, and one arm answers it, then no message remains in the other
            // arms.
            all.next = States { none: true, open: false, buried: all.next.buried };
        }
        all
    }

    /// Whether a condition asks if the thread has the message.
    fn asks(&self, condition: &Expr) -> bool {
        condition.ops.iter().any(|op| matches!(op, Op::Term(Term::Load(slot)) if self.tells.contains(slot)))
    }
}

/// Whether a `reply` in these statements answers the message that was received last.
pub(super) fn replies(body: &[Statement]) -> bool {
    let mut has = false;
    walk::each(body, &mut |statement| {
        has |= matches!(statement.kind, StatementKind::Reply { to: Answered::Last, .. });
    });
    has
}
