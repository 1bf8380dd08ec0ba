//! Random cells.

use imrs_protocol::rules::{Aging, Confirmation, Memory};
use imrs_protocol::*;
use proptest::prelude::*;
use std::sync::Arc;

/// The numbers from which a random cell is built.
#[derive(Clone, Debug)]
pub struct Plan {
    tasks: u16,
    nodes: u16,
    delay: u64,
    ports: Vec<[u8; 6]>,
    rules: [u8; 4],
    /// Whether the first two tasks are work-coupled, and in which way.
    couple: u8,
}

/// Random cells of 1 to 4 tasks on 1 to 3 nodes; a third of them run variants of the rules, a quarter of them have a couple.
pub fn plans() -> impl Strategy<Value = Plan> {
    let ports = proptest::collection::vec(any::<[u8; 6]>(), 1..5);
    let rules = prop_oneof![2 => Just([0; 4]), 1 => any::<[u8; 4]>()];
    let all = (1..=4_u16, 1..=3_u16, 1..=3_u64, ports, rules, any::<u8>());
    all.prop_map(|(tasks, nodes, delay, ports, rules, couple)| Plan {
        tasks,
        nodes,
        delay,
        ports,
        rules,
        couple,
    })
}

impl Plan {
    /// Makes a plan of a cell from any numbers.
    pub fn new([tasks, nodes, delay]: [u8; 3], ports: Vec<[u8; 6]>, rules: [u8; 4], couple: u8) -> Self {
        let within = |n: u8, most: u8| 1 + n % most;
        let (tasks, nodes) = (u16::from(within(tasks, 4)), u16::from(within(nodes, 3)));
        Self { tasks, nodes, delay: u64::from(within(delay, 3)), ports, rules, couple }
    }

    /// The same plan, but with at least two tasks, of which the first two are work-coupled.
    pub fn coupled(self) -> Self {
        Self { tasks: self.tasks.max(2), couple: self.couple | 3, ..self }
    }

    pub fn build(&self) -> Arc<CellTable> {
        let mut cell = Cell::new("random", Ticks(1));
        for i in 0..self.nodes {
            let node = cell.node(&format!("n{i}"));
            if i > 0 {
                cell.link(NodeId(i - 1), node, Ticks(self.delay));
            }
        }
        for i in 0..self.tasks {
            cell.task(&format!("t{i}"), NodeId(i % self.nodes));
        }
        if self.is_coupled() {
            self.couple(&mut cell);
        }
        for (i, shape) in self.ports.iter().enumerate().filter(|_| self.tasks > 1) {
            let port = self.port(i, *shape);
            let of_the_couple = |task: &TaskId| task.0 < 2;
            let senders = if port.usage == Usage::Send {
                vec![port.owner]
            } else {
                port.users.iter().map(|user| user.task).collect()
            };
            let guarded = self.is_coupled()
                && matches!(port.usage, Usage::Send | Usage::Receive)
                && port.fragments == 1
                && senders.iter().all(of_the_couple);
            cell.port(if guarded { port.guard(0) } else { port });
        }
        cell.rules = self.rules();
        Arc::new(CellTable::new(cell).expect("the plan fits"))
    }

    fn is_coupled(&self) -> bool {
        self.couple & 3 == 3 && self.tasks > 1
    }

    /// Adds a couple with short times, so that leases end and are taken over while the operations last.
    fn couple(&self, cell: &mut Cell) {
        let (primary, standby) = (TaskId(0), TaskId(1));
        let via = cell.port(PortDecl::new("alive", primary, Usage::Response, &[standby], Ticks(14)));
        let more = u64::from(self.couple >> 4);
        cell.couples.push(CoupleDecl {
            primary,
            standby,
            lease: Ticks(16 + more),
            takeover: Ticks(18 + more),
            every: Ticks(4),
            via,
            trusted: true,
            mutual: self.couple & 4 != 0,
        });
    }

    fn port(&self, i: usize, [kind, owner, users, buffer, time_out, resend]: [u8; 6]) -> PortDecl {
        let owner = u16::from(owner) % self.tasks;
        let others: Vec<TaskId> = (0..self.tasks).filter(|&t| t != owner).map(TaskId).collect();
        let picked = |n: usize| users & (1 << n) != 0;
        let mut list: Vec<TaskId> =
            others.iter().enumerate().filter(|&(n, _)| picked(n)).map(|(_, &t)| t).collect();
        if list.is_empty() {
            list = others;
        }
        let usage = [
            Usage::Send,
            Usage::Receive,
            Usage::Send,
            Usage::Receive,
            Usage::Waitfor,
            Usage::Waitfor,
            Usage::Query,
            Usage::Response,
            Usage::Send,
            Usage::Reply,
        ][usize::from(kind) % 10];
        let time_out = Ticks(60 + u64::from(time_out) % 30);
        let port = PortDecl::new(&format!("p{i}"), TaskId(owner), usage, &list, time_out);
        let every = Ticks(3 + u64::from(resend) % 6);
        let mut port = port.bounded_buffer(1 + u16::from(buffer) % 3);
        if buffer & 0x40 != 0 {
            let length = Ticks(1 + u64::from(buffer / 16));
            port.penalty = Some(Penalty { length, literal: buffer & 0x30 == 0x30 });
        }
        port.latest = buffer & 0x0c == 0x0c;
        match kind % 10 {
            0 | 1 => port,
            2 | 3 | 6 | 7 => port.command().retry(resend / 64, every),
            4 | 5 => port.resend(every, resend / 86),
            8 if resend & 1 == 0 => port.fragments(3, 1),
            _ => port.command().retry(resend / 128, every).fragments(1 + resend % 4, 1 + resend / 4 % 3),
        }
    }

    fn rules(&self) -> Rules {
        if self.rules == [0; 4] {
            return Rules::DEFAULT;
        }
        let bit = |n: u8| self.rules[0] & (1 << n) != 0;
        Rules {
            confirmation: [
                Confirmation::None,
                Confirmation::FirstComplete,
                Confirmation::EveryComplete,
                Confirmation::PassOn,
            ][usize::from(self.rules[1] % 4)],
            rounds: bit(0),
            last_released: bit(1),
            answer_late_arrivals: bit(2),
            aborts: bit(3),
            charge_residence: bit(4),
            refuse_late_replies: bit(5),
            reserve_way_back: bit(6),
            memory: [Memory::TtlAndLink, Memory::UntilAnswered, Memory::None][usize::from(self.rules[2] % 3)],
            quarantine: bit(7),
            aging: [Aging::Bounded, Aging::Off, Aging::Unbounded][usize::from(self.rules[3] % 3)],
            obey_order: self.rules[3] & 0x40 != 0,
            ..Rules::DEFAULT
        }
    }
}
