//! The design of an experiment, as written in a file.
//!
//! ```toml
//! name = "published"              # a slug: part of every seed, and of file names
//! seed = 2022
//! repetitions = 8                 # of each scenario under each policy, each with other random numbers
//! policies = ["consort", "random"]
//! treatments = ["calm"]           # and "coordinator-killed"
//! map = "hospital"                # a shipped map, or a file
//!
//! [mission]
//! name = "lab-samples"            # a shipped mission
//! parameters = { room = "@room" } # @site stands for a place drawn by the factor location
//! delivered = { item = "sample", to = "lab-arm" }   # condition of success; default: the mission is completed
//!
//! [[mission.phases]]              # optional: the report counts the failures in each phase
//! name = "navto_room"
//! tasks = ["navto_room"]
//!
//! [[robots]]                      # named r1, r2, … in the order of the file
//! count = 6
//! skills = ["navigation", "operate_drawer"]
//! drawer = true
//!
//! [[fixed]]                       # a stationary robot, the same in every scenario
//! name = "lab-arm"
//! place = "Laboratory"
//! skills = ["pick_up"]
//!
//! [[people]]
//! name = "nurse"
//! role = "nurse"
//! place = "@room"
//! items = ["sample"]
//!
//! [factors]                       # each level is drawn once; scenarios are all combinations of levels
//! speed     = { levels = 1, between = [0.15, 0.15] }      # metres per second, for each robot
//! charge    = { levels = 3, between = [0.05, 0.95] }      # shares of a full battery, for each robot
//! discharge = { levels = 3, between = [0.0002, 0.0008] }  # shares per second at work, for each robot
//! location  = { levels = 3, starts = ["IC Room 1", "IC Room 2"], sites = { room = ["PC Room 1"] } }
//! skills    = { lacking = [4, 2, 0] }   # for each level: the number of robots without one of their skills
//!
//! [travel]                        # see the module `travel`
//! spread = 0.1
//! ```

mod check;
mod generate;
mod shipped;

pub use generate::scenarios;
pub use shipped::{SHIPPED, shipped};

use super::outcome::TrialLimits;
use super::policy::Policy;
use super::results::Treatment;
use super::travel::TravelSettings;
use consort_protocol::ids::{ItemId, NameError, PlaceId, RobotId, RoleId, TaskId, TaskType};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// A design as written. [`Design::validation_errors`] checks it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Design {
    /// Its name: a slug.
    pub name: String,
    /// Seed of all random numbers.
    #[serde(default)]
    pub seed: u64,
    /// Number of trials of each scenario under each policy and treatment.
    pub repetitions: u32,
    /// The compared policies. The first is compared with each of the others.
    pub policies: Vec<Policy>,
    /// The injected faults.
    #[serde(default = "calm")]
    pub treatments: Vec<Treatment>,
    /// Name of a shipped map, or path of a file.
    pub map: String,
    /// World seconds per second of the fleet's own time. Actions of the fleet take this many times
    /// longer in the world than with a speed of 1: elections, auctions and messages appear slower,
    /// never faster. Default 20; a message between two nodes then takes some hundredths of a second
    /// in the world.
    #[serde(default = "world_speed")]
    pub world_speed: f64,
    /// Latest time of a kill: with the treatment `coordinator-killed`, it happens at a random time
    /// up to this many world seconds after the request. Default 240, slightly less than the
    /// duration of the published missions, so that most kills happen during the mission.
    #[serde(default = "kill_within_s")]
    pub kill_within_s: f64,
    /// The mission.
    pub mission: DesignMission,
    /// Limits of each trial.
    #[serde(default)]
    pub limits: TrialLimits,
    /// Mobile robots.
    pub robots: Vec<RobotGroup>,
    /// Stationary robots.
    #[serde(default)]
    pub fixed: Vec<FixedRobot>,
    /// People.
    #[serde(default)]
    pub people: Vec<DesignPerson>,
    /// The varied factors.
    pub factors: Factors,
    /// Duration of drives.
    #[serde(default)]
    pub travel: TravelSettings,
}

fn calm() -> Vec<Treatment> {
    vec![Treatment::Calm]
}

fn world_speed() -> f64 {
    20.0
}

fn kill_within_s() -> f64 {
    240.0
}

/// The mission.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DesignMission {
    /// Name of a shipped mission, or of a mission file that is given with the design.
    pub name: String,
    /// Its parameters; a value `@site` stands for a place drawn by the factor location.
    #[serde(default)]
    pub parameters: BTreeMap<String, String>,
    /// Condition of success; default: the mission is completed.
    #[serde(default)]
    pub delivered: Option<DeliveryGoal>,
    /// Its phases in their order, for the report: each task of a managed role is in a single phase.
    /// Default: none, and the report contains no failures by phase.
    #[serde(default)]
    pub phases: Vec<MissionPhase>,
}

/// Phase of a mission. The report counts the failures of its tasks together.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MissionPhase {
    /// Its name.
    pub name: String,
    /// Its tasks.
    pub tasks: BTreeSet<TaskId>,
}

/// A delivery: success if the item reaches its destination.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DeliveryGoal {
    /// The item: an item of a person.
    pub item: String,
    /// Destination: a robot of `fixed`, or a place (`@site` or by name).
    pub to: String,
}

/// A group of robots of the same kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RobotGroup {
    /// Number of robots.
    pub count: usize,
    /// Skills of each robot.
    pub skills: BTreeSet<TaskType>,
    /// Has a drawer.
    #[serde(default)]
    pub drawer: bool,
    /// Has an arm.
    #[serde(default)]
    pub arm: bool,
    /// Roles for which the random policy may choose these robots; default: all managed roles
    /// without a robot of `fixed`.
    #[serde(default)]
    pub roles: BTreeSet<RoleId>,
}

/// A stationary robot on mains power.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FixedRobot {
    /// Its name.
    pub name: RobotId,
    /// Its place: `@site` or by name.
    pub place: String,
    /// Its skills.
    pub skills: BTreeSet<TaskType>,
    /// The role that the random policy gives it.
    pub role: RoleId,
}

/// A person.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DesignPerson {
    /// Her name.
    pub name: String,
    /// Her role in the mission.
    pub role: RoleId,
    /// Her place: `@site` or by name.
    pub place: String,
    /// Items that she hands over.
    #[serde(default)]
    pub items: Vec<ItemId>,
}

/// The varied factors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Factors {
    /// Metres per second.
    pub speed: UniformRange,
    /// Charge at the start, as a share of a full battery.
    pub charge: UniformRange,
    /// Share of a full battery lost per second at work.
    pub discharge: UniformRange,
    /// Start positions and sites.
    pub location: LocationFactor,
    /// Missing skills.
    pub skills: SkillGaps,
}

/// A number for each robot, drawn from a uniform distribution.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UniformRange {
    /// Number of draws for all robots.
    pub levels: usize,
    /// Least and greatest value.
    pub between: (f64, f64),
}

/// Start positions of robots and sites of the mission.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LocationFactor {
    /// Number of draws of the places.
    pub levels: usize,
    /// Possible start places of robots; each robot starts at a different place.
    pub starts: Vec<PlaceId>,
    /// Candidates for the places of the mission, by site; the sites of a scenario differ from each
    /// other. The levels take the candidates in turn, so levels differ, too.
    #[serde(default)]
    pub sites: BTreeMap<String, Vec<PlaceId>>,
}

/// Missing skills of robots.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SkillGaps {
    /// Number of robots without a skill, for each level. The robots and the skills are drawn; in
    /// each group of `robots` at least a single robot keeps all skills.
    pub lacking: Vec<usize>,
}

/// A combination of levels.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scenario {
    /// Its name, unique in the design: a letter for each level, in the order speed, charge,
    /// discharge, location, skills.
    pub code: String,
    /// Its levels.
    pub levels: FactorLevels,
    /// Places of the mission, by site.
    pub sites: BTreeMap<String, PlaceId>,
    /// The mobile robots.
    pub robots: Vec<ScenarioRobot>,
}

/// Names of the levels of a scenario; empty for an imported scenario without levels.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct FactorLevels {
    /// Level of the factor speed.
    pub speed: String,
    /// Level of the factor charge.
    pub charge: String,
    /// Level of the factor discharge.
    pub discharge: String,
    /// Level of the factor location.
    pub location: String,
    /// Level of the factor skills.
    pub skills: String,
}

/// A robot of a scenario.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScenarioRobot {
    /// Its name.
    pub name: RobotId,
    /// Metres per second.
    pub speed_mps: f64,
    /// Charge at the start, as a share.
    pub charge: f64,
    /// Share lost per second at work.
    pub discharge: f64,
    /// Its start place.
    pub place: PlaceId,
    /// Its skills.
    pub skills: BTreeSet<TaskType>,
    /// Has a drawer.
    pub drawer: bool,
    /// Has an arm.
    pub arm: bool,
    /// Roles for which the random policy may choose it; default: all managed roles without a robot
    /// of `fixed`.
    pub roles: BTreeSet<RoleId>,
}

/// A place of a design is unknown in a scenario, or its name is not allowed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PlaceError {
    /// The scenario has no such site.
    #[error("there is no site {written}; sites: {known}")]
    UnknownSite {
        /// The site as written, with `@`.
        written: String,
        /// The sites of the scenario.
        known: String,
    },
    /// The name of a place is not allowed.
    #[error(transparent)]
    Name(#[from] NameError),
}

impl Scenario {
    /// Returns a place of the design: `@site`, or the name of a place.
    ///
    /// # Errors
    /// [`PlaceError`], with the allowed sites.
    pub fn place(&self, written: &str) -> Result<PlaceId, PlaceError> {
        match written.strip_prefix('@') {
            Some(site) => self.sites.get(site).cloned().ok_or_else(|| {
                let known = self.sites.keys().map(|site| format!("@{site}")).collect::<Vec<_>>().join(", ");
                PlaceError::UnknownSite { written: written.to_owned(), known }
            }),
            None => Ok(PlaceId::new(written)?),
        }
    }

    /// Returns the parameters of the mission with places for its sites.
    ///
    /// # Errors
    /// Those of [`place`](Scenario::place), for values that begin with `@`.
    pub fn parameters(&self, mission: &DesignMission) -> Result<BTreeMap<String, String>, PlaceError> {
        let filled = |(name, value): (&String, &String)| {
            let value = if value.starts_with('@') { self.place(value)?.to_string() } else { value.clone() };
            Ok((name.clone(), value))
        };
        mission.parameters.iter().map(filled).collect()
    }
}
