//! Executes a transcript: runs the nodes of a cell in virtual time. A packet takes its link's declared bound, unless a line of
//! the transcript sets another delay. Its remaining time is reduced by its real delay, but at least by the bound (D20). In each
//! tick time passes first, and then packets arrive.

use super::cells::Declared;
use super::look::{answer, look, whole};
use super::steps::{Ask, Fault, Step, What};
use super::words::Names;
use imrs_protocol::*;
use std::sync::Arc;

/// An observed event, and the tick in which it was observed.
#[derive(Clone, Debug)]
pub struct Seen {
    pub at: u64,
    pub text: String,
}

/// A packet that is under way on a link.
#[derive(Clone, Copy, Debug)]
struct Flight {
    left: u64,
    due: u64,
    from: NodeId,
    to: NodeId,
    packet: Packet,
    bound: u64,
}

enum Liveness {
    Up,
    /// The process has been suspended since this tick.
    Stopped(u64),
    Down,
}

/// A class-2 message that a task has received and may answer.
struct Got {
    task: TaskId,
    from: ReplyTo,
    answered: bool,
}

/// The links between the nodes, and the events that were observed.
struct Between {
    table: Arc<CellTable>,
    now: u64,
    flying: Vec<Flight>,
    faults: Vec<Fault>,
    busy: Vec<(NodeId, NodeId)>,
    show_packets: bool,
    seen: Vec<Seen>,
    signals: Vec<(TaskId, Signal, usize)>,
}

pub struct Drive {
    between: Between,
    nodes: Vec<Node>,
    liveness: Vec<(Liveness, u8)>,
    transit: u16,
    got: Vec<Got>,
}

struct Wires<'a> {
    node: NodeId,
    between: &'a mut Between,
}

impl Between {
    fn see(&mut self, text: String) {
        self.seen.push(Seen { at: self.now, text });
    }

    /// The fault for a packet that leaves `node`, if there is one. If several faults could apply, the first line decides.
    fn fate(&mut self, node: NodeId, packet: &Packet) -> Option<What> {
        let applies = |f: &&mut Fault| {
            f.count > 0
                && f.kind.is_none_or(|kind| kind == packet.kind)
                && (f.source, f.destination) == (packet.source, packet.destination)
                && f.at.is_none_or(|at| at == node)
        };
        let fault = self.faults.iter_mut().find(applies)?;
        if fault.count != u32::MAX {
            fault.count -= 1;
        }
        Some(fault.what)
    }
}

impl NodeOutbox for Wires<'_> {
    fn ready(&mut self, next: NodeId) -> bool {
        !self.between.busy.contains(&(self.node, next))
    }

    fn link(&mut self, next: NodeId, packet: Packet) {
        let fate = self.between.fate(self.node, &packet);
        if self.between.show_packets {
            let names = Names(&self.between.table);
            let mark = match fate {
                Some(What::Lost) => " (lost)",
                Some(What::Twice(_)) => " (twice)",
                Some(What::Takes(_)) | None => "",
            };
            let text =
                format!("{} => {} {}{mark}", names.node(self.node), names.node(next), names.packet(&packet));
            self.between.see(text);
        }
        let bound = self.between.table.link_bound(self.node, next).expect("a link").0;
        let left = self.between.now;
        let mut fly = |takes: u64| {
            let due = left + takes;
            self.between.flying.push(Flight { left, due, from: self.node, to: next, packet, bound });
        };
        match fate {
            Some(What::Lost) => {}
            Some(What::Twice(apart)) => {
                fly(bound);
                fly(bound + apart);
            }
            Some(What::Takes(takes)) => fly(takes),
            None => fly(bound),
        }
    }

    fn signal(&mut self, task: TaskId, signal: Signal) {
        // The text is written later, when the whole message can be read.
        self.between.signals.push((task, signal, self.between.seen.len()));
        self.between.see(String::new());
    }

    fn observe(&mut self, at: Option<TaskId>, observation: Observation) {
        let names = Names(&self.between.table);
        if let Some(text) = names.observation(self.node, at, &observation) {
            self.between.see(text);
        }
    }
}

impl Drive {
    pub fn new(declared: &Declared) -> Result<Self, String> {
        let table = declared.table().map_err(|faults| format!("the cell is wrong: {}", faults.join("; ")))?;
        let table = Arc::new(table);
        let ids = (0..table.cell().nodes.len()).map(NodeId::from_index);
        let new =
            |id| Node::new(NodeTable::new(Arc::clone(&table), id), Incarnation(0), false, declared.transit);
        let nodes: Vec<Node> = ids.map(new).collect();
        let liveness = nodes.iter().map(|_| (Liveness::Up, 0)).collect();
        let between = Between {
            table,
            now: 0,
            flying: Vec::new(),
            faults: Vec::new(),
            busy: Vec::new(),
            show_packets: false,
            seen: Vec::new(),
            signals: Vec::new(),
        };
        Ok(Self { between, nodes, liveness, transit: declared.transit, got: Vec::new() })
    }

    pub fn now(&self) -> u64 {
        self.between.now
    }

    /// Executes one step of the transcript. Returns the events that it caused.
    pub fn step(&mut self, step: &Step) -> Result<Vec<Seen>, String> {
        match step {
            Step::After(ticks) => {
                for _ in 0..*ticks {
                    self.tick()?;
                }
            }
            Step::Show(packets) => self.between.show_packets = *packets,
            Step::Next(fault) => self.between.faults.insert(0, fault.clone()),
            Step::Mend(from, to) => {
                self.between.faults.retain(|fault| (fault.source, fault.destination) != (*from, *to));
            }
            Step::Crash(node) => self.liveness[node.index()].0 = Liveness::Down,
            Step::Restart { node, unnoticed } => self.restart(*node, *unnoticed)?,
            Step::Stop(node) => self.liveness[node.index()].0 = Liveness::Stopped(self.between.now),
            Step::Continue(node) => self.go_on(*node)?,
            Step::Busy(from, to, busy) => {
                self.between.busy.retain(|&link| link != (*from, *to));
                if *busy {
                    self.between.busy.push((*from, *to));
                } else {
                    self.input(*from, NodeInput::Time)?;
                }
            }
            Step::Look(what) => {
                let text = look(*what, &self.nodes, &self.between.table)?;
                self.between.see(format!("| {text}"));
            }
            Step::Ask(task, ask) => self.ask(*task, ask)?,
        }
        Ok(std::mem::take(&mut self.between.seen).into_iter().filter(|seen| !seen.text.is_empty()).collect())
    }

    fn input(&mut self, node: NodeId, input: NodeInput) -> Result<(), String> {
        self.input_after(Ticks::ZERO, node, input)
    }

    /// Lets time pass at a node.
    fn pass(&mut self, node: NodeId, ticks: Ticks) -> Result<(), String> {
        self.input_after(ticks, node, NodeInput::Time)
    }

    fn input_after(&mut self, ticks: Ticks, node: NodeId, input: NodeInput) -> Result<(), String> {
        let at = &mut self.nodes[node.index()];
        at.step(at.now() + ticks, input, &mut Wires { node, between: &mut self.between });
        let parts = at.parts();
        for task in &parts.tasks {
            invariants::check(task, &parts.table)
                .map_err(|violation| format!("after {input:?}: {violation}"))?;
        }
        for (task, signal, place) in std::mem::take(&mut self.between.signals) {
            self.tell(node, task, &signal, place);
        }
        Ok(())
    }

    /// Writes the text of a signal. A message that can be answered is remembered for a later reply.
    fn tell(&mut self, node: NodeId, task: TaskId, signal: &Signal, place: usize) {
        let names = Names(&self.between.table);
        let Some(at) = self.nodes[node.index()].task(task) else { return };
        let told = names.signal(signal, &whole(at, signal), |port, of| answer(at, port, of));
        self.between.seen[place].text = format!("{} <- {told}", names.task(task));
        if let Signal::Message(d) | Signal::Interrupt(Call::Message(d)) = signal
            && d.class == Class::Command
        {
            self.got.push(Got { task, from: d.from, answered: false });
        }
    }

    fn tick(&mut self) -> Result<(), String> {
        self.between.now += 1;
        for i in 0..self.nodes.len() {
            if matches!(self.liveness[i].0, Liveness::Up) {
                self.pass(NodeId::from_index(i), Ticks(1))?;
            }
        }
        self.arrivals()
    }

    fn arrivals(&mut self) -> Result<(), String> {
        let now = self.between.now;
        for flight in std::mem::take(&mut self.between.flying) {
            match self.liveness[flight.to.index()].0 {
                Liveness::Down if flight.due <= now => {}
                Liveness::Up if flight.due <= now => {
                    let charge = Ticks(flight.bound.max(now - flight.left));
                    let Flight { from, packet, .. } = flight;
                    self.input(flight.to, NodeInput::Packet { from, packet, charge })?;
                }
                Liveness::Up | Liveness::Down | Liveness::Stopped(_) => self.between.flying.push(flight),
            }
        }
        Ok(())
    }

    /// Starts the node's next incarnation. The other nodes notice the restart at once, or not at all if `unnoticed`.
    fn restart(&mut self, node: NodeId, unnoticed: bool) -> Result<(), String> {
        let (state, count) = &mut self.liveness[node.index()];
        (*state, *count) = (Liveness::Up, *count + 1);
        let table = NodeTable::new(Arc::clone(&self.between.table), node);
        self.got.retain(|got| table.location(got.task) != Some(node));
        self.nodes[node.index()] = Node::new(table, Incarnation(*count), true, self.transit);
        for i in (0..self.nodes.len()).filter(|&i| i != node.index() && !unnoticed) {
            if matches!(self.liveness[i].0, Liveness::Up) {
                self.input(NodeId::from_index(i), NodeInput::PeerRestarted(node))?;
            }
        }
        Ok(())
    }

    /// Resumes a suspended process. All the time of the suspension passes at once, and then the node reads its sockets.
    fn go_on(&mut self, node: NodeId) -> Result<(), String> {
        let Liveness::Stopped(since) = self.liveness[node.index()].0 else {
            return Err("it does not stand still".into());
        };
        self.liveness[node.index()].0 = Liveness::Up;
        self.pass(node, Ticks(self.between.now - since))?;
        self.arrivals()
    }

    fn ask(&mut self, task: TaskId, ask: &Ask) -> Result<(), String> {
        match ask {
            Ask::Plain(request) => self.request(task, *request),
            Ask::Send { port, to, contents, time_out } => {
                let to = self.target(*port, to)?;
                let Some(first) = self.parts(task, *port, contents)? else { return Ok(()) };
                self.request(task, Request::Send { port: *port, to, contents: first, time_out: *time_out })
            }
            Ask::Reply { through, to, of, contents } => {
                let place = self.place_of(of.unwrap_or(task), *through, *to, of.is_some())?;
                let mut name = self.got[place].from;
                if of.is_some() {
                    name.port = through.ok_or("which `reply` port?")?;
                }
                let Some(first) = self.parts(task, name.port, contents)? else { return Ok(()) };
                self.request(task, Request::Reply { to: name, contents: first })?;
                self.got[place].answered |= !self.has_faults();
                Ok(())
            }
        }
    }

    /// Whether a request in this step was answered with a fault.
    fn has_faults(&self) -> bool {
        self.between.seen.iter().any(|seen| seen.text.contains("<- fault"))
    }

    /// The target of a send request: all tasks at the other end of the port, one, or some of them.
    fn target(&self, port: PortId, to: &[TaskId]) -> Result<Target, String> {
        let port = self.between.table.port(port).ok_or("no such port")?;
        Ok(match *to {
            [] => Target::All,
            [one] => Target::One(one),
            _ => {
                let parties = to.iter().map(|&task| port.party_index(task).ok_or("a task without that port"));
                let bits: Result<Vec<usize>, _> = parties.collect();
                Target::Some(bits?.into_iter().fold(0, |bits, party| bits | 1 << party))
            }
        })
    }

    /// The message that a reply answers: the latest message without an answer. If all are answered, it is the latest one.
    fn place_of(
        &self,
        receiver: TaskId,
        port: Option<PortId>,
        source: Option<TaskId>,
        third: bool,
    ) -> Result<usize, String> {
        let fits = |(_, got): &(usize, &Got)| {
            got.task == receiver
                && (third || port.is_none_or(|port| port == got.from.port))
                && source.is_none_or(|source| source == got.from.source)
        };
        let fitting = || self.got.iter().enumerate().rev().filter(fits);
        let open = fitting().find(|(_, got)| !got.answered).or_else(|| fitting().next());
        open.map(|(place, _)| place).ok_or_else(|| "there is no such message to answer".into())
    }

    /// Stages all fragments of a message except the first. Returns the first; `None` if the task refused a fragment with a fault.
    fn parts(&mut self, task: TaskId, port: PortId, contents: &[u8]) -> Result<Option<Contents>, String> {
        let mut parts =
            contents.chunks(CONTENTS_BYTES).map(|part| Contents::new(part).expect("short enough"));
        let first = parts.next().unwrap_or(Contents::EMPTY);
        for (i, contents) in parts.enumerate() {
            let index = u8::try_from(i + 1).map_err(|_| "too long")?;
            self.request(task, Request::Part { port, index, contents })?;
            if self.has_faults() {
                return Ok(None);
            }
        }
        Ok(Some(first))
    }

    fn request(&mut self, task: TaskId, request: Request) -> Result<(), String> {
        let node = self.between.table.location(task).ok_or("the task runs nowhere")?;
        if !matches!(self.liveness[node.index()].0, Liveness::Up) {
            return Err(format!("{} does not run", Names(&self.between.table).task(task)));
        }
        let before = self.between.seen.len();
        self.input(node, NodeInput::Request(task, request))?;
        // The answer `accepted` to these requests is not shown, because without a fault no other answer is possible.
        let quiet = matches!(
            request,
            Request::Part { .. }
                | Request::Reply { .. }
                | Request::Order(_)
                | Request::Handle { .. }
                | Request::Start { .. }
                | Request::Stop { .. }
                | Request::Done
                | Request::Atomic(_)
                | Request::Publish(_)
        );
        if quiet {
            let who = format!("{} <- ", Names(&self.between.table).task(task));
            let accepted = format!("{who}accepted");
            let seen = &mut self.between.seen;
            match (before..seen.len()).find(|&i| seen[i].text == accepted) {
                Some(place) => drop(seen.remove(place)),
                None if seen[before..].iter().any(|s| s.text.starts_with(&who)) => {}
                None => self.between.see(format!("{who}no answer")),
            }
        }
        Ok(())
    }
}
