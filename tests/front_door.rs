//! Checks that the pages which a stranger reads first agree with the tree and the command: the README, the page of the
//! monitor, the README of each crate. Excerpts occur in their files, commands and flags in the help, and quoted output is
//! really printed.

mod crates;
mod printed;

use crate::support::run;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");
/// The README must stay shorter than this, because it is read in one go.
const LONGEST_README: usize = 120;
const CRATES: [&str; 9] =
    ["protocol", "language", "wire", "model", "runtime", "client", "macros", "monitor", "benches"];

fn read(path: &str) -> String {
    fs::read_to_string(Path::new(ROOT).join(path)).unwrap_or_else(|e| panic!("{path}: {e}"))
}

/// The pages: their paths from the root, and their texts.
fn pages() -> Vec<(String, String)> {
    let crates = CRATES.iter().map(|room| format!("{room}/README.md"));
    let all = ["README.md", "docs/monitor.md"].map(str::to_owned).into_iter().chain(crates);
    all.map(|path| (path.clone(), read(&path))).collect()
}

/// A block of code: its kind, its lines, and the text before it.
pub struct Block<'a> {
    pub kind: &'a str,
    pub lines: Vec<&'a str>,
    pub before: &'a str,
}

pub fn blocks(text: &str) -> Vec<Block<'_>> {
    let mut found = Vec::new();
    let mut from = 0;
    while let Some(at) = text[from..].find("```").map(|at| from + at) {
        let (kind, body) = text[at + 3..].split_once('\n').expect("a line that opens a block");
        let (body, _) = body.split_once("```").expect("a block that is closed");
        found.push(Block { kind, lines: body.trim_end().lines().collect(), before: &text[..at] });
        from = at + 3 + kind.len() + 1 + body.len() + 3;
    }
    found
}

/// The spans between backquotes, line by line, without code blocks.
fn spans(text: &str) -> Vec<Vec<&str>> {
    let mut in_block = false;
    let mut found = Vec::new();
    for line in text.lines() {
        if line.starts_with("```") {
            in_block = !in_block;
        } else if !in_block {
            found.push(line.split('`').skip(1).step_by(2).collect());
        }
    }
    found
}

/// The targets of the links of a text within the tree.
pub fn links(text: &str) -> Vec<&str> {
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split([')', '#']).next());
    targets.filter(|target| !target.is_empty() && !target.contains("://")).collect()
}

/// Whether the lines of an excerpt occur in a source in this order. They must be adjacent, except that a line `...`
/// stands for any lines.
pub fn is_excerpt(excerpt: &[&str], source: &[&str]) -> bool {
    let mut at = 0;
    excerpt.split(|line| line.trim() == "...").filter(|piece| !piece.is_empty()).all(|piece| {
        let found = source[at..].windows(piece.len()).position(|window| window == piece);
        at += found.unwrap_or_default() + piece.len();
        found.is_some()
    })
}

#[test]
fn the_readme_is_short() {
    let lines = read("README.md").lines().count();
    assert!(lines < LONGEST_README, "README.md has {lines} lines");
}

#[test]
fn every_excerpt_is_a_part_of_its_file() {
    let mut excerpts = 0;
    for (page, text) in pages() {
        for block in blocks(&text).iter().filter(|block| ["cell", "rust"].contains(&block.kind)) {
            excerpts += 1;
            let room = page.strip_suffix("/README.md").filter(|room| CRATES.contains(room));
            let files = match room {
                // The example of a crate must occur in its documentation, or in `crates`.
                Some(room) => vec![format!("{room}/src/lib.rs"), "tests/front_door/crates.rs".into()],
                None => {
                    let named =
                        links(block.before).into_iter().rfind(|link| link.ends_with(block.kind_of_file()));
                    vec![named.unwrap_or_else(|| panic!("{page}: an excerpt of no file")).to_owned()]
                }
            };
            let is_there = files.iter().any(|file| {
                let source = read(file);
                let plain = |line| if room.is_some() { code(line) } else { line };
                let excerpt: Vec<&str> = block.lines.iter().map(|line| plain(line)).collect();
                is_excerpt(&excerpt, &source.lines().map(plain).collect::<Vec<_>>())
            });
            assert!(is_there, "{page} shows what is not in {files:?}:\n{}", block.lines.join("\n"));
        }
    }
    assert!(excerpts >= 8, "only {excerpts} excerpts were found");
}

impl Block<'_> {
    fn kind_of_file(&self) -> &'static str {
        if self.kind == "cell" { ".cell" } else { ".rs" }
    }
}

/// A line of an example, without the comment marks of a doc example.
fn code(line: &str) -> &str {
    let line = line.trim();
    line.strip_prefix("//!").or_else(|| line.strip_prefix("///")).unwrap_or(line).trim()
}

#[test]
fn links_and_paths_lead_somewhere() {
    for (page, text) in pages() {
        let folder = Path::new(ROOT).join(&page).parent().expect("a folder").to_owned();
        for link in links(&text) {
            assert!(folder.join(link).exists(), "{page} links to {link}");
        }
        let is_path = |span: &&str| {
            let ends = [".rs", ".md", ".cell", ".py", ".svg", ".toml"];
            span.contains('/') && !span.contains([' ', '$']) && ends.iter().any(|end| span.ends_with(end))
        };
        for path in spans(&text).into_iter().flatten().filter(is_path) {
            let is_there = Path::new(ROOT).join(path).exists() || folder.join(path).exists();
            assert!(is_there, "{page} names `{path}`");
        }
    }
}

/// The help of the command, and of each verb.
fn helps() -> BTreeMap<String, String> {
    let said = run(&["--help"]);
    assert_eq!(said.code, Some(0), "{said:?}");
    let (_, list) = said.out.split_once("Commands:\n").expect("a list of commands");
    let is_verb = |line: &&str| line.starts_with("  ") && !line.starts_with("   ");
    let verbs = list.lines().take_while(|line| !line.is_empty()).filter(is_verb);
    let verbs = verbs.filter_map(|line| line.split_whitespace().next()).filter(|verb| *verb != "help");
    let mut found: BTreeMap<String, String> =
        verbs.map(|verb| (verb.to_owned(), run(&[verb, "--help"]).out)).collect();
    found.insert(String::new(), said.out);
    assert!(found.len() > 10, "the verbs were not found: {found:?}");
    found
}

/// Whether a help has this flag.
fn has_flag(help: &str, flag: &str) -> bool {
    let flag = flag.split('=').next().unwrap_or(flag);
    help.match_indices(flag).any(|(at, _)| {
        let joins = |c: char| c.is_alphanumeric() || c == '-';
        !help[..at].ends_with(joins) && !help[at + flag.len()..].starts_with(joins)
    })
}

/// The arguments of `imrs` in a line that calls it, directly or through Cargo.
fn arguments<'a>(words: &[&'a str]) -> Option<Vec<&'a str>> {
    match words {
        ["imrs", rest @ ..] => Some(rest.to_vec()),
        ["cargo", "run", rest @ ..] if !rest.contains(&"-p") => {
            let at = rest.iter().position(|word| *word == "--")?;
            Some(rest[at + 1..].to_vec())
        }
        _ => None,
    }
}

/// Whether Cargo knows the examples and features that a command names.
fn cargo_knows(words: &[&str]) -> bool {
    words.windows(2).all(|pair| match pair {
        ["--example", name] => Path::new(ROOT).join(format!("examples/{name}.rs")).exists(),
        ["--features", name] => read("Cargo.toml").contains(&format!("\n{name} = [")),
        _ => true,
    })
}

/// Verbs that the command has only if it was built with the feature of the same name.
const WITH_FEATURES: [&str; 1] = ["zenoh"];

#[test]
fn commands_and_flags_are_those_of_the_help() {
    let helps = helps();
    let mut called = 0;
    for (page, text) in pages() {
        let blocks = blocks(&text);
        let typed = blocks.iter().filter(|block| block.kind == "sh").flat_map(|block| &block.lines);
        let typed = typed.map(|line| vec![line.split('#').next().unwrap_or(line)]);
        for line in spans(&text).into_iter().chain(typed) {
            let mut verb = None;
            for words in line.iter().map(|span| span.split_whitespace().collect::<Vec<_>>()) {
                if words.first() == Some(&"cargo") {
                    assert!(cargo_knows(&words), "{page}: {words:?}");
                }
                let flags = if let Some(arguments) = arguments(&words) {
                    let named = arguments.first().filter(|word| !word.starts_with('-'));
                    verb = Some(named.copied().unwrap_or_default());
                    called += 1;
                    arguments
                } else if words.first().is_some_and(|word| word.starts_with("--")) {
                    words
                } else {
                    continue;
                };
                if verb.is_some_and(|verb| WITH_FEATURES.contains(&verb) && !helps.contains_key(verb)) {
                    continue;
                }
                let known = match verb {
                    Some(verb) => helps.get(verb).cloned(),
                    None => Some(helps.values().cloned().collect::<Vec<_>>().concat()),
                };
                let known = known.unwrap_or_else(|| panic!("{page}: there is no `imrs {verb:?}`"));
                for flag in flags.into_iter().filter(|word| word.starts_with('-')) {
                    assert!(
                        has_flag(&known, flag),
                        "{page}: `imrs {}` has no {flag}",
                        verb.unwrap_or("VERB")
                    );
                }
            }
        }
    }
    assert!(called > 30, "only {called} calls of the command were found");
    let readme = read("README.md");
    for verb in helps.keys().filter(|verb| !verb.is_empty()) {
        assert!(readme.contains(&format!("`imrs {verb}")), "README.md does not name `imrs {verb}`");
    }
    let text = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let codes = readme.lines().find(|line| line.starts_with("Exit codes:")).expect("the exit codes");
    assert!(text(&helps[""]).contains(&text(codes)), "other exit codes than `imrs --help` has");
}

#[test]
fn the_demos_of_the_readme_are_those_of_the_command() {
    let source = read("src/demo/mod.rs");
    let field = |name: &str| -> Vec<String> {
        let begin = format!("        {name}: \"");
        let values = source.lines().filter_map(|line| line.strip_prefix(&begin)?.strip_suffix("\","));
        values.map(str::to_owned).collect()
    };
    let scenes: BTreeMap<String, String> = field("name").into_iter().zip(field("file")).collect();
    let readme = read("README.md");
    let row = |line: &str| {
        let (name, rest) = line.strip_prefix("| `")?.split_once("` | [")?;
        Some((name.to_owned(), rest.split(']').next()?.to_owned()))
    };
    let shown: BTreeMap<String, String> = readme.lines().filter_map(row).collect();
    assert_eq!(shown, scenes);
    let help = run(&["demo", "--help"]).out;
    assert!(scenes.len() == 5 && scenes.keys().all(|name| has_flag(&help, name)), "{help}");
}

#[test]
fn the_two_commands_come_first_and_stand_in_the_gate() {
    let readme = read("README.md");
    let blocks = blocks(&readme);
    let first = blocks.iter().find(|block| block.kind == "sh").expect("the commands");
    let commands: Vec<&str> =
        first.lines.iter().filter_map(|line| Some(line.split('#').next()?.trim())).collect();
    assert_eq!(commands, ["cargo run", "cargo test"]);
    let gate = read(".ci/run");
    let has = |words: &str| gate.lines().any(|line| line.starts_with("step ") && line.contains(words));
    // The gate may call the program of `cargo run` directly, because it has already built the program.
    assert!(has("cargo run") || has("/imrs\" verify"), "the gate does not check the claims");
    assert!(has("cargo test"), "the gate does not run the tests");
}

#[test]
fn the_cell_of_the_demonstration_and_the_pictures_is_sound() {
    let cell = format!("{ROOT}/src/demo/assembly.cell");
    for said in [run(&["check", &cell]), run(&["fmt", "--check", &cell])] {
        assert_eq!(said.code, Some(0), "{said:?}");
        assert!(!said.out.contains("warn["), "{said:?}");
    }
}

#[test]
fn libraries_are_named_where_they_do_their_work() {
    let manifest = read("Cargo.toml");
    let (_, known) = manifest.split_once("[workspace.dependencies]").expect("the libraries");
    let known: Vec<&str> = known.lines().filter_map(|line| Some(line.split_once(" = ")?.0)).collect();
    let readme = read("README.md");
    let (_, map) = readme.split_once("## The map").expect("the map");
    let mut named: Vec<&str> = Vec::new();
    for row in map.lines().filter(|line| line.starts_with("| [")) {
        let room = links(row)[0];
        let room = if room == "src" { "." } else { room };
        let column =
            row.rsplit('|').nth(1).expect("a column").split(|c: char| !c.is_alphanumeric() && c != '-');
        for library in column.filter(|word| known.contains(word)) {
            let manifest = read(&format!("{room}/Cargo.toml"));
            assert!(
                manifest.contains(&format!("\n{library} = {{ workspace")),
                "{room} does not use {library}"
            );
            named.push(library);
        }
    }
    let architecture = read("ARCHITECTURE.md");
    for library in ["stateright", "ratatui", "crossterm", "serde", "loom"] {
        assert!(named.contains(&library), "README.md does not name {library}");
        assert!(architecture.contains(library), "ARCHITECTURE.md does not name {library}");
    }
}
