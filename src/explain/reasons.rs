//! The pages about the reasons for which a message is dropped, as counters and events name them.

use super::Entry;

macro_rules! reasons {
    ($($code:literal $title:literal;)*) => {
        /// All reasons that have a page in this file. A reason that is also a warning of the monitor is explained with
        /// the warning.
        pub(super) const ALL: &[Entry] = &[$(Entry {
            code: $code,
            title: $title,
            explanation: include_str!(concat!($code, ".md")),
        },)*];
    };
}

reasons! {
    "expired_on_the_way" "messages that came too late";
    "expired_in_transit" "messages that waited too long for their link";
    "duplicate" "copies of messages that were received before";
    "old_round" "messages of a waitfor that is over";
    "not_allowed" "packets that their port does not allow";
    "unroutable" "packets for tasks that no route leads to";
    "hop_limit" "packets that passed too many relays";
    "unexpected" "answers that nobody waits for any more";
    "stale_incarnation" "messages from before a restart";
    "superseded" "messages that a newer one replaced";
    "incomplete" "messages of which packets are missing";
    "stale_epoch" "commands of a task whose lease has passed";
}

#[cfg(test)]
mod tests {
    use super::super::page;
    use imrs_protocol::Reason;

    #[test]
    fn every_reason_for_a_drop_has_a_page() {
        for reason in Reason::ALL {
            let page = page(reason.name()).unwrap_or_else(|_| panic!("`{}` has no page", reason.name()));
            assert!(
                page.explanation.starts_with(&format!("# {}: {}\n", page.code, page.title)),
                "{}",
                page.code
            );
            assert!(page.explanation.contains("What to do: "), "{}", page.code);
        }
        assert_eq!(page("Hop-Limit").map(|page| page.code).ok(), Some("hop_limit"));
    }
}
