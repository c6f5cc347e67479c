//! From TOML to configuration, with every unknown key named.

use super::{Problem, Problems};
use consort_protocol::mission::Allowed;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::ops::Range;
use std::path::{Path, PathBuf};
use toml::Spanned;
use toml::de::{DeTable, DeValue, Deserializer};

/// Largest configuration file in bytes. A world of thousands of robots fits.
const BYTES_MAX: u64 = 4 << 20;

/// A kind of configuration file.
pub trait ConfigFile: DeserializeOwned + Serialize {
    /// What it describes, in a word: `fleet`, `robot`.
    const KIND: &'static str;

    /// Makes paths in it relative to `folder`, where the file lies.
    fn settle(&mut self, folder: &Path);

    /// What is wrong beyond the form, if anything: each with the key it is about.
    fn problems(&self) -> Vec<String>;
}

/// Reads a file.
///
/// # Errors
/// [`Problems`] with all that is wrong.
pub fn load<C: ConfigFile>(path: &Path) -> Result<C, Problems> {
    let file = path.display().to_string();
    let unreadable = |problem: std::io::Error| Problem::of(&file, format!("cannot be read: {problem}"));
    let bytes = std::fs::metadata(path).map_err(unreadable)?.len();
    if bytes > BYTES_MAX {
        return Err(Problem::of(&file, format!("{bytes} bytes are more than the {BYTES_MAX} allowed")).into());
    }
    let text = std::fs::read_to_string(path).map_err(unreadable)?;
    let mut config: C = from_text(&text, &file)?;
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    config.settle(absolute.parent().unwrap_or(Path::new("/")));
    Ok(config)
}

/// Reads the text of a file; `file` names it in messages. Paths stay as they are written.
///
/// # Errors
/// [`Problems`]: all unknown keys, or the first thing that is otherwise not of the form, or all that makes no sense.
pub fn from_text<C: ConfigFile>(text: &str, file: &str) -> Result<C, Problems> {
    let place = |span: Option<Range<usize>>| span.map(|span| line_and_column(text, span.start));
    let mut table = DeTable::parse(text).map_err(|error| {
        Problems::from(Problem { file: file.to_owned(), at: place(error.span()), what: error.message().to_owned() })
    })?;
    let mut unknown = vec![];
    let config = loop {
        let error = match C::deserialize(Deserializer::from(table.clone())) {
            Ok(config) => break Ok(config),
            Err(error) => error,
        };
        let key = unknown_key(error.message());
        let what = match &key {
            Some((key, allowed)) => {
                let allowed = Allowed::instead_of(key, allowed);
                format!("unknown key `{key}` in a {} file; {allowed}", C::KIND)
            }
            None => error.message().replace("missing field", "missing key"),
        };
        let problem = Problem { file: file.to_owned(), at: place(error.span()), what };
        // Once an unknown key has been told of, the rest of the file is read without it.
        if key.is_some() && error.span().is_some_and(|span| remove(table.get_mut(), &span)) {
            unknown.push(problem);
        } else {
            break Err(problem);
        }
    };
    match config {
        Ok(config) => {
            unknown.extend(config.problems().into_iter().map(|what| Problem::of(file, what)));
            Problems::unless_none(unknown).map(|()| config)
        }
        Err(problem) => {
            // What is missing may be what was misspelt.
            if unknown.is_empty() || !problem.what.starts_with("missing") {
                unknown.push(problem);
            }
            Err(Problems(unknown))
        }
    }
}

/// The configuration as TOML that can be read back.
pub fn to_toml<C: ConfigFile>(config: &C) -> String {
    toml::to_string(config).expect("configuration consists of tables, lists, texts and numbers")
}

/// The path as seen from `folder`.
pub(super) fn under(folder: &Path, path: &Path) -> PathBuf {
    let joined = folder.join(path);
    // `./` and the like only make messages longer.
    joined.components().collect()
}

/// The key and those allowed in its place, if serde's message tells of an unknown field.
fn unknown_key(message: &str) -> Option<(String, Vec<String>)> {
    let rest = message.strip_prefix("unknown field ")?;
    let mut names = rest.split('`').skip(1).step_by(2).map(str::to_owned);
    Some((names.next()?, names.collect()))
}

fn line_and_column(text: &str, offset: usize) -> (usize, usize) {
    let before = text.get(..offset).unwrap_or(text);
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or_default().chars().count() + 1;
    (line, column)
}

/// Takes the entry whose key stands at `span` out of the table, or out of one below.
fn remove(table: &mut DeTable<'_>, span: &Range<usize>) -> bool {
    let key = table.keys().find(|key| key.span() == *span).cloned();
    if let Some(key) = key {
        return table.remove(&key).is_some();
    }
    fn within(value: &mut Spanned<DeValue<'_>>, span: &Range<usize>) -> bool {
        match value.get_mut() {
            DeValue::Table(table) => remove(table, span),
            DeValue::Array(list) => list.iter_mut().any(|value| within(value, span)),
            _ => false,
        }
    }
    table.iter_mut().any(|(_, value)| within(value, span))
}
