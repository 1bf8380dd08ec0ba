//! Collects and counts the results of many trials. A file can keep the results, so that an interrupted series can go on.

use super::tool::{Bound, resolution};
use super::trial::Trial;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// The finished trials of a series.
pub struct Tally {
    done: Mutex<(Vec<Trial>, Option<File>)>,
}

impl Tally {
    /// Starts a tally. If a file is given, the tally has the trials that the file keeps from an interrupted run, and
    /// each new trial is appended to the file.
    pub fn open(file: Option<PathBuf>) -> Self {
        let Some(path) = file else { return Self { done: Mutex::default() } };
        let text = std::fs::read_to_string(&path).unwrap_or_default();
        // The last line of the file may be truncated, and is then skipped.
        let done = text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
        let file = OpenOptions::new().create(true).append(true).open(path).expect("a file for the trials");
        Self { done: Mutex::new((done, Some(file))) }
    }

    pub fn has(&self, number: u64, is_comparison: bool) -> bool {
        let done = self.done.lock().unwrap_or_else(PoisonError::into_inner);
        done.0.iter().any(|trial| trial.number == number && trial.is_comparison() == is_comparison)
    }

    pub fn add(&self, trial: Trial) {
        let mut done = self.done.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(file) = &mut done.1 {
            // The line break at the start ends a truncated line.
            let line = serde_json::to_string(&trial).expect("JSON");
            file.write_all(format!("\n{line}\n").as_bytes()).expect("the trial is kept");
        }
        done.0.push(trial);
    }

    /// Returns the trials of the series, and separately the comparisons.
    pub fn finish(self) -> (Trials, Trials) {
        let (all, _) = self.done.into_inner().unwrap_or_else(PoisonError::into_inner);
        let (comparisons, trials) = all.into_iter().partition(Trial::is_comparison);
        (Trials(trials), Trials(comparisons))
    }
}

impl Trial {
    pub fn is_comparison(&self) -> bool {
        self.bound == Bound::Neither
    }
}

pub struct Trials(pub Vec<Trial>);

impl Trials {
    pub fn count(&self, is: impl Fn(&Trial) -> bool) -> u64 {
        self.0.iter().filter(|trial| is(trial)).count() as u64
    }

    /// The longest time during which two tasks acted in one trial, in microseconds.
    pub fn two_owners(&self) -> u64 {
        self.0.iter().map(|trial| trial.two_owners).max().unwrap_or(0)
    }

    /// The counts of the trials as text.
    pub fn counts(&self) -> String {
        format!(
            "{} trials, two owners for {} us at most; the standby acted in {}, the owner was in the middle of an action in {}, \
             the guard stood still in {}; processes stood still for {} to {} ms",
            self.0.len(),
            self.two_owners(),
            self.count(|trial| trial.took_over.is_some()),
            self.count(|trial| trial.mid_action),
            self.count(|trial| trial.guard_held),
            millis(self.held().min()),
            millis(self.held().max()),
        )
    }

    /// For each trial that stopped processes, how long they were stopped, in microseconds.
    fn held(&self) -> impl Iterator<Item = u64> {
        self.0.iter().map(|trial| trial.held).filter(|&held| held > 0)
    }

    /// The times from the fault to the take-over as text.
    pub fn take_over(&self) -> String {
        let at_once = self.0.iter().filter(|trial| !trial.waited);
        let mut times: Vec<u64> = at_once.filter_map(|trial| trial.took_over).collect();
        times.sort_unstable();
        let at = |share: usize| millis(times.get(times.len() * share / 100).or(times.last()).copied());
        format!(
            "take-over after {} ms (median), {} ms (9 of 10), {} ms (longest; in {} more the standby waited for a command that was held)",
            at(50),
            at(90),
            at(100),
            self.count(|trial| trial.waited),
        )
    }

    /// How long commands went on while their guard was stopped, as text.
    pub fn went_on(&self) -> String {
        let longest = |bound| {
            let of = self.0.iter().filter(|trial| trial.bound == bound);
            millis(of.filter_map(|trial| trial.went_on).max())
        };
        let (deadline, gate) = (longest(Bound::Both), longest(Bound::Gate));
        format!(
            "beside a guard that stands still a command went on for {deadline} ms at most by deadline and gate, {gate} ms by the gate alone"
        )
    }

    /// The results of the comparisons as text.
    pub fn compared(&self) -> String {
        let seen = self.count(|trial| trial.two_owners > 0);
        let guarded = self.count(|trial| !trial.guard_held);
        let seen_guarded = self.count(|trial| trial.two_owners > 0 && !trial.guard_held);
        let (all, longest) = (self.0.len(), millis(Some(self.two_owners())));
        format!(
            "without gate and deadline two owners in {seen} of {all}, for {longest} ms at most (in {seen_guarded} of {guarded} whose guard did not stand still)"
        )
    }
}

fn millis(micros: Option<u64>) -> u64 {
    micros.unwrap_or(0) / 1_000
}

/// Prints the line about the series that the script `.ci/long` keeps.
pub fn tell(trials: &Trials, comparisons: &Trials) {
    println!(
        "total: {}; {}; {}; {}; the log counts in steps of {} us of CLOCK_BOOTTIME",
        trials.counts(),
        trials.take_over(),
        trials.went_on(),
        comparisons.compared(),
        resolution(),
    );
}
