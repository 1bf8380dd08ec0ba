//! The stale-command duel: the commands of one stream, and the tally of those that were executed.
//!
//! The program `imrs-duel` sends the stream through the runtime, zenoh and libzmq. `specs/duel.md` explains it and has
//! the results.

use crate::report::time;
use crate::sample::Sample;
use rustix::time::{ClockId, clock_gettime};
use std::time::Duration;

/// How old a command may be when its execution begins. An older one is stale.
pub const TTL: Duration = Duration::from_millis(50);
/// The time from one command of the stream to the next.
pub const PERIOD: Duration = Duration::from_millis(5);
/// How long each execution takes.
pub const EXECUTION: Duration = Duration::from_millis(1);
/// The number of a command that only tests whether the other end runs. The executor does not execute it.
pub const WARM_UP: u32 = u32::MAX;

/// A command of the stream: its number, and when it was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Command {
    /// The command's position in the stream, or [`WARM_UP`].
    pub number: u32,
    /// When the command was made, in nanoseconds of the machine's monotonic clock.
    made: u64,
}

impl Command {
    /// The length of a command in bytes: what one packet holds.
    pub const BYTES: usize = 12;

    /// A command that is made now.
    #[must_use]
    pub fn now(number: u32) -> Self {
        Self { number, made: nanos() }
    }

    /// The command in bytes, as every contestant carries it.
    #[must_use]
    pub fn encode(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        bytes[..4].copy_from_slice(&self.number.to_le_bytes());
        bytes[4..].copy_from_slice(&self.made.to_le_bytes());
        bytes
    }

    /// The command in these bytes; `None` if they are too few or too many.
    #[must_use]
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (number, made) = bytes.split_first_chunk()?;
        Some(Self { number: u32::from_le_bytes(*number), made: u64::from_le_bytes(made.try_into().ok()?) })
    }

    /// How old the command is now, in nanoseconds. Both ends run on one machine, so they have one clock.
    #[must_use]
    pub fn age(self) -> u64 {
        nanos().saturating_sub(self.made)
    }
}

/// The machine's monotonic clock in nanoseconds, which is the same in all processes.
fn nanos() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec.unsigned_abs() * 1_000_000_000 + now.tv_nsec.unsigned_abs()
}

/// The result of a stream.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// How many commands were sent.
    pub sent: u64,
    /// How long the stream was.
    pub length: Duration,
    /// Each execution: the number of the command, and its age in nanoseconds when the execution began.
    pub executions: Vec<(u32, u64)>,
}

impl Tally {
    /// Adds another stream of the same contestant under the same conditions.
    pub fn add(&mut self, other: &Self) {
        self.sent += other.sent;
        self.length += other.length;
        self.executions.extend(&other.executions);
    }

    /// How many executions began when their command was older than [`TTL`].
    #[must_use]
    pub fn stale(&self) -> u64 {
        let is_stale = |(_, age): &&(u32, u64)| Duration::from_nanos(*age) > TTL;
        self.executions.iter().filter(is_stale).count() as u64
    }

    /// How many executions began in time.
    #[must_use]
    pub fn in_time(&self) -> u64 {
        self.executions.len() as u64 - self.stale()
    }

    /// The columns of [`HEAD`] that this tally fills.
    #[must_use]
    pub fn columns(&self) -> String {
        let ages: Vec<u64> = self.executions.iter().map(|(_, age)| *age).collect();
        let oldest = ages.iter().max().copied().unwrap_or_default();
        let goodput = self.in_time() as f64 / self.length.as_secs_f64();
        let p999 = time(Sample::of(ages, 1).p999);
        let oldest = time(oldest as f64);
        format!("{} | {} | {} | {goodput:.0} | {p999} | {oldest}", self.sent, self.in_time(), self.stale())
    }
}

/// The head of the table of results.
pub const HEAD: &str = "| conditions | contestant | sent | executed in time | **executed stale** | in time per second | age at execution, p99.9 | oldest |\n\
                        |---|---|---|---|---|---|---|---|\n";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_read_as_it_was_written() {
        let command = Command::now(7);
        assert_eq!(Command::decode(&command.encode()), Some(command));
        assert_eq!([11, 13].map(|length| Command::decode(&vec![0; length])), [None, None]);
        std::thread::sleep(Duration::from_millis(2));
        assert!(command.age() >= 2_000_000);
    }

    #[test]
    fn a_command_is_stale_once_it_is_older_than_its_time_to_live() {
        let ttl = 50_000_000;
        let executions = vec![(0, 1_000_000), (1, ttl), (2, ttl + 1), (3, 4 * ttl)];
        let mut tally = Tally { sent: 5, length: Duration::from_secs(1), executions };
        assert_eq!((tally.stale(), tally.in_time()), (2, 2));
        tally.add(&tally.clone());
        assert_eq!(tally.columns(), "10 | 4 | 4 | 2 | 200 ms | 200 ms");
    }
}
