//! Lowers `on silence p d when e` to a timer that runs while `e` is true, and that each message of `p` restarts. So no
//! timer runs while `e` is false.

use super::emit::Emitter;
use crate::hir::{Expr, Task, Trigger};
use imrs_protocol::script::{Op, Slot, Term, Type, eval};
use imrs_protocol::{PortId, Ticks, TimeId};

/// A handler `on silence port length when ..`: it runs when no message has come through `port` for `length`, while `when`
/// held all the time.
pub(super) struct Silence {
    pub port: PortId,
    pub timer: TimeId,
    pub length: Ticks,
    pub when: Option<Expr>,
    /// The variables of the task that `when` reads.
    watched: Vec<Slot>,
    /// The variable that keeps the last value of `when`, if one assignment can change the conditions of several silences.
    kept: Option<Slot>,
}

impl Silence {
    /// The `on silence` handlers of a task; `length` converts their durations.
    pub fn all(task: &Task, mut length: impl FnMut(crate::hir::Duration) -> Ticks) -> Vec<Self> {
        let mut silences = Vec::new();
        for handler in &task.handlers {
            let Trigger::Silence { port, timer, length: time, when } = &handler.trigger else { continue };
            let watched = when.iter().flat_map(|when| &when.ops).filter_map(|op| match op {
                Op::Term(Term::Load(slot)) => Some(*slot),
                _ => None,
            });
            let (watched, kept) = (watched.collect(), None);
            let (port, timer, length, when) = (*port, *timer, length(*time), when.clone());
            silences.push(Self { port, timer, length, when, watched, kept });
        }
        silences
    }

    fn start(&self, emit: &mut Emitter) {
        emit.op(Op::Start { timer: self.timer, length: self.length });
    }

    /// Emits the start of the timer, if `when` is true at that point.
    pub fn restart(&self, emit: &mut Emitter) {
        let Some(when) = &self.when else { return self.start(emit) };
        let on = emit.label();
        emit.ops(&when.ops);
        emit.unless(on);
        self.start(emit);
        emit.put(on);
    }

    /// Emits the start of the timer for the beginning of the task, where all variables are zero, if `when` is true then.
    pub fn begin(&self, emit: &mut Emitter) {
        let holds = self.when.as_ref().is_none_or(|when| {
            let terms: Vec<Term> = super::terms(when);
            eval(&terms, |term| matches!(term, Term::Load(_)).then_some(0)) == Ok(1)
        });
        if holds {
            self.start(emit);
        }
    }

    /// Emits the start or the stop of the timer, if the value of `when` has changed. The value before the change is on top
    /// of the stack.
    fn changed(&self, emit: &mut Emitter) {
        let Some(when) = &self.when else { return };
        let (was_false, on) = (emit.label(), emit.label());
        emit.unless(was_false);
        let stays = emit.label();
        emit.ops(&when.ops);
        emit.op(Op::Term(Term::Not));
        emit.unless(stays);
        emit.op(Op::Stop(self.timer));
        emit.put(stays);
        emit.jump(on);
        emit.put(was_false);
        emit.ops(&when.ops);
        emit.unless(on);
        self.start(emit);
        emit.put(on);
    }
}

/// Gives each silence a variable for the value of its condition, if one assignment can change several conditions.
pub(super) fn keep(silences: &mut [Silence], emit: &mut Emitter) {
    let with_condition = silences.iter().filter(|silence| !silence.watched.is_empty()).count();
    if with_condition < 2 {
        return;
    }
    for silence in silences.iter_mut().filter(|silence| !silence.watched.is_empty()) {
        silence.kept = Some(emit.builder.variable("(silence)", Type::Bool));
    }
}

/// Emits the operations of `write`, which store into these variables. Then emits the start or stop of each silence
/// timer whose condition reads one of them.
pub(super) fn store(
    silences: &[Silence],
    emit: &mut Emitter,
    into: &[Slot],
    write: impl FnOnce(&mut Emitter),
) {
    let watching = |silence: &&Silence| silence.watched.iter().any(|slot| into.contains(slot));
    let changed: Vec<&Silence> = silences.iter().filter(watching).collect();
    for silence in &changed {
        if let Some(when) = &silence.when {
            emit.ops(&when.ops);
        }
        if let (Some(kept), true) = (silence.kept, changed.len() > 1) {
            emit.op(Op::Store(kept));
        }
    }
    write(emit);
    for silence in &changed {
        if let (Some(kept), true) = (silence.kept, changed.len() > 1) {
            emit.op(Op::Term(Term::Load(kept)));
            emit.op(Op::Term(Term::Push(0)));
            emit.op(Op::Store(kept));
        }
        silence.changed(emit);
    }
}
