//! A running node: the parts of [`imrs_protocol::Node`], each behind its own lock (D38, D39).
//!
//! Nothing here runs by itself. Whoever brings input (a task's thread, the one that receives, the Timer's) takes one
//! lock, lets go of it, and carries out what the machine wants, one effect after the other. Two machines are never
//! locked together.

pub(crate) mod comm;
pub(crate) mod effects;
pub(crate) mod executor;
pub(crate) mod failstop;
pub(crate) mod member;
pub(crate) mod program;
pub(crate) mod threads;
pub(crate) mod timers;
pub(crate) mod transit;

use crate::clock::{self, Micros};
use crate::link::{Leading, Link, LinkDiscard, Sink};
use crate::node::comm::{Comm, Mail};
use crate::node::effects::{Effect, Effects, Stamped};
use crate::node::failstop::guarded;
use crate::node::member::{Member, Members};
use crate::node::timers::Timers;
use crate::node::transit::Dispatch;
use crate::observe::lateness::LatenessCounts;
use crate::record::Recorder;
use crate::script::Stage;
use crate::sync::alarm::Alarm;
use crate::sync::handoff::{Bell, Entry};
use crate::sync::lead::Lead;
use crate::sync::{AtomicU64, Mutex, Ordering, lock};
use imrs_protocol::route::{Arrival, Departure, arrived, departing};
use imrs_protocol::{
    CommTask, Incarnation, Input, NodeId, NodeTable, Packet, Reason, Request, TaskId, Ticks, discarded,
};
use imrs_wire::obs::RealTime;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

/// What a node is made from.
pub(crate) struct Plan {
    pub machine: imrs_protocol::Node,
    pub incarnation: Incarnation,
    pub insecure: bool,
    pub real_time: RealTime,
    pub link: Option<Arc<dyn Link>>,
    pub recorder: Option<Arc<dyn Recorder>>,
    pub spin: Micros,
    pub spin_tail: Micros,
    pub is_exact: bool,
}

/// What a task asks next without letting go of its communication task, after such an answer; nothing for most.
pub(crate) type More<'a> = &'a mut dyn FnMut(&Mail) -> Option<Request>;

/// A node that runs. Shared by its threads, and by whoever observes it.
pub struct Node {
    pub(crate) table: NodeTable,
    pub(crate) incarnation: Incarnation,
    pub(crate) insecure: bool,
    pub(crate) real_time: RealTime,
    pub(crate) started: Micros,
    pub(crate) members: Arc<Members>,
    pub(crate) dispatch: Dispatch,
    pub(crate) timers: Timers,
    pub(crate) alarm: Arc<Alarm>,
    pub(crate) lateness: LatenessCounts,
    pub(crate) link: Option<Arc<dyn Link>>,
    /// Lives as long as the node: a recorder that nobody else has would end its recording.
    _recorder: Option<Arc<dyn Recorder>>,
    pub(crate) lead: Lead,
    /// Whether the link brought something for a future since their thread last asked.
    pub(crate) futures_by_link: AtomicBool,
    /// For how long a task's thread looks before it sleeps.
    pub(crate) spin: Micros,
    /// How long before the end of its time it wakes, to look until then.
    pub(crate) spin_tail: Micros,
    /// Whether somebody asked for that.
    pub(crate) is_exact: bool,
    pub(crate) peers: Box<[Peer]>,
    /// Where the scripts of the node act. Here from the start on, unless it has none.
    pub(crate) stage: OnceLock<Stage>,
    /// Drops that no machine saw, by position in [`Reason::ALL`].
    pub(crate) discards: [AtomicU64; Reason::ALL.len()],
    /// Drops by links, by position in [`LinkDiscard::NAMES`].
    pub(crate) link_discards: [AtomicU64; LinkDiscard::NAMES.len()],
}

/// A neighbour.
pub(crate) struct Peer {
    pub node: NodeId,
    pub received: AtomicU64,
    /// When anything last came from it; zero before the first time.
    pub heard: AtomicU64,
    incarnation: Mutex<Option<Incarnation>>,
}

impl Node {
    pub(crate) fn new(plan: Plan) -> Self {
        let now = clock::now();
        let imrs_protocol::Parts { table, tasks, transit, timer } = plan.machine.into_parts();
        let count = tasks.len();
        let alarm = Arc::new(Alarm::new(count + 2));
        let bell = bell_of(plan.link.as_ref());
        let member = |(slot, machine): (usize, CommTask)| {
            let task = machine.task();
            let log = plan.recorder.clone().and_then(|recorder| recorder.log(task));
            let comm = Comm::new(machine, table.clone(), slot, Arc::clone(&alarm), log, now);
            Member::new(task, comm, bell.clone())
        };
        let list = tasks.into_vec().into_iter().enumerate().map(member).collect();
        let members = Arc::new(Members::new(list, table.cell().tasks.len()));
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
                Arc::clone(&members),
                Arc::clone(&alarm),
                now,
            ),
            members,
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

    /// Which life of the node this is.
    #[must_use]
    pub fn incarnation(&self) -> Incarnation {
        self.incarnation
    }

    /// The name of the node.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.table.cell().nodes[self.table.node.index()].name
    }

    /// What calls a thread of this node that waits in its link.
    pub(crate) fn bell(&self) -> Option<Arc<dyn Bell>> {
        bell_of(self.link.as_ref())
    }

    /// An instant, in microseconds of the node's clock, before which every step of a script of this node has been told to
    /// its [`Watch`](crate::script::Watch), and no lease ended that its task does not know of: none is told later with an
    /// earlier time.
    #[must_use]
    pub fn told_until(&self) -> u64 {
        let now = clock::now();
        // A step is stamped and told under the lock of its task: one that was stamped before is over after this.
        for member in &self.members.list {
            if self.look(member, |comm| comm.is_overdue(now)) {
                self.catch_up(member);
            }
        }
        now
    }

    /// Lets the script of a task notice now what is over, first of all its lease.
    pub(crate) fn catch_up(&self, member: &Member) {
        let mut effects = Effects::of_an_onlooker();
        let catch_up = |comm: &mut Comm, effects: &mut Effects| {
            comm.with_seat(|seat, comm| seat.catch_up(comm, effects));
        };
        member.handoff.visit(catch_up, &mut effects);
        self.carry_out(&mut effects);
    }

    /// A request of a task, from its own thread, and those that [`More`] says; then whatever that brings about.
    pub(crate) fn ask(
        &self,
        place: usize,
        at: Micros,
        request: Request,
        more: More<'_>,
        effects: &mut Effects,
    ) -> Entry<Mail> {
        let stamped = Stamped { at, input: Input::Request(request) };
        let next = |mail: &Mail| more(mail).map(|next| Stamped { at, input: Input::Request(next) });
        let entry = self.members.list[place].handoff.enter_and(stamped, next, effects);
        self.carry_out(effects);
        entry
    }

    /// A task's thread is back from its sleep. `due` says that it came because its time is over.
    pub(crate) fn come_back(
        &self,
        place: usize,
        now: Micros,
        due: bool,
        more: More<'_>,
        effects: &mut Effects,
    ) -> Entry<Mail> {
        if due {
            // Before the task's own time: it must know whether its message ever left.
            self.dispatch.advance(now, effects);
            self.timers.advance(now, effects);
            self.carry_out(effects);
        }
        let stamped = Stamped { at: now, input: Input::Time };
        let next = |mail: &Mail| more(mail).map(|next| Stamped { at: now, input: Input::Request(next) });
        let entry = self.members.list[place].handoff.come_back_and(stamped, next, effects);
        self.carry_out(effects);
        entry
    }

    /// A task that is a future brings input, unless there is something for it, and looks.
    pub(crate) fn look_in(&self, place: usize, stamped: Stamped, effects: &mut Effects) -> Entry<Mail> {
        let entry = self.members.list[place].handoff.enter_awake(stamped, effects);
        self.carry_out(effects);
        entry
    }

    /// Looks at a communication task, once what was left to it is taken in. Nothing else of it changes by that.
    pub(crate) fn look<R>(&self, member: &Member, look: impl FnOnce(&mut Comm) -> R) -> R {
        let mut effects = Effects::of_an_onlooker();
        let seen = guarded("a look at a communication task", || member.handoff.with(look, &mut effects));
        self.carry_out(&mut effects);
        seen
    }

    /// Does everything that is due and that nobody waits for.
    pub(crate) fn tend(&self, now: Micros, effects: &mut Effects) {
        let count = self.members.list.len();
        if self.alarm.slot(count) <= now {
            self.dispatch.advance(now, effects);
        }
        if self.alarm.slot(count + 1) <= now {
            self.timers.advance(now, effects);
        }
        self.carry_out(effects);
        for (slot, member) in self.members.list.iter().enumerate() {
            if self.alarm.slot(slot) <= now {
                let stamped = Stamped { at: now, input: Input::Time };
                member.handoff.deliver_now(stamped, effects);
                self.carry_out(effects);
            }
        }
    }

    /// Carries out effects until none are left: those of one may bring about others.
    pub(crate) fn carry_out(&self, effects: &mut Effects) {
        if !effects.is_done() || self.link.is_some() {
            guarded("the route layer, the Timer or a link", || self.carry_out_all(effects));
        }
        effects.steps = 0;
    }

    fn carry_out_all(&self, effects: &mut Effects) {
        loop {
            let mut latest = 0;
            loop {
                while let Some(effect) = effects.queue.pop_front() {
                    self.carry_out_one(effect, &mut latest, effects);
                }
                let Some((place, mut bundle)) = effects.bundles.pop() else { break };
                self.members.list[place].handoff.deliver_all(&mut bundle, effects);
                effects.bundles.give_back(bundle);
            }
            if !effects.holds || effects.leaving.len() >= self.dispatch.at_once {
                self.dispatch.pump(latest, effects);
            }
            while let Some(deed) = effects.deeds.pop_front() {
                if let Some(stage) = self.stage.get() {
                    stage.perform(self, deed);
                }
            }
            if effects.queue.is_empty() {
                return;
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
            Effect::Nudge(task) => {
                if let Some(member) = self.members.of(task) {
                    member.handoff.nudge(effects);
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
                let Some(place) = self.members.place(task) else { return };
                let member = &self.members.list[place];
                let stamped = Stamped { at, input: Input::Packet(packet) };
                // The only one that there is to do needs no bundle.
                let alone = effects.queue.is_empty() && effects.bundles.is_empty();
                if member.scripted.load(Ordering::Relaxed) && !alone {
                    effects.bundles.push(place, stamped);
                } else {
                    member.handoff.deliver(stamped, effects);
                }
            }
            Departure::Link(_) | Departure::Unroutable => {
                effects.leaving.push((at, packet));
            }
        }
    }

    fn feed(&self, task: TaskId, stamped: Stamped, effects: &mut Effects) {
        if let Some(member) = self.members.of(task) {
            member.handoff.deliver(stamped, effects);
        }
    }

    /// Takes in what came together: one instant and one charge for all, so that none is taken to be older than what was
    /// sent before it, and for each task one visit.
    fn receive(&self, from: NodeId, packets: &[Packet], charge: Ticks, at: Micros, effects: &mut Effects) {
        for &packet in packets {
            match arrived(&self.table, from, packet, charge) {
                Arrival::Local(task, packet) => {
                    let Some(place) = self.members.place(task) else { continue };
                    let member = &self.members.list[place];
                    let listens = member.listens.load(Ordering::Relaxed);
                    let by_link = if listens { &self.futures_by_link } else { &member.by_link };
                    by_link.store(true, Ordering::Relaxed);
                    let stamped = Stamped { at, input: Input::Packet(packet) };
                    if packets.len() > 1 {
                        effects.bundles.push(place, stamped);
                    } else {
                        member.handoff.deliver(stamped, effects);
                    }
                }
                Arrival::Relay(packet) => {
                    effects.leaving.push((at, packet));
                    // As many as pass without entering the buffer.
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

    /// A neighbour has a new life.
    fn restarted(&self, node: NodeId, at: Micros, effects: &mut Effects) {
        for member in &self.members.list {
            let stamped = Stamped { at, input: Input::PeerRestarted(node) };
            member.handoff.deliver(stamped, effects);
        }
        self.carry_out(effects);
    }

    fn peer(&self, node: NodeId) -> Option<&Peer> {
        self.peers.iter().find(|peer| peer.node == node)
    }
}

/// What calls a thread of the node that waits in its link.
fn bell_of(link: Option<&Arc<dyn Link>>) -> Option<Arc<dyn Bell>> {
    link.map(|link| Arc::new(LinkBell(Arc::clone(link))) as Arc<dyn Bell>)
}

/// Calls a thread that waits in the link.
struct LinkBell(Arc<dyn Link>);

impl Bell for LinkBell {
    fn ring(&self) {
        self.0.leading().into_iter().for_each(Leading::call);
    }
}

/// What one thread receives with: the node and the thread's effects.
pub(crate) struct Inlet {
    node: Arc<Node>,
    effects: Mutex<Effects>,
}

impl Inlet {
    pub fn new(node: Arc<Node>) -> Self {
        let effects = Effects::of_a_receiver(node.members.list.len());
        Self { node, effects: Mutex::new(effects) }
    }

    /// A neighbour takes packets again: sends what waited for it.
    pub fn ready(&self) {
        self.node.dispatch.ready();
        let mut effects = lock(&self.effects);
        self.node.dispatch.pump(clock::now(), &mut effects);
        self.node.carry_out(&mut effects);
    }
}

impl Sink for Inlet {
    fn packets(&self, from: NodeId, packets: &[Packet], charge: Ticks, at: Instant) {
        // This order: a stop between the two makes the packets too old, never too young. A later one does so, too: the
        // machines are told when this was, not when they are told.
        let now = clock::now();
        let charge = charge + Ticks(clock::micros(at.elapsed()));
        if let Some(peer) = self.node.peer(from) {
            peer.received.fetch_add(packets.len() as u64, Ordering::Relaxed);
            peer.heard.store(now, Ordering::Relaxed);
        }
        self.node.receive(from, packets, charge, now, &mut lock(&self.effects));
    }

    fn peer(&self, node: NodeId, incarnation: Incarnation, restarted: bool) {
        let Some(peer) = self.node.peer(node) else { return };
        let before = lock(&peer.incarnation).replace(incarnation);
        // What was asked of an earlier incarnation may have run or not; nobody will say. It may also have been asked without
        // ever being heard of. A node that lost its state may start again with the number of an earlier incarnation.
        if before.is_some() || restarted {
            self.node.restarted(node, clock::now(), &mut lock(&self.effects));
        }
    }

    fn discarded(&self, reason: LinkDiscard) {
        self.node.link_discards[reason.index()].fetch_add(1, Ordering::Relaxed);
    }
}
