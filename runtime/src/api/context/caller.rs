//! How a task's program reaches its communication task: it makes a request, waits, and returns with the answer.

use super::outcome::TaskError;
use crate::api::message::Bytes;
use crate::clock::{self, Micros};
use crate::node::comm::{Comm, Completion};
use crate::node::domain::{Answers, Asked, Domain};
use crate::node::effects::Effects;
use crate::node::failstop::guarded;
use crate::node::{Inlet, More, Node};
use crate::sync::awake::{Kind, SpinPolicy};
use crate::sync::handoff::Entry;
use crate::sync::lead::Led;
use imrs_protocol::{Contents, Delivery, PortId, ReplyTo, Request, Signal, TaskId, Ticks};
use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::task::Waker;
use std::time::Duration;

pub(crate) struct Caller {
    pub node: Arc<Node>,
    place: usize,
    /// The task's position in its domain: the tasks that share one lock.
    member: usize,
    effects: Effects,
    /// The buffers with which the thread receives while it leads. Made when it first leads.
    inlet: Option<Inlet>,
    /// The spin policy of the thread.
    policy: SpinPolicy,
    stopped: bool,
    /// The error of a handler that failed. The call that this handler interrupted cannot go on.
    failed: Option<TaskError>,
    /// The message that the task took last.
    pub taken: Option<ReplyTo>,
    /// How many handlers run above the task's thread.
    pub depth: u8,
    /// Whether the current thread is in an `atomic` section.
    pub atomic: bool,
    /// The answers that the node's futures share; `None` if the task is not a future.
    answers: Option<Rc<RefCell<Answers>>>,
    /// The waker that is called when there is an answer for the future.
    waker: Option<Waker>,
}

impl Caller {
    pub fn new(node: Arc<Node>, place: usize) -> Self {
        let local = &node.locals.list[place];
        Self {
            policy: SpinPolicy::new(node.spin),
            place,
            member: local.home.member(),
            effects: Effects::new(Some(local.task)),
            node,
            inlet: None,
            stopped: false,
            failed: None,
            taken: None,
            depth: 0,
            atomic: false,
            answers: None,
            waker: None,
        }
    }

    /// The node, and the position of the task in it.
    pub fn location(&self) -> (Arc<Node>, usize) {
        (Arc::clone(&self.node), self.place)
    }

    /// A caller for a task whose program is a future: no thread of the task ever sleeps.
    pub fn of_a_future(node: Arc<Node>, place: usize, answers: Rc<RefCell<Answers>>) -> Self {
        let mut caller = Self::new(node, place);
        caller.effects.waiter = None;
        caller.effects.of_the_futures = true;
        caller.answers = Some(answers);
        caller
    }

    /// As [`call`](Self::call), without waiting: returns the answer that the task has now. If that answers an earlier
    /// request, the new requests are not made. The second request is made once the first one is accepted.
    pub fn call_now(
        &mut self,
        [request, then]: [Option<&Request>; 2],
    ) -> Result<Option<(Signal, Ticks)>, TaskError> {
        if let Some(error) = &self.failed {
            return Err(error.clone());
        }
        if self.stopped {
            return Err(TaskError::Stopped);
        }
        let mut now = None;
        let mut answer = self.brought();
        if answer.is_none() {
            let at = if request.is_some() { clock::next() } else { clock::now() };
            now = Some(at);
            answer = self.enter(Asked { at, request, then });
        }
        match answer {
            Some(Completion { signal: Signal::Fault(fault), .. }) => Err(super::RequestFault(fault).into()),
            Some(Completion { signal, at: since }) => {
                // Only the age of messages and interrupts is used, so for other signals the clock is not read.
                let ages = matches!(signal, Signal::Message(_) | Signal::Interrupt(_));
                let now = now.unwrap_or_else(|| if ages { clock::now() } else { since });
                Ok(Some((signal, Ticks(now.saturating_sub(since)))))
            }
            None if self.stopped => {
                self.give_up();
                Err(TaskError::Stopped)
            }
            None => Ok(None),
        }
    }

    /// Takes an answer that the thread of the futures itself caused for this future. This needs no lock.
    fn brought(&self) -> Option<Completion> {
        self.answers.as_ref()?.borrow_mut().take(self.member)
    }

    /// Makes the future's requests under the lock, and takes the answer if there is one.
    fn enter(&mut self, asked: Asked<'_>) -> Option<Completion> {
        let answers = self.answers.as_ref()?;
        let ask = |domain: &mut Domain, member: usize, effects: &mut Effects| {
            domain.ask(member, asked, &mut answers.borrow_mut(), effects);
        };
        ((), self.stopped) = self.node.look_in(self.place, ask, &mut self.effects);
        self.brought()
    }

    /// Whether `waker` was registered already when the future last entered its communication task. If not, registers
    /// it, and the future must enter again before it waits: an answer may have come in between.
    pub fn listens(&mut self, waker: &Waker) -> bool {
        if self.waker.as_ref().is_some_and(|own| own.will_wake(waker)) {
            return true;
        }
        self.node.locals.list[self.place].listen(waker);
        self.waker = Some(waker.clone());
        false
    }

    pub fn task(&self) -> TaskId {
        self.node.locals.list[self.place].task
    }

    /// The port of the task that has this name.
    pub fn port(&self, name: &str) -> Result<PortId, TaskError> {
        let table = &self.node.table;
        let named = |id: &PortId| table.port(*id).is_some_and(|port| port.decl.name == name);
        let mut own = table.ports_of(self.task()).iter().copied();
        own.find(named).ok_or_else(|| TaskError::NoPort(name.into()))
    }

    /// The task of the cell that has this name.
    pub fn named(&self, name: &str) -> Result<TaskId, TaskError> {
        let position = self.node.table.cell().tasks.iter().position(|task| task.name == name);
        position.map(TaskId::from_index).ok_or_else(|| TaskError::NoTask(name.into()))
    }

    /// Makes a request and waits for its answer: it spins, or waits in the link's socket, or sleeps. The wait ends
    /// when another thread brings the answer, at the state machine's next expiry, or at `over`. Returns the answer
    /// and its age. Passes each answer to `more`.
    pub fn call(
        &mut self,
        asked: Micros,
        request: Request,
        over: Micros,
        more: More<'_>,
    ) -> Result<(Signal, Ticks), TaskError> {
        if let Some(error) = &self.failed {
            return Err(error.clone());
        }
        if self.stopped {
            return Err(TaskError::Stopped);
        }
        let kind = Kind::of(&request);
        let mut now = asked;
        let mut waited = false;
        let mut entry = self.node.ask(self.place, asked, request, more, &mut self.effects);
        loop {
            let Entry { completion, stopped, until } = entry;
            self.stopped = stopped;
            if let (true, Some(kind), Some(completion)) = (waited, kind, &completion) {
                self.policy.learn(kind, completion.at.saturating_sub(asked));
            }
            match completion {
                Some(Completion { signal: Signal::Fault(fault), .. }) => {
                    return Err(super::RequestFault(fault).into());
                }
                Some(Completion { signal, at }) => return Ok((signal, Ticks(now.saturating_sub(at)))),
                None if stopped => {
                    self.give_up();
                    return Err(TaskError::Stopped);
                }
                None => {}
            }
            let until = until.min(over);
            self.wait(kind, now, until, waited);
            waited = true;
            now = clock::now();
            // The thread wakes a spin tail (the time for which it spins at the end of a wait) before the
            // deadline. This early call also brings code and data into the caches.
            let due = now.saturating_add(self.node.spin_tail) >= until;
            entry = self.node.come_back(self.place, now, due, more, &mut self.effects);
        }
    }

    /// Sets whether sent packets wait, from here on, to leave together with later ones. Returns the earlier setting.
    pub fn hold(&mut self, holds: bool) -> bool {
        let before = std::mem::replace(&mut self.effects.holds, holds);
        if !holds && !self.effects.leaving.is_empty() {
            self.node.carry_out(&mut self.effects);
        }
        before
    }

    /// Waits for an answer, but at most until `until`. If this thread can lead, and the answer is likely to come from
    /// the link, it waits in the link's socket; otherwise it sleeps. `now` may be a little old. `waited` says that
    /// the task has waited for the same answer before.
    fn wait(&mut self, kind: Option<Kind>, now: Micros, until: Micros, waited: bool) {
        if self.effects.holds {
            // Sent packets must leave before the task waits, although `together` holds them.
            self.hold(false);
            self.effects.holds = true;
        }
        let node = &self.node;
        let local = &node.locals.list[self.place];
        // A wait for a time alone (a delay) must be exact if the program set the tail. Then the thread sleeps
        // on its own futex word, not in the link.
        let link = node.link.as_ref().filter(|_| !node.is_exact || kind.is_some());
        let leading = link.and_then(|link| link.leading());
        // `by_link` is set again when the link brings an answer for this task, whichever thread receives it.
        let leading = leading.filter(|_| local.by_link.swap(false, Ordering::Relaxed));
        let handoff = &*local.handoff;
        let is_there = || handoff.is_called() || handoff.has_left();
        if leading.is_some() && is_there() {
            // There is an answer already, so no wait takes place. `by_link`, which the line above has cleared, is set
            // again.
            return local.by_link.store(true, Ordering::Relaxed);
        }
        let inlet = leading.map(|_| &*self.inlet.get_or_insert_with(|| Inlet::new(Arc::clone(node))));
        let leading = leading.zip(inlet);
        let take_in = || {
            let take_in = || leading.is_some_and(|(leading, inlet)| leading.take_in(inlet));
            guarded("a task's thread that receives", take_in)
        };
        if let Some(kind) = kind
            && handoff.look(take_in, |there| self.policy.look(kind, handoff.thread_state(), until, there))
        {
            return;
        }
        if let Some((leading, _)) = leading {
            let left =
                || (until != clock::FAR).then(|| Duration::from_micros(until.saturating_sub(clock::now())));
            match node.lead.wait(handoff, || leading.wait(left()), take_in) {
                Led::ToTheEnd => return local.by_link.store(true, Ordering::Relaxed),
                Led::Called => return,
                Led::No => local.by_link.store(true, Ordering::Relaxed),
            }
        }
        let early = if until == clock::FAR { until } else { until.saturating_sub(node.spin_tail) };
        // If the instant `early` has passed since `now` was read, the kernel returns at once.
        if now < early {
            handoff.sleep(clock::nanos_of(early));
            return;
        }
        // Unless the program set the length of the tail, a thread spins only after it has slept: a wait that is briefer
        // than the tail must yield the core, too.
        if !waited && !node.is_exact {
            handoff.sleep(clock::nanos_of(until));
            return;
        }
        while !is_there() && clock::now() < until {
            std::hint::spin_loop();
        }
    }

    /// Makes every later call of the program fail, because a handler failed.
    pub fn fail(&mut self, error: TaskError) {
        self.give_up();
        self.failed.get_or_insert(error);
    }

    /// Cancels all outstanding requests: those of handlers, and those of the activations that these handlers
    /// interrupted. The other members of a `waitfor` get an ABORT.
    pub fn give_up(&mut self) {
        self.tell(Request::Abandon);
    }

    /// Notes that the program has ended. From now on the task answers no heartbeat, so that its partner takes over (D61).
    pub fn end(&mut self) {
        self.give_up();
        self.tell(Request::End);
        if self.answers.is_none() {
            self.node.locals.list[self.place].handoff.end(&mut self.effects);
            self.node.carry_out(&mut self.effects);
        }
    }

    fn tell(&mut self, request: Request) {
        if let Some(answers) = &self.answers {
            let at = clock::next();
            let tell = |domain: &mut Domain, member: usize, effects: &mut Effects| {
                domain.tell(member, (at, &request), &mut answers.borrow_mut(), effects);
            };
            self.node.look_in(self.place, tell, &mut self.effects);
            return;
        }
        let _answered = self.node.ask(self.place, clock::next(), request, &mut |_| None, &mut self.effects);
    }

    /// A message with the remaining time that it has when the task takes it, `age` after the communication task gave it
    /// out. `None` if the message expired in between, because the thread or its whole process stood still.
    pub fn in_hand(&mut self, message: &Delivery, age: Ticks) -> Option<Delivery> {
        self.taken = Some(message.from);
        self.still_alive(message, age)
    }

    /// As [`in_hand`](Self::in_hand), for a message that the task took earlier. The fragments that the communication
    /// task keeps may belong to a later message by now.
    pub fn still_alive(&mut self, message: &Delivery, age: Ticks) -> Option<Delivery> {
        if message.budget > age {
            return Some(Delivery { budget: message.budget - age, ..*message });
        }
        self.look(|comm| comm.expired_in_hand(message));
        None
    }

    /// A taken message with all its fragments (D28).
    pub fn whole(&mut self, message: &Delivery) -> Result<Bytes, TaskError> {
        let mut whole = Bytes::of(&message.contents);
        if message.fragments > 1 {
            if self.taken != Some(message.from) {
                return Err(TaskError::Gone);
            }
            self.look(|comm| {
                for index in 1..message.fragments {
                    comm.machine().fragment(index).into_iter().for_each(|part| whole.append(part));
                }
            });
        }
        Ok(whole)
    }

    /// The answer of `task` with all its fragments. `first` is the first fragment, where it is known.
    pub fn whole_answer(&mut self, port: PortId, task: TaskId, first: Option<&Contents>) -> Bytes {
        let mut whole = first.map(Bytes::of).unwrap_or_default();
        let from = u8::from(first.is_some());
        let fragments = self.node.table.port(port).map_or(1, |port| port.decl.answer_fragments);
        if fragments > from {
            self.look(|comm| {
                let parts = (from..fragments).map_while(|i| comm.machine().answer_fragment(port, task, i));
                parts.for_each(|part| whole.append(part));
            });
        }
        whole
    }

    /// Calls `look` with the communication task after draining its inbox. Nothing else of the communication task changes.
    pub fn look<R>(&mut self, look: impl FnOnce(&mut Comm) -> R) -> R {
        let seen = self.node.locals.list[self.place].look(look, &mut self.effects);
        self.node.carry_out(&mut self.effects);
        seen
    }
}

/// Lets the packets that a program has sent leave, even if the program ended inside of a
/// [`Context::together`](super::Context::together).
impl Drop for Caller {
    fn drop(&mut self) {
        self.hold(false);
    }
}
