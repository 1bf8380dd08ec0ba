//! Scenes of leader and followers at a socket. A leader takes its own answer, is woken, or receives datagrams for others,
//! while the polling thread receives, too.

use super::handoff::{Brought, Toy};
use super::{DEADLOCK, must_fail_large};
use crate::explorer::{Arc, Condvar, PlainMutex, explore_large, thread};
use crate::sync::combining_lock::{self, CombiningLock};
use crate::sync::handoff::{self, Handoff, ThreadWaker};
use crate::sync::lead::{self, Came, Lead, Led};

/// A socket as the kernel shows it: a datagram is reported to the leader if one waits, else to the polling thread.
pub(super) struct Socket {
    state: PlainMutex<State>,
    leaders: Condvar,
    pollers: Condvar,
}

#[derive(Default)]
struct State {
    /// The datagrams in the socket; true means that the datagram is for the leader's task.
    datagrams: Vec<bool>,
    /// How many datagrams are not taken yet: those in the socket, and those that will arrive later.
    open: u32,
    leads: bool,
    told: bool,
    called: bool,
    /// Whether reports are edge-triggered: then the socket does not report a datagram again that is still in it. Only
    /// for the test that must fail.
    edges: bool,
}

impl Socket {
    pub(super) fn expecting(datagrams: u32) -> Self {
        let state = State { open: datagrams, ..State::default() };
        Self { state: PlainMutex::new(state), leaders: Condvar::new(), pollers: Condvar::new() }
    }

    pub(super) fn arrive(&self, for_the_leader: bool) {
        let mut state = self.state.lock().unwrap();
        state.datagrams.push(for_the_leader);
        if state.leads {
            state.leads = false;
            self.leaders.notify_one();
        } else {
            state.told = true;
            self.pollers.notify_one();
        }
    }

    /// The leader's wait in the socket. If this reports a datagram, the datagram is still in the socket on return,
    /// unless the polling thread has taken it.
    pub(super) fn wait(&self) -> Came {
        let mut state = self.state.lock().unwrap();
        loop {
            if !state.datagrams.is_empty() {
                return Came::Something;
            }
            if std::mem::take(&mut state.called) {
                return Came::Nothing;
            }
            state.leads = true;
            state = self.leaders.wait(state).unwrap();
            state.leads = false;
        }
    }

    /// The polling thread's wait in the socket. Returns false once no more datagrams will arrive.
    pub(super) fn poll(&self) -> bool {
        let mut state = self.state.lock().unwrap();
        while state.open > 0 && (!state.told || state.datagrams.is_empty()) {
            state = self.pollers.wait(state).unwrap();
        }
        state.told &= !state.edges;
        state.open > 0
    }

    pub(super) fn take(&self) -> Option<bool> {
        let mut state = self.state.lock().unwrap();
        let datagram = state.datagrams.pop();
        if datagram.is_some() {
            state.open -= 1;
            if state.open == 0 {
                self.pollers.notify_one();
            }
        }
        datagram
    }
}

impl ThreadWaker for Socket {
    fn wake(&self) {
        self.state.lock().unwrap().called = true;
        self.leaders.notify_one();
    }
}

struct Scene {
    socket: std::sync::Arc<Socket>,
    handoff: Handoff<Toy, Option<handoff::Plant>>,
    lead: Lead<Option<lead::Plant>>,
    receiving: CombiningLock<(), Option<combining_lock::Plant>>,
}

/// The planted bugs of a scene.
#[derive(Clone, Copy, Debug, Default)]
struct Planted {
    /// The link does not wake a thread that waits in it.
    no_waker: bool,
    /// When the leader's own wait is over, the leader does not take the datagram that the kernel has reported to it.
    leaves_told: bool,
    /// The kernel's reports are edge-triggered.
    edges: bool,
    /// A receiving thread stops without checking whether another thread wanted to receive in the meantime.
    leaves_blindly: bool,
}

impl Scene {
    fn new(planted: Planted, datagrams: u32) -> Arc<Self> {
        let socket = std::sync::Arc::new(Socket::expecting(datagrams));
        let waker: std::sync::Arc<dyn ThreadWaker> = socket.clone();
        socket.state.lock().unwrap().edges = planted.edges;
        let no_waker = planted.no_waker.then_some(handoff::Plant::NoWaker);
        let handoff = Handoff::planted(Toy::default(), Some(waker), no_waker);
        let lead = Lead::planted(planted.leaves_told.then_some(lead::Plant::LeavesBlindly));
        let receiving = CombiningLock::planted(
            (),
            planted.leaves_blindly.then_some(combining_lock::Plant::LeavesBlindly),
        );
        Arc::new(Self { socket, handoff, lead, receiving })
    }

    fn deliver(&self, datagram: Option<bool>) {
        if datagram == Some(true) {
            self.handoff.deliver(Brought::Answer, &mut 0);
        }
    }

    /// The thread that receives for the node takes every datagram that is reported to it. Returns how many it took.
    fn run_poller(&self) -> u32 {
        let mut took = 0;
        while self.socket.poll() {
            let mut all = || {
                while let Some(datagram) = self.socket.take() {
                    took += 1;
                    self.deliver(Some(datagram));
                }
            };
            let mut is_done = false;
            self.receiving.want();
            self.receiving.take(|()| {
                all();
                is_done = true;
            });
            if !is_done {
                self.receiving.take_after(|()| all());
            }
        }
        took
    }

    /// The task makes a request, checks the socket `looks` times, and then waits. Returns how the wait went, and how
    /// many datagrams the task's thread took.
    fn run_task(&self, looks: u32) -> (Led, u32) {
        let (mut worked, mut took, mut led) = (0, 0, Led::ToTheEnd);
        let mut entry = self.handoff.enter(Brought::Question, &mut worked);
        while entry.completion.is_none() {
            let mut take_in = || {
                let mut is_done = false;
                self.receiving.want();
                self.receiving.take(|()| {
                    let datagram = self.socket.take();
                    took += u32::from(datagram.is_some());
                    self.deliver(datagram);
                    is_done = true;
                });
                is_done
            };
            if !self.handoff.look(&mut take_in, |there| (0..looks).any(|_| there())) {
                led = self.lead.wait(&self.handoff, || self.socket.wait(), take_in);
                if led == Led::No {
                    self.handoff.sleep(None);
                }
            }
            entry = self.handoff.enter(Brought::Nothing, &mut worked);
        }
        (led, took)
    }
}

/// The answer comes as a datagram. Returns how the task's wait went, and whether the task's thread took the answer itself.
fn answer_by_datagram(planted: Planted, looks: u32) -> (Led, u32) {
    let scene = Scene::new(planted, 1);
    let (poller, network) = (Arc::clone(&scene), Arc::clone(&scene));
    let poller = thread::spawn(move || poller.run_poller());
    let network = thread::spawn(move || network.socket.arrive(true));
    let went = scene.run_task(looks);
    network.join().unwrap();
    assert_eq!(went.1 + poller.join().unwrap(), 1, "a datagram was taken twice or not at all");
    went
}

#[test]
fn an_answer_by_datagram_ends_the_wait_whoever_takes_it() {
    let seen = explore_large(|| answer_by_datagram(Planted::default(), 0));
    let outcomes: Vec<_> = seen.keys().copied().collect();
    let expected = [(Led::ToTheEnd, 0), (Led::ToTheEnd, 1), (Led::Called, 0), (Led::No, 0)];
    assert_eq!(outcomes, expected, "{seen:?}");
}

#[test]
fn who_leads_and_is_not_called_waits_for_ever() {
    must_fail_large(DEADLOCK, || answer_by_datagram(Planted { no_waker: true, ..Planted::default() }, 0));
}

#[test]
fn who_looks_into_the_socket_before_it_leads_misses_no_answer() {
    let seen = explore_large(|| answer_by_datagram(Planted::default(), 1));
    let outcomes: Vec<_> = seen.keys().copied().collect();
    let expected = [(Led::ToTheEnd, 0), (Led::ToTheEnd, 1), (Led::Called, 0), (Led::No, 0)];
    assert_eq!(outcomes, expected, "{seen:?}");
}

#[test]
fn a_look_into_the_socket_does_not_make_up_for_the_waker() {
    must_fail_large(DEADLOCK, || answer_by_datagram(Planted { no_waker: true, ..Planted::default() }, 1));
}

/// The answer comes from another task of the node; meanwhile a datagram for a third task comes. Returns whether the
/// leader was woken, and whether the leader took that datagram.
fn answer_by_another_task(planted: Planted) -> (Led, u32) {
    let scene = Scene::new(planted, 1);
    let (poller, other) = (Arc::clone(&scene), Arc::clone(&scene));
    let poller = thread::spawn(move || poller.run_poller());
    let other = thread::spawn(move || {
        other.socket.arrive(false);
        other.handoff.deliver(Brought::Answer, &mut 0);
    });
    let went = scene.run_task(0);
    other.join().unwrap();
    assert_eq!(went.1 + poller.join().unwrap(), 1, "a datagram was taken twice or not at all");
    went
}

#[test]
fn a_datagram_for_others_is_taken_though_the_leader_leaves() {
    let seen = explore_large(|| answer_by_another_task(Planted::default()));
    let outcomes: Vec<_> = seen.keys().copied().collect();
    let (end, called, no) = (Led::ToTheEnd, Led::Called, Led::No);
    assert_eq!(outcomes, [(end, 0), (end, 1), (called, 0), (called, 1), (no, 0)], "{seen:?}");
}

#[test]
fn a_leader_that_leaves_what_it_was_told_of_hands_it_to_nobody() {
    must_fail_large(DEADLOCK, || answer_by_another_task(Planted { leaves_told: true, ..Planted::default() }));
}

/// The polling thread finds the socket empty. While it still holds the right to receive, the kernel reports the next
/// datagram to the leader.
fn two_datagrams(planted: Planted) -> (Led, u32) {
    let scene = Scene::new(planted, 2);
    scene.socket.arrive(false);
    let (poller, network) = (Arc::clone(&scene), Arc::clone(&scene));
    let poller = thread::spawn(move || poller.run_poller());
    let network = thread::spawn(move || network.socket.arrive(true));
    let went = scene.run_task(0);
    network.join().unwrap();
    assert_eq!(went.1 + poller.join().unwrap(), 2, "a datagram was taken twice or not at all");
    went
}

#[test]
fn what_the_leader_leaves_to_the_one_at_work_is_taken() {
    let seen = explore_large(|| two_datagrams(Planted::default()));
    let outcomes: Vec<_> = seen.keys().copied().collect();
    let (end, called, no) = (Led::ToTheEnd, Led::Called, Led::No);
    let expected = [(end, 0), (end, 1), (end, 2), (called, 0), (called, 1), (no, 0), (no, 1)];
    assert_eq!(outcomes, expected, "{seen:?}");
}

#[test]
fn one_at_work_who_is_told_of_edges_leaves_a_datagram() {
    must_fail_large(DEADLOCK, || two_datagrams(Planted { edges: true, ..Planted::default() }));
}

/// The answer comes as a datagram while the spinning thread of another task checks the socket. No thread polls.
fn answer_beside_a_look(planted: Planted) -> (Led, u32) {
    let scene = Scene::new(planted, 1);
    let (other, network) = (Arc::clone(&scene), Arc::clone(&scene));
    let other = thread::spawn(move || {
        let mut took = 0;
        other.receiving.want();
        other.receiving.take(|()| {
            let datagram = other.socket.take();
            took += u32::from(datagram.is_some());
            other.deliver(datagram);
        });
        took
    });
    let network = thread::spawn(move || network.socket.arrive(true));
    let went = scene.run_task(0);
    network.join().unwrap();
    assert_eq!(went.1 + other.join().unwrap(), 1, "a datagram was taken twice or not at all");
    went
}

#[test]
fn what_the_leader_leaves_to_one_who_looks_is_taken() {
    let seen = explore_large(|| answer_beside_a_look(Planted::default()));
    let outcomes: Vec<_> = seen.keys().copied().collect();
    let expected = [(Led::ToTheEnd, 0), (Led::ToTheEnd, 1), (Led::Called, 0), (Led::No, 0)];
    assert_eq!(outcomes, expected, "{seen:?}");
}

#[test]
fn one_who_looks_and_leaves_blindly_leaves_a_datagram() {
    must_fail_large(DEADLOCK, || {
        answer_beside_a_look(Planted { leaves_blindly: true, ..Planted::default() })
    });
}
