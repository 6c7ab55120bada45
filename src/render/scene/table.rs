//! Reading a TOML document value by value, with a diagnostic for everything that does not fit.
//!
//! In: a parsed document whose keys and values still know their byte spans.
//! Out: strings, numbers, vectors and sub-tables, each with its span; or a
//! [`Diagnostic`] that underlines the culprit, says what was expected and what to do.

use crate::{
    diagnostic::{Diagnostic, SourceText},
    error::Result,
    spelling::suggestion,
};
use glam::DVec3;
use std::{ops::Range, sync::Arc};
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

/// Bytes of the source text.
pub(super) type Span = Range<usize>;

/// A table of the document under the name the user knows it by.
#[derive(Clone)]
pub(super) struct Table<'a> {
    source: &'a Arc<SourceText>,
    name: String,
    span: Span,
    entries: &'a DeTable<'a>,
}

/// A value of the document under the name the user knows it by.
#[derive(Clone)]
pub(super) struct Value<'a> {
    source: &'a Arc<SourceText>,
    name: String,
    span: Span,
    value: &'a DeValue<'a>,
}

/// Parses the whole text, or says where it stops being TOML.
pub(super) fn parse(source: &Arc<SourceText>) -> Result<Spanned<DeTable<'_>>> {
    DeTable::parse(&source.text).map_err(|error| {
        let end = source.text.len();
        let message = format!("not valid TOML: {}", error.message());
        Diagnostic::new(source, error.span().unwrap_or(end..end), message)
            .with_label("here")
            .with_hint("a key may be given once; strings need quotes, arrays need commas")
            .into()
    })
}

impl<'a> Table<'a> {
    /// The document itself.
    pub(super) fn root(source: &'a Arc<SourceText>, document: &'a Spanned<DeTable<'a>>) -> Self {
        Self {
            source,
            name: String::from("the scene file"),
            span: 0..0,
            entries: document.get_ref(),
        }
    }

    /// Where the table stands.
    pub(super) fn span(&self) -> Span {
        self.span.clone()
    }

    /// A diagnostic at the table as a whole.
    pub(super) fn complain(&self, message: String) -> Diagnostic {
        Diagnostic::new(self.source, self.span(), message)
    }

    /// Refuses any key that is not in `known`.
    pub(super) fn allow_only(&self, known: &[&str]) -> Result<()> {
        let stranger = self
            .entries
            .keys()
            .find(|k| !known.contains(&&**k.get_ref()));
        let Some(key) = stranger else { return Ok(()) };
        let hint = suggestion(key.get_ref(), known);
        Err(Diagnostic::new(
            self.source,
            key.span(),
            format!("unknown key `{}` in {}", key.get_ref(), self.name),
        )
        .with_label("not a key of the scene format")
        .with_hint(hint)
        .into())
    }

    /// The value of `key`, if it is there.
    pub(super) fn optional(&self, key: &str) -> Option<Value<'a>> {
        let value = self.entries.get(key)?;
        Some(Value::new(self.source, key.to_owned(), value))
    }

    /// The value of `key`, which must be there; `example` shows how it could look.
    pub(super) fn required(&self, key: &str, example: &str) -> Result<Value<'a>> {
        self.optional(key).ok_or_else(|| {
            self.complain(format!("{} has no `{key}`", self.name))
                .with_label(format!("`{key}` is missing"))
                .with_hint(format!("add a line such as `{example}`"))
                .into()
        })
    }

    /// All entries in the order of the file, named by their keys, with the keys' spans.
    pub(super) fn entries(&self) -> impl Iterator<Item = (String, Span, Value<'a>)> {
        self.entries.iter().map(|(key, value)| {
            let name = key.get_ref().to_string();
            let value = Value::new(self.source, name.clone(), value);
            (name, key.span(), value)
        })
    }
}

impl<'a> Value<'a> {
    fn new(source: &'a Arc<SourceText>, name: String, value: &'a Spanned<DeValue<'a>>) -> Self {
        Self {
            source,
            name,
            span: value.span(),
            value: value.get_ref(),
        }
    }

    /// Where the value stands.
    pub(super) fn span(&self) -> Span {
        self.span.clone()
    }

    /// A diagnostic at the value.
    pub(super) fn complain(&self, message: String) -> Diagnostic {
        Diagnostic::new(self.source, self.span(), message)
    }

    /// A diagnostic that another type was expected.
    pub(super) fn wrong_type(&self, expected: &str) -> Diagnostic {
        let found = self.value.type_str();
        self.complain(format!("`{}` must be {expected}", self.name))
            .with_label(format!("this is of type {found}"))
            .with_hint(format!("write {expected}"))
    }

    /// The value as a string that is not empty.
    pub(super) fn string(&self) -> Result<&'a str> {
        match self.value.as_str() {
            Some("") => Err(self
                .complain(format!("`{}` is empty", self.name))
                .with_label("nothing between the quotes")
                .into()),
            Some(text) => Ok(text),
            None => Err(self.wrong_type("a string in quotes").into()),
        }
    }

    /// The value as a finite number.
    pub(super) fn number(&self) -> Result<f64> {
        let parsed = match self.value {
            DeValue::Float(float) => float.as_str().parse().ok(),
            DeValue::Integer(integer) if integer.radix() == 10 => integer.as_str().parse().ok(),
            DeValue::Integer(integer) => u64::from_str_radix(integer.as_str(), integer.radix())
                .ok()
                .map(|n| n as f64),
            _ => return Err(self.wrong_type("a number").into()),
        };
        match parsed {
            Some(number) if f64::is_finite(number) => Ok(number),
            _ => Err(self
                .complain(format!("`{}` is not a finite number", self.name))
                .with_label("a finite number is needed here")
                .into()),
        }
    }

    /// The value as an array.
    pub(super) fn array(&self, expected: &str) -> Result<Vec<Value<'a>>> {
        let array = self.value.as_array();
        let items = array.ok_or_else(|| self.wrong_type(expected))?;
        let named = |(i, v)| Value::new(self.source, format!("{}[{i}]", self.name), v);
        Ok(items.iter().enumerate().map(named).collect())
    }

    /// The value as three finite numbers.
    pub(super) fn vector(&self) -> Result<DVec3> {
        let items = self.array("three numbers such as [1.0, 0.0, 0.0]")?;
        let [x, y, z] = items.as_slice() else {
            return Err(self
                .complain(format!("`{}` must have three numbers", self.name))
                .with_label(format!("{} given", items.len()))
                .into());
        };
        Ok(DVec3::new(x.number()?, y.number()?, z.number()?))
    }

    /// The value as a vector that has a direction, scaled to unit length.
    pub(super) fn direction(&self) -> Result<DVec3> {
        let vector = self.vector()?;
        let largest = vector.abs().max_element();
        if largest == 0.0 {
            return Err(self
                .complain(format!("`{}` is the zero vector", self.name))
                .with_label("a direction cannot have length zero")
                .into());
        }
        // Dividing by the largest component first keeps the squares from over- or underflowing.
        Ok((vector / largest).normalize())
    }

    /// The value as three numbers that are light, so not negative.
    pub(super) fn light(&self) -> Result<[f32; 3]> {
        let colour = self.vector()?;
        if colour.min_element() < 0.0 || colour.max_element() > f64::from(f32::MAX) {
            return Err(self
                .complain(format!(
                    "`{}` must be red, green, blue from 0 up",
                    self.name
                ))
                .with_label("linear light is never negative")
                .into());
        }
        Ok(colour.as_vec3().to_array())
    }

    /// The value as a table that `name` describes to the user.
    pub(super) fn table(&self, name: String, expected: &str) -> Result<Table<'a>> {
        let table = self.value.as_table();
        let entries = table.ok_or_else(|| self.wrong_type(expected))?;
        Ok(Table {
            source: self.source,
            name,
            span: self.span(),
            entries,
        })
    }

    /// Whether the value is a string (several keys take a word or a table).
    pub(super) fn is_string(&self) -> bool {
        self.value.is_str()
    }

    /// The choice whose name the string is.
    pub(super) fn choice<T: Copy>(&self, choices: &[(&str, T)]) -> Result<T> {
        let word = self.string()?;
        if let Some((_, choice)) = choices.iter().find(|(name, _)| *name == word) {
            return Ok(*choice);
        }
        let names: Vec<&str> = choices.iter().map(|(name, _)| *name).collect();
        Err(self
            .complain(format!("unknown {} `{word}`", self.name))
            .with_label("not one of the choices")
            .with_hint(suggestion(word, &names))
            .into())
    }
}
