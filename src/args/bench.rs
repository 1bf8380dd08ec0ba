//! The options of `imrs bench`.

#[cfg(feature = "bench")]
pub use imrs_bench::BenchArgs;

/// Any arguments behind the verb: this build ignores them, because it contains no measurements.
#[cfg(not(feature = "bench"))]
#[derive(Debug, clap::Args)]
pub struct BenchArgs {
    /// Suites and flags of the measurements.
    #[arg(value_name = "ARGS", trailing_var_arg = true, allow_hyphen_values = true)]
    pub args: Vec<String>,
}
