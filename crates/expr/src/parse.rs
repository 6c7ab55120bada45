//! Expression text -> tokens with byte spans -> graph nodes, by precedence climbing.
//!
//! In: the text and a [`Scope`] of names. Out: a [`Parsed`] node, or an [`ExpressionError`] with the
//! byte span at fault. `^` binds tighter than unary minus and is
//! right-associative, so `-2^2` is −4 and `2^-1` is ½.

use super::graph::{Binary, FieldId, Graph, NodeId, Unary};
use crate::spelling::nearest;
use std::{
    collections::{HashMap, HashSet},
    ops::Range,
};

/// A fault of an expression, with its place in the text.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct ExpressionError {
    /// Bytes of the expression's text.
    pub span: Range<usize>,
    /// The fault, in one line.
    pub message: String,
    /// Advice to the user.
    pub hint: Option<String>,
    /// The name that means nothing here, if that is what is wrong.
    pub unknown: Option<String>,
}

impl ExpressionError {
    /// Makes an error at `span` of the text.
    pub fn new(span: Range<usize>, message: impl Into<String>) -> Self {
        Self {
            span,
            message: message.into(),
            hint: None,
            unknown: None,
        }
    }

    /// Returns the advice, or `declare` on a name that is like none that is known.
    pub fn advice(&self, declare: &str) -> Option<String> {
        let unknown = self.unknown.as_ref().map(|_| declare.to_owned());
        self.hint.clone().or(unknown)
    }

    pub(super) fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }
}

/// The meaning of a name.
#[derive(Debug, Clone, Copy)]
pub struct Binding {
    /// The node.
    pub node: NodeId,
    /// Set if the node uses the components of the tangent, directly or through other names.
    pub uses_tangent: bool,
}

impl Binding {
    /// A name for a node that does not use the tangent.
    pub fn fixed(node: NodeId) -> Self {
        Self {
            node,
            uses_tangent: false,
        }
    }
}

/// The names that an expression may use, besides the functions and the constants `pi` and `e`.
#[derive(Debug, Clone, Default)]
pub struct Scope {
    names: HashMap<String, Binding>,
    /// Functions of three arguments, given by samples.
    fields: HashMap<String, FieldId>,
    /// Names of constants that stand for nothing here.
    hidden: HashSet<String>,
}

impl Scope {
    /// Makes `name` stand for `binding`, hiding what it stood for before.
    pub fn bind(&mut self, name: impl Into<String>, binding: Binding) {
        self.names.insert(name.into(), binding);
    }

    /// Lets `name` not stand for a constant: elsewhere it is something else.
    pub fn hide(&mut self, name: impl Into<String>) {
        self.hidden.insert(name.into());
    }

    /// Makes `name` a function: this field of the graph.
    pub fn bind_field(&mut self, name: impl Into<String>, field: FieldId) {
        self.fields.insert(name.into(), field);
    }

    /// Returns whether `name` stands for something of its own.
    pub fn knows(&self, name: &str) -> bool {
        self.names.contains_key(name)
    }

    fn get(&self, graph: &mut Graph, name: &str) -> Option<Binding> {
        let constant = match name {
            _ if self.hidden.contains(name) => None,
            "pi" => Some(std::f64::consts::PI),
            "e" => Some(std::f64::consts::E),
            _ => None,
        };
        self.names
            .get(name)
            .copied()
            .or_else(|| constant.map(|value| Binding::fixed(graph.constant(value))))
    }

    fn nearest(&self, name: &str) -> Option<String> {
        let known = self.names.keys().map(String::as_str);
        nearest(name, known.chain(["pi", "e"]))
    }
}

/// An expression in the graph.
#[derive(Debug, Clone)]
pub struct Parsed {
    /// Its value.
    pub node: NodeId,
    /// Where it first names something that depends on the tangent.
    pub tangent_use: Option<Range<usize>>,
}

/// A word of the language: operators, brackets, names and numbers.
#[derive(Debug, Clone, PartialEq)]
enum Token {
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
    /// Returns `true` for `< <= > >=`.
    fn compares(&self) -> bool {
        use Token::{Greater, GreaterEqual, Less, LessEqual};
        matches!(self, Less | LessEqual | Greater | GreaterEqual)
    }
}

/// Reads all tokens of `text`, the last of which is [`Token::End`].
fn tokens(text: &str) -> Result<Vec<(Token, Range<usize>)>, ExpressionError> {
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

/// Reads the token that `rest` starts with: (token, its length in bytes).
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

/// Makes the error for a character that no token starts with.
fn stray(c: char, at: usize) -> ExpressionError {
    let hint = match c {
        '=' => "only `<`, `<=`, `>` and `>=` compare, inside `if(…)`",
        '[' | ']' | '{' | '}' => "group with round brackets",
        _ => "an expression has numbers, names, `+ - * / ^`, brackets and commas",
    };
    ExpressionError::new(at..at + c.len_utf8(), format!("unexpected character `{c}`")).hint(hint)
}

/// Reads a decimal number with optional fraction and exponent.
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

/// The deepest nesting of brackets, calls, signs and powers; keeps the recursion well inside the
/// smallest thread stack.
const DEEPEST: usize = 200;

/// Functions of one argument, by name.
const UNARY: [(&str, Unary); 17] = [
    ("sin", Unary::Sin),
    ("cos", Unary::Cos),
    ("tan", Unary::Tan),
    ("asin", Unary::Asin),
    ("acos", Unary::Acos),
    ("atan", Unary::Atan),
    ("sinh", Unary::Sinh),
    ("cosh", Unary::Cosh),
    ("tanh", Unary::Tanh),
    ("asinh", Unary::Asinh),
    ("acosh", Unary::Acosh),
    ("atanh", Unary::Atanh),
    ("exp", Unary::Exp),
    ("log", Unary::Log),
    ("ln", Unary::Log),
    ("sqrt", Unary::Sqrt),
    ("abs", Unary::Abs),
];

/// Functions of two arguments, by name.
const BINARY: [(&str, Binary); 3] = [
    ("atan2", Binary::Atan2),
    ("min", Binary::Min),
    ("max", Binary::Max),
];

/// Returns whether `name` is a function of the language and so cannot be declared.
pub fn is_function(name: &str) -> bool {
    name == "if" || UNARY.iter().any(|(n, _)| *n == name) || BINARY.iter().any(|(n, _)| *n == name)
}

/// Parses the whole of `text` into `graph`.
pub fn parse(text: &str, scope: &Scope, graph: &mut Graph) -> Result<Parsed, ExpressionError> {
    let mut parser = Parser {
        tokens: tokens(text)?,
        at: 0,
        depth: 0,
        scope,
        graph,
        tangent_use: None,
    };
    let node = parser.expression(0)?;
    match parser.peek() {
        Token::End => Ok(Parsed {
            node,
            tangent_use: parser.tangent_use,
        }),
        Token::Close => Err(parser.fail("this bracket was never opened")),
        token if token.compares() => Err(parser.misplaced_comparison()),
        Token::Comma => Err(parser.fail("a comma stands only between arguments")),
        _ => Err(parser
            .fail("an operator is missing before this")
            .hint("products need `*`")),
    }
}

struct Parser<'a> {
    tokens: Vec<(Token, Range<usize>)>,
    at: usize,
    depth: usize,
    scope: &'a Scope,
    graph: &'a mut Graph,
    tangent_use: Option<Range<usize>>,
}

type Parse<T> = Result<T, ExpressionError>;

impl Parser<'_> {
    fn peek(&self) -> &Token {
        &self.tokens[self.at].0
    }

    fn span(&self) -> Range<usize> {
        self.tokens[self.at].1.clone()
    }

    fn next(&mut self) -> (Token, Range<usize>) {
        let token = self.tokens[self.at].clone();
        self.at = (self.at + 1).min(self.tokens.len() - 1);
        token
    }

    fn fail(&self, message: impl Into<String>) -> ExpressionError {
        ExpressionError::new(self.span(), message)
    }

    fn expect(&mut self, token: Token, message: impl Into<String>) -> Parse<Range<usize>> {
        if *self.peek() == token {
            Ok(self.next().1)
        } else if self.peek().compares() {
            Err(self.misplaced_comparison())
        } else {
            Err(self.fail(message))
        }
    }

    fn misplaced_comparison(&self) -> ExpressionError {
        self.fail("a comparison stands only as the first argument of `if`, one at a time")
            .hint("write if(a < b, value, other)")
    }

    /// An operand followed by operators that bind at least as tightly as `tightness`.
    fn expression(&mut self, tightness: u8) -> Parse<NodeId> {
        self.depth += 1;
        if self.depth > DEEPEST {
            return Err(self
                .fail(format!("nested more than {DEEPEST} deep"))
                .hint("name parts of it in [let]"));
        }
        let mut left = self.operand()?;
        loop {
            // (left tightness, right tightness)
            let (binds, right) = match self.peek() {
                Token::Plus | Token::Minus => (1, 2),
                Token::Star | Token::Slash => (3, 4),
                Token::Caret => (7, 6),
                _ => break,
            };
            if binds < tightness {
                break;
            }
            let (operator, _) = self.next();
            let right = self.expression(right)?;
            left = match operator {
                Token::Plus => self.graph.add(left, right),
                Token::Minus => self.graph.sub(left, right),
                Token::Star => self.graph.mul(left, right),
                Token::Slash => self.graph.quotient(left, right),
                _ => self.graph.pow(left, right),
            };
        }
        self.depth -= 1;
        Ok(left)
    }

    fn operand(&mut self) -> Parse<NodeId> {
        let (token, span) = self.next();
        match token {
            Token::Number(value) => Ok(self.graph.constant(value)),
            // Unary minus binds looser than `^` and tighter than `*`.
            Token::Minus => {
                let operand = self.expression(5)?;
                Ok(self.graph.neg(operand))
            }
            Token::Plus => self.expression(5),
            Token::Open => {
                let inner = self.expression(0)?;
                self.expect(Token::Close, "a closing bracket is missing here")?;
                Ok(inner)
            }
            Token::Name(name) if *self.peek() == Token::Open => self.call(&name, span),
            Token::Name(name) => self.name(&name, span),
            Token::End => Err(ExpressionError::new(span, "the expression ends too early")
                .hint("a number, a name or a bracket must follow")),
            _ => Err(ExpressionError::new(
                span,
                "a number, a name or a bracket is needed here",
            )),
        }
    }

    fn name(&mut self, name: &str, span: Range<usize>) -> Parse<NodeId> {
        if let Some(binding) = self.scope.get(self.graph, name) {
            if binding.uses_tangent {
                self.tangent_use.get_or_insert(span);
            }
            return Ok(binding.node);
        }
        let mut error = ExpressionError::new(span, format!("unknown name `{name}`"));
        error.unknown = Some(name.to_string());
        Err(
            if is_function(name) || self.scope.fields.contains_key(name) {
                error.hint(format!("`{name}` is a function: write {name}(…)"))
            } else if let Some(near) = self.scope.nearest(name) {
                error.hint(format!("did you mean `{near}`?"))
            } else {
                error
            },
        )
    }

    fn call(&mut self, name: &str, span: Range<usize>) -> Parse<NodeId> {
        self.next();
        if name == "if" {
            return self.conditional(span);
        }
        if let Some(&(_, op)) = UNARY.iter().find(|(n, _)| *n == name) {
            let arguments = self.arguments::<1>(name, span)?;
            return Ok(self.graph.unary(op, arguments[0]));
        }
        if let Some(&(_, op)) = BINARY.iter().find(|(n, _)| *n == name) {
            let [a, b] = self.arguments::<2>(name, span)?;
            return Ok(self.graph.binary(op, a, b));
        }
        if let Some(&field) = self.scope.fields.get(name) {
            let at = self.arguments::<3>(name, span)?;
            return Ok(self.graph.sample(field, at));
        }
        let error = ExpressionError::new(span, format!("unknown function `{name}`"));
        let known = UNARY.iter().map(|(n, _)| *n);
        let known = known.chain(BINARY.iter().map(|(n, _)| *n)).chain(["if"]);
        let known = known.chain(self.scope.fields.keys().map(String::as_str));
        Err(match nearest(name, known) {
            Some(near) => error.hint(format!("did you mean `{near}`?")),
            None if self.scope.names.contains_key(name) => {
                error.hint(format!("products need `*`: {name}*(…)"))
            }
            None => error.hint("the functions are sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh exp log ln sqrt abs min max if"),
        })
    }

    /// Exactly `N` arguments and the closing bracket.
    fn arguments<const N: usize>(&mut self, name: &str, span: Range<usize>) -> Parse<[NodeId; N]> {
        let (found, whole) = self.argument_list(span)?;
        let count = found.len();
        found.try_into().map_err(|_| {
            let plural = if N == 1 { "" } else { "s" };
            let message = format!("`{name}` takes {N} argument{plural}, {count} given");
            ExpressionError::new(whole, message)
        })
    }

    /// Arguments up to the closing bracket, and the span of the whole call, whose name is at `span`.
    fn argument_list(&mut self, span: Range<usize>) -> Parse<(Vec<NodeId>, Range<usize>)> {
        let mut found = Vec::new();
        if *self.peek() != Token::Close {
            found.push(self.expression(0)?);
            while *self.peek() == Token::Comma {
                self.next();
                found.push(self.expression(0)?);
            }
        }
        let end = self.expect(Token::Close, "a comma or a closing bracket is missing here")?;
        Ok((found, span.start..end.end))
    }

    /// The rest of `if(` — a comparison and two values.
    fn conditional(&mut self, span: Range<usize>) -> Parse<NodeId> {
        let left = self.expression(0)?;
        if !self.peek().compares() {
            return Err(self
                .fail("`if` needs a comparison here")
                .hint("write if(a < b, value, other)"));
        }
        let (comparison, _) = self.next();
        let right = self.expression(0)?;
        self.expect(Token::Comma, "`if` needs a comma after its condition")?;
        let (values, whole) = self.argument_list(span)?;
        let [yes, no] = values.try_into().map_err(|_| {
            ExpressionError::new(whole, "`if` takes a condition and two values")
                .hint("write if(a < b, value, other)")
        })?;
        let mask = match comparison {
            Token::Less => self.graph.binary(Binary::Less, left, right),
            Token::LessEqual => self.graph.binary(Binary::LessEqual, left, right),
            Token::Greater => self.graph.binary(Binary::Less, right, left),
            _ => self.graph.binary(Binary::LessEqual, right, left),
        };
        Ok(self.graph.select(mask, yes, no))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(text: &str) -> f64 {
        let mut graph = Graph::new();
        let parsed = parse(text, &Scope::default(), &mut graph).unwrap();
        graph.value(parsed.node).unwrap()
    }

    fn error(text: &str) -> ExpressionError {
        parse(text, &Scope::default(), &mut Graph::new()).unwrap_err()
    }

    #[test]
    fn powers_bind_tighter_than_signs_and_to_the_right() {
        assert_eq!(value("-2^2"), -4.0);
        assert_eq!(value("2^3^2"), 512.0);
        assert_eq!(value("2^-1"), 0.5);
        assert_eq!(value("-2*-3"), 6.0);
        assert_eq!(value("2-3-4"), -5.0);
        assert_eq!(value("8/4/2"), 1.0);
    }

    #[test]
    fn numbers_have_fractions_and_exponents() {
        assert_eq!(value("1e-3*2"), 2e-3);
        assert_eq!(value(".5 + 2. + 1.5E2"), 152.5);
    }

    #[test]
    fn conditions_choose() {
        assert_eq!(value("if(1 < 2, 3, 4)"), 3.0);
        assert_eq!(value("if(1 >= 2, 3, 4)"), 4.0);
        assert_eq!(value("min(1, 2) + 10*max(1, 2)"), 21.0);
    }

    #[test]
    fn errors_point_at_the_fault() {
        assert_eq!(error("1 + rho").span, 4..7);
        assert_eq!(error("sin(1, 2)").span, 0..9);
        assert_eq!(error("2 pi").span, 2..4);
        assert_eq!(error("(1").message, "a closing bracket is missing here");
        assert_eq!(error("1 < 2").span, 2..3);
        assert_eq!(error("sine(1)").hint.unwrap(), "did you mean `sin`?");
        assert!(error(&"(".repeat(100_000)).message.contains("nested"));
        assert!(error(&"2^".repeat(100_000)).message.contains("nested"));
    }

    #[test]
    fn long_sums_do_not_exhaust_the_stack() {
        assert_eq!(value(&format!("0{}", "+1".repeat(50_000))), 50_000.0);
    }
}
