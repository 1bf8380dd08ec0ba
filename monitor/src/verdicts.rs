//! The validator's verdicts of the last minutes, for moving back while paused. They are no frames of a node, so the
//! frames of the history do not contain them.

use crate::clock::Moment;
use crate::conformance::Conformance;
use crate::source::{Arrival, Feed, SourceId};
use std::collections::{BTreeMap, VecDeque};
use std::mem::discriminant;
use std::time::Duration;

/// For how long arrivals and verdicts are kept, so that the user can move back to them.
pub const LENGTH: Duration = Duration::from_secs(600);
/// Two equal verdicts on an incarnation are kept only if they are this far apart.
const APART: Duration = Duration::from_secs(1);
/// For how many incarnations verdicts are kept, at most.
const INCARNATIONS: usize = 256;

/// The verdicts of the last [`LENGTH`], by cell, node and incarnation.
#[derive(Clone, Debug, Default)]
pub(crate) struct Verdicts(BTreeMap<(String, String, u8), VecDeque<(Moment, Conformance)>>);

impl Verdicts {
    /// Keeps a verdict; other arrivals are ignored.
    pub(crate) fn take(&mut self, arrival: &Arrival) {
        let Feed::Judged { cell, node, incarnation, said } = &arrival.feed else { return };
        let key = (cell.clone(), node.clone(), *incarnation);
        if !self.0.contains_key(&key) && self.0.len() == INCARNATIONS {
            self.0.pop_first();
        }
        let kept = self.0.entry(key).or_default();
        let like = |(at, last): &(Moment, Conformance)| {
            let same = discriminant(&last.verdict) == discriminant(&said.verdict);
            same && arrival.at.saturating_sub(*at) < APART
        };
        if !kept.back().is_some_and(like) {
            kept.push_back((arrival.at, (**said).clone()));
        }
        // The last verdict before the kept time stays, because it still applies at the start of that time.
        while kept.get(1).is_some_and(|(at, _)| arrival.at.saturating_sub(*at) > LENGTH) {
            kept.pop_front();
        }
    }

    /// For each incarnation, the latest verdict before a moment.
    pub(crate) fn at(&self, moment: Moment) -> impl Iterator<Item = Arrival> {
        self.0.iter().filter_map(move |((cell, node, incarnation), kept)| {
            let (at, said) = kept.iter().rfind(|(at, _)| *at <= moment)?;
            let (cell, node, said) = (cell.clone(), node.clone(), Box::new(said.clone()));
            let feed = Feed::Judged { cell, node, incarnation: *incarnation, said };
            Some(Arrival { at: *at, source: SourceId(0), feed })
        })
    }
}
