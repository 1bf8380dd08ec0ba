//! The cases that need no peer: hand-written baselines, and the subjects to measure.

pub mod cells;
pub mod floors;
pub mod growth;
pub mod handoff;
pub mod meet;
pub mod network;
pub mod observe;
pub mod queues;
pub mod recording;
#[cfg(feature = "screen")]
pub mod screen;
pub mod urgent;

use crate::suite::Suite;

/// All suites, with the peers of this build.
#[must_use]
pub fn all() -> Vec<Suite> {
    let mut suites = vec![
        handoff::awake(),
        handoff::threads(),
        urgent::urgent(),
        urgent::streams(),
        queues::queues(),
        queues::timers(),
        growth::growth(),
        growth::footprint(),
        meet::meetings(),
        network::network(),
        recording::recording(),
        observe::observe(),
    ];
    #[cfg(feature = "screen")]
    suites.push(screen::screen());
    crate::peers::join(&mut suites);
    suites
}
