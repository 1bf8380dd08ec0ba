//! Merges equal findings of tasks with the same statements, so that each is reported once.

use super::judge::Shown;
use super::plan::{CellPlan, Conduct};
use super::verdict::Finding;
use imrs_protocol::TaskId;
use imrs_protocol::script::Program;

/// Merges each finding that repeats an earlier finding into the earlier one, whose [`Finding::also`] gets the task of the
/// later one.
pub(super) fn told_once(plan: &CellPlan, findings: Vec<Finding>) -> Vec<Finding> {
    let mut kept: Vec<Finding> = Vec::new();
    for finding in findings {
        let first = kept.iter_mut().find(|first| repeats(plan, first, &finding));
        match (first, finding.task) {
            (Some(first), Some(task)) => first.also.push(task),
            _ => kept.push(finding),
        }
    }
    kept
}

/// Whether two findings are equal but for the task: at the same statement of two tasks with the same program.
fn repeats(plan: &CellPlan, first: &Finding, other: &Finding) -> bool {
    let key = |finding: &Finding| (finding.kind, finding.phase, finding.hypothesis, finding.address);
    let (Some(one), Some(two)) = (first.task, other.task) else { return false };
    key(first) == key(other)
        && first.address.is_some()
        && is_alike(plan, (one, &first.cause), (two, &other.cause))
}

/// Whether two findings of random runs are equal but for the task and the runs' faults: at the same statement of two tasks
/// with the same program.
pub(super) fn shows_alike(plan: &CellPlan, first: &Shown, other: &Shown) -> bool {
    let (Some(one), Some(two)) = (first.task, other.task) else { return false };
    let [one, two] = [one, two].map(TaskId::from_index);
    (first.kind, first.address) == (other.kind, other.address)
        && first.address.is_some()
        && is_alike(plan, (one, &first.cause), (two, &other.cause))
}

fn is_alike(plan: &CellPlan, (one, cause): (TaskId, &str), (two, other): (TaskId, &str)) -> bool {
    let name = |task: TaskId| plan.table.cell().tasks.get(task.index()).map_or("?", |task| &task.name);
    does_the_same(plan, one, two) && reads_alike(cause, other, (name(one), name(two)))
}

fn does_the_same(plan: &CellPlan, one: TaskId, two: TaskId) -> bool {
    let of = |task: TaskId| match plan.tasks.get(task.index()) {
        Some(Conduct::Program { program, values, .. }) => {
            let mut program = Program::clone(program);
            program.name.clear();
            // The compiler writes the reasons, which differ only in the line numbers of the tasks.
            program.reasons.iter_mut().for_each(|reason| *reason = without_line(reason).into());
            Some((program, values))
        }
        Some(Conduct::Extern(_)) | None => None,
    };
    of(one).is_some_and(|program| Some(program) == of(two))
}

/// The reason of an abort without the line number that the compiler appends.
fn without_line(reason: &str) -> &str {
    match reason.rsplit_once(", line ") {
        Some((what, line)) if line.bytes().all(|byte| byte.is_ascii_digit()) => what,
        _ => reason,
    }
}

/// Whether two sentences differ only in the names of their own tasks.
fn reads_alike(one: &str, two: &str, (a, b): (&str, &str)) -> bool {
    let (one, two) = (words(without_line(one)), words(without_line(two)));
    one.len() == two.len()
        && one.iter().zip(&two).all(|(x, y)| x == y || (*x, *y) == (a, b) || (*x, *y) == (b, a))
}

/// Splits a text into its names and numbers, and the text between them.
fn words(text: &str) -> Vec<&str> {
    let part = |c: char| c.is_alphanumeric() || c == '_';
    let chars: Vec<(usize, char)> = text.char_indices().collect();
    let between = chars.windows(2).filter(|pair| part(pair[0].1) != part(pair[1].1)).map(|pair| pair[1].0);
    let ends: Vec<usize> = between.chain([text.len()]).collect();
    let begins = std::iter::once(0).chain(ends.iter().copied());
    begins.zip(&ends).map(|(begin, &end)| &text[begin..end]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sentences_are_alike_up_to_the_names_of_their_tasks() {
        let alike = |one, two| reads_alike(one, two, ("a", "b_2"));
        assert!(alike("a: a value is 7, `grab`", "b_2: a value is 7, `grab`"), "the article is no name");
        assert!(alike("a waits for b_2", "b_2 waits for a"));
        assert!(!alike("a: got = 7", "b_2: got = 8"));
        assert!(!alike("a: got = 7", "c: got = 7"));
        assert!(!alike("a: got", "b_2: got = 7"));
    }
}
