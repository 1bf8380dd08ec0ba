//! Finds declarations that nothing uses.

use super::couples::is_used_by_tasks;
use super::{is_draft, messages, task};
use crate::codes::{DOES_NOTHING, UNUSED_PORT, UNUSED_VARIABLE};
use crate::diagnostic::Diagnostic;
use crate::hir::{Answered, CheckKind, Expr, Hir, Port, Statement, StatementKind, Task, Trigger};
use crate::walk;
use imrs_protocol::script::{Op, Slot, Term};
use imrs_protocol::{PortId, TaskId, Usage};
use std::collections::BTreeMap;

pub(super) fn check(hir: &Hir, found: &mut Vec<Diagnostic>) {
    for at in 0..hir.ports.len() {
        port(hir, PortId::from_index(at), found);
    }
    for at in 0..hir.tasks.len() {
        variables(hir, TaskId::from_index(at), found);
        nothing(hir, TaskId::from_index(at), found);
    }
}

/// Reports a task without statements and handlers if other tasks send to it or wait for it.
fn nothing(hir: &Hir, id: TaskId, found: &mut Vec<Diagnostic>) {
    let task = task(hir, id);
    if !is_draft(task) {
        return;
    }
    let asked = hir.ports.iter().enumerate().find(|&(at, port)| {
        let port_id = PortId::from_index(at);
        let joined = port.usage_of(id).is_some() && is_used_by_tasks(hir, port_id);
        joined && port.peers(id).any(|peer| uses(hir, port_id, peer) && !task_is_sender(port, id))
    });
    let Some((_, port)) = asked else { return };
    let message = format!("`{}` does nothing, but other tasks use `{}`", task.name, port.name);
    found.push(
        Diagnostic::warning(DOES_NOTHING, task.span, message)
            .label("no statement and no handler")
            .also(port.span, "other tasks depend on it here")
            .help("say what it does, or take it out of the `user_list`"),
    );
}

fn task_is_sender(port: &Port, id: TaskId) -> bool {
    messages::senders(port).any(|sender| sender == id)
}

/// Whether a task sends or waits on a port.
fn uses(hir: &Hir, id: PortId, by: TaskId) -> bool {
    let waits =
        |statement: &Statement| matches!(statement.kind, StatementKind::Waitfor { port, .. } if port == id);
    messages::is_sent(hir, id, by) || walk::any(task(hir, by), waits)
}

/// Reports a port on which no task sends or waits.
fn port(hir: &Hir, id: PortId, found: &mut Vec<Diagnostic>) {
    let port = &hir.ports[id.index()];
    let used = |&by: &TaskId| is_draft(task(hir, by)) || uses(hir, id, by);
    if !is_used_by_tasks(hir, id) || messages::starters(port).iter().any(used) {
        return;
    }
    let what = if port.usage == Usage::Waitfor { "waits at" } else { "sends on" };
    found.push(
        Diagnostic::warning(UNUSED_PORT, port.span, format!("no task {what} port `{}`", port.name))
            .label("never used")
            .help("remove it, or use it"),
    );
}

/// Reports variables that nothing reads. A record is one variable.
fn variables(hir: &Hir, id: TaskId, found: &mut Vec<Diagnostic>) {
    let task = &hir.tasks[id.index()];
    if task.is_extern || is_draft(task) {
        return;
    }
    let mut uses =
        Uses { read: vec![false; task.variables.len()], written: vec![false; task.variables.len()] };
    walk::of_task(task, &mut |statement| uses.statement(statement));
    for handler in &task.handlers {
        if let Trigger::Silence { when: Some(when), .. } = &handler.trigger {
            uses.reads(when);
        }
    }
    for check in &hir.checks {
        match &check.kind {
            CheckKind::Always(of) | CheckKind::Never(of) => uses.asked(of, id),
            CheckKind::Leads { when, then, .. } => [when, then].into_iter().for_each(|of| uses.asked(of, id)),
        }
    }
    for (name, fields) in named(task) {
        let (read, written) = (uses.any(&uses.read, &fields), uses.any(&uses.written, &fields));
        if read {
            continue;
        }
        let (message, label) = match written {
            true => (format!("what `{name}` holds is never read"), "only written"),
            false => (format!("variable `{name}` is never used"), "never used"),
        };
        let place = fields.first().map_or(task.span, |&at| task.variables[at].span);
        found.push(
            Diagnostic::warning(UNUSED_VARIABLE, place, message)
                .label(label)
                .help("remove it, or use what it holds"),
        );
    }
}

/// The variables that the file names. For each, the positions of its fields.
fn named(task: &Task) -> BTreeMap<&str, Vec<usize>> {
    let mut named: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (at, variable) in task.variables.iter().enumerate() {
        // Hidden variables of the compiler have a name in parentheses.
        if !variable.name.starts_with('(') {
            let name = variable.name.split('.').next().unwrap_or_default();
            named.entry(name).or_default().push(at);
        }
    }
    named
}

struct Uses {
    read: Vec<bool>,
    written: Vec<bool>,
}

impl Uses {
    fn any(&self, of: &[bool], fields: &[usize]) -> bool {
        fields.iter().any(|&at| of[at])
    }

    fn reads(&mut self, value: &Expr) {
        for op in &value.ops {
            if let Op::Term(Term::Load(slot)) = op {
                mark(&mut self.read, *slot);
            }
        }
    }

    fn asked(&mut self, value: &Expr, by: TaskId) {
        for op in &value.ops {
            if let Op::Term(Term::Of { task, variable }) = op
                && *task == by
            {
                mark(&mut self.read, Slot::Task(*variable));
            }
        }
    }

    fn statement(&mut self, statement: &Statement) {
        match &statement.kind {
            StatementKind::Send { values, into, .. } => {
                values.iter().for_each(|value| self.reads(value));
                into.iter().for_each(|to| mark(&mut self.written, to.slot));
            }
            StatementKind::Receive { into, .. } | StatementKind::Published { into, .. } => {
                into.iter().for_each(|to| mark(&mut self.written, to.slot));
            }
            StatementKind::Reply { to, values, .. } => {
                values.iter().for_each(|value| self.reads(value));
                if let Answered::Ticket { number, .. } = to {
                    self.reads(number);
                }
            }
            StatementKind::Waitfor { values, .. } | StatementKind::Publish { values, .. } => {
                values.iter().for_each(|value| self.reads(value));
            }
            StatementKind::Run { arguments, into, .. } => {
                arguments.iter().for_each(|value| self.reads(value));
                into.iter().for_each(|to| mark(&mut self.written, to.slot));
            }
            StatementKind::Assign { to, value } => {
                self.reads(value);
                mark(&mut self.written, to.slot);
            }
            StatementKind::AssignAll { to, values } => {
                values.iter().for_each(|value| self.reads(value));
                to.iter().for_each(|to| mark(&mut self.written, to.slot));
            }
            StatementKind::If { arms, .. } => arms.iter().for_each(|(condition, _)| self.reads(condition)),
            StatementKind::While(condition, _) | StatementKind::Assert(condition) => self.reads(condition),
            StatementKind::Order(_)
            | StatementKind::Delay(_)
            | StatementKind::Start { .. }
            | StatementKind::Stop(_)
            | StatementKind::Atomic(_)
            | StatementKind::Loop(_)
            | StatementKind::Exit
            | StatementKind::Skip
            | StatementKind::Abort(_) => {}
        }
    }
}

fn mark(of: &mut [bool], slot: Slot) {
    if let Slot::Task(at) = slot
        && let Some(flag) = of.get_mut(usize::from(at))
    {
        *flag = true;
    }
}
