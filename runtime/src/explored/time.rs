//! Scenes of time: which thread takes care of an expiry, and how the Timer thread ends.

use super::{DEADLOCK, Listed, must_fail, must_fail_large};
use crate::clock::{FAR, Micros};
use crate::explorer::{Arc, SEES_OLD_VALUES, explore, explore_large, thread};
use crate::sync::alarm::{Alarm, Cover, Keeps, Plant};
use crate::sync::handoff::{Handoff, Protected, Rest};
use crate::sync::{AtomicBool, Mutex, Ordering, lock};

type Planted = Alarm<Option<Plant>>;

fn alarm(slots: usize, plant: Option<Plant>) -> Arc<Planted> {
    Arc::new(Alarm::planted(slots, plant))
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Found {
    AtOnce,
    AfterSleep,
}

/// The Timer thread has served one deadline and searches the next, while another thread publishes a deadline.
fn publish_while_looking(plant: Option<Plant>) -> Found {
    let alarm = alarm(2, plant);
    alarm.publish(1, 3);
    assert_eq!(alarm.earliest().at, 3);
    let publisher = Arc::clone(&alarm);
    let other = thread::spawn(move || publisher.publish(0, 5));
    alarm.publish(1, FAR);
    let mut found = Found::AtOnce;
    loop {
        let earliest = alarm.earliest();
        if earliest.at == 5 {
            break;
        }
        alarm.sleep(earliest);
        found = Found::AfterSleep;
    }
    other.join().unwrap();
    found
}

#[test]
fn the_timer_thread_hears_of_every_expiry() {
    let seen = explore(|| publish_while_looking(None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [Found::AtOnce, Found::AfterSleep], "{seen:?}");
}

#[test]
fn a_target_that_is_not_opened_hides_an_expiry() {
    must_fail(DEADLOCK, || publish_while_looking(Some(Plant::NoOpenTarget)));
}

#[test]
fn without_its_fence_the_alarm_hides_an_expiry() {
    if SEES_OLD_VALUES {
        must_fail(DEADLOCK, || publish_while_looking(Some(Plant::NoFence)));
    }
}

/// The current instant for all threads of these scenes.
const NOW: Micros = 3;

/// Runs the Timer thread until it must end. Returns how often it served an expiry.
fn serve(alarm: &Planted, closing: &AtomicBool, mut tend: impl FnMut()) -> u32 {
    let mut served = 0;
    while alarm.next(0, || closing.load(Ordering::SeqCst), || NOW).is_some() {
        served += 1;
        tend();
    }
    served
}

/// The node closes while the Timer thread works or sleeps. Returns how many deadlines that thread served before it
/// ended.
fn close(plant: Option<Plant>) -> u32 {
    let alarm = alarm(1, plant);
    let closing = Arc::new(AtomicBool::new(false));
    let (theirs, told) = (Arc::clone(&alarm), Arc::clone(&closing));
    let timer = thread::spawn(move || serve(&theirs, &told, || theirs.publish(0, FAR)));
    alarm.publish(0, NOW);
    closing.store(true, Ordering::SeqCst);
    alarm.ring();
    timer.join().unwrap()
}

#[test]
fn closing_ends_the_timer_thread() {
    let seen = explore(|| close(None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [0, 1], "{seen:?}");
}

#[test]
fn looking_for_the_end_too_soon_sleeps_through_it() {
    must_fail(DEADLOCK, || close(Some(Plant::EndBeforeRung)));
}

/// A state machine with one deadline: now, or a long time from now.
struct Timed {
    alarm: Arc<Planted>,
    cover: Cover,
    due: Micros,
}

#[derive(Clone, Copy, PartialEq)]
enum Moment {
    /// The task makes a request with a long time_out.
    Asked,
    /// An input of another thread sets a deadline that is due now.
    Sooner,
    TimeIsUp,
    Nothing,
}

impl Listed for Moment {
    const ALL: &[Self] = &[Self::Asked, Self::Sooner, Self::TimeIsUp, Self::Nothing];
}

impl Protected for Timed {
    type Input = Moment;
    type Completion = ();
    /// Whether this thread has served the deadline.
    type Effects = bool;

    fn may_wait(_input: &Moment) -> bool {
        false
    }

    fn feed(&mut self, moment: &mut Moment, served: &mut bool) -> Option<()> {
        match moment {
            Moment::Asked => self.due = self.due.min(2 * NOW),
            Moment::Sooner => self.due = NOW,
            Moment::TimeIsUp if self.due <= NOW => {
                self.due = FAR;
                *served = true;
                return Some(());
            }
            Moment::TimeIsUp | Moment::Nothing => {}
        }
        None
    }

    fn settle(&mut self, rest: Rest, _served: &mut bool) -> Micros {
        self.cover.settle(&self.alarm, rest, self.due);
        self.due
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum ServedBy {
    TheTask,
    TheTimer,
}

/// A task goes to sleep for a long time while another thread sets a deadline that is due at once. Either the task
/// sees that deadline before it sleeps, or the Timer thread serves it.
fn an_expiry_changes_hands(covers_all: bool) -> ServedBy {
    let alarm = alarm(1, None);
    let mut cover = Cover::new(0);
    cover.covers_all = covers_all;
    let handoff = Arc::new(Handoff::new(Timed { alarm: Arc::clone(&alarm), cover, due: FAR }, None));
    let closing = Arc::new(AtomicBool::new(false));
    let (elsewhere, machine) = (Arc::clone(&handoff), Arc::clone(&handoff));
    let sooner = thread::spawn(move || elsewhere.deliver(Moment::Sooner, &mut false));
    let (theirs, told) = (Arc::clone(&alarm), Arc::clone(&closing));
    let timer = thread::spawn(move || {
        let mut served = false;
        serve(&theirs, &told, || machine.deliver_now(Moment::TimeIsUp, &mut served));
        served
    });
    let mut own = false;
    let mut entry = handoff.enter(Moment::Asked, &mut own);
    while entry.completion.is_none() {
        let moment = if entry.until <= NOW {
            Moment::TimeIsUp
        } else {
            handoff.sleep(Some(entry.until));
            Moment::Nothing
        };
        entry = handoff.enter(moment, &mut own);
    }
    closing.store(true, Ordering::SeqCst);
    alarm.ring();
    sooner.join().unwrap();
    let timers = timer.join().unwrap();
    assert!(own != timers, "an expiry is served once");
    if own { ServedBy::TheTask } else { ServedBy::TheTimer }
}

#[test]
fn an_expiry_always_has_somebody_to_look_after_it() {
    let seen = explore_large(|| an_expiry_changes_hands(false));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [ServedBy::TheTask, ServedBy::TheTimer], "{seen:?}");
}

#[test]
fn an_expiry_before_the_end_of_the_sleep_needs_the_timer() {
    must_fail_large(DEADLOCK, || an_expiry_changes_hands(true));
}

/// A state machine whose deadlines only the Timer thread serves. Most of its requests are answered in time.
struct Kept {
    cover: Cover,
    now: Micros,
    due: Micros,
}

impl Kept {
    /// Sets the state machine's next deadline.
    fn expires(&mut self, due: Micros, alarm: &Planted) {
        self.due = due;
        self.settle(alarm);
    }

    /// Advances the state machine in the Timer thread.
    fn time_is_up(&mut self, alarm: &Planted) {
        self.now = NOW;
        self.due = if self.due <= NOW { FAR } else { self.due };
        self.settle(alarm);
        assert!(alarm.slot(0) > NOW, "what is over stays published");
    }

    fn settle(&self, alarm: &Planted) {
        self.cover.keep(alarm, self.now, self.due);
        assert!(alarm.slot(0) <= self.due, "an expiry is hidden");
    }
}

/// A state machine makes a request and gets its answer in time. Then it makes two more, the last with a shorter
/// time_out. The Timer thread serves the machine. Returns which deadline is published after the answer.
fn an_answered_request_stays_published(keeps: Option<Keeps>) -> Micros {
    let alarm = alarm(1, None);
    let mut cover = Cover::new(0);
    cover.keeps = keeps;
    let machine = Arc::new(Mutex::new(Kept { cover, now: 0, due: FAR }));
    let closing = Arc::new(AtomicBool::new(false));
    let (theirs, told, served) = (Arc::clone(&alarm), Arc::clone(&closing), Arc::clone(&machine));
    let timer = thread::spawn(move || serve(&theirs, &told, || lock(&served).time_is_up(&theirs)));
    lock(&machine).expires(NOW - 1, &alarm);
    lock(&machine).expires(FAR, &alarm);
    let stands = alarm.slot(0);
    lock(&machine).expires(2 * NOW, &alarm);
    lock(&machine).expires(NOW + 1, &alarm);
    closing.store(true, Ordering::SeqCst);
    alarm.ring();
    timer.join().unwrap();
    stands
}

#[test]
fn what_was_answered_in_time_is_published_until_it_is_over() {
    let seen = explore_large(|| an_answered_request_stays_published(None));
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), [NOW - 1, FAR], "{seen:?}");
}

#[test]
fn a_cover_that_keeps_what_is_over_never_rests() {
    must_fail_large("what is over stays", || an_answered_request_stays_published(Some(Keeps::WhatIsOver)));
}

#[test]
fn a_cover_that_keeps_what_is_later_hides_an_expiry() {
    must_fail_large("an expiry is hidden", || an_answered_request_stays_published(Some(Keeps::WhatIsLater)));
}
