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

mod auctions;
pub mod delta;
mod fold;
mod happenings;
mod heard;
mod kpi;
mod missions;
mod parts;
mod plan;
mod tenures;
mod tracked;

pub use heard::{Ear, Heard};
pub use kpi::Kpis;
pub use parts::{
    AuctionShown, Bar, CoordinatorShown, EnsembleShown, FindingShown, Logged, MissionShown, NodeShown, Offer,
    PersonShown, Reach, ReachState, RobotShown, RoleShown, Takeover, Tenure,
};
pub use plan::FloorPlan;

use serde::Serialize;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::fmt::Display;
use tracked::Tracked;

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
pub const SILENT_AFTER_MS: u64 = 3000;

/// The fleet as known.
#[derive(Debug, Clone, Default)]
pub struct Picture {
    fleet: String,
    /// At which node it is drawn.
    node: String,
    plan: FloorPlan,
    since_ms: u64,
    /// Whether what hardly ever changes may have, since it was drawn: fleet, node and map.
    ground_touched: bool,
    reach: Reach,
    coordinator: Option<CoordinatorShown>,
    takeovers: Vec<Takeover>,
    nodes: Tracked<String, NodeShown>,
    robots: Tracked<String, RobotShown>,
    people: Tracked<String, PersonShown>,
    doors: Tracked<String, String>,
    missions: Tracked<String, MissionShown>,
    auctions: Tracked<String, AuctionShown>,
    /// Bids heard of auctions that have not been closed, with their parts, by mission.
    tenders: BTreeMap<String, Vec<consort_protocol::auction::Bid>>,
    ensembles: Tracked<String, EnsembleShown>,
    /// What is the matter, the worst first.
    health: Vec<FindingShown>,
    log: Tracked<u64, Logged>,
    /// Events logged so far.
    logged: u64,
    /// When each view was last heard, by its name.
    views: BTreeMap<String, u64>,
    use_of_robots: kpi::Use,
    pace: tenures::Pace,
}

impl Picture {
    /// A picture of nothing yet, of this fleet, drawn at this node from `now_ms` on.
    pub fn new(fleet: impl Into<String>, node: impl Into<String>, plan: FloorPlan, now_ms: u64) -> Picture {
        let reach = Reach { state: ReachState::Silent, links: 0, since_ms: now_ms, heard_ms: None };
        Picture { fleet: fleet.into(), node: node.into(), plan, since_ms: now_ms, reach, ..Picture::default() }
    }

    /// The whole, as JSON: objects, named by ids wherever there are several of a kind, and no nulls.
    pub fn value(&self) -> Value {
        let mut drawn = Value::Null;
        self.clone().redraw(&mut drawn);
        drawn
    }

    /// Brings `drawn`, which this was drawn to before, up to date, and says what has changed since, as a patch (see
    /// [`delta`]). Anything but an object counts as drawn never before. Only what has been touched since is looked at.
    pub fn redraw(&mut self, drawn: &mut Value) -> Option<Value> {
        if !drawn.is_object() {
            *drawn = json!({});
            self.touch_all();
        }
        let Value::Object(drawn) = drawn else { return None };
        let mut patch = Map::new();
        let mut renew = |members: Value| {
            let Value::Object(members) = members else { return };
            for (name, mut value) in members {
                delta::strip(&mut value);
                delta::renew(drawn, &mut patch, name, value);
            }
        };
        if std::mem::take(&mut self.ground_touched) {
            renew(
                json!({ "fleet": self.fleet, "node": self.node, "since_ms": self.since_ms, "map": self.plan.value() }),
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
    pub(crate) fn touch_all(&mut self) {
        self.ground_touched = true;
        self.nodes.touch_all();
        self.robots.touch_all();
        self.people.touch_all();
        self.doors.touch_all();
        self.missions.touch_all();
        self.auctions.touch_all();
        self.ensembles.touch_all();
        self.log.touch_all();
    }

    /// The missions, by id.
    pub fn missions(&self) -> &BTreeMap<String, MissionShown> {
        &self.missions
    }

    /// The robots, by name.
    pub fn robots(&self) -> &BTreeMap<String, RobotShown> {
        &self.robots
    }

    /// How the fleet is reached.
    pub fn reach(&self) -> &Reach {
        &self.reach
    }

    /// Who coordinates, as far as was heard.
    pub fn coordinator(&self) -> Option<&CoordinatorShown> {
        self.coordinator.as_ref()
    }

    /// The changes of the coordinator, oldest first.
    pub fn takeovers(&self) -> &[Takeover] {
        &self.takeovers
    }

    /// The log, by number.
    pub fn log(&self) -> &BTreeMap<u64, Logged> {
        &self.log
    }

    /// The people, by name.
    pub fn people(&self) -> &BTreeMap<String, PersonShown> {
        &self.people
    }

    /// How automatic doors stand, by name: `closed`, `opening`, `open` or `closing`.
    pub fn doors(&self) -> &BTreeMap<String, String> {
        &self.doors
    }

    /// The auctions, by mission, term and round.
    pub fn auctions(&self) -> &BTreeMap<String, AuctionShown> {
        &self.auctions
    }

    /// What is the matter with the fleet, as the nearest node judges, the worst first.
    pub fn health(&self) -> &[FindingShown] {
        &self.health
    }

    /// The ensembles, by name.
    pub fn ensembles(&self) -> &BTreeMap<String, EnsembleShown> {
        &self.ensembles
    }
}

/// Draws one section anew, where something in it was touched.
fn section<K: Ord + Clone + Display, V: Serialize>(
    name: &str,
    members: &mut Tracked<K, V>,
    drawn: &mut Map<String, Value>,
    patch: &mut Map<String, Value>,
) {
    let section = drawn.entry(name).or_insert_with(|| json!({}));
    if let Value::Object(section) = section
        && let Some(change) = members.redraw(section)
    {
        patch.insert(name.to_owned(), change);
    }
}
