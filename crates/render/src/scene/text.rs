//! The texts of OBJ and MTL files as statements.
//!
//! In: bytes. Out: text with line feeds only and every statement on a line ([`decoded`], [`joined`]),
//! and its [`statements`], each with the number that an editor shows for where it begins.

use std::borrow::Cow;

/// Returns the text in the bytes: without the mark that some editors put in front, with line feeds for the
/// line ends of other systems. Bytes that are not UTF-8 are read as Latin-1, which has a character
/// for each, so that names of materials and files stay apart.
pub(super) fn decoded(bytes: &[u8]) -> Cow<'_, str> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let text = match std::str::from_utf8(bytes) {
        Ok(text) => Cow::Borrowed(text),
        Err(_) => bytes.iter().map(|b| char::from(*b)).collect(),
    };
    match text.contains('\r') {
        true => Cow::Owned(text.replace("\r\n", "\n").replace('\r', "\n")),
        false => text,
    }
}

/// Returns the text with every line that ends in a backslash joined with the next. Blank lines take the place
/// of what has moved up, so that numbers of lines stay. A backslash at the end of a comment is part
/// of a path more often than not, and joins nothing.
pub(super) fn joined(text: &str) -> Cow<'_, str> {
    let part = |line: &str| -> Option<usize> {
        let part = line.trim_end().strip_suffix('\\')?;
        (!part.contains('#')).then_some(part.len())
    };
    if !text.contains('\\') || !text.lines().any(|line| part(line).is_some()) {
        return Cow::Borrowed(text);
    }
    let mut whole = String::with_capacity(text.len() + 1);
    let mut moved = 0;
    for line in text.lines() {
        if let Some(length) = part(line) {
            whole.push_str(&line[..length]);
            whole.push(' ');
            moved += 1;
            continue;
        }
        whole.push_str(line);
        (0..=moved).for_each(|_| whole.push('\n'));
        moved = 0;
    }
    Cow::Owned(whole)
}

/// A statement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Statement<'a> {
    /// The line in which it begins; the first is 1.
    pub line: usize,
    /// Its first word.
    pub key: &'a str,
    /// The rest of the line, with the comment at its end if there is one: names may hold a `#`.
    pub whole: &'a str,
    /// The rest of the line, without the comment.
    pub rest: &'a str,
}

/// The start of comments in which ZBrush writes the colours of vertices.
pub(super) const PAINT: &str = "#MRGB";

/// Returns the statements of a text, in order; lines that are empty or comments are none, but for [`PAINT`].
pub(super) fn statements(text: &str) -> impl Iterator<Item = Statement<'_>> {
    text.lines().enumerate().filter_map(|(i, line)| {
        let line = line.trim();
        let (key, whole) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let whole = whole.trim_start();
        let means = !key.is_empty() && (!key.starts_with('#') || key == PAINT);
        means.then(|| Statement {
            line: i + 1,
            key,
            whole,
            rest: without_comment(whole),
        })
    })
}

/// Returns what stands before a comment.
pub(super) fn without_comment(text: &str) -> &str {
    text.split('#').next().unwrap_or_default().trim_end()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn line_ends_of_all_systems_and_the_mark_of_editors_are_taken_away() {
        let bytes = b"\xef\xbb\xbfv 1\r\nv 2\rv 3\n";
        assert_eq!(decoded(bytes), "v 1\nv 2\nv 3\n");
        assert_eq!(decoded(b"newmtl B\xe4ume"), "newmtl B\u{e4}ume");
        assert_eq!(decoded("newmtl B\u{e4}ume".as_bytes()), "newmtl B\u{e4}ume");
    }

    #[test]
    fn statements_know_where_they_begin_and_where_their_comments_do() {
        let text = "# C:\\models\\\n\n\tf 1 \\\n 2 \\ \n3 # front\nusemtl\tMaterial #25\n\\\n\ng\n";
        let whole = joined(text);
        let found: Vec<Statement<'_>> = statements(&whole).collect();
        let told: Vec<_> = found.iter().map(|s| (s.line, s.key, s.rest)).collect();
        let known = [
            (3, "f", "1   2  3"),
            (6, "usemtl", "Material"),
            (9, "g", ""),
        ];
        assert_eq!(told, known);
        assert_eq!(found[1].whole, "Material #25");
    }
}
