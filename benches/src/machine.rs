//! The facts about the machine that the results show: cores, kernel, governor, build, load and date, and nothing else.

use crate::cores;

/// The facts that are shown with every measurement.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Facts {
    /// How many cores this process may use.
    pub cores: usize,
    /// The kernel's release.
    pub kernel: String,
    /// The frequency governor, if the kernel shows it.
    pub governor: Option<String>,
    /// Whether the program was built without debug assertions.
    pub release: bool,
    /// The date in UTC.
    pub date: String,
    /// The kernel's load average over one minute: how busy the machine is.
    pub load: Option<f64>,
}

impl Facts {
    /// The facts about this machine, now.
    #[must_use]
    pub fn now() -> Self {
        let read = |path: &str| std::fs::read_to_string(path).ok();
        let governor = read("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor");
        let kernel = rustix::system::uname().release().to_string_lossy().into_owned();
        let load = read("/proc/loadavg").and_then(|line| line.split(' ').next()?.parse().ok());
        Self {
            cores: cores::count(),
            kernel,
            governor: governor.map(|name| name.trim().to_owned()),
            release: !cfg!(debug_assertions),
            date: today(),
            load,
        }
    }

    /// The facts in one line.
    #[must_use]
    pub fn line(&self) -> String {
        let governor = self.governor.as_deref().unwrap_or("unknown");
        let build = if self.release { "release" } else { "DEV, not comparable" };
        let load = self.load.map_or_else(|| "unknown".to_owned(), |load| format!("{load:.1}"));
        let cores = self.cores;
        format!(
            "{}: {cores} cores, kernel {}, governor {governor}, load {load}, {build}",
            self.date, self.kernel
        )
    }
}

/// The present date in UTC as `2026-01-31`.
fn today() -> String {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    let (year, month, day) = civil(i64::try_from(since.as_secs() / 86_400).unwrap_or_default());
    format!("{year}-{month:02}-{day:02}")
}

/// The date of a day that is counted from 1970-01-01 (Howard Hinnant's `civil_from_days`).
const fn civil(days: i64) -> (i64, i64, i64) {
    let days = days + 719_468;
    let era = days.div_euclid(146_097);
    let of_era = days.rem_euclid(146_097);
    let year_of_era = (of_era - of_era / 1_460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * of_year + 2) / 153;
    let day = of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    let year = year_of_era + era * 400 + if month <= 2 { 1 } else { 0 };
    (year, month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_become_dates() {
        assert_eq!(civil(0), (1970, 1, 1));
        assert_eq!(civil(19_782), (2024, 2, 29));
        assert_eq!(civil(20_819), (2027, 1, 1));
    }

    #[test]
    fn the_facts_fit_a_line() {
        let facts = Facts::now();
        assert!(facts.cores >= 1 && !facts.kernel.is_empty());
        assert_eq!(facts.line().lines().count(), 1);
    }
}
