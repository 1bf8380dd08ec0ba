//! Decodes bytes into cells and their inputs, for the fuzz targets of `fuzz/` and for plain tests (`tests/fuzzing.rs`).
//! Any bytes are valid, and more bytes only continue a run.

use super::Effects;
use super::NextExpiry;
use super::fused::{Counts, Run};
use super::packing::{repack, without_arguments};
use super::plan::Plan;
use super::world::World;
use imrs_protocol::*;

/// The bytes of an input of a fuzz target, followed by zeros.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let (now, later) = self.0.split_at(N.min(self.0.len()));
        self.0 = later;
        let mut bytes = [0; N];
        bytes[..now.len()].copy_from_slice(now);
        bytes
    }

    fn byte(&mut self) -> u8 {
        self.take::<1>()[0]
    }

    /// A random cell, with its own rules and with a couple only if asked for.
    fn plan(&mut self, has_rules: bool, has_couple: bool) -> Plan {
        let [tasks, nodes, delay, ports] = self.take();
        let ports = (0..1 + usize::from(ports % 4)).map(|_| self.take()).collect();
        let rules = if has_rules { self.take() } else { [0; 4] };
        Plan::new([tasks, nodes, delay], ports, rules, if has_couple { self.byte() } else { 0 })
    }

    fn operation(&mut self) -> (u8, u8, u16, u16) {
        let [what, which, a, b, c, d] = self.take();
        (what, which, u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d]))
    }
}

/// The most operations that one fuzz input makes.
const OPERATIONS: usize = 300;

/// Drives the communication tasks of a random cell. Cell and operations are read from `data`. Checks after every operation
/// that the invariants hold and the next expiry is exact. Also checks that a second world behaves the same, although its
/// clocks go back to zero now and then and its states are packed and read back.
pub fn inputs(data: &[u8]) {
    let mut bytes = Bytes(data);
    let [flags, mask] = bytes.take();
    let plan = bytes.plan(flags & 1 != 0, flags & 8 != 0);
    let mut world = World::new(&plan.build(), flags & 2 != 0);
    let mut other = world.clone();
    let packs = flags & 4 != 0;
    for i in 0..OPERATIONS {
        if bytes.0.is_empty() {
            break;
        }
        let op = bytes.operation();
        let task = usize::from(op.1) % world.tasks.len();
        if mask >> (i % 8) & 1 == 1 {
            other.rebase();
            if packs {
                repack(&mut other, task);
            }
        }
        let (found, expected) = (other.step(op), world.step(op));
        if packs {
            assert_eq!(without_arguments(&found), without_arguments(&expected), "{op:?}, packed before");
        } else {
            assert_eq!(found, expected, "{op:?} after a rebase");
        }
        next_expiry_is_exact(&world, task);
        assert_eq!(other.bytes(task), world.bytes(task), "packed state of T{task}");
    }
}

/// Drives the nodes of a random cell, which is read from `data` as the operations are. Checks after every operation that a
/// fused step does what the small steps do, and that a step that is not fused changes nothing.
pub fn fused(data: &[u8]) {
    let mut bytes = Bytes(data);
    let flags = bytes.byte();
    let mut run = Run::new(&bytes.plan(flags & 1 != 0, flags & 8 != 0));
    for _ in 0..OPERATIONS {
        if bytes.0.is_empty() {
            break;
        }
        run.step(bytes.operation(), &mut Counts::new());
    }
}

/// Checks that nothing happens one tick before the next expiry, and that something happens at the expiry.
fn next_expiry_is_exact(world: &World, task: usize) {
    let mut ahead = world.clone();
    ahead.looks_around = true;
    let Some(due) = ahead.tasks[task].next_expiry() else {
        let never = ahead.pass(task, 1_000_000);
        assert!(never == Effects::default(), "{never:?} without a next expiry");
        return;
    };
    if due.0 > 0 {
        let early = ahead.pass(task, due.0 - 1);
        assert!(early == Effects::default(), "{early:?} before {due}");
    }
    let on_time = ahead.pass(task, u64::from(due.0 > 0));
    let residence = ahead.tables[task].rules().charge_residence;
    assert!(!residence || on_time != Effects::default(), "nothing after {due}");
}

/// Reads packets from `data`. Checks that any bytes are a packet or an error, that a packet encodes to itself, that every
/// flipped bit is detected, and that remaining time never grows.
pub fn packets(data: &[u8]) {
    let mut bytes = Bytes(data);
    while !bytes.0.is_empty() {
        let flipped = usize::from(bytes.byte());
        let mut raw: [u8; PACKET_BYTES] = bytes.take();
        let _ = Packet::decode(&raw, DIGEST, port_hash);
        // The same bytes, but with a valid checksum.
        let hash = port_hash(PortId(u16::from_le_bytes([raw[6], raw[7]]))).unwrap_or(0);
        let crc = checksum(&raw, DIGEST, hash);
        raw[28..].copy_from_slice(&crc.to_le_bytes());
        let Ok(packet) = Packet::decode(&raw, DIGEST, port_hash) else { continue };
        let encoded = packet.encode(DIGEST, hash);
        assert_eq!(Packet::decode(&encoded, DIGEST, port_hash), Ok(packet), "decode(encode(packet))");
        gains_no_remaining_time(&packet, u64::from_le_bytes(bytes.take()), hash);
        notices(&encoded, &packet, flipped);
        let _ = (packet.meeting(), packet.meeting().next_round(), packet.control());
    }
}

const DIGEST: u32 = 0x1234_5678;

/// The hash of a port; only every second port is known.
fn port_hash(port: PortId) -> Option<u32> {
    port.0.is_multiple_of(2).then(|| u32::from(port.0).wrapping_mul(0x9e37_79b9))
}

fn gains_no_remaining_time(packet: &Packet, remaining: u64, hash: u32) {
    let sent = Packet { remaining: Ticks(remaining), ..*packet };
    let decoded = Packet::decode(&sent.encode(DIGEST, hash), DIGEST, port_hash).expect("a packet");
    assert!(decoded.remaining <= sent.remaining, "{} became {}", sent.remaining, decoded.remaining);
    assert_eq!(decoded, Packet { remaining: decoded.remaining, ..sent });
    // The decoded time is less by at most one part in 2^23, or by one wire step. A time beyond the greatest encodable time
    // becomes that greatest time.
    let end = Ticks((((1 << 24) - 1) << 15) * WIRE_STEP_US);
    let kept = sent.remaining.min(end);
    assert!(
        kept.0 - decoded.remaining.0 <= (kept.0 >> 23).max(WIRE_STEP_US),
        "{kept} became {}",
        decoded.remaining
    );
}

/// Checks that a flipped bit is an error, except in the fields that relays change, which the envelope covers.
fn notices(encoded: &[u8; PACKET_BYTES], packet: &Packet, flipped: usize) {
    let mut damaged = *encoded;
    damaged[flipped / 8] ^= 1 << (flipped % 8);
    let relays_change = match flipped / 8 {
        1 => (1..=3).contains(&(flipped % 8)),
        12..=14 => true,
        15 => flipped % 8 < 4,
        _ => false,
    };
    match Packet::decode(&damaged, DIGEST, port_hash) {
        Err(_) => assert!(!relays_change, "bit {flipped}"),
        Ok(read) => {
            assert!(relays_change, "bit {flipped} went unnoticed");
            assert_eq!(Packet { hops: packet.hops, remaining: packet.remaining, ..read }, *packet);
        }
    }
}

/// The checksum of a packet as the format defines it (D47), computed independently of the code under test.
pub fn checksum(bytes: &[u8; PACKET_BYTES], digest: u32, port_hash: u32) -> u32 {
    let mut covered = [&digest.to_le_bytes()[..], &port_hash.to_le_bytes(), &bytes[..28]].concat();
    covered[8 + 1] &= 0b1111_0001;
    covered[8 + 12..8 + 15].fill(0);
    covered[8 + 15] &= 0xf0;
    crc::Crc::<u32>::new(&crc::CRC_32_AUTOSAR).checksum(&covered)
}
