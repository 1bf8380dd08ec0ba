//! The scenarios of the protocol's claims.

use crate::scenario::{Behaviour, Budget, Reductions, Scenario, Timing, Watch};
use imrs_protocol::rules::Rules;
use imrs_protocol::{Cell, CellError, CellTable, NodeId, PortDecl, PortId, TaskId, Ticks, Usage};
use std::sync::Arc;

/// The names of members, for charts.
const NAMES: [&str; 5] = ["A", "B", "C", "D", "E"];

/// A rendezvous of interchangeable members, each on a node of its own, with a link between every two nodes.
#[derive(Clone, Debug)]
pub struct Meeting {
    /// The number of members.
    pub members: usize,
    /// The members' time_out in ticks; `None`: the members never give up.
    pub time_out: Option<u64>,
    /// The longest link delay in ticks; `None`: no time passes at all.
    pub delay: Option<u8>,
    /// The period of retransmissions in ticks; `None`: every packet is sent once (D55).
    pub resend: Option<u64>,
    /// How many lost packets a meeting must survive: the CONFIRM is sent that many times more (D55).
    pub losses: u8,
    /// The margin in ticks; `None`: the closed form.
    pub margin: Option<u64>,
    /// How often each member reaches the waitfor; `None`: without limit.
    pub attempts: Option<u8>,
    /// The faults that may happen.
    pub budget: Budget,
    /// Deviations of time that may happen.
    pub timing: Timing,
    /// The rules of the protocol.
    pub rules: Rules,
    /// The property that is checked.
    pub watch: Watch,
    /// Whether the members are eager: each reaches the waitfor as soon as it can.
    pub hurry: bool,
    /// The reductions that the search uses.
    pub reductions: Reductions,
}

impl Meeting {
    /// A meeting of `members` under the default rules, without time and faults.
    #[must_use]
    pub const fn new(members: usize, watch: Watch) -> Self {
        Self {
            members,
            time_out: None,
            delay: None,
            resend: None,
            losses: 0,
            margin: Some(0),
            attempts: Some(1),
            budget: Budget { loss: 0, dup: 0, crash: 0 },
            timing: Timing { overcharge: 0, late: 0 },
            rules: Rules::DEFAULT,
            watch,
            hurry: false,
            reductions: Reductions::ALL,
        }
    }

    /// The scenario of this meeting.
    ///
    /// # Errors
    /// What is wrong with the declaration: for example, the margin leaves no time for a release.
    pub fn scenario(&self) -> Result<Arc<Scenario>, Vec<CellError>> {
        let tick = Ticks(1);
        let mut cell = mesh(self.members, u64::from(self.delay.unwrap_or(0)), tick);
        cell.rules = self.rules;
        let users: Vec<TaskId> = (1..self.members).map(TaskId::from_index).collect();
        let time_out = self.time_out.map_or(Ticks::FAR, Ticks);
        let mut port = PortDecl::new("meet", TaskId(0), Usage::Waitfor, &users, time_out);
        port = port.resend(self.resend.map_or(Ticks::FAR, Ticks), self.losses);
        port.margin = self.margin.map(Ticks);
        cell.port(port);
        let behaviour = Behaviour::Member { port: PortId(0), attempts: self.attempts };
        Ok(Arc::new(Scenario {
            cell: Arc::new(CellTable::new(cell)?),
            behaviours: vec![behaviour; self.members],
            delay: self.delay,
            budget: self.budget,
            timing: self.timing,
            wrap: None,
            watch: self.watch,
            hurry: self.hurry,
            clocks: vec![0; self.members],
            reductions: self.reductions,
        }))
    }
}

/// One sender and one receiver, each on a node of its own.
#[derive(Clone, Debug)]
pub struct Exchange {
    /// Whether the messages are commands (class 2). If not, they are statuses (class 1).
    pub command: bool,
    /// The TTL of each message in ticks.
    pub time_out: u64,
    /// The longest link delay in ticks.
    pub delay: u8,
    /// How often a command is retransmitted, and the period of retransmission in ticks.
    pub retry: (u8, u64),
    /// The value of `bounded_buffer`: how many messages the port's buffer holds.
    pub buffer: u16,
    /// How many messages are sent.
    pub sends: u8,
    /// The faults that may happen.
    pub budget: Budget,
    /// Deviations of time that may happen.
    pub timing: Timing,
    /// The rules of the protocol.
    pub rules: Rules,
    /// The property that is checked.
    pub watch: Watch,
    /// How many ticks ahead the clocks of the sender's and the receiver's node are.
    pub clocks: (u64, u64),
    /// For a variant of the rules: after how many messages sequence numbers wrap; `None`: they do not wrap.
    pub wrap: Option<u8>,
}

impl Exchange {
    /// An exchange of commands under the default rules, without faults.
    #[must_use]
    pub const fn new(watch: Watch) -> Self {
        Self {
            command: true,
            time_out: 6,
            delay: 1,
            retry: (0, 0),
            buffer: 1,
            sends: 2,
            budget: Budget { loss: 0, dup: 0, crash: 0 },
            timing: Timing { overcharge: 0, late: 0 },
            rules: Rules::DEFAULT,
            watch,
            clocks: (0, 0),
            wrap: None,
        }
    }

    /// The scenario of this exchange.
    ///
    /// # Errors
    /// The errors of the cell's declaration.
    pub fn scenario(&self) -> Result<Arc<Scenario>, Vec<CellError>> {
        let mut cell = mesh(2, u64::from(self.delay), Ticks(1));
        cell.rules = self.rules;
        let mut port = PortDecl::new("ask", TaskId(0), Usage::Send, &[TaskId(1)], Ticks(self.time_out));
        port = port.bounded_buffer(self.buffer);
        if self.command {
            port = port.command().retry(self.retry.0, Ticks(self.retry.1));
        }
        cell.port(port);
        Ok(Arc::new(Scenario {
            cell: Arc::new(CellTable::new(cell)?),
            behaviours: vec![Behaviour::Sender { port: PortId(0), sends: self.sends }, Behaviour::Receiver],
            delay: Some(self.delay),
            budget: self.budget,
            timing: self.timing,
            wrap: self.wrap,
            watch: self.watch,
            hurry: false,
            clocks: vec![self.clocks.0, self.clocks.1],
            reductions: Reductions::ALL,
        }))
    }
}

fn mesh(n: usize, delay: u64, tick: Ticks) -> Cell {
    let mut cell = Cell::new("world", tick);
    for (i, name) in NAMES.iter().enumerate().take(n) {
        let node = cell.node(&format!("n{name}"));
        cell.task(name, node);
        for other in 0..i {
            cell.link(NodeId::from_index(other), node, Ticks(delay));
        }
    }
    cell
}
