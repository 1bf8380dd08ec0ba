//! The guard of a node's commands, for programs that link `imrs-runtime` and do not call `guard::entry` themselves.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    imrs_runtime::guard::entry().unwrap_or_else(|| {
        eprintln!("imrs-guard: nodes start this program for the commands of their actions; it does nothing by itself");
        ExitCode::from(2)
    })
}
