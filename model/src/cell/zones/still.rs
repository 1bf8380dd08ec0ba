//! Looks for standstills among the kept states of a search by zones.
//!
//! A state is *still* if no run from it, without faults and restarts, leads to progress or to an end, at any of its times.
//! So the search may miss a standstill to which only some times of a state lead. A reported standstill was found again on
//! plain ticks, where it was explored in the same way as in the search at every tick.

use super::store::Store;

/// Where runs without faults and restarts lead to.
#[derive(Default)]
pub struct Walks {
    /// The runs without progress: the number of the state where the run begins, and the number of a kept state that
    /// covers the run's end.
    steps: Vec<(u32, u32)>,
    /// States from which a run leads to progress or to an end.
    free: Vec<u32>,
}

impl Walks {
    /// Notes a run that leads to the states `to`. If there are none, the run leads to progress or to an end.
    pub fn note(&mut self, from: u32, to: &[u32]) {
        if to.is_empty() {
            self.free.push(from);
        }
        self.steps.extend(to.iter().map(|&to| (from, to)));
    }

    /// The still states.
    pub fn still(&self, store: &Store) -> Vec<u32> {
        let count = store.states.len();
        let mut is_free = vec![false; count];
        let mut leads = vec![false; count];
        let mut back: Vec<(u32, u32)> = self.steps.iter().map(|&(from, to)| (store.heir(to), from)).collect();
        back.sort_unstable();
        back.dedup();
        self.steps.iter().for_each(|&(from, _)| leads[from as usize] = true);
        // A state without any run is an end, too: every run from it needs a fault or a restart.
        let ends = (0_u32..).zip(&leads).filter(|(_, leads)| !**leads).map(|(at, _)| at);
        let mut open: Vec<u32> = self.free.iter().copied().chain(ends).collect();
        while let Some(at) = open.pop() {
            if std::mem::replace(&mut is_free[at as usize], true) {
                continue;
            }
            let begin = back.partition_point(|&(to, _)| to < at);
            open.extend(back[begin..].iter().take_while(|&&(to, _)| to == at).map(|&(_, from)| from));
        }
        (0_u32..).zip(is_free).filter(|(_, is_free)| !is_free).map(|(at, _)| at).collect()
    }
}
