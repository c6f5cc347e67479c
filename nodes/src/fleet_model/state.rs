//! What a picture is made of.

use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;

/// How the fleet is reached from where the picture is drawn.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Reachability {
    /// In a word.
    pub state: ReachabilityState,
    /// Links to other nodes.
    pub links: usize,
    /// Since when it is so.
    pub since_ms: u64,
    /// When a coordinator was last heard.
    pub heard_ms: Option<u64>,
}

/// Whether what is shown is up to date.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ReachabilityState {
    /// A coordinator is heard.
    Whole,
    /// Other nodes are linked, and none of them coordinates.
    #[default]
    Silent,
    /// Nobody is linked, and no coordinator is heard.
    Alone,
}

/// Who coordinates.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct CoordinatorModel {
    /// The node.
    pub node: String,
    /// Its term.
    pub term: u64,
    /// Since when.
    pub since_ms: u64,
    /// When a majority of the voters last acknowledged it.
    pub quorum_ms: Option<u64>,
    /// Who keeps the ledger.
    pub voters: Vec<String>,
    /// Who follows without a vote.
    pub observers: Vec<String>,
    /// Voters that are gone for good.
    pub voters_lost: Vec<String>,
}

/// A node began to coordinate.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Takeover {
    /// When.
    pub at_ms: u64,
    /// Who.
    pub node: String,
    /// Its term.
    pub term: u64,
    /// Who coordinated before, if that is known.
    pub from: Option<String>,
    /// From the last word of the former coordinator to the first of the next, in milliseconds.
    pub gap_ms: Option<u64>,
}

/// A node.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct NodeModel {
    /// Whether it is judged alive.
    pub alive: bool,
    /// How it is judged, in a word.
    pub status: String,
    /// When it was last heard of.
    pub heard_ms: u64,
    /// Whether it may keep the ledger.
    pub may_vote: bool,
    /// Whether it stays where it is.
    pub stationary: bool,
    /// Whether it lives on mains power.
    pub mains_powered: bool,
    /// Whether it is about to leave for good.
    pub leaving: bool,
    /// Whether it has a robot.
    pub robot: bool,
}

/// A robot.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RobotModel {
    /// Whether its node is judged alive.
    pub alive: bool,
    /// The place it stands at, or passed last.
    pub place: String,
    /// Metres to the east of the map's origin.
    pub x: f64,
    /// Metres to the north.
    pub y: f64,
    /// Heading in radians, counter-clockwise from east.
    pub yaw: f64,
    /// Charge, as a share.
    pub battery: f64,
    /// Charge below which it takes no work, as a share.
    pub useful_charge: f64,
    /// Whether it can move.
    pub able: bool,
    /// `free`, `holding`, `suspended` or `out_of_service`.
    pub availability: String,
    /// Why it is out of service.
    pub problem: Option<String>,
    /// The mission it works for.
    pub mission: Option<String>,
    /// Its role there.
    pub role: Option<String>,
    /// The task it is at.
    pub task: Option<String>,
    /// Where it drives to.
    pub destination: Option<String>,
    /// The way there: points in metres.
    pub route: Vec<(f64, f64)>,
    /// Its average speed in metres per second.
    pub speed: Option<f64>,
    /// What it can do.
    pub skills: Vec<String>,
    /// When its node was last heard of.
    pub heard_ms: u64,
    /// When its body was last heard of.
    pub body_ms: Option<u64>,
}

/// A person.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct PersonModel {
    /// The role they play.
    pub role: String,
    /// Where they stay.
    pub place: String,
    /// Whether they have left it.
    pub away: bool,
    /// What they have to hand over.
    pub samples: Vec<String>,
    /// Metres to the east of the map's origin, if the place is on the map.
    pub x: Option<f64>,
    /// Metres to the north.
    pub y: Option<f64>,
}

/// A mission.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct MissionModel {
    /// In which order it was submitted.
    pub number: u64,
    /// How it stands, in a word.
    pub state: String,
    /// Why it failed, who withdrew it, what is to be rescued.
    pub cause: Option<String>,
    /// Whether the fleet does nothing more about it.
    pub ended: bool,
    /// Higher is served first.
    pub priority: i64,
    /// When it should be done.
    pub deadline_ms: Option<u64>,
    /// Which of its trees is carried out: `main` or `recovery`.
    pub branch: String,
    /// What the request filled in.
    pub parameters: BTreeMap<String, String>,
    /// Who has which role.
    pub holders: BTreeMap<String, String>,
    /// Steps ended.
    pub done: u64,
    /// Steps in all.
    pub steps: u64,
    /// Why no robots have it yet.
    pub why_pending: Option<String>,
    /// What robots have in their keeping.
    pub items: Option<Value>,
    /// When it was acknowledged.
    pub submitted_ms: u64,
    /// When its roles were first given.
    pub awarded_ms: Option<u64>,
    /// From the request to the award, in milliseconds.
    pub award_after_ms: Option<f64>,
    /// When it ended.
    pub ended_ms: Option<u64>,
    /// Its roles.
    pub roles: BTreeMap<String, RoleModel>,
    /// The tree: tasks, the first is the root, children by their indices.
    pub tasks: Option<Value>,
    /// What was done when, as far as it was heard.
    pub bars: Vec<TaskBar>,
    /// Who had which role when, as far as it was heard.
    pub tenures: Vec<RoleAssignment>,
}

/// A role of a mission.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RoleModel {
    /// `managed` or `unmanaged`.
    pub kind: String,
    /// How far it is, in a word.
    pub phase: String,
    /// Who has it.
    pub holder: Option<String>,
    /// By which award.
    pub epoch: Option<String>,
    /// Its plan: each step with type, label and whether it is done.
    pub steps: Option<Value>,
}

/// A task on the chart.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TaskBar {
    /// The role.
    pub role: String,
    /// The task.
    pub task: String,
    /// Who does it.
    pub by: String,
    /// When it began.
    pub from_ms: u64,
    /// When it ended.
    pub to_ms: Option<u64>,
    /// `running`, `done`, `failed`, or `broken off`.
    pub state: String,
}

/// A robot's time in a role.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RoleAssignment {
    /// The role.
    pub role: String,
    /// The robot.
    pub by: String,
    /// When it got the role, or when that was first heard.
    pub from_ms: u64,
    /// When it no longer had it.
    pub to_ms: Option<u64>,
    /// `at work`, `suspended`, `carried out`, `given up` or `broken off`.
    pub state: String,
    /// How long the robot had said it would take, in milliseconds at the pace of its world, if both are known.
    pub planned_ms: Option<u64>,
}

/// Something that is the matter with the fleet, or that nothing is.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct HealthFinding {
    /// `ok`, `warning` or `error`.
    pub level: String,
    /// What it is about.
    pub about: String,
    /// The node, robot or mission, if it is about one.
    pub name: Option<String>,
    /// What, in words.
    pub says: String,
}

/// A round of an auction.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct AuctionModel {
    /// The mission.
    pub mission: String,
    /// The coordinator's term.
    pub term: u64,
    /// Which round.
    pub round: u64,
    /// When it was closed.
    pub at_ms: u64,
    /// Who was chosen.
    pub chosen: BTreeMap<String, String>,
    /// Why nobody was.
    pub failure: Option<String>,
    /// Answers left out of the record.
    pub omitted: u64,
    /// Every answer, in the order of roles and robots.
    pub offers: Vec<RoleBid>,
}

/// A robot's answer for a role.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct RoleBid {
    /// The role.
    pub role: String,
    /// The robot.
    pub robot: String,
    /// `bid`, `unviable` or `refused`.
    pub verdict: String,
    /// Whether it won.
    pub chosen: bool,
    /// Time for the plan, in seconds.
    pub time_s: Option<f64>,
    /// Charge used, as a share.
    pub energy: Option<f64>,
    /// Charge left, as a share.
    pub remaining: Option<f64>,
    /// Why not.
    pub why: Option<String>,
    /// Where the estimate began.
    pub from: Option<String>,
    /// The parts of the price: label, skill, time and energy.
    pub parts: Option<Value>,
}

/// An ensemble: each node and, if it is none, why it is no member.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct EnsembleModel {
    /// What must be true of a member, as expressions of the fleet file.
    pub membership: Vec<String>,
    /// Skills of which it asks.
    pub skills: Vec<String>,
    /// Whoever was heard longer ago than this is no member, in milliseconds.
    pub stale_after_ms: Option<u64>,
    /// Members.
    pub members: Vec<String>,
    /// Those who are none, each with the reason.
    pub others: BTreeMap<String, String>,
}

/// An event in the log.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LogEntry {
    /// When, by the clock of the node where it happened.
    pub at_ms: u64,
    /// Where it happened.
    pub node: String,
    /// What kind of event: its name in the stream.
    pub kind: String,
    /// The same in a word for people.
    pub word: String,
    /// What happened, in words.
    pub text: String,
    /// The mission it is about.
    pub mission: Option<String>,
    /// The robot it is about.
    pub robot: Option<String>,
    /// Whether somebody should look at it.
    pub alarm: bool,
}
