//! From TOML to configuration, with every unknown key named.

use super::{Diagnostic, Diagnostics};
use crate::file;
use consort_protocol::mission::AllowedNames;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::ops::Range;
use std::path::{Path, PathBuf};
use toml::Spanned;
use toml::de::{DeTable, DeValue, Deserializer};

/// Largest configuration file in bytes. A world of thousands of robots fits.
const BYTES_MAX: u64 = 4 << 20;

/// Most mistakes that are told of at once. For each the file is read anew.
const PROBLEMS_MAX: usize = 50;

/// A kind of configuration file.
pub trait ConfigFile: DeserializeOwned + Serialize {
    /// What it describes, in a word: `fleet`, `robot`.
    const KIND: &'static str;

    /// Makes paths in it relative to `folder`, where the file lies.
    fn resolve_paths(&mut self, folder: &Path);

    /// What is wrong beyond the form, if anything: each with the key it is about.
    fn validate(&self) -> Vec<String>;
}

/// Reads a file.
///
/// # Errors
/// [`Problems`] with all that is wrong.
pub fn load<C: ConfigFile>(path: &Path) -> Result<C, Diagnostics> {
    let file = path.display().to_string();
    let text = file::read_text(path, BYTES_MAX).map_err(|problem| Diagnostic::for_file(&file, problem))?;
    let mut config: C = from_text(&text, &file)?;
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    config.resolve_paths(absolute.parent().unwrap_or(Path::new("/")));
    Ok(config)
}

/// Reads the text of a file; `file` names it in messages. Paths stay as they are written.
///
/// # Errors
/// [`Problems`]: all unknown keys, or the first thing that is otherwise not of the form, or all that makes no sense.
pub fn from_text<C: ConfigFile>(text: &str, file: &str) -> Result<C, Diagnostics> {
    let place = |span: Option<Range<usize>>| span.map(|span| line_and_column(text, span.start));
    let mut table = DeTable::parse(text).map_err(|error| {
        Diagnostics::from(Diagnostic {
            file: file.to_owned(),
            position: place(error.span()),
            message: error.message().to_owned(),
        })
    })?;
    let mut problems: Vec<Diagnostic> = vec![];
    let config = loop {
        let error = match C::deserialize(Deserializer::from(table.clone())) {
            Ok(config) => break Some(config),
            Err(error) => error,
        };
        let what = match unknown_key(error.message()) {
            Some((key, allowed)) => {
                let allowed = AllowedNames::suggest_for(&key, allowed);
                format!("unknown key `{key}` in a {} file; {allowed}", C::KIND)
            }
            None => error.message().replace("missing field", "missing key"),
        };
        // What is missing may be what was misspelt, or has been taken out below.
        if problems.is_empty() || !what.starts_with("missing") {
            problems.push(Diagnostic { file: file.to_owned(), position: place(error.span()), message: what });
        }
        // Once a mistake has been told of, the rest of the file is read without it.
        if problems.len() >= PROBLEMS_MAX || !error.span().is_some_and(|span| remove(table.get_mut(), &span)) {
            break None;
        }
    };
    problems.sort_by_key(|problem| problem.position);
    match config {
        Some(config) => {
            if problems.is_empty() {
                problems.extend(config.validate().into_iter().map(|what| Diagnostic::for_file(file, what)));
            }
            Diagnostics::into_result(problems).map(|()| config)
        }
        None => Err(Diagnostics(problems)),
    }
}

/// The configuration as TOML that can be read back.
pub fn to_toml<C: ConfigFile>(config: &C) -> String {
    toml::to_string(config).expect("configuration consists of tables, lists, texts and numbers")
}

/// The path as seen from `folder`.
pub(super) fn join_normalized(folder: &Path, path: &Path) -> PathBuf {
    let joined = folder.join(path);
    // `./` and the like only make messages longer.
    joined.components().collect()
}

/// Makes a path, if there is one, relative to `folder`.
pub(super) fn resolve_path(path: &mut Option<PathBuf>, folder: &Path) {
    if let Some(path) = path {
        *path = join_normalized(folder, path);
    }
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

/// Takes the entry whose key or value stands at `span` out of the table, or out of one below; for an element of a list
/// of plain values, the whole list.
fn remove(table: &mut DeTable<'_>, span: &Range<usize>) -> bool {
    let is_here = |value: &Spanned<DeValue<'_>>| match value.get_ref() {
        DeValue::Array(list) => list.iter().any(|element| element.span() == *span),
        _ => false,
    };
    let here = table.iter().find(|(key, value)| key.span() == *span || value.span() == *span || is_here(value));
    if let Some(key) = here.map(|(key, _)| key.clone()) {
        return table.remove(&key).is_some();
    }
    table.iter_mut().any(|(_, value)| match value.get_mut() {
        DeValue::Table(table) => remove(table, span),
        DeValue::Array(list) => list.iter_mut().any(|element| match element.get_mut() {
            DeValue::Table(table) => remove(table, span),
            _ => false,
        }),
        _ => false,
    })
}

#[cfg(test)]
mod tests {
    use super::super::{FleetConfig, RobotConfig, WorldConfig};
    use super::*;

    fn said<C: ConfigFile>(text: &str) -> Vec<String> {
        let problems = from_text::<C>(text, "f.toml").err().map(|problems| problems.0).unwrap_or_default();
        problems.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn every_mistake_is_told_of_with_line_and_what_is_allowed() {
        let text = "nam = \"x\"\nmap = \"hospital\"\n[lease]\nlase_ms = 3\n[limits]\ncharge_min = 3\n";
        assert_eq!(
            said::<FleetConfig>(text),
            [
                "f.toml:1:1: unknown key `nam` in a fleet file; allowed: name, map, calibration, bootstrap_expect, \
                 timing, voters, dead_after_ms, link_lease_ms, stall_after_s, limits, requests, lease, auction, ensemble; did you mean `name`?",
                "f.toml:4:1: unknown key `lase_ms` in a fleet file; allowed: lease_ms, grace_ms; did you mean `lease_ms`?",
                "f.toml:6:14: 3 is not a battery share: allowed is a number from 0 (empty) to 1 (full)",
            ]
        );
    }

    #[test]
    fn keys_in_lists_of_tables_are_known_too() {
        let text = "[[robot]]\nid = \"a\"\nplace = \"Dock\"\nspeed_mps = 1\nbattery = 1\ndischarge_share_per_s = 0\nwheels = 3\n";
        let said = said::<WorldConfig>(text);
        assert_eq!(said.len(), 1);
        assert!(
            said[0].starts_with("f.toml:7:1: unknown key `wheels` in a world file; allowed: id, place, "),
            "{said:?}"
        );
    }

    #[test]
    fn what_is_missing_and_what_makes_no_sense_is_told() {
        assert_eq!(said::<RobotConfig>("name = \"a\"\nskills = []"), ["f.toml:1:1: missing key `place`"]);
        let text = "name = \"a\"\nplace = \"Dock\"\nskills = [\"navigation\", \"fly\"]\n[bus]\nconnect = [\"udp/x\"]";
        let said = said::<RobotConfig>(text);
        assert!(said[0].starts_with("f.toml: skills: there are no tasks of type `fly`; allowed: "), "{said:?}");
        assert_eq!(said[1], "f.toml: speed_mps: is missing, and the robot has the skill `navigation`");
        assert!(said[2].starts_with("f.toml: bus.connect: \"udp/x\": the protocol is tcp"), "{said:?}");
    }

    #[test]
    fn what_is_printed_reads_back_the_same() {
        let mut robot: RobotConfig =
            from_text("name = \"a\"\nplace = \"Dock\"\nskills = [\"pick_up\"]\nfleet = \"x/fleet.toml\"", "f.toml")
                .unwrap();
        robot.resolve_paths(Path::new("/etc/consort"));
        assert_eq!(robot.fleet, super::super::FleetRef::File("/etc/consort/x/fleet.toml".into()));
        assert_eq!(from_text::<RobotConfig>(&to_toml(&robot), "f.toml").unwrap(), robot);
        robot.fleet = super::super::FleetRef::default();
        assert_eq!(from_text::<RobotConfig>(&to_toml(&robot), "f.toml").unwrap(), robot);
    }
}
