//! Checks rules of this project for its source files, so that no reviewer has to check them.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");
const FOLDERS: [&str; 15] = [
    "src", "tests", "examples", "protocol", "language", "wire", "model", "runtime", "client", "launch",
    "macros", "monitor", "benches", "fuzz", "testkit",
];
/// The largest permitted number of lines of a file, and of a function.
const LONGEST: (usize, usize) = (400, 70);
/// The exceptions: each line has the permitted length, a path, and for a function also its name. Exceptions may be
/// removed, but not added.
const LONGER: &str = include_str!("tidy_longer.txt");

/// Every Rust file of the workspace, with its text.
fn sources() -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    let mut folders: Vec<PathBuf> = FOLDERS.iter().map(|folder| Path::new(ROOT).join(folder)).collect();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() && path.file_name().is_some_and(|name| name != "target") {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = fs::read_to_string(&path).expect("a source file");
                found.push((path, text));
            }
        }
    }
    assert!(found.len() > 30, "the sources were not found: {found:?}");
    found
}

/// For each function of a formatted file, its number of lines. If several functions have the same name, the longest one
/// counts.
fn functions(text: &str) -> BTreeMap<String, usize> {
    let lines: Vec<&str> = text.lines().collect();
    let mut found = BTreeMap::new();
    for (at, line) in lines.iter().enumerate() {
        let (inner, words) =
            (line.trim_start(), ["pub ", "const ", "async ", "unsafe ", "pub(crate) ", "pub(super) "]);
        let mut rest = inner;
        while let Some(next) = words.iter().find_map(|word| rest.strip_prefix(word)) {
            rest = next;
        }
        let Some(name) = rest.strip_prefix("fn ") else { continue };
        let indent = &line[..line.len() - inner.len()];
        // A function on a single line has no closing brace on a line of its own.
        let is_end =
            |line: &&str| line.strip_prefix(indent).is_some_and(|rest| !rest.starts_with([' ', ')']));
        let length = lines[at + 1..]
            .iter()
            .position(is_end)
            .filter(|&end| lines[at + 1 + end] == format!("{indent}}}"));
        let name = name.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default();
        if let Some(length) = length {
            let longest = found.entry(name.to_owned()).or_insert(0);
            *longest = length.saturating_add(2).max(*longest);
        }
    }
    found
}

#[test]
fn files_and_functions_stay_short_enough_to_be_read() {
    let mut listed: BTreeMap<String, usize> = LONGER
        .lines()
        .map(|line| {
            let (length, what) = line.split_once(' ').expect("a length and a place");
            (what.to_owned(), length.parse().expect("a length"))
        })
        .collect();
    let mut longer = Vec::new();
    let mut judge = |what: String, length: usize, most: usize| {
        let known = listed.remove(&what);
        if length > known.unwrap_or(most) {
            longer.push(format!("{length} {what}"));
        } else if let Some(known) = known {
            assert!(length > most, "{what} is short enough now: take `{known} {what}` out of the list");
        }
    };
    for (path, text) in sources() {
        let path = path.strip_prefix(ROOT).expect("a file of the workspace").display().to_string();
        for (name, length) in functions(&text) {
            judge(format!("{path} {name}"), length, LONGEST.1);
        }
        judge(path, text.lines().count(), LONGEST.0);
    }
    assert!(longer.is_empty(), "longer than {LONGEST:?} lines, or than before: {longer:#?}");
    assert!(listed.is_empty(), "gone, or renamed: {listed:#?}");
}

#[test]
fn the_length_of_a_function_is_measured() {
    let text = "fn one() {}\nimpl A {\n    pub(crate) const fn two(\n        a: u8,\n    ) -> u8 {\n        a\n    }\n}\n\
                trait T {\n    fn none(&self);\n    fn three() {\n        x();\n    }\n}\n";
    let expected = [("two", 5), ("three", 3)].map(|(name, lines)| (name.to_owned(), lines));
    assert_eq!(functions(text), BTreeMap::from(expected));
}

#[test]
fn nothing_is_left_out_or_left_for_later() {
    // The words are concatenated, so that this file does not contain them.
    let unwanted = [
        concat!("#[ig", "nore"),
        concat!("to", "do!("),
        concat!("unimp", "lemented!("),
        concat!("FIX", "ME"),
    ];
    for (path, text) in sources() {
        for (number, line) in text.lines().enumerate() {
            for word in unwanted {
                assert!(!line.contains(word), "{}:{}: {}", path.display(), number + 1, line.trim());
            }
        }
    }
}

/// Private words that `specs/glossary.md` replaces by a standard term. No name of the code may contain one.
const RETIRED: [&str; 30] = [
    "beat", "beats", "court", "crossing", "deed", "deeds", "desk", "desks", "diary", "doorbell", "fate",
    "fates", "ghost", "ghosts", "habit", "habits", "life", "lives", "looker", "mail", "mails", "nudge",
    "seat", "sight", "sights", "sitting", "station", "stations", "tale", "teller",
];

/// The words of an identifier: `FirstLife`, `first_life` and `FIRST_LIFE` all contain the word `life`.
fn words_of(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut before = '_';
    for letter in name.chars() {
        if letter == '_' || (letter.is_uppercase() && (before.is_lowercase() || before.is_numeric())) {
            words.push(String::new());
        }
        if letter != '_' {
            words.last_mut().expect("one").extend(letter.to_lowercase());
        }
        before = letter;
    }
    words
}

/// The code of a file, without comments and string literals. All line numbers stay the same.
fn code_of(text: &str) -> String {
    let (mut code, mut rest) = (String::new(), text);
    while let Some(letter) = rest.chars().next() {
        let raw = ["r\"", "r#\"", "r##\""].iter().find(|open| rest.starts_with(**open));
        let length = if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if let Some(open) = raw {
            let close: String = open.chars().skip(1).collect::<Vec<_>>().into_iter().rev().collect();
            rest[open.len()..].find(&close).map_or(rest.len(), |at| open.len() + at + close.len())
        } else if letter == '"' {
            let mut escaped = false;
            let ends = |c: char| {
                let ends = c == '"' && !escaped;
                escaped = c == '\\' && !escaped;
                ends
            };
            rest[1..].find(ends).map_or(rest.len(), |at| at + 2)
        } else if rest.starts_with("'\"'") {
            3
        } else {
            code.push(letter);
            rest = &rest[letter.len_utf8()..];
            continue;
        };
        code.extend(rest[..length].chars().filter(|&c| c == '\n'));
        rest = &rest[length..];
    }
    code
}

fn names_in(code: &str) -> impl Iterator<Item = &str> {
    let names = code.split(|c: char| !c.is_alphanumeric() && c != '_');
    names.filter(|name| name.starts_with(|c: char| c.is_alphabetic() || c == '_'))
}

#[test]
fn no_name_of_the_code_has_a_retired_word() {
    let mut found = Vec::new();
    for (path, text) in sources() {
        let path = path.strip_prefix(ROOT).expect("a file of the workspace").to_path_buf();
        // In tests and examples, names such as `beat` are ports of cells.
        if path.iter().any(|part| part == "tests" || part == "examples") {
            continue;
        }
        for (number, line) in code_of(&text).lines().enumerate() {
            let retired = names_in(line)
                .filter(|name| words_of(name).iter().any(|word| RETIRED.contains(&word.as_str())));
            found.extend(retired.map(|name| format!("{}:{}: {name}", path.display(), number + 1)));
        }
    }
    assert!(found.is_empty(), "{} names, see specs/glossary.md: {found:#?}", found.len());
}

/// Parts of sentences that a first-time reader does not understand: they do not name who acts, or they use words that
/// only this project uses.
const UNCLEAR: [&str; 13] = [
    "whoever",
    "what is left",
    "turned away",
    "nobody",
    "somebody",
    "told of",
    "on the way",
    "on its way",
    "in vain",
    "comes in",
    "rings the bell",
    "rooms",
    "what else",
];

#[test]
fn comments_name_their_actors() {
    let mut found = Vec::new();
    for (path, text) in sources() {
        // This file is not searched, because it contains the list of words.
        if path.ends_with("tests/tidy.rs") {
            continue;
        }
        for (number, line) in text.lines().enumerate() {
            let Some(comment) =
                line.trim_start().strip_prefix("//").or_else(|| line.split_once(" // ").map(|(_, c)| c))
            else {
                continue;
            };
            let words = format!(" {} ", comment.replace(|c: char| !c.is_alphabetic(), " "));
            let begins =
                |phrase: &str| words.contains(&format!(" {}{} ", phrase[..1].to_uppercase(), &phrase[1..]));
            let unclear =
                UNCLEAR.iter().filter(|phrase| words.contains(&format!(" {phrase} ")) || begins(phrase));
            found.extend(unclear.map(|phrase| format!("{}:{}: {phrase}", path.display(), number + 1)));
        }
    }
    assert!(found.is_empty(), "say who does what: {found:#?}");
}

#[test]
fn words_of_names_are_told_apart() {
    for name in ["FirstLife", "first_life", "FIRST_LIFE"] {
        assert_eq!(words_of(name), ["first", "life"]);
    }
    let text = "let a_desk = ['\"', \"seat \\\" mail\nfate\"]; // ghost\nr#\"a \" deed\"#; tale";
    assert_eq!(code_of(text), "let a_desk = [, \n]; \n; tale");
    assert!(names_in(&code_of(text)).eq(["let", "a_desk", "tale"]));
}

#[test]
fn words_promise_no_more_than_is_so() {
    let unwanted = [concat!("safety", "-rated"), concat!("fail", "-safe"), concat!("SI", "L-")];
    let documents = ["README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md"];
    let texts = documents
        .map(|name| (PathBuf::from(name), fs::read_to_string(Path::new(ROOT).join(name)).expect(name)));
    for (path, text) in sources().into_iter().chain(texts) {
        for word in unwanted {
            // A sentence may say that the claim is not made.
            let claims = text.lines().find(|l| l.contains(word) && !l.contains("no ") && !l.contains("not "));
            assert_eq!(claims, None, "{}", path.display());
        }
    }
}
