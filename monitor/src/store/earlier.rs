//! The earlier incarnations of a node: which of them the store keeps, and how many have died.

use super::{Condition, NodeIncarnation, Store};

/// How many earlier incarnations of a node the store keeps besides the latest one.
const EARLIER_INCARNATIONS: usize = 3;

impl Store {
    /// How many earlier incarnations of the node of `incarnation` have died while the monitor watched.
    #[must_use]
    pub fn deaths_before(&self, incarnation: &NodeIncarnation) -> u32 {
        let earlier = self.incarnations_of(&incarnation.names.cell).filter(|other| {
            other.node_id == incarnation.node_id
                && other.node == incarnation.node
                && other.id < incarnation.id
        });
        let died = |other: &NodeIncarnation| u32::from(matches!(other.condition, Condition::Dead { .. }));
        earlier
            .map(|other| other.buried.saturating_add(died(other)))
            .fold(incarnation.buried, u32::saturating_add)
    }

    /// Drops the earliest ended incarnations of nodes that have had many. The next incarnation keeps the number of deaths.
    pub(super) fn forget_early_incarnations(&mut self) {
        let is_same =
            |a: &NodeIncarnation, b: &NodeIncarnation| a.names.cell == b.names.cell && a.node == b.node;
        let later = |incarnation: &NodeIncarnation| {
            let is_later =
                |other: &&NodeIncarnation| is_same(other, incarnation) && other.id > incarnation.id;
            self.incarnations.iter().filter(is_later).count()
        };
        let gone = |incarnation: &NodeIncarnation| incarnation.condition != Condition::Attached;
        let is_forgotten =
            |incarnation: &&NodeIncarnation| gone(incarnation) && later(incarnation) > EARLIER_INCARNATIONS;
        let forgotten: Vec<_> = self.incarnations.iter().filter(is_forgotten).cloned().collect();
        self.incarnations.retain(|one| !forgotten.iter().any(|gone| gone.id == one.id));
        for gone in forgotten {
            let next = self.incarnations.iter_mut().find(|other| is_same(other, &gone) && other.id > gone.id);
            if let Some(next) = next {
                let died = u32::from(matches!(gone.condition, Condition::Dead { .. }));
                next.buried = next.buried.saturating_add(gone.buried).saturating_add(died);
            }
            self.services.forget(gone.id);
            self.judged.remove(&gone.id);
        }
    }
}
