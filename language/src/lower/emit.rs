//! Emits operations, each with the span of its source.

use crate::span::Span;
use imrs_protocol::script::{Label, Op, Outcomes, Program, ProgramBuilder, ProgramError, Trigger};

/// A program under construction, with one span for each operation.
pub(super) struct Emitter {
    pub builder: ProgramBuilder,
    pub spans: Vec<Span>,
    /// The span of the operations that are emitted next.
    pub at: Span,
    /// The `abort` operations to which the current thread jumps. [`flush`](Self::flush) emits these operations behind the
    /// thread.
    aborts: Vec<(Label, String, Span)>,
}

impl Emitter {
    pub fn new(name: &str) -> Self {
        let (spans, aborts) = (Vec::new(), Vec::new());
        Self { builder: ProgramBuilder::new(name), spans, at: Span::default(), aborts }
    }

    pub fn op(&mut self, op: Op) {
        self.builder.op(op);
        self.spans.push(self.at);
    }

    pub fn ops(&mut self, ops: &[Op]) {
        ops.iter().for_each(|&op| self.op(op));
    }

    /// Begins a statement with this span.
    pub fn statement(&mut self, at: Span) {
        self.at = at;
        self.op(Op::Statement);
    }

    pub fn label(&mut self) -> Label {
        self.builder.label()
    }

    pub fn put(&mut self, label: Label) {
        self.builder.put(label);
    }

    pub fn jump(&mut self, to: Label) {
        self.builder.jump(to);
        self.spans.push(self.at);
    }

    pub fn unless(&mut self, to: Label) {
        self.builder.unless(to);
        self.spans.push(self.at);
    }

    pub fn on(&mut self, outcomes: Outcomes, to: Label) {
        self.builder.on(outcomes, to);
        self.spans.push(self.at);
    }

    /// Emits a jump that ends the task if the last statement has one of these outcomes.
    pub fn abort_on(&mut self, outcomes: Outcomes, reason: String) {
        let label = self.label();
        self.on(outcomes, label);
        self.aborts.push((label, reason, self.at));
    }

    /// Emits the `abort` operations to which the current thread jumps.
    pub fn flush(&mut self) {
        for (label, reason, at) in std::mem::take(&mut self.aborts) {
            self.put(label);
            self.at = at;
            let reason = self.builder.reason(&reason);
            self.op(Op::Abort(reason));
        }
    }

    /// Emits a handler: what `body` emits, and its end.
    pub fn handler(&mut self, trigger: Trigger, at: Span, body: impl FnOnce(&mut Self)) {
        self.at = at;
        let mut builder = std::mem::take(&mut self.builder);
        builder.handler(trigger, |inner| {
            self.builder = std::mem::take(inner);
            body(self);
            *inner = std::mem::take(&mut self.builder);
        });
        self.builder = builder;
        self.spans.push(at);
        self.flush();
    }

    /// Emits the take-over: what `body` emits, and the end of the task.
    pub fn takeover(&mut self, at: Span, body: impl FnOnce(&mut Self)) {
        self.at = at;
        let mut builder = std::mem::take(&mut self.builder);
        builder.takeover(|inner| {
            self.builder = std::mem::take(inner);
            body(self);
            *inner = std::mem::take(&mut self.builder);
        });
        self.builder = builder;
        self.spans.push(at);
        self.flush();
    }

    pub fn finish(self) -> Result<(Program, Vec<Span>), ProgramError> {
        let program = self.builder.finish()?;
        Ok((program, self.spans))
    }
}
