//! The vitals of a node's process, for monitors. They are read when a monitor wants them; only the Timer's lateness is
//! counted all the time.

use crate::clock;
use crate::node::Node;
use crate::observe::lateness::Seen;
use imrs_wire::obs::{Count, RecordingFacts, Vitals};
use rustix::time::{ClockId, clock_gettime};
use std::fs;

impl Node {
    /// The vitals of the process, with how late the Timer thread was since `seen`.
    pub(crate) fn vitals(&self, seen: &mut Seen, recording: Option<RecordingFacts>) -> Vitals {
        let cpu = clock_gettime(ClockId::ProcessCPUTime);
        let micros = |part: i64| u64::try_from(part).unwrap_or(0);
        let (memory, threads) = usage();
        let evidence = self.link.iter().flat_map(|link| link.evidence());
        Vitals {
            mono_us: clock::now(),
            timer: self.lateness.since(seen),
            links: evidence.map(|(name, count)| Count { name: name.into(), count }).collect(),
            recording,
            cpu_us: micros(cpu.tv_sec) * 1_000_000 + micros(cpu.tv_nsec) / 1_000,
            memory,
            threads,
        }
    }
}

/// The resident memory of the process in bytes, and the number of its threads; zero if the system does not report it.
fn usage() -> (u64, u32) {
    let text = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let figure = |name: &str| {
        let line = text.lines().find_map(|line| line.strip_prefix(name))?;
        line.split_whitespace().next()?.parse::<u64>().ok()
    };
    let threads = figure("Threads:").and_then(|threads| u32::try_from(threads).ok());
    (figure("VmRSS:").unwrap_or(0) * 1024, threads.unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_process_uses_memory_and_has_threads() {
        let (memory, threads) = usage();
        assert!(memory > 100_000 && threads >= 1, "{memory} bytes, {threads} threads");
    }
}
