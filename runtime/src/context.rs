//! What a task's program says to its communication task (§II, §5.2.1).

use crate::clock;
use crate::comm::Mail;
use crate::effects::Effects;
use crate::node::Node;
use imrs_protocol::{
    Contents, Delivery, Fault, Outcome, PortId, Ranked, ReleasedBy, ReplyTo, Request, Round, ServiceOrder,
    Signal, Target, TaskId, Ticks, TimeId,
};
use std::sync::Arc;
use std::time::Duration;

/// Why a call of a task's program was not carried out.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TaskError {
    /// The node stops: the program should return.
    #[error("the node stops")]
    Stopped,
    /// The request is at fault; nothing was done.
    #[error("{0}")]
    Fault(#[from] RequestFault),
    /// The cell has no port of this name, or the task is no party of it.
    #[error("the task has no port `{0}`: check the name and the port's user_list")]
    NoPort(String),
    /// The cell has no task of this name.
    #[error("the cell has no task `{0}`")]
    NoTask(String),
    /// The message does not fit a packet.
    #[error("a message of {0} bytes does not fit: 12 are the most")]
    TooLong(usize),
    /// More ports in one `order` than it has levels.
    #[error("`order` ranks at most 8 ports, not {0}")]
    TooManyLevels(usize),
}

/// A [`Fault`] as an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", explain(.0))]
pub struct RequestFault(pub Fault);

fn explain(fault: &Fault) -> &'static str {
    match fault {
        Fault::NotYourPort => "the task neither owns nor uses this port",
        Fault::WrongUsage => "the port's usage does not allow this",
        Fault::NotAPeer => "the named task is not at the other end of the port",
        Fault::TooManyTimers => "the task has as many timers as it may have",
        Fault::WrongLength => "the message has more fragments than its format, or one is missing",
        Fault::NotInterrupted => "no handler runs",
        Fault::Fenced => "the task does not hold the lease that this port acts under",
        Fault::Busy => "another request is outstanding",
        Fault::NothingToAnswer => "no such message waits for a reply",
        Fault::Late => "the execution budget has ended: the sender is beyond waiting",
    }
}

/// How a `send` ended.
#[must_use = "a command that was not answered may or may not have run"]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// Class 1: so many copies were accepted. What becomes of them is not reported (R53).
    Copies(u16),
    /// Class 2: how it ended.
    Outcome(Outcome),
}

impl Sent {
    /// The answer to a class-2 message, if there is one.
    #[must_use]
    pub fn reply(self) -> Option<Contents> {
        match self {
            Self::Outcome(Outcome::Reply(contents)) => Some(contents),
            Self::Outcome(
                Outcome::Refused
                | Outcome::TimedOutUnsent
                | Outcome::TimedOutUnknown
                | Outcome::PeerRestarted,
            )
            | Self::Copies(_) => None,
        }
    }
}

/// How a `waitfor` ended (§4.3). Both ends are normal: every program says what it does on time_out.
#[must_use = "a task that gave up must not act as if all had arrived"]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rendezvous {
    /// All have arrived.
    Released {
        /// The round, the same for all that this meeting releases.
        round: Round,
        /// How this task came to know.
        by: ReleasedBy,
    },
    /// The time_out ended first.
    GaveUp {
        /// The round waited in.
        round: Round,
        /// Bit `i`: party `i` of the port (owner first) had not arrived.
        missing: u64,
    },
}

/// A task's end of its communication task. Every call that waits ends by its time_out, or with
/// [`TaskError::Stopped`] when the node stops.
pub struct Context {
    node: Arc<Node>,
    place: usize,
    effects: Effects,
    stopped: bool,
}

impl Context {
    pub(crate) fn new(node: Arc<Node>, place: usize) -> Self {
        let task = node.members.list[place].task;
        Self { node, place, effects: Effects::new(Some(task)), stopped: false }
    }

    /// The task.
    #[must_use]
    pub fn id(&self) -> TaskId {
        self.node.members.list[self.place].task
    }

    /// The task's name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.node.table.cell().tasks[self.id().index()].name
    }

    /// Looks up a port of this task. Do it once, before the work begins.
    ///
    /// # Errors
    /// [`TaskError::NoPort`].
    pub fn port(&self, name: &str) -> Result<PortId, TaskError> {
        let own = self.node.table.ports_of(self.id()).iter();
        let named = |id: &&PortId| self.node.table.port(**id).is_some_and(|port| port.decl.name == name);
        own.copied().find(|id| named(&id)).ok_or_else(|| TaskError::NoPort(name.into()))
    }

    /// Looks up a task of the cell.
    ///
    /// # Errors
    /// [`TaskError::NoTask`].
    pub fn task(&self, name: &str) -> Result<TaskId, TaskError> {
        let position = self.node.table.cell().tasks.iter().position(|task| task.name == name);
        position.map(TaskId::from_index).ok_or_else(|| TaskError::NoTask(name.into()))
    }

    /// Sends to all tasks at the other end of the port (R39). Class 1 returns at once; class 2, which must have one
    /// task at its other end, waits for the answer.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn send(&mut self, port: PortId, contents: &[u8]) -> Result<Sent, TaskError> {
        self.send_with(port, Target::All, contents, None)
    }

    /// Sends to one of the tasks at the other end of the port (R43).
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn send_to(&mut self, port: PortId, to: TaskId, contents: &[u8]) -> Result<Sent, TaskError> {
        self.send_with(port, Target::One(to), contents, None)
    }

    /// Sends with another life than the port's time_out.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn send_with(
        &mut self,
        port: PortId,
        to: Target,
        contents: &[u8],
        time_out: Option<Duration>,
    ) -> Result<Sent, TaskError> {
        let (contents, time_out) = (packed(contents)?, time_out.map(ticks));
        let request = Request::Send { port, to, contents, time_out };
        match self.call(request)? {
            Signal::Accepted(copies) => Ok(Sent::Copies(copies)),
            Signal::Outcome(outcome) => Ok(Sent::Outcome(outcome)),
            other => mismatch(&request, &other),
        }
    }

    /// Waits for the most urgent message of a port, or, without a port, of all the task's ports (R68). `None` says that
    /// the time_out ended first; without one it waits without end.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn receive(
        &mut self,
        port: Option<PortId>,
        time_out: Option<Duration>,
    ) -> Result<Option<Delivery>, TaskError> {
        self.get(port, None, time_out)
    }

    /// As [`receive`](Self::receive), from one source alone.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn receive_from(
        &mut self,
        port: Option<PortId>,
        source: TaskId,
        time_out: Option<Duration>,
    ) -> Result<Option<Delivery>, TaskError> {
        self.get(port, Some(source), time_out)
    }

    /// Takes the most urgent message if there is one, without waiting.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn poll(&mut self, port: Option<PortId>) -> Result<Option<Delivery>, TaskError> {
        self.get(port, None, Some(Duration::ZERO))
    }

    /// Answers a received class-2 message. Does not wait.
    ///
    /// # Errors
    /// [`Fault::Late`] where the sender is beyond waiting: it will not hear this answer.
    pub fn reply(&mut self, to: &ReplyTo, contents: &[u8]) -> Result<(), TaskError> {
        let request = Request::Reply { to: *to, contents: packed(contents)? };
        match self.call(request)? {
            Signal::Accepted(_) => Ok(()),
            other => mismatch(&request, &other),
        }
    }

    /// Waits until all tasks of the port have reached this point (§4.3), at most for the port's time_out.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn waitfor(&mut self, port: PortId) -> Result<Rendezvous, TaskError> {
        self.waitfor_with(port, [0; 8], None)
    }

    /// As [`waitfor`](Self::waitfor), telling the others something, or with a shorter time_out than the port's.
    ///
    /// # Errors
    /// [`TaskError`].
    pub fn waitfor_with(
        &mut self,
        port: PortId,
        arguments: [u8; 8],
        time_out: Option<Duration>,
    ) -> Result<Rendezvous, TaskError> {
        let request = Request::Arrive { port, arguments, time_out: time_out.map(ticks) };
        match self.call(request)? {
            Signal::Released { round, by, .. } => Ok(Rendezvous::Released { round, by }),
            Signal::GaveUp { round, missing, .. } => Ok(Rendezvous::GaveUp { round, missing }),
            other => mismatch(&request, &other),
        }
    }

    /// Ranks ports, sources, timers and the current thread from here on (§5.1.1): on equal time_outs the first goes
    /// first; what is not named comes last.
    ///
    /// # Errors
    /// [`TaskError::TooManyLevels`].
    pub fn order(&mut self, named: &[Ranked]) -> Result<(), TaskError> {
        let order = ServiceOrder::new(named).ok_or(TaskError::TooManyLevels(named.len()))?;
        let request = Request::Order(order);
        match self.call(request)? {
            Signal::Accepted(_) => Ok(()),
            other => mismatch(&request, &other),
        }
    }

    /// Lets time pass (§5.1.2): at least `length`.
    ///
    /// # Errors
    /// [`TaskError::Stopped`].
    pub fn delay(&mut self, length: Duration) -> Result<(), TaskError> {
        let request = Request::Delay { id: TimeId(0), length: ticks(length) };
        match self.call(request)? {
            Signal::TimeOut(_) => Ok(()),
            other => mismatch(&request, &other),
        }
    }

    fn get(
        &mut self,
        port: Option<PortId>,
        source: Option<TaskId>,
        time_out: Option<Duration>,
    ) -> Result<Option<Delivery>, TaskError> {
        let until = time_out.map(|time_out| clock::now().saturating_add(clock::micros(time_out)));
        let mut left = time_out.map(ticks);
        loop {
            let request = Request::Get { port, source, time_out: left };
            let (signal, waited) = self.call_and_age(request)?;
            match signal {
                Signal::Message(message) if message.budget > waited => {
                    return Ok(Some(Delivery { budget: message.budget - waited, ..message }));
                }
                // The thread or its whole process stood still with the message in hand: nothing old is handed over.
                Signal::Message(message) => {
                    let handoff = &self.node.members.list[self.place].handoff;
                    handoff.with(|comm| comm.expired_in_hand(&message), &mut self.effects);
                }
                Signal::Nothing => return Ok(None),
                other => mismatch(&request, &other),
            }
            left = until.map(|until| Ticks(until.saturating_sub(clock::now())));
        }
    }

    fn call(&mut self, request: Request) -> Result<Signal, TaskError> {
        self.call_and_age(request).map(|(signal, _)| signal)
    }

    /// Asks, and waits for the answer: first that of the machine, then asleep until it is brought, or until the
    /// machine has something to do by itself. Says too how old the answer is.
    fn call_and_age(&mut self, request: Request) -> Result<(Signal, Ticks), TaskError> {
        if self.stopped {
            return Err(TaskError::Stopped);
        }
        let asked = clock::next();
        let over = match request {
            Request::Delay { length, .. } => asked.saturating_add(length.0),
            _ => clock::FAR,
        };
        let mut now = asked;
        let mut entry = self.node.ask(self.place, asked, request, &mut self.effects);
        loop {
            self.stopped = entry.stopped;
            match entry.mail {
                Some(Mail { signal: Signal::Fault(fault), .. }) => return Err(RequestFault(fault).into()),
                Some(Mail { signal, at }) => return Ok((signal, Ticks(now.saturating_sub(at)))),
                None if entry.stopped => {
                    self.give_up();
                    return Err(TaskError::Stopped);
                }
                None => {}
            }
            let until = entry.until.min(over);
            self.node.members.list[self.place].handoff.sleep(clock::nanos_of(until));
            now = clock::now();
            entry = self.node.come_back(self.place, now, now >= until, &mut self.effects);
        }
    }

    /// Takes back whatever is outstanding: members of a `waitfor` are told.
    pub(crate) fn give_up(&mut self) {
        let _answered = self.node.ask(self.place, clock::next(), Request::Cancel, &mut self.effects);
    }
}

fn packed(contents: &[u8]) -> Result<Contents, TaskError> {
    Contents::new(contents).ok_or(TaskError::TooLong(contents.len()))
}

fn ticks(length: Duration) -> Ticks {
    Ticks(clock::micros(length))
}

/// Only a fault in the machine leads here.
#[cold]
fn mismatch(request: &Request, signal: &Signal) -> ! {
    panic!("the communication task answered {request:?} with {signal:?}")
}
