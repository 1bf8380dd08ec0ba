//! Emits what follows from the outcome of a statement: its branches, and the values to save.

use super::task::Writer;
use crate::ast::BranchKind;
use crate::hir::{Branch, Captured, Statement};
use crate::resolve::after;
use imrs_protocol::script::{Binary, Mark, Op, Outcomes, Slot, StatementOutcome, Term, Type};
use imrs_protocol::{PortId, TaskId};

/// A bad outcome of a statement: the branch for it, and the reason for which the task ends if the statement has no such
/// branch.
pub(super) struct Bad {
    branch: Option<BranchKind>,
    outcomes: Outcomes,
    /// The keyword of the branch; `None` if the task continues without a branch.
    word: Option<&'static str>,
}

pub(super) const TIMED_OUT: Bad =
    Bad { branch: Some(BranchKind::TimeOut), outcomes: Outcomes::TIME_OUT, word: Some("time_out of") };
pub(super) const REFUSED: Bad =
    Bad { branch: Some(BranchKind::Refused), outcomes: Outcomes::REFUSED, word: Some("refusal of") };
pub(super) const FENCED: Bad =
    Bad { branch: None, outcomes: Outcomes::of(&[StatementOutcome::Fenced]), word: Some("lease lost at") };
pub(super) const FAILED: Bad = Bad {
    branch: Some(BranchKind::Failed),
    outcomes: Outcomes::of(&[StatementOutcome::Failed, StatementOutcome::Fenced]),
    word: Some("failure of"),
};
/// A reply that comes too late ends no task, because the asker has already given up.
pub(super) const TOO_LATE: Bad = Bad {
    branch: Some(BranchKind::Failed),
    outcomes: Outcomes::of(&[StatementOutcome::Unanswerable]),
    word: None,
};

impl<'h> Writer<'h, '_> {
    /// Emits the branches of a statement. A bad outcome without a branch ends the task (D33, D45).
    pub fn branches(&mut self, statement: &'h Statement, name: &str, ways: &[Bad]) {
        let taken: Vec<(&'h Branch, Outcomes)> = statement
            .branches
            .iter()
            .filter_map(|branch| {
                let way = ways.iter().find(|way| way.branch == Some(branch.when))?;
                Some((branch, way.outcomes))
            })
            .collect();
        let end = self.emit.label();
        let labels: Vec<_> = taken.iter().map(|_| self.emit.label()).collect();
        for (&(_, outcomes), &label) in taken.iter().zip(&labels) {
            self.emit.on(outcomes, label);
        }
        let line = self.hir.line(statement.span);
        for way in ways {
            let has = taken.iter().any(|(branch, _)| way.branch == Some(branch.when));
            if let (Some(word), false) = (way.word, has) {
                self.emit.abort_on(way.outcomes, format!("{word} `{name}`, line {line}"));
            }
        }
        if taken.is_empty() {
            return;
        }
        self.emit.jump(end);
        for ((branch, _), label) in taken.into_iter().zip(labels) {
            self.emit.put(label);
            self.statements(&branch.body);
            self.emit.at = branch.span;
            self.emit.jump(end);
        }
        self.emit.put(end);
    }

    pub fn keep_outcome(&mut self) {
        let kept = self.captures.iter().find(|capture| capture.what == Captured::Outcome);
        if let Some(kept) = kept {
            self.emit.op(Op::Outcome);
            self.emit.op(Op::Store(kept.slot));
        }
    }

    /// Saves which tasks answered and which refused, if an expression reads that.
    pub fn keep_answers(&mut self, port: PortId, asked: &[TaskId]) {
        for capture in self.captures {
            let (task, mark, alone) = match capture.what {
                Captured::Answered(of, task) if of == port => (task, Mark::Answered, StatementOutcome::Reply),
                Captured::Refused(of, task) if of == port => (task, Mark::Refused, StatementOutcome::Refused),
                Captured::Outcome
                | Captured::Sender
                | Captured::Received
                | Captured::Answered(..)
                | Captured::Refused(..)
                | Captured::Told(..)
                | Captured::Ticket => continue,
            };
            let push = |value| Op::Term(Term::Push(value));
            let int = |operator| Op::Term(Term::Int(operator));
            let party = self.hir.ports[port.index()].party(task).unwrap_or(0);
            let bit = 1_i64.checked_shl(u32::try_from(party).unwrap_or(u32::MAX)).unwrap_or(0);
            match asked {
                [one] if *one == task => {
                    self.emit.ops(&[Op::Outcome, push(alone as i64), int(Binary::Equal)]);
                }
                several if !several.contains(&task) || bit == 0 => self.emit.op(push(0)),
                // The highest bit is the sign bit, so it is set if the mask is negative.
                _ if bit < 0 => self.emit.ops(&[Op::Mark(mark), push(0), int(Binary::Less)]),
                _ => self.emit.ops(&[
                    Op::Mark(mark),
                    push(bit),
                    int(Binary::Divide),
                    push(2),
                    int(Binary::Remainder),
                    push(0),
                    int(Binary::NotEqual),
                ]),
            }
            self.emit.op(Op::Store(capture.slot));
        }
    }

    /// Saves the values that members brought to a waitfor, or that the `asked` tasks answered, if an expression reads these
    /// values. An unknown value is zero.
    pub fn keep_told(&mut self, port: PortId, asked: Option<&[TaskId]>) {
        let declared = &self.hir.ports[port.index()];
        let fields = if asked.is_some() { &declared.answer } else { &declared.message };
        let types: Vec<Type> = fields.iter().map(|field| field.of).collect();
        for capture in self.captures {
            let Captured::Told(of, task) = capture.what else { continue };
            if of != port {
                continue;
            }
            let slots: Vec<Slot> = (1..=types.len()).map(|at| after(capture.slot, at)).collect();
            let (unknown, on) = (self.emit.label(), self.emit.label());
            let format = self.emit.builder.format(&types);
            match asked {
                None => self.emit.op(Op::Arrival { port, task, format }),
                // Only this task was asked, so the outcome of the statement says whether it answered.
                Some([one]) if *one == task => self.emit.ops(&[
                    Op::Outcome,
                    Op::Term(Term::Push(StatementOutcome::Reply as i64)),
                    Op::Term(Term::Int(Binary::Equal)),
                ]),
                Some(asked) if asked.contains(&task) => self.emit.op(Op::Answer { port, task }),
                Some(_) => self.emit.op(Op::Term(Term::Push(0))),
            }
            self.emit.op(Op::Store(capture.slot));
            self.emit.op(Op::Term(Term::Load(capture.slot)));
            self.emit.unless(unknown);
            let into = self.emit.builder.places(&slots);
            self.emit.op(Op::Unpack { format, into });
            self.emit.jump(on);
            self.emit.put(unknown);
            for slot in slots {
                self.emit.op(Op::Term(Term::Push(0)));
                self.emit.op(Op::Store(slot));
            }
            self.emit.put(on);
        }
    }
}
