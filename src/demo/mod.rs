//! `imrs demo`: the built-in cells, with a fault injected and the outcome explained.

mod beam_lift;

pub use beam_lift::program;

use crate::args::{DemoArgs, DemoCell};
use crate::cells::{self, Source};
use crate::exit::{Exit, Failure};
use crate::launch::{self, Run};
use crate::output::Output;
use std::collections::BTreeMap;
use std::time::Duration;

/// How long a demo runs unless told otherwise.
const LENGTH: Duration = Duration::from_secs(10);

/// Runs a demo.
///
/// # Errors
/// [`Failure`].
pub fn run(args: &DemoArgs, out: &mut Output) -> Result<Exit, Failure> {
    let DemoCell::BeamLift = args.cell;
    let source = Source::BuiltIn(cells::beam_lift::NAME.into());
    let loaded = cells::load(&source)?;
    let run = Run {
        source,
        loaded: &loaded,
        args: &args.launch,
        length: Some(args.launch.length.unwrap_or(LENGTH)),
        actions: BTreeMap::new(),
        introduction: Some(
            "All tasks meet at the waitfor `lift` before every lift; nobody is to start without the others.",
        ),
    };
    launch::run(&run, out)
}
