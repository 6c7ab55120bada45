//! Reading a scene value by value, under the names that the user knows, with a diagnostic for
//! everything that does not fit.
//!
//! In: a parsed [`document`](geofan_core::document). Out: strings, numbers, vectors and sub-tables, each
//! with its span; or a [`Diagnostic`] that underlines the culprit, says what was expected and what
//! to do.

use geofan_core::{
    diagnostic::{Diagnostic, SourceText},
    document::{self, Item},
    error::Result,
};
use geofan_expr::spelling::suggestion;
use glam::DVec3;
use std::{ops::Range, sync::Arc};
use toml::{Spanned, de::DeTable};

/// Bytes of the source text.
pub(super) type Span = Range<usize>;

/// A table of the document under the name the user knows it by.
#[derive(Clone)]
pub(super) struct NamedTable<'a> {
    name: String,
    table: document::TomlTable<'a>,
}

/// A value of the document under the name the user knows it by.
#[derive(Clone)]
pub(super) struct NamedValue<'a> {
    name: String,
    item: Item<'a>,
}

/// Parses the whole text, or says where it stops being TOML.
pub(super) fn parse(source: &Arc<SourceText>) -> Result<Spanned<DeTable<'_>>> {
    DeTable::parse(&source.text).map_err(|error| {
        let end = source.text.len();
        let message = format!("not valid TOML: {}", error.message());
        Diagnostic::new(source, error.span().unwrap_or(end..end), message)
            .with_label("here")
            .with_hint(match error.message().contains("mantissa") {
                true => "numbers have a digit before the point and one behind it, such as 0.5",
                false => "a key may be given once; strings need quotes, arrays need commas",
            })
            .into()
    })
}

impl<'a> NamedTable<'a> {
    /// The document itself, which the user knows as `name`.
    pub(super) fn root(
        name: &str,
        source: &'a Arc<SourceText>,
        document: &'a Spanned<DeTable<'a>>,
    ) -> Self {
        Self {
            name: name.into(),
            table: document::TomlTable::root(source, document),
        }
    }

    /// Where the table stands.
    pub(super) fn span(&self) -> Span {
        self.table.span.clone()
    }

    /// A diagnostic at the table as a whole.
    pub(super) fn complain(&self, message: String) -> Diagnostic {
        self.table.complain(message)
    }

    /// Refuses any key that is not in `known`.
    pub(super) fn allow_only(&self, known: &[&str]) -> Result<()> {
        let mut keys = self.table.entries().into_iter().map(|(key, _)| key);
        let Some(key) = keys.find(|key| !known.contains(&key.value.as_str())) else {
            return Ok(());
        };
        Err(key
            .complain(format!("unknown key `{}` in {}", key.value, self.name))
            .with_label("no key of this table")
            .with_hint(suggestion(&key.value, known))
            .into())
    }

    /// The value of `key`, if it is there.
    pub(super) fn optional(&self, key: &str) -> Option<NamedValue<'a>> {
        Some(NamedValue {
            name: key.to_owned(),
            item: self.table.get(key)?,
        })
    }

    /// The value of `key`, which must be there; `example` shows how it could look.
    pub(super) fn required(&self, key: &str, example: &str) -> Result<NamedValue<'a>> {
        self.optional(key).ok_or_else(|| {
            self.complain(format!("{} has no `{key}`", self.name))
                .with_label(format!("`{key}` is missing"))
                .with_hint(format!("add a line such as `{example}`"))
                .into()
        })
    }

    /// All entries in the order of the file, named by their keys, with the keys' spans.
    pub(super) fn entries(&self) -> impl Iterator<Item = (String, Span, NamedValue<'a>)> {
        self.table.entries().into_iter().map(|(key, item)| {
            let name = key.value.clone();
            (key.value, key.span, NamedValue { name, item })
        })
    }
}

impl<'a> NamedValue<'a> {
    /// Where the value stands.
    pub(super) fn span(&self) -> Span {
        self.item.span.clone()
    }

    /// A diagnostic at the value.
    pub(super) fn complain(&self, message: String) -> Diagnostic {
        self.item.complain(message)
    }

    /// A diagnostic that another type was expected.
    pub(super) fn wrong_type(&self, expected: &str) -> Diagnostic {
        let found = self.item.type_name();
        self.complain(format!("`{}` must be {expected}", self.name))
            .with_label(format!("this is of type {found}"))
            .with_hint(format!("write {expected}"))
    }

    /// The value as a string that is not empty.
    pub(super) fn string(&self) -> Result<&'a str> {
        match self.item.as_str() {
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
        match self.item.as_number() {
            None => Err(self.wrong_type("a number").into()),
            Some(number) if number.is_finite() => Ok(number),
            Some(_) => Err(self
                .complain(format!("`{}` is not a finite number", self.name))
                .with_label("a finite number is needed here")
                .into()),
        }
    }

    /// The value as `true` or `false`.
    pub(super) fn truth(&self) -> Result<bool> {
        let truth = self.item.as_truth();
        truth.ok_or_else(|| self.wrong_type("true or false").into())
    }

    /// The value as an array.
    pub(super) fn array(&self, expected: &str) -> Result<Vec<NamedValue<'a>>> {
        let list = self.item.as_list();
        let items = list.ok_or_else(|| self.wrong_type(expected))?;
        let named = |(i, item)| NamedValue {
            name: format!("{}[{i}]", self.name),
            item,
        };
        Ok(items.into_iter().enumerate().map(named).collect())
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
                    "`{}` must be red, green, blue from 0 to 3e38",
                    self.name
                ))
                .with_label("linear light is never negative, and kept in single precision")
                .into());
        }
        Ok(colour.as_vec3().to_array())
    }

    /// The value as a table that `name` describes to the user.
    pub(super) fn table(&self, name: String, expected: &str) -> Result<NamedTable<'a>> {
        let table = self.item.as_table();
        let table = table.ok_or_else(|| self.wrong_type(expected))?;
        Ok(NamedTable { name, table })
    }

    /// Returns whether the value is a string (several keys take a word or a table).
    pub(super) fn is_string(&self) -> bool {
        self.item.as_str().is_some()
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
