//! The texts about what a verdict does not cover, and about the values that the search tried.

use crate::failure::Failure;
use crate::output::{FAINT, Output, Styled};
use imrs_model::cell::{CellPlan, Tried};

/// What no verdict on a cell covers.
const STANDSTILLS: &str = "livelock: a task that polls for ever while other tasks make progress, or one that only asks again and again whether something came";

/// What the verdict on a cell with extern tasks does not cover.
const TIMES_OUTSIDE: &str =
    "extern tasks that use a port otherwise than once in each period of their rate, or in each tick";

/// What the verdict does not cover if the cell uses results of actions otherwise than in comparisons.
const OTHER_RESULTS: &str =
    "other results of actions than the ends of their ranges and what is compared with";

/// What the verdict does not cover if actions of the cell give numbers.
const UNFIT: &str =
    "results of actions that are outside their range, or do not fit the variable that takes them";

/// What the verdict on this cell does not cover.
pub(super) fn not_looked_for(plan: &CellPlan) -> Vec<&'static str> {
    let outside = plan.has_extern().then_some(TIMES_OUTSIDE);
    let results = plan.has_open_results().then_some(OTHER_RESULTS);
    let unfit = plan.takes_numbers().then_some(UNFIT);
    std::iter::once(STANDSTILLS).chain(outside).chain(results).chain(unfit).collect()
}

/// Prints the values with which the messages of extern tasks were tried.
///
/// # Errors
/// [`Failure::Output`].
pub(super) fn values_tried(tried: &Tried, out: &mut Output) -> Result<(), Failure> {
    let mut say = |words: &str, values: Vec<String>| match &values[..] {
        [] => Ok(()),
        values => out.line(Styled(FAINT, format!("  {words}: {}", values.join(", ")))),
    };
    let whole = |values: &[i64]| values.iter().map(i64::to_string).collect();
    let real = |values: &[f32]| values.iter().map(f32::to_string).collect();
    say("messages of extern tasks were tried with these values in each field", whole(&tried.whole))?;
    say("not tried, because there are so many", whole(&tried.left_out))?;
    say("in each `real`", real(&tried.real))?;
    say("not tried in a `real`, because there are so many", real(&tried.real_left_out))
}
