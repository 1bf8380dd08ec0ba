//! A running node: the parts of [`imrs_protocol::Node`], each behind its own lock (D38, D39), except that the
//! communication tasks of a [domain](domain) share one lock (D186).
//!
//! Nothing here runs by itself. A thread that brings input is a task's thread, the receiving thread or the Timer
//! thread. It takes one lock, releases it, and carries out the effects that the state machine asked for. No thread
//! takes two locks at once.

pub(crate) mod comm;
pub(crate) mod domain;
pub(crate) mod effects;
pub(crate) mod executor;
pub(crate) mod failstop;
pub(crate) mod home;
mod inlet;
mod link_waker;
pub(crate) mod local_task;
pub(crate) mod program;
pub(crate) mod threads;
pub(crate) mod timers;
pub(crate) mod transit;

pub(crate) use inlet::Inlet;

use crate::clock::{self, Micros};
use crate::link::{Link, LinkDiscard};
use crate::node::comm::{Comm, Completion};
use crate::node::effects::{Addressed, Effect, Effects, Stamped};
use crate::node::failstop::guarded;
use crate::node::home::{Homes, RunBy};
use crate::node::link_waker::link_waker;
use crate::node::local_task::{LocalTask, LocalTasks, local_tasks};
use crate::node::timers::Timers;
use crate::node::transit::Dispatch;
use crate::observe::lateness::LatenessCounts;
use crate::record::Recorder;
use crate::script::Stage;
use crate::sync::alarm::Alarm;
use crate::sync::handoff::{Entry, ThreadWaker};
use crate::sync::lead::Lead;
use crate::sync::{AtomicU64, Mutex, Ordering};
use imrs_protocol::route::{Arrival, Departure, arrived, departing};
use imrs_protocol::{
    CommTask, Incarnation, Input, NodeId, NodeTable, Packet, Reason, Request, TaskId, Ticks, discarded,
};
use imrs_wire::obs::RealTime;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};

/// The parts from which a node is made.
pub(crate) struct Plan {
    pub machine: imrs_protocol::Node,
    /// For each task of the node, which thread runs the task's program.
    pub run_by: Vec<RunBy>,
    pub incarnation: Incarnation,
    pub insecure: bool,
    pub real_time: RealTime,
    pub link: Option<Arc<dyn Link>>,
    pub recorder: Option<Arc<dyn Recorder>>,
    pub spin: Micros,
    pub spin_tail: Micros,
    pub is_exact: bool,
}

/// A callback that gets an answer. It may return the task's next request, which is then made under the same lock.
pub(crate) type More<'a> = &'a mut dyn FnMut(&Completion) -> Option<Request>;

/// A running node. Its threads share it with its observers.
pub struct Node {
    pub(crate) table: NodeTable,
    pub(crate) incarnation: Incarnation,
    pub(crate) insecure: bool,
    pub(crate) real_time: RealTime,
    pub(crate) started: Micros,
    pub(crate) locals: Arc<LocalTasks>,
    pub(crate) dispatch: Dispatch,
    pub(crate) timers: Timers,
    pub(crate) alarm: Arc<Alarm>,
    pub(crate) lateness: LatenessCounts,
    pub(crate) link: Option<Arc<dyn Link>>,
    /// Kept as long as the node, because dropping a recorder ends its recording.
    _recorder: Option<Arc<dyn Recorder>>,
    pub(crate) lead: Lead,
    /// Whether the link brought an answer for a future since the thread of the futures last checked.
    pub(crate) futures_by_link: AtomicBool,
    /// How long a waiting thread of a task spins before it sleeps.
    pub(crate) spin: Micros,
    /// How long before its deadline a waiting thread wakes, to spin until the deadline.
    pub(crate) spin_tail: Micros,
    /// Whether the program set `spin_tail` itself.
    pub(crate) is_exact: bool,
    pub(crate) peers: Box<[Peer]>,
    /// Where the scripts of the node carry out their actions. Set when the runtime starts.
    pub(crate) stage: OnceLock<Stage>,
    /// How many packets were dropped before a state machine got them, by position in [`Reason::ALL`].
    pub(crate) discards: [AtomicU64; Reason::ALL.len()],
    /// How many datagrams and packets the link dropped, by position in [`LinkDiscard::NAMES`].
    pub(crate) link_discards: [AtomicU64; LinkDiscard::NAMES.len()],
}

/// What a node knows about one of its neighbours.
pub(crate) struct Peer {
    pub node: NodeId,
    pub received: AtomicU64,
    /// When packets last arrived from the neighbour, in microseconds of the node's clock; zero before the first.
    pub heard: AtomicU64,
    incarnation: Mutex<Option<Incarnation>>,
}

impl Node {
    pub(crate) fn new(plan: Plan) -> Self {
        let now = clock::now();
        let imrs_protocol::Parts { table, tasks, transit, timer } = plan.machine.into_parts();
        let count = tasks.len();
        let alarm = Arc::new(Alarm::new(count + 2));
        let waker = link_waker(plan.link.as_ref());
        let run_by = tasks.iter().map(CommTask::task).zip(plan.run_by);
        let homes = Arc::new(Homes::new(run_by, table.cell().tasks.len()));
        let comm = |(place, machine): (usize, CommTask)| {
            let log = plan.recorder.clone().and_then(|recorder| recorder.log(machine.task()));
            let home = (homes.at(place), Arc::clone(&homes));
            Comm::new(machine, table.clone(), home, Arc::clone(&alarm), log, now)
        };
        let comms = tasks.into_vec().into_iter().enumerate().map(comm);
        let list = local_tasks(comms, &table, &homes, waker.as_ref());
        let locals = Arc::new(LocalTasks::new(list, homes));
        let peer = |node| Peer {
            node,
            received: AtomicU64::new(0),
            heard: AtomicU64::new(0),
            incarnation: Mutex::new(None),
        };
        Self {
            incarnation: plan.incarnation,
            insecure: plan.insecure,
            real_time: plan.real_time,
            started: now,
            dispatch: Dispatch::new(
                table.clone(),
                transit,
                plan.link.clone(),
                Arc::clone(&locals),
                Arc::clone(&alarm),
                now,
            ),
            locals,
            timers: Timers::new(timer, count, Arc::clone(&alarm), count + 1, now),
            alarm,
            lateness: LatenessCounts::new(table.cell().tick.0),
            stage: OnceLock::new(),
            link: plan.link,
            _recorder: plan.recorder,
            lead: Lead::new(),
            futures_by_link: AtomicBool::new(true),
            spin: plan.spin,
            spin_tail: plan.spin_tail,
            is_exact: plan.is_exact,
            peers: table.neighbours(table.node).map(peer).collect(),
            discards: std::array::from_fn(|_| AtomicU64::new(0)),
            link_discards: std::array::from_fn(|_| AtomicU64::new(0)),
            table,
        }
    }

    /// The table of the cell as this node sees it.
    #[must_use]
    pub fn table(&self) -> &NodeTable {
        &self.table
    }

    /// The incarnation of this node: which of the node's starts this is.
    #[must_use]
    pub fn incarnation(&self) -> Incarnation {
        self.incarnation
    }

    /// The name of the node.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.table.cell().nodes[self.table.node.index()].name
    }

    /// Wakes a thread of this node that waits in its link.
    pub(crate) fn waker(&self) -> Option<Arc<dyn ThreadWaker>> {
        link_waker(self.link.as_ref())
    }

    /// An instant, in microseconds of the node's clock. Every script step before it has been reported to its
    /// [`Watch`](crate::script::Watch), and each task knows if its lease ended before it. No step is reported later
    /// with an earlier time.
    #[must_use]
    pub fn told_until(&self) -> u64 {
        let now = clock::now();
        // A script step is stamped and reported under its task's lock. `look` takes this lock, so earlier steps are reported.
        for local in &self.locals.list {
            if self.look(local, |comm| comm.is_overdue(now)) {
                self.catch_up(local);
            }
        }
        now
    }

    /// Advances the task's clock to now, so that its script learns at once what has expired, above all its lease.
    pub(crate) fn catch_up(&self, local: &LocalTask) {
        let mut effects = Effects::of_an_onlooker();
        local.with_runner(&mut effects, |runner, comm, effects| runner.catch_up(comm, effects));
        self.carry_out(&mut effects);
    }

    /// Makes `request` for a task's own thread, then those that [`More`] returns, and carries out the effects.
    pub(crate) fn ask(
        &self,
        place: usize,
        at: Micros,
        request: Request,
        more: More<'_>,
        effects: &mut Effects,
    ) -> Entry<Completion> {
        let first = request_of(at, request);
        let next = |completion: &Completion| more(completion).map(|next| request_of(at, next));
        let entry = self.locals.list[place].handoff.enter_and(first, next, effects);
        self.carry_out(effects);
        entry
    }

    /// Advances a task after its thread has waited. `due` says that the deadline of the wait has passed.
    pub(crate) fn come_back(
        &self,
        place: usize,
        now: Micros,
        due: bool,
        more: More<'_>,
        effects: &mut Effects,
    ) -> Entry<Completion> {
        if due {
            // The task must know whether its message left before its own time_out counts, so the buffer goes first.
            self.dispatch.advance(now, effects);
            self.timers.advance(now, effects);
            self.carry_out(effects);
        }
        let time = Addressed { member: 0, stamped: Stamped { at: now, input: Input::Time } };
        let next = |completion: &Completion| more(completion).map(|next| request_of(now, next));
        let entry = self.locals.list[place].handoff.come_back_and(time, next, effects);
        self.carry_out(effects);
        entry
    }

    /// Drains the inbox of a communication task, and then calls `look` with the task. Nothing else of the task changes.
    pub(crate) fn look<R>(&self, local: &LocalTask, look: impl FnOnce(&mut Comm) -> R) -> R {
        let mut effects = Effects::of_an_onlooker();
        let seen = guarded("a look at a communication task", || local.look(look, &mut effects));
        self.carry_out(&mut effects);
        seen
    }

    /// Serves all deadlines that have passed and for which no thread of a task sleeps.
    pub(crate) fn tend(&self, now: Micros, effects: &mut Effects) {
        let count = self.locals.list.len();
        if self.alarm.slot(count) <= now {
            self.dispatch.advance(now, effects);
        }
        if self.alarm.slot(count + 1) <= now {
            self.timers.advance(now, effects);
        }
        self.carry_out(effects);
        for (slot, local) in self.locals.list.iter().enumerate() {
            if self.alarm.slot(slot) <= now {
                let stamped = Stamped { at: now, input: Input::Time };
                local.deliver_now(stamped, effects);
                self.carry_out(effects);
            }
        }
    }

    /// Carries out effects until none remain: one effect may cause others.
    pub(crate) fn carry_out(&self, effects: &mut Effects) {
        self.call_futures(effects);
        if !effects.is_done() || self.link.is_some() {
            guarded("the route layer, the Timer or a link", || self.carry_out_all(effects));
        }
        effects.steps = 0;
    }

    fn carry_out_all(&self, effects: &mut Effects) {
        loop {
            let mut latest = 0;
            self.call_futures(effects);
            loop {
                while let Some(effect) = effects.queue.pop_front() {
                    self.carry_out_one(effect, &mut latest, effects);
                }
                let Some((place, mut bundle)) = effects.bundles.pop() else { break };
                self.locals.list[place].handoff.deliver_all(&mut bundle, effects);
                effects.bundles.give_back(bundle);
            }
            if !effects.holds || effects.leaving.len() >= self.dispatch.at_once {
                self.dispatch.pump(latest, effects);
            }
            while let Some(effect) = effects.outside.pop_front() {
                if let Some(stage) = self.stage.get() {
                    stage.perform(self, effect);
                }
            }
            if effects.queue.is_empty() && effects.called.is_empty() {
                // All other effects are carried out. For inputs between tasks of a domain, the thread takes its lock again.
                let Some(home) = effects.inside.first() else { return };
                self.locals.list[home.place()].handoff.visit(|_, _| (), effects);
            }
        }
    }

    fn carry_out_one(&self, effect: Effect, latest: &mut Micros, effects: &mut Effects) {
        match effect {
            Effect::Transmit(at, packet) => {
                *latest = at.max(*latest);
                self.transmit(at, packet, effects);
            }
            Effect::Feed(task, stamped) => self.feed(task, stamped, effects),
            Effect::Wake(task) => {
                if let Some(local) = self.locals.of(task) {
                    local.handoff.wake(effects);
                }
            }
            Effect::Arm(at, task, id, turn, length) => {
                self.timers.arm(at, task, (id, turn), length, effects);
            }
            Effect::Disarm(at, task, id) => self.timers.disarm(at, task, id, effects),
        }
    }

    fn transmit(&self, at: Micros, packet: Packet, effects: &mut Effects) {
        match departing(&self.table, &packet) {
            Departure::Local(task) => {
                let Some(place) = self.locals.place(task) else { return };
                let local = &self.locals.list[place];
                let stamped = Stamped { at, input: Input::Packet(packet) };
                // A lone packet needs no bundle.
                let alone = effects.queue.is_empty() && effects.bundles.is_empty();
                if local.is_script() && !alone {
                    local.hold(stamped, effects);
                } else {
                    local.deliver(stamped, effects);
                }
            }
            Departure::Link(_) | Departure::Unroutable => {
                effects.leaving.push((at, packet));
            }
        }
    }

    fn feed(&self, task: TaskId, stamped: Stamped, effects: &mut Effects) {
        if let Some(local) = self.locals.of(task) {
            local.deliver(stamped, effects);
        }
    }

    /// Handles packets that arrived together. All get one instant, and lose the same remaining time (`charge`). So none
    /// counts as older than a packet that was sent before it. Each task takes its packets under one lock.
    fn receive(&self, from: NodeId, packets: &[Packet], charge: Ticks, at: Micros, effects: &mut Effects) {
        for &packet in packets {
            match arrived(&self.table, from, packet, charge) {
                Arrival::Local(task, packet) => {
                    let Some(place) = self.locals.place(task) else { continue };
                    let local = &self.locals.list[place];
                    let by_link = if local.is_future() { &self.futures_by_link } else { &local.by_link };
                    by_link.store(true, Ordering::Relaxed);
                    let stamped = Stamped { at, input: Input::Packet(packet) };
                    if packets.len() > 1 {
                        local.hold(stamped, effects);
                    } else {
                        local.deliver(stamped, effects);
                    }
                }
                Arrival::Relay(packet) => {
                    effects.leaving.push((at, packet));
                    // At most `at_once` packets are gathered: more would have to enter the buffer.
                    if effects.leaving.len() >= self.dispatch.at_once {
                        self.dispatch.pump(at, effects);
                    }
                }
                Arrival::Discard(reason, packet) => {
                    self.discards[reason as usize].fetch_add(1, Ordering::Relaxed);
                    self.dispatch.note(at, discarded(reason, &packet));
                }
            }
        }
        self.carry_out(effects);
    }

    /// Gives every task of the node this input about a neighbour.
    fn tell_all(&self, input: Input, at: Micros, effects: &mut Effects) {
        for local in &self.locals.list {
            local.deliver(Stamped { at, input }, effects);
        }
        self.carry_out(effects);
    }

    fn peer(&self, node: NodeId) -> Option<&Peer> {
        self.peers.iter().find(|peer| peer.node == node)
    }
}

/// A request of a task that shares its lock with no other task.
const fn request_of(at: Micros, request: Request) -> Addressed {
    Addressed { member: 0, stamped: Stamped { at, input: Input::Request(request) } }
}
