//! Resolves the owners' declarations of ports: Figure 1 with its options (R27..R31, R35, D11).

use super::names::duplicate;
use super::{DISAGREE, MISSING, OPTION, Resolver, TOO_LONG, TWICE, TWO_OWNERS, TYPES};
use crate::ast::{self, Name, PortDecl, TypeName};
use crate::diagnostic::Diagnostic;
use crate::hir::{Duration, Field, Port, User};
use crate::span::Span;
use imrs_protocol::script::{MAX_MESSAGE, Type};
use imrs_protocol::{Class, TaskId, Usage};

/// How many bytes of a task's values fit in an arrival at a `waitfor`, or in an answer to a heartbeat (D47, D61).
pub(super) const SHORT: usize = 8;

/// The fields of a port's messages, and the record that declares these fields.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Message {
    pub record: Option<usize>,
    pub fields: Vec<Field>,
}

/// The options of a `port` or a `use_port`, each at most once.
#[derive(Debug, Default)]
pub(super) struct Options<'a> {
    pub usage: Option<(Usage, Span)>,
    pub format: Option<&'a Name>,
    pub user_list: Option<(&'a [Name], Span)>,
    pub time_out: Option<Duration>,
    pub class: Option<(Class, Span)>,
    pub buffer: Option<ast::Number>,
    pub retry: Option<ast::Number>,
    pub resend: Option<(Duration, Span)>,
    pub penalty: Option<(Duration, bool, Span)>,
    pub rate: Option<(u16, Duration)>,
    pub latest: Option<Span>,
    /// Whether an option could not be used, so that the port is not fully known.
    pub broken: bool,
}

impl<'a> Resolver<'a> {
    pub(super) fn declare_ports(&mut self) {
        for (at, task) in self.written.clone().into_iter().enumerate() {
            for port in task.ports.iter().filter(|port| port.owner) {
                self.declare_port(TaskId::from_index(at), port);
            }
        }
    }

    fn declare_port(&mut self, owner: TaskId, decl: &'a PortDecl) {
        if let Err(first) = self.ports.add(&decl.name, self.hir.ports.len()) {
            return self.second_owner(owner, decl, first);
        }
        // A wrong port is added to the list, too, because the names of ports map to positions in this list.
        let at = self.hir.ports.len();
        let options = self.options(decl);
        let message = self.message(decl, options.format).unwrap_or_else(|| {
            self.poison_port(at, decl);
            Message::default()
        });
        let Some((usage, usage_span)) = options.usage else {
            self.report(
                Diagnostic::error(MISSING, decl.name.span, format!("port `{}` has no usage", decl.name.text))
                    .label("what is it for?")
                    .help("add `usage = send`, or receive, reply, query, response or waitfor"),
            );
            self.hir.ports.push(self.blank(owner, decl, Usage::Send));
            self.poison_port(at, decl);
            return;
        };
        let answer = self.answer(decl, usage, &message).unwrap_or_else(|| {
            self.poison_port(at, decl);
            Vec::new()
        });
        let class = self.class(decl, usage, &options, usage_span);
        if options.time_out.is_none() {
            self.report(
                Diagnostic::error(
                    MISSING,
                    decl.name.span,
                    format!("port `{}` has no time_out", decl.name.text),
                )
                .label("for how long may a message be used?")
                .help("add `time_out = 100 msec`: it is the priority, patience and TTL of its messages"),
            );
        }
        let buffer = options.buffer.map_or(1, |n| self.buffer(n));
        let port = Port {
            record: message.record,
            message: message.fields,
            answer,
            class,
            time_out: options.time_out,
            bounded_buffer: buffer,
            buffer_span: options.buffer.map(|n| n.span),
            retry: options.retry.map_or(0, |n| self.retry(n)),
            resend: options.resend.map(|(length, _)| length),
            penalty: options.penalty.map(|(length, literal, _)| (length, literal)),
            rate: options.rate,
            latest: options.latest.is_some(),
            user_list: options.user_list.map(|(_, span)| span),
            ..self.blank(owner, decl, usage)
        };
        self.hir.ports.push(port);
        if options.broken || self.lost.touches(decl.span) {
            self.poison_port(at, decl);
        }
        self.fitting(decl, usage, &options);
        self.short_enough(at, decl);
        if let Some((names, _)) = options.user_list {
            let known = |name: &Name| {
                self.tasks.get(&name.text).is_some() || self.modules.contains_key(name.text.as_str())
            };
            if !names.iter().all(known) {
                self.guessed_users.insert(at);
            }
            self.hir.ports[at].users = self.users(owner, names);
        }
    }

    fn second_owner(&mut self, owner: TaskId, decl: &'a PortDecl, first: Span) {
        let other = self.ports.get(&decl.name.text).and_then(|at| self.hir.ports.get(at));
        let found = match other.map(|port| &self.hir.tasks[port.owner.index()]) {
            Some(task) if self.hir.tasks[owner.index()].span != task.span => {
                let message = format!("port `{}` is owned by two tasks", decl.name.text);
                Diagnostic::error(TWO_OWNERS, decl.name.span, message)
                    .label(format!("`{}` owns it, too", self.hir.tasks[owner.index()].name))
                    .also(first, format!("`{}` owns it", task.name))
                    .help(format!(
                        "`use_port {}` if it is the same one; else rename one of them",
                        decl.name.text
                    ))
            }
            _ => duplicate("ports", &decl.name, first),
        };
        // The statements of this task name a port that does not exist; poisoning the name avoids a further report for each
        // of them.
        self.poison.ports.insert(&decl.name.text);
        self.poisoned_ports.extend(self.ports.get(&decl.name.text));
        self.report(found);
    }

    fn blank(&self, owner: TaskId, decl: &PortDecl, usage: Usage) -> Port {
        Port {
            name: decl.name.text.clone(),
            owner,
            usage,
            users: Vec::new(),
            user_list: None,
            record: None,
            message: Vec::new(),
            answer: Vec::new(),
            class: Class::Status,
            time_out: None,
            bounded_buffer: 1,
            buffer_span: None,
            retry: 0,
            resend: None,
            penalty: None,
            rate: None,
            latest: false,
            guard: None,
            span: decl.name.span,
        }
    }

    /// Marks a port as wrong, so that its uses are not reported, too.
    pub(super) fn poison_port(&mut self, at: usize, decl: &'a PortDecl) {
        self.poison.ports.insert(&decl.name.text);
        self.poisoned_ports.insert(at);
    }

    /// The users in a `user_list`. A module stands for its tasks (D32).
    fn users(&mut self, owner: TaskId, names: &'a [Name]) -> Vec<User> {
        let mut users: Vec<User> = Vec::new();
        for name in names {
            let is_module = self.tasks.get(&name.text).is_none();
            for task in self.tasks_or_module(name) {
                if task == owner && is_module {
                    continue;
                }
                let again = users.iter().find(|user| user.task == task).map(|user| user.listed);
                if task == owner || again.is_some_and(|_| !is_module) {
                    let what = if task == owner { "its owner" } else { "it twice" };
                    let found =
                        Diagnostic::error(TWICE, name.span, format!("`{}` is listed, {what}", name.text));
                    let found = match again {
                        Some(first) => found.label("the second time").also(first, "the first time"),
                        None => found.label("owns the port already"),
                    };
                    self.report(found.help("remove it from the user_list"));
                }
                if task != owner && again.is_none() {
                    let (time_out, rate, retry, span) = (None, None, None, None);
                    users.push(User { task, time_out, rate, retry, listed: name.span, span });
                }
            }
        }
        users
    }

    /// The fields of a port's messages: the parameters, a record's fields, or the fields of `message_format` (R41, C5, C7).
    pub(super) fn message(&mut self, decl: &'a PortDecl, format: Option<&'a Name>) -> Option<Message> {
        let mut broken = false;
        let format = format.and_then(|name| {
            let record = self.record(name);
            broken |= record.is_none();
            record.map(|record| (record, name.span))
        });
        let said = match &decl.parameters[..] {
            [ast::Field { of: Some(TypeName::Record(name)), .. }] => self.record(name).map(|record| {
                Message { record: Some(record), fields: self.hir.records[record].fields.clone() }
            }),
            parameters => self.plain(parameters),
        };
        if broken {
            return None;
        }
        let (said, (record, span)) = match (said?, format) {
            (said, None) => return Some(said),
            (said, Some(format)) => (said, format),
        };
        let fields = self.hir.records[record].fields.clone();
        let agrees = decl.parameters.is_empty() || same_types(&adopted(decl, &said.fields, &fields), &fields);
        if !agrees || said.record.is_some_and(|other| other != record) {
            let (name, declared) = (&self.hir.records[record].name, self.hir.records[record].span);
            let found = Diagnostic::error(
                DISAGREE,
                span,
                format!("`message_format = {name}` is not what port `{}` carries", decl.name.text),
            )
            .label(format!("{name} is ({})", types(&fields)))
            .also(decl.name.span, format!("its parameters are ({})", types(&said.fields)))
            .also(declared, "declared here")
            .help("leave `message_format` out, or let the parameters be those of the record");
            self.report(found);
        }
        Some(Message { record: Some(record), fields })
    }

    fn plain(&mut self, parameters: &'a [ast::Field]) -> Option<Message> {
        let mut fields: Vec<Field> = Vec::new();
        let mut whole = true;
        for parameter in parameters {
            if let Some(first) = fields.iter().find(|other| other.name == parameter.name.text) {
                let found = duplicate("parameters", &parameter.name, first.span);
                self.report(found);
                continue;
            }
            let of = match &parameter.of {
                None => Type::Word,
                Some(TypeName::Plain(of, _)) => *of,
                Some(TypeName::Timer(span)) => {
                    self.report(
                        Diagnostic::error(TYPES, *span, "a message cannot carry a timer")
                            .label("not a value")
                            .help("send how long it shall run, as an integer"),
                    );
                    whole = false;
                    continue;
                }
                Some(TypeName::Record(name)) => {
                    if self.record(name).is_some() {
                        self.report(
                            Diagnostic::error(TYPES, name.span, "a record is the only parameter of its port")
                                .label("beside other parameters")
                                .help("add the others to the record, or write its fields out"),
                        );
                    }
                    whole = false;
                    continue;
                }
            };
            fields.push(Field { name: parameter.name.text.clone(), of, span: parameter.name.span });
        }
        whole.then_some(Message { record: None, fields })
    }

    /// The fields of the answers to a port's messages.
    fn answer(&mut self, decl: &'a PortDecl, usage: Usage, message: &Message) -> Option<Vec<Field>> {
        let fields = match (&decl.answer, usage) {
            (Some(of), _) => self.answer_of(of),
            (None, Usage::Query | Usage::Response) => Some(message.fields.clone()),
            (None, Usage::Send | Usage::Receive | Usage::Reply | Usage::Waitfor) => Some(Vec::new()),
        };
        if let (Some(of), Usage::Waitfor | Usage::Reply) = (&decl.answer, usage) {
            self.report(
                Diagnostic::error(OPTION, span_of(of), format!("a port of usage {usage} has no answer"))
                    .label("no task gives one")
                    .help("remove the `->`"),
            );
        }
        fields
    }

    pub(super) fn answer_of(&mut self, of: &'a TypeName) -> Option<Vec<Field>> {
        match of {
            TypeName::Plain(of, span) => {
                Some(vec![Field { name: String::from("answer"), of: *of, span: *span }])
            }
            TypeName::Record(name) => self.record(name).map(|at| self.hir.records[at].fields.clone()),
            TypeName::Timer(span) => {
                self.report(
                    Diagnostic::error(TYPES, *span, "an answer cannot carry a timer")
                        .label("not a value")
                        .help("answer how long it shall run, as an integer"),
                );
                None
            }
        }
    }

    fn short_enough(&mut self, at: usize, decl: &'a PortDecl) {
        let port = &self.hir.ports[at];
        let bytes = |fields: &[Field]| fields.iter().map(|field| field.of.bytes()).sum::<usize>();
        let named = port.record.map(|record| self.hir.records[record].name.clone());
        let what =
            named.map_or_else(|| format!("a message of `{}`", port.name), |name| format!("record `{name}`"));
        let (message, answer) = (bytes(&port.message), bytes(&port.answer));
        let found = if port.usage == Usage::Waitfor && message > SHORT {
            Some(
                Diagnostic::error(
                    TOO_LONG,
                    decl.name.span,
                    format!("{what} is {message} bytes; an arrival carries {SHORT}"),
                )
                .label("the values for the other members are too long")
                .help("send them less, or send the rest through another port"),
            )
        } else if message > MAX_MESSAGE {
            let message = format!("{what} is {message} bytes; 16 packets carry {MAX_MESSAGE}");
            Some(
                Diagnostic::error(TOO_LONG, decl.name.span, message)
                    .label("too long for one message")
                    .help("send it in parts"),
            )
        } else if answer > MAX_MESSAGE {
            let message =
                format!("an answer of `{}` is {answer} bytes; 16 packets carry {MAX_MESSAGE}", port.name);
            let place = decl.answer.as_ref().map_or(decl.name.span, span_of);
            Some(
                Diagnostic::error(TOO_LONG, place, message)
                    .label("too long for one answer")
                    .help("ask for it in parts"),
            )
        } else {
            None
        };
        self.found.extend(found);
    }
}

/// The parameters of a port. A parameter without a type takes the type from `fields`, as in the paper's
/// Figure 1.
pub(super) fn adopted(decl: &PortDecl, said: &[Field], fields: &[Field]) -> Vec<Field> {
    let mut adopted = said.to_vec();
    if said.len() == fields.len() && decl.parameters.len() == fields.len() {
        for ((own, parameter), field) in adopted.iter_mut().zip(&decl.parameters).zip(fields) {
            if parameter.of.is_none() {
                own.of = field.of;
            }
        }
    }
    adopted
}

/// The types of these fields as text: `int16, bool`.
pub(super) fn types(fields: &[Field]) -> String {
    let words: Vec<&str> = fields.iter().map(|field| super::expr::word(field.of)).collect();
    words.join(", ")
}

pub(super) fn same_types(a: &[Field], b: &[Field]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.of == b.of)
}

pub(super) const fn span_of(of: &TypeName) -> Span {
    match of {
        TypeName::Plain(_, span) | TypeName::Timer(span) => *span,
        TypeName::Record(name) => name.span,
    }
}
