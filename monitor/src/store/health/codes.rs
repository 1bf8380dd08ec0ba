//! The lints of the monitor: the kinds of findings, each with its code, severity and explanation.

use crate::store::journal::Severity;

/// How directly a kind of finding names a cause. Of findings of equal severity, the more direct one comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum About {
    /// A task, a port, or the end of a node: what the cell itself does, or does not do any more.
    Cell,
    /// A node as a whole: its release, its transit buffer, its start.
    Node,
    /// A link, a timer or the computer. If something is slow, this may be why, and it may be by chance.
    Machine,
}

/// A lint: a kind of finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lint {
    /// The code: a stable name, for programs and for `imrs explain`.
    pub code: &'static str,
    /// The severity of such a finding.
    pub level: Severity,
    /// How directly such a finding names a cause.
    pub about: About,
    /// A short title.
    pub title: &'static str,
    /// An explanation in Markdown: what the finding means, when it is reported, what to do.
    pub explanation: &'static str,
}

macro_rules! lints {
    ($($name:ident $level:ident $about:ident $code:literal $title:literal;)*) => {
        $(pub(in crate::store) const $name: Lint = Lint {
            code: $code,
            level: Severity::$level,
            about: About::$about,
            title: $title,
            explanation: include_str!(concat!("explain/", $code, ".md")),
        };)*

        /// All lints, most severe first.
        pub const ALL: &[Lint] = &[$($name,)*];
    };
}

lints! {
    NODE_DEAD Bad Cell "node-dead" "a node is gone";
    NODE_MISSING Bad Cell "node-missing" "a node was never seen";
    TASK_CRASHED Bad Cell "task-crashed" "a task panicked";
    LOST_MEMBER Bad Cell "rendezvous-lost-member" "a task waits for a member that is gone";
    WAIT_CYCLE Bad Cell "wait-cycle" "tasks wait for each other in a cycle";
    DIVERGENT Bad Cell "divergent-rendezvous" "a rendezvous ended differently for its members";
    COMMAND_EVICTED Bad Cell "command-evicted" "a command was dropped for space";
    MODEL_VIOLATION Bad Cell "model-violation" "a node does not do what was verified";
    LINK_CUT Bad Cell "link-cut" "what one node sends does not arrive at another one";
    DIGEST_MISMATCH Bad Cell "digest-mismatch" "nodes run different cells under one name";
    LINK_FAULTY Warn Machine "link-faulty" "a link damages datagrams and loses them";
    LINK_LATE Warn Machine "link-late" "datagrams take longer than their link declares";
    VERSION_MISMATCH Warn Node "version-mismatch" "nodes of different releases";
    RENDEZVOUS_STUCK Warn Cell "rendezvous-stuck" "a rendezvous will soon be given up";
    WITHIN_MARGIN Warn Cell "within-margin" "all arrived, too late to go on alone";
    DEADLINE_RISK Warn Cell "deadline-risk" "a message will miss its deadline";
    STARVING Warn Cell "starving" "a message is rejected again and again";
    STATUS_FLOOD Warn Cell "status-flood" "more class-1 messages than are taken";
    TIME_OUTS Warn Cell "time-outs" "requests ended by time_out";
    REFUSED Warn Cell "refused" "messages found no space";
    EVICTED Warn Cell "evicted" "messages were evicted for more urgent ones";
    EXPIRED Warn Cell "expired" "messages that expired here";
    TRANSIT_FULL Warn Node "transit-full" "packets wait for their link";
    TIMER_LATE Warn Machine "timer-late" "timers end later than the cell declares";
    KERNEL_RESIDENCY Warn Machine "kernel-residency" "datagrams that the kernel dropped";
    INTEGRITY Warn Machine "integrity" "datagrams that were damaged, forged or repeated";
    LINK_DISCARDS Warn Machine "link-discards" "datagrams that cannot be used";
    NODE_SILENT Warn Cell "node-silent" "a node sends nothing, though attached";
    NO_REAL_TIME Note Machine "no-real-time" "real time was asked for and refused";
    LINK_NEAR Note Machine "link-near-bound" "datagrams take nearly as long as their link declares";
    HELD_BACK Note Node "held-back" "scripts of a restarted node begin later";
    EVENTS_LOST Note Node "events-lost" "the node could not keep all events for this monitor";
}

/// The lint with this code.
#[must_use]
pub fn find(code: &str) -> Option<&'static Lint> {
    ALL.iter().find(|lint| lint.code == code)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn codes_are_unique_and_every_page_says_what_it_means_and_what_to_do() {
        let codes: BTreeSet<_> = ALL.iter().map(|lint| lint.code).collect();
        assert_eq!(codes.len(), ALL.len());
        for lint in ALL {
            let heading = format!("# {}: {}\n", lint.code, lint.title);
            assert!(lint.explanation.starts_with(&heading), "{}", lint.code);
            for part in ["Raised when", "What to do:"] {
                assert!(lint.explanation.contains(part), "{} has no `{part}`", lint.code);
            }
        }
        assert!(ALL.is_sorted_by_key(|lint| std::cmp::Reverse(lint.level)));
    }
}
