//! A switch between hosts. Its faults are drawn from a seed. The decision about a frame depends only on the seed, the
//! two hosts, and the number of the frame among the frames from one to the other. So the faults of a run can be
//! repeated.

use super::frames::{damage, is_arp, is_datagram, receiver};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// The shares of datagrams that get each fault.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Faults {
    pub loss: f64,
    pub duplication: f64,
    pub corruption: f64,
    /// The share of datagrams that are held for a random part of `delay`, so that later ones overtake them.
    pub late: f64,
    pub delay: Duration,
}

/// How many datagrams the switch passed on or changed, by kind of fault.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Counts {
    pub datagrams: u64,
    pub lost: u64,
    pub duplicated: u64,
    pub corrupted: u64,
    pub late: u64,
    /// The number of datagrams between hosts whose link was cut.
    pub cut: u64,
}

/// One frame that leaves the switch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Departure {
    pub to: usize,
    pub after: Duration,
    pub frame: Vec<u8>,
}

/// The decisions of the switch, without its hosts.
pub struct Decisions {
    seed: u64,
    hosts: usize,
    faults: Faults,
    /// The directed pairs of hosts between which no frame passes.
    cuts: BTreeSet<(usize, usize)>,
    /// For each directed pair, how many datagrams it has sent.
    numbers: BTreeMap<(usize, usize), u64>,
    /// The first datagrams that came, each with its receiver.
    pub seen: Vec<(usize, Vec<u8>)>,
    pub counts: Counts,
}

/// How many datagrams the switch remembers.
const SEEN: usize = 1_000;

impl Decisions {
    pub fn new(seed: u64, hosts: usize) -> Self {
        let (faults, cuts, numbers, seen, counts) = Default::default();
        Self { seed, hosts, faults, cuts, numbers, seen, counts }
    }

    /// Subjects the datagrams to these faults from now on.
    pub fn set(&mut self, faults: Faults) {
        self.faults = faults;
    }

    /// Cuts the link from one host to another, in this direction only.
    pub fn cut(&mut self, from: usize, to: usize) {
        self.cuts.insert((from, to));
    }

    /// Ends all cuts.
    pub fn heal(&mut self) {
        self.cuts.clear();
    }

    /// Decides what becomes of a frame. Frames that are no datagrams are never counted and get no faults, so that noise
    /// of the kernels changes nothing for later datagrams.
    pub fn decide(&mut self, from: usize, frame: Vec<u8>) -> Vec<Departure> {
        let Some(to) = receiver(&frame) else { return self.to_all(from, &frame) };
        if to >= self.hosts || to == from {
            return Vec::new();
        }
        if !is_datagram(&frame) {
            let passes = !self.cuts.contains(&(from, to));
            return if passes { vec![Departure { to, after: Duration::ZERO, frame }] } else { Vec::new() };
        }
        let number = self.numbers.entry((from, to)).or_default();
        *number += 1;
        let draws = Draws::of(self.seed, from, to, *number);
        self.counts.datagrams += 1;
        if self.seen.len() < SEEN {
            self.seen.push((to, frame.clone()));
        }
        if self.cuts.contains(&(from, to)) {
            self.counts.cut += 1;
            return Vec::new();
        }
        self.apply(to, frame, &draws)
    }

    /// Only ARP goes to all hosts. IPv6, which nothing here uses, is dropped.
    fn to_all(&self, from: usize, frame: &[u8]) -> Vec<Departure> {
        let reached = |to: &usize| is_arp(frame) && *to != from && !self.cuts.contains(&(from, *to));
        let others = (0..self.hosts).filter(reached);
        others.map(|to| Departure { to, after: Duration::ZERO, frame: frame.to_vec() }).collect()
    }

    fn apply(&mut self, to: usize, mut frame: Vec<u8>, draws: &Draws) -> Vec<Departure> {
        let (faults, counts) = (self.faults, &mut self.counts);
        if draws.loss < faults.loss {
            counts.lost += 1;
            return Vec::new();
        }
        if draws.corruption < faults.corruption {
            counts.corrupted += 1;
            damage(&mut frame, draws.bits);
        }
        let copies = 1 + usize::from(draws.duplication < faults.duplication);
        counts.duplicated += copies as u64 - 1;
        let departure = |at: usize| {
            let late = draws.late[at] < faults.late;
            let after = if late { faults.delay.mul_f64(draws.delay[at]) } else { Duration::ZERO };
            (late, Departure { to, after, frame: frame.clone() })
        };
        let (late, departures): (Vec<bool>, Vec<Departure>) = (0..copies).map(departure).unzip();
        counts.late += late.iter().filter(|late| **late).count() as u64;
        departures
    }
}

/// All random numbers for one datagram. All of them are drawn for each datagram, so that a change of the share of one
/// fault does not change the other faults.
struct Draws {
    loss: f64,
    duplication: f64,
    corruption: f64,
    bits: u64,
    late: [f64; 2],
    delay: [f64; 2],
}

impl Draws {
    fn of(seed: u64, from: usize, to: usize, number: u64) -> Self {
        let parts = [from as u64, to as u64, number];
        let seed = parts.iter().fold(seed, |seed, part| fastrand::Rng::with_seed(seed ^ part).u64(..));
        let mut draws = fastrand::Rng::with_seed(seed);
        let (loss, duplication, corruption, bits) = (draws.f64(), draws.f64(), draws.f64(), draws.u64(..));
        let [late, delay] = [(); 2].map(|()| [draws.f64(), draws.f64()]);
        Self { loss, duplication, corruption, bits, late, delay }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::frames::datagram;

    const MANY: u64 = 20_000;
    const FAULTS: Faults = Faults {
        loss: 0.1,
        duplication: 0.05,
        corruption: 0.02,
        late: 0.2,
        delay: Duration::from_millis(40),
    };

    /// For each pair of hosts, the frames that leave the switch for each datagram of the pair.
    type All = BTreeMap<(usize, usize), Vec<Vec<Departure>>>;

    /// The frames that leave the switch if these pairs send in this order. The frames of `noise` come between the
    /// datagrams.
    fn departures(seed: u64, order: impl Iterator<Item = (usize, usize)>, noise: &[&[u8]]) -> (All, Counts) {
        let mut decisions = Decisions::new(seed, 3);
        decisions.set(FAULTS);
        let mut all = All::new();
        for (from, to) in order {
            for noise in noise {
                decisions.decide(from, noise.to_vec());
            }
            let number = all.get(&(from, to)).map_or(0, Vec::len);
            let frame = datagram(to, format!("{from} to {to}, number {number}").as_bytes());
            all.entry((from, to)).or_default().push(decisions.decide(from, frame));
        }
        (all, decisions.counts)
    }

    #[test]
    fn decisions_depend_on_nothing_but_the_seed_the_pair_and_the_number() {
        let pairs = [(0, 1), (1, 0), (0, 2), (2, 1)];
        let in_turns = || (0..MANY).flat_map(|_| pairs);
        let one_by_one = || pairs.into_iter().flat_map(|pair| (0..MANY).map(move |_| pair));
        let once = departures(7, in_turns(), &[]);
        assert_eq!(once, departures(7, one_by_one(), &[]));
        let arp: &[u8] = &[&[255; 6][..], &[2, 0, 0, 0, 0, 1, 8, 6], &[0; 28]].concat();
        let ipv6: &[u8] = &[&[0x33; 6][..], &[2, 0, 0, 0, 0, 1, 0x86, 0xdd], &[0; 60]].concat();
        let answer: &[u8] = &[&[2, 0, 0, 0, 0, 3][..], &[2, 0, 0, 0, 0, 1, 8, 6], &[0; 28]].concat();
        assert_eq!(once, departures(7, in_turns(), &[arp, ipv6, answer]));
        assert_ne!(once, departures(8, in_turns(), &[]));
        // The decisions about one pair do not depend on the other pairs.
        let lost = |pair| -> Vec<bool> { once.0[&pair].iter().map(Vec::is_empty).collect() };
        assert_ne!(lost((0, 1)), lost((1, 0)));
        assert_ne!(lost((0, 1)), lost((0, 2)));
    }

    #[test]
    fn the_shares_are_those_that_were_asked_for() {
        let (all, counts) = departures(1, (0..MANY).map(|_| (0, 1)), &[]);
        // The seed is fixed, so the draws are the same in each run, and these bounds of five standard deviations do not
        // fail by chance.
        for (count, of, share) in [
            (counts.lost, MANY, FAULTS.loss),
            (counts.duplicated, MANY - counts.lost, FAULTS.duplication),
            (counts.corrupted, MANY - counts.lost, FAULTS.corruption),
            (counts.late, MANY - counts.lost + counts.duplicated, FAULTS.late),
        ] {
            let (of, count) = (of as f64, count as f64);
            let most = 5.0 * (of * share * (1.0 - share)).sqrt();
            assert!((count - of * share).abs() < most, "{count} of {of}, {share} asked for");
        }
        assert_eq!(counts.datagrams, MANY);
        let left: Vec<&Departure> = all[&(0, 1)].iter().flatten().collect();
        assert_eq!(left.len() as u64, MANY - counts.lost + counts.duplicated);
        assert!(left.iter().all(|departure| departure.after < FAULTS.delay));
        let is_damaged = |(number, departures): (usize, &Vec<Departure>)| {
            let sent = datagram(1, format!("0 to 1, number {number}").as_bytes());
            departures.iter().any(|departure| departure.frame != sent)
        };
        let damaged = all[&(0, 1)].iter().enumerate().filter(|one| is_damaged(*one)).count() as u64;
        assert_eq!(damaged, counts.corrupted);
    }

    #[test]
    fn a_cut_link_passes_nothing_in_its_direction_and_numbers_go_on() {
        let mut decisions = Decisions::new(3, 3);
        decisions.cut(0, 1);
        let send = |decisions: &mut Decisions, from, to| decisions.decide(from, datagram(to, b"x")).len();
        assert_eq!([(0, 1), (1, 0), (0, 2)].map(|(from, to)| send(&mut decisions, from, to)), [0, 1, 1]);
        let answer = [&[2, 0, 0, 0, 0, 2][..], &[2, 0, 0, 0, 0, 1, 8, 6], &[0; 28]].concat();
        assert_eq!(decisions.decide(0, answer).len(), 0, "no ARP either");
        decisions.heal();
        assert_eq!(send(&mut decisions, 0, 1), 1);
        assert_eq!((decisions.counts.cut, decisions.counts.datagrams), (1, 4));
        assert_eq!(decisions.numbers[&(0, 1)], 2);
    }

    #[test]
    fn damage_is_in_the_payload_alone() {
        let frame = datagram(1, &[0; 100]);
        for draw in 0..1_000 {
            let mut damaged = frame.clone();
            damage(&mut damaged, draw);
            assert_eq!(damaged[..40], frame[..40]);
            let flipped: u32 = damaged[42..].iter().map(|byte| byte.count_ones()).sum();
            assert!(flipped <= 3, "{flipped}");
        }
    }
}
