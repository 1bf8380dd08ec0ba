//! Tests that mutated datagrams cause no panic, and that genuine datagrams are still accepted.

use super::rig::{A, B, C, Memory, PATIENCE, introduced, link, packet, raw_socket};
use super::sessions::{drive, taken_on_its_way};
use imrs_runtime::link::Link;
use imrs_runtime::link::udp::UdpLink;
use imrs_wire::envelope::MAX_DATAGRAM_BYTES;
use std::time::{Duration, Instant};

const HEADER: usize = 60;
/// How many mutated datagrams are sent between two checks with genuine datagrams.
const BATCH: usize = 250;

const CRC: crc::Crc<u32, crc::Table<16>> = crc::Crc::<u32, crc::Table<16>>::new(&crc::CRC_32_MEF);

/// Changes some bytes at random. Half of the time it then repairs the digests and the checksum, and perhaps counter and length.
fn mutated(genuine: &[u8], counter: u64, rng: &mut fastrand::Rng) -> Vec<u8> {
    let mut bytes = genuine.to_vec();
    match rng.u8(..16) {
        0 => bytes.truncate(rng.usize(..bytes.len())),
        1 => bytes.extend_from_within(..rng.usize(..bytes.len())),
        _ => {}
    }
    for _ in 0..rng.usize(1..5) {
        if !bytes.is_empty() {
            // The header is mutated more often than its share of the bytes.
            let end = if rng.bool() { bytes.len() } else { bytes.len().min(HEADER) };
            let at = rng.usize(..end);
            bytes[at] = if rng.bool() { rng.u8(..) } else { bytes[at] ^ (1 << rng.u8(..8)) };
        }
    }
    if rng.bool() && bytes.len() >= HEADER + 4 {
        bytes[..12].copy_from_slice(&genuine[..12]);
        if rng.bool() {
            bytes[36..44].copy_from_slice(&counter.to_le_bytes());
        }
        if rng.bool() {
            bytes[18] = u8::try_from((bytes.len() - HEADER - 4) / 32).unwrap_or(u8::MAX);
        }
        let end = bytes.len() - 4;
        let checksum = CRC.checksum(&bytes[..end]).to_le_bytes();
        bytes[end..].copy_from_slice(&checksum);
    }
    bytes.truncate(2 * MAX_DATAGRAM_BYTES);
    bytes
}

/// Lets A send until B has received a packet. Returns how long that took.
fn goes_on((a, at_a): (&UdpLink, &Memory), (b, at_b): (&UdpLink, &Memory), number: &mut u32) -> Duration {
    let (start, mut next) = (Instant::now(), Instant::now());
    let first = *number;
    let is_new = |of: u32| first <= of;
    drive(&[(b, at_b), (a, at_a)], || {
        let got = std::mem::take(&mut *at_b.packets.lock().unwrap());
        let genuine = got.iter().find(|got| got.0 == A && is_new(got.1.id.sequence.get()));
        if let Some((_, _, charge)) = genuine {
            // The packet must not be charged as if it were old: it would then expire too early.
            assert!(charge.0 <= 20_000_000, "{charge} us");
            return true;
        }
        if next <= Instant::now() {
            a.send(B, &[packet(*number)]).unwrap();
            *number += 1;
            next = Instant::now() + Duration::from_millis(5);
        }
        false
    });
    start.elapsed()
}

#[test]
fn genuine_traffic_goes_on_between_mutated_datagrams() {
    let count = std::env::var("IMRS_MUTATED").map_or(5_000, |count| count.parse().expect("a number"));
    let seed = std::env::var("IMRS_SEED").map_or(1, |seed| seed.parse().expect("a number"));
    let mut rng = fastrand::Rng::with_seed(seed);
    let (a, b) = introduced(link(A), link(B));
    let c = link(C);
    c.set_address(B, Some(b.local_address())).unwrap();
    b.set_address(C, Some(c.local_address())).unwrap();
    let (at_a, at_b, at_c) = (Memory::default(), Memory::default(), Memory::default());
    let (from, mut number, mut thrown) = (raw_socket(), 1_000_000, 0);
    let mut longest = Duration::ZERO;
    // First the two nodes must receive a datagram from each other.
    goes_on((&a, &at_a), (&b, &at_b), &mut number);
    while thrown < count {
        let genuine = taken_on_its_way(&a, &b, packet(number - 1));
        for extra in 0..BATCH as u64 {
            let counter = u64::from(number) + extra;
            from.send_to(&mutated(&genuine, counter, &mut rng), b.local_address()).unwrap();
            b.poll(&at_b, Some(Instant::now() + PATIENCE));
        }
        thrown += BATCH;
        for memory in [&at_a, &at_b, &at_c] {
            memory.packets.lock().unwrap().clear();
            memory.peers.lock().unwrap().clear();
            memory.discards.lock().unwrap().clear();
        }
        longest = longest.max(goes_on((&a, &at_a), (&b, &at_b), &mut number));
        // B must answer, too.
        b.send(A, &[packet(1)]).unwrap();
        drive(&[(&a, &at_a), (&c, &at_c)], || at_a.delivered() > 0);
    }
    println!("total: {thrown} mutated datagrams, genuine ones after at most {longest:?}");
}
