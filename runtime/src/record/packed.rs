//! Packs the inputs of a communication task and its script into words of a [`lane`](crate::sync::lane). The inputs
//! that occur with every message are packed by few instructions; others are encoded with postcard. This format never
//! leaves the process.
//!
//! ```text
//! word 0   tag 8 | more about it 24 | elapsed 32        word 1   digest        2, 3   ports, tasks, numbers
//! word 4   a time                                       5, 6     contents
//! ```

use super::Step;
use crate::sync::lane;
use imrs_protocol::{
    CONTENTS_BYTES, Class, Contents, Incarnation, Input, Kind, MessageId, Packet, PortId, ReplyTo, Request,
    Seal, Seq24, Target, TaskId, Ticks,
};
use imrs_wire::recording::ScriptStep;

/// The number of words of a slot, which is a cache line. Every input that is not encoded with postcard fits into one slot.
const WORDS: usize = 8;
type Words = [u64; WORDS];
pub(super) type Fill = lane::Fill<WORDS>;
pub(super) type Drain = lane::Drain<WORDS>;

const TIME: u64 = 0;
const PACKET: u64 = 1;
const SEND: u64 = 2;
const GET: u64 = 3;
const REPLY: u64 = 4;
const LONG: u64 = 5;
const SCRIPT: u64 = 6;
const GAP: u64 = 7;
const KEYFRAME: u64 = 8;

/// The size of a buffer that is large enough for any input, encoded with postcard.
const LONGEST: usize = 256;
const SLOT_BYTES: usize = WORDS * size_of::<u64>();

/// One entry of a lane, read back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Entry {
    Input {
        step: Step,
        outputs: u64,
    },
    Script {
        step: ScriptStep,
        done: u64,
    },
    /// This many records were lost.
    Gap {
        lost: u64,
    },
    /// The mark of a keyframe. The keyframe's state is the next one in the queue of states beside the lane.
    Keyframe {
        outputs: u64,
    },
    /// Words that cannot be decoded, because of a fault in this module. The entry counts as a lost record.
    Unreadable,
}

/// Puts an input into the lane, if there is room.
#[inline]
pub(super) fn step(fill: &mut Fill, step: &Step, outputs: u64, crowded: impl FnOnce()) -> bool {
    let Ok(elapsed) = u32::try_from(step.elapsed.0) else { return long(fill, step, outputs, crowded) };
    let head = |tag, more: u64| u64::from(elapsed) << 32 | more << 8 | tag;
    match step.input {
        Input::Time => one(fill, [head(TIME, 0), outputs, 0, 0, 0, 0, 0, 0], crowded),
        Input::Packet(ref packet) => {
            let Packet { kind, class, more, resent, hops, fragment, .. } = *packet;
            let Packet { destination, source, port, id, remaining, ref contents, .. } = *packet;
            let flags = u64::from(more) << 4 | u64::from(resent) << 5;
            let status = u64::from(class == Class::Status) << 3;
            let how = kind as u64 | status | flags;
            let how = head(PACKET, how | u64::from(hops) << 8 | u64::from(fragment) << 16);
            let ends = u64::from(destination.0) | u64::from(source.0) << 16 | u64::from(port.0) << 32;
            let (len, first, last) = words(contents);
            one(fill, [how, outputs, ends | len << 48, number(id), remaining.0, first, last, 0], crowded)
        }
        Input::Request(Request::Send { port, to, ref contents, time_out }) => {
            let (to, whom) = match to {
                Target::All => (0, 0),
                Target::One(task) => (1, u64::from(task.0)),
                Target::Some(parties) => (2, parties),
            };
            let how = head(SEND, to | u64::from(time_out.is_some()) << 2);
            let (len, first, last) = words(contents);
            let time_out = time_out.unwrap_or(Ticks::ZERO).0;
            one(fill, [how, outputs, u64::from(port.0) | len << 48, whom, time_out, first, last, 0], crowded)
        }
        Input::Request(Request::Get { port, source, time_out }) => {
            let given = u64::from(port.is_some())
                | u64::from(source.is_some()) << 1
                | u64::from(time_out.is_some()) << 2;
            let ends = port.map_or(0, |port| u64::from(port.0));
            let ends = ends | source.map_or(0, |source| u64::from(source.0) << 16);
            let time_out = time_out.unwrap_or(Ticks::ZERO).0;
            one(fill, [head(GET, given), outputs, ends, 0, time_out, 0, 0, 0], crowded)
        }
        Input::Request(Request::Reply { to, ref contents }) => {
            let ends = u64::from(to.port.0) | u64::from(to.source.0) << 16;
            let (len, first, last) = words(contents);
            one(fill, [head(REPLY, 0), outputs, ends | len << 48, number(to.id), 0, first, last, 0], crowded)
        }
        _ => long(fill, step, outputs, crowded),
    }
}

/// Puts a step of a script into the lane, if there is room.
pub(super) fn script(fill: &mut Fill, step: ScriptStep, done: u64, crowded: impl FnOnce()) -> bool {
    let (which, what) = match step {
        ScriptStep::Begin { at } => (0, at),
        ScriptStep::Acted { level, ok, value } => {
            let value = u64::from(u32::from_ne_bytes(value.to_ne_bytes()));
            (1, u64::from(level) | u64::from(ok) << 8 | value << 32)
        }
        ScriptStep::Chosen(choice) => (2, u64::from(choice)),
        ScriptStep::Stopped => (3, 0),
    };
    one(fill, [which << 8 | SCRIPT, done, what, 0, 0, 0, 0, 0], crowded)
}

/// Puts a gap for the lost records and the mark of a keyframe into the lane: both or, if there is no room, neither.
pub(super) fn keyframe(fill: &mut Fill, lost: u64, outputs: u64) -> bool {
    let room = fill.has_room(2, || ());
    if room {
        if lost > 0 {
            fill.put([GAP, 0, lost, 0, 0, 0, 0, 0]);
        }
        fill.put([KEYFRAME, outputs, 0, 0, 0, 0, 0, 0]);
        fill.publish();
    }
    room
}

#[inline]
fn one(fill: &mut Fill, words: Words, crowded: impl FnOnce()) -> bool {
    let room = fill.has_room(1, crowded);
    if room {
        fill.put(words);
        fill.publish();
    }
    room
}

/// Puts any input into the lane, encoded with postcard. An input longer than the buffer is treated as one for which
/// the lane has no room.
#[cold]
fn long(fill: &mut Fill, step: &Step, outputs: u64, crowded: impl FnOnce()) -> bool {
    let mut bytes = [0; LONGEST];
    let Ok(used) = postcard::to_slice(&step.input, &mut bytes) else { return false };
    let used = used.len();
    let slots = used.div_ceil(SLOT_BYTES);
    let room = fill.has_room(1 + slots, crowded);
    if room {
        fill.put([(used as u64) << 8 | LONG, outputs, step.elapsed.0, 0, 0, 0, 0, 0]);
        let (words, _) = bytes.as_chunks::<8>();
        for slot in words.chunks_exact(WORDS).take(slots) {
            fill.put(std::array::from_fn(|word| u64::from_le_bytes(slot[word])));
        }
        fill.publish();
    }
    room
}

/// Takes the next entry, if it lies before `until`, and frees its slots.
pub(super) fn take(drain: &mut Drain, until: usize) -> Option<Entry> {
    let words = drain.next(until)?;
    let entry = read(words, || drain.next(until));
    drain.give_back();
    Some(entry.unwrap_or(Entry::Unreadable))
}

fn read(words: Words, mut next: impl FnMut() -> Option<Words>) -> Option<Entry> {
    let [head, digest, a, b, time, first, last, _] = words;
    let more = head >> 8 & 0xff_ffff;
    let input = match head & 0xff {
        TIME => Input::Time,
        PACKET => Input::Packet(packet(more, a, b, time, contents(a >> 48, first, last)?)),
        SEND => {
            let to = match more & 3 {
                0 => Target::All,
                1 => Target::One(TaskId(half(b))),
                _ => Target::Some(b),
            };
            let time_out = (more & 4 != 0).then_some(Ticks(time));
            let contents = contents(a >> 48, first, last)?;
            Input::Request(Request::Send { port: PortId(half(a)), to, contents, time_out })
        }
        GET => Input::Request(Request::Get {
            port: (more & 1 != 0).then_some(PortId(half(a))),
            source: (more & 2 != 0).then_some(TaskId(half(a >> 16))),
            time_out: (more & 4 != 0).then_some(Ticks(time)),
        }),
        REPLY => {
            let to = ReplyTo { port: PortId(half(a)), source: TaskId(half(a >> 16)), id: id(b) };
            Input::Request(Request::Reply { to, contents: contents(a >> 48, first, last)? })
        }
        LONG => {
            let mut bytes = Vec::with_capacity(LONGEST);
            let used = usize::try_from(more).ok()?;
            while bytes.len() < used {
                bytes.extend(next()?.iter().flat_map(|word| word.to_le_bytes()));
            }
            let input = postcard::from_bytes(&bytes).ok()?;
            return Some(Entry::Input { step: Step { elapsed: Ticks(a), input }, outputs: digest });
        }
        SCRIPT => return Some(Entry::Script { step: script_step(more, a), done: digest }),
        GAP => return Some(Entry::Gap { lost: a }),
        KEYFRAME => return Some(Entry::Keyframe { outputs: digest }),
        _ => return None,
    };
    Some(Entry::Input { step: Step { elapsed: Ticks(head >> 32), input }, outputs: digest })
}

fn packet(how: u64, ends: u64, number: u64, remaining: u64, contents: Contents) -> Packet {
    let [flags, hops, fragment, ..] = how.to_le_bytes();
    Packet {
        kind: Kind::ALL[usize::from(flags & 7)],
        class: if flags & 8 == 0 { Class::Command } else { Class::Status },
        more: flags & 16 != 0,
        resent: flags & 32 != 0,
        hops,
        fragment,
        destination: TaskId(half(ends)),
        source: TaskId(half(ends >> 16)),
        port: PortId(half(ends >> 32)),
        id: id(number),
        remaining: Ticks(remaining),
        contents,
        seal: Seal::NONE,
    }
}

fn script_step(which: u64, what: u64) -> ScriptStep {
    match which {
        0 => ScriptStep::Begin { at: what },
        1 => {
            let [level, ok, _, _, a, b, c, d] = what.to_le_bytes();
            ScriptStep::Acted { level, ok: ok != 0, value: i32::from_le_bytes([a, b, c, d]) }
        }
        2 => ScriptStep::Chosen(half(what)),
        _ => ScriptStep::Stopped,
    }
}

/// The length of the contents, and all their bytes, as three numbers.
#[inline]
fn words(contents: &Contents) -> (u64, u64, u64) {
    const { assert!(CONTENTS_BYTES == 12) };
    let [a, b, c, d, e, f, g, h, i, j, k, l] = *contents.padded();
    let first = u64::from_le_bytes([a, b, c, d, e, f, g, h]);
    (contents.as_bytes().len() as u64, first, u64::from(u32::from_le_bytes([i, j, k, l])))
}

fn contents(len: u64, first: u64, last: u64) -> Option<Contents> {
    let mut bytes = [0; 16];
    bytes[..8].copy_from_slice(&first.to_le_bytes());
    bytes[8..].copy_from_slice(&last.to_le_bytes());
    Contents::new(bytes.get(..usize::try_from(len).ok()?)?)
}

const fn number(id: MessageId) -> u64 {
    (id.incarnation.0 as u64) << 32 | id.sequence.get() as u64
}

fn id(number: u64) -> MessageId {
    let [a, b, c, _, incarnation, ..] = number.to_le_bytes();
    MessageId {
        incarnation: Incarnation(incarnation),
        sequence: Seq24::new(u32::from_le_bytes([a, b, c, 0])),
    }
}

/// The lowest 16 bits of a word.
fn half(word: u64) -> u16 {
    let [a, b, ..] = word.to_le_bytes();
    u16::from_le_bytes([a, b])
}
