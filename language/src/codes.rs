//! The codes of the diagnostics, and a page about each: what it means, a wrong example and a right one.

/// A code and what is to be said about it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CodeEntry {
    /// `E005`
    pub code: &'static str,
    /// What it is about, in a few words.
    pub title: &'static str,
    /// The page, in Markdown.
    pub explanation: &'static str,
}

macro_rules! codes {
    ($($name:ident $code:literal $title:literal;)*) => {
        $(pub(crate) const $name: &str = $code;)*

        /// All codes, sorted.
        pub const ALL: &[CodeEntry] = &[$(CodeEntry {
            code: $code,
            title: $title,
            explanation: include_str!(concat!("explain/", $code, ".md")),
        },)*];
    };
}

codes! {
    UNKNOWN "E001" "characters that are not known";
    UNCLOSED_TEXT "E002" "a comment or a text is not closed";
    NUMBER "E003" "a number that cannot be used";
    UNIT "E004" "an unknown unit of time";
    UNEXPECTED "E005" "something else was expected";
    SEMICOLON "E006" "a missing semicolon";
    UNCLOSED_BLOCK "E007" "a block is not closed";
    STRAY_END "E008" "an `end` that does not fit";
    RESERVED "E009" "a word of the language as a name";
    MISSPELT "E010" "an unknown word";
    UNCLEAR_NOT "E011" "what `not` covers is not plain";
    LIMIT "E012" "larger than is allowed";
    NOT_TEXT "E013" "not a text";
    OPERATOR "E014" "an operator of another language";
    MISPLACED "E015" "right, but not here";
    MORE "E016" "more errors than are shown";
    DUPLICATE "E101" "two things of one name";
    UNKNOWN_NAME "E102" "nothing has this name";
    TWO_OWNERS "E103" "a port of two owners";
    USAGES "E105" "usages that do not go together";
    NOT_LISTED "E106" "a port that lists the task not";
    NO_USE_PORT "E107" "a listed task without a `use_port`";
    DISAGREE "E108" "the two ends of a port disagree";
    ARGUMENTS "E109" "too few or too many values";
    TOO_LONG "E110" "a message that is too long";
    OPTION "E111" "an option that does not fit";
    TYPES "E112" "a value of another type";
    STATEMENT "E113" "a statement that cannot be here";
    ACTION "E114" "one action of two shapes";
    HANDLERS "E115" "two handlers for the same thing";
    TAKEOVER "E116" "a take-over without its couple";
    TIMERS "E118" "a timer that calls nothing";
    ORDER "E119" "an `order` that cannot be kept";
    MISSING "E120" "something is missing";
    TWICE "E121" "the same thing twice";
    COUPLE "E122" "a work couple that does not fit";
    TOO_MANY "E123" "too large";
    INTERVAL "E124" "an interval that ends before it begins";
    MALFORMED "E125" "a fault of the compiler";
    DEADLINE "E201" "a deadline that cannot be met";
    NO_LINK "E205" "nodes that are not joined";
    RATE "E207" "a rate that cannot be served";
    WRAPS "E304" "message numbers that may repeat";
    TAKEOVER_TOO_SOON "E305" "both tasks of a couple can act";
    LEASE_TOO_SHORT "E306" "a lease that ends before it is renewed";
    ROUNDED "N101" "a duration is no multiple of the tick";
}

/// The page about a code, in capitals or not.
#[must_use]
pub fn explain(code: &str) -> Option<&'static CodeEntry> {
    ALL.iter().find(|entry| entry.code.eq_ignore_ascii_case(code))
}
