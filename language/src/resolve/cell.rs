//! Resolves ticks, nodes, links, records and faults.

use super::names::duplicate;
use super::{DUPLICATE, MISSING, OPTION, Resolver, TOO_MANY, TWICE, TYPES, UNKNOWN_NAME};
use crate::ast::{self, Item, TypeName};
use crate::diagnostic::Diagnostic;
use crate::hir::{Faults, Field, Link, Node, Pause, Record};
use crate::span::Span;
use imrs_protocol::NodeId;
use imrs_protocol::cell::MAX_NODES;

/// The greatest number of declarations of one kind (nodes, tasks, ports and others): their ids have 16 bits.
pub(super) const MOST: usize = u16::MAX as usize;

impl<'a> Resolver<'a> {
    pub(super) fn cell(&mut self, file: &'a ast::File) {
        self.hir.name = file.name.as_ref().map_or_else(String::new, |name| name.text.clone());
        for item in &file.items {
            match item {
                Item::Tick(tick) => self.tick(tick),
                Item::Node(node) => self.declare_node(node),
                Item::Type(record) => self.declare_record(record),
                Item::Link(_) | Item::Task(_) | Item::Couple(_) | Item::Faults(_) | Item::Check(_) => {}
            }
        }
        self.nested_records(file);
        for item in &file.items {
            if let Item::Link(link) = item {
                self.link(link);
            }
        }
        if self.hir.tick.is_none() {
            let at = file.name.as_ref().map_or_else(Span::default, |name| name.span);
            self.report(
                Diagnostic::error(MISSING, at, "the cell has no `tick`")
                    .label("of this cell")
                    .help("say by how much its timers may be late: `tick 1 msec;`"),
            );
        }
        self.model_tick();
    }

    fn tick(&mut self, tick: &'a ast::TickDecl) {
        let (place, what) =
            if tick.model { (&mut self.hir.model_tick, "model tick") } else { (&mut self.hir.tick, "tick") };
        if let Some(first) = place {
            let found = Diagnostic::error(DUPLICATE, tick.span, format!("the cell has two `{what}`s"))
                .label("the second one")
                .also(first.span, "the first one")
                .help("remove one of them");
            return self.report(found);
        }
        *place = Some(tick.length);
        if tick.length.usec == 0 {
            self.report(
                Diagnostic::error(OPTION, tick.length.span, format!("a `{what}` of no time"))
                    .label("must be longer than 0")
                    .help("say by how much timers may be late, such as `1 msec`"),
            );
        }
    }

    /// Checks that the `model tick` is a multiple of the `tick`, because the model counts in ticks.
    fn model_tick(&mut self) {
        let (Some(tick), Some(model)) = (self.hir.tick, self.hir.model_tick) else { return };
        if tick.usec > 0 && model.usec > 0 && !model.usec.is_multiple_of(tick.usec) {
            self.report(
                Diagnostic::error(OPTION, model.span, "the `model tick` is not a multiple of the `tick`")
                    .label("counted in ticks")
                    .also(tick.span, "the tick")
                    .help("write a multiple of the tick, or the tick itself"),
            );
        }
    }

    /// Reports a cell with too many nodes. Nothing else of such a cell is checked, because the checks search the routes
    /// between all nodes.
    pub(super) fn has_too_many_nodes(&mut self, file: &'a ast::File) -> bool {
        let mut nodes = file.items.iter().filter_map(|item| match item {
            Item::Node(node) => Some(node),
            _ => None,
        });
        let first = nodes.nth(MAX_NODES);
        if let Some(node) = first {
            self.report(
                Diagnostic::error(TOO_MANY, node.name.span, format!("more than {MAX_NODES} nodes"))
                    .label("one too many")
                    .help("split the cell: parts that do not talk to each other are cells of their own"),
            );
        }
        first.is_some()
    }

    fn declare_node(&mut self, node: &'a ast::NodeDecl) {
        if let Err(first) = self.nodes.add(&node.name, self.hir.nodes.len()) {
            return self.report(duplicate("nodes", &node.name, first));
        }
        let port = node.port.and_then(|port| {
            let fits = u16::try_from(port.value).ok().filter(|&port| port > 0);
            if fits.is_none() {
                self.report(
                    Diagnostic::error(OPTION, port.span, format!("{} is not a UDP port", port.value))
                        .label("1 to 65535")
                        .help("leave `port` out for one of its own choice, or write a free port"),
                );
            }
            fits
        });
        let host = node.at.as_ref().map(|(host, _)| host.clone());
        self.hir.nodes.push(Node { name: node.name.text.clone(), host, port, span: node.name.span });
    }

    fn link(&mut self, link: &'a ast::LinkDecl) {
        let (a, b) = (self.node(&link.a), self.node(&link.b));
        let (Some(a), Some(b)) = (a, b) else { return };
        if a == b {
            return self.report(
                Diagnostic::error(TWICE, link.b.span, format!("a link joins `{}` with itself", link.a.text))
                    .label("the same node")
                    .help("tasks of one node need no link"),
            );
        }
        if let Some(first) = self.link_between(a, b) {
            let first = self.hir.links[first].span;
            return self.report(
                Diagnostic::error(
                    TWICE,
                    link.span,
                    format!("two links join `{}` and `{}`", link.a.text, link.b.text),
                )
                .label("the second one")
                .also(first, "the first one")
                .help("keep the one with the delay that holds"),
            );
        }
        self.links.insert((a.min(b), a.max(b)), self.hir.links.len());
        let capacity = link.capacity.as_ref().and_then(|capacity| self.rate(capacity));
        self.hir.links.push(Link { a, b, delay: link.delay, capacity, span: link.span });
    }

    pub(super) fn link_between(&self, a: NodeId, b: NodeId) -> Option<usize> {
        self.links.get(&(a.min(b), a.max(b))).copied()
    }

    fn declare_record(&mut self, record: &'a ast::TypeDecl) {
        if let Err(first) = self.records.add(&record.name, self.hir.records.len()) {
            return self.report(duplicate("types", &record.name, first));
        }
        let mut fields: Vec<Field> = Vec::new();
        let mut whole = !self.lost.touches(self.lost.around(record.name.span));
        for field in &record.fields {
            if let Some(first) = fields.iter().find(|other| other.name == field.name.text) {
                let found = duplicate("fields of a record", &field.name, first.span);
                self.report(found);
                continue;
            }
            let of = match &field.of {
                None => imrs_protocol::script::Type::Word,
                Some(TypeName::Plain(of, _)) => *of,
                Some(TypeName::Timer(span)) => {
                    self.report(
                        Diagnostic::error(TYPES, *span, "a record cannot hold a timer")
                            .label("timers are variables of a task")
                            .help(format!("declare it in the task: `var {}: timer;`", field.name.text)),
                    );
                    whole = false;
                    continue;
                }
                Some(TypeName::Record(_)) => {
                    whole = false;
                    continue;
                }
            };
            fields.push(Field { name: field.name.text.clone(), of, span: field.name.span });
        }
        let (name, span) = (record.name.text.clone(), record.name.span);
        if !whole {
            self.broken_records.insert(self.hir.records.len());
        }
        self.hir.records.push(Record { name, fields, span });
    }

    /// Reports fields whose type is a record or an unknown name.
    fn nested_records(&mut self, file: &'a ast::File) {
        for item in &file.items {
            let Item::Type(record) = item else { continue };
            for field in &record.fields {
                let Some(TypeName::Record(name)) = &field.of else { continue };
                if self.records.get(&name.text).is_none() {
                    self.record(name);
                    continue;
                }
                self.report(
                    Diagnostic::error(TYPES, name.span, "a record cannot hold a record")
                        .label("not a plain type")
                        .help("write its fields out: bool, int8, int16, int32, word or real"),
                );
            }
        }
    }

    pub(super) fn too_many(&mut self, what: &str, span: Span) {
        self.report(
            Diagnostic::error(TOO_MANY, span, format!("more than {MOST} {what}"))
                .label("one too many")
                .help("split the cell"),
        );
    }

    pub(super) fn faults(&mut self, file: &'a ast::File) {
        for item in &file.items {
            let Item::Faults(decl) = item else { continue };
            let mut hypothesis = Faults { span: decl.span, ..Faults::default() };
            decl.faults.iter().for_each(|fault| self.fault(fault, &mut hypothesis));
            self.hir.faults.push(hypothesis);
        }
    }

    fn fault(&mut self, fault: &'a ast::Fault, faults: &mut Faults) {
        match fault {
            ast::Fault::Loss(n) => faults.loss = self.times(*n),
            ast::Fault::Dup(n) => faults.dup = self.times(*n),
            ast::Fault::Fail(n) => faults.fail = self.times(*n),
            ast::Fault::Drift(n) => faults.drift = self.times(*n),
            ast::Fault::Crash(name) => faults.crash.extend(self.node_or_task(name)),
            ast::Fault::Pause(name, most) => {
                let node = self.node_or_task(name);
                if let Some(most) = most.filter(|most| most.usec == 0) {
                    self.report(
                        Diagnostic::error(OPTION, most.span, "a pause that takes no time")
                            .label("it would change nothing")
                            .help("write how long it may last, `up to 300 msec`, or leave `up to` out"),
                    );
                }
                faults.pause.extend(node.map(|node| Pause { node, most: *most }));
            }
            ast::Fault::Cut(a, b) => {
                let (Some(from), Some(to)) = (self.node(a), self.node(b)) else { return };
                match self.link_between(from, to) {
                    Some(link) => faults.cut.push(link),
                    None => self.report(
                        Diagnostic::error(
                            UNKNOWN_NAME,
                            a.span.to(b.span),
                            format!("no link joins `{}` and `{}`", a.text, b.text),
                        )
                        .label("there is nothing to cut")
                        .help(format!(
                            "name a link of the cell, or declare `link {} -- {} delay ..;`",
                            a.text, b.text
                        )),
                    ),
                }
            }
        }
    }

    /// The node of this name, or the node on which the task of this name runs.
    fn node_or_task(&mut self, name: &'a ast::Name) -> Option<NodeId> {
        let task = self.tasks.get(&name.text).map(|at| self.hir.tasks[at].node);
        let node = task.or_else(|| self.nodes.get(&name.text).map(NodeId::from_index));
        if node.is_none() {
            // No node has the name, so this reports an unknown name unless a task has it.
            let _ = self.task(name);
        }
        node
    }

    fn times(&mut self, n: ast::Number) -> u8 {
        u8::try_from(n.value).unwrap_or_else(|_| {
            self.report(
                Diagnostic::error(OPTION, n.span, format!("{} faults are more than are tried", n.value))
                    .label("at most 255")
                    .help("write how many are tried: one or two show the most"),
            );
            u8::MAX
        })
    }
}
