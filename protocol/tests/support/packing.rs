//! Packs states and reads them back. For comparisons a function also removes the parts that packing does not keep.

use super::Effects;
use super::shift::Shift;
use super::world::World;
use imrs_protocol::*;

/// Packs a task, reads it back into itself and shifts its ids back to those of its world. A state that does not fit its
/// packed form stays as it is.
pub fn repack(world: &mut World, task: usize) {
    let Ok(bytes) = world.bytes(task) else { return };
    let (rounds, sequences) = world.frame();
    let table = world.tables[task].clone();
    let loaded = &mut world.tasks[task];
    let read = Decode::read(&bytes, world.restarts, |r| loaded.walk(&table, r));
    assert_eq!(read, bytes.len(), "not all bytes were read");
    let home = (vec![Frame::ROUND; rounds.len()], vec![Frame::SEQUENCE; sequences.len()]);
    let frame = Frame { rounds: &home.0, sequences: &home.1, incarnations: world.restarts };
    let again = Encode::bytes(&frame, |w| loaded.walk(&table, w));
    assert_eq!(again, Ok(bytes), "other bytes after reading back");
    let shift = Shift {
        rounds: rounds.iter().map(|r| r.steps_from(Frame::ROUND)).collect(),
        sequences: sequences.iter().map(|s| s.steps_from(Frame::SEQUENCE)).collect(),
        epochs: world.shift.epochs,
        ..Shift::default()
    };
    loaded.walk(&table, &mut &shift);
    // A packed state does not record the number of a timer's start, so the numbers begin at zero again.
    world.turns[task].iter_mut().for_each(|turn| turn.1 = 0);
}

/// The effects without the parts that packing need not keep: the turns of timers, and the arguments of arrivals, which
/// `bury` may drop.
pub fn without_arguments(effects: &Effects) -> Effects {
    let mut effects = effects.clone();
    effects.turns.clear();
    for packet in effects.packets.iter_mut().filter(|p| p.kind == Kind::Arrive) {
        packet.contents = Meeting { arguments: [0; 8], ..packet.meeting() }.to_contents();
    }
    effects
}
