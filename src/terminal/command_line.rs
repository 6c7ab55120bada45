//! The command line as it was typed.
//!
//! In: the process's arguments. Out: text that a shell takes back. Arguments that are not UTF-8 are
//! shown with replacement characters.

/// Writes the command line of this process as a shell takes it back.
pub fn command_line() -> String {
    words()
        .iter()
        .map(|word| quoted(word))
        .collect::<Vec<_>>()
        .join(" ")
}

/// Tells whether `option` stands on the command line of this process.
pub fn has_option(option: &str) -> bool {
    words().iter().any(|word| word == option)
}

fn words() -> Vec<String> {
    std::env::args_os()
        .map(|word| word.to_string_lossy().into_owned())
        .collect()
}

/// Quotes a word as a shell takes it back.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=,+:@%".contains(c);
    match !word.is_empty() && word.chars().all(plain) {
        true => word.into(),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_quoted_for_the_shell() {
        assert_eq!(quoted("a/b.toml"), "a/b.toml");
        assert_eq!(quoted("my file"), "'my file'");
        assert_eq!(quoted("it's"), r"'it'\''s'");
    }
}
