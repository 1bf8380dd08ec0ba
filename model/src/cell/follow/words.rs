//! Compares and describes what a run and the model did.

use super::run::Turn;
use imrs_protocol::script::ScriptInput;
use imrs_protocol::{Call, CellTable, Outcome, Packet, PortId, Signal, Ticks};

pub(super) fn port_name(table: &CellTable, port: PortId) -> String {
    table.port(port).map_or_else(|| "?".into(), |port| format!("`{}`", port.decl.name))
}

/// An input in a few words.
pub(super) fn said(input: &ScriptInput) -> String {
    match input {
        ScriptInput::Begin => "begins".into(),
        ScriptInput::Acted { ok: true, value, .. } => format!("the action ends: {value}"),
        ScriptInput::Acted { ok: false, .. } => "the action fails".into(),
        ScriptInput::Chosen(choice) => format!("chooses {choice}"),
        ScriptInput::Signal(signal) => match signal {
            Signal::Outcome(Outcome::Reply(_)) => "is answered".into(),
            Signal::Released { round, .. } => format!("is released from round {}", round.0),
            other => format!("{other:?}"),
        },
    }
}

/// The packet without the fields that relays and time change: its remaining time and hops.
pub(super) fn named(packet: &Packet) -> Packet {
    Packet { remaining: Ticks::ZERO, hops: 0, ..*packet }
}

/// Whether two script steps are equal except for remaining times, which the run and the model count in different units.
pub(super) fn alike(a: &Turn, b: &Turn) -> bool {
    (a.at, &a.passed, a.end) == (b.at, &b.passed, b.end) && plain(a.input) == plain(b.input)
}

/// A script's input without the remaining time of its message.
pub(in crate::cell) fn plain(mut input: ScriptInput) -> ScriptInput {
    if let ScriptInput::Signal(Signal::Message(delivery) | Signal::Interrupt(Call::Message(delivery))) =
        &mut input
    {
        delivery.budget = Ticks::ZERO;
    }
    input
}
