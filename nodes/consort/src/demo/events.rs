//! The demo's own events, as `demo --json` prints them: one object per line.

use consort_protocol::ids::{MissionId, NodeId};
use serde::Serialize;

/// Event of the demo.
#[derive(Serialize)]
#[serde(tag = "event")]
pub(super) enum DemoEvent {
    /// The first line.
    #[serde(rename = "demo_started")]
    Started {
        /// Description of the fleet.
        fleet: String,
    },
    /// The dashboard is served.
    #[serde(rename = "demo_dashboard")]
    Dashboard {
        /// Its address.
        url: String,
    },
    /// The coordinator was killed.
    #[serde(rename = "demo_killed")]
    Killed {
        /// The killed node.
        node: NodeId,
    },
    /// Another node has taken over.
    #[serde(rename = "demo_takeover")]
    Takeover(Takeover),
    /// The killed node was started again.
    #[serde(rename = "demo_restarted")]
    Restarted {
        /// The node.
        node: NodeId,
    },
    /// The last line.
    #[serde(rename = "demo_summary")]
    Summary(DemoSummary),
    /// The fleet runs until it is interrupted.
    #[serde(rename = "demo_keeps_running")]
    KeepsRunning,
}

/// Takeover after the kill.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Takeover {
    /// The new coordinator.
    pub(super) node: NodeId,
    /// Time since the kill, in milliseconds.
    pub(super) after_ms: f64,
}

/// Result of the demo.
#[derive(Serialize)]
pub(super) struct DemoSummary {
    /// Result of each mission.
    pub(super) missions: Vec<MissionResult>,
    /// Number of completed missions.
    pub(super) completed: usize,
    /// Number of samples of all missions.
    pub(super) samples: usize,
    /// Number of samples in the laboratory.
    pub(super) delivered: usize,
    /// The killed node; `null` without a kill.
    pub(super) killed: Option<NodeId>,
    /// Takeover by the next coordinator; `null` if no coordinator was killed.
    pub(super) takeover: Option<Takeover>,
}

/// Result of a mission.
#[derive(Serialize)]
pub(super) struct MissionResult {
    /// The mission.
    pub(super) mission: MissionId,
    /// Room of the request.
    pub(super) room: String,
    /// State at the end.
    pub(super) outcome: &'static str,
    /// Time from the request to the award, in milliseconds; `null` without an award.
    pub(super) award_ms: Option<f64>,
    /// Time from the request to the end, in seconds.
    pub(super) took_s: f64,
    /// Number of auctions.
    pub(super) auctions: u32,
    /// The holders of the roles.
    pub(super) holders: String,
}

/// A line of output: an event with the seconds since the start of the demo.
#[derive(Serialize)]
pub(super) struct TimedEvent<E> {
    #[serde(flatten)]
    pub(super) event: E,
    pub(super) t_s: f64,
}
