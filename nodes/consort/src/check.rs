//! Checks files, each by its kind.

use crate::config::{self, FleetConfig, LinkRole, NodeFile, RobotConfig, StationConfig, WorldConfig, load_unchecked};
use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::{domains, inputs, map_loader, mission_files, wiring};
use consort_map_import::MapFormat;
use consort_protocol::ids::RoleId;
use consort_protocol::mission::{Format, IhtnOptions, MissionDocument, MissionTemplate, is_flat_ihtn};
use consort_skills::bt::xml::read_xml;
use consort_skills::bt::{NodeOrigin, TreeError, report_nodes};
use consort_skills::descriptor::Calibration;
use consort_skills::domain::standard_domain;
use consort_skills::domain_file::{DomainFile, action_of_people};
use consort_skills::extensions::Extensions;
use consort_text::count;
use consort_world::world::{SetupErrors, check_simulated_actions};
use serde_json::Value;
use std::fmt;
use std::path::Path;

/// Kind of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum FileKind {
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
    /// Corrections to robots' estimates, learned from experiments, in TOML.
    Calibration,
    /// A domain: actions and task types, in YAML.
    Domain,
    /// A behavior tree, in the XML of BehaviorTree.CPP 4.
    Tree,
}

impl fmt::Display for FileKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            FileKind::Mission => "a mission",
            FileKind::Ihtn => "a flat iHTN",
            FileKind::Map => "a map",
            FileKind::Fleet => "a fleet",
            FileKind::Robot => "a robot",
            FileKind::Station => "a station",
            FileKind::World => "a world",
            FileKind::Workers => "workers",
            FileKind::Scenarios => "scenarios",
            FileKind::Design => "a design",
            FileKind::Calibration => "a calibration",
            FileKind::Domain => "a domain",
            FileKind::Tree => "a tree",
        })
    }
}

/// Checks a file and returns a short description of its content. `people` are agents of a flat iHTN.
///
/// # Errors
/// [`Diagnostics`] with all problems found.
pub fn check_file(
    path: &Path,
    kind: Option<FileKind>,
    people: &[RoleId],
    extensions: Extensions,
) -> Result<String, Diagnostics> {
    let file = path.display().to_string();
    let text = inputs::read_text(path)?;
    let kind = match kind {
        Some(kind) => kind,
        None => detect(&text, &file)?,
    };
    // Problems of a referenced object come without a file name.
    check_kind(kind, path, &text, people, extensions)
        .map(|what| format!("{kind}: {what}"))
        .map_err(|problems| problems.with_file(&file))
}

/// Detects the kind of a file by its content.
///
/// # Errors
/// [`Diagnostics`] if the file cannot be read, or is of no known kind.
pub fn detect_kind(path: &Path) -> Result<FileKind, Diagnostics> {
    detect(&inputs::read_text(path)?, &path.display().to_string())
}

fn check_kind(
    kind: FileKind,
    path: &Path,
    text: &str,
    people: &[RoleId],
    extensions: Extensions,
) -> Result<String, Diagnostics> {
    let file = &*path.display().to_string();
    match kind {
        FileKind::Mission => mission(text, path, extensions),
        FileKind::Ihtn => ihtn(text, path, people, extensions),
        FileKind::Map => {
            let floor = map_loader::parse(text, file)?;
            wiring::skill_resources(&floor, extensions)?;
            let (places, ways) = (floor.topology.places.len(), floor.topology.edges.len());
            Ok(format!("{}, {}", count(places, "place", "places"), count(ways, "way", "ways")))
        }
        FileKind::Fleet => {
            let (fleet, extensions) = fleet_file(path, extensions)?;
            wiring::fleet_settings(&fleet, extensions)?;
            wiring::fleet_skill_resources(&fleet, None, extensions)?;
            Ok(fleet.name.to_string())
        }
        FileKind::Robot => {
            let (robot, fleet, extensions): (RobotConfig, _, _) = node_file(path, extensions)?;
            wiring::fleet_settings(&fleet, extensions)?;
            let equipment = wiring::fleet_skill_resources(&fleet, robot.graph.as_deref(), extensions)?;
            wiring::worker(&robot, &equipment.places)?;
            describe_node(robot, &fleet)
        }
        FileKind::Station => {
            let (station, fleet, extensions): (StationConfig, _, _) = node_file(path, extensions)?;
            wiring::fleet_settings(&fleet, extensions)?;
            describe_node(station, &fleet)
        }
        FileKind::World => {
            let (world, fleet, extensions): (WorldConfig, _, _) = node_file(path, extensions)?;
            wiring::fleet_settings(&fleet, extensions)?;
            wiring::build_world(&world, &fleet, extensions)?;
            let robots = count(world.robot.len(), "robot", "robots");
            let people = count(world.person.len(), "person", "people");
            describe_node(world, &fleet)?;
            Ok(format!("{robots}, {people}"))
        }
        FileKind::Workers => inputs::workers(text, file).map(|workers| format!("{} of them", workers.len())),
        FileKind::Scenarios => inputs::scenarios(text, file).map(|scenarios| format!("{} of them", scenarios.len())),
        FileKind::Design => {
            Err(Diagnostic::for_file(file, "designs of evaluations are checked by consort-lab check").into())
        }
        FileKind::Tree => tree(text, file, extensions),
        FileKind::Domain => {
            let domain = domains::parse(path, text, Extensions::default())?;
            check_simulated_actions(&domain, extensions).map_err(|SetupErrors(errors)| {
                Diagnostics(errors.iter().map(|error| Diagnostic::for_file(file, error)).collect())
            })?;
            let (actions, tasks) = (domain.actions().count(), domain.task_types().count());
            let (actions, tasks) = (count(actions, "action", "actions"), count(tasks, "task type", "task types"));
            let readings = match domain.reading_forms().count() {
                0 => String::new(),
                number => format!("{}, ", count(number, "reading", "readings")),
            };
            Ok(format!("{actions}, {readings}{tasks}, content {}", domain.reference().hash))
        }
        FileKind::Calibration => {
            let learned: Calibration = config::load(path, &extensions.domain())?;
            let skills = count(learned.skills.len(), "skill", "skills");
            Ok(format!("{skills}, {}", count(learned.legs.len(), "leg", "legs")))
        }
    }
}

/// Reads a fleet file. Returns it with the fleet's domains.
///
/// # Errors
/// [`Diagnostics`] of the files.
pub(crate) fn fleet_file(path: &Path, extensions: Extensions) -> Result<(FleetConfig, Extensions), Diagnostics> {
    let extensions = domains::with_files(extensions, &load_unchecked::<FleetConfig>(path)?.domains)?;
    let fleet = config::load(path, &extensions.domain())?;
    Ok((fleet, extensions))
}

/// Reads the file of a node and the fleet that it names. Returns them with the fleet's domains.
///
/// # Errors
/// [`Diagnostics`] of the files.
pub(crate) fn node_file<C: NodeFile>(
    path: &Path,
    extensions: Extensions,
) -> Result<(C, FleetConfig, Extensions), Diagnostics> {
    let mut unchecked: C = load_unchecked(path)?;
    let fleet = unchecked.common_mut().fleet.resolve_unchecked()?;
    let extensions = domains::with_files(extensions, &fleet.domains)?;
    let domain = extensions.domain();
    let mut node: C = config::load(path, &domain)?;
    let fleet = node.common_mut().fleet.resolve(&domain)?;
    Ok((node, fleet, extensions))
}

/// Describes a node: its name, and its relays if it does not relay.
fn describe_node<C: NodeFile>(mut node: C, fleet: &FleetConfig) -> Result<String, Diagnostics> {
    let name = node.node();
    let role = node.common_mut().link_role(&name, fleet);
    Ok(match role.map_err(|problem| Diagnostic::for_file("", problem))? {
        LinkRole::Relay(_) => name.to_string(),
        client @ LinkRole::Client(..) => format!("{name}, {client}"),
    })
}

/// Checks a tree. If no domain declares some of its nodes, as in a tree for another program, every such node
/// is reported; otherwise the first mistake.
fn tree(text: &str, file: &str, extensions: Extensions) -> Result<String, Diagnostics> {
    let in_file = |problem: &TreeError| Diagnostics::from(Diagnostic::for_file("", problem));
    let spec = read_xml(file, text).map_err(|problem| in_file(&problem))?;
    let library = domains::library(extensions)?;
    let nodes = report_nodes(&spec, library.registry());
    let unknown = nodes.iter().filter_map(|node| match &node.origin {
        NodeOrigin::Unknown { nearest } => {
            let hint = nearest.as_ref().map_or_else(String::new, |name| format!("; did you mean `{name}`?"));
            let position = node.line.map(|line| (usize::try_from(line).unwrap_or(usize::MAX), 1));
            let message = format!("no domain declares the node `{}`{hint}", node.id);
            Some(Diagnostic { file: file.to_owned(), position, message })
        }
        NodeOrigin::BuiltIn | NodeOrigin::Registered | NodeOrigin::Tree => None,
    });
    Diagnostics::into_result(unknown.collect())?;
    library.registry().check(&spec).map_err(|problem| in_file(&problem))?;
    let actions = extensions.files().chain([standard_domain()]).flat_map(DomainFile::action_forms);
    if let Some(problem) = action_of_people(&spec, actions) {
        return Err(in_file(&problem));
    }
    Ok(format!("{}, {}", spec.main, count(nodes.len(), "node", "nodes")))
}

/// Checks a mission file.
fn mission(text: &str, path: &Path, extensions: Extensions) -> Result<String, Diagnostics> {
    let file = &*path.display().to_string();
    let template = MissionTemplate::parse(text, Format::of(Some(path), text))
        .map_err(|error| Diagnostics::from(Diagnostic::for_file(file, error)))?;
    let document = MissionDocument::Template(Box::new(template));
    let library = domains::library(extensions)?;
    let description = mission_files::describe(&document, file, &extensions.domain(), &library)?;
    Ok(format!("{}, {description}", document.name()))
}

/// Checks a flat iHTN with these people and those of the domain.
fn ihtn(text: &str, path: &Path, people: &[RoleId], extensions: Extensions) -> Result<String, Diagnostics> {
    let options = IhtnOptions { name: inputs::ihtn_name(path), people: people.iter().cloned().collect() };
    let document = MissionDocument::Ihtn { text: text.to_owned(), options };
    let library = domains::library(extensions)?;
    mission_files::describe(&document, &path.display().to_string(), &extensions.domain(), &library)
}

/// Detects the kind of a text.
fn detect(text: &str, file: &str) -> Result<FileKind, Diagnostics> {
    if file.ends_with(".toml") {
        return detect_toml(text, file);
    }
    if text.contains("BTCPP_format") {
        return Ok(FileKind::Tree);
    }
    if MapFormat::of(file).is_foreign() {
        return Ok(FileKind::Map);
    }
    let value: Value = inputs::parse_any_format(text, file)?;
    match &value {
        Value::Array(list) if list.iter().any(|entry| entry.get("robots").is_some()) => Ok(FileKind::Scenarios),
        Value::Array(list) if list.iter().any(|entry| entry.get("skills").is_some()) => Ok(FileKind::Workers),
        Value::Object(map) => {
            let has = |keys: &[&str]| keys.iter().any(|key| map.contains_key(*key));
            if has(&["mission", "root"]) {
                Ok(FileKind::Mission)
            } else if has(&["places", "lanes"]) || (has(&["nodes"]) && has(&["edges"])) {
                Ok(FileKind::Map)
            } else if has(&["domain"]) {
                Ok(FileKind::Domain)
            } else if has(&["worker"]) {
                Ok(FileKind::Workers)
            } else if is_flat_ihtn(&value) {
                Ok(FileKind::Ihtn)
            } else {
                Err(unknown_kind(
                    file,
                    "a mission has `mission` and `root`, a map `places` and `lanes`, a domain `domain`, a tree `BTCPP_format`",
                ))
            }
        }
        _ => Err(unknown_kind(
            file,
            "a mission has `mission` and `root`, a map `places` and `lanes`, a domain `domain`, a tree `BTCPP_format`",
        )),
    }
}

fn unknown_kind(file: &str, hint: &str) -> Diagnostics {
    Diagnostic::for_file(file, format!("the kind of this file cannot be detected: {hint}; name it with --kind")).into()
}

/// Detects the kind of a TOML file: the kind with most of its keys.
fn detect_toml(text: &str, file: &str) -> Result<FileKind, Diagnostics> {
    let table: toml::Table = text.parse().map_err(|_| {
        // Any kind serves to locate the syntax error.
        config::from_text::<FleetConfig>(text, file, &Extensions::default().domain())
            .err()
            .unwrap_or_else(|| unknown_kind(file, "it is not TOML"))
    })?;
    // Keys that identify a kind. Robot and station files share most keys; only a robot has a place
    // and skills.
    const KEYS: [(FileKind, &[&str]); 6] = [
        (FileKind::Workers, &["worker"]),
        (FileKind::World, &["robot", "person", "seed", "speed", "durations"]),
        (FileKind::Robot, &["place", "skills", "speed_mps", "battery", "discharge_share_per_s", "useful_charge"]),
        (
            FileKind::Fleet,
            &[
                "map",
                "calibration",
                "bootstrap_expect",
                "timing",
                "voters",
                "planned_nodes",
                "dead_after_ms",
                "link_lease_ms",
                "stall_after_s",
                "domains",
                "missions",
                "dashboards",
                "limits",
                "requests",
                "lease",
                "auction",
                "charging",
                "zones",
                "alarms",
                "ensemble",
            ],
        ),
        (
            FileKind::Design,
            &["repetitions", "policies", "treatments", "mission", "robots", "fixed", "factors", "travel"],
        ),
        (FileKind::Calibration, &["quantile", "to", "from", "legs", "discharge", "charging"]),
    ];
    const STATION: &[&str] = &["fleet", "stationary", "mains_powered", "may_vote", "bus"];
    let count = |keys: &[&str]| keys.iter().filter(|mark| table.contains_key(**mark)).count();
    // Of equal counts the first kind wins; a station is the fallback.
    let most = KEYS.iter().map(|(kind, keys)| (count(keys), *kind)).rev().max_by_key(|(count, _)| *count);
    match most {
        Some((1.., kind)) => Ok(kind),
        _ if count(STATION) > 0 => Ok(FileKind::Station),
        _ if table.contains_key("name") => Ok(FileKind::Fleet),
        _ => Err(unknown_kind(
            file,
            "it has no key of a fleet, robot, station, world, workers, design or calibration file",
        )),
    }
}
