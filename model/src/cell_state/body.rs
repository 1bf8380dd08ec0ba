//! The tasks of a cell as nondeterministic programs: the search tries each of their choices.

use super::plan::{CellScenario, Errand, TaskPlan, Times};
use super::script::Actor;
use imrs_protocol::{
    Call, Class, Contents, Delivery, PortId, ReplyTo, Request, Signal, TaskId, Ticks, TimeId,
};

/// What an activation of a task is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) enum Does {
    /// The activation is idle. It may begin its task's errand.
    #[default]
    Free,
    /// The activation waits for its communication task.
    Waits,
    /// The activation serves a message, or is a handler that runs.
    Serves,
    /// The activation runs an action.
    Works,
}

/// One activation of a task: its thread, or a handler that interrupted the activation below it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct Activation {
    pub does: Does,
    /// The command that the activation must answer (`None` if a script answers it), and the first byte of the command's
    /// contents.
    pub to: Option<ReplyTo>,
    pub echo: u8,
    /// Whether this handler has sent its nested command.
    pub nested: bool,
    /// How many ticks the service or the work has lasted.
    pub age: u8,
    /// Specification state: how many more ticks the activation's wait may last; [`Activation::FOREVER`] for no limit.
    pub left: u8,
    /// Specification state: the contents byte of the command whose answer the activation waits for.
    pub question: u8,
    /// Specification state: whether the wait is a GET. The next field is its port.
    pub get: bool,
    pub port: Option<PortId>,
    /// Specification state: the rank at which this handler runs.
    pub rank: u8,
}

impl Activation {
    pub const FOREVER: u8 = u8::MAX;
}

/// The state of a task's own program.
#[derive(Clone, Debug, Default)]
pub(crate) struct Body {
    /// How many errands are left; [`Body::ENDLESS`] for no limit.
    pub times: u8,
    /// Ticks until the task may send again.
    pub rest: u8,
    /// The activations: the task's thread, and the handlers that interrupted each other.
    pub activations: Vec<Activation>,
    /// The script, if the task has one: then `activations` only says what the script waits for.
    pub actor: Option<Actor>,
}

impl Body {
    pub const ENDLESS: u8 = u8::MAX;

    pub fn new(plan: &TaskPlan) -> Self {
        let times = match plan.errand {
            Errand::Rest => 0,
            Errand::Receive { .. } => Self::ENDLESS,
            Errand::Send { times, .. }
            | Errand::Order { times, .. }
            | Errand::Work { times, .. }
            | Errand::Meet { times, .. }
            | Errand::Delay { times, .. } => match times {
                Times::Most(times) => times,
                Times::Endless => Self::ENDLESS,
            },
        };
        Self {
            times,
            rest: 0,
            activations: vec![Activation::default()],
            actor: plan.script.as_ref().map(Actor::new),
        }
    }

    /// The API calls that the task makes first.
    pub fn setup(plan: &TaskPlan) -> Vec<Request> {
        let mut requests = Vec::new();
        if !plan.order.ranked().is_empty() {
            requests.push(Request::Order(plan.order));
        }
        requests.extend(plan.handles.iter().map(|&port| Request::Handle { port, handled: true }));
        requests
    }

    pub fn top(&self) -> Activation {
        self.activations.last().copied().unwrap_or_default()
    }

    pub fn top_mut(&mut self) -> Option<&mut Activation> {
        self.activations.last_mut()
    }

    /// Whether the task can take its next step now, without an input.
    pub fn may_act(&self, plan: &TaskPlan) -> bool {
        if self.actor.is_some() {
            return false;
        }
        let top = self.top();
        match top.does {
            Does::Free => self.times > 0 && self.rest == 0,
            Does::Waits => false,
            Does::Serves => top.age >= plan.service.0,
            Does::Works => matches!(plan.errand, Errand::Work { least, .. } if top.age >= least),
        }
    }

    /// Whether the task must step before anything else happens.
    pub fn must_act(&self, plan: &TaskPlan) -> bool {
        if let Some(actor) = &self.actor {
            return actor.must_act();
        }
        let top = self.top();
        self.may_act(plan)
            && match top.does {
                Does::Free => plan.hurry,
                Does::Waits => false,
                Does::Serves => top.age >= plan.service.1,
                Does::Works => matches!(plan.errand, Errand::Work { most, .. } if top.age >= most),
            }
    }

    /// Whether the task's handler may send its nested command now: only one such command can be outstanding on its port.
    pub fn may_nest(&self, plan: &TaskPlan) -> bool {
        let top = self.top();
        let outstanding = |activation: &Activation| activation.nested && activation.does == Does::Waits;
        self.actor.is_none()
            && plan.nested.is_some()
            && self.activations.len() > 1
            && top.does == Does::Serves
            && !top.nested
            && !self.activations.iter().any(outstanding)
    }

    /// Lets a tick pass for the task.
    pub fn tick(&mut self, plan: &TaskPlan) {
        if let Some(actor) = &mut self.actor {
            return actor.pass(Ticks(1));
        }
        self.rest = self.rest.saturating_sub(1);
        let last = self.activations.len() - 1;
        for (i, activation) in self.activations.iter_mut().enumerate() {
            let most = match activation.does {
                // A handler stops the service that it interrupts, so only the innermost service grows older. An action
                // goes on while a handler runs.
                Does::Serves if i == last => bound(plan.service),
                Does::Works => match plan.errand {
                    Errand::Work { least, most, .. } => bound((least, most)),
                    _ => 0,
                },
                Does::Serves | Does::Free | Does::Waits => continue,
            };
            activation.age = activation.age.saturating_add(1).min(most);
        }
    }

    /// The API calls of the task's next step, in order.
    pub fn act(&mut self, task: TaskId, plan: &CellScenario) -> Vec<Request> {
        let own = &plan.tasks[task.index()];
        let top = self.top();
        match top.does {
            Does::Free => self.errand(own, plan),
            Does::Waits => Vec::new(),
            Does::Works => vec![Request::Done],
            Does::Serves => {
                let answer = top.to.map(|to| Request::Reply { to, contents: says(top.echo, plan) });
                let end = (self.activations.len() > 1).then_some(Request::Return);
                answer.into_iter().chain(end).collect()
            }
        }
    }

    fn errand(&mut self, own: &TaskPlan, plan: &CellScenario) -> Vec<Request> {
        if self.times != Self::ENDLESS {
            self.times -= 1;
        }
        let question = self.times;
        let Some(activation) = self.activations.last_mut() else { return Vec::new() };
        activation.does = Does::Waits;
        let request = match own.errand {
            Errand::Rest => return Vec::new(),
            Errand::Send { port, to, every, .. } => {
                self.rest = every;
                activation.question = question;
                Request::Send { port, to, contents: says(question, plan), time_out: None }
            }
            Errand::Order { port, .. } => Request::Send {
                port,
                to: imrs_protocol::Target::All,
                contents: Contents::EMPTY,
                time_out: None,
            },
            Errand::Receive { port, time_out } => Request::Get { port, source: None, time_out },
            Errand::Work { .. } => {
                activation.does = Does::Works;
                Request::Work
            }
            Errand::Meet { port, .. } => Request::Arrive { port, arguments: [0; 8], time_out: None },
            Errand::Delay { length, .. } => Request::Delay { id: TimeId(0), length },
        };
        vec![request]
    }

    /// The API call with which a handler sends its nested command.
    pub fn nest(&mut self, own: &TaskPlan, plan: &CellScenario) -> Vec<Request> {
        let (Some(port), Some(activation)) = (own.nested, self.activations.last_mut()) else {
            return Vec::new();
        };
        activation.does = Does::Waits;
        activation.nested = true;
        activation.question = activation.echo;
        let contents = says(activation.echo, plan);
        vec![Request::Send { port, to: imrs_protocol::Target::All, contents, time_out: None }]
    }

    /// Takes a signal of its communication task.
    pub fn hear(&mut self, signal: &Signal) {
        // A script keeps track itself of the commands that it must answer.
        let answers = |delivery: &Delivery| delivery.class == Class::Command && self.actor.is_none();
        let serves = |delivery: &Delivery| Activation {
            does: Does::Serves,
            to: answers(delivery).then_some(delivery.from),
            echo: delivery.contents.as_bytes().first().copied().unwrap_or(0),
            ..Activation::default()
        };
        match signal {
            Signal::Interrupt(call) => {
                self.activations.push(match call {
                    Call::Message(delivery) => serves(delivery),
                    Call::Timer(_) | Call::Fenced | Call::TakeOver(_) => {
                        Activation { does: Does::Serves, ..Activation::default() }
                    }
                });
            }
            Signal::Message(delivery) => {
                if let Some(activation) = self.activations.last_mut() {
                    *activation = serves(delivery);
                }
            }
            Signal::Outcome(_)
            | Signal::Answers { .. }
            | Signal::Nothing
            | Signal::Released { .. }
            | Signal::GaveUp { .. }
            | Signal::TimeOut(_)
            | Signal::Cancelled
            | Signal::Accepted(_)
            | Signal::Granted(_)
            | Signal::Fault(_) => {}
        }
    }

    /// Ends the wait of the topmost activation.
    pub fn resume(&mut self) {
        let handler = self.activations.len() > 1;
        if let Some(activation) = self.activations.last_mut() {
            if handler {
                activation.does = Does::Serves;
                (activation.question, activation.left) = (0, 0);
                (activation.get, activation.port) = (false, None);
            } else {
                *activation = Activation::default();
            }
        }
    }
}

/// The value at which `age` stops counting. A service without a longest time behaves the same from its least
/// time on.
const fn bound((least, most): (u8, u8)) -> u8 {
    if most == u8::MAX { least } else { most }
}

/// The contents of a message. Only `CellProperty::Waits` reads these contents.
pub(crate) fn says(byte: u8, plan: &CellScenario) -> Contents {
    if plan.waits().is_some() { Contents::new(&[byte]).unwrap_or_default() } else { Contents::EMPTY }
}
