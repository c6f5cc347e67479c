//! The fleet as it is known at one place: values in, values out. The dashboard shows it, and so may whatever else wants to
//! show a fleet, live or recorded: nothing here knows a bus, a server or a clock.
//!
//! ```text
//!  views, events, body states, beacons ──▶ Picture ──▶ value() ──▶ delta::between(before, after) ──▶ whoever looks on
//! ```
//!
//! Instants are milliseconds of a wall clock, and go by names that end in `_ms`; where something was heard of, the picture
//! has the instant and not its age, so that a thing of which nothing new is heard does not change. Everything is bounded:
//! see the constants of [`bounds`].

mod assignments;
mod auctions;
pub mod delta;
mod events;
mod floor_plan;
mod input;
mod kpi;
mod missions;
mod state;
mod tracked;
mod update;

pub use floor_plan::FloorPlan;
pub use input::{FleetInput, FleetListener};
pub use kpi::Kpis;
pub use state::{
    AuctionModel, CoordinatorModel, EnsembleModel, HealthFinding, LogEntry, MissionModel, NodeModel, PersonModel,
    Reachability, ReachabilityState, RobotModel, RoleAssignment, RoleBid, RoleModel, Takeover, TaskBar,
};

use serde::Serialize;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::fmt::Display;
use tracked::TrackedMap;

/// How much a picture holds.
pub mod bounds {
    /// Events in the log.
    pub const EVENTS: usize = 500;
    /// Missions that have ended, the latest.
    pub const ENDED_MISSIONS: usize = 300;
    /// Rounds of auctions, the latest.
    pub const AUCTIONS: usize = 60;
    /// Bars of one mission on the chart.
    pub const BARS: usize = 200;
    /// Changes of the coordinator.
    pub const TAKEOVERS: usize = 50;
    /// What is the matter.
    pub const FINDINGS: usize = 50;
    /// Nodes, robots and people, each; a fleet of more is shown in part.
    pub const NODES: usize = 2000;
}

/// After this long without a word of a coordinator, its place counts as silent, in milliseconds: a dozen of its beacons.
pub const NO_COORDINATOR_AFTER_MS: u64 = 3000;

/// The fleet as known.
#[derive(Debug, Clone, Default)]
pub struct FleetModel {
    fleet: String,
    /// At which node it is drawn.
    node: String,
    plan: FloorPlan,
    since_ms: u64,
    /// Whether what hardly ever changes may have, since it was drawn: fleet, node and map.
    static_fields_changed: bool,
    reach: Reachability,
    coordinator: Option<CoordinatorModel>,
    takeovers: Vec<Takeover>,
    nodes: TrackedMap<String, NodeModel>,
    robots: TrackedMap<String, RobotModel>,
    people: TrackedMap<String, PersonModel>,
    doors: TrackedMap<String, String>,
    missions: TrackedMap<String, MissionModel>,
    auctions: TrackedMap<String, AuctionModel>,
    /// Bids heard of auctions that have not been closed, with their parts, by mission.
    open_bids: BTreeMap<String, Vec<consort_protocol::auction::Bid>>,
    ensembles: TrackedMap<String, EnsembleModel>,
    /// What is the matter, the worst first.
    health: Vec<HealthFinding>,
    log: TrackedMap<u64, LogEntry>,
    /// Events logged so far.
    log_count: u64,
    /// When each view was last heard, by its name.
    views: BTreeMap<String, u64>,
    utilization: kpi::Utilization,
    world_rate: assignments::WorldRate,
}

impl FleetModel {
    /// A picture of nothing yet, of this fleet, drawn at this node from `now_ms` on.
    pub fn new(fleet: impl Into<String>, node: impl Into<String>, plan: FloorPlan, now_ms: u64) -> FleetModel {
        let reach = Reachability { state: ReachabilityState::Silent, links: 0, since_ms: now_ms, heard_ms: None };
        FleetModel { fleet: fleet.into(), node: node.into(), plan, since_ms: now_ms, reach, ..FleetModel::default() }
    }

    /// The whole, as JSON: objects, named by ids wherever there are several of a kind, and no nulls.
    pub fn to_json(&self) -> Value {
        let mut drawn = Value::Null;
        self.clone().render_patch(&mut drawn);
        drawn
    }

    /// Brings `drawn`, which this was drawn to before, up to date, and says what has changed since, as a patch (see
    /// [`delta`]). Anything but an object counts as drawn never before. Only what has been touched since is looked at.
    pub fn render_patch(&mut self, drawn: &mut Value) -> Option<Value> {
        if !drawn.is_object() {
            *drawn = json!({});
            self.mark_all_changed();
        }
        let Value::Object(drawn) = drawn else { return None };
        let mut patch = Map::new();
        let mut renew = |members: Value| {
            let Value::Object(members) = members else { return };
            for (name, mut value) in members {
                delta::strip_nulls(&mut value);
                delta::replace_member(drawn, &mut patch, name, value);
            }
        };
        if std::mem::take(&mut self.static_fields_changed) {
            renew(
                json!({ "fleet": self.fleet, "node": self.node, "since_ms": self.since_ms, "map": self.plan.map_json() }),
            );
        }
        renew(json!({
            "reach": self.reach,
            "coordinator": self.coordinator,
            "takeovers": self.takeovers,
            "health": self.health,
            "views": self.views,
            "kpis": self.kpis(),
        }));
        section("nodes", &mut self.nodes, drawn, &mut patch);
        section("robots", &mut self.robots, drawn, &mut patch);
        section("people", &mut self.people, drawn, &mut patch);
        section("doors", &mut self.doors, drawn, &mut patch);
        section("missions", &mut self.missions, drawn, &mut patch);
        section("auctions", &mut self.auctions, drawn, &mut patch);
        section("ensembles", &mut self.ensembles, drawn, &mut patch);
        section("log", &mut self.log, drawn, &mut patch);
        (!patch.is_empty()).then_some(Value::Object(patch))
    }

    /// Counts everything as changed since it was drawn: this is not the picture that was.
    pub(crate) fn mark_all_changed(&mut self) {
        self.static_fields_changed = true;
        self.nodes.mark_all_changed();
        self.robots.mark_all_changed();
        self.people.mark_all_changed();
        self.doors.mark_all_changed();
        self.missions.mark_all_changed();
        self.auctions.mark_all_changed();
        self.ensembles.mark_all_changed();
        self.log.mark_all_changed();
    }

    /// The missions, by id.
    pub fn missions(&self) -> &BTreeMap<String, MissionModel> {
        &self.missions
    }

    /// The robots, by name.
    pub fn robots(&self) -> &BTreeMap<String, RobotModel> {
        &self.robots
    }

    /// How the fleet is reached.
    pub fn reach(&self) -> &Reachability {
        &self.reach
    }

    /// Who coordinates, as far as was heard.
    pub fn coordinator(&self) -> Option<&CoordinatorModel> {
        self.coordinator.as_ref()
    }

    /// The changes of the coordinator, oldest first.
    pub fn takeovers(&self) -> &[Takeover] {
        &self.takeovers
    }

    /// The log, by number.
    pub fn log(&self) -> &BTreeMap<u64, LogEntry> {
        &self.log
    }

    /// The people, by name.
    pub fn people(&self) -> &BTreeMap<String, PersonModel> {
        &self.people
    }

    /// How automatic doors stand, by name: `closed`, `opening`, `open` or `closing`.
    pub fn doors(&self) -> &BTreeMap<String, String> {
        &self.doors
    }

    /// The auctions, by mission, term and round.
    pub fn auctions(&self) -> &BTreeMap<String, AuctionModel> {
        &self.auctions
    }

    /// What is the matter with the fleet, as the nearest node judges, the worst first.
    pub fn health(&self) -> &[HealthFinding] {
        &self.health
    }

    /// The ensembles, by name.
    pub fn ensembles(&self) -> &BTreeMap<String, EnsembleModel> {
        &self.ensembles
    }
}

/// Draws one section anew, where something in it was touched.
fn section<K: Ord + Clone + Display, V: Serialize>(
    name: &str,
    members: &mut TrackedMap<K, V>,
    drawn: &mut Map<String, Value>,
    patch: &mut Map<String, Value>,
) {
    let section = drawn.entry(name).or_insert_with(|| json!({}));
    if let Value::Object(section) = section
        && let Some(change) = members.render_patch(section)
    {
        patch.insert(name.to_owned(), change);
    }
}
