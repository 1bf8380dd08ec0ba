//! Words of RAPID, KRL, Structured Text, Python and ROS, each with what to write in a cell file in its place.

use crate::codes::MISSPELT;
use crate::diagnostic::Diagnostic;
use crate::lexer::Kind;
use crate::span::Span;

/// One row: words of other languages that mean the same thing, in lower case, and the word to write in a cell instead.
type Row = (&'static [&'static str], &'static str);

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
    declared(word).unwrap_or("declare ports and variables here, and write `begin` in front of statements")
}

/// What to write in place of a declaration of another language, or of a statement that a program may have outside.
fn declared(word: &str) -> Option<&'static str> {
    find(DECLARATIONS, word).or_else(|| find(STATEMENTS, word))
}

/// What to write in place of a type of another language.
pub(crate) fn data_type(word: &str) -> Option<&'static str> {
    find(TYPES, word)
}

fn find(rows: &[Row], word: &str) -> Option<&'static str> {
    let lower = word.to_ascii_lowercase();
    rows.iter().find(|(words, _)| words.contains(&lower.as_str())).map(|(_, help)| *help)
}

pub(crate) const NO_ARRAYS: &str = "there are no arrays: write a variable for each, or a record";

const STATEMENTS: &[Row] = &[
    (&["for", "foreach", "repeat", "until"], "loops are written `loop ... end;` and `while ... do ... end;`"),
    (&["case", "switch", "match", "test"], "choices are written `if ... then ... elsif ... else ... end;`"),
    (&["return", "break", "leave"], "`exit;` leaves a loop; a task ends at its `end`"),
    (&["continue", "next", "goto"], "there are no jumps: put the rest of the round into an `if`"),
    (&["pass", "nop", "null"], "`skip;` does nothing"),
    (&["print", "printf", "log", "tpwrite", "echo", "msgnotify"], "show it by an action: `run show n;`"),
    (
        &["wait", "waittime", "sleep", "usleep", "msleep"],
        "`delay 200 msec;` waits for a time, `receive p(x);` for a message",
    ),
    (
        &["waitdi", "waitdo", "waituntil", "waitsignal"],
        "`receive p(x);` waits for a message, `run NAME;` for an action outside",
    ),
    (
        &["waitsynctask", "synccmd", "progsync", "barrier"],
        "`waitfor p() on time_out do ... end;` waits until all its tasks have arrived",
    ),
    (
        &[
            "movel", "movej", "movec", "moveabsj", "ptp", "lin", "circ", "spl", "spline", "move", "ptp_rel",
            "lin_rel", "movetox", "velset", "accset",
        ],
        "a motion is an action: `run move_to x, y takes 1..2 sec;`, and a driver carries it out",
    ),
    (
        &["set", "reset", "setdo", "setgo", "pulsedo", "digital_out"],
        "an output is set by an action: `run set_gripper;`, and a driver carries it out",
    ),
    (
        &["call", "execute", "invoke"],
        "there are no procedures: an action outside is carried out by `run NAME;`",
    ),
    (
        &["try", "except", "catch", "raise", "throw", "error"],
        "each statement has its own branches: `... on time_out do ... end on refused do ... end;`",
    ),
    (
        &["trap", "interrupt", "connect", "callback", "subscribe", "create_subscription"],
        "a handler is written at the beginning of the body: `on receive p(x) do ... end;`",
    ),
    (&["idisable", "ienable", "critical", "synchronized"], "`atomic ... end;` keeps handlers out"),
    (
        &["lock", "unlock", "mutex", "semaphore", "acquire", "release"],
        "one task owns what other tasks need; they ask it: `query p() -> ok on time_out do ... end;`",
    ),
    (
        &["publish", "emit", "put", "post", "write", "sendto", "notify", "signal", "broadcast"],
        "`send p(x);` sends on a port of the task, `use_send p(x);` on a port that it uses",
    ),
    (&["await", "yield", "spin", "spin_once", "rate"], "a statement waits by itself: `receive p(x);`"),
    (
        &["spawn", "fork", "thread", "go", "join"],
        "a task is declared in the file; what it shares with others it sends",
    ),
    (
        &["ton", "tof", "tp", "timer", "create_timer", "settimer"],
        "`start t 4 sec;` starts a timer; `on expiry t do ... end;` is called at its end",
    ),
    (
        &["incr", "decr", "inc", "dec", "add", "clear", "assign"],
        "a variable is changed by an assignment: `n := n + 1;`",
    ),
    (
        &["halt", "stopmove", "startmove", "exitcycle", "brake", "systemstopaction"],
        "`abort \"why\";` ends a task; a motion is stopped by its driver, when the action is cut short",
    ),
    (
        &["recv", "take", "listen", "poll", "select", "accept", "read", "get", "input"],
        "`receive p(x);` waits for a message; a handler takes one at any time: `on receive p(x) do ... end;`",
    ),
];

const DECLARATIONS: &[Row] = &[
    (
        &["const", "constant", "static", "pers", "persistent"],
        "there are no constants: write the value, or a variable that the body sets first",
    ),
    (
        &[
            "procedure",
            "proc",
            "function",
            "func",
            "fun",
            "fn",
            "def",
            "async",
            "lambda",
            "function_block",
            "sub",
            "method",
            "routine",
        ],
        "there are no procedures: write the statements where they run, or an action (`run NAME;`)",
    ),
    (
        &[
            "program",
            "process",
            "class",
            "main",
            "proctype",
            "active",
            "actor",
            "agent",
            "component",
            "robot",
            "device",
            "controller",
            "public",
        ],
        "what a robot does is a task: `task arm on n1 begin ... end arm;`",
    ),
    (
        &[
            "import",
            "from",
            "include",
            "require",
            "using",
            "package",
            "namespace",
            "module",
            "rclpy",
            "rclcpp",
        ],
        "a cell is one file; a module is declared at a task: `task arm on n1 module arms`",
    ),
    (
        &["struct", "record", "typedef", "dut", "message", "msg", "interface"],
        "`type Pose is record x: int16; end;` declares a record",
    ),
    (
        &["enum", "enumeration"],
        "there are no enumerations: write numbers, and say in a comment what they mean",
    ),
    (&["array", "list", "vector"], NO_ARRAYS),
    (
        &[
            "topic",
            "publisher",
            "subscriber",
            "subscription",
            "service",
            "client",
            "channel",
            "chan",
            "queue",
            "mailbox",
            "create_publisher",
            "create_service",
            "create_client",
        ],
        "messages go through ports: `port p(x: int16) usage = send user_list = {arm} time_out = 50 msec;` in a task",
    ),
    (
        &[
            "int",
            "dint",
            "integer",
            "bool",
            "float",
            "double",
            "real",
            "string",
            "num",
            "variable",
            "let",
            "decl",
            "dim",
            "auto",
            "local",
            "global",
            "declare_parameter",
        ],
        "variables stand in a task in front of `begin`: `var x: int16;`",
    ),
    (&["action"], "an action needs no declaration: `run NAME;` in a task carries it out"),
    (&["host", "computer", "station", "plc", "machine"], "a computer is a node: `node n1;`"),
    (&["network", "bus", "wire", "cable"], "two nodes are joined by a link: `link n1 -- n2 delay 5 msec;`"),
];

const TYPES: &[Row] = &[
    (
        &[
            "int", "sint", "dint", "lint", "num", "number", "int64", "i64", "long", "short", "i8", "i16",
            "i32",
        ],
        "whole numbers are `int8`, `int16` and `int32`, others `real`",
    ),
    (
        &["uint", "usint", "udint", "ulint", "byte", "uint8", "uint16", "u8", "u16", "natural"],
        "whole numbers are `int8`, `int16` and `int32`; without a sign there is `word`, of 32 bits",
    ),
    (&["dword", "uint32", "u32", "lword", "uint64", "u64"], "write `word`, which has 32 bits and no sign"),
    (&["float", "double", "lreal", "float32", "float64", "f32", "f64"], "write `real`, which has 32 bits"),
    (&["boolean", "bit"], "write `bool`"),
    (
        &["string", "str", "text", "char", "wstring", "strvar"],
        "messages carry no texts: send a number, and say in a comment what it means",
    ),
    (&["array", "list", "vector", "seq", "tuple", "dict"], NO_ARRAYS),
    (
        &["pose", "robtarget", "jointtarget", "e6pos", "frame", "point"],
        "declare it: `type Pose is record x: int16; y: int16; end;`",
    ),
    (&["time", "duration", "clock"], "a time stands where it is used: `delay 200 msec;`"),
    (
        &["ton", "tof", "tp", "timer"],
        "a timer is no variable: `start t 4 sec;` starts it, `on expiry t do ... end;` handles its end",
    ),
    (
        &["semaphore", "mutex", "lock"],
        "a task owns what others need, and they ask it: there is nothing to lock",
    ),
    (
        &["pointer", "ref", "any", "object", "void"],
        "there is no such type: a message is a copy of its fields",
    ),
];

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn each_word_stands_once_in_its_table_and_in_lower_case() {
        for table in [STATEMENTS, DECLARATIONS, TYPES] {
            let words: Vec<&str> = table.iter().flat_map(|(words, _)| *words).copied().collect();
            assert_eq!(words.iter().collect::<BTreeSet<_>>().len(), words.len());
            assert!(words.iter().all(|word| *word == word.to_ascii_lowercase()));
        }
    }
}
