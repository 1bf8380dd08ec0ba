//! Scenes of a task that is a future: it waits for an answer, or cancels its request. It shares its hand-off
//! (a lock with its inbox) with other futures, so the answer for it is in the state that the lock protects
//! (D187).

use super::{DEADLOCK, Listed, must_fail};
use crate::clock::FAR;
use crate::explorer::{Arc, SEES_OLD_VALUES, explore, thread};
use crate::sync::handoff::{Handoff, Plant, Protected, Rest};
use crate::sync::park::Park;
use crate::sync::ready::ReadyFutures;
use crate::sync::task_waker::TaskWaker;
use std::task::{Wake, Waker};

/// A state machine whose task may have made a request. Like the real one, it confirms a cancellation even if the
/// task does not wait.
#[derive(Default)]
struct Asked {
    waits: bool,
    kept: u32,
    answer: Option<Got>,
}

#[derive(Clone, Copy, PartialEq)]
enum Brought {
    Question,
    Message,
    Cancel,
    Nothing,
}

impl Listed for Brought {
    const ALL: &[Self] = &[Self::Question, Self::Message, Self::Cancel, Self::Nothing];
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Got {
    Message,
    Cancelled,
}

impl Protected for Asked {
    type Input = Brought;
    type Completion = Got;
    /// Whether there is an answer for the future.
    type Effects = bool;

    fn may_wait(input: &Brought) -> bool {
        matches!(input, Brought::Message)
    }

    fn feed(&mut self, input: &mut Brought, called: &mut bool) -> Option<Got> {
        match *input {
            Brought::Question => self.waits = true,
            Brought::Message if std::mem::take(&mut self.waits) => {
                self.answer = Some(Got::Message);
                *called = true;
            }
            Brought::Message => self.kept += 1,
            Brought::Cancel => {
                self.waits = false;
                self.answer = Some(Got::Cancelled);
            }
            Brought::Nothing => {}
        }
        None
    }

    fn settle(&mut self, _rest: Rest, _called: &mut bool) -> u64 {
        FAR
    }
}

/// The waker of the future at position 0 of its thread: it marks that future as ready.
struct Mark(std::sync::Arc<ReadyFutures>);

impl Wake for Mark {
    fn wake(self: std::sync::Arc<Self>) {
        self.0.wake(0);
    }
}

struct Scene {
    handoff: Handoff<Asked, Option<Plant>>,
    waker: TaskWaker,
    ready: std::sync::Arc<ReadyFutures>,
}

impl Scene {
    fn new(plant: Option<Plant>) -> Arc<Self> {
        let ready = std::sync::Arc::new(ReadyFutures::new(1, Park::new(None)));
        let handoff = Handoff::planted(Asked::default(), None, plant);
        Arc::new(Self { handoff, waker: TaskWaker::new(), ready })
    }

    fn bring_a_message(self: &Arc<Self>) -> thread::JoinHandle<()> {
        let scene = Arc::clone(self);
        thread::spawn(move || {
            let mut called = false;
            scene.handoff.deliver(Brought::Message, &mut called);
            if called {
                scene.waker.wake();
            }
        })
    }

    /// Takes the future's answer. If there is none yet, gives the state machine `input` first; with `blindly`, gives
    /// it in any case.
    fn enter(&self, input: Brought, blindly: bool) -> Option<Got> {
        let mut called = false;
        let ask = |asked: &mut Asked, called: &mut bool| {
            if blindly || asked.answer.is_none() {
                asked.feed(&mut { input }, called);
            }
            asked.answer.take()
        };
        let (got, _) = self.handoff.enter_shared(ask, &mut called);
        if called {
            self.ready.mark_own(0);
        }
        got
    }

    /// Waits until the future is ready to be polled.
    fn wait(&self) {
        let mut polled = false;
        while !polled {
            self.ready.poll_ready(|_| polled = true);
            if !polled && !self.ready.any() {
                self.ready.park.sleep();
            }
        }
    }
}

/// The future makes its request and registers its waker; another thread brings the message. Returns how often the
/// future was polled again. With `late` the future waits as soon as the waker is registered, without entering the
/// state machine again.
fn ask_and_listen(plant: Option<Plant>, late: bool) -> u32 {
    let scene = Scene::new(plant);
    // Every future is polled once at the start.
    scene.wait();
    let other = scene.bring_a_message();
    let (mut polls, mut listens) = (0, false);
    let mut got = scene.enter(Brought::Question, false);
    while got.is_none() {
        if !std::mem::replace(&mut listens, true) {
            let mark = Mark(std::sync::Arc::clone(&scene.ready));
            scene.waker.listen(&Waker::from(std::sync::Arc::new(mark)));
            if !late {
                got = scene.enter(kept(&scene), false);
                continue;
            }
        }
        polls += 1;
        scene.wait();
        got = scene.enter(kept(&scene), false);
    }
    other.join().unwrap();
    polls
}

/// What the future asks next: for the message that came before its request, if the state machine keeps one.
fn kept(scene: &Scene) -> Brought {
    let kept = scene.handoff.look_at(|asked| std::mem::take(&mut asked.kept));
    if kept > 0 { Brought::Message } else { Brought::Nothing }
}

#[test]
fn a_future_that_listens_is_woken() {
    let seen = explore(|| ask_and_listen(None, false));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [0, 1], "{seen:?}");
}

#[test]
fn a_future_that_listens_too_late_waits_for_ever() {
    must_fail(DEADLOCK, || ask_and_listen(None, true));
}

#[test]
fn a_message_left_while_the_future_entered_is_taken_when_it_leaves() {
    must_fail(DEADLOCK, || ask_and_listen(Some(Plant::NoSecondLook), false));
    if SEES_OLD_VALUES {
        must_fail(DEADLOCK, || ask_and_listen(Some(Plant::NoFence), false));
    }
}

/// The future cancels its wait while another thread brings the message. Returns what the future got.
fn give_up(blindly: bool) -> Got {
    let scene = Scene::new(None);
    scene.enter(Brought::Question, false);
    let other = scene.bring_a_message();
    let got = scene.enter(Brought::Cancel, blindly).expect("one or the other");
    other.join().unwrap();
    let kept = scene.handoff.look_at(|asked| asked.kept);
    assert_eq!(kept + u32::from(got == Got::Message), 1, "a message is gone");
    got
}

#[test]
fn a_message_for_a_wait_that_is_given_up_is_found_or_kept() {
    let seen = explore(|| give_up(false));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [Got::Message, Got::Cancelled], "{seen:?}");
}

#[test]
fn a_wait_that_is_given_up_blindly_loses_a_message() {
    must_fail("a message is gone", || give_up(true));
}
