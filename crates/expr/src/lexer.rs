//! Expression text -> tokens with byte spans.

use super::parse::ExpressionError;
use std::ops::Range;

/// A token's meaning.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Token {
    Number(f64),
    Name(String),
    Plus,
    Minus,
    Star,
    Slash,
    Caret,
    Open,
    Close,
    Comma,
    Less,
    LessEqual,
    Greater,
    GreaterEqual,
    End,
}

impl Token {
    /// Whether it is one of `< <= > >=`.
    pub fn compares(&self) -> bool {
        use Token::{Greater, GreaterEqual, Less, LessEqual};
        matches!(self, Less | LessEqual | Greater | GreaterEqual)
    }
}

/// All tokens of `text`, ending with [`Token::End`].
pub(super) fn tokens(text: &str) -> Result<Vec<(Token, Range<usize>)>, ExpressionError> {
    let mut found = Vec::new();
    let mut at = 0;
    while let Some(c) = text[at..].chars().next() {
        if c.is_whitespace() {
            at += c.len_utf8();
            continue;
        }
        let (token, length) = token(&text[at..], c, at)?;
        found.push((token, at..at + length));
        at += length;
    }
    found.push((Token::End, at..at));
    Ok(found)
}

/// The token that `rest` starts with, and its length in bytes.
fn token(rest: &str, first: char, at: usize) -> Result<(Token, usize), ExpressionError> {
    if first.is_ascii_digit() || first == '.' {
        return number(rest, at);
    }
    if first.is_alphabetic() || first == '_' {
        let length = rest
            .find(|c: char| !c.is_alphanumeric() && c != '_')
            .unwrap_or(rest.len());
        return Ok((Token::Name(rest[..length].to_string()), length));
    }
    let wide = rest[first.len_utf8()..].starts_with('=');
    Ok(match first {
        '+' => (Token::Plus, 1),
        '-' => (Token::Minus, 1),
        '*' if rest.starts_with("**") => {
            return Err(ExpressionError::new(at..at + 2, "`**` is not an operator")
                .hint("write powers with `^`"));
        }
        '*' => (Token::Star, 1),
        '/' => (Token::Slash, 1),
        '^' => (Token::Caret, 1),
        '(' => (Token::Open, 1),
        ')' => (Token::Close, 1),
        ',' => (Token::Comma, 1),
        '<' if wide => (Token::LessEqual, 2),
        '<' => (Token::Less, 1),
        '>' if wide => (Token::GreaterEqual, 2),
        '>' => (Token::Greater, 1),
        _ => return Err(stray(first, at)),
    })
}

fn stray(c: char, at: usize) -> ExpressionError {
    let hint = match c {
        '=' => "only `<`, `<=`, `>` and `>=` compare, inside `if(…)`",
        '[' | ']' | '{' | '}' => "group with round brackets",
        _ => "an expression has numbers, names, `+ - * / ^`, brackets and commas",
    };
    ExpressionError::new(at..at + c.len_utf8(), format!("unexpected character `{c}`")).hint(hint)
}

/// A decimal number with optional fraction and exponent.
fn number(rest: &str, at: usize) -> Result<(Token, usize), ExpressionError> {
    let bytes = rest.as_bytes();
    let digits = |from: usize| {
        bytes[from..]
            .iter()
            .take_while(|b| b.is_ascii_digit())
            .count()
    };
    let mut end = digits(0);
    if bytes.get(end) == Some(&b'.') {
        end += 1 + digits(end + 1);
    }
    if matches!(bytes.get(end), Some(b'e' | b'E')) {
        let sign = usize::from(matches!(bytes.get(end + 1), Some(b'+' | b'-')));
        let exponent = digits((end + 1 + sign).min(bytes.len()));
        if exponent > 0 {
            end += 1 + sign + exponent;
        }
    }
    // `1.2.3` is one mistake, not two numbers.
    if bytes.get(end) == Some(&b'.') {
        let more = bytes[end..].iter();
        end += more
            .take_while(|b| b.is_ascii_digit() || **b == b'.')
            .count();
    }
    match rest[..end].parse::<f64>() {
        Ok(value) if value.is_finite() => Ok((Token::Number(value), end)),
        Ok(_) => Err(
            ExpressionError::new(at..at + end, "this number is too large")
                .hint("numbers go up to about 1.8e308"),
        ),
        Err(_) => Err(ExpressionError::new(at..at + end, "this is not a number")),
    }
}
