//! Guesses the known name that a misspelt one was meant to be.

/// Finds the one of `known` that looks most like `name`, if any is close and shares a letter with it.
pub fn nearest<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> Option<String> {
    let length = name.chars().count();
    let close = |k: &'a str| {
        let (own, shorter) = (k.chars().count(), length.min(k.chars().count()));
        let most = 1.max(shorter / 3);
        // Names much longer than any known one are not compared letter by letter.
        let distance = (length.abs_diff(own) <= most).then(|| edit_distance(name, k))?;
        (distance < shorter && distance <= most).then_some((distance, k))
    };
    known.filter_map(close).min().map(|(_, k)| k.to_string())
}

/// Advises on an unknown `name`: names the known one that it looks like, or else all of them.
pub fn suggestion(name: &str, known: &[&str]) -> String {
    match nearest(name, known.iter().copied()) {
        Some(near) => format!("did you mean `{near}`?"),
        None => format!("known here: {}", known.join(", ")),
    }
}

/// Levenshtein's distance in characters, where two neighbours swapped count as one change.
fn edit_distance(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    let mut rows = vec![vec![0; b.len() + 1]; a.len() + 1];
    for i in 0..=a.len() {
        for j in 0..=b.len() {
            if i == 0 || j == 0 {
                rows[i][j] = i + j;
                continue;
            }
            let change = rows[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
            let mut best = change.min(rows[i - 1][j] + 1).min(rows[i][j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                best = best.min(rows[i - 2][j - 2] + 1);
            }
            rows[i][j] = best;
        }
    }
    rows[a.len()][b.len()]
}

#[cfg(test)]
mod tests {
    use super::nearest;

    #[test]
    fn close_names_are_found_and_strangers_are_not() {
        let nearest = |name| nearest(name, ["alpha", "metric", "e", "rho"].into_iter());
        assert_eq!(nearest("alpah").as_deref(), Some("alpha"));
        assert_eq!(nearest("metirc").as_deref(), Some("metric"));
        assert_eq!(nearest("roh").as_deref(), Some("rho"));
        assert_eq!(nearest("b"), None);
        assert_eq!(nearest("ρ"), None);
        assert_eq!(nearest("omega"), None);
    }
}
