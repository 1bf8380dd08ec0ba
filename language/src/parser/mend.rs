//! Corrects misspelt keywords at the beginning of a line: reports them, and replaces their tokens by the keywords that were
//! probably meant. So `whlie` opens a block, and the block's `end` fits.

use super::failure::misspelt;
use crate::codes::STRAY_END;
use crate::diagnostic::Diagnostic;
use crate::foreign;
use crate::lexer::{Kind, Token};
use crate::report::Report;
use crate::source::Source;
use crate::span::Span;
use crate::words::Word;

/// The greatest number of names that the parser compares with all keywords, because comparing takes time.
const MOST: usize = 1000;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Region {
    Top,
    Record,
    Head,
    Body,
}

/// Replaces misspelt keywords among the tokens and reports them.
pub(super) fn mend(tokens: &mut [Token], source: &Source, report: &mut Report) {
    let mut region = Region::Top;
    let mut compared = 0;
    for index in 0..tokens.len() {
        if tokens[index].0 == Kind::Name && compared < MOST && begins_line(tokens, index, region, source) {
            compared += 1;
            if let Some((word, found)) = meant(source.slice(tokens[index].1), tokens[index].1, region, index)
            {
                report.push(|| found);
                tokens[index].0 = Kind::Word(word);
            }
        }
        let Kind::Word(word) = tokens[index].0 else { continue };
        let follows = tokens.get(index + 1).map(|(kind, _)| *kind);
        region = match (region, word) {
            (_, Word::Record) => Region::Record,
            (_, Word::Task) => Region::Head,
            (_, Word::Begin) => Region::Body,
            (Region::Record, Word::End) => Region::Top,
            (_, Word::End) if follows.is_some_and(Kind::may_be_name) => Region::Top,
            _ => region,
        };
    }
}

fn begins_line(tokens: &[Token], index: usize, region: Region, source: &Source) -> bool {
    let follows = tokens.get(index + 1).map(|(kind, _)| *kind);
    let behind_variables =
        [Kind::Assign, Kind::Dot, Kind::Equal, Kind::Colon, Kind::BracketOpen, Kind::Plus, Kind::Link];
    if follows.is_some_and(|kind| behind_variables.contains(&kind)) {
        return false;
    }
    let Some((before, place)) = index.checked_sub(1).map(|index| tokens[index]) else { return true };
    let behind = match before {
        Kind::Semicolon => true,
        Kind::Word(word) => matches!(
            word,
            Word::Begin | Word::Then | Word::Else | Word::Do | Word::Loop | Word::Atomic | Word::Takeover
        ),
        _ => false,
    };
    let gap = || source.text()[place.end as usize..tokens[index].1.start as usize].contains('\n');
    behind || region == Region::Head && gap()
}

/// The keyword that was probably meant, and the diagnostic about the misspelling.
fn meant(text: &str, span: Span, region: Region, index: usize) -> Option<(Word, Diagnostic)> {
    if foreign::is_known(text) {
        return None; // The parser says what to write in place of this word.
    }
    let near = |among: &[Word]| Word::near(text, among).map(|word| (word, misspelt(span, text, word)));
    match region {
        Region::Record => None,
        Region::Top if index == 0 => near(&[Word::Cell]),
        Region::Top => near(Word::DECLARATIONS),
        Region::Head => near(Word::OF_TASK),
        Region::Body => {
            let lower = text.to_ascii_lowercase();
            let rest = lower.strip_prefix("end").map(|rest| rest.trim_start_matches('_'));
            if matches!(rest, Some("if" | "while" | "loop" | "for" | "on" | "task" | "atomic")) {
                let message = format!("`{text}`: a block is closed by `end` alone");
                let found = Diagnostic::error(STRAY_END, span, message).help("write `end;`");
                return Some((Word::End, found));
            }
            near(Word::STATEMENTS)
        }
    }
}
