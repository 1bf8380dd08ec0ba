//! Scenarios that are small enough to explore in a moment.

use imrs_model::worlds::{Exchange, Meeting};
use imrs_model::{Budget, Reductions, Scenario, Watch};
use imrs_protocol::rules::{Confirmation, Rules};
use std::sync::Arc;

/// A meeting in which packets take up to one tick and arrivals are retransmitted every two ticks.
pub fn timed(members: usize, watch: Watch, loss: u8, margin: u64, time_out: u64) -> Meeting {
    Meeting {
        time_out: Some(time_out),
        delay: Some(1),
        resend: Some(2),
        losses: loss,
        margin: Some(margin),
        budget: Budget { loss, dup: 0, crash: 0 },
        ..Meeting::new(members, watch)
    }
}

/// A meeting of members that meet without end, on a network that delays and loses packets.
pub fn endless(members: usize, loss: u8) -> Meeting {
    let budget = Budget { loss, dup: 0, crash: 0 };
    Meeting { attempts: None, delay: Some(1), budget, ..Meeting::new(members, Watch::Pairing) }
}

/// A meeting without time in which every packet is sent once, with up to `loss` losses, to find out whether a member is
/// stranded.
pub fn literal(members: usize, confirmation: Confirmation, loss: u8) -> Meeting {
    let rules = Rules { confirmation, answer_late_arrivals: false, ..Rules::DEFAULT };
    let budget = Budget { loss, dup: 0, crash: 0 };
    Meeting { rules, budget, ..Meeting::new(members, Watch::Stranded) }
}

/// The least number of lost packets that strands a member.
pub fn least_losses(members: usize, confirmation: Confirmation) -> u8 {
    let strands = |loss: &u8| {
        let scenario = scenario(&literal(members, confirmation, *loss));
        imrs_model::explore(&scenario, imrs_model::Limits::default(), None).violation.is_some()
    };
    (0..12).find(strands).expect("twelve losses strand a member under any rule")
}

/// A scenario of commands with a retransmission, a loss and a duplicate.
pub fn commands(watch: Watch) -> Exchange {
    Exchange { retry: (1, 2), budget: Budget { loss: 1, dup: 1, crash: 0 }, ..Exchange::new(watch) }
}

pub fn scenario(meeting: &Meeting) -> Arc<Scenario> {
    meeting.scenario().expect("a declaration without faults")
}

pub fn with(reductions: Reductions, meeting: &Meeting) -> Arc<Scenario> {
    scenario(&Meeting { reductions, ..meeting.clone() })
}
