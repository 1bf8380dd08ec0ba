//! For each kind of finding, the advice that usually helps.

use imrs_model::cell::Kind;

/// The advice that usually helps against this kind of finding.
pub(super) const fn help(kind: Kind) -> &'static str {
    match kind {
        Kind::Deadlock => {
            "let one of them give up (`within .. on time_out do ..`), or do first what the others wait for"
        }
        Kind::TimeOut => "let the other side answer sooner, or give the message a longer time_out",
        Kind::Starves => "let it age (`penalty = T` without `paper`), or rank it before what goes first",
        Kind::Stranded => "let the others arrive in time, or give the waitfor a longer time_out",
        Kind::Refused => {
            "make the buffer larger (`bounded_buffer[n]`), or let the receiver take its messages sooner"
        }
        Kind::Ends => {
            "declare what happens then: `on time_out do .. end`, `on refused do .. end`, `on failed do .. end`"
        }
        Kind::Aborts => "nothing had gone wrong: look at what leads there, or do something else than abort",
        Kind::LeaseLost => {
            "let the standby go on in an endless `loop` until it takes over, or give the couple a longer lease"
        }
        Kind::Assertion => "correct what leads to these values, or what is asserted",
        Kind::ScriptFault => "take a wider type, or keep the values in range",
        Kind::Check => "correct what the tasks above do there, or the check",
        Kind::TwoOwners => "give the couple a longer takeover or a shorter lease",
        Kind::Unreached => "remove it, or correct the condition that keeps it from being reached",
        Kind::Vacuous => "correct the left side of the check, or what should make it true",
        Kind::Standstill => {
            "let one of them release what it holds, or end its loop after some tries; if waiting for ever is intended, ignore this"
        }
        Kind::WaitsForEver => {
            "let it wait for a time (`receive .. within T on time_out do ..`), or let the others go on (a standby: in an endless `loop`); where it has nothing left to do then, nothing is to be done"
        }
        Kind::Machine => "this is a fault of imrs, not of the cell: please report it with the file",
    }
}
