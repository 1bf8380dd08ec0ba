//! Properties of two nodes with keys that hold whatever the network does to their datagrams. The fuzz target `keys`
//! checks them, too.

use super::NodeKeys;
use super::rig::{End, MS, end, ends, keys};
use std::sync::LazyLock;

/// The keys of all runs, drawn once, because drawing them costs more than a run.
static KEYS: LazyLock<[NodeKeys; 2]> = LazyLock::new(keys);
/// How many datagrams the network holds, at most.
const FLYING: usize = 64;
/// Each start of a node takes its counters from a range of this length, so that no two starts use the same counter.
const COUNTERS: u64 = 1 << 33;

/// A network that handles datagrams as the fuzzer's bytes command.
struct Network<'a> {
    bytes: &'a [u8],
    ends: [End; 2],
    now: u64,
    starts: u64,
    /// The end that sends nothing by itself after the faults have ended; `None` if both ends send.
    silent: Option<usize>,
    /// The datagrams in flight: to which end, and their bytes.
    flying: Vec<(usize, Vec<u8>)>,
}

/// Lets the network deliver, lose, repeat, hold back, change and forge datagrams, and restart nodes, as the
/// bytes of the fuzzer say.
///
/// # Panics
/// If an end accepts a counter that the other end has not used, or accepts one counter twice; or if the two ends do
/// not receive from each other after the network's faults have ended.
pub fn check(bytes: &[u8]) {
    let silent = bytes.first().and_then(|&first| [None, Some(0), Some(1)][usize::from(first) % 3]);
    let mut net = Network { bytes, ends: ends(&KEYS), now: 0, starts: 100, silent, flying: Vec::new() };
    while let Some(what) = net.byte() {
        net.step(what);
        for me in [0, 1] {
            let (sent, opened) = (net.ends[1 - me].counter, &net.ends[me].opened);
            assert!(opened.iter().all(|&counter| counter < sent), "a datagram that was never sent");
            let mut once = opened.clone();
            once.sort_unstable();
            assert!(once.windows(2).all(|pair| pair[0] != pair[1]), "a datagram was taken in twice");
        }
    }
    net.talk();
}

impl Network<'_> {
    fn byte(&mut self) -> Option<u8> {
        let (&first, rest) = self.bytes.split_first()?;
        self.bytes = rest;
        Some(first)
    }

    fn some(&mut self, count: usize) -> usize {
        usize::from(self.byte().unwrap_or_default()) % count.max(1)
    }

    fn send(&mut self, to: usize, bytes: Option<Vec<u8>>) {
        if self.flying.len() < FLYING {
            self.flying.extend(bytes.map(|bytes| (to, bytes)));
        }
    }

    fn step(&mut self, what: u8) {
        let me = usize::from(what >> 7);
        match what & 0x0f {
            0 => {
                let hello = self.ends[me].knock(self.now);
                self.send(1 - me, hello);
            }
            1 => {
                let datagram = self.ends[me].datagram();
                self.send(1 - me, datagram);
            }
            2 => self.now += 1 << (self.some(36) as u64),
            3 => self.restart(me),
            // Bytes that neither node made.
            4 => {
                let length = self.some(256).min(self.bytes.len());
                let (made_up, rest) = self.bytes.split_at(length);
                self.bytes = rest;
                self.arrive(me, made_up);
            }
            what => {
                if self.flying.is_empty() {
                    return;
                }
                let at = self.some(self.flying.len());
                let (to, mut bytes) = self.flying[at].clone();
                match what {
                    5 => drop(self.flying.remove(at)),
                    // A copy of the datagram arrives now, and another copy may arrive later.
                    6 => self.arrive(to, &bytes),
                    // The datagram is reflected to its sender.
                    7 => self.arrive(1 - to, &bytes),
                    8 | 9 => {
                        let (place, by) = (self.some(bytes.len()), self.byte().unwrap_or(1));
                        bytes[place] ^= by;
                        self.arrive(to, &bytes);
                    }
                    10 => {
                        bytes.truncate(self.some(bytes.len()));
                        self.arrive(to, &bytes);
                    }
                    _ => {
                        self.flying.remove(at);
                        self.arrive(to, &bytes);
                    }
                }
            }
        }
    }

    fn arrive(&mut self, to: usize, bytes: &[u8]) {
        // For this check it does not matter why a datagram is dropped.
        let reply = self.ends[to].take(bytes, self.now).unwrap_or_default();
        self.send(1 - to, reply);
    }

    /// Restarts the node with the same keys. Datagrams from before the restart may still arrive.
    fn restart(&mut self, me: usize) {
        self.starts += 1;
        self.ends[me] = end(&KEYS, me, self.starts, super::rig::DIGESTS);
        self.ends[me].counter = self.starts * COUNTERS;
    }

    /// Lets the nodes talk while the network loses and changes nothing: each end must receive within half a minute
    /// what is sent to it. An end that sends nothing by itself asks for a session if it has none, and repeats its
    /// greeting.
    fn talk(&mut self) {
        self.flying.clear();
        let heard = self.ends.each_ref().map(|end| end.opened.len());
        for _ in 0..3_000 {
            let is_heard = |to: usize| self.silent == Some(1 - to) || self.ends[to].opened.len() > heard[to];
            if is_heard(0) && is_heard(1) {
                return;
            }
            for me in [0, 1] {
                let said = match self.silent {
                    Some(silent) if silent == me => self.ends[me].greeting(self.now),
                    _ => self.ends[me].datagram(),
                };
                let hello = self.ends[me].knock(self.now);
                self.send(1 - me, hello);
                self.send(1 - me, said);
            }
            for (to, bytes) in std::mem::take(&mut self.flying) {
                self.arrive(to, &bytes);
            }
            self.now += 10 * MS;
        }
        panic!("the two do not talk any more");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn whatever_the_network_does_nothing_is_taken_in_twice_and_the_two_talk_again(
            bytes in proptest::collection::vec(any::<u8>(), 0..400),
        ) {
            check(&bytes);
        }
    }
}
