//! How fast a fleet notices and reacts: two sets of times that belong together.
//!
//! | | `lan` | `wifi` | what it decides |
//! |---|---|---|---|
//! | heartbeat | 100 ms | 250 ms | how often a leader speaks, and after which it asks whether it is heard |
//! | election | 300–600 ms | 1500–3000 ms | after which silence a node stands for election |
//! | silence bound | 280 ms | 1400 ms | after which silence of the majority a leader doubts itself |
//! | beacon | 250 ms | 500 ms | how often the coordinator tells robots that it is there |
//! | auction window | 200 ms | 800 ms | how long an auction waits for a member that does not answer |
//! | gossip beat, round | 2 s, 1 s | 2 s, 1 s | how often knowledge is repeated (more rarely in large fleets) and compared |
//! | probe, its round trip | 500, 150 ms | 1000, 400 ms | how failures are detected |
//! | suspicion | 2 s | 4 s | how long a suspect has to say that it is alive |
//! | dead after | 10 s | 20 s | how long a voter must be gone until the autopilot replaces it |
//! | link lease | 2 s | 5 s | how long Zenoh counts a silent neighbour as linked |
//!
//! **`lan`** is for wired machines with round trips of some milliseconds. Three heartbeats fit into the shortest
//! election, so two may be lost or late; the bound on silence leaves a leader 180 ms in which its machine may do
//! something else before it doubts itself. Shorter elections find a dead leader sooner (150–300 ms: median 176 ms) and
//! doubt a healthy one on a busy machine, which was observed with two cores and seven nodes.
//!
//! **`wifi`** is for links that lose one message in ten and stall for a second when a robot roams. A voter takes its leader for
//! lost only after six heartbeats in a row were lost.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A set of times. All nodes of a fleet use the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Timing {
    /// Wired machines: the default.
    #[default]
    Lan,
    /// Links that lose messages and stall.
    Wifi,
}

/// The times of a [`Timing`]; the module's table gives them with their reasons.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TimingParameters {
    /// How often a leader speaks.
    pub heartbeat: Duration,
    /// The shortest silence after which a node stands for election.
    pub election_min: Duration,
    /// The longest.
    pub election_max: Duration,
    /// How often the coordinator publishes its beacon.
    pub beacon_interval: Duration,
    /// How long an auction waits for a member that does not answer.
    pub auction_window: Duration,
    /// How often a node repeats its record.
    pub gossip_refresh: Duration,
    /// How often two nodes compare what they know.
    pub anti_entropy_interval: Duration,
    /// How often a random member is probed.
    pub probe_period: Duration,
    /// How long a probed member may take to answer.
    pub probe_timeout: Duration,
    /// How long a suspect has to say that it is alive.
    pub suspicion_timeout: Duration,
    /// How long a voter must be gone until it is replaced.
    pub dead_after: Duration,
    /// How long a silent neighbour counts as linked.
    pub link_lease: Duration,
}

impl Timing {
    /// Its times.
    pub fn parameters(self) -> TimingParameters {
        let ms = Duration::from_millis;
        match self {
            Timing::Lan => TimingParameters {
                heartbeat: ms(100),
                election_min: ms(300),
                election_max: ms(600),
                beacon_interval: ms(250),
                auction_window: ms(200),
                gossip_refresh: ms(2000),
                anti_entropy_interval: ms(1000),
                probe_period: ms(500),
                probe_timeout: ms(150),
                suspicion_timeout: ms(2000),
                dead_after: ms(10_000),
                link_lease: ms(2000),
            },
            Timing::Wifi => TimingParameters {
                heartbeat: ms(250),
                election_min: ms(1500),
                election_max: ms(3000),
                beacon_interval: ms(500),
                auction_window: ms(800),
                gossip_refresh: ms(2000),
                anti_entropy_interval: ms(1000),
                probe_period: ms(1000),
                probe_timeout: ms(400),
                suspicion_timeout: ms(4000),
                dead_after: ms(20_000),
                link_lease: ms(5000),
            },
        }
    }
}
