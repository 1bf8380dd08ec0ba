//! How the kept states of a search by zones were reached.

/// How a part of a state's zone was reached: from which kept state (`None`: from the start), and with which answers to the
/// run's comparisons of times.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin {
    pub parent: Option<u32>,
    pub answers: Box<[u16]>,
}

/// The origins of one state, the first and the last, in the order in which they were added.
#[derive(Clone, Copy, Debug)]
pub struct List {
    first: u32,
    last: u32,
}

/// An origin in the table.
struct Entry {
    /// [`NONE`] stands for the start.
    parent: u32,
    /// The next origin of the same state, or [`NONE`].
    next: u32,
    /// The place of the first of its answers, and their number.
    answers: (u32, u16),
}

const NONE: u32 = u32::MAX;

/// All origins of a search, in one table. A state takes over the origins of another by a change of one number. A list of
/// its own for each state would keep its room when it is emptied: that was most of a search's memory.
#[derive(Default)]
pub struct Origins {
    entries: Vec<Entry>,
    answers: Vec<u16>,
}

impl Origins {
    /// A list of this origin alone.
    pub fn one(&mut self, parent: Option<u32>, answers: &[u16]) -> List {
        let number_of = |len: usize| u32::try_from(len).expect("fewer than 2^32 answers");
        let (at, begin) = (number_of(self.entries.len()), number_of(self.answers.len()));
        let count = u16::try_from(answers.len()).expect("fewer than 2^16 answers in a run");
        self.answers.extend_from_slice(answers);
        let parent = parent.unwrap_or(NONE);
        self.entries.push(Entry { parent, next: NONE, answers: (begin, count) });
        List { first: at, last: at }
    }

    /// The origins of one list, and after them those of the other.
    pub fn join(&mut self, one: List, other: List) -> List {
        self.entries[one.last as usize].next = other.first;
        List { first: one.first, last: other.last }
    }

    /// The origins of a list.
    pub fn of(&self, list: List) -> impl Iterator<Item = Origin> {
        let first = Some(list.first);
        let next = move |&at: &u32| Some(self.entries[at as usize].next).filter(|_| at != list.last);
        std::iter::successors(first, next).map(|at| {
            let Entry { parent, answers: (begin, count), .. } = self.entries[at as usize];
            let answers = self.answers[begin as usize..].iter().take(count.into()).copied().collect();
            Origin { parent: Some(parent).filter(|&parent| parent != NONE), answers }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joined_lists_have_the_origins_of_both_in_their_order() {
        let mut origins = Origins::default();
        let all = [(None, &[][..]), (Some(3), &[1, 2]), (Some(0), &[]), (Some(7), &[5])];
        let [a, b, c, d] = all.map(|(parent, answers)| origins.one(parent, answers));
        let (first, second) = (origins.join(c, a), origins.join(d, b));
        let both = origins.join(second, first);
        let expected = [3, 1, 2, 0].map(|at: usize| all[at]);
        let found: Vec<Origin> = origins.of(both).collect();
        let found: Vec<_> = found.iter().map(|origin| (origin.parent, &*origin.answers)).collect();
        assert_eq!(found, expected);
    }
}
