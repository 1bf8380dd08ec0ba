//! A slow, independent form of a world without restarts: cloned communication tasks, packets and memories in `Vec`s, and
//! absolute rounds, all hashed field by field. It shares with the packed form only the state machine, the scenario and the
//! names of actions. So equal counts of states and transitions show that packing loses and invents nothing.

use super::structural::hash_fields;
use imrs_model::{Action, Behaviour, Scenario, Violation, Watch};
use imrs_protocol::{
    Class, CommTask, Contents, Event, Kind, Meeting, MessageId, Node, NodeId, NodeInput, NodeOutbox,
    NodeTable, Observation, Packet, Pass, PortId, ReplyTo, Request, Round, Seq24, Signal, Target, TaskId,
    TaskState, Ticks, Walk,
};
use stateright::{Model, Property};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Arc, Mutex};

/// The round from which a normalised state counts rounds.
const ORIGIN_ROUND: Round = Round(500);
const ORIGIN_SEQUENCE: Seq24 = Seq24::new(5000);
const ENDLESS: u8 = u8::MAX;

#[derive(Clone, Debug)]
pub struct Reference {
    tasks: Vec<CommTask>,
    in_flight: Vec<InFlight>,
    memories: Vec<Memory>,
    loss: u8,
    dup: u8,
    pub violation: Option<Violation>,
}

#[derive(Clone, Debug)]
struct InFlight {
    packet: Packet,
    age: u8,
}

/// The specification state of one task.
#[derive(Clone, Debug, Default, Hash)]
struct Memory {
    left: u8,
    announced: Vec<Round>,
    released: Vec<Round>,
    gave_up: Vec<Round>,
    reached: u32,
    releases: u32,
    last_released: Option<Round>,
    serving: Option<ReplyTo>,
    /// The commands of this task that were handed over to its receiver.
    executed: Vec<Seq24>,
}

impl Hash for Reference {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        if let Some(violation) = self.violation {
            return (violation as u8).hash(hasher);
        }
        self.tasks.iter().for_each(|task| hash_fields(task, hasher));
        self.in_flight.iter().for_each(|carried| key(carried).hash(hasher));
        (&self.memories, self.loss, self.dup).hash(hasher);
    }
}

/// Two states are equal if their fingerprints are equal: the search compares them in this way, too.
impl PartialEq for Reference {
    fn eq(&self, other: &Self) -> bool {
        let fingerprint = |state: &Self| {
            let mut hasher = DefaultHasher::new();
            state.hash(&mut hasher);
            hasher.finish()
        };
        fingerprint(self) == fingerprint(other)
    }
}

/// The fields that distinguish packets. The id of a meeting's packet is left out, because no task reads it, and the
/// remaining time of a CONFIRM or an ABORT is constant.
fn key(carried: &InFlight) -> (u8, u16, u16, u16, bool, u32, u64, Contents, u8) {
    let p = &carried.packet;
    let sequence = if of_meeting(p) { 0 } else { p.id.sequence.get() };
    let remaining = if matches!(p.kind, Kind::Confirm | Kind::Abort) { 0 } else { p.remaining.0 };
    let status = p.class == Class::Status;
    (
        p.kind as u8,
        p.source.0,
        p.destination.0,
        p.port.0,
        status,
        sequence,
        remaining,
        p.contents,
        carried.age,
    )
}

/// An order of packets in which equal packets are neighbours.
fn order(carried: &InFlight) -> impl Ord + use<> {
    let (a, b, c, d, e, f, g, contents, age) = key(carried);
    (a, b, c, d, e, f, g, contents.as_bytes().to_vec(), age)
}

const fn of_meeting(packet: &Packet) -> bool {
    matches!(packet.kind, Kind::Arrive | Kind::Confirm | Kind::Abort)
}

/// The task from whose sequence numbers the id of a packet comes.
const fn counts_in(packet: &Packet) -> TaskId {
    match packet.kind {
        Kind::Reply | Kind::Response | Kind::Control => packet.destination,
        _ => packet.source,
    }
}

#[derive(Default)]
struct Seen {
    sent: Vec<Packet>,
    signals: Vec<Signal>,
    observations: Vec<Observation>,
}

impl NodeOutbox for Seen {
    fn link(&mut self, _: NodeId, packet: Packet) {
        self.sent.push(packet);
    }
    fn signal(&mut self, _: TaskId, signal: Signal) {
        self.signals.push(signal);
    }
    fn observe(&mut self, _: Option<TaskId>, observation: Observation) {
        self.observations.push(observation);
    }
}

/// The reference form as a stateright model. It uses no reductions, not even those of the scenario.
pub struct ReferenceModel {
    scenario: Arc<Scenario>,
    /// Reusable nodes. For one step a task is put into a node; between steps the nodes are empty.
    nodes: Mutex<Vec<Node>>,
    tables: Vec<NodeTable>,
    states: u64,
    expanded: std::sync::atomic::AtomicU64,
}

impl ReferenceModel {
    /// The reference form of `scenario`. The search expands at most `states` states.
    pub fn new(scenario: &Arc<Scenario>, states: u64) -> Self {
        assert!(!scenario.incarnations(), "the reference form has no restarts");
        let tables = (0..scenario.tasks()).map(|i| scenario.table(NodeId::from_index(i)));
        let tables: Vec<NodeTable> = tables.collect();
        let node = |table: &NodeTable| Node::new(table.clone(), imrs_protocol::Incarnation(0), false, 16);
        let nodes = Mutex::new(tables.iter().map(node).collect());
        Self { scenario: Arc::clone(scenario), nodes, tables, states, expanded: 0.into() }
    }

    fn member_port(&self, i: usize) -> PortId {
        match self.scenario.behaviours[i] {
            Behaviour::Member { port, .. } | Behaviour::Sender { port, .. } => port,
            Behaviour::Receiver => PortId(0),
        }
    }

    fn apply(&self, state: &mut Reference, action: Action) -> Result<(), Violation> {
        match action {
            Action::Tick => {
                state.in_flight.iter_mut().for_each(|carried| carried.age += 1);
                (0..state.tasks.len()).try_for_each(|i| self.step(state, i, 1, NodeInput::Time))
            }
            Action::Deliver(at) | Action::Duplicate(at) => {
                let packet = state.in_flight[usize::from(at)].packet;
                if matches!(action, Action::Duplicate(_)) {
                    state.dup -= 1;
                } else {
                    state.in_flight.remove(usize::from(at));
                }
                let charge = Ticks(u64::from(self.scenario.delay.unwrap_or(0)));
                let from = NodeId::from_index(packet.source.index());
                self.step(state, packet.destination.index(), 0, NodeInput::Packet { from, packet, charge })
            }
            Action::Lose(at) => {
                state.in_flight.remove(usize::from(at));
                state.loss -= 1;
                Ok(())
            }
            Action::Act(i) => {
                let i = usize::from(i);
                let request = self.request(state, i);
                self.step(state, i, 0, NodeInput::Request(TaskId::from_index(i), request))
            }
            Action::Answer(i) => {
                let i = usize::from(i);
                let to = state.memories[i].serving.take().expect("an answer needs a command");
                let asker = &state.tasks[to.source.index()];
                let back = asker.next_sequence().steps_from(to.id.sequence) - 1;
                let asked = u32::from(state.memories[to.source.index()].left) + back;
                let contents = Contents::new(&[u8::try_from(asked).unwrap()]).unwrap();
                let reply = Request::Reply { to, contents };
                self.step(state, i, 0, NodeInput::Request(TaskId::from_index(i), reply))
            }
            Action::Crash(_)
            | Action::Restart(_)
            | Action::Heal
            | Action::Late(_)
            | Action::Overcharge(..) => unreachable!("not in the reference form"),
        }
    }

    fn request(&self, state: &mut Reference, i: usize) -> Request {
        let port = self.member_port(i);
        let left = &mut state.memories[i].left;
        let behaviour = self.scenario.behaviours[i];
        if *left != ENDLESS && behaviour != Behaviour::Receiver {
            *left -= 1;
        }
        match behaviour {
            Behaviour::Member { .. } => Request::Arrive { port, arguments: [0; 8], time_out: None },
            Behaviour::Sender { .. } => {
                let contents = Contents::new(&[*left]).unwrap();
                Request::Send { port, to: Target::All, contents, time_out: None }
            }
            Behaviour::Receiver => Request::Get { port: None, source: None, time_out: None },
        }
    }

    fn step(&self, state: &mut Reference, i: usize, ticks: u64, input: NodeInput) -> Result<(), Violation> {
        let waited_in = match state.tasks[i].state() {
            TaskState::Waiting { round, .. } => Some(round),
            _ => None,
        };
        let mut seen = Seen::default();
        {
            let mut nodes = self.nodes.lock().unwrap();
            std::mem::swap(&mut nodes[i].parts_mut().tasks[0], &mut state.tasks[i]);
            let now = nodes[i].now() + Ticks(ticks);
            nodes[i].step(now, input, &mut seen);
            std::mem::swap(&mut nodes[i].parts_mut().tasks[0], &mut state.tasks[i]);
        }
        state.in_flight.extend(seen.sent.into_iter().map(|packet| InFlight { packet, age: 0 }));
        remember(&mut state.memories[i], waited_in, &seen.observations);
        seen.signals.iter().try_for_each(|signal| self.judge(state, i, signal))?;
        let any = |mark: fn(&Memory) -> &Vec<Round>| state.memories.iter().flat_map(mark).collect::<Vec<_>>();
        let divergent = any(|m| &m.released).iter().any(|round| any(|m| &m.gave_up).contains(round));
        if self.scenario.watch == Watch::AllOrNone && divergent { Err(Violation::Divergent) } else { Ok(()) }
    }

    fn judge(&self, state: &mut Reference, i: usize, signal: &Signal) -> Result<(), Violation> {
        let watch = self.scenario.watch;
        match signal {
            Signal::Released { round, .. } => {
                let memory = &mut state.memories[i];
                memory.released.push(*round);
                memory.releases += 1;
                memory.last_released = Some(*round);
                let releases = memory.releases;
                let all = |test: &dyn Fn(&Memory) -> bool| state.memories.iter().all(test);
                if watch == Watch::FalseRelease && !all(&|m| m.announced.contains(round))
                    || watch == Watch::Pairing && !all(&|m| m.reached >= releases)
                {
                    return Err(Violation::FalseRelease);
                }
                let paired = |m: &Memory| {
                    m.releases < releases || (m.releases == releases && m.last_released == Some(*round))
                };
                if watch == Watch::Pairing && !all(&paired) {
                    return Err(Violation::Unpaired);
                }
                Ok(())
            }
            Signal::Message(delivery) if delivery.class == Class::Command => {
                state.memories[i].serving = Some(delivery.from);
                let executed = &mut state.memories[delivery.from.source.index()].executed;
                if executed.contains(&delivery.from.id.sequence) && watch == Watch::AtMostOnce {
                    return Err(Violation::ExecutedTwice);
                }
                executed.push(delivery.from.id.sequence);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Makes rounds, sequence numbers and time relative to fixed origins, and drops what the property does not need.
    fn normalise(&self, state: &mut Reference) {
        for (i, task) in state.tasks.iter_mut().enumerate() {
            task.bury();
            task.rebase(&self.tables[i]);
        }
        let next: Vec<Seq24> = state.tasks.iter().map(CommTask::next_sequence).collect();
        let mut oldest = Oldest(None);
        for (task, table) in state.tasks.iter_mut().zip(&self.tables) {
            task.walk(table, &mut oldest);
        }
        for carried in state.in_flight.iter().filter(|carried| of_meeting(&carried.packet)) {
            let meeting = carried.packet.meeting();
            [meeting.round, meeting.released].iter_mut().for_each(|round| oldest.round(PortId(0), round));
        }
        state
            .memories
            .iter()
            .filter_map(|m| m.last_released)
            .for_each(|mut r| oldest.round(PortId(0), &mut r));
        let mut origin = Origin { oldest: oldest.0.unwrap_or(ORIGIN_ROUND), next };
        for (task, table) in state.tasks.iter_mut().zip(&self.tables) {
            task.walk(table, &mut origin);
        }
        for InFlight { packet, .. } in &mut state.in_flight {
            origin.packet(packet);
        }
        let fewest = state.memories.iter().map(|m| m.releases).min().unwrap_or(0);
        for (i, memory) in state.memories.iter_mut().enumerate() {
            self.forget(memory, TaskId::from_index(i), fewest, &mut origin);
        }
        state.in_flight.sort_by_cached_key(order);
    }

    fn forget(&self, memory: &mut Memory, task: TaskId, fewest: u32, origin: &mut Origin) {
        let watch = self.scenario.watch;
        let kept = Memory { left: memory.left, ..Memory::default() };
        let mut rounds = |rounds: &[Round]| {
            let mut rounds: Vec<Round> =
                rounds.iter().copied().filter(|&r| !origin.oldest.is_newer_than(r)).collect();
            rounds.iter_mut().for_each(|r| origin.round(PortId(0), r));
            rounds.sort_by_key(|r| r.0);
            rounds.dedup();
            rounds
        };
        *memory = match watch {
            Watch::FalseRelease => Memory { announced: rounds(&memory.announced), ..kept },
            Watch::AllOrNone => {
                Memory { released: rounds(&memory.released), gave_up: rounds(&memory.gave_up), ..kept }
            }
            Watch::Pairing => Memory {
                reached: memory.reached - fewest,
                releases: memory.releases - fewest,
                last_released: rounds(memory.last_released.as_slice()).first().copied(),
                ..kept
            },
            Watch::AtMostOnce => {
                let mut kept = Memory { serving: memory.serving, executed: memory.executed.clone(), ..kept };
                if let Some(to) = &mut kept.serving {
                    origin.sequence(to.source, &mut to.id.sequence);
                }
                kept.executed.iter_mut().for_each(|sequence| origin.sequence(task, sequence));
                kept.executed.sort_by_key(|sequence| sequence.get());
                kept
            }
            other => unreachable!("the reference form has no {other:?}"),
        };
    }
}

fn remember(memory: &mut Memory, mut waited_in: Option<Round>, observations: &[Observation]) {
    for seen in observations {
        let round = Round(u16::try_from(seen.number & 0xffff).unwrap());
        match seen.event {
            Event::Reached | Event::Rejoined => {
                memory.gave_up.extend(waited_in);
                memory.announced.push(round);
                memory.reached += u32::from(seen.event == Event::Reached);
                waited_in = Some(round);
            }
            Event::GaveUp => {
                memory.gave_up.push(round);
                waited_in = None;
            }
            _ => {}
        }
    }
}

struct Oldest(Option<Round>);

impl Walk for Oldest {
    const PASS: Pass = Pass::Look;

    fn round(&mut self, _: PortId, round: &mut Round) {
        self.0 =
            Some(self.0.map_or(*round, |oldest| if oldest.is_newer_than(*round) { *round } else { oldest }));
    }
}

struct Origin {
    oldest: Round,
    next: Vec<Seq24>,
}

impl Origin {
    fn packet(&mut self, packet: &mut Packet) {
        if of_meeting(packet) {
            packet.id = MessageId::default();
            let Meeting { mut round, mut released, mut arguments } = packet.meeting();
            if packet.kind == Kind::Abort {
                let mut next = packet.meeting().next_round();
                self.round(packet.port, &mut next);
                arguments = Meeting::abort_arguments(next);
            }
            self.round(packet.port, &mut round);
            self.round(packet.port, &mut released);
            packet.contents = Meeting { round, released, arguments }.to_contents();
        } else {
            self.sequence(counts_in(packet), &mut packet.id.sequence);
        }
    }
}

impl Walk for Origin {
    const PASS: Pass = Pass::Change;

    fn round(&mut self, _: PortId, round: &mut Round) {
        *round = ORIGIN_ROUND.plus(round.steps_from(self.oldest));
    }
    fn sequence(&mut self, source: TaskId, sequence: &mut Seq24) {
        let back = self.next[source.index()].steps_from(*sequence);
        *sequence = ORIGIN_SEQUENCE.plus(Seq24::MODULUS - back);
    }
}

impl Model for ReferenceModel {
    type State = Reference;
    type Action = Action;

    fn init_states(&self) -> Vec<Reference> {
        let memory = |behaviour: &Behaviour| Memory {
            left: match *behaviour {
                Behaviour::Member { attempts, .. } => attempts.unwrap_or(ENDLESS),
                Behaviour::Sender { sends, .. } => sends,
                Behaviour::Receiver => 0,
            },
            ..Memory::default()
        };
        let mut state = Reference {
            tasks: self.nodes.lock().unwrap().iter().map(|node| node.parts().tasks[0].clone()).collect(),
            in_flight: Vec::new(),
            memories: self.scenario.behaviours.iter().map(memory).collect(),
            loss: self.scenario.budget.loss,
            dup: self.scenario.budget.dup,
            violation: None,
        };
        self.normalise(&mut state);
        vec![state]
    }

    fn actions(&self, state: &Reference, actions: &mut Vec<Action>) {
        let expanded = self.expanded.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        if state.violation.is_some() || expanded >= self.states {
            return;
        }
        for (i, behaviour) in self.scenario.behaviours.iter().enumerate() {
            let (at, idle) = (u8::try_from(i).unwrap(), state.tasks[i].is_idle());
            match behaviour {
                Behaviour::Receiver if state.memories[i].serving.is_some() => {
                    actions.push(Action::Answer(at));
                }
                Behaviour::Receiver if idle => actions.push(Action::Act(at)),
                Behaviour::Member { .. } | Behaviour::Sender { .. } if idle && state.memories[i].left > 0 => {
                    actions.push(Action::Act(at));
                }
                _ => {}
            }
        }
        let urgent = self.scenario.hurry && !actions.is_empty();
        for (i, carried) in state.in_flight.iter().enumerate() {
            if i > 0 && key(&state.in_flight[i - 1]) == key(carried) {
                continue;
            }
            let at = u8::try_from(i).unwrap();
            actions.push(Action::Deliver(at));
            actions.extend((state.loss > 0).then_some(Action::Lose(at)));
            actions.extend((state.dup > 0).then_some(Action::Duplicate(at)));
        }
        if let Some(delay) = self.scenario.delay
            && !urgent
            && state.in_flight.iter().all(|carried| carried.age < delay)
        {
            actions.push(Action::Tick);
        }
    }

    fn next_state(&self, state: &Reference, action: Action) -> Option<Reference> {
        let mut next = state.clone();
        match self.apply(&mut next, action) {
            Ok(()) => self.normalise(&mut next),
            Err(violation) => next.violation = Some(violation),
        }
        Some(next)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![Property::always("claim", |_, state: &Reference| state.violation.is_none())]
    }
}
