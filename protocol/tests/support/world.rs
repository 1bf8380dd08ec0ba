//! A random cell, its communication tasks and the packets between them, driven by random operations. Packets arrive in
//! any order, late, twice or never. Two worlds that run the same operations are compared output by output.

use super::Effects;
use super::shift::Shift;
use imrs_protocol::*;
use proptest::prelude::*;
use std::sync::Arc;

/// One random operation. Its meaning depends only on the state of the world that takes it.
pub type Op = (u8, u8, u16, u16);

pub fn ops() -> impl Strategy<Value = Vec<Op>> {
    proptest::collection::vec(any::<Op>(), 1..120)
}

/// Operations that are mostly passing time and arriving packets, so that leases are granted, end and are taken over.
pub fn lively() -> impl Strategy<Value = Vec<Op>> {
    let what = prop_oneof![3 => 0..2_u8, 6 => 2..8_u8, 2 => any::<u8>()];
    proptest::collection::vec((what, any::<u8>(), any::<u16>(), any::<u16>()), 20..240)
}

/// The communication tasks of a cell, and the packets between them.
#[derive(Clone)]
pub struct World {
    pub tables: Vec<NodeTable>,
    pub tasks: Vec<CommTask>,
    pub flying: Vec<Packet>,
    /// The commands that each task received.
    got: Vec<Vec<ReplyTo>>,
    incarnations: Vec<u8>,
    /// For each task, the latest start of each of its delays and timers.
    pub turns: Vec<Vec<(TimeId, u8)>>,
    /// By how much the ids of this world differ from those of a world without a shift.
    pub shift: Shift,
    /// Whether nodes restart and packets of other incarnations appear.
    pub restarts: bool,
    /// How many ticks pass before each input that is not time itself.
    pub lag: u64,
    /// Whether these ticks pass in a separate time input, before the input itself.
    pub splits: bool,
    /// Whether every deadline is checked after time has passed, due or not.
    pub looks_around: bool,
    /// The time of the next input, if all clocks run alike. A packet in flight then has its deadline in place of its
    /// remaining time. If this is empty, each task has a clock of its own.
    pub at: Option<Instant>,
}

impl World {
    pub fn new(table: &Arc<CellTable>, restarts: bool) -> Self {
        let tasks = table.cell().tasks.len();
        let locate =
            |t| NodeTable::new(Arc::clone(table), table.location(TaskId::from_index(t)).expect("located"));
        let tables: Vec<NodeTable> = (0..tasks).map(locate).collect();
        let new = |(t, table)| CommTask::new(table, TaskId::from_index(t), Incarnation(0), false);
        Self {
            tasks: tables.iter().enumerate().map(new).collect(),
            tables,
            flying: Vec::new(),
            got: vec![Vec::new(); tasks],
            incarnations: vec![0; table.cell().nodes.len()],
            turns: vec![Vec::new(); tasks],
            shift: Shift::none(table),
            restarts,
            lag: 0,
            splits: false,
            looks_around: false,
            at: None,
        }
    }

    /// Sets all clocks back to zero.
    pub fn rebase(&mut self) {
        self.tasks.iter_mut().zip(&self.tables).for_each(|(task, table)| task.rebase(table));
    }

    /// This world with all its ids shifted.
    pub fn moved(mut self, shift: Shift) -> Self {
        for (task, table) in self.tasks.iter_mut().zip(&self.tables) {
            task.walk(table, &mut &shift);
        }
        self.flying = self.flying.iter().map(|p| shift.packet(p)).collect();
        for to in self.got.iter_mut().flatten() {
            to.id = shift.id(to.source, to.id);
        }
        self.shift = shift;
        self
    }

    /// Carries out one operation and returns its effects; the packets among them are then in flight.
    pub fn step(&mut self, op: Op) -> Effects {
        let (what, which, a, b) = op;
        let task = usize::from(which) % self.tasks.len();
        match what % 16 {
            0 | 1 => self.pass(task, u64::from(a % 12)),
            2..=7 => self.deliver(a, b),
            8..=10 => self.input(task, Input::Request(self.request(task, a, b))),
            11 => self.answer(task, a, b),
            12 => self.pass(task, u64::from(a % 90)),
            13 => self.input(task, Input::Request(odd_request(a, b))),
            14 => self.forged(a, b),
            _ => self.event(task, a, b),
        }
    }

    pub fn input(&mut self, task: usize, input: Input) -> Effects {
        self.input_after(self.lag, task, input)
    }

    /// Lets `ticks` pass for one task.
    pub fn pass(&mut self, task: usize, ticks: u64) -> Effects {
        self.input_after(ticks, task, Input::Time)
    }

    /// Gives a task an input, `ticks` after its last one.
    fn input_after(&mut self, ticks: u64, task: usize, input: Input) -> Effects {
        let mut out = Effects::default();
        let now = self.at.unwrap_or_else(|| self.tasks[task].now() + Ticks(ticks));
        let most = if ticks > 0 || self.at.is_some() { 2 } else { 1 };
        let passes = ticks > 0 || self.at.is_some() || matches!(input, Input::Time);
        if passes && (self.splits || self.looks_around) {
            self.tasks[task].handle(&self.tables[task], now, &Input::Time, &mut out);
        }
        if passes && self.looks_around {
            // This call must have no effect, because everything that is due has just happened.
            self.tasks[task].look_around(&self.tables[task], &mut out);
        }
        self.tasks[task].handle(&self.tables[task], now, &input, &mut out);
        if let Err(violation) = invariants::check(&self.tasks[task], &self.tables[task]) {
            panic!("T{task} after {input:?}: {violation}");
        }
        assert!(out.signals.len() <= most, "T{task} gets {:?} for {input:?}", out.signals);
        self.flying.extend(&out.packets);
        if let Some(now) = self.at {
            let left = self.flying.iter_mut().rev().take(out.packets.len());
            left.for_each(|packet| packet.remaining += now - Instant::START);
        }
        for &(id, turn) in &out.turns {
            self.turns[task].retain(|t| t.0 != id);
            self.turns[task].push((id, turn));
        }
        for s in &out.signals {
            if let Signal::Message(d) | Signal::Interrupt(Call::Message(d)) = s
                && d.class == Class::Command
            {
                self.got[task].push(d.from);
            }
        }
        out
    }

    fn deliver(&mut self, a: u16, b: u16) -> Effects {
        if self.flying.is_empty() {
            return Effects::default();
        }
        let at = usize::from(a) % self.flying.len();
        let mut packet = self.flying[at];
        if !b.is_multiple_of(4) {
            self.flying.remove(at);
        }
        if b % 16 == 15 {
            return Effects::default();
        }
        if let Some(now) = self.at {
            packet.remaining = packet.remaining - (now - Instant::START);
            return self.hear(packet, 0);
        }
        self.hear(packet, u64::from(b / 16 % 5))
    }

    /// Hands a packet to its destination, as a node does.
    pub fn hear(&mut self, packet: Packet, charge: u64) -> Effects {
        let Some(table) = self.tables.get(packet.destination.index()) else { return Effects::default() };
        match route::arrived(table, super::neighbour_before(table, &packet), packet, Ticks(charge)) {
            route::Arrival::Local(task, packet) => self.input(task.index(), Input::Packet(packet)),
            route::Arrival::Relay(_) | route::Arrival::Discard(..) => Effects::default(),
        }
    }

    /// A request that fits the cell.
    pub fn request(&self, task: usize, a: u16, b: u16) -> Request {
        let table = &self.tables[task];
        let own = table.ports_of(TaskId::from_index(task));
        if own.is_empty() {
            return Request::Delay { id: TimeId(0), length: Ticks(u64::from(a)) };
        }
        let port = table.port(own[usize::from(a) % own.len()]).expect("an own port");
        let me = TaskId::from_index(task);
        let time_out = (b & 0x300 == 0).then(|| Ticks(u64::from(b % 70)));
        match port.party(me).expect("a party").usage {
            Usage::Receive if port.decl.usage == Usage::Reply => Request::Boundary,
            Usage::Reply => self.third_party(port, a, b),
            Usage::Send | Usage::Query => {
                let peers: Vec<TaskId> = port.peers(me).collect();
                let contents = Contents::new(&a.to_le_bytes()).expect("short");
                if port.decl.fragments > 1 && b & 0x1800 == 0 {
                    let index = u8::try_from(1 + b % 3).expect("small");
                    return Request::Part { port: port.id, index, contents };
                }
                let to = Target::One(peers[usize::from(a / 8) % peers.len()]);
                let some = Target::Some(u64::from(b & 0xf));
                let to = if b & 0x400 != 0 { [Target::All, some][usize::from(a & 1)] } else { to };
                Request::Send { port: port.id, to, contents, time_out }
            }
            Usage::Receive | Usage::Response => {
                if b & 0x6000 == 0 {
                    return Request::Handle { port: port.id, handled: b & 0x70 != 0 };
                }
                let source = (b & 0x800 != 0).then_some(TaskId(a % 4));
                Request::Get { port: (b & 0x1000 != 0).then_some(port.id), source, time_out }
            }
            Usage::Waitfor => {
                let arguments = u64::from(a).to_le_bytes();
                Request::Arrive { port: port.id, arguments, time_out }
            }
        }
    }

    /// A request for a third-party reply to any request in flight.
    fn third_party(&self, port: &Port, a: u16, b: u16) -> Request {
        let asked =
            self.flying.iter().filter(|p| matches!(p.kind, Kind::Send | Kind::Query)).nth(usize::from(a) % 4);
        let Some(&Packet { source, id, .. }) = asked else { return Request::Boundary };
        let contents = Contents::new(&b.to_le_bytes()).expect("short");
        Request::Reply { to: ReplyTo { port: port.id, source, id }, contents }
    }

    fn answer(&mut self, task: usize, a: u16, b: u16) -> Effects {
        let got = &self.got[task];
        // Usually this picks the latest request, sometimes an earlier one.
        let back = if b.is_multiple_of(4) { usize::from(a) } else { 0 };
        let Some(&to) = got.iter().rev().cycle().nth(back % got.len().max(1)) else {
            return Effects::default();
        };
        let contents = Contents::new(&b.to_le_bytes()).expect("short");
        let fragments = self.tables[task].port(to.port).map_or(1, |port| port.decl.answer_fragments);
        if fragments > 1 && b & 0x40 != 0 {
            return self.input(task, Input::Request(Request::Part { port: to.port, index: 1, contents }));
        }
        self.input(task, Input::Request(Request::Reply { to, contents }))
    }

    /// Delivers a forged packet with a valid checksum.
    fn forged(&mut self, a: u16, b: u16) -> Effects {
        let mut bytes = [0; PACKET_BYTES];
        let mut seed = (u64::from(a) << 16 | u64::from(b)).wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        for byte in &mut bytes {
            seed ^= seed << 13;
            seed ^= seed >> 7;
            seed ^= seed << 17;
            *byte = seed.to_le_bytes()[3];
        }
        let port = PortId(u16::from(bytes[6]) % 4);
        let near =
            |byte: u8| if byte & 3 == 0 { u16::from(byte).wrapping_sub(40) } else { u16::from(byte & 3) };
        let (round, released) = (near(bytes[16]), near(bytes[18]));
        bytes[16..18].copy_from_slice(&round.to_le_bytes());
        bytes[18..20].copy_from_slice(&released.to_le_bytes());
        let packet = Packet {
            kind: [
                Kind::Send,
                Kind::Reply,
                Kind::Control,
                Kind::Arrive,
                Kind::Confirm,
                Kind::Abort,
                Kind::Query,
                Kind::Response,
            ][usize::from(bytes[0]) % 8],
            class: if bytes[1] & 1 == 0 { Class::Command } else { Class::Status },
            more: bytes[3] & 7 == 0,
            resent: bytes[1] & 2 != 0,
            hops: 7,
            fragment: if bytes[3] & 0x38 == 0 { bytes[3] >> 6 } else { 0 },
            destination: TaskId(u16::from(bytes[2] % 4)),
            source: TaskId(u16::from(bytes[4] % 4)),
            port,
            id: MessageId {
                incarnation: Incarnation(if self.restarts { bytes[8] % 3 } else { 0 }),
                sequence: Seq24::new(u32::from(near(bytes[9]))),
            },
            remaining: Ticks(u64::from(bytes[12] % 90)),
            contents: Contents::new(&bytes[16..16 + usize::from(bytes[13] % 13)]).expect("short"),
            seal: Seal::NONE,
        };
        self.hear(self.shift.packet(&packet), 0)
    }

    fn event(&mut self, task: usize, a: u16, b: u16) -> Effects {
        let node = usize::from(b) % self.incarnations.len();
        match a % 4 {
            0 => self.time_out(task, b),
            1 => match self.tasks[task].awaits() {
                Some((_, id)) => self.input(task, Input::Unsent(id)),
                None => Effects::default(),
            },
            2 => self.input(task, Input::PeerRestarted(NodeId::from_index(node))),
            _ if self.restarts && a & 0x1c == 0 => self.restart(node),
            _ => Effects::default(),
        }
    }

    /// Reports the end of one of the task's delays and timers, or of one that was stopped or never started.
    fn time_out(&mut self, task: usize, b: u16) -> Effects {
        let id = TimeId(u8::try_from(b % 3).expect("small"));
        let turn = self.turns[task].iter().rev().find(|t| t.0 == id).map_or(0, |t| t.1);
        self.input(task, Input::TimeOut { id, turn })
    }

    /// Starts the next incarnation of a node, whose tasks know nothing of the previous incarnation.
    fn restart(&mut self, node: usize) -> Effects {
        self.incarnations[node] += 1;
        for (t, table) in self.tables.iter().enumerate().filter(|(_, table)| table.node.index() == node) {
            let mut task =
                CommTask::new(table, TaskId::from_index(t), Incarnation(self.incarnations[node]), true);
            task.walk(table, &mut &self.shift);
            self.tasks[t] = task;
            self.got[t].clear();
        }
        Effects::default()
    }

    /// The numbers from which packed ids are counted: for each port the shift of its rounds (zero in a world without a
    /// shift), and for each source its next sequence number.
    pub fn frame(&self) -> (Vec<Round>, Vec<Seq24>) {
        let next = self.tasks.iter().map(CommTask::next_sequence);
        (self.shift.rounds.iter().map(|&r| Round(r)).collect(), next.collect())
    }

    /// The canonical bytes of one task, after dead state is dropped.
    pub fn bytes(&self, task: usize) -> Result<Vec<u8>, Overflow> {
        let (rounds, sequences) = self.frame();
        let frame = Frame { rounds: &rounds, sequences: &sequences, incarnations: self.restarts };
        let mut task_now = self.tasks[task].clone();
        task_now.walk(&self.tables[task], &mut &self.shift.epochs_back());
        task_now.bury();
        Encode::bytes(&frame, |w| task_now.walk(&self.tables[task], w))
    }
}

/// A request that does not fit the cell, or a request that fits any cell.
fn odd_request(a: u16, b: u16) -> Request {
    let port = PortId(a % 5);
    let id = TimeId(u8::try_from(a % 3).expect("small"));
    let length = Ticks(u64::from(a));
    let contents = Contents::EMPTY;
    match b % 23 {
        0 => Request::Cancel,
        1 | 2 => Request::Order(order(a)),
        3 => Request::Delay { id, length },
        4 => Request::Send { port, to: Target::All, contents, time_out: None },
        5 => Request::Send { port, to: Target::One(TaskId(a / 8 % 5)), contents, time_out: None },
        6 => Request::Arrive { port, arguments: [0; 8], time_out: Some(Ticks::ZERO) },
        7 | 8 => Request::Boundary,
        9 => Request::Work,
        10 => Request::Done,
        11..=13 => Request::Return,
        14 => Request::Atomic(a & 3 == 0),
        15 => Request::Start { id, length },
        16 if a & 1 == 0 => Request::Stop { id },
        16 => Request::Abandon,
        17 => Request::Handle { port, handled: a & 8 != 0 },
        20 => Request::Lease,
        21 => Request::Publish(Contents::new(&a.to_le_bytes()).expect("short")),
        22 => Request::End,
        18 => Request::Part { port, index: u8::try_from(a % 5).expect("small"), contents },
        _ => Request::Get { port: Some(port), source: None, time_out: Some(Ticks(u64::from(a % 9))) },
    }
}

fn order(a: u16) -> ServiceOrder {
    let named = [
        Ranked::Port(PortId(a % 3)),
        Ranked::Own,
        Ranked::Source(TaskId(a / 8 % 3)),
        if a & 512 == 0 { Ranked::Timers } else { Ranked::Timer(TimeId(1)) },
        Ranked::Port(PortId(a / 32 % 3)),
    ];
    let skip = usize::from(a / 128 % 4);
    ServiceOrder::new(&named[skip.min(2)..]).expect("few levels")
}
