//! Checks that the documents in `specs/` agree with the source tree: everything that a document names exists, and each
//! document contains what it must.

use crate::support::claims::settled;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

fn read(path: impl AsRef<Path>) -> String {
    let path = Path::new(ROOT).join(path);
    fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// The documents' paths, relative to the root of the repository.
fn documents() -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> =
        ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "SECURITY.md"].map(PathBuf::from).into();
    for folder in ["specs", "specs/decisions", "specs/protocol", "specs/language"] {
        for entry in fs::read_dir(Path::new(ROOT).join(folder)).expect("a folder").flatten() {
            if entry.path().extension().is_some_and(|extension| extension == "md") {
                found.push(Path::new(folder).join(entry.file_name()));
            }
        }
    }
    assert!(found.len() > 12, "the documents were not found: {found:?}");
    found
}

/// Whether `text` contains `word` as a whole word: without a letter, digit or underscore directly before or after it.
fn has_word(text: &str, word: &str) -> bool {
    let joins = |c: char| c.is_alphanumeric() || c == '_';
    text.match_indices(word)
        .any(|(at, _)| !text[..at].ends_with(joins) && !text[at + word.len()..].starts_with(joins))
}

/// The texts between backquotes. Text in code blocks is left out.
fn quoted(text: &str) -> Vec<&str> {
    let mut in_block = false;
    let mut found = Vec::new();
    for line in text.lines() {
        if line.starts_with("```") {
            in_block = !in_block;
        } else if !in_block {
            found.extend(line.split('`').skip(1).step_by(2));
        }
    }
    found
}

/// The numbers of the rules or decisions that a text names. For the letter `D` such a name is `D54`. A number may have
/// a suffix, such as `b` in `R64b`.
fn numbers(text: &str, letter: char) -> Vec<String> {
    let words = text.split(|c: char| !c.is_alphanumeric());
    let digits =
        |word: &str| word.strip_prefix(letter).is_some_and(|n| n.starts_with(|c: char| c.is_ascii_digit()));
    words.filter(|word| digits(word)).map(str::to_owned).collect()
}

#[test]
fn every_file_and_name_of_the_trace_exists() {
    let text = read("specs/paper-trace.md");
    let mut entries = 0;
    let mut missing = Vec::new();
    for entry in quoted(&text) {
        let Some((path, item)) = entry.split_once("::").filter(|(path, _)| path.contains('/')) else {
            continue;
        };
        let source = fs::read_to_string(Path::new(ROOT).join(path)).unwrap_or_default();
        let is_page = path.ends_with(".md");
        if is_page && scenario(&source, item).is_none() || !is_page && !has_word(&source, item) {
            missing.push(entry);
        }
        entries += 1;
    }
    assert!(missing.is_empty(), "named in the trace, but not in the tree: {missing:#?}");
    assert!(entries > 100, "only {entries} entries were found");
}

/// The section of a page of `specs/protocol` under this heading, without its rules and backquotes. `None` if the
/// section has no executable block.
fn scenario<'a>(page: &'a str, heading: &str) -> Option<&'a str> {
    let mut parts = page.split("\n## ").skip(1);
    let part = parts.find(|part| {
        let line = part.lines().next().unwrap_or("").replace('`', "");
        line.rsplit_once(" (").is_some_and(|(words, _)| words == heading)
    })?;
    (part.contains("```transcript\n") || part.contains("```wrong\n")).then_some(part)
}

/// A heading of an executable page, and the names of the rules under it.
type Heading = (String, Vec<String>);

/// The executable pages. For each page: its path, its text, and its headings.
fn scenarios() -> Vec<(PathBuf, String, Vec<Heading>)> {
    let pages = documents().into_iter().filter(|path| path.starts_with("specs/protocol"));
    let read_page = |path: PathBuf| {
        let page = read(&path);
        let headings = page.lines().filter_map(|line| line.strip_prefix("## ")).map(|heading| {
            let heading = heading.replace('`', "");
            let at = format!("{}: {heading}", path.display());
            let (words, named) = heading.rsplit_once(" (").unwrap_or_else(|| panic!("{at} names no rule"));
            let named = named.strip_suffix(')').unwrap_or_else(|| panic!("{at} does not end with its rules"));
            (words.to_owned(), named.split(", ").map(str::to_owned).collect())
        });
        let headings = headings.collect();
        (path, page, headings)
    };
    let mut pages: Vec<_> = pages.map(read_page).collect();
    pages.sort();
    pages
}

#[test]
fn every_scenario_names_rules_that_exist() {
    let rules = read("specs/rules.md");
    let decisions = decisions();
    for (path, page, headings) in scenarios() {
        for (words, named) in headings {
            let at = format!("{}: {words}", path.display());
            for rule in named {
                let written = match rule.split_at(1) {
                    ("D", number) => number.parse().is_ok_and(|number| decisions.contains_key(&number)),
                    _ => rules.contains(&format!("| {rule} |")),
                };
                assert!(written, "{at}: {rule} is written down nowhere");
            }
            assert!(scenario(&page, &words).is_some(), "{at} shows nothing");
        }
    }
}

/// The last part of the trace lists, for each rule, the scenarios that name it. `IMRS_BLESS=1` writes that part of the file.
#[test]
fn the_trace_leads_from_each_rule_to_its_scenarios() {
    let mut by_rule: BTreeMap<(bool, u32, String), Vec<String>> = BTreeMap::new();
    for (path, _, headings) in scenarios() {
        for (words, named) in headings {
            for rule in named {
                let digits: String = rule[1..].chars().take_while(char::is_ascii_digit).collect();
                let key = (rule.starts_with('D'), digits.parse().expect("a number"), rule);
                by_rule.entry(key).or_default().push(format!("`{}::{words}`", path.display()));
            }
        }
    }
    let rows = by_rule.iter().map(|((_, _, rule), shown)| format!("| {rule} | {} |\n", shown.join("<br>")));
    let table = format!("| rule | scenarios |\n|---|---|\n{}", rows.collect::<String>());
    let trace = read("specs/paper-trace.md");
    let (before, found) = trace.split_once("\n## Scenarios\n\n").expect("the last part");
    if std::env::var_os("IMRS_BLESS").is_some() {
        let whole = format!("{before}\n## Scenarios\n\n{table}");
        fs::write(Path::new(ROOT).join("specs/paper-trace.md"), whole).expect("a page that can be written");
    }
    assert!(found == table, "the scenarios of specs/paper-trace.md are others than those of specs/protocol");
}

/// Asserts that a file has a test of this name; `entry` is both, as documents name it.
fn is_test(entry: &str) {
    let (path, item) = entry.split_once("::").expect("a file and a name");
    let source = read(path);
    let at = source.find(&format!("fn {item}(")).unwrap_or_else(|| panic!("{entry} is no function"));
    let before = source[..at].trim_end();
    let mut attributes = before.lines().rev().map(str::trim).take_while(|line| line.starts_with(['#', '/']));
    assert!(attributes.any(|line| line == "#[test]"), "{entry} is no test");
}

#[test]
fn tests_of_the_trace_are_tests() {
    let text = read("specs/paper-trace.md");
    let carried_out = text.split("## In part").next().expect("a first part");
    for row in carried_out.lines().filter(|line| line.starts_with("| ") && line.contains("::")) {
        let column = row.split('|').nth(3).expect("four columns");
        for entry in quoted(column) {
            let (path, item) = entry.split_once("::").expect("a file and a name");
            if path.ends_with(".md") {
                assert!(scenario(&read(path), item).is_some(), "{entry} is carried out by nothing");
            } else {
                is_test(entry);
            }
        }
    }
}

#[test]
fn tests_of_the_faults_are_tests() {
    let text = read("specs/faults.md");
    let entries: Vec<&str> = quoted(&text).into_iter().filter(|entry| entry.contains(".rs::")).collect();
    assert!(entries.len() > 30, "only {} tests were found", entries.len());
    entries.into_iter().for_each(is_test);
}

#[test]
fn every_rule_of_the_paper_is_traced() {
    let traced = numbers(&read("specs/paper-trace.md"), 'R');
    let table = read("specs/rules.md");
    let rules = table.lines().filter_map(|line| line.strip_prefix("| R")?.split(' ').next());
    let rules: Vec<String> = rules.map(|number| format!("R{number}")).collect();
    for number in 1..=99 {
        let times = rules.iter().filter(|rule| **rule == format!("R{number}")).count();
        assert_eq!(times, 1, "R{number} in specs/rules.md");
    }
    for rule in &rules {
        assert!(traced.contains(rule), "{rule} is not in specs/paper-trace.md");
    }
}

/// For each decision number, how many entries the decision has: list items and headings of records together.
fn decisions() -> BTreeMap<u32, usize> {
    let mut found = BTreeMap::new();
    for path in documents().iter().filter(|path| path.starts_with("specs/decisions")) {
        let file = path.file_name().and_then(|name| name.to_str()).expect("a name");
        for line in read(path).lines() {
            let start = line
                .strip_prefix("- **D")
                .or_else(|| line.strip_prefix("# D").filter(|_| file.starts_with('D')));
            let Some(start) = start else { continue };
            let digits: String = start.chars().take_while(char::is_ascii_digit).collect();
            assert!(
                !file.starts_with('D') || file.starts_with(&format!("D{digits}-")),
                "{file} begins with D{digits}"
            );
            *found.entry(digits.parse().expect("a number")).or_default() += 1;
        }
    }
    found
}

#[test]
fn every_decision_is_written_down_once() {
    let decisions = decisions();
    let last = *decisions.keys().next_back().expect("decisions");
    assert!(last >= 73);
    for number in 1..=last {
        assert_eq!(decisions.get(&number), Some(&1), "D{number} in specs/decisions");
    }
}

#[test]
fn the_index_has_every_decision_once_and_says_which_are_superseded() {
    let last = *decisions().keys().next_back().expect("decisions");
    let index = read("specs/decisions/README.md");
    let mut entries = BTreeMap::<u32, usize>::new();
    for entry in index.split("\n\n").flat_map(|list| list.split("- [D").skip(1)) {
        let (number, link) = entry.split_once("](").expect("a link");
        *entries.entry(number.parse().expect("a number")).or_default() += 1;
        if let Some((file, line)) = link.split_once(')').filter(|(file, _)| file.starts_with('D')) {
            let record = read(format!("specs/decisions/{file}"));
            let says = ["\n*Superseded", "\n*Partly superseded"].iter().any(|words| record.contains(words));
            assert_eq!(line.contains("uperseded by"), says, "D{number} is superseded: index, record");
        }
    }
    let expected: BTreeMap<u32, usize> = (1..=last).map(|number| (number, 1)).collect();
    assert_eq!(entries, expected, "the entries of specs/decisions/README.md, by number: how often");
}

#[test]
fn decisions_that_code_and_documents_cite_are_written_down() {
    let written = decisions();
    let mut folders: Vec<PathBuf> =
        ["src", "protocol", "wire", "model", "runtime", "client", "launch", "monitor", "tests", "examples"]
            .map(|folder| Path::new(ROOT).join(folder))
            .into();
    let mut files: Vec<PathBuf> = documents().iter().map(|path| Path::new(ROOT).join(path)).collect();
    while let Some(folder) = folders.pop() {
        for path in fs::read_dir(&folder).expect("a folder").flatten().map(|entry| entry.path()) {
            if path.is_dir() && path.file_name().is_some_and(|name| name != "target") {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                files.push(path);
            }
        }
    }
    for path in files {
        // In Rust files only comments are searched, because `D1` may also be an identifier.
        let text = read(&path);
        let is_code = path.extension().is_some_and(|extension| extension == "rs");
        for line in text.lines() {
            let cites = if is_code { line.split_once("//").map_or("", |(_, comment)| comment) } else { line };
            for cited in numbers(cites, 'D') {
                let number = cited[1..].parse().unwrap_or(0);
                assert!(written.contains_key(&number), "{}: {cited} is written down nowhere", path.display());
            }
        }
    }
}

#[test]
fn the_page_of_claims_has_every_claim_and_no_other() {
    let text = read("specs/claims.md");
    let described: Vec<&str> =
        text.lines().filter_map(|line| line.strip_prefix("## `")?.strip_suffix('`')).collect();
    assert_eq!(described, imrs_model::claim_names());
    let trace = read("specs/paper-trace.md");
    let claims = imrs_model::claim_names();
    for row in trace.lines().filter(|line| line.starts_with("| ") && line.contains("::")) {
        let claim = row.split('|').nth(4).map_or("", str::trim);
        assert!(claim.is_empty() || claims.contains(&claim), "the trace names the claim `{claim}`");
    }
}

/// The page must show the checker's present results. Only claims that are checked quickly are compared.
/// `specs/claims.py` renews the page.
#[test]
fn the_page_of_claims_has_the_numbers_and_charts_of_the_checker() {
    let text = read("specs/claims.md");
    let grouped = |n: u64| {
        let digits = n.to_string();
        let groups =
            digits.as_bytes().rchunks(3).rev().map(|group| String::from_utf8_lossy(group).into_owned());
        groups.collect::<Vec<_>>().join(",")
    };
    for name in ["pairing", "no-stale-delivery", "class-2-resolves", "at-most-once", "no-global-clock"] {
        let section = text.split(&format!("## `{name}`")).nth(1).expect("a section");
        let section = section.split("\n## ").next().expect("an end");
        let report = settled(name);
        let rows = section.lines().filter(|line| line.starts_with("| ")).count();
        assert_eq!(rows, report.claims.len() + 2, "the rows of `{name}`");
        for verdict in &report.claims {
            let outcome = format!("{:?}", verdict.outcome).to_lowercase();
            let begin = format!("| {} | {} | {outcome} |", verdict.rule, verdict.parties);
            let end = format!(
                "| {} | {} | {} |",
                grouped(verdict.states),
                grouped(verdict.transitions),
                verdict.depth
            );
            let is_there = section.lines().any(|line| line.starts_with(&begin) && line.ends_with(&end));
            assert!(is_there, "`{name}` has no row `{begin} ... {end}`");
        }
        for chart in section.split("```text\n").skip(1) {
            let chart = chart.split("\n```").next().expect("an end");
            let mut drawn = report.claims.iter().filter_map(|verdict| verdict.counterexample.as_ref());
            assert!(
                drawn.any(|found| found.chart.trim_end() == chart),
                "no longer a counterexample:\n{chart}"
            );
        }
    }
}

#[test]
fn links_between_documents_lead_somewhere() {
    for path in documents() {
        let text = read(&path);
        let folder = path.parent().expect("a folder");
        for (at, _) in text.match_indices("](") {
            let target = text[at + 2..].split(')').next().unwrap_or("");
            let target = target.split('#').next().unwrap_or("");
            if target.is_empty() || target.contains("://") {
                continue;
            }
            let full = Path::new(ROOT).join(folder).join(target);
            assert!(full.exists(), "{} links to {target}, which does not exist", path.display());
        }
    }
}

#[test]
fn files_that_documents_name_exist() {
    let folders = [
        "src/",
        "protocol/",
        "wire/",
        "model/",
        "runtime/",
        "client/",
        "launch/",
        "monitor/",
        "tests/",
        "specs/",
        "examples/",
    ];
    for path in documents() {
        let text = read(&path);
        for name in quoted(&text) {
            let file = name.split("::").next().unwrap_or(name);
            let is_path = folders.iter().any(|folder| file.starts_with(folder))
                && [".rs", ".md"].iter().any(|end| file.ends_with(end));
            assert!(!is_path || Path::new(ROOT).join(file).exists(), "{} names `{file}`", path.display());
        }
    }
}

#[test]
fn every_library_has_its_reason() {
    let text = read("Cargo.toml");
    let section = text.split("[workspace.dependencies]").nth(1).and_then(|rest| rest.split("\n[").next());
    let names = section.expect("dependencies").lines().filter_map(|line| line.split_once(" = "));
    let table = read("specs/decisions/D70-libraries.md");
    let reasons: Vec<&str> =
        table.lines().filter_map(|line| line.strip_prefix("| ")?.split('|').next()).collect();
    for (name, _) in names.filter(|(name, _)| !name.starts_with("imrs-")) {
        let listed = reasons.iter().flat_map(|cell| cell.split(", ")).any(|listed| listed.trim() == name);
        assert!(listed, "`{name}` has no row in specs/decisions/D70-libraries.md");
    }
}
