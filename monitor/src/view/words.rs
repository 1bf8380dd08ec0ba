//! Short texts about observations, for the lanes of the timeline and for tables.

use crate::store::Names;
use crate::store::journal::{Severity, level_of};
use crate::store::timeline::Mark;
use crate::theme::{Ink, Theme};
use imrs_protocol::{Event, Observation};

/// A very short text: `> beat#12` arrived, `beat#12 >` was sent, `* lift r3` is a rendezvous, `x` a loss, `^` a
/// rejection.
pub(super) fn short(mark: &Mark, names: &Names, theme: &Theme) -> String {
    let Observation { event, port, peer, number, .. } = mark.seen.what;
    let (port, peer) = (names.port_name(port), names.task(peer));
    let signs = theme.glyphs;
    let (to, dead, met) = (signs.arrow, signs.dead, signs.met);
    match event {
        Event::Sent => format!("{port}#{number} {to} {peer}"),
        Event::Resent => format!("{port}#{number} again {to} {peer}"),
        Event::Enqueued => format!("{to} {port}#{number} queued"),
        Event::Delivered => format!("{to} {port}#{number} taken"),
        Event::Replied => format!("answer {port}#{number} {to} {peer}"),
        Event::Answered => format!("{to} answer {port}#{number}"),
        Event::RefusedByPeer => format!("{dead} {port}#{number} refused by {peer}"),
        Event::TimedOut => format!("{dead} {port}#{number} timed out"),
        Event::TimedOutUnsent => format!("{dead} {port}#{number} timed out unsent"),
        Event::PeerRestarted => format!("{dead} {port}#{number}: {peer} restarted"),
        Event::Discarded(reason) if mark.in_transit => {
            format!("{dead} {port}#{number} {} in transit", reason.name())
        }
        Event::Discarded(reason) => format!("{dead} {port}#{number} {} ({peer})", reason.name()),
        Event::Reached => format!("{met} {port} r{number} reached"),
        Event::Rejoined => format!("{met} {port} r{number} rejoined"),
        Event::PartnerArrived => format!("{to} {port} r{number} {peer} is there"),
        Event::PartnerAborted => format!("{to} {port} r{number} {peer} gave up"),
        Event::Confirmed => format!("{port} r{number} confirm {to}"),
        Event::ReleasedComplete => format!("{met} {port} r{number} released"),
        Event::ReleasedByConfirm => format!("{met} {port} r{number} released (confirm)"),
        Event::WithinMargin => format!("{met} {port} r{number} too late to release"),
        Event::GaveUp => format!("{dead} {port} r{number} gave up"),
        Event::Rejected => format!("{} {port}#{number} rejected", signs.penalty),
        Event::Interrupted => "handler begins".to_owned(),
        Event::Resumed => "handler ends".to_owned(),
        Event::Granted => format!("lease epoch {number} granted"),
        Event::TookOver => format!("took over, epoch {number}"),
        Event::Fenced => format!("fenced, epoch {number}"),
    }
}

pub(super) fn ink(event: Event) -> Ink {
    match level_of(event) {
        Severity::Trace | Severity::Note => Ink::Plain,
        Severity::Warn => Ink::Warn,
        Severity::Bad => Ink::Bad,
    }
}
