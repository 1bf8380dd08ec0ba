//! The scrub bar's data: a recording from its beginning to its end, with the places at which something went wrong. A
//! place is a position on the bar.

use super::{Film, Player, Trouble};
use crate::clock::{Moment, Span, micros};

/// Two troubles that are closer together than the length divided by this number are shown as one, because no screen
/// has more columns.
const PLACES: u64 = 1_000;

/// The ends of a recording, and its troubles. This refers to no frame, so it keeps no frame in memory.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ribbon {
    /// Whether places are counted in steps of a counterexample; otherwise they are counted in microseconds.
    steps: bool,
    first: u64,
    last: u64,
    /// The places of the troubles, ascending.
    troubles: Vec<(u64, Trouble)>,
}

impl Ribbon {
    /// The data of the scrub bar for a recording.
    #[must_use]
    pub fn of(film: &Film) -> Self {
        let steps = film.story.is_some();
        let place = |(index, at): (usize, Moment)| if steps { index as u64 } else { micros(at) };
        let stops = || film.stops().iter().enumerate();
        let first = film.stops().first().map_or(0, |stop| place((0, stop.at)));
        let last = stops().next_back().map_or(0, |(index, stop)| place((index, stop.at)));
        let is_trouble = |(_, stop): &(usize, &super::Stop)| stop.trouble > Trouble::None;
        let troubles = stops().filter(is_trouble);
        let mut troubles: Vec<_> =
            troubles.map(|(index, stop)| (place((index, stop.at)), stop.trouble)).collect();
        let apart = (last.saturating_sub(first) / PLACES).max(1);
        // Of several troubles at one place, the first of the gravest is kept.
        troubles.dedup_by(|next, kept| {
            let is_same = next.0 / apart == kept.0 / apart;
            if is_same && next.1 > kept.1 {
                *kept = *next;
            }
            is_same
        });
        Self { steps, first, last, troubles }
    }

    /// The place of the stop that a player shows.
    #[must_use]
    pub fn place(&self, player: &Player) -> u64 {
        if self.steps { player.stop() as u64 } else { self.moment(player.moment()) }
    }

    /// The place that belongs to a moment.
    #[must_use]
    pub fn moment(&self, at: Moment) -> u64 {
        micros(at).clamp(self.first, self.last)
    }

    /// The column in which a place is drawn, if the bar has `width` columns.
    #[must_use]
    pub fn column(&self, place: u64, width: u16) -> u16 {
        let length = u128::from(self.last.saturating_sub(self.first)).max(1);
        let at = u128::from(place.saturating_sub(self.first)) * u128::from(width.saturating_sub(1)) / length;
        u16::try_from(at).unwrap_or(u16::MAX).min(width.saturating_sub(1))
    }

    /// The place in the recording for which a column stands, if the bar has `width` columns. This is the place of the gravest
    /// trouble in it, or the beginning of the column if it has none.
    #[must_use]
    pub fn place_of(&self, column: u16, width: u16) -> u64 {
        let here = self.troubles.iter().filter(|(place, _)| self.column(*place, width) == column);
        if let Some((place, _)) = here.rev().max_by_key(|(_, trouble)| *trouble) {
            return *place;
        }
        let length = u128::from(self.last.saturating_sub(self.first));
        let columns = u128::from(width.saturating_sub(1)).max(1);
        let after = (u128::from(column) * length).div_ceil(columns);
        self.first.saturating_add(u64::try_from(after).unwrap_or(u64::MAX)).min(self.last)
    }

    /// The columns in which something went wrong, if the bar has `width` columns, and how grave it is. The gravest come last.
    #[must_use]
    pub fn troubles(&self, width: u16) -> Vec<(u16, Trouble)> {
        let column = |(place, trouble): &(u64, Trouble)| (self.column(*place, width), *trouble);
        let mut columns: Vec<_> = self.troubles.iter().map(column).collect();
        columns.sort_by_key(|(_, trouble)| *trouble);
        columns
    }

    /// A place and the end as texts for people: the time since the beginning, or the number of a step.
    #[must_use]
    pub fn labels(&self, place: u64) -> (String, String) {
        let label = |place: u64| {
            let after = place.saturating_sub(self.first);
            if self.steps { after.to_string() } else { Span::micros(after).to_string() }
        };
        (label(place), label(self.last))
    }
}

impl Player {
    /// Moves to a place of the scrub bar, and pauses.
    pub fn go_to_place(&mut self, ribbon: &Ribbon, place: u64) {
        if ribbon.steps {
            self.go(usize::try_from(place).unwrap_or(usize::MAX));
        } else {
            // A place is rounded down to a microsecond, and the stop may be within that microsecond.
            self.seek(super::At::After(Moment::from_micros(place) + Moment::from_nanos(999)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_click_on_a_column_leads_to_a_place_that_is_drawn_there() {
        let troubles = vec![(1_000_000, Trouble::Grave), (61_234_567, Trouble::Slight)];
        let ribbon = Ribbon { steps: false, first: 1_000_000, last: 61_234_567, troubles };
        for width in [1, 2, 40, 199] {
            for column in 0..width {
                let place = ribbon.place_of(column, width);
                assert_eq!(ribbon.column(place, width), column, "{column} of {width}");
            }
            assert_eq!(ribbon.troubles(width), [(width - 1, Trouble::Slight), (0, Trouble::Grave)]);
        }
        assert_eq!(ribbon.column(u64::MAX, 0), 0);
        assert_eq!(Ribbon::default().column(7, 10), 9);
        assert_eq!(ribbon.labels(3_500_000), ("2.50s".to_owned(), "1m00s".to_owned()));
    }
}
