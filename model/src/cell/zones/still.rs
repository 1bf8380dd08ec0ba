//! Looks for standstills among the kept states.
//!
//! A state is *still* if no run from it, without faults and restarts, leads to progress or to an end, at any of its times. So a
//! standstill that only some times of a state lead to may be missed. What is told was found again on plain ticks, where it is
//! explored as that of the search at every tick.

use super::store::Store;

/// Where runs without faults and restarts lead.
#[derive(Default)]
pub struct Walks {
    /// Runs without progress: from one state to one that covers its end.
    steps: Vec<(u32, u32)>,
    /// States with a run to progress or to an end.
    free: Vec<u32>,
}

impl Walks {
    /// Notes a run that leads to these states; without any it leads to progress or to an end.
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
        // A state without any run free of faults is an end, too.
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
