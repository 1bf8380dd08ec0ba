//! The explanations of columns, figures and abbreviations that the help lists.

use crate::app::Screen;

/// What `INSECURE` in the header says.
pub(super) const INSECURE: &str = "the nodes neither encrypt nor authenticate their datagrams";

/// What lists and numbers of all screens say.
pub(super) const LISTS: &[(&str, &str)] = &[
    ("37/156", "the selected line, of so many lines, if not all have room"),
    ("12k 3M", "thousands, millions"),
    ("us ms", "microseconds, milliseconds; s, m, h: seconds, minutes, hours"),
    ("-", "nothing to show, or not known yet"),
];

/// What the header says.
pub(super) const HEADER: &[(&str, &str)] = &[
    ("Over Rdv Prob", "the screens 1 overview, 3 rendezvous, 8 problems; 2 and 4 to 7 by their names"),
    ("(1/2, C: next)", "the first of two cells; the key C shows the next one"),
    ("3/4 nodes", "so many nodes are up, of those that the cell declares"),
    ("LIVE", "what the nodes report now"),
    ("NO NODE UP", "every node of the cell has ended"),
    ("PAUSED", "this screen stands still; the nodes do not"),
    ("REPLAY", "a recording, and the position in it"),
    ("REC", "the monitor records what the nodes report"),
    ("INSECURE", INSECURE),
    ("lost 12", "so many events of the nodes that the monitor did not get"),
];

/// What the banner says.
pub(super) const BANNER: &[(&str, &str)] = &[
    ("BLOCKED BY", "tasks wait for this one: it is gone, or they wait longer than usual"),
    ("waiting for", "the same, but no longer than usual"),
    ("WAIT CYCLE", "tasks wait for each other"),
    ("LOST", "a node or task is gone, and no task waits for it at the moment"),
    ("LINK CUT", "one node sends over this link, and nothing arrives at the other"),
    ("holds 2 of 5", "so many of the cell's tasks wait for it, directly or not"),
    ("p99", "99 of 100 were at most this; of a wait: rounds of this rendezvous"),
    ("DEAD", "the connection to the node ended without a goodbye"),
    ("SILENT", "the node is attached and sends nothing"),
    ("CRASHED", "the task panicked"),
    ("ENDED", "the task, or the node (STOPPED), ended in order"),
    ("TTL", "time to live: how long a message may be used after it was sent"),
    ("CONFIRM", "a member's message that it knows of all arrivals"),
];

const OVERVIEW: &[(&str, &str)] = &[
    ("NODE/TASK/PORT", "a node and its process, its tasks, their ports"),
    ("STATE", "what it does; of a port: class, usage, parties"),
    ("up 4m", "the node runs, and how long it has"),
    ("inc 9, 8 deaths", "the node's incarnation: its starts are numbered; so often it died before"),
    ("pid", "the number of the node's process"),
    ("run", "the task computes, or waits for nothing of the cell; otherwise what it waits for"),
    ("lines", "at the end of a node's state: messages a second, and least slack, of the last minute"),
    ("10 nodes", "the healthy nodes of a large cell; Enter shows them"),
    ("QUEUE", "messages waiting / space; of a waitfor: arrived / members"),
    ("SLACK", "remaining time of the most urgent message, or of the wait"),
    ("MSG/s", "sent and served by this end, over the last seconds"),
    ("+3", "so many more in the last five seconds; otherwise the count since the start"),
    ("EXP", "messages that expired here"),
    ("OVF", "messages refused or evicted for space"),
    ("REJ", "messages the task rejected by rank"),
    ("RES", "copies sent again"),
    ("T/O", "own requests that ended by time_out"),
    ("HEALTH", "the worst of what is within the row"),
    ("!", "HEALTH as a sign: ! look at it soon, !! now"),
    ("c1 c2", "class 1: status, sent once; class 2: command, acknowledged"),
    ("rt NO RT", "the node runs in real time; it asked for that, and it was refused"),
    ("transit 2", "packets that wait in this node for their link"),
    ("links", "ok: a packet arrived in the last second; quiet: none for so long"),
    ("p50 p99 max", "of a link: half, 99 of 100, all took at most so many ms lately"),
    ("ok 1.20/5 ms", "p99 / the declared bound, where p50 and max have no room"),
    ("late near", "of a link: p99 is above its bound; above four fifths of it"),
    ("too few", "to judge: less than 20 datagrams were measured lately"),
    ("DOWN CUT", "of a link: a node at its end is gone; what is sent does not arrive"),
    ("STOPPED", "of a link: a node at its end has stopped in order, or a neighbour says so"),
    ("FAULTY", "of a link: datagrams come damaged, and others are missing"),
    ("model", "the validator's verdict on the recorded inputs"),
    ("UNKNOWN", "no such verdict: nothing is recorded, or a part of it is missing"),
    ("r12", "the number of the round of a waitfor"),
];

const PORT: &[(&str, &str)] = &[
    ("#", "the place in the order of service: earliest deadline first"),
    ("CLS", "class 1: status; class 2: command, answered"),
    ("REMAIN", "its remaining time"),
    ("AGE", "how much of its TTL is used up"),
    ("REJ", "how often it was rejected by rank"),
    ("PEN", "how long it is not offered again, because of rejections"),
    ("VERDICT", "place x 99th percentile of the service time against REMAIN"),
    ("service", "how long the task takes for one, once it is its turn"),
    ("Jain", "1: all sources fare alike; 1/n: one has everything"),
    ("by source", "served / offered, of what was seen since the monitor attached"),
    ("since start", "what the node has counted since it started"),
    ("since attached", "what the monitor has seen since it attached"),
    ("class", "1: status; 2: command, answered"),
    ("port", "the place of this port among those that receive"),
    ("slack p5", "5 of 100 samples had less left for the most urgent message"),
    ("FROM", "the task that sent it"),
    ("MSG", "the sender's incarnation, and the number of the message"),
    ("TIME LEFT", "REMAIN as a part of its TTL"),
    ("MISS", "it will likely expire before it is served"),
    ("buffer", "messages waiting / space"),
    ("usage", "what the task does at the port"),
    ("time_out", "the TTL of a new message"),
    ("in", "messages that were queued"),
    ("served", "messages that the task took"),
    ("expired", "messages whose TTL ended here"),
    ("refused", "messages without space, so the sender knows"),
    ("evicted", "messages that made room for more urgent ones"),
    ("rejected", "messages that the task does not serve now, by rank"),
    ("dup", "copies of messages that were known"),
    ("dropped", "messages that were dropped for another reason"),
    ("sent", "messages that the task sent here"),
    ("re-sent", "copies that it sent again"),
    ("timed out", "its requests that ended by time_out"),
    ("fill", "how full the buffer was, the latest at the right"),
    ("bypassed", "served before one of higher rank / the limit of that"),
    ("p50 p99", "half, and 99 of 100, were at most this"),
];

const MESSAGE: &[(&str, &str)] = &[
    ("AT", "on the clock of the node that sent it, since that started"),
    ("LEFT", "its remaining time then"),
    ("CHARGED", "what the protocol took off since the stage named in SINCE"),
    ("CLOCKS", "what clocks saw pass since then; ~ between two nodes"),
    ("WHERE", "the task or the link"),
    ("WHAT", "what happened to it there"),
    ("SINCE", "the stage from which CHARGED and CLOCKS count"),
    ("TIME LEFT", "LEFT as a part of its TTL"),
    ("TTL", "its time to live when it was sent"),
    ("class", "1: status; 2: command, answered"),
];

const RENDEZVOUS: &[(&str, &str)] = &[
    ("r12", "the number of the round"),
    ("GATHERING", "arrived / members, while one of them waits"),
    ("MEMBER", "a task of the rendezvous, and its node"),
    ("ARRIVED", "whether the member waits in the round shown, since when"),
    ("CONFIRMS", "confirmations this member holds from others"),
    ("WAITS FOR", "members whose arrival it does not know of"),
    ("MISSING", "it has not arrived, and it cannot: its task or node has ended"),
    ("CONFIRM", "a member's message that it has all arrivals"),
    ("history", "the last 50 rounds: how they ended"),
    ("done", "rounds in which all went on"),
    ("timed out", "rounds that all members gave up"),
    ("split rounds", "rounds in which some members went on, and others gave up"),
    ("gather", "from the first arrival to the last"),
    ("p50 p99", "half, and 99 of 100, took at most this"),
    ("slowest", "the member that came last most often"),
];

const TIMELINE: &[(&str, &str)] = &[
    ("TIME", "on the clock of the selected lane's node, since it started"),
    ("TASK", "the task in which it happened"),
    ("clocks", "how far the order of events on different nodes may be wrong"),
    ("WHAT", "what happened"),
    ("#12 r3", "a message's number; a round"),
    ("+2", "so many more in this row"),
    ("clocks +-59ms", "the greatest error of a time of another node, marked with ~"),
    ("100ms a row", "how much time a row stands for, or `each event`: + and - change it"),
    ("+3 new", "so many rows came after the last one that is shown"),
    ("3< >32", "so many lanes to the left and to the right have no room; +1>: their events"),
    ("+12 elsewhere", "events in lanes without room; the busiest lanes are shown, 4 chooses again"),
];

const TIMERS: &[(&str, &str)] = &[
    ("OWNER", "the task"),
    ("ID", "the timer, or the port of the wait"),
    ("KIND", "timer, delay: of the Timer; receive, reply, waitfor: waits with an end"),
    ("LENGTH", "its time_out; of a timer the most that was ever seen left"),
    ("LEFT", "until it runs out"),
    ("TIME LEFT", "LEFT as a part of LENGTH"),
    ("t0 r12 #7", "the number of a timer, a round, a message"),
    ("p50 p99", "half, and 99 of 100, were at most this late"),
    ("late", "how late the node's Timer was, and how often later than the cell's tick"),
    ("WHAT", "what ends the wait, or what begins then"),
];

const EVENTS: &[(&str, &str)] = &[
    ("AGO", "when it happened; if it repeats, when it began"),
    ("!", "! look at it soon, !! now"),
    ("x37 12/s", "so many times, each within ten seconds of the one before, and so often"),
    ("NODE", "the node that reported it"),
    ("KIND", "what happened"),
    ("OBJECT", "the message, port or task"),
    ("DETAIL", "the reason, and the other task"),
    ("pid", "the number of the node's process"),
    ("following", "new events appear at the bottom; going up holds the list"),
    ("+2 new", "so many events came after the last one that is shown"),
];

const MODEL: &[(&str, &str)] = &[
    ("conforms", "every recorded step was what the verified machine does"),
    ("VIOLATES", "a node did what the verified machine does not do"),
    ("UNKNOWN", "nothing is recorded, or a part of it is missing"),
    ("5/34 (17%)", "transition kinds seen, of those that the task's ports make possible"),
    ("steps checked", "recorded steps that the validator has compared"),
    ("seen", "transition kinds that were observed, and how often"),
    ("never", "kinds that the task's ports make possible, and that did not occur"),
];

const PROBLEMS: &[(&str, &str)] = &[
    ("!", "! look at it soon, !! now"),
    ("PROBLEM", "what is wrong, or what is left for the message"),
    ("PLACE", "node, task and port; indented: a consequence of the row above"),
    ("CODE", "of the finding: x explains it, and so does `imrs explain CODE`"),
    ("next deadline", "a queued message: likely misses by time left, then others by time to spare"),
    ("MISS", "the message will likely expire before it is served"),
    ("TTL", "time to live: what a message had when it was sent"),
    ("needs", "when it is likely done: place in the queue x 99th percentile of service"),
];

/// What a column or a figure of a screen shows: `SLACK: remaining time ...`.
#[must_use]
pub fn column(screen: Screen, title: &str) -> Option<String> {
    let (name, text) = columns(screen).iter().find(|(name, _)| *name == title)?;
    Some(format!("{name}: {text}"))
}

/// The explanations of a screen's columns.
pub(crate) const fn columns(screen: Screen) -> &'static [(&'static str, &'static str)] {
    match screen {
        Screen::Overview | Screen::Settings | Screen::Help => OVERVIEW,
        Screen::Port => PORT,
        Screen::Message => MESSAGE,
        Screen::Rendezvous => RENDEZVOUS,
        Screen::Timeline => TIMELINE,
        Screen::Timers => TIMERS,
        Screen::Events => EVENTS,
        Screen::Problems | Screen::Explain => PROBLEMS,
        Screen::Model => MODEL,
    }
}
