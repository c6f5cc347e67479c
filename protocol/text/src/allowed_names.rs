//! Allowed names in a diagnostic, and the most similar of them.

use std::fmt;

/// Names that are allowed at a place, and the most similar of them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AllowedNames {
    /// All allowed names, in order.
    pub names: Vec<String>,
    /// Name that was probably intended.
    pub nearest: Option<String>,
}

/// Maximum number of allowed names in a message.
const NAMES_SHOWN: usize = 24;

impl AllowedNames {
    /// Creates the names allowed in place of `found`.
    pub fn suggest_for<T: fmt::Display>(found: &str, names: impl IntoIterator<Item = T>) -> Self {
        let names: Vec<String> = names.into_iter().map(|name| name.to_string()).collect();
        let nearest = names
            .iter()
            .map(|name| (distance(found, name), name))
            .filter(|(distance, name)| *distance <= 1 + name.chars().count().max(found.chars().count()) / 4)
            .min()
            .map(|(_, name)| name.clone());
        Self { names, nearest }
    }
}

impl fmt::Display for AllowedNames {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.names.is_empty() {
            return f.write_str("no names are available");
        }
        let shown = &self.names[..self.names.len().min(NAMES_SHOWN)];
        write!(f, "allowed: {}", shown.join(", "))?;
        if self.names.len() > shown.len() {
            write!(f, " and {} more", self.names.len() - shown.len())?;
        }
        match &self.nearest {
            Some(name) => write!(f, "; did you mean `{name}`?"),
            None => Ok(()),
        }
    }
}

/// Returns the edit distance (insert, delete, replace, swap of neighbours) of two names, ignoring
/// case.
fn distance(a: &str, b: &str) -> usize {
    let a: Vec<char> = a.chars().take(80).flat_map(char::to_lowercase).collect();
    let b: Vec<char> = b.chars().take(80).flat_map(char::to_lowercase).collect();
    let mut rows: Vec<Vec<usize>> = vec![(0..=b.len()).collect()];
    for i in 1..=a.len() {
        let mut row = vec![i];
        for j in 1..=b.len() {
            let replace = rows[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
            let mut best = replace.min(rows[i - 1][j] + 1).min(row[j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                best = best.min(rows[i - 2][j - 2] + 1);
            }
            row.push(best);
        }
        rows.push(row);
    }
    rows[a.len()][b.len()]
}
