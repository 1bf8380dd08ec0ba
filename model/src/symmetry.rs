//! The symmetry reduction: members of a meeting are interchangeable, so the canonical form of a state is that renaming of
//! its members whose packed bytes are least. This form is computed inside `next_state`, so that every search uses it
//! (stateright's breadth-first search ignores stateright's own `symmetry`).

use crate::network::{Codec, InFlight, Packed};
use crate::state::HEADER;
use imrs_protocol::{Frame, Overflow, TaskId};

/// With this many members, `views` costs less than trying all renamings of members with equal features.
const MANY: usize = 4;

/// The parts from which a packed state is composed.
pub(crate) struct Parts<'a> {
    pub header: [u8; HEADER],
    pub specs: &'a [Vec<u8>],
    pub blocks: &'a [Vec<u8>],
    pub packets: &'a [InFlight],
    pub frame: Frame<'a>,
    pub codec: Codec,
}

impl Parts<'_> {
    /// The packed state with its members in their present order.
    pub fn in_order(&self) -> Result<Vec<u8>, Overflow> {
        let mut bytes = Vec::with_capacity(96);
        bytes.extend(self.header);
        self.specs.iter().for_each(|spec_state| bytes.extend(spec_state));
        self.blocks.iter().for_each(|block| bytes.extend(block));
        self.put_in_flight(|task| u8::try_from(task.0).unwrap_or(u8::MAX), &mut bytes)?;
        Ok(bytes)
    }

    /// The canonical form: the least bytes of all renamings of the state, and the order of members that gives these bytes.
    /// Only orders that sort the members by their renaming-invariant features are tried.
    pub fn least(&self) -> Result<(Vec<u8>, Vec<usize>), Overflow> {
        let n = self.blocks.len();
        let mut order: Vec<usize> = (0..n).collect();
        let views = if n < MANY { Vec::new() } else { self.views()? };
        let signature = |i: usize| {
            let block = self.block(i);
            (self.specs[i].as_slice(), block.node, block.task, views.get(i).map(Vec::as_slice))
        };
        order.sort_by(|&a, &b| signature(a).cmp(&signature(b)));
        let mut best = (self.renamed(&order)?, order.clone());
        // Members with equal features may still differ in what they know of each other.
        let mut permutation = order.clone();
        while next_permutation(&mut permutation, |a, b| signature(a) == signature(b), &order) {
            let candidate = self.renamed(&permutation)?;
            if candidate < best.0 {
                best = (candidate, permutation.clone());
            }
        }
        Ok(best)
    }

    /// More renaming-invariant features of each member: what the member knows of the others, what the others know of the
    /// member, and the packets in flight from and to the member.
    fn views(&self) -> Result<Vec<Vec<u8>>, Overflow> {
        let n = self.blocks.len();
        let entries: Vec<_> = (0..n).map(|i| self.entries(&self.block(i))).collect();
        let knows = |i: usize, of: usize| entries[i].get(of).copied().unwrap_or_default();
        let mut packets = Vec::with_capacity(self.packets.len());
        for carried in self.packets {
            let (from, to) = (carried.packet.source.index(), carried.packet.destination.index());
            packets.push((self.codec.encode(carried, &self.frame, |_| 0)?, from, to));
        }
        let view = |i: usize| {
            let mut own: Vec<_> = (0..n).map(|of| knows(i, of)).collect();
            let mut others: Vec<_> = (0..n).map(|other| knows(other, i)).collect();
            own.sort_unstable();
            others.sort_unstable();
            let mut view: Vec<u8> = own.into_iter().chain(others).flatten().copied().collect();
            let near = packets.iter().filter(|&&(_, from, to)| from == i || to == i);
            let mut near: Vec<_> = near.map(|(packed, from, _)| (packed, *from == i)).collect();
            near.sort_unstable();
            for (packed, sent) in near {
                view.push(u8::from(sent));
                view.extend(packed.as_bytes());
            }
            view
        };
        Ok((0..n).map(view).collect())
    }

    /// The packed state with its members renamed: member `order[k]` moves to position `k`.
    pub fn renamed(&self, order: &[usize]) -> Result<Vec<u8>, Overflow> {
        let mut bytes = Vec::with_capacity(96);
        bytes.extend(self.header);
        order.iter().for_each(|&i| bytes.extend(&self.specs[i]));
        for &i in order {
            let block = self.block(i);
            bytes.push(block.len);
            bytes.extend(block.node);
            if !block.known.is_empty() {
                order.iter().for_each(|&of| bytes.push(block.known[of]));
            }
            bytes.extend(block.task);
            let entries = self.entries(&block);
            order.iter().for_each(|&of| bytes.extend(entries.get(of).copied().unwrap_or_default()));
        }
        let position = |task: TaskId| order.iter().position(|&i| i == task.index()).unwrap_or(0);
        self.put_in_flight(|task| u8::try_from(position(task)).unwrap_or(u8::MAX), &mut bytes)?;
        Ok(bytes)
    }

    fn put_in_flight(&self, rename: impl Fn(TaskId) -> u8, bytes: &mut Vec<u8>) -> Result<(), Overflow> {
        let mut packed: Vec<Packed> = Vec::with_capacity(self.packets.len());
        for carried in self.packets {
            packed.push(self.codec.encode(carried, &self.frame, &rename)?);
        }
        packed.sort_unstable();
        packed.iter().for_each(|carried| bytes.extend(carried.as_bytes()));
        Ok(())
    }
}

/// A packed node, split into the bytes that a renaming keeps and the bytes that it permutes.
struct Block<'a> {
    len: u8,
    /// The node's least round and, if nodes can restart, whether the node is up, and its incarnation.
    node: &'a [u8],
    /// If nodes can restart, the incarnations in which this node knows the other nodes.
    known: &'a [u8],
    /// The node's task without the entries for the members.
    task: &'a [u8],
    /// The entries of the node's task for the members.
    members: &'a [u8],
}

impl Parts<'_> {
    fn block(&self, i: usize) -> Block<'_> {
        let block = self.blocks[i].as_slice();
        let incarnations = self.frame.incarnations;
        // This code follows the layout of `store_place`: length, least round; if nodes can restart, also up, own
        // incarnation, known incarnations.
        let known = if incarnations { 4 } else { 2 };
        let start = if incarnations { known + self.blocks.len() } else { known };
        // This code follows the layout of `CommTask::walk`: the ranks of the order; the wait (one byte for a task that only
        // meets); three more bytes if nodes can restart; then the meeting's flags, its round, and the fields that the flags
        // announce.
        let mut at = start;
        at += 1 + 2 * usize::from(block.get(at).copied().unwrap_or(0) & 0x0f);
        at += if incarnations { 4 } else { 1 };
        let flags = block.get(at).copied().unwrap_or(0);
        at += 2;
        at += usize::from(flags & 1 != 0) + usize::from(flags & 2 != 0) + usize::from(flags & 4 != 0);
        at += if flags & 16 != 0 { 2 } else { 0 };
        // A node that is down has no task, so its block ends before a task's bytes.
        let at = at.min(block.len());
        Block {
            len: block[0],
            node: &block[1..known],
            known: &block[known..start],
            task: &block[start..at],
            members: &block[at..],
        }
    }

    /// The entries of a node's task for the members, in order.
    fn entries<'a>(&self, block: &Block<'a>) -> Vec<&'a [u8]> {
        let mut entries = Vec::with_capacity(4);
        let mut bytes = block.members;
        while let Some(&flags) = bytes.first() {
            let len = 1 + if flags & 1 != 0 { 2 } else { 0 } + usize::from(flags & 2 != 0);
            let (entry, rest) = bytes.split_at((len + usize::from(self.frame.incarnations)).min(bytes.len()));
            entries.push(entry);
            bytes = rest;
        }
        entries
    }
}

/// Advances `p` to the next permutation among those that only exchange members for which `same` is true. Ranks are
/// positions in `order`.
fn next_permutation(p: &mut [usize], same: impl Fn(usize, usize) -> bool, order: &[usize]) -> bool {
    let rank = |i: usize| order.iter().position(|&o| o == i).unwrap_or(0);
    // The loop counts like an odometer over the groups of equal members: it advances the last group that has a next
    // arrangement, and resets the groups behind that one.
    let mut end = p.len();
    while end > 0 {
        let mut start = end - 1;
        while start > 0 && same(p[start - 1], p[end - 1]) {
            start -= 1;
        }
        if next_in_run(&mut p[start..end], rank) {
            return true;
        }
        p[start..end].sort_by_key(|&i| rank(i));
        end = start;
    }
    false
}

fn next_in_run(run: &mut [usize], rank: impl Fn(usize) -> usize) -> bool {
    let Some(pivot) = (1..run.len()).rev().find(|&i| rank(run[i - 1]) < rank(run[i])) else { return false };
    let Some(swap) = (pivot..run.len()).rev().find(|&i| rank(run[i]) > rank(run[pivot - 1])) else {
        return false;
    };
    run.swap(pivot - 1, swap);
    run[pivot..].reverse();
    true
}

#[cfg(test)]
mod tests {
    use super::next_permutation;

    #[test]
    fn every_arrangement_of_equal_members_is_visited_once() {
        let order = [4, 2, 7, 1, 0];
        let class = |i: usize| usize::from(i == 7 || i == 1);
        let mut p = order;
        let mut seen = vec![p];
        // Members 4 and 2, and members 7 and 1, form two groups of two; member 0 is alone.
        while next_permutation(&mut p, |a, b| class(a) == class(b), &order) {
            seen.push(p);
        }
        let all = [[4, 2, 7, 1, 0], [4, 2, 1, 7, 0], [2, 4, 7, 1, 0], [2, 4, 1, 7, 0]];
        assert_eq!(seen, all);
    }
}
