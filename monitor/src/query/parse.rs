//! The parser of the monitor's conditions.

use super::amount::{Aggregate, Amount};
use super::fields::{self, FIELDS, Field, Kind};
use super::{Condition, Operator, Value};
use std::borrow::Cow;
use thiserror::Error;

/// The error that a text is not a valid condition.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("at column {column}: {what}")]
pub struct QueryError {
    /// The column of the error, in characters from 1.
    pub column: usize,
    /// What is wrong, and what is expected instead.
    pub what: String,
}

/// The deepest nesting of conditions.
const DEEPEST: usize = 32;

#[derive(Clone, Debug, PartialEq)]
enum Token {
    Word(String),
    Quoted(String),
    Operator(Operator),
    Open,
    Close,
}

/// A type of operands: what may stand on the left side of a comparison.
pub(super) trait Operand: Sized {
    /// Parses the operand that begins with `word`. Returns it with its type.
    fn read(parser: &mut Parser, word: &str, column: usize) -> Result<(Self, Kind), QueryError>;
    /// Whether a condition may consist of words without an operator.
    const WORDS: bool;
}

impl Operand for Field {
    const WORDS: bool = true;

    fn read(_: &mut Parser, word: &str, column: usize) -> Result<(Self, Kind), QueryError> {
        let info = fields::find(word).ok_or_else(|| unknown(word, column))?;
        Ok((info.field, info.kind))
    }
}

impl Operand for Amount {
    const WORDS: bool = false;

    /// An operand of an assertion: `expired` (the sum of all ports), `min_slack`, `count(class=2 and fill>80%)`, `max(len)`.
    fn read(parser: &mut Parser, word: &str, column: usize) -> Result<(Self, Kind), QueryError> {
        if let Some(amount) = Self::named(word) {
            return Ok((amount, Kind::Number));
        }
        if word == "count" && parser.take(&Token::Open) {
            let condition = parser.condition::<Field>(1)?;
            parser.expect_close()?;
            return Ok((Self::Count(condition), Kind::Number));
        }
        if let Some(aggregate) = Aggregate::named(word)
            && parser.take(&Token::Open)
        {
            let (column, name) = parser.word()?;
            let info = fields::find(&name).ok_or_else(|| unknown(&name, column))?;
            parser.expect_close()?;
            return number_or_time(Self::Over(aggregate, info.field), info.kind, &name, column);
        }
        for aggregate in Aggregate::ALL {
            let Some(name) = word.strip_prefix(aggregate.word()).and_then(|rest| rest.strip_prefix('_'))
            else {
                continue;
            };
            let info = fields::find(name).ok_or_else(|| unknown(word, column))?;
            return number_or_time(Self::Over(aggregate, info.field), info.kind, name, column);
        }
        let info = fields::find(word).ok_or_else(|| unknown(word, column))?;
        number_or_time(Self::Over(Aggregate::Sum, info.field), info.kind, word, column)
    }
}

fn number_or_time(
    amount: Amount,
    kind: Kind,
    name: &str,
    column: usize,
) -> Result<(Amount, Kind), QueryError> {
    if kind == Kind::Text {
        let what = format!("`{name}` is a text of each row: write count({name}=...)");
        return Err(QueryError { column, what });
    }
    Ok((amount, kind))
}

/// Parses a condition on rows.
pub(super) fn filter(text: &str) -> Result<Condition<Field>, QueryError> {
    whole(text)
}

/// Parses a condition on a cell.
pub(super) fn assertion(text: &str) -> Result<Condition<Amount>, QueryError> {
    whole(text)
}

fn whole<T: Operand>(text: &str) -> Result<Condition<T>, QueryError> {
    let mut parser = Parser { tokens: tokens(text)?, at: 0, end: text.chars().count() + 1 };
    let condition = parser.condition(0)?;
    match parser.peek() {
        None => Ok(condition),
        Some(_) => Err(parser.error("`and`, `or` or the end was expected here")),
    }
}

pub(super) struct Parser {
    /// The tokens of the text, each with the column at which it starts.
    tokens: Vec<(usize, Token)>,
    at: usize,
    end: usize,
}

impl Parser {
    fn peek(&self) -> Option<&Token> {
        self.tokens.get(self.at).map(|(_, token)| token)
    }

    fn column(&self) -> usize {
        self.tokens.get(self.at).map_or(self.end, |(column, _)| *column)
    }

    fn error(&self, what: impl Into<String>) -> QueryError {
        QueryError { column: self.column(), what: what.into() }
    }

    fn take(&mut self, token: &Token) -> bool {
        let there = self.peek() == Some(token);
        self.at += usize::from(there);
        there
    }

    fn take_word(&mut self, word: &str) -> bool {
        let there = matches!(self.peek(), Some(Token::Word(found)) if found.eq_ignore_ascii_case(word));
        self.at += usize::from(there);
        there
    }

    fn word(&mut self) -> Result<(usize, String), QueryError> {
        let column = self.column();
        match self.peek() {
            Some(Token::Word(word)) => {
                let word = word.to_lowercase();
                self.at += 1;
                Ok((column, word))
            }
            _ => Err(self.error("the name of a field was expected here")),
        }
    }

    fn expect_close(&mut self) -> Result<(), QueryError> {
        if self.take(&Token::Close) { Ok(()) } else { Err(self.error("`)` is missing here")) }
    }

    fn condition<T: Operand>(&mut self, depth: usize) -> Result<Condition<T>, QueryError> {
        let mut all = vec![self.conjunction(depth)?];
        while self.take_word("or") {
            all.push(self.conjunction(depth)?);
        }
        Ok(if all.len() == 1 { all.remove(0) } else { Condition::Or(all) })
    }

    fn conjunction<T: Operand>(&mut self, depth: usize) -> Result<Condition<T>, QueryError> {
        let mut all = vec![self.unary(depth)?];
        while self.take_word("and") {
            all.push(self.unary(depth)?);
        }
        Ok(if all.len() == 1 { all.remove(0) } else { Condition::And(all) })
    }

    fn unary<T: Operand>(&mut self, depth: usize) -> Result<Condition<T>, QueryError> {
        if depth > DEEPEST {
            return Err(self.error("nested too deeply"));
        }
        if self.take_word("not") {
            return Ok(Condition::Not(Box::new(self.unary(depth + 1)?)));
        }
        if self.take(&Token::Open) {
            let inner = self.condition(depth + 1)?;
            self.expect_close()?;
            return Ok(inner);
        }
        let compares = matches!(
            (self.tokens.get(self.at), self.tokens.get(self.at + 1)),
            (Some((_, Token::Word(_))), Some((_, Token::Operator(_) | Token::Open)))
        );
        if T::WORDS && !compares {
            return self.words();
        }
        let (column, word) = self.word()?;
        let (left, kind) = T::read(self, &word, column)?;
        let Some(Token::Operator(operator)) = self.peek().cloned() else {
            return Err(self.error(format!("a comparison was expected here, as in `{word} < 3`")));
        };
        self.at += 1;
        if let Some(right) = self.quantity(kind) {
            return Ok(Condition::Against(left, operator, right));
        }
        let right = self.literal(kind, &word, operator)?;
        Ok(Condition::Compare(left, operator, right))
    }

    /// Parses a quantity on the right side of a comparison with a number: `up==nodes`. For anything else returns
    /// `None`, so that [`Self::literal`] parses it.
    fn quantity<T: Operand>(&mut self, kind: Kind) -> Option<T> {
        if T::WORDS || kind != Kind::Number {
            return None;
        }
        let before = self.at;
        let read = self.word().and_then(|(column, word)| T::read(self, &word, column));
        let right = read.ok().filter(|(_, right)| *right == kind).map(|(right, _)| right);
        if right.is_none() {
            self.at = before;
        }
        right
    }

    /// Parses a sequence of words, to be found in a name.
    fn words<T>(&mut self) -> Result<Condition<T>, QueryError> {
        let mut words: Vec<String> = Vec::new();
        loop {
            let connects = ["and", "or", "not"];
            match self.peek() {
                Some(Token::Word(word)) if !connects.contains(&word.to_lowercase().as_str()) => {
                    words.push(word.to_lowercase());
                }
                Some(Token::Quoted(text)) => words.push(text.to_lowercase()),
                _ if words.is_empty() => return Err(self.error("a condition was expected here")),
                _ => return Ok(Condition::Words(words.join(" "))),
            }
            self.at += 1;
        }
    }

    fn literal(&mut self, kind: Kind, name: &str, operator: Operator) -> Result<Value<'static>, QueryError> {
        let column = self.column();
        if operator == Operator::Contains && kind != Kind::Text {
            return Err(QueryError { column, what: format!("`~` looks into texts, and `{name}` is none") });
        }
        let (quoted, text) = match self.peek() {
            Some(Token::Word(word)) => (false, word.clone()),
            Some(Token::Quoted(text)) => (true, text.clone()),
            _ => return Err(self.error(format!("what `{name}` is compared with was expected here"))),
        };
        self.at += 1;
        let wrong = |example: &str| QueryError {
            column,
            what: format!("`{text}` cannot be compared with `{name}`: write {example}"),
        };
        match kind {
            Kind::Text => Ok(Value::Text(Cow::Owned(text))),
            Kind::Number if !quoted => {
                let digits = text.strip_suffix('%').unwrap_or(&text);
                digits.parse().map(Value::Number).map_err(|_| wrong("a number, as 3 or 80%"))
            }
            Kind::Time if !quoted => {
                time(&text).map(Value::Time).ok_or_else(|| wrong("a time, as 20ms, 5us or 1.5s"))
            }
            Kind::Number => Err(wrong("a number, as 3 or 80%")),
            Kind::Time => Err(wrong("a time, as 20ms, 5us or 1.5s")),
        }
    }
}

/// Parses a length of time. The result is in microseconds.
fn time(text: &str) -> Option<f64> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit = match &text[digits.len()..] {
        "us" => 1.0,
        "ms" => 1e3,
        "s" => 1e6,
        "min" => 6e7,
        "" if digits == "0" => 1.0,
        _ => return None,
    };
    digits.parse::<f64>().ok().map(|number| number * unit)
}

fn unknown(word: &str, column: usize) -> QueryError {
    let near = FIELDS
        .iter()
        .map(|info| info.name)
        .filter(|name| strsim::osa_distance(word, name) <= 1)
        .min_by_key(|name| name.len());
    let what = match near {
        Some(near) => format!("no field `{word}`: did you mean `{near}`?"),
        None => {
            let names: Vec<_> = FIELDS.iter().map(|info| info.name).collect();
            format!("no field `{word}`: there are {}", names.join(", "))
        }
    };
    QueryError { column, what }
}

fn tokens(text: &str) -> Result<Vec<(usize, Token)>, QueryError> {
    let chars: Vec<char> = text.chars().collect();
    let mut found = Vec::new();
    let mut at = 0;
    while let Some(&c) = chars.get(at) {
        let column = at + 1;
        let next = chars.get(at + 1).copied();
        let (token, length) = match (c, next) {
            (c, _) if c.is_whitespace() => {
                at += 1;
                continue;
            }
            ('(', _) => (Token::Open, 1),
            (')', _) => (Token::Close, 1),
            ('=', Some('=')) => (Token::Operator(Operator::Equal), 2),
            ('=', _) => (Token::Operator(Operator::Equal), 1),
            ('!', Some('=')) => (Token::Operator(Operator::Unequal), 2),
            ('<', Some('=')) => (Token::Operator(Operator::LessOrEqual), 2),
            ('<', _) => (Token::Operator(Operator::Less), 1),
            ('>', Some('=')) => (Token::Operator(Operator::GreaterOrEqual), 2),
            ('>', _) => (Token::Operator(Operator::Greater), 1),
            ('~', _) => (Token::Operator(Operator::Contains), 1),
            ('&', Some('&')) => (Token::Word("and".to_owned()), 2),
            ('|', Some('|')) => (Token::Word("or".to_owned()), 2),
            ('!', _) => (Token::Word("not".to_owned()), 1),
            ('"' | '\'', _) => {
                let inner: String = chars[at + 1..].iter().take_while(|end| **end != c).collect();
                let length = inner.chars().count() + 2;
                if at + length > chars.len() {
                    return Err(QueryError {
                        column,
                        what: "a text that begins here is not closed".to_owned(),
                    });
                }
                (Token::Quoted(inner), length)
            }
            _ => {
                let is_of_word = |c: &&char| !c.is_whitespace() && !"()=!<>~&|\"'".contains(**c);
                let word: String = chars[at..].iter().take_while(is_of_word).collect();
                if word.is_empty() {
                    return Err(QueryError { column, what: format!("`{c}` means nothing here") });
                }
                let length = word.chars().count();
                (Token::Word(word), length)
            }
        };
        found.push((column, token));
        at += length;
    }
    Ok(found)
}
