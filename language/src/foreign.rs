//! Words of RAPID, KRL, Structured Text, Python and ROS, each with what to write in a cell file in its place.

use crate::codes::MISSPELT;
use crate::diagnostic::Diagnostic;
use crate::lexer::Kind;
use crate::span::Span;

/// One row: words of other languages that mean the same thing, in lower case and separated by spaces, and what to write in
/// a cell instead.
type Row = (&'static str, &'static str);

/// The diagnostic for a line that begins with an unknown word, which the message shows as `shown`. `follows` is the token
/// behind the word.
pub(crate) fn unknown_statement(name: &str, shown: &str, span: Span, follows: Option<Kind>) -> Diagnostic {
    let found = Diagnostic::error(MISSPELT, span, format!("`{shown}` does not begin a statement"));
    match follows {
        // `n++;` and `n--;` of other languages: in a cell an assignment changes a variable.
        Some(sign @ (Kind::Plus | Kind::Link)) => {
            let sign = if sign == Kind::Plus { '+' } else { '-' };
            found.help(format!("write `{shown} := {shown} {sign} 1;`"))
        }
        Some(Kind::BracketOpen) if statement(name).is_none() => found.help(NO_ARRAYS),
        Some(Kind::Colon) if statement(name).is_none() => found.help(VARIABLES),
        Some(Kind::Name) if statement(name).is_none() && data_type(name).is_some() => found.help(VARIABLES),
        _ => match (statement(name), follows == Some(Kind::ParenOpen)) {
            (Some(help), false) => found.help(help),
            (Some(help), true) => {
                found.help(help).help(format!("or, if it is an action of yours: `run {shown}`"))
            }
            (None, true) => found.help(format!("an action is carried out by `run {shown}`")),
            (None, false) => {
                found.help("a statement begins with a keyword like `send`, or is `variable := value`")
            }
        },
    }
}

/// What to write in place of a statement of another language.
fn statement(word: &str) -> Option<&'static str> {
    find(STATEMENTS, word).or_else(|| find(DECLARATIONS, word))
}

/// Whether a word begins a line of another language.
pub(crate) fn is_known(word: &str) -> bool {
    statement(word).is_some()
}

/// The advice for a word of another language in a place where a declaration is expected.
pub(crate) fn declaration(word: &str) -> &'static str {
    declared(word).unwrap_or(
        "begin with the keyword of a declaration: `node n1;`, `task arm on n1 ..`; statements belong into a task",
    )
}

/// The advice for a word of another language in front of a task's `begin`.
pub(crate) fn in_task(word: &str) -> &'static str {
    declared(word).unwrap_or(
        "declare ports and variables here (`var x: int16;`), and write `begin` in front of statements",
    )
}

/// What to write in place of a word of another language where a declaration belongs. The word may stand for a
/// statement.
fn declared(word: &str) -> Option<&'static str> {
    find(DECLARATIONS, word).or_else(|| find(STATEMENTS, word))
}

/// What to write in place of a type of another language.
pub(crate) fn data_type(word: &str) -> Option<&'static str> {
    find(TYPES, word)
}

fn find(rows: &[Row], word: &str) -> Option<&'static str> {
    let lower = word.to_ascii_lowercase();
    rows.iter().find(|(words, _)| words.split_whitespace().any(|word| word == lower)).map(|(_, help)| *help)
}

/// The names of the types that need no declaration.
pub(crate) const PLAIN_TYPES: [&str; 7] = ["bool", "int8", "int16", "int32", "integer", "word", "real"];

/// Whether a keyword is the name of a type.
pub(crate) fn is_type(word: &str) -> bool {
    PLAIN_TYPES.iter().any(|name| name.eq_ignore_ascii_case(word))
}

/// What to write in place of a word between two values.
pub(crate) fn operator(word: &str) -> Option<&'static str> {
    find(OPERATORS, word)
}

const OPERATORS: &[Row] =
    &[("xor", "of two bools, `a <> b` is true if exactly one is true"), ("div", "`/` divides")];

const VARIABLES: &str = "variables stand in a task in front of `begin`: `var x: int16;`";
pub(crate) const NO_TEXTS: &str =
    "messages carry no texts: send a number, and say in a comment what it means";
pub(crate) const TYPE_BEHIND: &str = "the name comes first, and the type behind it: `x: int16`";
pub(crate) const NO_ARRAYS: &str = "there are no arrays: write a variable for each, or a record";

const STATEMENTS: &[Row] = &[
    ("for foreach repeat until", "loops are written `loop ... end;` and `while ... do ... end;`"),
    ("case switch match test", "choices are written `if ... then ... elsif ... else ... end;`"),
    (
        "end_case endcase endtest endswitch end_repeat endrepeat end_try endtry",
        "a block is closed by `end;` alone",
    ),
    ("return break leave", "`exit;` leaves a loop; a task ends at its `end`"),
    ("continue next goto jmp jump lbl label", "there are no jumps: put the rest of the round into an `if`"),
    ("pass nop null", "`skip;` does nothing"),
    (
        "print printf log tpwrite tperase echo msgnotify popup textmsg post_err errlog uimsgbox",
        "show it by an action: `run show n;`",
    ),
    (
        "wait waittime sleep usleep msleep",
        "`delay 200 msec;` waits for a time, `receive p(x);` for a message",
    ),
    (
        "waitdi waitdo waituntil waitsignal get_digital_in get_standard_digital_in",
        "`receive p(x);` waits for a message, `run NAME;` for an action outside",
    ),
    (
        "waitsynctask syncmoveon syncmoveoff synccmd progsync barrier rendezvous sync",
        "`waitfor p() on time_out do ... end;` waits until all its tasks have arrived",
    ),
    (
        "movel movej movec moveabsj ptp lin circ spl spline move ptp_rel lin_rel movetox velset \
         accset movep j l mc_moveabsolute mc_moverelative mc_movelinear mc_power mc_home",
        "a motion is an action: `run move_to x, y takes 1..2 sec;`, and a driver carries it out",
    ),
    (
        "set reset setdo setgo pulsedo digital_out set_digital_out set_standard_digital_out \
         set_tool_digital_out dout aout out open close",
        "an output is set by an action: `run set_gripper;`, and a driver carries it out",
    ),
    ("call execute invoke", "there are no procedures: an action outside is carried out by `run NAME;`"),
    (
        "try except catch raise throw error finally trynext",
        "each statement has its own branches: `... on time_out do ... end on refused do ... end;`",
    ),
    (
        "trap interrupt connect callback subscribe create_subscription idelete condition enable \
         disable",
        "a handler is written at the beginning of the body: `on receive p(x) do ... end;`",
    ),
    (
        "idisable ienable critical synchronized enter_critical exit_critical",
        "`atomic ... end;` keeps handlers out",
    ),
    (
        "lock unlock mutex semaphore acquire release",
        "one task owns what other tasks need; they ask it: `query p() -> ok on time_out do ... end;`",
    ),
    (
        "publish emit put post write sendto notify notify_all signal broadcast",
        "`send p(x);` sends on a port of the task, `use_send p(x);` on a port that it uses",
    ),
    (
        "ask request call_async send_request send_goal",
        "`query p() -> x on time_out do ... end;` asks, and waits for the answer",
    ),
    ("answer respond", "`response(x);` answers a query, `reply(x);` a command"),
    ("await yield spin spin_once rate", "a statement waits by itself: `receive p(x);`"),
    (
        "spawn fork thread go join parallel kill",
        "a task is declared in the file; what it shares with others it sends",
    ),
    (
        "ton tof tp timer create_timer settimer",
        "`start t 4 sec;` starts a timer; `on expiry t do ... end;` is called at its end",
    ),
    ("incr decr inc dec add clear assign", "a variable is changed by an assignment: `n := n + 1;`"),
    (
        "halt stopmove startmove exitcycle brake systemstopaction stopj stopl mc_stop mc_halt \
         cancel",
        "`abort \"why\";` ends a task; a motion is stopped by its driver, when the action is cut short",
    ),
    (
        "recv take listen poll select accept read get input",
        "`receive p(x);` waits for a message; a handler takes one at any time: `on receive p(x) do ... end;`",
    ),
];

const DECLARATIONS: &[Row] = &[
    (
        "new del delete malloc",
        "nothing is made or removed while a cell runs: variables, ports and tasks are declared",
    ),
    (
        "invariant property safety ltl ensure always",
        "`check apart: never a.inside and b.inside;` declares what must hold",
    ),
    (
        "key keys keyfile private_key public_key psk secret secrets password passwd token credential credentials",
        "all nodes read this file, so it holds no key: `imrs keygen CELL` writes one file for each node beside it",
    ),
    ("retain var_retain", "nothing is kept over a restart: all variables begin with zero or `false`"),
    (
        "deadline cycle period interval",
        "times stand where they are used: `time_out = 50 msec` at a port, `delay 10 msec;` in a task",
    ),
    (
        "const constant static pers persistent parameter param",
        "there are no constants: write the value, or a variable that the body sets first",
    ),
    (
        "procedure proc function func fun fn def async lambda function_block sub method routine \
         void",
        "there are no procedures: write the statements where they run, or an action (`run NAME;`)",
    ),
    (
        "program process class main proctype active actor agent component robot device controller \
         public",
        "what a robot does is a task: `task arm on n1 begin ... end arm;`",
    ),
    (
        "import from include launch require using package namespace module rclpy rclcpp",
        "a cell is one file; a module is declared at a task: `task arm on n1 module arms`",
    ),
    (
        "struct record typedef dut message msg interface",
        "`type Pose is record x: int16; end;` declares a record",
    ),
    ("enum enumeration", "there are no enumerations: write numbers, and say in a comment what they mean"),
    ("array list vector", NO_ARRAYS),
    (
        "topic publisher subscriber subscription service client channel chan queue mailbox \
         create_publisher create_service create_client output var_input var_output var_in_out",
        "messages go through ports: `port p(x: int16) usage = send user_list = {arm} time_out = 50 msec;` in a task",
    ),
    (
        "int dint integer bool float double real string num variable var var_global let decl dim \
         auto local global declare_parameter",
        VARIABLES,
    ),
    ("action", "an action needs no declaration: `run NAME;` in a task carries it out"),
    ("host computer station plc machine", "a computer is a node: `node n1;`"),
    ("network bus wire cable connection", "two nodes are joined by a link: `link n1 -- n2 delay 5 msec;`"),
];

const TYPES: &[Row] = &[
    (
        "int sint dint lint num number int64 i64 long short i8 i16 i32 int8_t int16_t int32_t",
        "whole numbers are `int8`, `int16` and `int32`, others `real`",
    ),
    (
        "uint usint udint ulint byte uint8 uint16 u8 u16 natural uint8_t uint16_t",
        "whole numbers are `int8`, `int16` and `int32`; without a sign there is `word`, of 32 bits",
    ),
    ("dword uint32 uint32_t u32 lword uint64 u64", "write `word`, which has 32 bits and no sign"),
    ("float double lreal float32 float64 f32 f64", "write `real`, which has 32 bits"),
    ("boolean bit", "write `bool`"),
    ("string str text char wstring strvar", NO_TEXTS),
    ("array list vector seq tuple dict", NO_ARRAYS),
    (
        "pose robtarget jointtarget e6pos frame point",
        "declare it: `type Pose is record x: int16; y: int16; end;`",
    ),
    ("time duration clock", "a time stands where it is used: `delay 200 msec;`"),
    (
        "ton tof tp timer",
        "a timer is no variable: `start t 4 sec;` starts it, `on expiry t do ... end;` handles its end",
    ),
    ("semaphore mutex lock", "a task owns what others need, and they ask it: there is nothing to lock"),
    ("enum", "there are no enumerations: write numbers, and say in a comment what they mean"),
    (
        "signaldi signaldo signalgi signalgo",
        "signals of a robot belong to its driver: `run NAME;` sets an output, `run NAME -> x;` reads an input",
    ),
    ("event trigger", "an event is a message: declare a port, and a handler `on receive p() do ... end;`"),
    ("pointer ref any object void", "there is no such type: a message is a copy of its fields"),
];

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn each_word_stands_once_in_its_table_and_in_lower_case() {
        for table in [STATEMENTS, DECLARATIONS, TYPES, OPERATORS] {
            let words: Vec<&str> = table.iter().flat_map(|(words, _)| words.split_whitespace()).collect();
            assert_eq!(words.iter().collect::<BTreeSet<_>>().len(), words.len());
            assert!(words.iter().all(|word| *word == word.to_ascii_lowercase()));
        }
    }
}
