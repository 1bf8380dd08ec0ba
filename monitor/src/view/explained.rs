//! The explanations of columns and numbers, which the help lists.

use crate::app::Screen;

/// The words of the banner, with their meaning.
pub(super) const BANNER: &[(&str, &str)] = &[
    ("BLOCKED BY", "tasks wait for this one: it is gone, or they wait longer than usual"),
    ("waiting for", "the same, but no longer than usual"),
    ("WAIT CYCLE", "tasks wait for each other"),
    ("LOST", "a node or task is gone, and no task waits for it at the moment"),
    ("holds 2 of 5", "so many of the cell's tasks wait for it, directly or not"),
    ("p99", "99 of 100 rounds of this rendezvous gather in less"),
];

const OVERVIEW: &[(&str, &str)] = &[
    ("NODE/TASK/PORT", "a node and its process, its tasks, their ports"),
    ("STATE", "what it does; of a port: class, usage, parties"),
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
    ("links", "ok: a packet arrived in the last second; quiet: none for so long"),
    ("model", "the validator's verdict on the recorded inputs"),
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
    ("slack p5", "5 of 100 samples had less left for the most urgent message"),
    ("FROM", "the task that sent it"),
    ("MSG", "its incarnation and number"),
    ("TIME LEFT", "REMAIN as a part of its TTL"),
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
];

const RENDEZVOUS: &[(&str, &str)] = &[
    ("MEMBER", "a task of the rendezvous, and its node"),
    ("ARRIVED", "whether the member waits in the round shown, since when"),
    ("CONFIRMS", "confirmations this member holds from others"),
    ("WAITS FOR", "members whose arrival it does not know of"),
    ("history", "the last 50 rounds: how they ended"),
    ("gather", "from the first arrival to the last"),
    ("slowest", "the member that came last most often"),
];

const TIMELINE: &[(&str, &str)] = &[
    ("TIME", "on the clock of the selected lane's node, since it started"),
    ("#12 r3", "a message's number; a round"),
    ("+2", "so many more in this row"),
    ("+12 elsewhere", "events in lanes without room; the busiest lanes are shown, 4 chooses again"),
];

const TIMERS: &[(&str, &str)] = &[
    ("OWNER", "the task"),
    ("ID", "the timer, or the port of the wait"),
    ("KIND", "timer, delay: of the Timer; receive, reply, waitfor: waits with an end"),
    ("LENGTH", "its time_out; of a timer the most that was ever seen left"),
    ("LEFT", "until it runs out"),
    ("late", "how late the node's Timer was, and how often later than the cell's tick"),
    ("WHAT", "what ends the wait, or what begins then"),
];

const EVENTS: &[(&str, &str)] = &[
    ("AGO", "when it happened; if it repeats, when it began"),
    ("x37 12/s", "so many times, each within ten seconds of the one before, and so often"),
    ("NODE", "the node that reported it"),
    ("KIND", "what happened"),
    ("OBJECT", "the message, port or task"),
    ("DETAIL", "the reason, and the other task"),
];

const MODEL: &[(&str, &str)] = &[
    ("conforms", "every recorded step was what the verified machine does"),
    ("UNKNOWN", "nothing is recorded, or a part of it is missing"),
    ("seen", "transition kinds that were observed, and how often"),
    ("never", "kinds that the task's ports make possible, and that did not occur"),
];

const PROBLEMS: &[(&str, &str)] = &[
    ("PROBLEM", "what is wrong, or what is left for the message"),
    ("PLACE", "node, task and port; indented: a consequence of the row above"),
    ("CODE", "of the finding: x explains it, and so does `imrs explain CODE`"),
    ("next deadline", "a queued message; those with the least time to spare come first"),
    ("needs", "when it is likely done: place in the queue x 99th percentile of service"),
];

/// What the column with this title shows: `SLACK: remaining time ...`.
pub(crate) fn column(screen: Screen, title: &str) -> Option<String> {
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
