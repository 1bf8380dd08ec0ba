//! `imrs bench`: runs the measurements that do not compare with other libraries. The default build leaves them out.

use crate::args::BenchArgs;
use crate::exit::Exit;
use crate::failure::Failure;
use crate::output::Output;

/// Runs the measurements, and prints the results.
#[cfg(feature = "bench")]
pub fn run(args: &BenchArgs, out: &mut Output) -> Result<Exit, Failure> {
    Ok(match imrs_bench::run(args, &mut |text: &str| out.text(text))? {
        imrs_bench::Verdict::Well => Exit::Well,
        imrs_bench::Verdict::Missed => Exit::Finding,
    })
}

/// Says how to get a build that contains the measurements.
#[cfg(not(feature = "bench"))]
pub fn run(args: &BenchArgs, _out: &mut Output) -> Result<Exit, Failure> {
    let command = [&["bench".to_owned()][..], &args.args].concat().join(" ");
    Err(Failure::Usage(format!(
        "this build leaves out the measurements. From the source folder, run:\n  \
         cargo run --release --features bench -- {command}"
    )))
}
