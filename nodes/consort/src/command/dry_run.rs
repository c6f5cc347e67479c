//! `consort dry-run`: computes the result of a mission's auction.

use super::flag_values::{key_value, seconds, share};
use super::flags::{PeopleFlags, set};
use crate::check::fleet_file;
use crate::config::FleetConfig;
use crate::diagnostic::Diagnostics;
use crate::dry_run::{AssumedFleet, DryRunOutcome, WorkerBid, simulate_auction};
use crate::exit::Failure;
use crate::people_asked::{ExpectedRequest, expected_requests};
use crate::wiring::{fleet_settings, fleet_skill_resources, limits};
use crate::{inputs, output};
use consort_protocol::auction::BidPart;
use consort_protocol::ids::{RobotId, RoleId};
use consort_protocol::mission::{Domain, Mission, MissionDocument};
use consort_protocol::plan::{Division, divide_and_check};
use consort_protocol::units::{BatteryShare, Seconds};
use consort_skills::extensions::Extensions;
use consort_skills::missions::NamedMissions;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;

/// Show the result of a mission's auction, offline
///
/// Divides the mission into the plans of its roles, lets each worker estimate them as its node
/// would, and selects as the coordinator would. Prints every request to people with its time limit
/// and escalation, every bid with its parts, every refusal with its reason, and the assignment.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort dry-run lab-samples --workers examples/workers.toml --set room='PC Room 3'
  consort dry-run my-mission.yaml --map my-map.yaml --workers workers.json --json
  consort dry-run my-mission.yaml --fleet fleet.toml --workers workers.toml
  consort dry-run my-ihtn.json --domain my-domain.yaml --person nurse --workers workers.toml
  consort dry-run lab-samples --map hospital_map.json --scenarios scenarios_81.json --json

A workers file, in TOML (in JSON and YAML: a list of the same):
  [[worker]]
  name = \"ada\"
  place = \"Dock\"
  skills = [\"navigation\", \"operate_drawer\"]
  speed_mps = 0.15                 # left out: it does not drive
  battery = 0.9                    # default 1
  discharge_share_per_s = 0.0004   # default 0
  useful_charge = 0.08             # the default
  busy_s = 60                      # it holds another role for that time; left out: it is free")]
pub(crate) struct Args {
    /// The mission: the name of a bundled mission (lab-samples, …), a mission file, a file in the flat iHTN form (JSON),
    /// or else the name of a mission of the fleet file
    mission: String,
    #[command(flatten)]
    people: PeopleFlags,
    /// The fleet file, with the ensembles, limits, map, domains and missions; the coordinator is assumed to be a station
    /// on mains power. Without it, every worker is a member of every ensemble
    #[arg(long, env = "CONSORT_FLEET", value_name = "FILE")]
    fleet: Option<PathBuf>,
    /// The map: the name of a bundled map (hospital), or a file in Consort's format or that of the
    /// published evaluation. Default: that of the fleet, or hospital
    #[arg(long, env = "CONSORT_MAP", value_name = "NAME|FILE")]
    map: Option<String>,
    /// The workers that bid
    #[arg(long, value_name = "FILE", required_unless_present = "scenarios", conflicts_with = "scenarios")]
    workers: Option<PathBuf>,
    /// Scenarios of the published evaluation: each has its own workers, and its nurse's place is
    /// the parameter `room`
    #[arg(long, value_name = "FILE")]
    scenarios: Option<PathBuf>,
    /// A parameter of the mission
    #[arg(long = "set", value_name = "NAME=VALUE", value_parser = key_value)]
    parameters: Vec<(String, String)>,
    /// A role to auction; may be repeated. Default: all managed roles; with --scenarios: r1
    #[arg(long = "role", value_name = "ROLE")]
    roles: Vec<RoleId>,
    /// Maximum time of a plan, in seconds. Default: that of the fleet, or none
    #[arg(long, env = "CONSORT_TIME_LIMIT_S", value_name = "SECONDS", value_parser = seconds)]
    time_limit_s: Option<Seconds>,
    /// Charge that must be left, as a share. Default: that of the fleet, or 0.05
    #[arg(long, env = "CONSORT_CHARGE_MIN", value_name = "SHARE", value_parser = share)]
    charge_min: Option<BatteryShare>,
    /// Print JSON: a line for the mission, or for each scenario
    #[arg(long)]
    json: bool,
}

/// Result of a scenario, as JSON.
#[derive(Serialize)]
struct ScenarioLine<'a> {
    code: &'a str,
    bids: &'a [WorkerBid],
    selected: Option<&'a RobotId>,
}

/// Result of a mission, as JSON.
#[derive(Serialize)]
struct MissionLine<'a> {
    mission: &'a str,
    parameters: &'a BTreeMap<String, String>,
    people: &'a [ExpectedRequest],
    roles: Vec<RoleLine<'a>>,
    selected: &'a BTreeMap<RoleId, RobotId>,
    /// Time until each promised role begins, in seconds: its robot is free, and the roles before it have ended.
    promised: &'a BTreeMap<RoleId, Seconds>,
    failure: Option<&'a str>,
}

#[derive(Serialize)]
struct RoleLine<'a> {
    role: &'a RoleId,
    bids: Vec<BidLine<'a>>,
    selected: Option<&'a RobotId>,
}

#[derive(Serialize)]
struct BidLine<'a> {
    #[serde(flatten)]
    bid: &'a WorkerBid,
    parts: &'a [BidPart],
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for wrong files; [`Failure::Unsuccessful`] if a role of the mission is not
/// assigned (an unassigned scenario is a normal result).
pub(crate) fn run(args: Args, extensions: Extensions) -> Result<(), Failure> {
    let (fleet, missions) = assumed_fleet(&args, extensions)?;
    let template = inputs::mission(&args.mission, &args.people.people, &missions)?;
    let given: BTreeMap<String, String> = args.parameters.iter().cloned().collect();
    match (&args.scenarios, &args.workers) {
        (Some(path), _) => scenarios(&args, path, &template, &fleet, &given),
        (None, Some(path)) => mission(&args, path, &template, &fleet, &given),
        (None, None) => Err(Failure::Usage("--workers or --scenarios is needed".to_owned())),
    }
}

/// Returns the fleet of the fleet file and its missions, with the values of the flags; without a file, a fleet of all
/// defaults and without ensembles.
fn assumed_fleet(args: &Args, extensions: Extensions) -> Result<(AssumedFleet, Arc<NamedMissions>), Diagnostics> {
    let (mut config, extensions) = match &args.fleet {
        Some(path) => fleet_file(path, extensions)?,
        None => (FleetConfig::default(), extensions),
    };
    set(&mut config.map, args.map.clone());
    config.limits.time_s = args.time_limit_s.or(config.limits.time_s);
    set(&mut config.limits.charge_min, args.charge_min);
    let (mut equipment, limits) = (fleet_skill_resources(&config, None, extensions)?, limits(&config));
    let (charging, ensembles, missions) = match &args.fleet {
        Some(_) => {
            let settings = fleet_settings(&config, extensions)?;
            equipment.domain = settings.domain;
            (settings.charging, Some(settings.ensembles), settings.missions)
        }
        None => (None, None, Arc::default()),
    };
    let (promises, patience_s) = (config.auction.promise_terms(), config.requests.limits().patience_s);
    Ok((AssumedFleet { equipment, limits, charging, promises, patience_s, ensembles }, missions))
}

fn mission(
    args: &Args,
    path: &std::path::Path,
    template: &MissionDocument,
    fleet: &AssumedFleet,
    given: &BTreeMap<String, String>,
) -> Result<(), Failure> {
    let workers = inputs::workers(&inputs::read_text(path)?, &path.display().to_string())?;
    let (mission, division) = divide(template, &fleet.equipment.domain, given)?;
    let roles: BTreeSet<RoleId> = wanted(&args.roles, &mission, || mission.managed_roles().cloned().collect())?;
    let result = simulate_auction(&mission, &division, &roles, &workers, fleet);
    let people = expected_requests(&mission, &fleet.equipment.library, fleet.patience_s);
    if args.json {
        let roles = result.bids.iter().map(|(role, bids)| RoleLine {
            role,
            bids: bids.iter().map(|bid| BidLine { bid, parts: &bid.parts }).collect(),
            selected: result.holders.get(role),
        });
        output::json(&MissionLine {
            mission: template.name().as_str(),
            parameters: given,
            people: &people,
            roles: roles.collect(),
            selected: &result.holders,
            promised: &result.promised,
            failure: result.failure.as_deref(),
        })?;
    } else {
        let set: String = given.iter().map(|(name, value)| format!(", {name} = {value}")).collect();
        output::line(format_args!("{}{set}", template.name()))?;
        if !people.is_empty() {
            let lines = people.iter().map(|request| format!("\n    {request}"));
            output::line(format_args!("  people{}", lines.collect::<String>()))?;
        }
        output::line(readable(&result))?;
    }
    match result.failure {
        None => Ok(()),
        Some(failure) => Err(Failure::Unsuccessful(format!("the mission would stay pending: {failure}"))),
    }
}

fn scenarios(
    args: &Args,
    path: &std::path::Path,
    template: &MissionDocument,
    fleet: &AssumedFleet,
    given: &BTreeMap<String, String>,
) -> Result<(), Failure> {
    for scenario in inputs::scenarios(&inputs::read_text(path)?, &path.display().to_string())? {
        let mut given = given.clone();
        given.entry("room".to_owned()).or_insert_with(|| scenario.room.to_string());
        let (mission, division) = divide(template, &fleet.equipment.domain, &given)?;
        let r1 = || RoleId::new("r1").into_iter().collect();
        let roles: BTreeSet<RoleId> = wanted(&args.roles, &mission, r1)?;
        let result = simulate_auction(&mission, &division, &roles, &scenario.workers, fleet);
        if args.json {
            for (role, bids) in &result.bids {
                output::json(&ScenarioLine { code: &scenario.code, bids, selected: result.holders.get(role) })?;
            }
        } else {
            output::line(format_args!("{}: {}, room = {}", scenario.code, template.name(), scenario.room))?;
            output::line(readable(&result))?;
        }
    }
    Ok(())
}

fn divide(
    template: &MissionDocument,
    domain: &Domain,
    given: &BTreeMap<String, String>,
) -> Result<(Mission, Division), Failure> {
    let usage = |problem: String| Failure::Usage(problem);
    let mission = template.instantiate(given, domain).map_err(|e| usage(e.to_string()))?;
    let division = divide_and_check(&mission).map_err(|e| usage(e.to_string()))?;
    Ok((mission, division))
}

fn wanted(
    asked: &[RoleId],
    mission: &Mission,
    default: impl FnOnce() -> BTreeSet<RoleId>,
) -> Result<BTreeSet<RoleId>, Failure> {
    let roles = if asked.is_empty() { default() } else { asked.iter().cloned().collect() };
    let managed: BTreeSet<RoleId> = mission.managed_roles().cloned().collect();
    match roles.iter().find(|role| !managed.contains(*role)) {
        None => Ok(roles),
        Some(role) => {
            let known = managed.iter().map(RoleId::as_str).collect::<Vec<_>>().join(", ");
            Err(Failure::Usage(format!("mission {} has no managed role {role}; there are {known}", mission.name)))
        }
    }
}

/// Formats every bid for every role, the fastest first, and the assignment.
fn readable(result: &DryRunOutcome) -> String {
    let mut text = String::new();
    for (role, bids) in &result.bids {
        let chosen = result.holders.get(role);
        text.push_str(&format!("  {role}\n"));
        let mut sorted: Vec<&WorkerBid> = bids.iter().collect();
        sorted.sort_by(|a, b| {
            let rank = |bid: &WorkerBid| (!bid.viable, bid.time_s.unwrap_or(f64::INFINITY));
            let ((a_out, a_time), (b_out, b_time)) = (rank(a), rank(b));
            a_out.cmp(&b_out).then(a_time.total_cmp(&b_time)).then(a.worker.cmp(&b.worker))
        });
        let rows: Vec<Vec<String>> = sorted.iter().map(|bid| row(bid, chosen)).collect();
        for (line, bid) in output::table(&rows).lines().zip(&sorted) {
            text.push_str(&format!("    {line}\n"));
            if !bid.parts.is_empty() {
                let part = |part: &BidPart| format!("{} {:.1}", part.label, part.time.get());
                let parts = bid.parts.iter().map(part).collect::<Vec<_>>().join(", ");
                text.push_str(&format!("      in seconds: {parts}\n"));
            }
        }
    }
    match &result.failure {
        Some(failure) => text.push_str(&format!("  no assignment: {failure}")),
        None => {
            let holders = result.holders.iter().map(|(role, robot)| format!("{role} = {robot}"));
            let why = if result.holders.len() == 1 {
                "the fastest viable bid"
            } else {
                "the viable bids of different robots that are fastest together"
            };
            text.push_str(&format!("  assignment: {} ({why})", holders.collect::<Vec<_>>().join(", ")));
        }
    }
    for why in &result.why {
        text.push_str(&format!("\n  {why}"));
    }
    text
}

fn row(bid: &WorkerBid, chosen: Option<&RobotId>) -> Vec<String> {
    let reason = bid.reason.as_deref();
    let (Some(time), Some(energy), Some(remaining)) = (bid.time_s, bid.energy, bid.remaining) else {
        let [time, energy, remaining] = ["-"; 3].map(str::to_owned);
        return vec![bid.worker.to_string(), time, energy, remaining, format!("refuses: {}", reason.unwrap_or("?"))];
    };
    let verdict = match reason {
        _ if chosen == Some(&bid.worker) => "chosen".to_owned(),
        None => "viable".to_owned(),
        Some(reason) => format!("not viable: {reason}"),
    };
    let (energy, remaining) = (energy * 100.0, remaining * 100.0);
    let [time, energy, remaining] =
        [format!("{time:.1} s"), format!("uses {energy:.1} %"), format!("leaves {remaining:.1} %")];
    vec![bid.worker.to_string(), time, energy, remaining, verdict]
}
