//! Draws a chart as text: lanes on the left, words on the right, at most 78 columns wide.

use super::{Note, outcome_words};

/// The width of the widest line. The command indents charts by two columns, so that they still fit the narrowest terminals.
const COLUMNS: usize = 78;
/// How many columns all lanes take together, unless a lane would then have fewer than three.
const LANES: usize = 36;
/// The least number of columns of a lane, if there is space: an arrow must be visible.
const NARROW: usize = 8;
/// The least number of columns for the words. If the lanes leave fewer columns, no lanes are drawn.
const WORDS: usize = 30;
/// The number of notes of the longest cycle for which the drawing searches.
const CYCLE: usize = 64;
/// The least number of notes that folding a cycle must save.
const WORTH: usize = 4;

/// How a chart shows notes that repeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Folding {
    /// A cycle is drawn once, with the number of its repetitions.
    Repeats,
    /// Every note is drawn.
    Nothing,
}

/// Draws a chart: a lane for each name, a line or more for each note, and the cause at the chart's end. At most 78 columns
/// wide.
#[must_use]
pub fn chart(names: &[String], notes: &[Note], cause: &str, folding: Folding) -> String {
    let last = notes.last().map_or(0, Note::tick);
    let lines = notes.iter().filter_map(Note::line).max();
    let sheet = Sheet::new(names, last, lines);
    let mut lines = sheet.head();
    let mut from = 0;
    let mut tick = None;
    while from < notes.len() {
        let cycle = match folding {
            Folding::Repeats => cycle(&notes[from..]),
            Folding::Nothing => None,
        };
        let shown = cycle.as_ref().map_or(1, |cycle| cycle.length);
        for note in &notes[from..from + shown] {
            sheet.note(note, tick != Some(note.tick()), &mut lines);
            tick = Some(note.tick());
        }
        from += shown;
        if let Some(Cycle { length, times, every }) = cycle {
            from += length * (times - 1);
            let until = notes[from - 1].tick();
            tick = Some(until);
            let times = match times - 1 {
                1 => "once more".to_owned(),
                more => format!("{more} more times"),
            };
            let text = format!("... the same {times}, every {}, until tick {until}", ticks(every));
            lines.push(format!("{}{text}", " ".repeat(sheet.margin)));
        }
    }
    let indent = " ".repeat(sheet.margin);
    for (i, line) in wrapped(cause, COLUMNS - sheet.margin - 3).into_iter().enumerate() {
        lines.push(format!("{indent}{} {line}", if i == 0 { "=>" } else { "  " }));
    }
    lines.join("\n")
}

fn ticks(number: u32) -> String {
    format!("{number} tick{}", if number == 1 { "" } else { "s" })
}

/// How the lines of a chart are laid out.
struct Sheet<'a> {
    names: &'a [String],
    /// How many columns the tick takes.
    margin: usize,
    /// How many columns each lane takes; 0 if there are too many lanes to draw any.
    lane: usize,
    /// How many columns the line of the cell's source text takes; 0 if no note has such a line.
    line: usize,
}

impl<'a> Sheet<'a> {
    fn new(names: &'a [String], last: u32, lines: Option<u32>) -> Self {
        let line = lines.map_or(0, |line| line.to_string().len().max("line".len()) + 2);
        let margin = last.to_string().len().max("tick".len()) + 2;
        let longest = names.iter().map(|name| name.chars().count()).max().unwrap_or(0);
        let most = (LANES / names.len().max(1)).max(3);
        let lane = (longest + 2).max(NARROW).min(most);
        let fits = margin + lane * names.len() + line + WORDS <= COLUMNS;
        Self { names, margin, lane: if fits { lane } else { 0 }, line }
    }

    fn head(&self) -> Vec<String> {
        let mut head = format!("{:>width$}  ", "tick", width = self.margin - 2);
        if self.lane > 0 {
            for name in self.names {
                let name: String = name.chars().take(self.lane - 1).collect();
                head.push_str(&format!("{name:<width$}", width = self.lane));
            }
        }
        if self.line > 0 {
            head.push_str(&self.beside("line"));
        }
        vec![head.trim_end().to_owned()]
    }

    /// The column for source lines, with this text in it.
    fn beside(&self, line: &str) -> String {
        if self.line == 0 { String::new() } else { format!("{line:>width$}  ", width = self.line - 2) }
    }

    /// The lanes of one line, without marks.
    fn empty(&self) -> Vec<char> {
        let mut line = vec![' '; self.lane * self.names.len()];
        line.iter_mut().step_by(self.lane.max(1)).for_each(|column| *column = '|');
        line
    }

    fn note(&self, note: &Note, first: bool, lines: &mut Vec<String>) {
        let mut drawn = self.empty();
        self.draw(note, &mut drawn);
        let tick = if first { note.tick().to_string() } else { String::new() };
        let of_text = note.line().map(|line| line.to_string()).unwrap_or_default();
        let room = COLUMNS - self.margin - drawn.len() - self.line;
        for (i, words) in wrapped(&self.words(note), room).into_iter().enumerate() {
            let (tick, of_text, drawn) =
                if i == 0 { (tick.as_str(), of_text.as_str(), &drawn) } else { ("", "", &self.empty()) };
            let (drawn, beside): (String, String) = (drawn.iter().collect(), self.beside(of_text));
            let line = format!("{tick:>width$}  {drawn}{beside}{words}", width = self.margin - 2);
            lines.push(line.trim_end().to_owned());
        }
    }

    fn draw(&self, note: &Note, line: &mut [char]) {
        let mut put = |at: usize, mark: char| {
            if let Some(column) = line.get_mut(at) {
                *column = mark;
            }
        };
        match note {
            Note::Event { lane, .. } => put(lane * self.lane, '*'),
            Note::Packet { from, to, outcome, .. } => {
                let (left, right) = (from.min(to) * self.lane, from.max(to) * self.lane);
                (left + 1..right).for_each(|at| put(at, '-'));
                let tip = match outcome.as_str() {
                    "LOST" | "CUT OFF" => 'x',
                    _ if from < to => '>',
                    _ => '<',
                };
                match from.cmp(to) {
                    std::cmp::Ordering::Less => put(right.saturating_sub(1), tip),
                    std::cmp::Ordering::Greater => put(left + 1, tip),
                    std::cmp::Ordering::Equal => put(left, '*'),
                }
            }
            Note::Remark { .. } => {}
        }
    }

    fn words(&self, note: &Note) -> String {
        let name = |lane: usize| self.names.get(lane).map_or("?", String::as_str);
        match note {
            Note::Event { lane, text, .. } => format!("{}: {text}", name(*lane)),
            Note::Packet { from, to, label, outcome, .. } => {
                let outcome = if outcome.is_empty() { "" } else { outcome_words(outcome) };
                let text = format!("{} -> {}: {label} {outcome}", name(*from), name(*to));
                text.trim_end().to_owned()
            }
            Note::Remark { text, .. } => text.clone(),
        }
    }
}

/// Wraps a text to lines of at most `room` columns. Longer words are cut; all lines but the first are indented.
fn wrapped(text: &str, room: usize) -> Vec<String> {
    const INDENT: usize = 2;
    let mut lines = vec![String::new()];
    let mut used = 0;
    for word in text.split_whitespace() {
        let mut left: Vec<char> = word.chars().collect();
        let gap = usize::from(used > 0);
        if used + gap + left.len() > room && used > INDENT {
            lines.push(" ".repeat(INDENT));
            used = INDENT;
        } else if used > INDENT || (used > 0 && lines.len() == 1) {
            lines.last_mut().expect("there is one").push(' ');
            used += 1;
        }
        while left.len() > room.saturating_sub(used).max(1) {
            let rest = left.split_off(room.saturating_sub(used).max(1));
            lines.last_mut().expect("there is one").extend(left);
            lines.push(" ".repeat(INDENT));
            (left, used) = (rest, INDENT);
        }
        used += left.len();
        lines.last_mut().expect("there is one").extend(left);
    }
    lines
}

/// A group of consecutive notes that repeats.
struct Cycle {
    /// How many notes one repetition has.
    length: usize,
    /// How many repetitions there are, the first one included.
    times: usize,
    /// The number of ticks from one repetition to the next.
    every: u32,
}

/// The cycle that saves most notes, of those with which these notes begin; `None` if no cycle saves enough.
fn cycle(notes: &[Note]) -> Option<Cycle> {
    let most = CYCLE.min(notes.len() / 2);
    let cycles = (1..=most).filter_map(|length| {
        let every = notes[length].tick() - notes[0].tick();
        let again = |time: usize| {
            let (before, after) = (&notes[(time - 1) * length..], &notes[time * length..]);
            after.len() >= length && (0..length).all(|i| is_same(&before[i], &after[i], every))
        };
        let times = (1..).take_while(|&time| again(time)).count() + 1;
        (every > 0 && length * (times - 1) >= WORTH).then_some(Cycle { length, times, every })
    });
    // A longer cycle is better only if it saves more notes than the shorter one, by more than the length of the shorter
    // one.
    cycles.reduce(|best, other| {
        let saves = |cycle: &Cycle| cycle.length * (cycle.times - 1);
        if saves(&other) > saves(&best) + best.length { other } else { best }
    })
}

/// Whether `other`, `later` ticks after `one`, repeats `one`. Numbers of messages and rounds may differ.
fn is_same(one: &Note, other: &Note, later: u32) -> bool {
    let text = |one: &str, other: &str| unnumbered(one).eq(unnumbered(other));
    one.tick().checked_add(later) == Some(other.tick())
        && one.line() == other.line()
        && match (one, other) {
            (Note::Event { lane: a, text: x, .. }, Note::Event { lane: b, text: y, .. }) => {
                a == b && text(x, y)
            }
            (
                Note::Packet { from: a, to: b, label: x, outcome: f, .. },
                Note::Packet { from: c, to: d, label: y, outcome: g, .. },
            ) => (a, b, f) == (c, d, g) && text(x, y),
            (Note::Remark { text: x, .. }, Note::Remark { text: y, .. }) => x == y,
            (Note::Event { .. } | Note::Packet { .. } | Note::Remark { .. }, _) => false,
        }
}

/// The characters of a text without the numbers of messages and rounds: digits behind `#` and behind `round `.
fn unnumbered(text: &str) -> impl Iterator<Item = char> {
    let mut numbered = false;
    let mut before = "";
    text.char_indices().filter_map(move |(at, c)| {
        numbered = c.is_ascii_digit() && (numbered || before.ends_with('#') || before.ends_with("round "));
        before = &text[..at + c.len_utf8()];
        (!numbered).then_some(c)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names() -> Vec<String> {
        ["armL", "armR"].map(str::to_owned).into()
    }

    fn heartbeat(number: u32, tick: u32) -> [Note; 2] {
        let label = format!("QUERY beat #{number}");
        let text = format!("takes beat #{number} of armL");
        [
            Note::Packet { tick, from: 0, to: 1, label, outcome: String::new(), line: None },
            Note::Event { tick, lane: 1, text, line: None },
        ]
    }

    #[test]
    fn a_packet_is_an_arrow_and_says_who_sends_what_on_which_port() {
        let lost = Note::Packet {
            tick: 4,
            from: 1,
            to: 0,
            label: "SEND halt #1".into(),
            outcome: "LOST".into(),
            line: None,
        };
        let notes = [&heartbeat(0, 3)[..], &[lost]].concat();
        let drawn = chart(&names(), &notes, "`small` does not hold: armL.at = 9", Folding::Repeats);
        assert_eq!(
            drawn,
            "tick  armL    armR\n   3  |------>|       armL -> armR: QUERY beat #0\n      |       *       armR: takes beat #0 of armL\n   4  |x------|       armR -> armL: SEND halt #1 is LOST\n      => `small` does not hold: armL.at = 9"
        );
    }

    #[test]
    fn what_happens_again_and_again_is_drawn_once_and_counted() {
        let mut notes: Vec<Note> = (0..9).flat_map(|i| heartbeat(i, 10 + 5 * i)).collect();
        notes.push(Note::Event { tick: 60, lane: 0, text: "ends".into(), line: None });
        let folded = chart(&names(), &notes, "so", Folding::Repeats);
        assert!(folded.contains("... the same 8 more times, every 5 ticks, until tick 50"), "{folded}");
        assert_eq!((folded.lines().count(), folded.matches("QUERY").count()), (6, 1), "{folded}");
        let whole = chart(&names(), &notes, "so", Folding::Nothing);
        assert_eq!(whole.matches("QUERY beat #").count(), 9, "{whole}");
    }

    #[test]
    fn lines_of_the_cell_stand_in_a_column_of_their_own() {
        let event = |tick, line| Note::Event { tick, lane: 1, text: "goes on".into(), line };
        let drawn = chart(
            &names(),
            &[event(3, Some(7)), event(4, None), event(5, Some(12_345))],
            "so",
            Folding::Repeats,
        );
        assert_eq!(
            drawn,
            "tick  armL    armR     line\n   3  |       *           7  armR: goes on\n   4  |       *              armR: goes on\n   5  |       *       12345  armR: goes on\n      => so"
        );
        // The same words at another line of the cell's source text are another step.
        let notes: Vec<Note> = (0..9).map(|i| event(i, Some(i))).collect();
        assert!(!chart(&names(), &notes, "so", Folding::Repeats).contains("..."));
    }

    #[test]
    fn what_differs_in_more_than_a_number_of_a_message_is_no_repetition() {
        let event =
            |tick, value| Note::Event { tick, lane: 0, text: format!("weigh ends: {value}"), line: None };
        let notes: Vec<Note> = (0..8).map(|i| event(i, i)).collect();
        assert!(!chart(&names(), &notes, "so", Folding::Repeats).contains("..."));
        let early: Vec<Note> = (0..8).map(|i| event(i * i, 1)).collect();
        assert!(!chart(&names(), &early, "so", Folding::Repeats).contains("..."), "at other times");
    }

    #[test]
    fn no_chart_is_wider_than_a_terminal_and_no_word_is_left_out() {
        let long =
            "a_port_with_a_name_that_is_much_longer_than_any_that_a_person_would_ever_want_to_type_again";
        for tasks in [1, 2, 5, 9, 30] {
            let names: Vec<String> = (0..tasks).map(|i| format!("inspector_of_station_{i}")).collect();
            let notes = [
                Note::Event {
                    tick: 123_456,
                    lane: tasks - 1,
                    text: format!("drops {long} #12: refused"),
                    line: None,
                },
                Note::Packet {
                    tick: 123_457,
                    from: tasks - 1,
                    to: 0,
                    label: long.into(),
                    outcome: "CUT OFF".into(),
                    line: None,
                },
            ];
            let drawn = chart(&names, &notes, &format!("{long} {long}"), Folding::Repeats);
            assert!(drawn.lines().all(|line| line.chars().count() <= COLUMNS), "{drawn}");
            let kept: String = drawn.chars().filter(|c| c.is_ascii_lowercase() || *c == '_').collect();
            assert!(drawn.contains("interrupted") && kept.contains("type_again"), "{drawn}");
        }
    }
}
