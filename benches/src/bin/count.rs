//! Runs one case of the benchmarks a given number of times and prints nothing. `.ci/counts` counts the instructions of
//! this program.

use imrs_bench::cases;
use imrs_bench::suite::Effort;
use std::process::ExitCode;

fn main() -> ExitCode {
    let mut args = std::env::args().skip(1);
    let (Some(name), Some(Ok(times))) = (args.next(), args.next().map(|times| times.parse())) else {
        eprintln!("usage: imrs-count CASE TIMES");
        return ExitCode::from(2);
    };
    let suites = cases::all();
    let Some(case) = suites.iter().flat_map(|suite| &suite.cases).find(|case| case.name == name) else {
        eprintln!("error: there is no case `{name}`; `imrs-bench --list` names them");
        return ExitCode::from(2);
    };
    (case.run)(Effort::Times(times));
    ExitCode::SUCCESS
}
