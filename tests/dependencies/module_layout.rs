//! Layout of modules: a module with files below it is `name/mod.rs`, and its unit tests stand at
//! the end of its file, or in `name/tests.rs` if they are long.

use std::fs;
use std::path::{Path, PathBuf};

/// Most lines of unit tests at the end of a file.
const INLINE_TEST_LINES_MAX: usize = 150;

/// Returns a text for each file below a folder with another layout.
pub(crate) fn violations(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for file in rust_files(folder) {
        let at = file.display();
        let below = rust_files(&file.with_extension(""));
        if !below.is_empty() {
            found.push(format!("{at}: move it to {}", file.with_extension("").join("mod.rs").display()));
        }
        let text = fs::read_to_string(&file).unwrap_or_else(|problem| panic!("{at}: {problem}"));
        let lines: Vec<&str> = text.lines().collect();
        let Some(tests) = lines.iter().position(|line| *line == "mod tests {") else { continue };
        let length = lines[tests..].iter().position(|line| *line == "}").map_or(0, |end| end + 1);
        if tests + length != lines.len() {
            found.push(format!("{at}: there is code after the unit tests, in line {}", tests + length + 1));
        }
        if length > INLINE_TEST_LINES_MAX {
            found.push(format!("{at}: move its {length} lines of unit tests to tests.rs"));
        }
    }
    found
}

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = files(folder);
    files.retain(|file| file.extension().is_some_and(|extension| extension == "rs"));
    files
}

/// Returns the files below a folder, sorted; none if there is no such folder.
pub(crate) fn files(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    let paths = entries.map(|entry| entry.expect("an entry of a folder").path());
    let mut found: Vec<PathBuf> = Vec::new();
    for path in paths {
        if path.is_dir() {
            found.extend(files(&path));
        } else {
            found.push(path);
        }
    }
    found.sort();
    found
}
