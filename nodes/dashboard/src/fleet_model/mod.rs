//! A model of the fleet as seen by an observer: inputs are applied, and JSON is rendered. It serves
//! the dashboard and any other live or recorded display. It uses no bus, server or clock.
//!
//! ```text
//!  views, events, telemetry, beacons ──▶ FleetModel ──▶ to_json() ──▶ delta::between(before, after) ──▶ clients
//! ```
//!
//! Instants are milliseconds of a wall clock, with names that end in `_ms`. The model stores the
//! instant of the last contact and not its age, so that it does not change without new inputs. All
//! collections are bounded: see the constants of [`bounds`].

mod assignments;
mod auctions;
mod charge_trend;
pub mod delta;
mod events;
mod floor_plan;
mod input;
mod kpi;
mod missions;
mod schedules;
mod state;
mod tracked;
mod update;

pub use floor_plan::FloorPlan;
pub use input::{FleetInput, FleetListener};
pub use kpi::Kpis;
pub use schedules::{ScheduleModel, schedule_state};
pub(crate) use state::NodeModel;
pub use state::{
    AuctionModel, CoordinatorModel, EnsembleModel, LogEntry, MissionModel, PersonModel, Reachability,
    ReachabilityState, RobotModel, Takeover,
};

use consort_protocol::api::{RobotSelection, SelectionError};
use consort_protocol::ids::{PlaceId, RobotId, ZoneId};
use consort_protocol::knowledge::RobotKnowledge;
use consort_protocol::ledger::{Alarm, AlarmPlan, Closure, SpeedLimit};
use consort_protocol::view::{ChargingView, HealthFinding};
use serde::Serialize;
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use tracked::TrackedMap;

/// Size limits of the model.
pub mod bounds {
    /// Events in the log.
    pub const EVENTS: usize = 500;
    /// Latest ended missions.
    pub const ENDED_MISSIONS: usize = 300;
    /// Latest rounds of auctions.
    pub(crate) const AUCTIONS: usize = 60;
    /// Bars of a mission on the chart.
    pub const BARS: usize = 200;
    /// Closures, and speed limits, each. The ledger's limits are smaller.
    pub(crate) const CLOSURES: usize = 1000;
    /// Alarms in force, and alarms of the fleet file, each.
    pub(crate) const ALARMS: usize = 16;
    /// Zones of the fleet file.
    pub(crate) const ZONES: usize = 1000;
    /// Promised roles of a robot.
    pub(crate) const NEXT_ROLES: usize = 64;
    /// Next occurrences of a schedule.
    pub const OCCURRENCES: usize = 20;
    /// Changes of the coordinator.
    pub const TAKEOVERS: usize = 50;
    /// Health findings.
    pub(crate) const FINDINGS: usize = 50;
    /// Nodes, robots, people and chargers, each; a larger fleet is shown in part.
    pub(crate) const NODES: usize = 2000;
}

/// Time without a beacon after which the coordinator counts as lost, in milliseconds: about a dozen
/// beacons.
pub const NO_COORDINATOR_AFTER_MS: u64 = 3000;

/// The fleet as seen by an observer.
#[derive(Debug, Clone, Default)]
pub struct FleetModel {
    fleet: String,
    /// The observing node.
    node: String,
    plan: FloorPlan,
    since_ms: u64,
    /// True if the rarely changing parts may have changed since the last rendering: fleet, node and
    /// map.
    static_fields_changed: bool,
    reachability: Reachability,
    coordinator: Option<CoordinatorModel>,
    takeovers: Vec<Takeover>,
    nodes: TrackedMap<String, NodeModel>,
    robots: TrackedMap<String, RobotModel>,
    /// Records of the robots, by which orders select them.
    records: BTreeMap<RobotId, RobotKnowledge>,
    people: TrackedMap<String, PersonModel>,
    doors: TrackedMap<String, String>,
    /// A node with a ledger has stated the closures, speed limits and alarms.
    knows_orders: bool,
    /// Closed zones, places and lanes, by their texts, as `A – B`.
    closures: TrackedMap<String, Closure>,
    /// Speed limits, by the texts of their zones, places and lanes.
    speed_limits: TrackedMap<String, SpeedLimit>,
    /// Alarms in force.
    alarms: TrackedMap<String, Alarm>,
    /// Plans of the alarms that people may raise.
    declared_alarms: TrackedMap<String, AlarmPlan>,
    /// Zones of the fleet file, with their places.
    zones: TrackedMap<ZoneId, BTreeSet<PlaceId>>,
    /// Hash of these declarations.
    declared_hash: Option<String>,
    /// Number of consecutive views with other declarations.
    other_declarations: u32,
    missions: TrackedMap<String, MissionModel>,
    schedules: TrackedMap<String, ScheduleModel>,
    auctions: TrackedMap<String, AuctionModel>,
    /// Bids received in open auctions, with their parts, by mission.
    open_bids: BTreeMap<String, Vec<consort_protocol::auction::Bid>>,
    ensembles: TrackedMap<String, EnsembleModel>,
    /// Charging by the robots themselves.
    charging: Option<ChargingView>,
    /// Health findings, the worst first.
    health: Vec<HealthFinding>,
    log: TrackedMap<u64, LogEntry>,
    /// Number of logged events.
    log_count: u64,
    /// Time of each view's content, by the view's name.
    views: BTreeMap<String, u64>,
    utilization: kpi::Utilization,
    world_rate: assignments::WorldRate,
}

impl FleetModel {
    /// Creates an empty model of a fleet, observed at a node from `now_ms` on.
    pub fn new(fleet: impl Into<String>, node: impl Into<String>, plan: FloorPlan, now_ms: u64) -> FleetModel {
        let reachability =
            Reachability { state: ReachabilityState::NoCoordinator, links: 0, since_ms: now_ms, last_contact_ms: None };
        FleetModel {
            fleet: fleet.into(),
            node: node.into(),
            plan,
            since_ms: now_ms,
            reachability,
            ..FleetModel::default()
        }
    }

    /// Returns the complete model as JSON: objects, named by ids, and no nulls.
    pub fn to_json(&self) -> Value {
        let mut drawn = Value::Null;
        self.clone().render_patch(&mut drawn);
        drawn
    }

    /// Updates `drawn`, a former rendering of this model, and returns the changes as a patch (see
    /// [`delta`]). Any value but an object counts as not rendered yet. Only changed parts are
    /// rendered.
    pub fn render_patch(&mut self, drawn: &mut Value) -> Option<Value> {
        if !drawn.is_object() {
            *drawn = Value::Object(Map::new());
            self.mark_all_changed();
        }
        let Value::Object(drawn) = drawn else { return None };
        let mut patch = Map::new();
        let mut renew = |rendered: Value| {
            let Value::Object(rendered) = rendered else { return };
            for (name, mut value) in rendered {
                delta::strip_nulls(&mut value);
                delta::replace_member(drawn, &mut patch, name, value);
            }
        };
        if std::mem::take(&mut self.static_fields_changed) {
            renew(members(&IdentityMembers {
                fleet: &self.fleet,
                node: &self.node,
                since_ms: self.since_ms,
                map: self.plan.map_json(),
            }));
        }
        renew(members(&StateMembers {
            reachability: &self.reachability,
            coordinator: self.coordinator.as_ref(),
            takeovers: &self.takeovers,
            charging: self.charging.as_ref(),
            health: &self.health,
            views: &self.views,
            kpis: self.kpis(),
        }));
        section("nodes", &mut self.nodes, drawn, &mut patch);
        section("robots", &mut self.robots, drawn, &mut patch);
        section("people", &mut self.people, drawn, &mut patch);
        section("doors", &mut self.doors, drawn, &mut patch);
        section("closures", &mut self.closures, drawn, &mut patch);
        section("speed_limits", &mut self.speed_limits, drawn, &mut patch);
        section("alarms", &mut self.alarms, drawn, &mut patch);
        section("declared_alarms", &mut self.declared_alarms, drawn, &mut patch);
        section("zones", &mut self.zones, drawn, &mut patch);
        section("missions", &mut self.missions, drawn, &mut patch);
        section("schedules", &mut self.schedules, drawn, &mut patch);
        section("auctions", &mut self.auctions, drawn, &mut patch);
        section("ensembles", &mut self.ensembles, drawn, &mut patch);
        section("log", &mut self.log, drawn, &mut patch);
        (!patch.is_empty()).then_some(Value::Object(patch))
    }

    /// Marks everything as changed: the model was replaced.
    pub(crate) fn mark_all_changed(&mut self) {
        self.static_fields_changed = true;
        self.nodes.mark_all_changed();
        self.robots.mark_all_changed();
        self.people.mark_all_changed();
        self.doors.mark_all_changed();
        self.closures.mark_all_changed();
        self.speed_limits.mark_all_changed();
        self.alarms.mark_all_changed();
        self.declared_alarms.mark_all_changed();
        self.zones.mark_all_changed();
        self.missions.mark_all_changed();
        self.schedules.mark_all_changed();
        self.auctions.mark_all_changed();
        self.ensembles.mark_all_changed();
        self.log.mark_all_changed();
    }

    /// Returns the missions, by id.
    pub fn missions(&self) -> &BTreeMap<String, MissionModel> {
        &self.missions
    }

    /// Returns the schedules, by name.
    pub fn schedules(&self) -> &BTreeMap<String, ScheduleModel> {
        &self.schedules
    }

    /// Returns the robots, by name.
    pub fn robots(&self) -> &BTreeMap<String, RobotModel> {
        &self.robots
    }

    /// Returns the reachability of the fleet.
    pub fn reachability(&self) -> &Reachability {
        &self.reachability
    }

    /// Returns the last known coordinator.
    pub fn coordinator(&self) -> Option<&CoordinatorModel> {
        self.coordinator.as_ref()
    }

    /// Returns the changes of the coordinator, oldest first.
    pub fn takeovers(&self) -> &[Takeover] {
        &self.takeovers
    }

    /// Returns the log, by number.
    pub fn log(&self) -> &BTreeMap<u64, LogEntry> {
        &self.log
    }

    /// Checks whether the closures, speed limits and alarms are known: a node with a ledger has stated them.
    pub fn knows_orders(&self) -> bool {
        self.knows_orders
    }

    /// Returns the closures, by the texts of their zones, places and lanes.
    pub fn closures(&self) -> &BTreeMap<String, Closure> {
        &self.closures
    }

    /// Returns the speed limits, by the texts of their zones, places and lanes.
    pub fn speed_limits(&self) -> &BTreeMap<String, SpeedLimit> {
        &self.speed_limits
    }

    /// Returns the alarms in force, by name.
    pub fn alarms(&self) -> &BTreeMap<String, Alarm> {
        &self.alarms
    }

    /// Returns the plans of the alarms that people may raise, by name.
    pub fn declared_alarms(&self) -> &BTreeMap<String, AlarmPlan> {
        &self.declared_alarms
    }

    /// Returns the zones of the fleet file, by name.
    pub fn zones(&self) -> &BTreeMap<ZoneId, BTreeSet<PlaceId>> {
        &self.zones
    }

    /// Returns the robots that an order to this selection would affect now. The coordinator selects them again.
    ///
    /// # Errors
    /// As [`RobotSelection::among`].
    pub fn selected(&self, selection: &RobotSelection) -> Result<BTreeSet<RobotId>, SelectionError> {
        selection.among(&self.records, &self.zones)
    }

    /// Returns the people, by name.
    pub fn people(&self) -> &BTreeMap<String, PersonModel> {
        &self.people
    }

    /// Returns the states of automatic doors, by name: `closed`, `opening`, `open` or `closing`.
    pub(crate) fn doors(&self) -> &BTreeMap<String, String> {
        &self.doors
    }

    /// Returns the auctions, by mission, term and round.
    pub fn auctions(&self) -> &BTreeMap<String, AuctionModel> {
        &self.auctions
    }

    /// Returns the health findings of the nearest node, the worst first.
    pub fn health(&self) -> &[HealthFinding] {
        &self.health
    }

    /// Returns the ensembles, by name.
    pub fn ensembles(&self) -> &BTreeMap<String, EnsembleModel> {
        &self.ensembles
    }
}

/// Members of a rendering that change only when the model is replaced.
#[derive(Serialize)]
struct IdentityMembers<'a> {
    fleet: &'a str,
    node: &'a str,
    since_ms: u64,
    map: &'a Value,
}

/// Members of a rendering that are written as a whole.
#[derive(Serialize)]
struct StateMembers<'a> {
    reachability: &'a Reachability,
    coordinator: Option<&'a CoordinatorModel>,
    takeovers: &'a [Takeover],
    charging: Option<&'a ChargingView>,
    health: &'a [HealthFinding],
    views: &'a BTreeMap<String, u64>,
    kpis: Kpis,
}

fn members(of: &impl Serialize) -> Value {
    serde_json::to_value(of).expect("members serialize to JSON")
}

/// Renders a section again, if any member has changed.
fn section<K: Ord + Clone + Display, V: Serialize>(
    name: &str,
    members: &mut TrackedMap<K, V>,
    drawn: &mut Map<String, Value>,
    patch: &mut Map<String, Value>,
) {
    let section = drawn.entry(name).or_insert_with(|| Value::Object(Map::new()));
    if let Value::Object(section) = section
        && let Some(change) = members.render_patch(section)
    {
        patch.insert(name.to_owned(), change);
    }
}
