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

pub use heard::{Ear, Heard};
pub use kpi::Kpis;
pub use parts::{
    AuctionShown, Bar, CoordinatorShown, EnsembleShown, Logged, MissionShown, NodeShown, Offer, PersonShown, Reach,
    ReachState, RobotShown, RoleShown, Takeover,
};
pub use plan::FloorPlan;

use serde_json::Value;
use std::collections::BTreeMap;

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
    reach: Reach,
    coordinator: Option<CoordinatorShown>,
    takeovers: Vec<Takeover>,
    nodes: BTreeMap<String, NodeShown>,
    robots: BTreeMap<String, RobotShown>,
    people: BTreeMap<String, PersonShown>,
    doors: BTreeMap<String, String>,
    missions: BTreeMap<String, MissionShown>,
    auctions: BTreeMap<String, AuctionShown>,
    /// Bids heard of auctions that have not been closed, with their parts, by mission.
    tenders: BTreeMap<String, Vec<consort_protocol::auction::Bid>>,
    ensembles: BTreeMap<String, EnsembleShown>,
    log: BTreeMap<u64, Logged>,
    /// Events logged so far.
    logged: u64,
    /// When each view was last heard, by its name.
    views: BTreeMap<String, u64>,
    use_of_robots: kpi::Use,
}

impl Picture {
    /// A picture of nothing yet, of this fleet, drawn at this node from `now_ms` on.
    pub fn new(fleet: impl Into<String>, node: impl Into<String>, plan: FloorPlan, now_ms: u64) -> Picture {
        let reach = Reach { state: ReachState::Silent, links: 0, since_ms: now_ms, heard_ms: None };
        Picture { fleet: fleet.into(), node: node.into(), plan, since_ms: now_ms, reach, ..Picture::default() }
    }

    /// The whole, as JSON: objects, named by ids wherever there are several of a kind, and no nulls, so that
    /// [`delta::between`] two of them is small.
    pub fn value(&self) -> Value {
        let log: BTreeMap<String, &Logged> =
            self.log.iter().map(|(number, event)| (number.to_string(), event)).collect();
        let mut value = serde_json::json!({
            "fleet": self.fleet,
            "node": self.node,
            "since_ms": self.since_ms,
            "reach": self.reach,
            "coordinator": self.coordinator,
            "takeovers": self.takeovers,
            "nodes": self.nodes,
            "robots": self.robots,
            "people": self.people,
            "doors": self.doors,
            "missions": self.missions,
            "auctions": self.auctions,
            "ensembles": self.ensembles,
            "log": log,
            "views": self.views,
            "kpis": self.kpis(),
            "map": self.plan.value(),
        });
        delta::strip(&mut value);
        value
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

    /// The ensembles, by name.
    pub fn ensembles(&self) -> &BTreeMap<String, EnsembleShown> {
        &self.ensembles
    }
}

/// Keeps the last `most` of a map in the order of its keys.
fn keep_last<K: Ord + Clone, V>(map: &mut BTreeMap<K, V>, most: usize) {
    while map.len() > most {
        map.pop_first();
    }
}
