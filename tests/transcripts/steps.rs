//! Reads the steps of a `transcript` block. The expected events below a step are not parsed, but compared as text.

use super::cells::{node, port, task};
use super::tokens::Tokens;
use imrs_protocol::*;

/// One step of a transcript.
#[derive(Clone, Debug)]
pub enum Step {
    /// Lets this many ticks pass.
    After(u64),
    /// Whether the transcript shows packets that leave a node, from now on.
    Show(bool),
    /// A fault for packets that leave a node after this step.
    Next(Fault),
    /// Removes the faults for packets from the first task to the second one.
    Mend(TaskId, TaskId),
    Crash(NodeId),
    Restart {
        node: NodeId,
        unnoticed: bool,
    },
    /// `Stop` suspends the process of a node, and `Continue` resumes it.
    Stop(NodeId),
    Continue(NodeId),
    /// Whether the link from the first node to the second one is busy, so that it accepts no packets.
    Busy(NodeId, NodeId, bool),
    /// Shows a part of the state.
    Look(Look),
    /// A task makes a request.
    Ask(TaskId, Ask),
}

/// The parts of the state that a transcript can show.
#[derive(Clone, Copy, Debug)]
pub enum Look {
    Queue(PortId, TaskId),
    Counters(PortId, TaskId),
    State(TaskId),
    Transit(NodeId),
    Answer(PortId, TaskId, TaskId),
}

/// A request of a task. The fragments and the address of an answer are determined when the step is executed.
#[derive(Clone, Debug)]
pub enum Ask {
    Plain(Request),
    Send { port: PortId, to: Vec<TaskId>, contents: Vec<u8>, time_out: Option<Ticks> },
    Reply { through: Option<PortId>, to: Option<TaskId>, of: Option<TaskId>, contents: Vec<u8> },
}

/// A fault for the next packets of a kind.
#[derive(Clone, Debug)]
pub struct Fault {
    /// How many packets the fault affects; `u32::MAX` stands for all.
    pub count: u32,
    pub kind: Option<Kind>,
    pub source: TaskId,
    pub destination: TaskId,
    /// If this is set, the fault affects only packets that leave this node.
    pub at: Option<NodeId>,
    pub what: What,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum What {
    Lost,
    /// A second copy of the packet arrives this many ticks after the first.
    Twice(u64),
    /// The packet is under way for this many ticks.
    Takes(u64),
}

/// Reads one step from its line.
pub fn read(line: &str, cell: &Cell) -> Result<Step, String> {
    let mut tokens = Tokens::new(line)?;
    let t = &mut tokens;
    let step = if let Some(task) = t.maybe(|name| task(cell, name)) {
        t.must(":")?;
        Step::Ask(task, ask(t, cell)?)
    } else {
        control(t, cell)?
    };
    tokens.end()?;
    Ok(step)
}

fn control(t: &mut Tokens, cell: &Cell) -> Result<Step, String> {
    let a_node = |t: &mut Tokens| t.named("node", |name| node(cell, name));
    let a_task = |t: &mut Tokens| t.named("task", |name| task(cell, name));
    let found = t.found();
    Ok(match t.word()?.as_str() {
        "after" => Step::After(t.number()?),
        "show" => Step::Show(t.must("packets").map(|()| true)?),
        "hide" => Step::Show(t.must("packets").map(|()| false)?),
        "next" => {
            let count = t.maybe_number().unwrap_or(1);
            Step::Next(fault(count, t, cell)?)
        }
        "every" => Step::Next(fault(u32::MAX, t, cell)?),
        "mend" => {
            let source = a_task(t)?;
            t.must("->")?;
            Step::Mend(source, a_task(t)?)
        }
        "crash" => Step::Crash(a_node(t)?),
        "restart" => Step::Restart { node: a_node(t)?, unnoticed: t.eat("unnoticed") },
        "stop" => Step::Stop(a_node(t)?),
        "continue" => Step::Continue(a_node(t)?),
        word @ ("busy" | "free") => {
            let from = a_node(t)?;
            t.must("->")?;
            Step::Busy(from, a_node(t)?, word == "busy")
        }
        "queue" => Step::Look(Look::Queue(a_port(t, cell)?, t.must("at").and_then(|()| a_task(t))?)),
        "counters" => Step::Look(Look::Counters(a_port(t, cell)?, t.must("at").and_then(|()| a_task(t))?)),
        "state" => Step::Look(Look::State(a_task(t)?)),
        "transit" => Step::Look(Look::Transit(a_node(t)?)),
        "answer" => {
            let port = a_port(t, cell)?;
            t.must("of")?;
            let of = a_task(t)?;
            t.must("at")?;
            Step::Look(Look::Answer(port, of, a_task(t)?))
        }
        _ => return Err(format!("{found} is neither a task nor something that happens or can be looked at")),
    })
}

fn fault(count: u32, t: &mut Tokens, cell: &Cell) -> Result<Fault, String> {
    let kind = t.maybe(kind);
    let source = t.named("task", |name| task(cell, name))?;
    t.must("->")?;
    let destination = t.named("task", |name| task(cell, name))?;
    let at = if t.eat("at") { Some(t.named("node", |name| node(cell, name))?) } else { None };
    let what = match t.word()?.as_str() {
        "is" => t.must("lost").map(|()| What::Lost)?,
        "comes" => {
            t.must("twice")?;
            let apart = if t.eat(",") { t.number()? } else { 0 };
            if apart > 0 {
                t.must("apart")?;
            }
            What::Twice(apart)
        }
        "takes" => What::Takes(t.number()?),
        other => return Err(format!("`{other}`: a packet is lost, comes twice or takes so long")),
    };
    Ok(Fault { count, kind, source, destination, at, what })
}

fn kind(word: &str) -> Option<Kind> {
    Some(match word {
        "SEND" => Kind::Send,
        "QUERY" => Kind::Query,
        "REPLY" => Kind::Reply,
        "RESPONSE" => Kind::Response,
        "ARRIVE" => Kind::Arrive,
        "CONFIRM" => Kind::Confirm,
        "ABORT" => Kind::Abort,
        "CONTROL" => Kind::Control,
        _ => return None,
    })
}

fn a_port(t: &mut Tokens, cell: &Cell) -> Result<PortId, String> {
    t.named("port", |name| port(cell, name))
}

fn ask(t: &mut Tokens, cell: &Cell) -> Result<Ask, String> {
    let found = t.found();
    let verb = t.word()?;
    let request = match verb.as_str() {
        "send" | "query" => return send(t, cell),
        "reply" | "respond" => return reply(t, cell),
        "receive" => Request::Get {
            port: t.maybe(|name| port(cell, name)),
            source: if t.eat("from") { Some(t.named("task", |name| task(cell, name))?) } else { None },
            time_out: length(t)?,
        },
        "waitfor" => {
            let port = a_port(t, cell)?;
            let mut arguments = [0; 8];
            let text = t.text();
            arguments.get_mut(..text.len()).ok_or("more than 8 bytes")?.copy_from_slice(&text);
            Request::Arrive { port, arguments, time_out: length(t)? }
        }
        "order" => Request::Order(order(t, cell)?),
        "handle" => Request::Handle { port: a_port(t, cell)?, handled: true },
        "unhandle" => Request::Handle { port: a_port(t, cell)?, handled: false },
        "delay" => Request::Delay { id: TimeId(t.number()?), length: must_length(t)? },
        "start" => Request::Start { id: TimeId(t.number()?), length: must_length(t)? },
        "stop" => Request::Stop { id: TimeId(t.number()?) },
        "boundary" => Request::Boundary,
        "work" => Request::Work,
        "done" => Request::Done,
        "return" => Request::Return,
        "atomic" => Request::Atomic(!t.eat("end")),
        "lease" => Request::Lease,
        "publish" => Request::Publish(Contents::new(&t.text()).ok_or("more than one packet carries")?),
        "cancel" => Request::Cancel,
        "abandon" => Request::Abandon,
        _ => return Err(format!("{found} is nothing that a task asks for")),
    };
    Ok(Ask::Plain(request))
}

fn send(t: &mut Tokens, cell: &Cell) -> Result<Ask, String> {
    let id = a_port(t, cell)?;
    let to = if t.eat("to") { t.list("task", |name| task(cell, name))? } else { Vec::new() };
    let contents = t.text();
    Ok(Ask::Send { port: id, to, contents, time_out: length(t)? })
}

/// Reads `reply [PORT] [to A] [for B] "..."`. With a `reply` port, `for B` names the task that received the message.
fn reply(t: &mut Tokens, cell: &Cell) -> Result<Ask, String> {
    let through = t.maybe(|name| port(cell, name));
    let to = if t.eat("to") { Some(t.named("task", |name| task(cell, name))?) } else { None };
    let of = if t.eat("for") { Some(t.named("task", |name| task(cell, name))?) } else { None };
    Ok(Ask::Reply { through, to, of, contents: t.text() })
}

fn order(t: &mut Tokens, cell: &Cell) -> Result<ServiceOrder, String> {
    let mut ranked = Vec::new();
    while ranked.is_empty() || t.eat(">") {
        let found = |name: &str| match name {
            "self" => Some(Ranked::Own),
            "timers" => Some(Ranked::Timers),
            name => port(cell, name).map(Ranked::Port).or_else(|| task(cell, name).map(Ranked::Source)),
        };
        ranked.push(t.named("port or task", found)?);
    }
    ServiceOrder::new(&ranked).ok_or_else(|| "more levels than an order has".into())
}

fn length(t: &mut Tokens) -> Result<Option<Ticks>, String> {
    if t.eat("for") { t.number().map(|n| Some(Ticks(n))) } else { Ok(None) }
}

fn must_length(t: &mut Tokens) -> Result<Ticks, String> {
    t.must("for")?;
    t.number().map(Ticks)
}
