//! Typed reading of a TOML text whose every complaint points at a place.
//!
//! In: a [`SourceText`]. Out: [`TomlTable`]s and [`Item`]s that give up their content only as the type
//! asked for, or a [`Diagnostic`] with the span underlined.

use crate::diagnostic::{Diagnostic, SourceText};
use geofan_expr::spelling::suggestion;
use std::{cell::RefCell, ops::Range, sync::Arc};
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

/// What is read, or a complaint at its place.
pub(crate) type Reading<T> = Result<T, Diagnostic>;

/// Parses `source` and hands the root table to `read`.
pub fn read<T>(
    source: &Arc<SourceText>,
    read: impl FnOnce(TomlTable<'_>) -> Reading<T>,
) -> Reading<T> {
    let root = DeTable::parse(&source.text).map_err(|e| {
        Diagnostic::new(source, e.span().unwrap_or(0..0), e.message().to_string())
            .with_hint("the file is TOML: key = value lines and [table] headings")
    })?;
    read(TomlTable::root(source, &root))
}

/// Writes a string as TOML has it, quotes included.
pub fn quoted(text: &str) -> String {
    let mut written = String::from('"');
    for c in text.chars() {
        match c {
            '"' | '\\' => written.extend(['\\', c]),
            c if c.is_control() => written += &format!("\\u{:04X}", c as u32),
            c => written.push(c),
        }
    }
    written + "\""
}

/// A string with its place.
#[derive(Debug, Clone)]
pub struct Text {
    /// The string.
    pub value: String,
    /// Its bytes in the source, quotes included.
    pub span: Range<usize>,
    source: Arc<SourceText>,
}

impl Text {
    /// A complaint about the whole string.
    pub fn complain(&self, message: impl Into<String>) -> Diagnostic {
        Diagnostic::new(&self.source, self.span.clone(), message)
    }

    /// A complaint about the bytes `part` of the string.
    pub fn complain_at(&self, part: Range<usize>, message: impl Into<String>) -> Diagnostic {
        Diagnostic::new(&self.source, self.place_of(part), message)
    }

    fn place_of(&self, part: Range<usize>) -> Range<usize> {
        place_in_string(&self.source, &self.span, &self.value, part)
    }
}

/// Returns where the bytes `part` of a string lie in the source, of which `span` is the string with its quotes. A string
/// with escapes cannot be followed byte by byte; its whole span is the answer then.
pub fn place_in_string(
    source: &SourceText,
    span: &Range<usize>,
    value: &str,
    part: Range<usize>,
) -> Range<usize> {
    let raw = source.text.get(span.clone()).unwrap_or_default();
    match raw.find(value) {
        Some(offset) if !value.is_empty() => {
            let start = span.start + offset;
            start + part.start..start + part.end
        }
        _ => span.clone(),
    }
}

/// A value of the document.
#[derive(Debug, Clone)]
pub struct Item<'d> {
    source: &'d Arc<SourceText>,
    /// Its bytes in the source.
    pub span: Range<usize>,
    value: &'d DeValue<'d>,
}

impl<'d> Item<'d> {
    fn new(source: &'d Arc<SourceText>, value: &'d Spanned<DeValue<'d>>) -> Self {
        Self {
            source,
            span: value.span(),
            value: value.get_ref(),
        }
    }

    /// A complaint about this value.
    pub fn complain(&self, message: impl Into<String>) -> Diagnostic {
        Diagnostic::new(self.source, self.span.clone(), message)
    }

    /// Returns TOML's name of its type.
    pub fn type_name(&self) -> &'static str {
        self.value.type_str()
    }

    /// The string that it is.
    pub fn as_str(&self) -> Option<&'d str> {
        self.value.as_str()
    }

    /// The truth value that it is.
    pub fn as_truth(&self) -> Option<bool> {
        match self.value {
            DeValue::Boolean(truth) => Some(*truth),
            _ => None,
        }
    }

    /// The number that it is; not finite if it is too large for double precision.
    pub fn as_number(&self) -> Option<f64> {
        let parsed = match self.value {
            DeValue::Float(f) => f.as_str().parse().ok(),
            DeValue::Integer(i) if i.radix() == 10 => i.as_str().parse().ok(),
            DeValue::Integer(i) => u64::from_str_radix(i.as_str(), i.radix())
                .ok()
                .map(|i| i as f64),
            _ => return None,
        };
        Some(parsed.unwrap_or(f64::NAN))
    }

    /// The items of the list that it is.
    pub fn as_list(&self) -> Option<Vec<Self>> {
        let items = self.value.as_array()?.iter();
        Some(items.map(|item| Self::new(self.source, item)).collect())
    }

    /// The table that it is.
    pub fn as_table(&self) -> Option<TomlTable<'d>> {
        Some(TomlTable {
            source: self.source,
            span: self.span.clone(),
            entries: self.value.as_table()?,
            known: RefCell::default(),
        })
    }

    fn wrong_type(&self, wanted: &str) -> Diagnostic {
        let found = self.type_name();
        let article = if found.starts_with(['a', 'i']) {
            "an"
        } else {
            "a"
        };
        self.complain(format!(
            "{wanted} is needed here, this is {article} {found}"
        ))
    }

    /// The value as a string.
    pub fn text(&self) -> Reading<Text> {
        match self.value {
            DeValue::String(value) => Ok(Text {
                value: value.to_string(),
                span: self.span.clone(),
                source: self.source.clone(),
            }),
            DeValue::Integer(_) | DeValue::Float(_) => Err(self
                .wrong_type("a string")
                .with_hint("put quotes around it")),
            _ => Err(self.wrong_type("a string")),
        }
    }

    /// The value as a finite number.
    pub fn number(&self) -> Reading<f64> {
        match self.as_number() {
            Some(value) if value.is_finite() => Ok(value),
            Some(_) => Err(self.complain("a finite number is needed here")),
            None if self.as_str().is_some() => Err(self
                .wrong_type("a number")
                .with_hint("take the quotes away; expressions are not possible here")),
            None => Err(self.wrong_type("a number")),
        }
    }

    /// The value as a list.
    pub fn list(&self) -> Reading<Vec<Item<'d>>> {
        self.as_list().ok_or_else(|| self.wrong_type("a list"))
    }

    /// The value as a list of exactly `N` things; `what` names them for the complaint.
    pub fn exactly<const N: usize>(&self, what: &str) -> Reading<[Item<'d>; N]> {
        let items = self.list()?;
        let count = items.len();
        items
            .try_into()
            .map_err(|_| self.complain(format!("{N} {what} are needed here, {count} given")))
    }

    /// The value as `N` numbers.
    pub fn numbers<const N: usize>(&self) -> Reading<[f64; N]> {
        let mut numbers = [0.0; N];
        for (slot, item) in numbers.iter_mut().zip(self.exactly::<N>("numbers")?) {
            *slot = item.number()?;
        }
        Ok(numbers)
    }

    /// The value as two numbers, the first the smaller.
    pub fn interval(&self) -> Reading<[f64; 2]> {
        let [low, high] = self.numbers()?;
        if low < high {
            return Ok([low, high]);
        }
        Err(self
            .complain("an interval needs its lower limit first")
            .with_hint("write [lower, upper]"))
    }

    /// The value as a list of strings.
    pub fn texts(&self) -> Reading<Vec<Text>> {
        self.list()?.iter().map(Item::text).collect()
    }

    /// The value as a table.
    pub fn table(&self) -> Reading<TomlTable<'d>> {
        self.as_table().ok_or_else(|| self.wrong_type("a table"))
    }
}

/// A table of the document. It remembers the keys asked for, so that [`TomlTable::finish`] can refuse
/// the others.
#[derive(Debug, Clone)]
pub struct TomlTable<'d> {
    source: &'d Arc<SourceText>,
    /// Its bytes in the source (empty for the root).
    pub span: Range<usize>,
    entries: &'d DeTable<'d>,
    known: RefCell<Vec<String>>,
}

impl<'d> TomlTable<'d> {
    /// All of a parsed text.
    pub fn root(source: &'d Arc<SourceText>, document: &'d Spanned<DeTable<'d>>) -> Self {
        Self {
            source,
            span: 0..0,
            entries: document.get_ref(),
            known: RefCell::default(),
        }
    }

    /// The value under `key`, if it is there.
    pub fn get(&self, key: &str) -> Option<Item<'d>> {
        let mut known = self.known.borrow_mut();
        if !known.iter().any(|known| known == key) {
            known.push(key.to_string());
        }
        let value = self.entries.get(key)?;
        Some(Item::new(self.source, value))
    }

    /// The value under `key`.
    pub fn require(&self, key: &str) -> Reading<Item<'d>> {
        self.get(key)
            .ok_or_else(|| self.complain(format!("`{key}` is missing")))
    }

    /// A complaint about the table.
    pub fn complain(&self, message: impl Into<String>) -> Diagnostic {
        Diagnostic::new(self.source, self.span.clone(), message)
    }

    /// All entries in the order of the file, keys with their places.
    pub fn entries(&self) -> Vec<(Text, Item<'d>)> {
        let entry = |(key, value): (&Spanned<_>, &'d Spanned<DeValue<'d>>)| {
            let key: &Spanned<std::borrow::Cow<'_, str>> = key;
            let text = Text {
                value: key.get_ref().to_string(),
                span: key.span(),
                source: self.source.clone(),
            };
            (text, Item::new(self.source, value))
        };
        let mut entries: Vec<(Text, Item<'d>)> = self.entries.iter().map(entry).collect();
        entries.sort_by_key(|(key, _)| key.span.start);
        entries
    }

    /// Refuses keys that nobody asked for.
    pub fn finish(&self) -> Reading<()> {
        let known = self.known.borrow();
        for (key, _) in self.entries() {
            if !known.contains(&key.value) {
                let known: Vec<&str> = known.iter().map(String::as_str).collect();
                return Err(key
                    .complain(format!("unknown key `{}`", key.value))
                    .with_hint(suggestion(&key.value, &known)));
            }
        }
        Ok(())
    }
}
