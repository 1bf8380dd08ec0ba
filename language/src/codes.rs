//! The codes of the diagnostics. Each code has a page: what it means, a wrong example and a right one.

/// A code with its title and its page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CodeEntry {
    /// The code, such as `E005`.
    pub code: &'static str,
    /// What the code is about, in a few words.
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
    RESERVED "E009" "a keyword as a name";
    MISSPELT "E010" "an unknown word";
    UNCLEAR_NOT "E011" "what `not` covers is not plain";
    LIMIT "E012" "larger than is allowed";
    NOT_TEXT "E013" "not a text";
    OPERATOR "E014" "an operator of another language";
    MISPLACED "E015" "right, but not here";
    MORE "E016" "more errors than are shown";
    DUPLICATE "E101" "two things with one name";
    UNKNOWN_NAME "E102" "an unknown name";
    TWO_OWNERS "E103" "a port with two owners";
    NEVER_COMES "E104" "a `waitfor` that a member never reaches";
    USAGES "E105" "usages that do not go together";
    NOT_LISTED "E106" "a port whose `user_list` lacks the task";
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
    NOT_IN_THE_PAPER "E117" "not a keyword of the paper";
    TIMERS "E118" "a timer that calls nothing";
    ORDER "E119" "an `order` that cannot be kept";
    MISSING "E120" "something is missing";
    TWICE "E121" "the same thing twice";
    COUPLE "E122" "a work couple that does not fit";
    TOO_MANY "E123" "too large";
    INTERVAL "E124" "an interval that ends before it begins";
    MALFORMED "E125" "a fault of the compiler";
    DEADLINE "E201" "a deadline that cannot be met";
    RING "E202" "tasks that wait for each other's answers";
    WAITFOR_ORDER "E203" "rendezvous in different orders";
    NEVER_RECEIVED "E204" "a command that no task receives";
    NO_LINK "E205" "nodes that no links join";
    SHORT_TIME_OUT "E206" "a time_out of a few ticks";
    RATE "E207" "a rate that cannot be served";
    NO_TIME_OUT "E208" "a `waitfor` that cannot give up";
    NEVER_ANSWERED "E209" "a command that no task answers";
    ACTS_EARLY "E211" "a standby that acts before it takes over";
    WRAPS "E304" "message numbers that may repeat";
    TAKEOVER_TOO_SOON "E305" "both tasks of a couple can act";
    LEASE_TOO_SHORT "E306" "a lease that ends before it is renewed";
    ROUNDED "N101" "a duration is no multiple of the tick";
    SOON "N201" "a time_out of less than 20 ticks";
    UNRANKED "N202" "handlers that rank behind the task itself";
    UNPREPARED "W301" "a bad outcome without a branch";
    FULL "W302" "a buffer with fewer places than senders";
    TOO_BUSY "W303" "too busy to answer in time";
    NOBODY_LISTENS "W304" "a status that no task receives";
    SERIAL "W305" "a serial couple without an order";
    LONG_PENALTY "W306" "a penalty longer than the time_out";
    LITERAL_PENALTY "W307" "the paper's penalty starves";
    NOT_ALWAYS_ANSWERED "W308" "a command that is not always answered";
    UNREACHABLE "W309" "a statement that is never reached";
    UNUSED_PORT "W310" "a port that no task uses";
    UNUSED_VARIABLE "W311" "a variable that is never read";
    TIGHT "W312" "a tight couple without a query";
    LOOSE "W313" "a loose couple without its administrator";
    CONDITIONAL "W314" "a `waitfor` that one member reaches only under a condition";
    LOAD "W315" "more than a link carries";
    DOES_NOTHING "W316" "a task that does nothing yet";
    TELLS_NOBODY "W317" "a published value that no heartbeat carries";
    TIGHT_DEADLINE "W318" "a deadline that late ticks and slow actions can miss";
    HIDES "W319" "a handler's variable hides the task's";
    STANDBY_ENDS "W320" "a standby whose body ends";
}

/// The page of a code; case is ignored.
#[must_use]
pub fn explain(code: &str) -> Option<&'static CodeEntry> {
    ALL.iter().find(|entry| entry.code.eq_ignore_ascii_case(code))
}
