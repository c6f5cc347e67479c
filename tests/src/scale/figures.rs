//! Figures of a measured fleet.

use crate::percentiles::Percentiles;
use serde::Serialize;
use std::collections::BTreeMap;

/// Figures of a fleet. Rates are per second of virtual time, percentages of a core are of virtual time.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ScaleFigures {
    /// Number of robots.
    pub robots: usize,
    /// Robots drove.
    pub moving: bool,
    /// Number of auctions.
    pub missions: usize,
    /// Number of other missions that waited during the measurements of traffic, computing time, views and auctions.
    pub backlog: usize,
    /// Bytes received by the mean robot.
    pub robot_received_bytes_per_s: f64,
    /// Messages received by the mean robot.
    pub robot_received_messages_per_s: f64,
    /// Bytes sent by the mean robot.
    pub robot_sent_bytes_per_s: f64,
    /// Messages sent by the mean robot.
    pub robot_sent_messages_per_s: f64,
    /// Computing time of a robot's node, in percent of a core.
    pub robot_cpu_percent: f64,
    /// Traffic received by the mean robot, by kind of key.
    pub robot_received_by_kind: BTreeMap<&'static str, KindFigures>,
    /// Bytes received by the mean station that does not coordinate.
    pub station_received_bytes_per_s: f64,
    /// Messages received by the mean station that does not coordinate.
    pub station_received_messages_per_s: f64,
    /// Bytes received by the coordinator.
    pub coordinator_received_bytes_per_s: f64,
    /// Messages received by the coordinator.
    pub coordinator_received_messages_per_s: f64,
    /// Bytes sent by the coordinator.
    pub coordinator_sent_bytes_per_s: f64,
    /// Messages sent by the coordinator.
    pub coordinator_sent_messages_per_s: f64,
    /// Computing time of the coordinator's node, in percent of a core.
    pub coordinator_cpu_percent: f64,
    /// Records that the mean node holds.
    pub records_per_node: f64,
    /// Calls for bids and replies to them, per mission. Those for missions of the backlog are included.
    pub messages_per_auction: f64,
    /// Milliseconds from the commit of a request to the commit of the award, and the coordinator's computing
    /// time from the request to the award.
    pub auction_ms: Option<Percentiles>,
    /// Milliseconds from a request of a client to the acknowledgement, and the coordinator's computing time.
    pub commit_ms: Option<Percentiles>,
    /// Milliseconds of computing time of the coordinator to draw the view of the fleet.
    pub view_ms: Option<Percentiles>,
    /// Milliseconds from the kill of the coordinator to the election of the next, without computing time.
    pub takeover_ms: Option<Percentiles>,
    /// Seconds until all nodes of a fleet that starts at once know each other.
    pub start_s: f64,
    /// Bytes that a newcomer receives until it knows all nodes.
    pub join_bytes: u64,
    /// Seconds until a newcomer knows all nodes.
    pub join_s: f64,
    /// Seconds until the coordinator has noticed the loss of a tenth of the robots at once.
    pub loss_detected_s: f64,
    /// Messages received by the mean node per second meanwhile.
    pub loss_messages_per_s: f64,
    /// Digest of all messages with their times: equal for equal sizes and seeds.
    pub trace: String,
    /// Most memory of the process so far, in MB.
    pub memory_mb: Option<f64>,
    /// Duration of the measurement in seconds, of both fleets.
    pub wall_s: f64,
    /// Duration of the measurement on virtual time in seconds, of both fleets.
    pub virtual_s: f64,
}

/// Received traffic of a kind.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct KindFigures {
    /// Bytes.
    pub bytes_per_s: f64,
    /// Messages.
    pub messages_per_s: f64,
}
