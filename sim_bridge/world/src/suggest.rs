//! Suggestions for misspelled names.

/// Returns `; did you mean "…"?` with the known name nearest to `text`, or an empty text if none is
/// near.
pub fn did_you_mean<'a>(text: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    let wanted = text.to_lowercase();
    let near = (wanted.chars().count() / 3).max(1);
    known
        .into_iter()
        .map(|name| (edits(&wanted, &name.to_lowercase()), name))
        .filter(|(edits, _)| *edits <= near)
        .min()
        .map_or_else(String::new, |(_, name)| format!("; did you mean {name:?}?"))
}

/// Edit distance of two texts: insertions, deletions and replacements (Levenshtein).
fn edits(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut corner = i;
        row[0] = i + 1;
        for (j, &cb) in b.iter().enumerate() {
            let replaced = corner + usize::from(ca != cb);
            corner = row[j + 1];
            row[j + 1] = replaced.min(corner + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_name_is_offered_and_a_far_one_is_not() {
        let known = ["IC Room 1", "PC Room 1", "Laboratory"];
        assert_eq!(did_you_mean("labratory", known), "; did you mean \"Laboratory\"?");
        assert_eq!(did_you_mean("PC Rom 1", known), "; did you mean \"PC Room 1\"?");
        assert_eq!(did_you_mean("Kitchen", known), "");
    }
}
