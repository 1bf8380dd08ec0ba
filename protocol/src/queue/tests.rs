//! Tests of the queue against a plain list.

use super::*;
use proptest::prelude::*;

/// A test entry. Its side data are the instant at which it is due.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Item {
    key: Key,
    yields: bool,
}

impl Entry for Item {
    type Side = Instant;
    fn key(&self) -> Key {
        self.key
    }
    fn due(&self, side: &Instant) -> Instant {
        *side
    }
    fn yields(&self) -> bool {
        self.yields
    }
}

/// Compares the queue with a plain list.
fn agrees(queue: &mut Queue<Item>, model: &[(Slot, Item, u64)]) -> Result<(), TestCaseError> {
    let named = |found: Option<(Slot, &Item)>| found.map(|(slot, item)| (slot, *item));
    prop_assert_eq!((queue.len(), queue.capacity()), (model.len(), 20));
    let all = model.iter().map(|&(slot, item, _)| (slot, item));
    prop_assert_eq!(named(queue.first()), all.clone().min_by_key(|(_, i)| i.key));
    prop_assert_eq!(named(queue.last()), all.clone().max_by_key(|(_, i)| (i.yields, i.key)));
    let due = model.iter().map(|&(_, _, due)| Instant(due)).min().unwrap_or(Instant::NEVER);
    prop_assert_eq!(queue.next_due(), due);
    prop_assert!(queue.is_in_order());
    let mut sorted: Vec<_> = all.collect();
    sorted.sort_by_key(|(_, i)| i.key);
    let found: Vec<_> = queue.sorted().into_iter().map(|(slot, item)| (slot, *item)).collect();
    prop_assert_eq!(&found, &sorted);
    for now in [0, 2, 5, 9] {
        let mut found: Vec<_> = queue.all_due(Instant(now)).map(|(slot, _)| slot).collect();
        found.sort_unstable();
        let mut all: Vec<_> =
            model.iter().filter(|(_, _, due)| *due <= now).map(|&(slot, ..)| slot).collect();
        all.sort_unstable();
        prop_assert_eq!(found, all, "due by {}", now);
    }
    Ok(())
}

proptest! {
    /// Compares the queue with a plain list under pushes, pops, removals, and changes of one entry or of all.
    #[test]
    fn behaves_like_a_list(steps in proptest::collection::vec((0..9_u8, any::<u16>(), 0..10_u64, any::<bool>()), 0..200)) {
        let mut queue = Queue::watched(20);
        let mut model: Vec<(Slot, Item, u64)> = Vec::new();
        for (n, (what, a, at, yields)) in steps.into_iter().enumerate() {
            // Some instants are equal, and some do not fit into a heap word.
            let instant = u64::from(a % 8) << if a & 8 == 0 { 0 } else { 61 };
            let item = Item { key: (Instant(instant), n as u64), yields };
            let nth = model.get(usize::from(a) % 20).copied();
            match (what, nth) {
                (0..=3, _) => match queue.push_with(item, Instant(at)) {
                    Ok(slot) => model.push((slot, item, at)),
                    Err(back) => prop_assert!(back == item && model.len() == 20),
                },
                (4, _) => {
                    let popped = queue.pop_if(|_| true);
                    let first = model.iter().min_by_key(|(_, i, _)| i.key).copied();
                    prop_assert_eq!(popped, first.map(|(_, item, _)| item));
                    model.retain(|&entry| Some(entry) != first);
                }
                (5, _) => {
                    let popped = queue.pop_due(Instant(4));
                    let first = model.iter().filter(|(_, _, due)| *due <= 4).min_by_key(|(_, i, due)| (*due, i.key));
                    prop_assert_eq!(popped, first.map(|&(_, item, _)| item));
                    model.retain(|&(_, item, _)| Some(item) != popped);
                }
                (6, _) => {
                    queue.change_all(|item, due| (item.key, *due) = ((Instant(item.key.0.0 ^ 0xff), item.key.1), Instant(due.0 ^ 3)));
                    model.iter_mut().for_each(|(_, item, due)| (item.key, *due) = ((Instant(item.key.0.0 ^ 0xff), item.key.1), *due ^ 3));
                }
                (7, Some((slot, old, _))) => {
                    prop_assert_eq!(queue.remove(slot), Some(old));
                    prop_assert_eq!(queue.remove(slot), None);
                    model.retain(|&(s, ..)| s != slot);
                }
                (_, Some((slot, ..))) => {
                    queue.change(slot, |old, due| (*old, *due) = (item, Instant(at)));
                    let changed = model.iter_mut().filter(|(s, ..)| *s == slot);
                    changed.for_each(|(_, old, due)| (*old, *due) = (item, at));
                }
                (_, None) => {}
            }
            agrees(&mut queue, &model)?;
        }
        queue.clear();
        agrees(&mut queue, &[])?;
        let again = Item { key: (Instant(0), 1), yields: false };
        prop_assert_eq!((queue.push(again), queue.push(again)), (Ok(0), Ok(1)));
    }
}
