//! The folds: each computes one result from the facts of a run. A fold takes the facts one by one, and keeps no more
//! than its result needs.

pub mod attendance;
pub mod gatherer;
pub mod joined;
pub mod links;
pub mod report;
pub mod rounds;
pub mod settled;
pub mod spans;
pub mod spread;
pub mod standing;
pub mod story;
pub mod summary;
pub mod tally;
pub mod timeline;
pub mod trouble;
