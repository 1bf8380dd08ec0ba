//! Splits a line of a page into words.

/// A word, a quoted text, or one of the characters `:` and `,`.
#[derive(Clone, Debug, PartialEq)]
enum Token {
    Word(String),
    Text(Vec<u8>),
}

/// The tokens of one line, consumed from left to right.
pub struct Tokens {
    tokens: Vec<Token>,
    at: usize,
}

impl Tokens {
    /// Splits `line` into tokens. The text after a `#` is a remark, and is left out.
    pub fn new(line: &str) -> Result<Self, String> {
        let mut tokens = Vec::new();
        let mut rest = line.trim_start();
        while let Some(first) = rest.chars().next() {
            match first {
                '#' => break,
                '"' => {
                    let (text, after) = quoted(&rest[1..])?;
                    tokens.push(Token::Text(text));
                    rest = after;
                }
                ':' | ',' => {
                    tokens.push(Token::Word(first.into()));
                    rest = &rest[1..];
                }
                _ => {
                    let ends = |c: char| c.is_whitespace() || ":,\"#".contains(c);
                    let (word, after) = rest.split_at(rest.find(ends).unwrap_or(rest.len()));
                    tokens.push(Token::Word(word.into()));
                    rest = after;
                }
            }
            rest = rest.trim_start();
        }
        Ok(Self { tokens, at: 0 })
    }

    pub fn is_over(&self) -> bool {
        self.at == self.tokens.len()
    }

    /// Consumes the next word if it equals `wanted`.
    pub fn eat(&mut self, wanted: &str) -> bool {
        let found = matches!(self.tokens.get(self.at), Some(Token::Word(word)) if word == wanted);
        self.at += usize::from(found);
        found
    }

    /// Consumes the next word, and fails if it does not equal `wanted`.
    pub fn must(&mut self, wanted: &str) -> Result<(), String> {
        if self.eat(wanted) { Ok(()) } else { Err(format!("expected `{wanted}`, found {}", self.found())) }
    }

    pub fn word(&mut self) -> Result<String, String> {
        let Some(Token::Word(word)) = self.tokens.get(self.at) else {
            return Err(format!("expected a word, found {}", self.found()));
        };
        self.at += 1;
        Ok(word.clone())
    }

    pub fn number<N: std::str::FromStr>(&mut self) -> Result<N, String> {
        let found = self.found();
        self.word()?.parse().map_err(|_| format!("expected a number, found {found}"))
    }

    /// Consumes the next word if it is a number.
    pub fn maybe_number(&mut self) -> Option<u32> {
        let Some(Token::Word(word)) = self.tokens.get(self.at) else { return None };
        let number = word.parse().ok()?;
        self.at += 1;
        Some(number)
    }

    /// Consumes a quoted text. Returns an empty one if the next token is something else.
    pub fn text(&mut self) -> Vec<u8> {
        let Some(Token::Text(text)) = self.tokens.get(self.at) else { return Vec::new() };
        self.at += 1;
        text.clone()
    }

    /// Consumes the next word if `look_up` finds it.
    pub fn maybe<T>(&mut self, look_up: impl FnOnce(&str) -> Option<T>) -> Option<T> {
        let Some(Token::Word(word)) = self.tokens.get(self.at) else { return None };
        let found = look_up(word)?;
        self.at += 1;
        Some(found)
    }

    /// Consumes the next word, which must be the name of a `what` that `look_up` finds.
    pub fn named<T>(&mut self, what: &str, look_up: impl FnOnce(&str) -> Option<T>) -> Result<T, String> {
        let found = self.found();
        self.maybe(look_up).ok_or_else(|| format!("expected a {what}, found {found}"))
    }

    /// Consumes a list of names, with commas or `and` between them.
    pub fn list<T>(&mut self, what: &str, look_up: impl Fn(&str) -> Option<T>) -> Result<Vec<T>, String> {
        let mut found = vec![self.named(what, &look_up)?];
        loop {
            let before = self.at;
            if !self.eat("and") && !self.eat(",") {
                return Ok(found);
            }
            let Some(next) = self.maybe(&look_up) else {
                // The comma is not part of the list, but belongs to the words after it.
                self.at = before;
                return Ok(found);
            };
            found.push(next);
        }
    }

    /// Fails if tokens of the line have not been consumed.
    pub fn end(&self) -> Result<(), String> {
        if self.is_over() { Ok(()) } else { Err(format!("{} is one word too many", self.found())) }
    }

    /// The next token in quotes, for an error message.
    pub fn found(&self) -> String {
        match self.tokens.get(self.at) {
            Some(Token::Word(word)) => format!("`{word}`"),
            Some(Token::Text(text)) => format!("\"{}\"", text.escape_ascii()),
            None => "the end of the line".into(),
        }
    }
}

/// A text up to its closing quote, and the rest of the line. `\"`, `\\` and `\x00` are escapes.
fn quoted(line: &str) -> Result<(Vec<u8>, &str), String> {
    let mut text = Vec::new();
    let mut rest = line;
    loop {
        let mut chars = rest.chars();
        let first = chars.next().ok_or("a text without an end")?;
        rest = chars.as_str();
        match first {
            '"' => return Ok((text, rest)),
            '\\' => {
                let digits = rest.strip_prefix('x').and_then(|hex| hex.get(..2));
                if let Some(byte) = digits.and_then(|digits| u8::from_str_radix(digits, 16).ok()) {
                    text.push(byte);
                    rest = &rest[3..];
                } else {
                    let escaped = rest.bytes().next().filter(|b| b"\"\\".contains(b));
                    text.push(escaped.ok_or("only \\\", \\\\ and \\x00 stand for something else")?);
                    rest = &rest[1..];
                }
            }
            plain => text.extend(plain.to_string().as_bytes()),
        }
    }
}
