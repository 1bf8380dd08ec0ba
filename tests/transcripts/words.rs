//! Writes events, and parts of the state, as text.

use imrs_protocol::*;

/// The contents of a message, as a transcript writes them.
pub fn text(bytes: &[u8]) -> String {
    format!("\"{}\"", bytes.escape_ascii().to_string().replace("\\'", "'"))
}

/// Writes texts in which the tasks, nodes and ports have their names in the cell.
pub struct Names<'a>(pub &'a CellTable);

impl Names<'_> {
    pub fn node(&self, node: NodeId) -> &str {
        &self.0.cell().nodes[node.index()].name
    }

    pub fn task(&self, task: TaskId) -> &str {
        self.0.cell().tasks.get(task.index()).map_or("nobody", |task| &task.name)
    }

    pub fn port(&self, port: PortId) -> &str {
        self.0.cell().ports.get(port.index()).map_or("no port", |port| &port.name)
    }

    /// A packet that leaves a node, such as `ARRIVE X to Y on lift round 1, 40 left`.
    pub fn packet(&self, p: &Packet) -> String {
        let meeting = p.meeting();
        let what = match p.kind {
            Kind::Arrive | Kind::Confirm => format!("round {}", meeting.round.0),
            Kind::Abort => format!("round {}, next {}", meeting.round.0, meeting.next_round().0),
            Kind::Control => p.control().map_or("?".into(), |c| format!("{c:?}")),
            Kind::Send | Kind::Query | Kind::Reply | Kind::Response => text(p.contents.as_bytes()),
        };
        let word = format!("{:?}", p.kind).to_uppercase();
        let part = if p.more || p.fragment > 0 { format!(" part {}", p.fragment) } else { String::new() };
        let again = if p.resent { ", again" } else { "" };
        let (from, to, port) = (self.task(p.source), self.task(p.destination), self.port(p.port));
        format!("{word} {from} to {to} on {port} {what}{part}, {} left{again}", p.remaining)
    }

    /// A signal to a task, as text. `whole` is the whole message that the signal delivers. `answer` reads the answer of
    /// a task.
    pub fn signal(
        &self,
        signal: &Signal,
        whole: &[u8],
        answer: impl Fn(PortId, TaskId) -> Option<Vec<u8>>,
    ) -> String {
        match *signal {
            Signal::Accepted(1) | Signal::Accepted(0) => "accepted".into(),
            Signal::Accepted(copies) => format!("accepted, {copies} copies"),
            Signal::Fault(fault) => format!("fault {fault:?}"),
            Signal::Outcome(Outcome::Reply(contents)) => format!("Reply {}", text(contents.as_bytes())),
            Signal::Outcome(outcome) => format!("{outcome:?}"),
            Signal::Answers { port, answers } => self.answers(port, &answers, answer),
            Signal::Interrupt(Call::Message(d)) => format!("interrupt: {}", self.delivery(&d, whole)),
            Signal::Interrupt(Call::Timer(id)) => format!("interrupt: timer {}", id.0),
            Signal::Interrupt(Call::Fenced) => "interrupt: fenced".into(),
            Signal::Interrupt(Call::TakeOver(epoch)) => format!("interrupt: take over, epoch {epoch}"),
            Signal::Granted(epoch) => format!("granted, epoch {epoch}"),
            Signal::Message(d) => self.delivery(&d, whole),
            Signal::Nothing => "nothing".into(),
            Signal::Released { round, by: ReleasedBy::AllArrived, .. } => {
                format!("released from round {}: all arrived", round.0)
            }
            Signal::Released { round, by: ReleasedBy::Confirm(task), .. } => {
                format!("released from round {}: CONFIRM of {}", round.0, self.task(task))
            }
            Signal::GaveUp { port, round, missing } => {
                format!("gave up round {}, missing {}", round.0, self.parties(port, missing))
            }
            Signal::TimeOut(id) => format!("time_out {}", id.0),
            Signal::Cancelled => "cancelled".into(),
        }
    }

    fn delivery(&self, d: &Delivery, whole: &[u8]) -> String {
        let (said, from, port) = (text(whole), self.task(d.from.source), self.port(d.from.port));
        match d.class {
            Class::Command => format!("{said} from {from} on {port}, answer within {}", d.budget),
            Class::Status => format!("{said} from {from} on {port}, {} left", d.budget),
        }
    }

    /// The outcome of each member of a set of receivers, as text.
    fn answers(
        &self,
        port: PortId,
        a: &Answers,
        answer: impl Fn(PortId, TaskId) -> Option<Vec<u8>>,
    ) -> String {
        let Some(decl) = self.0.port(port) else { return "nothing".into() };
        let asked = decl.parties.iter().enumerate().filter(|(i, _)| a.asked >> i & 1 == 1);
        let said = asked.map(|(i, party)| {
            let is = |bits: u64| bits >> i & 1 == 1;
            let mark = match answer(port, party.task) {
                Some(said) if is(a.answered) => text(&said),
                _ if is(a.refused) => "refused".into(),
                _ if is(a.restarted) => "restarted".into(),
                _ if is(a.unsent) => "never left".into(),
                _ => "unknown".into(),
            };
            format!("{} {mark}", self.task(party.task))
        });
        format!("answers: {}", said.collect::<Vec<_>>().join(", "))
    }

    /// The tasks whose bits are set in a bit mask, with the owner of the port first.
    fn parties(&self, port: PortId, bits: u64) -> String {
        let Some(port) = self.0.port(port) else { return "nobody".into() };
        let named = port.parties.iter().enumerate().filter(|(i, _)| bits >> i & 1 == 1);
        let names: Vec<&str> = named.map(|(_, party)| self.task(party.task)).collect();
        if names.is_empty() { "nobody".into() } else { names.join(" and ") }
    }

    /// An observation as text; `None` if transcripts do not show observations of its kind.
    pub fn observation(&self, node: NodeId, at: Option<TaskId>, o: &Observation) -> Option<String> {
        let who = at.map_or_else(|| self.node(node), |task| self.task(task));
        match o.event {
            Event::Discarded(reason) => {
                Some(format!("{who} drops {} ({}): {}", self.port(o.port), self.task(o.peer), reason.name()))
            }
            Event::Rejected => Some(format!("{who} rejects {} ({})", self.port(o.port), self.task(o.peer))),
            Event::WithinMargin => {
                Some(format!("{who} holds all arrivals, {} left: not enough", o.remaining))
            }
            _ => None,
        }
    }

    /// The state of a task as text.
    pub fn state(&self, state: &TaskState) -> String {
        match *state {
            TaskState::Running => "runs".into(),
            TaskState::Receiving { port, remaining } => {
                let on = port.map_or(String::new(), |port| format!(" on {}", self.port(port)));
                format!("receives{on}{}", remaining.map_or(String::new(), |left| format!(", {left} left")))
            }
            TaskState::AwaitingReply { port, from, remaining } => {
                format!("waits for {}'s answer on {}, {remaining} left", self.task(from), self.port(port))
            }
            TaskState::Waiting { port, round, remaining } => {
                format!("waits in round {} of {}, {remaining} left", round.0, self.port(port))
            }
            TaskState::Delaying => "delays".into(),
        }
    }

    /// The messages that wait in the queue of a port, in the order in which they are served.
    pub fn queue(&self, view: &PortView) -> String {
        let entry = |e: &QueueEntry| format!("{} with {} left", self.task(e.source), e.remaining);
        let entries: Vec<String> = view.queue.iter().map(entry).collect();
        if entries.is_empty() { "nothing waits".into() } else { entries.join(", then ") }
    }

    /// The counters of a port that are not zero, as text.
    pub fn counters(&self, c: &PortCounters) -> String {
        let all = [
            (c.sent, "sent"),
            (c.resent, "sent again"),
            (c.enqueued, "enqueued"),
            (c.delivered, "delivered"),
            (c.expired, "expired"),
            (c.refused, "refused"),
            (c.rejected, "rejected"),
            (c.evicted, "evicted"),
            (c.duplicates, "duplicates"),
            (c.timed_out, "timed out"),
            (c.dropped, "dropped"),
        ];
        let some: Vec<String> =
            all.iter().filter(|(n, _)| *n > 0).map(|(n, word)| format!("{n} {word}")).collect();
        if some.is_empty() { "nothing counted".into() } else { some.join(", ") }
    }

    /// The packets that wait in a node's transit buffer, in the order in which they leave it.
    pub fn transit(&self, waiting: &[Packet]) -> String {
        let all: Vec<String> = waiting.iter().map(|p| self.packet(p)).collect();
        if all.is_empty() { "nothing waits".into() } else { all.join(", then ") }
    }
}
