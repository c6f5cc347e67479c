//! Whether files are right, each judged by what it is.

use crate::config::{self, FleetConfig, Problem, Problems, RobotConfig, StationConfig, WorldConfig};
use crate::evaluation::{Evaluation, Instead};
use crate::{floor, kit, source, wiring};
use consort_protocol::count::count;
use consort_protocol::ids::TaskId;
use consort_protocol::mission::{Format, IhtnReading, Mission, MissionTemplate, TemplateKind, import_ihtn};
use consort_protocol::plan::divide_and_check;
use consort_sim::experiment::calibration::Calibration;
use consort_sim::map::MapForm;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;

/// What a file can be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Kind {
    /// A mission, in YAML or JSON.
    Mission,
    /// A mission in the flat iHTN form of the MissionControl replication package.
    Ihtn,
    /// A map, in YAML or JSON, as a drawing or as an Open-RMF building.
    Map,
    /// A fleet, in TOML.
    Fleet,
    /// A robot's node, in TOML.
    Robot,
    /// A node without a robot, in TOML.
    Station,
    /// A world's node, in TOML.
    World,
    /// Workers for `dry-run`.
    Workers,
    /// Scenarios of the published evaluation.
    Scenarios,
    /// The design of an evaluation, in TOML.
    Design,
    /// What robots have learned of their estimates, in TOML.
    Calibration,
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Kind::Mission => "a mission",
            Kind::Ihtn => "a flat iHTN",
            Kind::Map => "a map",
            Kind::Fleet => "a fleet",
            Kind::Robot => "a robot",
            Kind::Station => "a station",
            Kind::World => "a world",
            Kind::Workers => "workers",
            Kind::Scenarios => "scenarios",
            Kind::Design => "a design",
            Kind::Calibration => "a calibration",
        })
    }
}

/// Checks a file; the answer says in a few words what it is.
///
/// # Errors
/// [`Problems`] with all that was found.
pub fn check(path: &Path, kind: Option<Kind>) -> Result<String, Problems> {
    let file = path.display().to_string();
    let text = source::text(path)?;
    let kind = match kind {
        Some(kind) => kind,
        None => recognise(&text, &file)?,
    };
    // Problems of what a file refers to come without a file of their own.
    judge(kind, path, &text, &file).map(|what| format!("{kind}: {what}")).map_err(|mut problems| {
        for problem in problems.0.iter_mut().filter(|problem| problem.file.is_empty()) {
            problem.file.clone_from(&file);
        }
        problems
    })
}

/// What a file is, by its content.
///
/// # Errors
/// [`Problems`] if it cannot be read, or is nothing that is known.
pub fn kind_of(path: &Path) -> Result<Kind, Problems> {
    recognise(&source::text(path)?, &path.display().to_string())
}

fn judge(kind: Kind, path: &Path, text: &str, file: &str) -> Result<String, Problems> {
    match kind {
        Kind::Mission => mission(text, path, file),
        Kind::Ihtn => ihtn(text, path, file),
        Kind::Map => {
            let floor = floor::read(text, file)?;
            wiring::equipment(&floor)?;
            let (places, ways) = (floor.topology.places.len(), floor.topology.edges.len());
            Ok(format!("{}, {}", count(places, "place", "places"), count(ways, "way", "ways")))
        }
        Kind::Fleet => {
            let fleet: FleetConfig = config::load(path)?;
            wiring::fleet_settings(&fleet)?;
            wiring::fleet_equipment(&fleet)?;
            Ok(fleet.name.to_string())
        }
        Kind::Robot => {
            let robot: RobotConfig = config::load(path)?;
            let equipment = wiring::fleet_equipment(&robot.fleet.resolve()?)?;
            wiring::worker(&robot, &equipment.places)?;
            Ok(robot.name.to_string())
        }
        Kind::Station => {
            let station: StationConfig = config::load(path)?;
            wiring::fleet_settings(&station.fleet.resolve()?)?;
            Ok(station.name.to_string())
        }
        Kind::World => {
            let world: WorldConfig = config::load(path)?;
            wiring::build_world(&world, &world.fleet.resolve()?)?;
            let robots = count(world.robot.len(), "robot", "robots");
            Ok(format!("{robots}, {}", count(world.person.len(), "person", "people")))
        }
        Kind::Workers => source::workers(text, file).map(|workers| format!("{} of them", workers.len())),
        Kind::Scenarios => source::scenarios(text, file).map(|scenarios| format!("{} of them", scenarios.len())),
        Kind::Design => {
            let evaluation = Evaluation::of(config::load(path)?, &Instead::default())?;
            let design = &evaluation.design;
            evaluation.stage(design.clone(), None)?;
            let trials = evaluation.scenarios.len() * design.policies.len() * design.treatments.len();
            let trials = count(trials * design.repetitions as usize, "trial", "trials");
            Ok(format!("{}, {trials}", design.name))
        }
        Kind::Calibration => {
            let learned: Calibration = config::load(path)?;
            let skills = count(learned.skills.len(), "skill", "skills");
            Ok(format!("{skills}, {}", count(learned.legs.len(), "leg", "legs")))
        }
    }
}

/// A mission is judged with its defaults; what has none is given a value of its kind.
fn mission(text: &str, path: &Path, file: &str) -> Result<String, Problems> {
    let template = MissionTemplate::parse(text, Format::of(Some(path), text))
        .map_err(|error| Problems::from(Problem::of(file, error)))?;
    let open = template.parameters().iter().filter(|(_, parameter)| parameter.default.is_none());
    let sample = |kind: TemplateKind| match kind {
        TemplateKind::Place => "Some Place",
        TemplateKind::Seconds => "1",
        TemplateKind::Text => "some text",
    };
    let given: BTreeMap<String, String> =
        open.map(|(name, parameter)| (name.clone(), sample(parameter.kind).to_owned())).collect();
    let (mission, recovery) = template
        .instantiate_both(&given, &kit::domain())
        .map_err(|errors| Problems(errors.problems.iter().map(|problem| Problem::of(file, problem)).collect()))?;
    let recovery = recovery.map(|recovery| size(&recovery, file)).transpose()?;
    let of_recovery = recovery.map(|size| format!(", recovery with {size}"));
    Ok(format!("{}, {}{}", template.name(), size(&mission, file)?, of_recovery.unwrap_or_default()))
}

/// A flat iHTN does not say who is a person: `nurse` is taken for one.
fn ihtn(text: &str, path: &Path, file: &str) -> Result<String, Problems> {
    let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let name = TaskId::new(stem).or_else(|_| TaskId::new("mission")).expect("a slug");
    let slug = |text: &str| text.parse().expect("a slug");
    let reading = IhtnReading {
        name,
        unmanaged: BTreeSet::from(["nurse".parse().expect("a slug")]),
        aliases: BTreeMap::from([("navto".to_owned(), slug("navigation"))]),
    };
    let mission = import_ihtn(text, &reading, &kit::domain())
        .map_err(|errors| Problems(errors.problems.iter().map(|problem| Problem::of(file, problem)).collect()))?;
    size(&mission, file)
}

/// How large a mission is, once it has been found to be one that can be carried out.
fn size(mission: &Mission, file: &str) -> Result<String, Problems> {
    let division = divide_and_check(mission).map_err(|error| Problems::from(Problem::of(file, error)))?;
    let steps = division.plans.values().map(|plan| plan.steps.len()).sum();
    let roles = count(mission.roles.len(), "role", "roles");
    Ok(format!("{roles}, {}", count::<usize>(steps, "step", "steps")))
}

/// What kind of file a text is.
fn recognise(text: &str, file: &str) -> Result<Kind, Problems> {
    if file.ends_with(".toml") {
        return recognise_toml(text, file);
    }
    if MapForm::of(file).is_foreign() {
        return Ok(Kind::Map);
    }
    let value: Value = source::any_format(text, file)?;
    let all_tasks = |map: &serde_json::Map<String, Value>| {
        !map.is_empty() && map.values().all(|node| node.get("parent").is_some() && node.get("type").is_some())
    };
    match &value {
        Value::Array(list) if list.iter().any(|entry| entry.get("robots").is_some()) => Ok(Kind::Scenarios),
        Value::Array(list) if list.iter().any(|entry| entry.get("skills").is_some()) => Ok(Kind::Workers),
        Value::Object(map) => {
            let has = |keys: &[&str]| keys.iter().any(|key| map.contains_key(*key));
            if has(&["mission", "root"]) {
                Ok(Kind::Mission)
            } else if has(&["places", "lanes"]) || (has(&["nodes"]) && has(&["edges"])) {
                Ok(Kind::Map)
            } else if has(&["worker"]) {
                Ok(Kind::Workers)
            } else if all_tasks(map) {
                Ok(Kind::Ihtn)
            } else {
                Err(unknown(file, "a mission has `mission` and `root`, a map `places` and `lanes`"))
            }
        }
        _ => Err(unknown(file, "a mission has `mission` and `root`, a map `places` and `lanes`")),
    }
}

fn unknown(file: &str, hint: &str) -> Problems {
    Problem::of(file, format!("it cannot be told what this file is: {hint}; --kind says it")).into()
}

/// A TOML file is of the kind that has most of its keys.
fn recognise_toml(text: &str, file: &str) -> Result<Kind, Problems> {
    let table: toml::Table = text.parse().map_err(|_| {
        // Any kind will do to say where the text is not TOML.
        config::from_text::<FleetConfig>(text, file).err().unwrap_or_else(|| unknown(file, "it is not TOML"))
    })?;
    // Keys by which a kind is known. Robots and stations share most of theirs: a robot has a place and skills.
    const MARKS: [(Kind, &[&str]); 6] = [
        (Kind::Workers, &["worker"]),
        (Kind::World, &["robot", "person", "seed", "speed", "durations"]),
        (Kind::Robot, &["place", "skills", "speed_mps", "battery", "discharge_share_per_s", "useful_charge"]),
        (
            Kind::Fleet,
            &[
                "map",
                "calibration",
                "bootstrap_expect",
                "timing",
                "voters",
                "dead_after_ms",
                "link_lease_ms",
                "stall_after_s",
                "limits",
                "requests",
                "lease",
                "auction",
                "ensemble",
            ],
        ),
        (Kind::Design, &["repetitions", "policies", "treatments", "mission", "robots", "fixed", "factors", "travel"]),
        (Kind::Calibration, &["quantile", "to", "from", "legs"]),
    ];
    const STATION: &[&str] = &["fleet", "stationary", "mains_powered", "may_vote", "bus"];
    let count = |marks: &[&str]| marks.iter().filter(|mark| table.contains_key(**mark)).count();
    // Of equal counts the first kind wins; a station is what is left.
    let most = MARKS.iter().map(|(kind, marks)| (count(marks), *kind)).rev().max_by_key(|(count, _)| *count);
    match most {
        Some((1.., kind)) => Ok(kind),
        _ if count(STATION) > 0 => Ok(Kind::Station),
        _ if table.contains_key("name") => Ok(Kind::Fleet),
        _ => Err(unknown(
            file,
            "none of its keys is one of a fleet, robot, station, world, workers, design or calibration file",
        )),
    }
}
