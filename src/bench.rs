//! `imrs bench`: the measurements that need no peer.

use crate::exit::{Exit, Failure};
use crate::output::Output;
use imrs_bench::{BenchArgs, Verdict};

/// Measures, and says what came of it.
pub fn run(args: &BenchArgs, out: &mut Output) -> Result<Exit, Failure> {
    Ok(match imrs_bench::run(args, &mut |text: &str| out.text(text))? {
        Verdict::Well => Exit::Well,
        Verdict::Missed => Exit::Finding,
    })
}
