//! The resources that this process holds, according to the kernel.

use std::ffi::OsString;
use std::fs::DirEntry;
use std::time::{Duration, Instant};

/// The resources that the process holds at an instant.
#[derive(Clone, Copy, Debug, Default)]
pub struct Held {
    /// Seconds since the beginning of the run.
    pub at: f64,
    /// Anonymous memory in RAM, in KiB. Mapped files do not count, because the kernel loads and drops them as it likes.
    pub memory: u64,
    pub descriptors: usize,
    /// The number of the nodes' threads. The test runner starts and ends threads of its own, which do not count.
    pub threads: usize,
}

fn listed(folder: &str) -> impl Iterator<Item = DirEntry> {
    std::fs::read_dir(folder).expect("this is Linux").flatten()
}

/// All threads of the process, by their numbers.
pub fn threads() -> Vec<OsString> {
    listed("/proc/self/task").map(|thread| thread.file_name()).collect()
}

impl Held {
    /// Measures the process. `others` are the threads that existed before the nodes. The kernel may list a thread for a
    /// while after its end.
    pub fn now(since: Instant, others: &[OsString]) -> Self {
        let status = std::fs::read_to_string("/proc/self/status").expect("this is Linux");
        let field = |name: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(name)).expect("a field");
            line.trim_end_matches("kB").trim().parse().expect("a number")
        };
        let is_of_a_node = |thread: &DirEntry| {
            let name = std::fs::read_to_string(thread.path().join("comm")).unwrap_or_default();
            let is_another = others.contains(&thread.file_name());
            // The node's threads are those of the tasks, which have short names, and those that run for all tasks. A
            // thread for actions ends some time after its node.
            !is_another
                && (["imrs receive", "imrs timer"].contains(&name.trim_end()) || name.trim_end().len() == 1)
        };
        Self {
            at: since.elapsed().as_secs_f64(),
            memory: field("RssAnon:"),
            descriptors: listed("/proc/self/fd").count(),
            threads: listed("/proc/self/task").filter(is_of_a_node).count(),
        }
    }
}

/// Processor time of all threads so far.
pub fn worked() -> Duration {
    let stat = std::fs::read_to_string("/proc/self/stat").expect("this is Linux");
    let (_, after) = stat.rsplit_once(')').expect("a name in brackets");
    let ticks = |at| after.split_whitespace().nth(at).and_then(|n| n.parse::<u64>().ok()).expect("a number");
    // The kernel reports hundredths of a second, whatever its own tick is.
    Duration::from_millis(10 * (ticks(11) + ticks(12)))
}

/// The trend of the memory in a series: its mean over the first quarter and over the last one, in KiB, and its slope
/// by least squares, in KiB per hour.
pub fn trend(series: &[Held]) -> (f64, f64, f64) {
    let mean =
        |part: &[Held], of: &dyn Fn(&Held) -> f64| part.iter().map(of).sum::<f64>() / part.len() as f64;
    let memory = |held: &Held| held.memory as f64;
    let quarter = (series.len() / 4).max(1);
    let (middle, level) = (mean(series, &|held| held.at), mean(series, &memory));
    let along = mean(series, &|held| (held.at - middle) * (memory(held) - level));
    let spread = mean(series, &|held| (held.at - middle).powi(2));
    let last = &series[series.len() - quarter..];
    (mean(&series[..quarter], &memory), mean(last, &memory), along / spread * 3_600.0)
}

#[test]
fn a_trend_is_that_of_a_line_through_the_series() {
    let held =
        |at: u32| Held { at: f64::from(at), memory: u64::from(1_000 + 2 * at), descriptors: 3, threads: 1 };
    let (begin, end, slope) = trend(&(0..100).map(held).collect::<Vec<_>>());
    assert_eq!((begin, end), (1_024.0, 1_174.0));
    assert!((slope - 7_200.0).abs() < 1e-6, "{slope}");
}
