//! Loads missions, workers and scenarios, from files and by name.

use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::file::{self, BYTES_MAX};
use consort_protocol::api::{MissionSource, SubmitRequest};
use consort_protocol::ids::{PlaceId, RobotId, RoleId, TaskId, TaskType};
use consort_protocol::knowledge::{Attributes, Availability, RobotKnowledge};
use consort_protocol::mission::{Format, IhtnFields, MissionDocument, MissionErrors, MissionFileError, is_flat_ihtn};
use consort_protocol::pose::Pose;
use consort_protocol::units::{BatteryShare, MetresPerSecond, Seconds, SharePerSecond};
use consort_skills::descriptor::ESTIMATOR_VERSION;
use consort_skills::missions::NamedMissions;
use schemars::{JsonSchema, Schema, schema_for};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Reads the text of a file.
///
/// # Errors
/// [`Diagnostics`] with the reason why it cannot be read.
pub fn read_text(path: &Path) -> Result<String, Diagnostics> {
    file::read_text(path, BYTES_MAX).map_err(|problem| Diagnostic::for_file(path.display(), problem).into())
}

/// Loads the mission that a word means. `people` are agents of a flat iHTN.
///
/// The same holds for [`mission_request`]: the word is the name of a shipped mission, or else a file, or else the name of
/// a mission of the fleet.
///
/// # Errors
/// [`Diagnostics`] of the file; if it does not exist, with the names of `missions`.
pub fn mission(word: &str, people: &[RoleId], missions: &NamedMissions) -> Result<MissionDocument, Diagnostics> {
    let is_shipped = NamedMissions::default().contains(word);
    if missions.contains(word) && (is_shipped || is_name_of_fleet(word)) {
        return missions.document(word, &ihtn_fields(people)).map_err(|error| Diagnostic::for_file(word, error).into());
    }
    mission_file(existing_file(word, missions)?, people)
}

/// Loads a mission from a file. A flat iHTN gets the name of its file; `people` are agents of it.
///
/// # Errors
/// [`Diagnostics`] of the file.
pub(crate) fn mission_file(path: &Path, people: &[RoleId]) -> Result<MissionDocument, Diagnostics> {
    let text = read_text(path)?;
    let document = MissionDocument::parse(&text, Format::of(Some(path), &text), ihtn_fields(people))
        .map_err(|error| in_mission(&path.display().to_string(), error))?;
    Ok(document.named(ihtn_name(path)))
}

/// Returns a request to the coordinator for a mission: its name, or a whole file as JSON, with the people of a flat
/// iHTN. A word that is no file is the name of a mission of the fleet, which only its nodes know.
///
/// # Errors
/// See [`mission`].
pub fn mission_request(word: &str, people: &[RoleId]) -> Result<SubmitRequest, Diagnostics> {
    let (shipped, fields) = (NamedMissions::default(), ihtn_fields(people));
    let is_shipped = shipped.contains(word);
    if is_shipped {
        mission(word, people, &shipped)?;
    }
    if is_shipped || is_name_of_fleet(word) {
        return Ok(SubmitRequest { people: fields.people, ..SubmitRequest::of(MissionSource::Named(word.to_owned())) });
    }
    let path = existing_file(word, &shipped)?;
    let text = read_text(path)?;
    let file = MissionDocument::request(&text, Format::of(Some(path), &text), fields.clone())
        .map_err(|error| in_mission(word, error))?;
    let own_name = is_flat_ihtn(&file).then(|| ihtn_name(path));
    let source = serde_json::from_value(file).map_err(|error| Diagnostic::for_file(word, error))?;
    Ok(SubmitRequest { name: own_name, people: fields.people, ..SubmitRequest::of(source) })
}

/// Checks whether a word that names no shipped mission can only name a mission of the fleet: there is no such file,
/// and the word has no extension of mission files.
fn is_name_of_fleet(word: &str) -> bool {
    let path = Path::new(word);
    let extension = path.extension().and_then(|extension| extension.to_str());
    TaskId::new(word).is_ok() && !matches!(extension, Some("json" | "yaml" | "yml")) && !path.exists()
}

fn ihtn_fields(people: &[RoleId]) -> IhtnFields {
    IhtnFields { name: None, people: people.iter().cloned().collect() }
}

/// Returns the name of the mission of a flat iHTN, which has none: the name of its file.
pub(crate) fn ihtn_name(path: &Path) -> TaskId {
    let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    TaskId::new(stem).or_else(|_| TaskId::new("mission")).expect("a slug")
}

/// Returns the diagnostics of a mission, one for each problem of a flat iHTN.
fn in_mission(file: &str, error: MissionFileError) -> Diagnostics {
    match error {
        MissionFileError::Ihtn(errors) => mission_diagnostics(file, &errors),
        other => Diagnostic::for_file(file, other).into(),
    }
}

/// Returns a diagnostic for each problem of a mission.
pub(crate) fn mission_diagnostics(file: &str, errors: &MissionErrors) -> Diagnostics {
    Diagnostics(errors.diagnostics.iter().map(|problem| Diagnostic::for_file(file, problem)).collect())
}

/// Returns the path of a mission file.
fn existing_file<'a>(word: &'a str, missions: &NamedMissions) -> Result<&'a Path, Diagnostics> {
    let path = Path::new(word);
    if path.exists() {
        return Ok(path);
    }
    let known = missions.offered().map(|offered| offered.mission.as_str()).collect::<Vec<_>>().join(", ");
    let what = format!("there is no such file, and no mission of this name; missions: {known}");
    Err(Diagnostic::for_file(word, what).into())
}

/// Parses TOML, JSON or YAML, detected by the file's extension, or by the first character.
///
/// # Errors
/// [`Diagnostics`] with line and column.
pub(crate) fn parse_any_format<T: DeserializeOwned>(text: &str, file: &str) -> Result<T, Diagnostics> {
    if file.ends_with(".toml") {
        return toml::from_str(text).map_err(|error| Diagnostic::for_file(file, error.to_string().trim_end()).into());
    }
    let first = text.trim_start_matches('\u{feff}').trim_start().chars().next();
    let json = file.ends_with(".json") || (matches!(first, Some('{' | '[')) && !file.ends_with(".yaml"));
    if json {
        serde_json::from_str(text).map_err(|error| Diagnostic::for_file(file, error).into())
    } else {
        serde_saphyr::from_str(text).map_err(|error| Diagnostic::for_file(file, error).into())
    }
}

/// A worker of a workers file.
///
/// ```toml
/// [[worker]]
/// name = "ada"
/// place = "Dock"
/// skills = ["navigation", "approach_person", "authenticate_person", "operate_drawer", "approach_robot"]
/// speed_mps = 0.15                  # left out: it does not drive
/// battery = 0.9                     # default 1
/// discharge_share_per_s = 0.0004    # default 0
/// useful_charge = 0.08              # the default
/// attributes = { section = "icu" }  # default: none
/// busy_s = 60                       # left out: it holds no role
/// ```
///
/// In JSON and YAML the file is an object with a list `worker`, or just the list.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WorkerEntry {
    /// Its name.
    pub name: RobotId,
    /// Its start place.
    pub place: PlaceId,
    /// The task types of its skills.
    pub skills: BTreeSet<TaskType>,
    /// Its attributes, as in a robot's file.
    #[serde(default)]
    pub attributes: Attributes,
    /// Its average speed in metres per second; none if it does not drive.
    #[serde(default)]
    pub speed_mps: Option<MetresPerSecond>,
    /// Its charge, as a share.
    #[serde(default = "full")]
    pub battery: BatteryShare,
    /// Charge used per second, as a share.
    #[serde(default = "nothing")]
    pub discharge_share_per_s: SharePerSecond,
    /// Charge below which it takes no work, as a share.
    #[serde(default = "crate::config::useful_charge")]
    pub useful_charge: BatteryShare,
    /// Time for which it still holds a role of another mission, in seconds; none if it is free.
    #[serde(default)]
    pub busy_s: Option<Seconds>,
}

fn full() -> BatteryShare {
    BatteryShare::FULL
}

fn nothing() -> SharePerSecond {
    SharePerSecond::new(0.0).expect("0 is a rate")
}

impl WorkerEntry {
    /// Returns the worker's knowledge record, free for work.
    pub(crate) fn worker(&self, places: &BTreeMap<PlaceId, Pose>) -> RobotKnowledge {
        RobotKnowledge {
            skills: self.skills.clone(),
            attributes: self.attributes.clone(),
            place: self.place.clone(),
            // An unknown place causes an error in the estimator, which is reported there.
            pose: places.get(&self.place).copied().unwrap_or_default(),
            battery: self.battery,
            discharge: self.discharge_share_per_s,
            useful_charge: self.useful_charge,
            speed: self.speed_mps,
            availability: Availability::Free,
            estimator: ESTIMATOR_VERSION.to_owned(),
            charging: None,
        }
    }
}

/// Workers for `consort dry-run`.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct WorkersFile {
    /// The workers.
    worker: Vec<WorkerEntry>,
}

/// Returns the JSON Schema of a workers file.
pub(crate) fn workers_schema() -> Schema {
    let mut schema = schema_for!(WorkersFile);
    // In JSON and YAML the list alone is accepted; TOML needs a key.
    let whole =
        ["type", "properties", "required", "additionalProperties"].map(|key| (key.to_owned(), schema.remove(key)));
    let whole: Map<String, Value> = whole.into_iter().filter_map(|(key, value)| Some((key, value?))).collect();
    let list = whole["properties"]["worker"].clone();
    schema.insert("anyOf".to_owned(), Value::Array(vec![Value::Object(whole), list]));
    schema
}

/// Parses a workers file.
///
/// # Errors
/// [`Diagnostics`] of the syntax, of duplicate names, or of an empty list.
pub fn workers(text: &str, file: &str) -> Result<Vec<WorkerEntry>, Diagnostics> {
    let list = !file.ends_with(".toml") && text.trim_start().starts_with(['[', '-']);
    let workers: Vec<WorkerEntry> =
        if list { parse_any_format(text, file)? } else { parse_any_format::<WorkersFile>(text, file)?.worker };
    let mut names = BTreeSet::new();
    let duplicates = workers.iter().filter(|worker| !names.insert(&worker.name));
    let problem = |worker: &WorkerEntry| Diagnostic::for_file(file, format!("worker {} is defined twice", worker.name));
    let mut problems: Vec<Diagnostic> = duplicates.map(problem).collect();
    if workers.is_empty() {
        problems.push(Diagnostic::for_file(file, "there is no worker"));
    }
    Diagnostics::into_result(problems).map(|()| workers)
}

/// A scenario of the published evaluation: the nurse's place, and six robots. Other fields of the
/// file are ignored.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct PublishedScenario {
    /// Its name in the publication.
    pub code: String,
    /// The nurse's place.
    pub room: PlaceId,
    /// The robots.
    pub workers: Vec<WorkerEntry>,
}

#[derive(Deserialize)]
struct ScenarioEntry {
    code: String,
    nurses: Vec<ScenarioNurse>,
    robots: Vec<ScenarioRobot>,
}

#[derive(Deserialize)]
struct ScenarioNurse {
    location: PlaceId,
}

#[derive(Deserialize)]
struct ScenarioRobot {
    name: RobotId,
    location: PlaceId,
    skills: BTreeSet<TaskType>,
    avg_speed: MetresPerSecond,
    battery_charge: BatteryShare,
    battery_discharge_rate: SharePerSecond,
}

/// Parses a file of scenarios in the published format.
///
/// # Errors
/// [`Diagnostics`] of the syntax, or of a scenario without a nurse.
pub fn scenarios(text: &str, file: &str) -> Result<Vec<PublishedScenario>, Diagnostics> {
    let entries: Vec<ScenarioEntry> = parse_any_format(text, file)?;
    let scenario = |entry: ScenarioEntry| {
        let nurse = entry.nurses.into_iter().next();
        let nurse =
            nurse.ok_or_else(|| Diagnostic::for_file(file, format!("scenario {}: there is no nurse", entry.code)))?;
        let worker = |robot: ScenarioRobot| WorkerEntry {
            name: robot.name,
            place: robot.location,
            skills: robot.skills,
            attributes: Attributes::default(),
            speed_mps: Some(robot.avg_speed),
            battery: robot.battery_charge,
            discharge_share_per_s: robot.battery_discharge_rate,
            useful_charge: crate::config::useful_charge(),
            busy_s: None,
        };
        let workers = entry.robots.into_iter().map(worker).collect();
        Ok(PublishedScenario { code: entry.code, room: nurse.location, workers })
    };
    entries.into_iter().map(scenario).collect::<Result<_, Diagnostic>>().map_err(Diagnostics::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file in the folder in which the tests of this crate run. It contains no mission.
    const FILE: &str = "Cargo.toml";

    #[test]
    fn a_file_prevails_over_a_mission_of_the_fleet() {
        let mut missions = NamedMissions::default();
        for name in [FILE, "rounds"] {
            let text = format!(
                "mission: {name}\nroles: {{ r1: {{ kind: managed }} }}\n\
                 root: {{ task: rest, type: wait, roles: [r1], parameters: {{ seconds: \"5\" }} }}\n"
            );
            missions.add(MissionDocument::parse(&text, Format::Yaml, ihtn_fields(&[])).unwrap()).unwrap();
        }
        assert!(mission(FILE, &[], &missions).is_err() && mission_request(FILE, &[]).is_err());
        assert_eq!(mission("rounds", &[], &missions).unwrap().name().as_str(), "rounds");
        let source = mission_request("rounds", &[]).unwrap().mission;
        assert!(matches!(&source, MissionSource::Named(name) if name == "rounds"), "{source:?}");
    }
}
