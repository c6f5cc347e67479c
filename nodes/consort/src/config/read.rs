//! Parses TOML configuration and reports every unknown key.

use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::file;
use consort_protocol::mission::Domain;
use consort_text::AllowedNames;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::ops::Range;
use std::path::{Path, PathBuf};
use toml::Spanned;
use toml::de::{DeTable, DeValue, Deserializer};

/// Maximum size of a configuration file in bytes. A world of thousands of robots fits.
const BYTES_MAX: u64 = 4 << 20;

/// Maximum number of problems reported at once. The file is parsed again for each.
const PROBLEMS_MAX: usize = 50;

/// A kind of configuration file.
pub trait ConfigFile: DeserializeOwned + Serialize {
    /// Name of the kind: `fleet`, `robot`.
    const KIND: &'static str;

    /// Resolves paths relative to `folder`, the folder of the file.
    fn resolve_paths(&mut self, folder: &Path);

    /// Returns the semantic problems, each with its key. `domain` contains the known task types.
    fn validate(&self, domain: &Domain) -> Vec<String>;
}

/// Reads a file.
///
/// # Errors
/// [`Diagnostics`] with all problems.
pub fn load<C: ConfigFile>(path: &Path, domain: &Domain) -> Result<C, Diagnostics> {
    load_with(path, |text, file| from_text(text, file, domain))
}

/// Reads a file without its semantic checks, for programs that need a single value of it.
///
/// # Errors
/// [`Diagnostics`] with all unknown keys, or the first other syntax problem.
pub(crate) fn load_unchecked<C: ConfigFile>(path: &Path) -> Result<C, Diagnostics> {
    load_with(path, parse)
}

fn load_with<C: ConfigFile>(
    path: &Path,
    read: impl FnOnce(&str, &str) -> Result<C, Diagnostics>,
) -> Result<C, Diagnostics> {
    let file = path.display().to_string();
    let text = file::read_text(path, BYTES_MAX).map_err(|problem| Diagnostic::for_file(&file, problem))?;
    let mut config = read(&text, &file)?;
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    config.resolve_paths(absolute.parent().unwrap_or(Path::new("/")));
    Ok(config)
}

/// Parses the text of a file; `file` is its name in messages. Paths stay as written.
///
/// # Errors
/// [`Diagnostics`]: all unknown keys, or the first other syntax problem, or all semantic problems.
pub fn from_text<C: ConfigFile>(text: &str, file: &str, domain: &Domain) -> Result<C, Diagnostics> {
    let config: C = parse(text, file)?;
    let problems = config.validate(domain).into_iter().map(|message| Diagnostic::for_file(file, message)).collect();
    Diagnostics::into_result(problems).map(|()| config)
}

/// Parses the text of a file without its semantic checks.
fn parse<C: ConfigFile>(text: &str, file: &str) -> Result<C, Diagnostics> {
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
        let message = match unknown_key(error.message()) {
            Some((key, allowed)) => {
                let allowed = AllowedNames::suggest_for(&key, allowed);
                format!("unknown key `{key}` in a {} file; {allowed}", C::KIND)
            }
            None => error.message().replace("missing field", "missing key"),
        };
        // A missing key may be a misspelt key, or may have been removed below.
        if problems.is_empty() || !message.starts_with("missing") {
            problems.push(Diagnostic { file: file.to_owned(), position: place(error.span()), message });
        }
        // After a problem has been reported, the rest of the file is parsed without it.
        if problems.len() >= PROBLEMS_MAX || !error.span().is_some_and(|span| remove(table.get_mut(), &span)) {
            break None;
        }
    };
    problems.sort_by_key(|problem| problem.position);
    match config {
        Some(config) => Diagnostics::into_result(problems).map(|()| config),
        None => Err(Diagnostics(problems)),
    }
}

/// Writes the configuration as TOML that can be read back.
pub fn to_toml<C: ConfigFile>(config: &C) -> String {
    toml::to_string(config).expect("configuration consists of tables, lists, texts and numbers")
}

/// Resolves a path relative to `folder`.
pub fn join_normalized(folder: &Path, path: &Path) -> PathBuf {
    let joined = folder.join(path);
    // Components like `./` only make messages longer.
    joined.components().collect()
}

/// Resolves a path, if present, relative to `folder`.
pub fn resolve_path(path: &mut Option<PathBuf>, folder: &Path) {
    if let Some(path) = path {
        *path = join_normalized(folder, path);
    }
}

/// Returns the unknown key and the allowed keys, if serde's message reports an unknown field.
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

/// Removes the entry with a key or value at `span` from the table, or from a nested table; for an
/// element of a list of plain values, removes the whole list.
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
    use consort_skills::extensions::Extensions;

    fn domain() -> Domain {
        Extensions::default().domain()
    }

    fn messages<C: ConfigFile>(text: &str) -> Vec<String> {
        let problems = from_text::<C>(text, "f.toml", &domain()).err().map(|problems| problems.0).unwrap_or_default();
        problems.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn every_mistake_is_reported_with_line_and_allowed_keys() {
        let text = "nam = \"x\"\nmap = \"hospital\"\n[lease]\nlase_ms = 3\n[limits]\ncharge_min = 3\n";
        assert_eq!(
            messages::<FleetConfig>(text),
            [
                "f.toml:1:1: unknown key `nam` in a fleet file; allowed: name, map, calibration, bootstrap_expect, \
                 timing, voters, planned_nodes, dead_after_ms, link_lease_ms, stall_after_s, domains, missions, dashboards, limits, requests, history, lease, auction, charging, zones, alarms, device, ensemble; did you mean `name`?",
                "f.toml:4:1: unknown key `lase_ms` in a fleet file; allowed: lease_ms, grace_ms; did you mean `lease_ms`?",
                "f.toml:6:14: 3 is not a battery share: allowed is a number from 0 (empty) to 1 (full)",
            ]
        );
    }

    #[test]
    fn keys_in_lists_of_tables_are_checked_too() {
        let text = "[[robot]]\nid = \"a\"\nplace = \"Dock\"\nspeed_mps = 1\nbattery = 1\ndischarge_share_per_s = 0\nwheels = 3\n";
        let messages = messages::<WorldConfig>(text);
        assert_eq!(messages.len(), 1);
        assert!(
            messages[0].starts_with("f.toml:7:1: unknown key `wheels` in a world file; allowed: id, place, "),
            "{messages:?}"
        );
    }

    #[test]
    fn missing_keys_and_invalid_values_are_reported() {
        assert_eq!(messages::<RobotConfig>("name = \"a\"\nskills = []"), ["f.toml:1:1: missing key `place`"]);
        let text = "name = \"a\"\nplace = \"Dock\"\nskills = [\"navigation\", \"fly\"]\n[bus]\nconnect = [\"udp/x\"]";
        let messages = messages::<RobotConfig>(text);
        assert!(messages[0].starts_with("f.toml: skills: there are no tasks of type `fly`; allowed: "), "{messages:?}");
        assert_eq!(messages[1], "f.toml: speed_mps: is missing, and the robot has the skill `navigation`");
        assert!(messages[2].starts_with("f.toml: bus.connect: \"udp/x\": the protocol is tcp"), "{messages:?}");
    }

    #[test]
    fn limits_of_promises_are_checked() {
        let text = "[auction]\nhorizon_s = 0\ndelay_s = 700000\nlate_s = 0\ngain_s = 0\n\
                    ahead_s = 700000\nobjective = \"weighted\"\nbattery_s = 0\n";
        assert_eq!(
            messages::<FleetConfig>(text),
            [
                "f.toml: auction.horizon_s is 0, allowed is 1 to 604800",
                "f.toml: auction.delay_s is 700000, allowed is 0 to 604800",
                "f.toml: auction.late_s is 0, allowed is 1 to 604800",
                "f.toml: auction.gain_s is 0, allowed is 1 to 604800",
                "f.toml: auction.ahead_s is 700000, allowed is 0 to 604800",
                "f.toml: auction.battery_s is 0, allowed is 1 to 1000000",
            ]
        );
    }

    #[test]
    fn a_printed_configuration_reads_back_the_same() {
        let mut robot: RobotConfig = from_text(
            "name = \"a\"\nplace = \"Dock\"\nskills = [\"pick_up\"]\nfleet = \"x/fleet.toml\"",
            "f.toml",
            &domain(),
        )
        .unwrap();
        robot.resolve_paths(Path::new("/etc/consort"));
        assert_eq!(robot.fleet, super::super::FleetRef::File("/etc/consort/x/fleet.toml".into()));
        assert_eq!(from_text::<RobotConfig>(&to_toml(&robot), "f.toml", &domain()).unwrap(), robot);
        robot.fleet = super::super::FleetRef::default();
        assert_eq!(from_text::<RobotConfig>(&to_toml(&robot), "f.toml", &domain()).unwrap(), robot);
    }
}
