//! Reads a `cell` block of a page. Each line is a declaration, as in Figures 1 and 2 of the paper.
//!
//! ```text
//! node left, right
//! link left -- right delay 2
//! task A on left
//! port move: A sends to B, class 2, time_out 20, bounded_buffer 2, retry 1 every 5
//! ```

use super::tokens::Tokens;
use imrs_protocol::rules::{Aging, Confirmation, Eviction, LeaseRule, Memory};
use imrs_protocol::*;

/// The declared cell, and the size of its nodes' transit buffers.
#[derive(Clone, Debug)]
pub struct Declared {
    pub cell: Cell,
    pub transit: u16,
}

impl Default for Declared {
    fn default() -> Self {
        Self { cell: Cell::new("spec", Ticks(1)), transit: 16 }
    }
}

impl Declared {
    /// Reads one line of a `cell` block.
    pub fn line(&mut self, line: &str) -> Result<(), String> {
        let mut t = Tokens::new(line)?;
        if t.is_over() {
            return Ok(());
        }
        match t.word()?.as_str() {
            "tick" => self.cell.tick = Ticks(t.number()?),
            "transit_buffer" => self.transit = t.number()?,
            "node" => {
                for name in t.list("name", new_name)? {
                    self.cell.node(&name);
                }
            }
            "link" => self.link(&mut t)?,
            "task" => self.task(&mut t)?,
            "port" => self.port(&mut t)?,
            "couple" => self.couple(&mut t)?,
            "rule" => self.rule(&mut t)?,
            other => {
                return Err(format!(
                    "`{other}`: a cell has node, link, task, port, couple, rule, tick, transit_buffer"
                ));
            }
        }
        t.end()
    }

    /// The cell's table, or the faults for which the cell is rejected.
    pub fn table(&self) -> Result<CellTable, Vec<String>> {
        CellTable::new(self.cell.clone()).map_err(|faults| faults.iter().map(ToString::to_string).collect())
    }

    pub fn faults(&self) -> Vec<String> {
        self.table().err().unwrap_or_default()
    }

    fn link(&mut self, t: &mut Tokens) -> Result<(), String> {
        let a = t.named("node", |name| node(&self.cell, name))?;
        t.must("--")?;
        let b = t.named("node", |name| node(&self.cell, name))?;
        t.must("delay")?;
        self.cell.link(a, b, Ticks(t.number()?));
        Ok(())
    }

    fn task(&mut self, t: &mut Tokens) -> Result<(), String> {
        let names = t.list("name", new_name)?;
        t.must("on")?;
        let at = t.named("node", |name| node(&self.cell, name))?;
        let module = if t.eat("in") { Some(t.word()?) } else { None };
        for name in names {
            let id = self.cell.task(&name, at);
            self.cell.tasks[id.index()].module.clone_from(&module);
        }
        Ok(())
    }

    fn port(&mut self, t: &mut Tokens) -> Result<(), String> {
        let name = t.word()?;
        t.must(":")?;
        let find = |name: &str| task(&self.cell, name);
        let owner = t.named("task", find)?;
        let (usage, to) = match t.word()?.as_str() {
            "sends" => (Usage::Send, "to"),
            "receives" => (Usage::Receive, "from"),
            "queries" => (Usage::Query, ""),
            "responds" => (Usage::Response, "to"),
            "meets" => (Usage::Waitfor, ""),
            "replies" => (Usage::Reply, "to"),
            other => {
                return Err(format!(
                    "`{other}`: a task sends to, receives from, queries, responds to, meets or replies to others"
                ));
            }
        };
        if !to.is_empty() {
            t.must(to)?;
        }
        let mut modules = Vec::new();
        let users = if t.eat("module") {
            modules.push(t.word()?);
            Vec::new()
        } else {
            t.list("task", find)?
        };
        let mut port = PortDecl::new(&name, owner, usage, &users, Ticks::ZERO);
        port.modules = modules;
        while t.eat(",") {
            self.option(&mut port, t)?;
        }
        self.cell.port(port);
        Ok(())
    }

    fn option(&self, port: &mut PortDecl, t: &mut Tokens) -> Result<(), String> {
        match t.word()?.as_str() {
            "class" => {
                port.class = match t.number::<u8>()? {
                    1 => Class::Status,
                    2 => Class::Command,
                    other => return Err(format!("class {other}: there are 1 and 2")),
                };
            }
            "time_out" => {
                let length = Ticks(t.number()?);
                if t.eat("for") {
                    let who = t.named("task", |name| task(&self.cell, name))?;
                    let user = port.users.iter_mut().find(|user| user.task == who);
                    user.ok_or("only a user has a time_out of its own")?.time_out = Some(length);
                } else {
                    port.time_out = length;
                }
            }
            "bounded_buffer" => port.bounded_buffer = t.number()?,
            "retry" => {
                port.retry = t.number()?;
                t.must("every")?;
                port.resend = Ticks(t.number()?);
            }
            "resend" => {
                t.must("every")?;
                port.resend = Ticks(t.number()?);
            }
            "losses" => port.losses = t.number()?,
            "margin" => port.margin = Some(Ticks(t.number()?)),
            "penalty" => {
                let literal = t.eat("paper");
                port.penalty = Some(Penalty { length: Ticks(t.number()?), literal });
            }
            "latest" => port.latest = true,
            "fragments" => port.fragments = t.number()?,
            "answer_fragments" => port.answer_fragments = t.number()?,
            "rate" => {
                let count = t.number()?;
                t.must("per")?;
                port.rate = Some(Rate { count, per: Ticks(t.number()?) });
            }
            "guard" => port.guard = Some(t.number()?),
            other => return Err(format!("`{other}` is no option of a port")),
        }
        Ok(())
    }

    /// Reads the declaration of a couple: `couple P -> S via alive, lease 20, takeover 40, every 5`. With `<->` the two
    /// tasks can exchange their roles.
    fn couple(&mut self, t: &mut Tokens) -> Result<(), String> {
        let primary = t.named("task", |name| task(&self.cell, name))?;
        let mutual = t.eat("<->");
        if !mutual {
            t.must("->")?;
        }
        let standby = t.named("task", |name| task(&self.cell, name))?;
        t.must("via")?;
        let via = t.named("port", |name| port(&self.cell, name))?;
        let mut lengths = [Ticks::ZERO; 3];
        for (length, word) in lengths.iter_mut().zip(["lease", "takeover", "every"]) {
            t.must(",")?;
            t.must(word)?;
            *length = Ticks(t.number()?);
        }
        let [lease, takeover, every] = lengths;
        self.cell.couples.push(CoupleDecl {
            primary,
            standby,
            lease,
            takeover,
            every,
            via,
            trusted: false,
            mutual,
        });
        Ok(())
    }

    /// Reads a changed rule of the protocol. A page shows with such a rule why the default rule is needed.
    fn rule(&mut self, t: &mut Tokens) -> Result<(), String> {
        let rules = &mut self.cell.rules;
        let (rule, choice) = (t.word()?, t.word()?);
        match (rule.as_str(), choice.as_str()) {
            ("confirmation", "none") => rules.confirmation = Confirmation::None,
            ("confirmation", "first_complete") => rules.confirmation = Confirmation::FirstComplete,
            ("confirmation", "pass_on") => rules.confirmation = Confirmation::PassOn,
            ("rounds", "off") => rules.rounds = false,
            ("last_released", "off") => rules.last_released = false,
            ("answer_late_arrivals", "off") => rules.answer_late_arrivals = false,
            ("aborts", "off") => rules.aborts = false,
            ("charge_residence", "off") => rules.charge_residence = false,
            ("refuse_late_replies", "off") => rules.refuse_late_replies = false,
            ("reserve_way_back", "off") => rules.reserve_way_back = false,
            ("memory", "until_answered") => rules.memory = Memory::UntilAnswered,
            ("memory", "none") => rules.memory = Memory::None,
            ("quarantine", "off") => rules.quarantine = false,
            ("aging", "off") => rules.aging = Aging::Off,
            ("aging", "unbounded") => rules.aging = Aging::Unbounded,
            ("order", "off") => rules.obey_order = false,
            ("eviction", "by_time") => rules.eviction = Eviction::ByTime,
            ("lease", "heartbeat") => rules.lease = LeaseRule::Heartbeat,
            _ => return Err(format!("`rule {rule} {choice}` is no variant of a rule")),
        }
        Ok(())
    }
}

/// Any word that starts with a letter can be the name of a new declaration.
fn new_name(word: &str) -> Option<String> {
    word.starts_with(|c: char| c.is_ascii_alphabetic()).then(|| word.into())
}

pub fn node(cell: &Cell, name: &str) -> Option<NodeId> {
    cell.nodes.iter().position(|node| node.name == name).map(NodeId::from_index)
}

pub fn task(cell: &Cell, name: &str) -> Option<TaskId> {
    cell.tasks.iter().position(|task| task.name == name).map(TaskId::from_index)
}

pub fn port(cell: &Cell, name: &str) -> Option<PortId> {
    cell.ports.iter().position(|port| port.name == name).map(PortId::from_index)
}
