//! What is to be tried: a design, as a file says it.
//!
//! ```toml
//! name = "published"              # a slug: part of every seed, and of file names
//! seed = 2022
//! repetitions = 8                 # of each scenario under each policy, each with new chance
//! policies = ["consort", "random"]
//! treatments = ["calm"]           # and "coordinator-killed"
//! map = "hospital"                # one that is shipped, or a file
//!
//! [mission]
//! name = "lab-samples"            # one that is shipped
//! parameters = { room = "@room" } # @site stands for a place that the factor location draws
//! delivered = { item = "sample", to = "lab-arm" }   # what success is; without it: that the mission is completed
//!
//! [[robots]]                      # called r1, r2, … in the order of the file
//! count = 6
//! skills = ["navigation", "operate_drawer"]
//! drawer = true
//!
//! [[fixed]]                       # who stands in one place and is the same in every scenario
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
//! skills    = { lacking = [4, 2, 0] }   # a level each: so many robots lack one skill of theirs
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
use consort_protocol::ids::{ItemId, PlaceId, RobotId, RoleId, TaskType};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// A design as written. [`Design::problems`] says what is wrong with it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Design {
    /// Its name: a slug.
    pub name: String,
    /// Where all chance comes from.
    #[serde(default)]
    pub seed: u64,
    /// How often each scenario is tried under each policy and treatment.
    pub repetitions: u32,
    /// The rules that are compared. The first is the one that the others are compared with.
    pub policies: Vec<Policy>,
    /// What is done to the fleet.
    #[serde(default = "calm")]
    pub treatments: Vec<Treatment>,
    /// The name of a shipped map, or the path of a file.
    pub map: String,
    /// World seconds that pass in one second of the fleet's own time. What the fleet does takes so many times as long in the
    /// world as it would with a speed of 1: elections, auctions and messages are made to look slower than they are, never
    /// faster. Default 20, at which a message between two nodes takes some hundredths of a second in the world.
    #[serde(default = "world_speed")]
    pub world_speed: f64,
    /// With the treatment `coordinator-killed`: the moment is drawn between the request and so many world seconds later.
    /// Default 240, somewhat less than the published missions take, so that most kills fall into the mission.
    #[serde(default = "kill_within_s")]
    pub kill_within_s: f64,
    /// The mission.
    pub mission: DesignMission,
    /// When a trial is cut.
    #[serde(default)]
    pub limits: TrialLimits,
    /// Robots that drive.
    pub robots: Vec<RobotGroup>,
    /// Robots that do not.
    #[serde(default)]
    pub fixed: Vec<FixedRobot>,
    /// People.
    #[serde(default)]
    pub people: Vec<DesignPerson>,
    /// What is varied.
    pub factors: Factors,
    /// How long drives take.
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
    /// The name of a shipped mission.
    pub name: String,
    /// Its parameters; a value `@site` stands for a place that the factor location draws.
    #[serde(default)]
    pub parameters: BTreeMap<String, String>,
    /// What success is; without it, that the mission is completed.
    #[serde(default)]
    pub delivered: Option<DeliveryGoal>,
}

/// Something has reached its destination.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DeliveryGoal {
    /// The thing: one of a person's items.
    pub item: String,
    /// Where to: a robot of `fixed`, or a place (`@site` or by name).
    pub to: String,
}

/// Some robots of one kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RobotGroup {
    /// How many.
    pub count: usize,
    /// What each can do.
    pub skills: BTreeSet<TaskType>,
    /// Whether it has a drawer.
    #[serde(default)]
    pub drawer: bool,
    /// Whether it has an arm.
    #[serde(default)]
    pub arm: bool,
    /// The roles for which chance may choose it; all managed roles that no robot of `fixed` has if there are none.
    #[serde(default)]
    pub roles: BTreeSet<RoleId>,
}

/// A robot that stays where it is, on mains power.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FixedRobot {
    /// Its name.
    pub name: RobotId,
    /// Where it stands: `@site` or by name.
    pub place: String,
    /// What it can do.
    pub skills: BTreeSet<TaskType>,
    /// The role that chance gives it.
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
    /// Where she is: `@site` or by name.
    pub place: String,
    /// What she has to hand over.
    #[serde(default)]
    pub items: Vec<ItemId>,
}

/// What is varied.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Factors {
    /// Metres per second.
    pub speed: UniformRange,
    /// Charge at the start, as a share of a full battery.
    pub charge: UniformRange,
    /// Share of a full battery lost per second at work.
    pub discharge: UniformRange,
    /// Where everybody is.
    pub location: LocationFactor,
    /// Who lacks what.
    pub skills: SkillGaps,
}

/// A number for each robot, drawn evenly.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UniformRange {
    /// How many times the robots' numbers are drawn.
    pub levels: usize,
    /// Least and greatest.
    pub between: (f64, f64),
}

/// Where everybody is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LocationFactor {
    /// How many times the places are drawn.
    pub levels: usize,
    /// Where robots may start, each in another place.
    pub starts: Vec<PlaceId>,
    /// Where the places of the mission may be, by name; sites differ from one another. Level by level each candidate comes
    /// once before one comes again, so that levels differ, too.
    #[serde(default)]
    pub sites: BTreeMap<String, Vec<PlaceId>>,
}

/// Who lacks what.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SkillGaps {
    /// For each level, how many robots lack one of their skills. Those are drawn, and so is the skill; of each part of
    /// `robots` at least one lacks nothing.
    pub lacking: Vec<usize>,
}

/// One combination of levels.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scenario {
    /// Its name, unique in the design: the levels, a letter each, in the order speed, charge, discharge, location, skills.
    pub code: String,
    /// The levels by which it was made.
    pub levels: FactorLevels,
    /// The places of the mission, by name.
    pub sites: BTreeMap<String, PlaceId>,
    /// The robots that drive.
    pub robots: Vec<ScenarioRobot>,
}

/// The levels of a scenario, each named; empty for one that was made elsewhere and does not say.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct FactorLevels {
    /// Of the factor speed.
    pub speed: String,
    /// Of the factor charge.
    pub charge: String,
    /// Of the factor discharge.
    pub discharge: String,
    /// Of the factor location.
    pub location: String,
    /// Of the factor skills.
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
    /// Where it starts.
    pub place: PlaceId,
    /// What it can do.
    pub skills: BTreeSet<TaskType>,
    /// Whether it has a drawer.
    pub drawer: bool,
    /// Whether it has an arm.
    pub arm: bool,
    /// The roles for which chance may choose it; all that nobody in `fixed` has if there are none.
    pub roles: BTreeSet<RoleId>,
}

impl Scenario {
    /// A place as a design writes it: `@site`, or its name.
    ///
    /// # Errors
    /// What is wrong, and what is allowed.
    pub fn place(&self, written: &str) -> Result<PlaceId, String> {
        match written.strip_prefix('@') {
            Some(site) => self.sites.get(site).cloned().ok_or_else(|| {
                let known = self.sites.keys().map(|site| format!("@{site}")).collect::<Vec<_>>().join(", ");
                format!("there is no site {written}; there are: {known}")
            }),
            None => PlaceId::new(written).map_err(|error| error.to_string()),
        }
    }

    /// The mission's parameters with its sites filled in.
    ///
    /// # Errors
    /// As [`place`](Scenario::place), for values that begin with `@`.
    pub fn parameters(&self, mission: &DesignMission) -> Result<BTreeMap<String, String>, String> {
        let filled = |(name, value): (&String, &String)| {
            let value = if value.starts_with('@') { self.place(value)?.to_string() } else { value.clone() };
            Ok((name.clone(), value))
        };
        mission.parameters.iter().map(filled).collect()
    }
}
