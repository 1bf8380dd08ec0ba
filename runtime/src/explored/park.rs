//! Scenes of the thread that runs the futures: it polls them, leads at the socket or sleeps, and every waker wakes it.

use super::lead::Socket;
use super::{DEADLOCK, must_fail};
use crate::clock;
use crate::explorer::{Arc, explore, thread};
use crate::sync::handoff::ThreadWaker;
use crate::sync::lead::{Lead, Led};
use crate::sync::park::{Park, Plant};
use crate::sync::{Mutex, lock, try_lock};

struct Scene {
    socket: std::sync::Arc<Socket>,
    park: Park<Option<Plant>>,
    lead: Lead,
    receiving: Mutex<()>,
    /// Whether the future of this scene can go on.
    woken: Mutex<bool>,
}

impl Scene {
    fn new(plant: Option<Plant>, datagrams: u32) -> Arc<Self> {
        let socket = std::sync::Arc::new(Socket::expecting(datagrams));
        let park = Park::planted(Some(socket.clone() as std::sync::Arc<dyn ThreadWaker>), plant);
        let (lead, receiving, woken) = (Lead::new(), Mutex::new(()), Mutex::new(false));
        Arc::new(Self { socket, park, lead, receiving, woken })
    }

    fn wake(&self) {
        *lock(&self.woken) = true;
        self.park.call();
    }

    /// Takes one datagram, and wakes the future if the datagram is for it. Returns how many datagrams it took.
    fn take(&self) -> u32 {
        let datagram = self.socket.take();
        if datagram == Some(true) {
            self.wake();
        }
        u32::from(datagram.is_some())
    }

    /// Runs the thread that receives for the node. Returns how many datagrams it took.
    fn run_poller(&self) -> u32 {
        let mut took = 0;
        while self.socket.poll() {
            let _turn = lock(&self.receiving);
            took += self.take();
        }
        took
    }

    /// Polls the future until it can go on. Returns how the last wait went, if there was one, and how many datagrams this
    /// thread took.
    fn run_futures(&self, leads: bool) -> (Option<Led>, u32) {
        let (mut went, mut took) = (None, 0);
        loop {
            self.park.begins();
            if *lock(&self.woken) {
                return (went, took);
            }
            let take_in = || {
                let turn = try_lock(&self.receiving);
                turn.map(|_turn| took += self.take()).is_some()
            };
            let led =
                if leads { self.lead.wait(&self.park, || self.socket.wait(), take_in) } else { Led::No };
            if led == Led::No {
                self.park.sleep();
            }
            went = Some(led);
        }
    }
}

/// A datagram wakes the future, whichever thread receives the datagram.
fn woken_by_datagram(plant: Option<Plant>) -> (Option<Led>, u32) {
    let scene = Scene::new(plant, 1);
    let (poller, network) = (Arc::clone(&scene), Arc::clone(&scene));
    let poller = thread::spawn(move || poller.run_poller());
    let network = thread::spawn(move || network.socket.arrive(true));
    let went = scene.run_futures(true);
    network.join().unwrap();
    assert_eq!(went.1 + poller.join().unwrap(), 1, "a datagram was taken twice or not at all");
    went
}

#[test]
fn a_datagram_wakes_a_future_whoever_takes_it() {
    let seen = explore(|| woken_by_datagram(None));
    let outcomes: Vec<_> = seen.keys().copied().collect();
    let [end, called, no] = [Led::ToTheEnd, Led::Called, Led::No].map(Some);
    assert_eq!(outcomes, [(None, 0), (end, 0), (end, 1), (called, 0), (no, 0)], "{seen:?}");
}

#[test]
fn who_is_away_and_is_not_called_never_polls_again() {
    must_fail(DEADLOCK, || woken_by_datagram(Some(Plant::NoWaker)));
}

/// Another thread wakes the future: a task, the Timer, or another waker of the program.
fn woken_by_a_thread(plant: Option<Plant>, leads: bool) -> Option<Led> {
    let scene = Scene::new(plant, 0);
    let other = Arc::clone(&scene);
    let other = thread::spawn(move || other.wake());
    let went = scene.run_futures(leads);
    other.join().unwrap();
    went.0
}

#[test]
fn a_thread_that_wakes_a_future_calls_back_who_leads_and_who_sleeps() {
    let seen = explore(|| woken_by_a_thread(None, true));
    let outcomes: Vec<_> = seen.keys().copied().collect();
    assert_eq!(outcomes, [None, Some(Led::ToTheEnd), Some(Led::Called)], "{seen:?}");
    let seen = explore(|| woken_by_a_thread(None, false));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [None, Some(Led::No)], "{seen:?}");
}

#[test]
fn a_wake_between_the_last_poll_and_the_wait_must_be_seen() {
    must_fail(DEADLOCK, || woken_by_a_thread(Some(Plant::GoesBlindly), true));
    must_fail(DEADLOCK, || woken_by_a_thread(Some(Plant::GoesBlindly), false));
}

#[test]
fn a_thread_that_slept_asks_the_kernel_for_the_time() {
    let seen = explore(|| {
        let park = Arc::new(Park::new(None));
        let caller = {
            let park = Arc::clone(&park);
            thread::spawn(move || park.call())
        };
        let asks = clock::is_told_of(|| park.sleep());
        caller.join().unwrap();
        asks
    });
    // If the wake-up came first, the thread does not sleep. Then it may keep its anchor (its last reading of the
    // kernel's clock).
    assert!(seen[&true] > 0 && seen[&false] > 0, "{seen:?}");
}
