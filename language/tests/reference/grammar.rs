//! Checks that the parser accepts every text that the grammar in the reference produces.

use super::{pages, read};
use imrs_language::{Source, parse, render};
use proptest::prelude::*;
use std::collections::BTreeMap;

/// A part of a rule of the grammar.
#[derive(Clone, Debug)]
enum Part {
    /// A literal text.
    Sign(String),
    /// Another rule, or a token.
    Rule(String),
    /// A sequence: `a b`.
    All(Vec<Part>),
    /// Alternatives: `a | b`.
    One(Vec<Part>),
    /// An optional part: `[a]`.
    Maybe(Box<Part>),
    /// A part that may be repeated: `{a}`.
    Many(Box<Part>),
}

type Rules = BTreeMap<String, Part>;

/// The rules in the blocks fenced as `ebnf`.
fn rules() -> Rules {
    let page = pages().into_iter().find(|path| path.ends_with("grammar.md")).expect("the grammar");
    let text = read(&page);
    let blocks = text.split("```ebnf\n").skip(1).filter_map(|rest| rest.split("```").next());
    let tokens: Vec<String> = blocks.flat_map(tokens).collect();
    let mut rules = Rules::new();
    let mut at = 0;
    while at < tokens.len() {
        let name = tokens[at].clone();
        assert_eq!(tokens[at + 1], "=", "behind {name}");
        at += 2;
        let part = choice(&tokens, &mut at);
        assert_eq!(tokens[at], ";", "at the end of {name}");
        at += 1;
        assert!(rules.insert(name.clone(), part).is_none(), "{name} twice");
    }
    rules
}

fn tokens(text: &str) -> Vec<String> {
    let mut tokens = Vec::new();
    let mut rest = text.trim_start();
    while let Some(first) = rest.chars().next() {
        let end = match first {
            '"' => rest[1..].find('"').expect("a closing quote") + 2,
            c if c.is_alphanumeric() => {
                rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len())
            }
            _ => 1,
        };
        tokens.push(rest[..end].to_owned());
        rest = rest[end..].trim_start();
    }
    tokens
}

fn choice(tokens: &[String], at: &mut usize) -> Part {
    let mut parts = vec![sequence(tokens, at)];
    while tokens[*at] == "|" {
        *at += 1;
        parts.push(sequence(tokens, at));
    }
    if parts.len() == 1 { parts.remove(0) } else { Part::One(parts) }
}

fn sequence(tokens: &[String], at: &mut usize) -> Part {
    let mut parts = Vec::new();
    loop {
        let token = tokens[*at].as_str();
        let close = match token {
            "[" => "]",
            "{" => "}",
            "(" => ")",
            "|" | "]" | "}" | ")" | ";" => return Part::All(parts),
            _ => {
                let sign = token.strip_prefix('"').and_then(|token| token.strip_suffix('"'));
                parts.push(sign.map_or_else(|| Part::Rule(token.into()), |sign| Part::Sign(sign.into())));
                *at += 1;
                continue;
            }
        };
        *at += 1;
        let inner = choice(tokens, at);
        assert_eq!(tokens[*at], close);
        *at += 1;
        parts.push(match close {
            "]" => Part::Maybe(inner.into()),
            "}" => Part::Many(inner.into()),
            _ => inner,
        });
    }
}

/// Makes a random text from the rules of the grammar.
struct Making<'a> {
    rules: &'a Rules,
    choices: std::slice::Iter<'a, u8>,
    depth: usize,
    /// How many expressions enclose the current part.
    exprs: usize,
}

impl Making<'_> {
    /// Chooses a number below `of`. Once the random choices have run out, the number is always that of the first
    /// alternative, so that every text ends. The length of expressions is limited (E012), so the generator keeps them
    /// small, and choices are left for other parts.
    fn choose(&mut self, of: usize) -> usize {
        if self.depth > 40 || self.exprs > 1 {
            return 0;
        }
        self.choices.next().map_or(0, |&choice| usize::from(choice)) % of
    }

    fn make(&mut self, part: &Part, out: &mut Vec<String>) {
        match part {
            Part::Sign(sign) => out.push(sign.clone()),
            Part::All(parts) => parts.iter().for_each(|part| self.make(part, out)),
            Part::One(parts) => {
                let chosen = self.choose(parts.len());
                self.make(&parts[chosen], out);
            }
            Part::Maybe(part) => {
                if self.choose(2) == 1 {
                    self.make(part, out);
                }
            }
            Part::Many(part) => {
                for _ in 0..self.choose(if self.exprs > 0 { 2 } else { 3 }) {
                    self.make(part, out);
                }
            }
            Part::Rule(name) => self.rule(name, out),
        }
    }

    fn rule(&mut self, name: &str, out: &mut Vec<String>) {
        let pick = |making: &mut Self, of: &[&str]| of[making.choose(of.len())].to_owned();
        let token = match name {
            // All names are the same, because the name behind a task's `end` must be that of the task.
            "name" => "a".to_owned(),
            "number" => pick(self, &["1", "20", "1_000"]),
            "text" => "\"x\"".to_owned(),
            _ => {
                let is_expr = usize::from(name == "expr");
                self.depth += 1;
                self.exprs += is_expr;
                let rule = self.rules.get(name).unwrap_or_else(|| panic!("no rule `{name}`"));
                self.make(rule, out);
                self.depth -= 1;
                self.exprs -= is_expr;
                return;
            }
        };
        out.push(token);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn what_the_grammar_produces_is_read(choices in proptest::collection::vec(any::<u8>(), 20..400)) {
        let rules = rules();
        let mut making = Making { rules: &rules, choices: choices.iter(), depth: 0, exprs: 0 };
        let mut out = Vec::new();
        making.rule("file", &mut out);
        let text = out.join(" ");
        let source = Source::new(text.as_bytes()).expect("a text");
        let parsed = parse(&source);
        let shown = render::text(&parsed.diagnostics, "made.cell", Some(&source), render::Style::Plain);
        prop_assert!(parsed.diagnostics.is_empty(), "{shown}");
    }

    /// Makes texts that consist of statements only, which are rare in the test above.
    #[test]
    fn statements_of_the_grammar_are_read(choices in proptest::collection::vec(any::<u8>(), 20..400)) {
        let rules = rules();
        let mut making = Making { rules: &rules, choices: choices.iter(), depth: 0, exprs: 0 };
        let mut out = Vec::new();
        for _ in 0..8 {
            making.rule("statement", &mut out);
        }
        let text = format!("cell c; task t on n begin {} end t;", out.join(" "));
        let source = Source::new(text.as_bytes()).expect("a text");
        let parsed = parse(&source);
        let shown = render::text(&parsed.diagnostics, "made.cell", Some(&source), render::Style::Plain);
        prop_assert!(parsed.diagnostics.is_empty(), "{shown}");
    }
}
