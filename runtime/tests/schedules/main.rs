//! Runs the concurrent parts of the runtime under many schedules, by shuttle. The code and the scenes are those that
//! loom explores in the unit tests. With shuttle a load returns no stale value, but there are many more schedules.

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
