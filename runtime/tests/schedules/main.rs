//! Runs the concurrent parts of the runtime under many schedules, by shuttle. Source and scenes are the same that loom
//! explores in the unit tests. There are no stale values here, but many more schedules.

#[allow(dead_code, reason = "the scenes have clocks of their own")]
#[path = "../../src/clock.rs"]
mod clock;
#[path = "../../src/explored/mod.rs"]
mod explored;
mod explorer;
mod observe {
    pub(crate) use crate::ring;
}
#[path = "../../src/observe/ring.rs"]
mod ring;
#[allow(dead_code, reason = "the pieces bring along what no scene needs")]
#[path = "../../src/sync/mod.rs"]
mod sync;
