//! Packets and signals in words.

use imrs_protocol::{Answers, Call, Control, Kind, Outcome, Packet, ReleasedBy, Signal};

/// A packet in words: `SEND T0>T1 #3 [7] for 20`.
#[must_use]
pub fn packet(p: &Packet) -> String {
    let way = format!("{}>{}", p.source, p.destination);
    let what = match (p.kind, p.control()) {
        (Kind::Arrive, _) => format!("ARRIVE {way} {}", p.meeting().round),
        (Kind::Confirm, _) => format!("CONFIRM {way} {}", p.meeting().round),
        (Kind::Abort, _) => format!("ABORT {way} {} next {}", p.meeting().round, p.meeting().next_round()),
        (Kind::Control, Some(control)) => {
            let word = match control {
                Control::Refused => "REFUSED",
                Control::RefusedOnTheWay => "REFUSED ON THE WAY",
                Control::Restarted => "RESTARTED",
            };
            format!("{word} {way} #{}", p.id.sequence.get())
        }
        (kind, _) => {
            let word = format!("{kind:?}").to_uppercase();
            format!("{word} {way} #{} {:?}", p.id.sequence.get(), p.contents.as_bytes())
        }
    };
    format!("{what} for {}{}", p.remaining, if p.resent { " again" } else { "" })
}

/// A signal in words.
#[must_use]
pub fn signal(s: &Signal) -> String {
    match s {
        Signal::Accepted(copies) => format!("accepted {copies}"),
        Signal::Fault(fault) => format!("fault {fault:?}"),
        Signal::Outcome(Outcome::Reply(contents)) => format!("reply {:?}", contents.as_bytes()),
        Signal::Outcome(outcome) => format!("{outcome:?}"),
        Signal::Message(d) => {
            format!("message {:?} from {} for {}", d.contents.as_bytes(), d.from.source, d.budget)
        }
        Signal::Nothing => "nothing".into(),
        Signal::Released { round, by: ReleasedBy::AllArrived, .. } => format!("released {round} complete"),
        Signal::Released { round, by: ReleasedBy::Confirm(task), .. } => {
            format!("released {round} by {task}")
        }
        Signal::GaveUp { round, missing, .. } => format!("gave up {round} missing {missing:#b}"),
        Signal::TimeOut(id) => format!("time_out {}", id.0),
        Signal::Cancelled => "cancelled".into(),
        Signal::Answers { answers, .. } => {
            let Answers { asked, answered, refused, restarted, unsent } = answers;
            let named =
                [("answered", answered), ("refused", refused), ("restarted", restarted), ("unsent", unsent)];
            let marks =
                named.iter().filter(|(_, mask)| **mask != 0).map(|(name, mask)| format!(" {name} {mask:#b}"));
            format!("answers of {asked:#b}:{}", marks.collect::<String>())
        }
        Signal::Interrupt(Call::Message(d)) => {
            format!("interrupt {:?} from {} for {}", d.contents.as_bytes(), d.from.source, d.budget)
        }
        Signal::Interrupt(call) => format!("interrupt {call:?}"),
        Signal::Granted(epoch) => format!("granted {epoch}"),
    }
}
