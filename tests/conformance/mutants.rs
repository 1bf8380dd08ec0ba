//! Faults of a runtime, each as it would appear in a recording.
//!
//! Each input is recorded with the digest of the machine's outputs up to that input. If a runtime deviates from the
//! verified machine, the inputs and the digests do not match.
#![allow(clippy::ptr_arg, reason = "all of them have one type, and some take records away")]

use imrs_protocol::{Contents, Incarnation, Input, Kind, Packet, Ticks};
use imrs_wire::recording::{Record, ScriptStep};

/// A fault of a runtime.
pub struct Mutant {
    /// The fault's description.
    pub name: &'static str,
    /// The node whose recording the fault changes.
    pub node: &'static str,
    /// Applies the fault to the records. Returns the position of the changed record, or `None` if the recording has no
    /// suitable place.
    pub make: fn(&mut Vec<Record>) -> Option<usize>,
}

pub const MUTANTS: &[Mutant] = &[
    Mutant { name: "an answer is given to the wrong ask", node: "na", make: wrong_ask },
    Mutant { name: "a time_out never fires", node: "na", make: no_time_out },
    Mutant { name: "a time_out fires too soon", node: "na", make: early_time_out },
    Mutant { name: "messages are taken out of their order", node: "nb", make: out_of_order },
    Mutant { name: "a signal is lost", node: "na", make: lost_signal },
    Mutant { name: "a packet is handed over twice", node: "nb", make: doubled },
    Mutant { name: "a packet is lost without a word", node: "nb", make: lost_packet },
    Mutant { name: "a message is kept though its life is over", node: "nb", make: kept_too_long },
    Mutant { name: "a message is dropped before its life is over", node: "nb", make: dropped_too_soon },
    Mutant {
        name: "a rejected message is offered before its back-off is over",
        node: "nb",
        make: short_penalty,
    },
    Mutant { name: "a step has the digest of another", node: "na", make: other_digest },
    Mutant { name: "the clock of a task runs twice as fast", node: "na", make: fast_clock },
    Mutant { name: "a packet is taken for one of another life", node: "nb", make: other_life },
    Mutant { name: "a bit of a message is another", node: "nb", make: other_bit },
    Mutant { name: "an arrival at a rendezvous is heard as a confirmation", node: "nb", make: other_kind },
    Mutant { name: "an action that ended is not told to its task", node: "nb", make: lost_action },
    Mutant { name: "a task asks for what its statements do not say", node: "na", make: other_request },
    Mutant { name: "an input at the end is written down nowhere", node: "na", make: lost_at_the_end },
];

/// The digest of the outputs after the input at `at`, and the digest before that input.
fn digests(records: &[Record], at: usize) -> Option<(u64, u64)> {
    let Record::Input { outputs, .. } = records.get(at)? else { return None };
    let before = records[..at].iter().rev().find_map(|record| match record {
        Record::Input { outputs, .. } => Some(*outputs),
        _ => None,
    })?;
    Some((*outputs, before))
}

/// Whether the machine had outputs for the input at `at`.
fn tells(records: &[Record], at: usize) -> bool {
    digests(records, at).is_some_and(|(after, before)| after != before)
}

/// The position of an input that `fits` accepts and that has outputs. If there are several, the one in the middle.
fn place(records: &[Record], fits: impl Fn(&Input) -> bool) -> Option<usize> {
    places(records, |records, at| {
        matches!(&records[at], Record::Input { input, .. } if fits(input)) && tells(records, at)
    })
}

fn places(records: &[Record], fits: impl Fn(&[Record], usize) -> bool) -> Option<usize> {
    let all: Vec<usize> = (1..records.len()).filter(|&at| fits(records, at)).collect();
    all.get(all.len() / 2).copied()
}

fn packet(wanted: impl Fn(&Packet) -> bool) -> impl Fn(&Input) -> bool {
    move |input| matches!(input, Input::Packet(packet) if wanted(packet))
}

const fn is_message(packet: &Packet) -> bool {
    matches!(packet.kind, Kind::Send | Kind::Query)
}

const fn is_time(input: &Input) -> bool {
    matches!(input, Input::Time | Input::TimeOut { .. })
}

/// Changes the input at a position.
fn change(
    records: &mut [Record],
    at: usize,
    change: impl FnOnce(&mut Ticks, &mut Input, &mut u64),
) -> Option<usize> {
    let Record::Input { elapsed, input, outputs, .. } = &mut records[at] else { return None };
    change(elapsed, input, outputs);
    Some(at)
}

fn change_packet(
    records: &mut [Record],
    wanted: impl Fn(&Packet) -> bool,
    how: impl FnOnce(&mut Packet),
) -> Option<usize> {
    let at = place(records, packet(wanted))?;
    change(records, at, |_, input, _| {
        if let Input::Packet(packet) = input {
            how(packet);
        }
    })
}

fn wrong_ask(records: &mut Vec<Record>) -> Option<usize> {
    let is_answer = |packet: &Packet| packet.kind == Kind::Response;
    change_packet(records, is_answer, |packet| packet.id.sequence = packet.id.sequence.plus(1))
}

fn no_time_out(records: &mut Vec<Record>) -> Option<usize> {
    let at = place(records, is_time)?;
    let Record::Input { elapsed, .. } = records.remove(at) else { return None };
    let next = (at..records.len()).find(|&at| matches!(records[at], Record::Input { .. }))?;
    change(records, next, |later, _, _| *later += elapsed)?;
    Some(at)
}

fn early_time_out(records: &mut Vec<Record>) -> Option<usize> {
    let long = |records: &[Record], at: usize| match &records[at] {
        Record::Input { elapsed, input, .. } => is_time(input) && elapsed.0 > 1_000 && tells(records, at),
        _ => false,
    };
    let at = places(records, long)?;
    change(records, at, |elapsed, input, _| {
        *elapsed = Ticks(elapsed.0 / 2);
        // The state machine checks its deadlines itself, and does not rely on the Timer's report, so this input is not
        // necessary.
        *input = Input::Time;
    })
}

fn out_of_order(records: &mut Vec<Record>) -> Option<usize> {
    let taken = |records: &[Record], at: usize| matches!(&records[at], Record::Input { input: Input::Packet(packet), .. } if is_message(packet));
    let all: Vec<usize> = (0..records.len()).filter(|&at| taken(records, at)).collect();
    let pair =
        all.windows(2).filter(|pair| tells(records, pair[0]) && tells(records, pair[1])).collect::<Vec<_>>();
    let &[first, second] = *pair.get(pair.len() / 2)? else { return None };
    let of = |at: usize| match &records[at] {
        Record::Input { input, .. } => Some(*input),
        _ => None,
    };
    let (one, other) = (of(first)?, of(second)?);
    change(records, first, |_, input, _| *input = other)?;
    change(records, second, |_, input, _| *input = one)?;
    Some(first)
}

fn lost_signal(records: &mut Vec<Record>) -> Option<usize> {
    let at = place(records, |_| true)?;
    let (_, before) = digests(records, at)?;
    change(records, at, |_, _, outputs| *outputs = before)
}

fn doubled(records: &mut Vec<Record>) -> Option<usize> {
    let at = place(records, packet(is_message))?;
    let mut again = records[at].clone();
    if let Record::Input { elapsed, .. } = &mut again {
        *elapsed = Ticks::ZERO;
    }
    records.insert(at + 1, again);
    // A runtime with this fault counts the copy, too, and has outputs that the machine does not have.
    let before = digests(records, at)?.1;
    change(records, at + 1, |_, _, outputs| *outputs ^= before)?;
    count_one_more(records);
    Some(at)
}

fn count_one_more(records: &mut [Record]) {
    for record in records {
        if let Record::Close { inputs, .. } = record {
            *inputs += 1;
        }
    }
}

fn lost_packet(records: &mut Vec<Record>) -> Option<usize> {
    let at = place(records, packet(is_message))?;
    records.remove(at);
    Some(at)
}

fn kept_too_long(records: &mut Vec<Record>) -> Option<usize> {
    change_packet(records, is_message, |packet| packet.remaining = Ticks(1))
}

fn dropped_too_soon(records: &mut Vec<Record>) -> Option<usize> {
    let at = place(records, packet(is_message))?;
    let (_, before) = digests(records, at)?;
    change(records, at, |_, _, outputs| *outputs = before)
}

fn short_penalty(records: &mut Vec<Record>) -> Option<usize> {
    let early = |records: &[Record], at: usize| {
        let waits = |at: usize| matches!(&records[at], Record::Input { input, .. } if is_time(input));
        waits(at - 1) && !tells(records, at - 1) && tells(records, at)
    };
    let at = places(records, early)?;
    let (after, _) = digests(records, at)?;
    change(records, at - 1, |_, _, outputs| *outputs = after)
}

fn other_digest(records: &mut Vec<Record>) -> Option<usize> {
    let at = place(records, |_| true)?;
    let other = (0..at / 2).rev().find_map(|other| digests(records, other))?.0;
    change(records, at, |_, _, outputs| *outputs = other)
}

fn fast_clock(records: &mut Vec<Record>) -> Option<usize> {
    for record in records.iter_mut() {
        if let Record::Input { elapsed, .. } = record {
            *elapsed = Ticks(elapsed.0.saturating_mul(2));
        }
    }
    Some(0)
}

fn other_life(records: &mut Vec<Record>) -> Option<usize> {
    change_packet(records, is_message, |packet| {
        packet.id.incarnation = Incarnation(packet.id.incarnation.0.wrapping_add(1));
    })
}

fn other_bit(records: &mut Vec<Record>) -> Option<usize> {
    change_packet(
        records,
        |packet| is_message(packet) && !packet.contents.as_bytes().is_empty(),
        |packet| {
            let mut bytes = packet.contents.as_bytes().to_vec();
            bytes[0] ^= 1;
            packet.contents = Contents::new(&bytes).expect("as many bytes as before");
        },
    )
}

fn other_kind(records: &mut Vec<Record>) -> Option<usize> {
    change_packet(records, |packet| packet.kind == Kind::Arrive, |packet| packet.kind = Kind::Confirm)
}

fn lost_action(records: &mut Vec<Record>) -> Option<usize> {
    let acted = |records: &[Record], at: usize| {
        matches!(records[at], Record::Script { step: ScriptStep::Acted { .. }, .. })
    };
    let at = places(records, acted)?;
    records.remove(at);
    Some(at)
}

fn other_request(records: &mut Vec<Record>) -> Option<usize> {
    let asks = |input: &Input| matches!(input, Input::Request(_));
    let at = place(records, asks)?;
    let other = records[..at].iter().rev().find_map(|record| match (record, &records[at]) {
        (Record::Input { input: other @ Input::Request(_), .. }, Record::Input { input, .. })
            if other != input =>
        {
            Some(*other)
        }
        _ => None,
    })?;
    change(records, at, |_, input, _| *input = other)
}

fn lost_at_the_end(records: &mut Vec<Record>) -> Option<usize> {
    count_one_more(records);
    records.iter().position(|record| matches!(record, Record::Close { .. }))
}
