//! The concurrent pieces of the runtime under many schedules, by shuttle: the same source and the same scenes that loom
//! explores in the unit tests, with no old values but many more schedules.

#[allow(dead_code, reason = "the pieces bring along what no scene needs")]
#[path = "../../src/alarm.rs"]
mod alarm;
#[allow(dead_code, reason = "the scenes count nobody")]
#[path = "../../src/awake.rs"]
mod awake;
#[allow(dead_code, reason = "the scenes have clocks of their own")]
#[path = "../../src/clock.rs"]
mod clock;
#[path = "../../src/explored/mod.rs"]
mod explored;
mod explorer;
#[allow(dead_code, reason = "the pieces bring along what no scene needs")]
#[path = "../../src/handoff.rs"]
mod handoff;
#[path = "../../src/inbox.rs"]
mod inbox;
#[allow(dead_code, reason = "the pieces bring along what no scene needs")]
#[path = "../../src/lane.rs"]
mod lane;
#[allow(dead_code, reason = "no time passes in a scene")]
#[path = "../../src/lead.rs"]
mod lead;
#[path = "../../src/park.rs"]
mod park;
#[path = "../../src/ring.rs"]
mod ring;
#[path = "../../src/station.rs"]
mod station;
#[allow(dead_code, reason = "the pieces bring along what no scene needs")]
#[path = "../../src/sync.rs"]
mod sync;
#[path = "../../src/turn.rs"]
mod turn;
