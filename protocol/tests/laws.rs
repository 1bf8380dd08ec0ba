//! The laws of the machine, on random cells with random inputs: changes of a state that must not change its behaviour
//! (D51).

use crate::support::Effects;
use crate::support::NextExpiry;
use crate::support::bytes::checksum;
use crate::support::packing::{repack, without_arguments};
use crate::support::plan::{Plan, plans};
use crate::support::shift::Shift;
use crate::support::world::{Op, World, lively, ops};
use imrs_protocol::*;
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::TestRunner;
use std::collections::BTreeSet;

/// Runs the operations in two worlds. Before each operation, `change` may change the second world in a way that must not
/// change its behaviour. `same` makes the effects of both worlds comparable.
fn compare(
    plain: &mut World,
    other: &mut World,
    ops: &[Op],
    mut change: impl FnMut(usize, &mut World),
    same: impl Fn(&World, &Effects) -> Effects,
) -> Result<(), TestCaseError> {
    for (i, &op) in ops.iter().enumerate() {
        change(i, other);
        let (expected, found) = (plain.step(op), other.step(op));
        prop_assert_eq!(same(other, &found), same(plain, &expected), "operation {} {:?}", i, op);
        for task in 0..plain.tasks.len() {
            prop_assert_eq!(
                other.bytes(task),
                plain.bytes(task),
                "state of T{} after operation {} {:?}",
                task,
                i,
                op
            );
        }
    }
    Ok(())
}

fn exactly(_: &World, effects: &Effects) -> Effects {
    effects.clone()
}

/// Whether [`compare`] changes the second world before operation `i`. The bits of a random number decide.
fn picks(mask: u64, i: usize) -> bool {
    mask >> (i % 64) & 1 == 1
}

/// Rounds from which a port counts, on both sides of every wrap of 16 and of 24 bits.
const ROUNDS: [u16; 7] = [1, 0x7ff0, 0x7fff, 0x8000, 0xfff0, 0xfffe, 0xffff];
/// Epochs from which a couple counts, on both sides of a wrap. They are even, because a primary's epochs are odd (D80).
const EPOCHS: [u8; 7] = [2, 0x70, 0x7e, 0x80, 0xf0, 0xfc, 0xfe];
const SEQUENCES: [u32; 7] = [1, 0x7f_fff0, 0x7f_ffff, 0x80_0000, 0xff_fff0, 0xff_fffe, 0xff_ffff];

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    /// No input makes a task panic, not even a forged packet, and the invariants hold after every input (each step checks).
    #[test]
    fn every_input_is_taken_in_every_state(plan in plans(), ops in ops(), restarts: bool) {
        let mut world = World::new(&plan.build(), restarts);
        for op in ops {
            world.step(op);
        }
    }

    /// No bytes with a valid checksum make a task panic: every state accepts any packet that decodes.
    #[test]
    fn any_bytes_behind_a_right_checksum_are_harmless(
        plan in plans(),
        ops in ops(),
        datagrams in proptest::collection::vec(any::<[u8; PACKET_BYTES]>(), 1..20),
    ) {
        let table = plan.build();
        let mut world = World::new(&table, true);
        ops.iter().for_each(|&op| drop(world.step(op)));
        for mut bytes in datagrams {
            bytes[0] = bytes[0] & 0x3f | PACKET_VERSION << 6;
            for high in [3, 5, 7] {
                bytes[high] = 0;
            }
            for low in [2, 4, 6] {
                bytes[low] %= 4;
            }
            let hash = |port: PortId| table.port(port).map(|p| p.hash);
            let port = PortId(u16::from(bytes[6]));
            let crc = checksum(&bytes, table.digest(), hash(port).unwrap_or(0));
            bytes[28..].copy_from_slice(&crc.to_le_bytes());
            match Packet::decode(&bytes, table.digest(), hash) {
                Ok(packet) => drop(world.hear(packet, u64::from(bytes[20] % 4))),
                Err(PacketError::UnknownPort(unknown)) => prop_assert!(unknown == port && table.port(port).is_none()),
                Err(error) => prop_assert_eq!(error, PacketError::Malformed),
            }
        }
    }

    /// Letting `a + b` pass equals letting `a` and then `b` pass, if `a` ends before the next expiry.
    #[test]
    fn time_may_be_given_in_pieces(plan in plans(), ops in ops(), cut: u64) {
        let mut plain = World::new(&plan.build(), true);
        let mut other = plain.clone();
        other.looks_around = true;
        for (i, &op) in ops.iter().enumerate() {
            let task = usize::from(op.1) % plain.tasks.len();
            let elapsed = match op.0 % 16 { 0 | 1 => u64::from(op.2 % 12), 12 => u64::from(op.2 % 90), _ => 0 };
            let quiet = other.tasks[task].next_expiry().map_or(elapsed, |due| due.0.saturating_sub(1)).min(elapsed);
            let expected = plain.step(op);
            let found = if quiet > 0 {
                let piece = cut.rotate_left(u32::try_from(i).unwrap()) % (quiet + 1);
                let before = other.pass(task, piece);
                prop_assert!(before == Effects::default(), "{:?} before the next expiry", before);
                other.pass(task, elapsed - piece)
            } else {
                other.step(op)
            };
            prop_assert_eq!(&found, &expected);
            for t in 0..plain.tasks.len() {
                prop_assert_eq!(other.bytes(t), plain.bytes(t));
            }
        }
    }

    /// `next_expiry` is exact: one tick earlier nothing happens, and at that instant something does.
    #[test]
    fn the_next_expiry_is_when_something_happens(plan in plans(), ops in ops()) {
        let mut world = World::new(&plan.build(), true);
        for op in ops {
            world.step(op);
            for task in 0..world.tasks.len() {
                let mut ahead = world.clone();
                ahead.looks_around = true;
                match ahead.tasks[task].next_expiry() {
                    None => {
                        let never = ahead.pass(task, 1_000_000);
                        prop_assert!(never == Effects::default(), "{:?}", never);
                    }
                    Some(due) => {
                        if due.0 > 0 {
                            let early = ahead.pass(task, due.0 - 1);
                            prop_assert!(early == Effects::default(), "{:?}", early);
                        }
                        let on_time = ahead.pass(task, u64::from(due.0 > 0));
                        let residence = ahead.tables[task].rules().charge_residence;
                        prop_assert!(!residence || on_time != Effects::default(), "nothing after {}", due);
                    }
                }
            }
        }
    }

    /// The clock of a task may be set back to zero at any moment, without an effect.
    #[test]
    fn rebase_changes_nothing(plan in plans(), ops in ops(), mask: u64) {
        let mut plain = World::new(&plan.build(), true);
        let mut other = plain.clone();
        let rebase = |i, world: &mut World| if picks(mask, i) { world.rebase() };
        compare(&mut plain, &mut other, &ops, rebase, exactly)?;
    }

    /// Tests that behaviour does not depend on how large the counter of the clock is.
    #[test]
    fn a_counter_near_its_end_behaves_as_one_at_zero(plan in plans(), ops in ops(), back in 20_000..40_000_u64) {
        let mut plain = World::new(&plan.build(), true);
        let mut other = plain.clone();
        for &op in &ops {
            prop_assert_eq!(other.step(op), plain.step(op));
            if other.flying.len() == 3 {
                break;
            }
        }
        let late = u64::MAX - back;
        for task in 0..plain.tasks.len() {
            // A wait of zero length is due whatever the counter of the clock is, so it must end first.
            prop_assert_eq!(other.pass(task, 0), plain.pass(task, 0));
        }
        for (task, table) in other.tasks.iter_mut().zip(&other.tables) {
            task.bury();
            task.rebase(table);
            task.walk(table, &mut Later(late));
            let mut out = Effects::default();
            // Under the variant without residence, waiting messages regain the time that passes.
            if table.rules().charge_residence {
                task.handle(table, Instant(late), &Input::Time, &mut out);
            } else {
                task.walk(table, &mut Earlier(late));
            }
            prop_assert_eq!(out, Effects::default());
        }
        compare(&mut plain, &mut other, &ops, |_, _| (), exactly)?;
    }

    /// Adding a constant to all sequences of a source, and to all rounds of a port, changes nothing else, even if these
    /// numbers wrap.
    #[test]
    fn ids_may_start_anywhere(plan in plans(), ops in ops(), at in 0..60_usize, bases in any::<[u8; 8]>()) {
        let table = plan.build();
        let mut plain = World::new(&table, true);
        let at = at.min(ops.len());
        for &op in &ops[..at] {
            plain.step(op);
        }
        let base = |i: usize| usize::from(bases[i % 8]) % 7;
        let shift = Shift {
            sequences: (0..table.cell().tasks.len()).map(|t| SEQUENCES[base(t)]).collect(),
            rounds: (0..table.ports().len()).map(|p| ROUNDS[base(4 + p)]).collect(),
            ..Shift::none(&table)
        };
        let mut other = plain.clone().moved(shift);
        compare(&mut plain, &mut other, &ops[at..], |_, _| (), |world, effects| world.shift.back().effects(effects))?;
    }

    /// Adding an even constant to all epochs of a couple changes nothing else, even if the epochs wrap.
    #[test]
    fn epochs_may_start_anywhere(
        plan in plans().prop_map(Plan::coupled),
        ops in lively(),
        at in 0..60_usize,
        base in 0..EPOCHS.len(),
    ) {
        let table = plan.build();
        // A guarded command keeps its epoch in its contents for retransmission, and the shift does not change that copy.
        prop_assume!(!table.ports().iter().any(|p| p.decl.guard.is_some() && p.decl.class == Class::Command));
        let mut plain = World::new(&table, true);
        let at = at.min(ops.len());
        for &op in &ops[..at] {
            plain.step(op);
        }
        let mut other = plain.clone().moved(Shift { epochs: EPOCHS[base], ..Shift::none(&table) });
        compare(&mut plain, &mut other, &ops[at..], |_, _| (), |world, effects| world.shift.back().effects(effects))?;
    }

    /// The parts of a state that `bury` drops can never have an effect again.
    #[test]
    fn burying_changes_nothing(plan in plans(), ops in ops(), mask: u64) {
        let mut plain = World::new(&plan.build(), true);
        let mut other = plain.clone();
        let bury = |i, world: &mut World| if picks(mask, i) { world.tasks.iter_mut().for_each(CommTask::bury) };
        compare(&mut plain, &mut other, &ops, bury, exactly)?;
    }

    /// A packet that a task ignores stays ignored: it causes no signal and no change of state, and a CONFIRM that answers it
    /// has no effect either.
    #[test]
    fn what_is_ignored_stays_ignored(plan in plans(), ops in ops()) {
        let mut world = World::new(&plan.build(), false);
        let mut ignored: Vec<Packet> = Vec::new();
        for op in ops {
            // The reduction assumes that no packet is forged and no node restarts.
            if op.0 % 16 == 14 || (op.0 % 16 == 15 && op.2 % 4 == 2) {
                continue;
            }
            world.step(op);
            ignored.extend(world.flying.iter().filter(|p| ignores(&world, p)).copied());
            for packet in &ignored {
                prop_assert!(ignores(&world, packet), "no longer after {:?}: {:?}", op, packet);
                let mut with = world.clone();
                let out = with.hear(*packet, 0);
                prop_assert!(out.signals.is_empty() && out.timers.is_empty(), "{:?} after {:?}", out, packet);
                let at = packet.destination.index();
                prop_assert_eq!(with.bytes(at), world.bytes(at), "state after {:?}", packet);
                for answer in &out.packets {
                    let mut answered = with.clone();
                    let out = answered.hear(*answer, 0);
                    prop_assert!(out.is_nothing(), "{:?} provokes {:?}: {:?}", packet, answer, out);
                    let back = answer.destination.index();
                    prop_assert_eq!(answered.bytes(back), with.bytes(back), "state after {:?}", answer);
                }
            }
            ignored.truncate(20);
        }
    }

    /// A state that was packed and read back behaves as the original, and packs to the same bytes.
    #[test]
    fn a_packed_state_behaves_as_the_original(plan in plans(), ops in ops(), restarts: bool, mask: u64) {
        let mut plain = World::new(&plan.build(), restarts);
        let mut other = plain.clone();
        let repack = |i, world: &mut World| if picks(mask, i) { (0..world.tasks.len()).for_each(|t| repack(world, t)) };
        compare(&mut plain, &mut other, &ops, repack, |_, effects| without_arguments(effects))?;
    }
}

/// The random runs of these tests must reach every event and outcome, because they prove nothing about others.
#[test]
fn random_runs_reach_every_event_and_outcome() {
    let mut runner = TestRunner::deterministic();
    let mut seen = BTreeSet::new();
    for _ in 0..2000 {
        let (plan, ops) = (plans(), ops()).new_tree(&mut runner).expect("a plan").current();
        let mut world = World::new(&plan.build(), true);
        for op in ops {
            let out = world.step(op);
            seen.extend(out.observations.iter().map(|o| format!("{:?}", o.event)));
            seen.extend(out.signals.iter().map(|s| match s {
                Signal::Outcome(Outcome::Reply(_)) => "Reply".into(),
                Signal::Outcome(outcome) => format!("{outcome:?}"),
                Signal::Fault(fault) => format!("{fault:?}"),
                Signal::Released { by: ReleasedBy::Confirm(_), .. } => "Released by CONFIRM".into(),
                Signal::Interrupt(Call::Timer(_)) => "Interrupt by a timer".into(),
                other => format!("{other:?}").split(['(', ' ']).next().unwrap_or_default().to_owned(),
            }));
        }
    }
    let expected = [
        "Accepted",
        "Answered",
        "Answers",
        "Busy",
        "Cancelled",
        "Confirmed",
        "Delivered",
        "Discarded(Duplicate)",
        "Discarded(Evicted)",
        "Discarded(Expired)",
        "Discarded(ExpiredOnTheWay)",
        "Discarded(NotAllowed)",
        "Discarded(OldRound)",
        "Discarded(Incomplete)",
        "Discarded(Refused)",
        "Discarded(Superseded)",
        "Discarded(StaleIncarnation)",
        "Discarded(Unexpected)",
        "Enqueued",
        "Fenced",
        "GaveUp",
        "Granted",
        "Interrupt",
        "Interrupt by a timer",
        "Interrupted",
        "Late",
        "Message",
        "NotAPeer",
        "NotInterrupted",
        "NotYourPort",
        "Nothing",
        "NothingToAnswer",
        "PartnerAborted",
        "PartnerArrived",
        "PeerRestarted",
        "Reached",
        "Refused",
        "RefusedByPeer",
        "Rejected",
        "Rejoined",
        "Released",
        "Released by CONFIRM",
        "ReleasedByConfirm",
        "ReleasedComplete",
        "Replied",
        "Reply",
        "Resent",
        "Resumed",
        "Sent",
        "TimeOut",
        "TimedOut",
        "TimedOutUnknown",
        "TimedOutUnsent",
        "TookOver",
        "WithinMargin",
        "WrongLength",
        "WrongUsage",
    ];
    let missing: Vec<_> = expected.iter().filter(|&&e| !seen.contains(e)).collect();
    assert!(missing.is_empty(), "never reached: {missing:?}; reached: {seen:?}");
}

fn ignores(world: &World, packet: &Packet) -> bool {
    let (to, from) = (packet.destination.index(), packet.source.index());
    world.tasks[to].ignores(&world.tables[to], packet, &world.tasks[from])
}

struct Later(u64);

impl Walk for Later {
    const PASS: Pass = Pass::Change;

    fn instant(&mut self, instant: &mut Instant) {
        *instant += Ticks(self.0);
    }
}

struct Earlier(u64);

impl Walk for Earlier {
    const PASS: Pass = Pass::Change;

    fn instant(&mut self, instant: &mut Instant) {
        if *instant != Instant::NEVER {
            *instant = *instant - Ticks(self.0);
        }
    }
}
