//! The fleet file: settings shared by all nodes of a fleet.

use super::alarms::{AlarmConfig, alarm_plans};
use super::charging::ChargingConfig;
use super::devices::{DeviceConfig, devices};
use super::read::{join_normalized, resolve_path};
use super::{ConfigFile, load, load_unchecked};
use crate::diagnostic::Diagnostics;
use crate::map_loader::is_shipped;
use consort_fleet::autopilot;
use consort_fleet::coordinator::{CandidateSettings, RequestLimits};
use consort_protocol::auction::{BidLimits, Objective, PromiseTerms};
use consort_protocol::ensemble::{Ensemble, EnsembleSpec, ExchangedValue, private_attribute_problems};
use consort_protocol::ids::{ActionName, AlarmId, EnsembleId, FleetId, PlaceId, TaskType, ZoneId};
use consort_protocol::lease::LeaseTerms;
use consort_protocol::ledger::{HistoryLimits, TIME_AHEAD_MAX, Zone};
use consort_protocol::mission::{Domain, PATIENCE_MAX_S};
use consort_protocol::pose::Pose;
use consort_protocol::timing::{Timing, TimingParameters};
use consort_protocol::units::{BatteryShare, Seconds};
use consort_text::AllowedNames;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::MapAccessDeserializer;
use serde::de::{Deserializer, MapAccess, Visitor};
use serde::ser::Serializer;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Default name of a fleet.
pub(crate) const DEFAULT_FLEET: &str = "ward";

/// A fleet file. Every key has a default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FleetConfig {
    /// The fleet's name: part of every key on the bus. Default `ward`.
    pub name: FleetId,
    /// The map: the name of a bundled map (`hospital`, the default), or the path of a file.
    pub map: String,
    /// Corrections to robots' estimates: a file written by `consort lab experiment calibrate` or `energy`.
    /// Robots then bid with the measured cost of drives and tasks, and only if the battery lasts in
    /// all but the worst cases. Default: no corrections.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<PathBuf>,
    /// Number of nodes with `may_vote` that must have met, and agree on a founder, before the
    /// ledger is created for the first time: as many as are started together. A node that receives
    /// a ledger of this fleet's name creates no ledger; it listens for 0.6 s before it creates a
    /// ledger, and queries all reachable nodes. So nodes that reach each other share a single
    /// ledger, however few they expect. Parts of a fleet without any connection each create a
    /// ledger if each has as many nodes as expected, and the two never merge: only more than half
    /// of all nodes excludes that. Default 1, for starting nodes individually on a single machine.
    pub bootstrap_expect: usize,
    /// Timing preset of failure detection and elections: `lan` (default) for wired machines, `wifi`
    /// for links that lose messages.
    pub timing: Timing,
    /// Target number of voters, an odd number from 1 to 9. More voters survive more simultaneous
    /// failures, and slow each commit. Default 5.
    pub voters: usize,
    /// Planned number of nodes: robots, stations and worlds. From 30 on only stations, worlds and nodes on
    /// mains power relay messages for others, and all other nodes connect to them, unless `relay` of a
    /// node says otherwise. The places and charges of moving robots then go to stations, worlds, nodes on mains
    /// power and voters only. Default: a small fleet, in which every node relays.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub planned_nodes: Option<usize>,
    /// Time that a voter must be unreachable until another replaces it, in milliseconds. Default:
    /// that of `timing`, 10000 or 20000: longer than a restart takes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dead_after_ms: Option<u64>,
    /// Time that a silent neighbour still counts as linked, in milliseconds. Shorter: a silent loss
    /// is detected earlier; a slow link is more easily mistaken for a loss. Default: that of
    /// `timing`, 2000 or 5000.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub link_lease_ms: Option<u64>,
    /// Time without a finished step after which a role is taken from its robot, in seconds, unless
    /// the role waits for another role; 0 for never. Longer: slow drives are not interrupted, stuck
    /// robots keep their roles for longer. Default 900.
    pub stall_after_s: u64,
    /// Domain files with the fleet's own actions and task types, in addition to those of `--domain`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub domains: Vec<PathBuf>,
    /// Mission files of the fleet, also in the flat iHTN form (JSON). Requests, schedules and the certificates of people
    /// name them as they name the shipped missions. No two have the same name, and none that of a shipped mission.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub missions: Vec<PathBuf>,
    /// Addresses of the fleet's dashboards, as `http://ward-1:8088`. The page for people names them when
    /// its own node does not reply.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub dashboards: Vec<String>,
    /// Limits of bids.
    pub limits: LimitsConfig,
    /// Limits of requests.
    pub requests: RequestsConfig,
    /// Memory of ended missions.
    pub history: HistoryConfig,
    /// Duration of awards.
    pub lease: LeaseConfig,
    /// Settings of auctions.
    pub auction: AuctionConfig,
    /// Charging by the robots themselves. Default: none, and robots charge by tasks of missions only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub charging: Option<ChargingConfig>,
    /// Zones: names for places to which people give orders together, as `icu = ["IC Room 5", "IC Room 6"]`. A zone has
    /// another name than each place. Default: none.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub zones: BTreeMap<ZoneId, BTreeSet<PlaceId>>,
    /// Alarms that people may raise, such as `fire`, by name. Default: none.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, AlarmConfig>")]
    pub alarms: BTreeMap<AlarmId, AlarmConfig>,
    /// Doors, lifts and other devices of the building, which robots request before they enter. Default: none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub device: Vec<DeviceConfig>,
    /// Ensembles: groups of robots that receive calls for bids. A mission file names those that it
    /// prefers. Default: the ensemble `workers`, of robots with any skill that a mission can use.
    pub ensemble: Vec<EnsembleSpec>,
}

/// `[limits]`: limits of bids.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LimitsConfig {
    /// Maximum time of a robot's part by its own estimate, in world seconds. Default: no limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_s: Option<Seconds>,
    /// Charge that must be left, as a share. Default 0.05: below it a robot stops dead.
    pub charge_min: BatteryShare,
}

/// `[requests]`: limits of requests. A rejected client may retry.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RequestsConfig {
    /// Maximum number of active missions; 0 for no limit. Default 1000.
    pub missions: usize,
    /// Maximum sustained number of requests (submit, cancel, resolve) per second, with bursts of
    /// five times as many; 0 for no limit. Default 200.
    pub per_s: u32,
    /// Time to wait for an answer of people, in seconds, for tasks and questions of robots that state no `patience_s`; 0 for
    /// no limit. Without an answer the mission fails, or the tree of the robot goes on. Longer: robots wait for longer for an answer
    /// that does not come. Default 3600.
    pub patience_s: u32,
    /// Bound on the time of missions whose files state no `time_limit_s`, in seconds from the request, or from the
    /// earliest start; 0 for no bound. Default 0.
    pub time_limit_s: u32,
}

impl RequestsConfig {
    /// Returns the limits of requests and missions.
    pub(crate) fn limits(&self) -> RequestLimits {
        let bound = |seconds: u32| (seconds > 0).then_some(seconds);
        RequestLimits {
            missions_max: self.missions,
            requests_per_s: self.per_s,
            patience_s: bound(self.patience_s),
            time_limit: bound(self.time_limit_s).map(|seconds| Duration::from_secs(seconds.into())),
        }
    }
}

/// `[history]`: what the fleet remembers of ended missions.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct HistoryConfig {
    /// Maximum number of ended missions kept whole, for display. The earliest ended are dropped.
    /// Default 500.
    pub missions: u32,
    /// Time after the end of a mission for which its outcome is known, in hours. A request that is
    /// repeated within that time is not executed again. Longer: the ledger is larger. Default 24.
    pub outcomes_h: u32,
    /// Maximum size of all outcomes, in MiB: some five thousand missions each. The earliest are
    /// dropped. Default 4.
    pub outcomes_mib: u32,
}

/// `[lease]`: duration of awards without contact.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LeaseConfig {
    /// Time after its last contact with the coordinator at which a robot suspends its role, in
    /// milliseconds. Longer: robots keep moving through blackouts; lost robots are replaced later.
    /// Default 4000.
    pub lease_ms: u64,
    /// Additional time that the coordinator waits before it gives the role to another robot, in
    /// milliseconds. It covers clock drift. Default 2000.
    pub grace_ms: u64,
}

/// `[auction]`: settings of auctions.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AuctionConfig {
    /// Time that an auction waits for a member that does not answer, in milliseconds; it closes at
    /// once when all have answered. Default: that of `timing`, 200 or 800.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub window_ms: Option<u64>,
    /// Maximum number of roles that are promised to a robot while it holds another; 0 for none. More: missions
    /// start earlier, and their other robots wait for a scarce robot. Default 16.
    pub promises: u32,
    /// Maximum time until a robot is free for a role that it promises, in seconds. Longer: roles are assigned earlier, by
    /// less certain estimates. Default: no limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub horizon_s: Option<u32>,
    /// Maximum time by which a promised role is delayed, by all roles that robots insert before it, in seconds. Longer: robots
    /// drive less, and some roles wait for longer. Default 600.
    pub delay_s: u32,
    /// Time by which a promised role may be late, although it can start, in seconds. Then it passes to another robot that can
    /// begin within this time. Longer: fewer changes, longer waits for robots that are held up. Default 300.
    pub late_s: u32,
    /// Minimum gain for which a promised role passes to another robot, in seconds of the objective. More: fewer changes. Default
    /// 60.
    pub gain_s: u32,
    /// Time before the earliest start of a mission (`not_before`) from which its roles are promised, in seconds. Longer: the
    /// robots are known earlier, and keep themselves free; their bids are less certain. Default 0: roles are auctioned at the
    /// earliest start.
    pub ahead_s: u32,
    /// What robots minimise when they insert a role among their promised roles, and the coordinator when it chooses among
    /// bids: `earliest_end` (default) for the sum of the times at which roles end, `least_energy`, or `weighted` for the
    /// sum of both.
    pub objective: ObjectiveName,
    /// Seconds for which a full battery counts with the objective `weighted`. More: robots drive less, and roles end later.
    /// Default 3600.
    pub battery_s: u32,
    /// Number of robots that an auction asks first, those that may cost least by their records. It asks more until no other robot could
    /// get a role. A fleet with at most as many members asks all; 0 to ask all in any fleet. More: more messages, fewer auctions that ask
    /// again. Default 16.
    pub candidates: usize,
}

/// Objective of auctions.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ObjectiveName {
    /// The least sum of the ends of all roles.
    #[default]
    EarliestEnd,
    /// The least energy.
    LeastEnergy,
    /// The least sum of ends and energy.
    Weighted,
}

impl Default for FleetConfig {
    fn default() -> Self {
        FleetConfig {
            name: FleetId::new(DEFAULT_FLEET).expect("a slug"),
            map: "hospital".to_owned(),
            calibration: None,
            bootstrap_expect: 1,
            timing: Timing::default(),
            voters: autopilot::VOTERS,
            planned_nodes: None,
            dead_after_ms: None,
            link_lease_ms: None,
            stall_after_s: 900,
            domains: vec![],
            missions: vec![],
            dashboards: vec![],
            limits: LimitsConfig::default(),
            requests: RequestsConfig::default(),
            history: HistoryConfig::default(),
            lease: LeaseConfig::default(),
            auction: AuctionConfig::default(),
            charging: None,
            zones: BTreeMap::new(),
            alarms: BTreeMap::new(),
            device: vec![],
            ensemble: vec![],
        }
    }
}

impl Default for LimitsConfig {
    fn default() -> Self {
        let BidLimits { time, charge_min } = BidLimits::default();
        LimitsConfig { time_s: time, charge_min }
    }
}

impl Default for AuctionConfig {
    fn default() -> Self {
        let PromiseTerms { promises_max: promises, delay_max, late_max, gain_min, ahead, .. } = PromiseTerms::default();
        let whole = |time: Seconds| time.get().round() as u32;
        AuctionConfig {
            window_ms: None,
            promises,
            horizon_s: None,
            delay_s: whole(delay_max),
            late_s: whole(late_max),
            gain_s: whole(gain_min),
            ahead_s: whole(ahead),
            objective: ObjectiveName::default(),
            battery_s: 3600,
            candidates: CandidateSettings::DEFAULT_COUNT,
        }
    }
}

impl AuctionConfig {
    /// Returns the limits of promises.
    pub(crate) fn promise_terms(&self) -> PromiseTerms {
        let seconds = |number: u32| Seconds::new(number.into()).expect("a whole number of seconds is a time");
        PromiseTerms {
            promises_max: self.promises,
            horizon: self.horizon_s.map(seconds),
            delay_max: seconds(self.delay_s),
            late_max: seconds(self.late_s),
            gain_min: seconds(self.gain_s),
            ahead: seconds(self.ahead_s),
            objective: match self.objective {
                ObjectiveName::EarliestEnd => Objective::EarliestEnd,
                ObjectiveName::LeastEnergy => Objective::LeastEnergy,
                ObjectiveName::Weighted => Objective::Weighted { battery_s: seconds(self.battery_s) },
            },
        }
    }
}

impl Default for RequestsConfig {
    fn default() -> Self {
        let RequestLimits { missions_max: missions, requests_per_s, patience_s, time_limit } = RequestLimits::default();
        let seconds = |time: Duration| u32::try_from(time.as_secs()).expect("a default of seconds");
        RequestsConfig {
            missions,
            per_s: requests_per_s,
            patience_s: patience_s.unwrap_or(0),
            time_limit_s: time_limit.map_or(0, seconds),
        }
    }
}

const HOUR_MS: u64 = 60 * 60 * 1000;
const MIB: u64 = 1024 * 1024;

impl HistoryConfig {
    /// Returns the limits of the ledger's history.
    pub(crate) fn limits(&self) -> HistoryLimits {
        HistoryLimits {
            missions_max: self.missions,
            outcome_age_max_ms: u64::from(self.outcomes_h) * HOUR_MS,
            outcome_bytes_max: u64::from(self.outcomes_mib) * MIB,
        }
    }

    /// Returns the limits in the units of the file.
    fn of(limits: HistoryLimits) -> HistoryConfig {
        let HistoryLimits { missions_max, outcome_age_max_ms, outcome_bytes_max } = limits;
        let whole = |number: u64| u32::try_from(number).unwrap_or(u32::MAX);
        HistoryConfig {
            missions: missions_max,
            outcomes_h: whole(outcome_age_max_ms / HOUR_MS),
            outcomes_mib: whole(outcome_bytes_max / MIB),
        }
    }
}

impl Default for HistoryConfig {
    fn default() -> Self {
        HistoryConfig::of(HistoryLimits::default())
    }
}

impl Default for LeaseConfig {
    fn default() -> Self {
        let LeaseTerms { lease, grace } = LeaseTerms::default();
        let ms = |time: Duration| u64::try_from(time.as_millis()).expect("a default of seconds");
        LeaseConfig { lease_ms: ms(lease), grace_ms: ms(grace) }
    }
}

impl FleetConfig {
    /// Returns the times of the preset, with individual overrides.
    pub fn times(&self) -> TimingParameters {
        let times = self.timing.parameters();
        let or = |ms: Option<u64>, preset| ms.map_or(preset, Duration::from_millis);
        TimingParameters {
            dead_after: or(self.dead_after_ms, times.dead_after),
            link_lease: or(self.link_lease_ms, times.link_lease),
            auction_window: or(self.auction.window_ms, times.auction_window),
            ..times
        }
    }

    /// Returns the ensembles.
    pub(crate) fn ensembles(&self, domain: &Domain) -> Vec<EnsembleSpec> {
        if self.ensemble.is_empty() {
            let skills = domain.task_types().cloned().collect();
            return vec![EnsembleSpec::with_any_skill_of(EnsembleId::new("workers").expect("a slug"), skills)];
        }
        self.ensemble.clone()
    }
}

impl ConfigFile for FleetConfig {
    const KIND: &'static str = "fleet";

    fn resolve_paths(&mut self, folder: &Path) {
        if !is_shipped(&self.map) {
            self.map = join_normalized(folder, Path::new(&self.map)).display().to_string();
        }
        resolve_path(&mut self.calibration, folder);
        for path in self.domains.iter_mut().chain(&mut self.missions) {
            *path = join_normalized(folder, path);
        }
    }

    fn validate(&self, domain: &Domain) -> Vec<String> {
        let mut validate = vec![];
        let times = self.times();
        let ms = |time: Duration| u64::try_from(time.as_millis()).unwrap_or(u64::MAX);
        let mut within = |key: &str, value: u64, least: u64, most: u64| {
            if !(least..=most).contains(&value) {
                validate.push(format!("{key} is {value}, allowed is {least} to {most}"));
            }
        };
        let is_page = |address: &str| address.starts_with("http://") || address.starts_with("https://");
        let wrong = self.dashboards.iter().filter(|address| !is_page(address));
        let wrong: Vec<String> = wrong
            .map(|address| format!("dashboards: {address:?} is no address of a page, as http://ward-1:8088"))
            .collect();
        within("bootstrap_expect", self.bootstrap_expect as u64, 1, 1_000);
        within("voters", self.voters as u64, 1, autopilot::VOTERS_MAX as u64);
        within("planned_nodes", self.planned_nodes.unwrap_or(1) as u64, 1, 100_000);
        within("dead_after_ms", ms(times.dead_after), 1_000, 86_400_000);
        within("link_lease_ms", ms(times.link_lease), 100, 600_000);
        within("stall_after_s", self.stall_after_s, 0, 604_800);
        within("requests.missions", self.requests.missions as u64, 0, 1_000_000);
        within("requests.per_s", self.requests.per_s.into(), 0, 1_000_000);
        within("requests.patience_s", self.requests.patience_s.into(), 0, PATIENCE_MAX_S.into());
        within("requests.time_limit_s", self.requests.time_limit_s.into(), 0, TIME_AHEAD_MAX.as_secs());
        let largest = HistoryConfig::of(HistoryLimits::LARGEST);
        within("history.missions", self.history.missions.into(), 1, largest.missions.into());
        within("history.outcomes_h", self.history.outcomes_h.into(), 1, largest.outcomes_h.into());
        within("history.outcomes_mib", self.history.outcomes_mib.into(), 1, largest.outcomes_mib.into());
        within("lease.lease_ms", self.lease.lease_ms, 500, LEASE_MS_MAX);
        within("lease.grace_ms", self.lease.grace_ms, 1, LEASE_MS_MAX);
        within("auction.window_ms", ms(times.auction_window), 1, 60_000);
        within("auction.horizon_s", self.auction.horizon_s.unwrap_or(PLANNED_S_MAX).into(), 1, PLANNED_S_MAX.into());
        within("auction.delay_s", self.auction.delay_s.into(), 0, PLANNED_S_MAX.into());
        within("auction.late_s", self.auction.late_s.into(), 1, PLANNED_S_MAX.into());
        within("auction.gain_s", self.auction.gain_s.into(), 1, PLANNED_S_MAX.into());
        within("auction.ahead_s", self.auction.ahead_s.into(), 0, PLANNED_S_MAX.into());
        within("auction.battery_s", self.auction.battery_s.into(), 1, 1_000_000);
        within("auction.candidates", self.auction.candidates as u64, 0, 1_000_000);
        let LeaseConfig { lease_ms, grace_ms } = self.lease;
        let grace_min_ms = ms(LeaseTerms::grace_min(Duration::from_millis(lease_ms.min(LEASE_MS_MAX))));
        if grace_ms < grace_min_ms {
            validate.push(format!(
                "lease.grace_ms is {grace_ms}, allowed with lease.lease_ms {lease_ms} is {grace_min_ms} or more: \
                 with less, two robots could act in a role if their clocks differ by 1 %"
            ));
        }
        if self.voters.is_multiple_of(2) {
            validate.push(format!("voters is {}, allowed is an odd number: 1, 3, 5, 7 or 9", self.voters));
        }
        validate.extend(wrong);
        validate.extend(self.charging.iter().flat_map(ChargingConfig::validate));
        let with_zones = domain.clone().with_zones(self.zones.clone());
        validate.extend(alarm_plans(&self.alarms, &with_zones).err().into_iter().flatten());
        validate.extend(devices(&self.device, domain).err().into_iter().flatten());
        let mut compiled = vec![];
        for (index, spec) in self.ensemble.iter().enumerate() {
            if self.ensemble[..index].iter().any(|other| other.name == spec.name) {
                validate.push(format!("ensemble {}: is declared twice", spec.name));
            }
            for skill in spec.skills.iter().filter(|skill| domain.get(skill).is_none()) {
                validate.push(format!("ensemble {}: skills: {}", spec.name, unknown_skill(skill, domain)));
            }
            let exchanged = spec.exchange.iter().filter_map(|value| match value {
                ExchangedValue::Reading(name) => Some(name),
                ExchangedValue::Attribute(_) => None,
            });
            for reading in exchanged.filter(|name| !domain.readings().contains(*name)) {
                let allowed = AllowedNames::suggest_for(reading, domain.readings());
                validate.push(format!(
                    "ensemble {}: exchange: no domain declares the reading `{reading}`; {allowed}",
                    spec.name
                ));
            }
            match Ensemble::compile(spec.clone()) {
                Ok(ensemble) => compiled.push(ensemble),
                Err(problem) => validate.push(problem.to_string()),
            }
        }
        for (zone, places) in &self.zones {
            match places.len() {
                0 => validate.push(format!("zones.{zone}: has no places; name at least one")),
                count if count > Zone::PLACES_MAX => {
                    validate
                        .push(format!("zones.{zone}: has {count} places; allowed are {} at most", Zone::PLACES_MAX));
                }
                _ => {}
            }
        }
        validate.extend(private_attribute_problems(&compiled).iter().map(ToString::to_string));
        validate
    }
}

/// Returns the problems of actions whose cancel takes so long that the lease leaves no time for their goals.
pub(crate) fn cancel_problems<'a>(
    lease: &LeaseConfig,
    actions: impl Iterator<Item = (&'a ActionName, Duration)>,
) -> Vec<String> {
    let lease_ms = lease.lease_ms;
    let most = LeaseTerms::cancel_within_max(Duration::from_millis(lease_ms));
    let too_long = actions.filter(|(_, within)| *within > most);
    let problem = |(action, within): (&ActionName, Duration)| {
        let (within_s, most_s) = (within.as_secs_f64(), most.as_secs_f64());
        let lease_min_ms = LeaseTerms::lease_min(within).as_millis();
        format!(
            "actions.{action}.cancel.within_s is {within_s}, allowed with lease.lease_ms {lease_ms} is {most_s} or \
             less, and it is allowed with lease.lease_ms {lease_min_ms} or more: the robot stops before the lease ends"
        )
    };
    too_long.map(problem).collect()
}

/// Returns the problems of zones on a map with these places: their places are on the map, and their names are not.
pub(crate) fn zone_problems(
    zones: &BTreeMap<ZoneId, BTreeSet<PlaceId>>,
    on_map: &BTreeMap<PlaceId, Pose>,
) -> Vec<String> {
    let mut problems = vec![];
    for (zone, places) in zones {
        if on_map.keys().any(|place| place.as_str() == zone.as_str()) {
            problems.push(format!("zones.{zone}: is a place of the fleet's map; give the zone a name of its own"));
        }
        for unknown in places.iter().filter(|place| !on_map.contains_key(*place)) {
            let allowed = AllowedNames::suggest_for(unknown.as_str(), on_map.keys());
            problems.push(format!("zones.{zone}: {:?} is not on the fleet's map; {allowed}", unknown.as_str()));
        }
    }
    problems
}

/// Longest horizon, delay and gain of promised roles, in seconds.
const PLANNED_S_MAX: u32 = 604_800;

/// Longest lease and grace, in milliseconds.
const LEASE_MS_MAX: u64 = 3_600_000;

/// Describes an unknown skill, with the allowed task types.
pub(super) fn unknown_skill(skill: &TaskType, domain: &Domain) -> String {
    let allowed = AllowedNames::suggest_for(skill.as_str(), domain.task_types());
    format!("there are no tasks of type `{skill}`; {allowed}")
}

/// A node file's `fleet`: the path of a fleet file, or the fleet as a table.
#[derive(Debug, Clone, PartialEq)]
pub enum FleetRef {
    /// `fleet = "fleet.toml"`
    File(PathBuf),
    /// `[fleet]`
    Table(Box<FleetConfig>),
}

impl Default for FleetRef {
    fn default() -> Self {
        FleetRef::Table(Box::default())
    }
}

impl From<FleetConfig> for FleetRef {
    fn from(fleet: FleetConfig) -> FleetRef {
        FleetRef::Table(Box::new(fleet))
    }
}

impl FleetRef {
    /// Returns the fleet.
    ///
    /// # Errors
    /// [`Diagnostics`] of the file.
    pub fn resolve(&self, domain: &Domain) -> Result<FleetConfig, Diagnostics> {
        match self {
            FleetRef::File(path) => load(path, domain),
            FleetRef::Table(fleet) => Ok((**fleet).clone()),
        }
    }

    /// Same as [`resolve`](FleetRef::resolve), without semantic checks.
    ///
    /// # Errors
    /// [`Diagnostics`] of the file.
    pub(crate) fn resolve_unchecked(&self) -> Result<FleetConfig, Diagnostics> {
        match self {
            FleetRef::File(path) => load_unchecked(path),
            FleetRef::Table(fleet) => Ok((**fleet).clone()),
        }
    }

    pub(super) fn resolve_paths(&mut self, folder: &Path) {
        match self {
            FleetRef::File(path) => *path = join_normalized(folder, path),
            FleetRef::Table(fleet) => fleet.resolve_paths(folder),
        }
    }

    pub(super) fn validate(&self, domain: &Domain) -> Vec<String> {
        match self {
            FleetRef::File(_) => vec![],
            FleetRef::Table(fleet) => {
                fleet.validate(domain).into_iter().map(|problem| format!("fleet: {problem}")).collect()
            }
        }
    }
}

impl JsonSchema for FleetRef {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "FleetRef".into()
    }

    fn json_schema(schemas: &mut SchemaGenerator) -> Schema {
        json_schema!({ "anyOf": [{ "type": "string" }, schemas.subschema_for::<FleetConfig>()] })
    }
}

impl Serialize for FleetRef {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            FleetRef::File(path) => path.serialize(serializer),
            FleetRef::Table(fleet) => fleet.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for FleetRef {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<FleetRef, D::Error> {
        struct PathOrTable;
        impl<'de> Visitor<'de> for PathOrTable {
            type Value = FleetRef;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the path of a fleet file, or a table with the same keys")
            }
            fn visit_str<E>(self, path: &str) -> Result<FleetRef, E> {
                Ok(FleetRef::File(PathBuf::from(path)))
            }
            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<FleetRef, A::Error> {
                FleetConfig::deserialize(MapAccessDeserializer::new(map)).map(|fleet| FleetRef::Table(Box::new(fleet)))
            }
        }
        deserializer.deserialize_any(PathOrTable)
    }
}
