//! Parses durations of the command line: `2s`, `500ms`, `500 msec`, `1min 30s`.

use std::time::Duration;

/// The longest duration that is accepted. Adding a longer one to an instant could overflow.
const LONGEST: Duration = Duration::from_secs(100 * 365 * 24 * 3600);

/// Why a text is not a duration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TimeError {
    /// The text cannot be parsed.
    #[error("{0}: write a number and a unit, as in 500ms, 500 msec, 2s or 1min 30s")]
    Text(humantime::DurationError),
    /// The duration is longer than a century.
    #[error("longer than a century: write a shorter time, such as 1h")]
    TooLong,
}

/// Parses a duration of the command line.
///
/// # Errors
/// [`TimeError`].
pub fn parse(text: &str) -> Result<Duration, TimeError> {
    match humantime::parse_duration(text) {
        Ok(time) if time > LONGEST => Err(TimeError::TooLong),
        Ok(time) => Ok(time),
        Err(humantime::DurationError::NumberOverflow) => Err(TimeError::TooLong),
        Err(error) => Err(TimeError::Text(error)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_those_of_cells_and_of_command_lines() {
        for (text, ms) in
            [("500ms", 500), ("500 msec", 500), ("2s", 2_000), ("2 sec", 2_000), ("1min 30s", 90_000)]
        {
            assert_eq!(parse(text), Ok(Duration::from_millis(ms)), "{text}");
        }
        assert_eq!(parse("3 usec"), Ok(Duration::from_micros(3)));
        assert!(matches!(parse("3 beats"), Err(TimeError::Text(_))));
        assert!(matches!(parse(""), Err(TimeError::Text(_))));
    }

    #[test]
    fn a_century_is_the_longest() {
        assert_eq!(parse("36500days"), Ok(LONGEST));
        for text in ["36501days", "584942417355years", "18446744073709551615s", "99999999999999999999s"] {
            assert_eq!(parse(text), Err(TimeError::TooLong), "{text}");
        }
    }
}
