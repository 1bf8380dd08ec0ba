//! A shift of all numbers that are only compared with each other. A shift must not change the behaviour of a world.

use super::Effects;
use imrs_protocol::*;

/// How far the ids of each source, the rounds of each port and the epochs of all couples are shifted.
#[derive(Clone, Debug, Default)]
pub struct Shift {
    pub sequences: Vec<u32>,
    pub rounds: Vec<u16>,
    /// The shift of the epochs, which is even because the epochs of a primary are odd.
    pub epochs: u8,
    /// For each port, the place at which its packets carry an epoch.
    pub places: Vec<EpochAt>,
}

/// The place at which packets of a port carry an epoch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EpochAt {
    Nowhere,
    /// Packets of the port are heartbeats of a couple and their answers, which carry an epoch.
    Heartbeats,
    /// Packets of the port are orders; their last byte is the epoch.
    Orders,
}

impl EpochAt {
    fn of(table: &CellTable, port: &Port) -> Self {
        if table.cell().couples.iter().any(|couple| couple.via == port.id) {
            Self::Heartbeats
        } else if port.decl.guard.is_some() {
            Self::Orders
        } else {
            Self::Nowhere
        }
    }

    fn within(self, packet: &Packet) -> Option<usize> {
        let len = packet.contents.as_bytes().len();
        let at = match (self, packet.kind) {
            (Self::Heartbeats, Kind::Query) => Some(2),
            (Self::Heartbeats, Kind::Response) => Some(1),
            (Self::Orders, Kind::Send) => len.checked_sub(1),
            _ => None,
        };
        at.filter(|&at| at < len)
    }
}

impl Walk for &Shift {
    const PASS: Pass = Pass::Change;

    fn round(&mut self, port: PortId, round: &mut Round) {
        *round = round.plus(self.rounds[port.index()]);
    }
    fn sequence(&mut self, source: TaskId, sequence: &mut Seq24) {
        *sequence = sequence.plus(self.sequences[source.index()]);
    }
    fn epoch(&mut self, _: u8, epoch: &mut u8) {
        *epoch = epoch.wrapping_add(self.epochs);
    }
}

impl Shift {
    pub fn none(table: &CellTable) -> Self {
        Self {
            sequences: vec![0; table.cell().tasks.len()],
            rounds: vec![0; table.ports().len()],
            epochs: 0,
            places: table.ports().iter().map(|port| EpochAt::of(table, port)).collect(),
        }
    }

    pub fn back(&self) -> Self {
        let sequences = self.sequences.iter().map(|s| Seq24::MODULUS - s % Seq24::MODULUS).collect();
        let rounds = self.rounds.iter().map(|r| r.wrapping_neg()).collect();
        Self { sequences, rounds, epochs: self.epochs.wrapping_neg(), places: self.places.clone() }
    }

    /// The shift that moves only the epochs back: packed states hold epochs as they are.
    pub fn epochs_back(&self) -> Self {
        let (sequences, rounds) = (vec![0; self.sequences.len()], vec![0; self.rounds.len()]);
        Self { sequences, rounds, ..self.back() }
    }

    pub fn id(&self, source: TaskId, id: MessageId) -> MessageId {
        let by = self.sequences.get(source.index()).copied().unwrap_or(0);
        MessageId { sequence: id.sequence.plus(by), ..id }
    }

    pub fn packet(&self, p: &Packet) -> Packet {
        let mut moved = *p;
        match p.kind {
            Kind::Arrive | Kind::Confirm | Kind::Abort => {
                let by = self.rounds.get(p.port.index()).copied().unwrap_or(0);
                let mut meeting = p.meeting();
                if p.kind == Kind::Abort {
                    meeting.arguments = Meeting::abort_arguments(meeting.next_round().plus(by));
                }
                meeting.round = meeting.round.plus(by);
                meeting.released = meeting.released.plus(by);
                moved.contents = meeting.to_contents();
            }
            Kind::Send | Kind::Query => moved.id = self.id(p.source, p.id),
            // An answer carries the id of the request that it answers.
            Kind::Reply | Kind::Response | Kind::Control => moved.id = self.id(p.destination, p.id),
        }
        if let Some(at) = self.places.get(p.port.index()).and_then(|place| place.within(p)) {
            let mut bytes = p.contents.as_bytes().to_vec();
            bytes[at] = bytes[at].wrapping_add(self.epochs);
            moved.contents = Contents::new(&bytes).expect("as long as before");
        }
        moved
    }

    /// The effects with all ids shifted. Observations are left out, because their numbers may mean anything.
    pub fn effects(&self, effects: &Effects) -> Effects {
        let packets = effects.packets.iter().map(|p| self.packet(p)).collect();
        let signals = effects.signals.iter().map(|s| match *s {
            Signal::Message(d) => {
                let from = ReplyTo { id: self.id(d.from.source, d.from.id), ..d.from };
                Signal::Message(Delivery { from, ..d })
            }
            Signal::Interrupt(Call::Message(d)) => {
                let from = ReplyTo { id: self.id(d.from.source, d.from.id), ..d.from };
                Signal::Interrupt(Call::Message(Delivery { from, ..d }))
            }
            Signal::Released { port, round, by } => {
                Signal::Released { port, round: round.plus(self.rounds[port.index()]), by }
            }
            Signal::GaveUp { port, round, missing } => {
                Signal::GaveUp { port, round: round.plus(self.rounds[port.index()]), missing }
            }
            Signal::Granted(epoch) => Signal::Granted(epoch.wrapping_add(self.epochs)),
            Signal::Interrupt(Call::TakeOver(epoch)) => {
                Signal::Interrupt(Call::TakeOver(epoch.wrapping_add(self.epochs)))
            }
            other => other,
        });
        Effects { packets, signals: signals.collect(), timers: effects.timers.clone(), ..Effects::default() }
    }
}
