//! Timing parameters of a fleet: two presets of values that fit together.
//!
//! | | `lan` | `wifi` | meaning |
//! |---|---|---|---|
//! | heartbeat | 100 ms | 250 ms | interval of a leader's heartbeats; a voter that is late by half of it is probed |
//! | election | 300–600 ms | 1500–3000 ms | time without leader contact after which a voter campaigns |
//! | check-quorum timeout | 280 ms | 1400 ms | time without acknowledgements of a majority after which a leader gives up leadership |
//! | beacon | 250 ms | 500 ms | interval of the coordinator's beacons to the robots |
//! | auction window | 200 ms | 800 ms | time that an auction waits for a member that does not reply |
//! | gossip refresh, anti-entropy | 2 s, 1 s | 2 s, 1 s | intervals of repeating a node's record (longer in large fleets) and of comparing digests |
//! | probe, its timeout | 500, 150 ms | 1000, 400 ms | failure detection |
//! | suspicion | 2 s | 4 s | time that a suspect has to refute |
//! | dead after | 10 s | 20 s | time that a voter must be gone before the autopilot replaces it |
//! | link lease | 2 s | 5 s | time for which Zenoh treats a silent neighbor as linked |
//!
//! A leader whose process has ended is replaced within fractions of a heartbeat, without the election
//! timeout, since its presence token vanishes with its sockets.
//!
//! **`lan`** is for wired machines with round trips of some milliseconds. Three heartbeats fit into
//! the shortest election timeout, so two heartbeats may be lost or late. The check-quorum timeout
//! leaves a leader 180 ms in which its machine may be busy with other work. Shorter election
//! timeouts detect a dead leader sooner (150–300 ms: median 176 ms), but depose a healthy leader on
//! a busy machine. This was observed with two cores and seven nodes.
//!
//! **`wifi`** is for links that lose one message in ten and stall for a second when a robot roams, and for links of
//! 1 Mbit/s, on which a heartbeat takes half a second while views are downloaded.
//! A voter treats its leader as lost only after six consecutive heartbeats were lost.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Preset of timing parameters. All nodes of a fleet use the same preset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Timing {
    /// Wired machines. The default.
    #[default]
    Lan,
    /// Links that lose messages and stall.
    Wifi,
}

/// Timing parameters of a [`Timing`] preset; the table of the module gives the values and their
/// reasons.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TimingParameters {
    /// Interval of a leader's heartbeats.
    pub heartbeat: Duration,
    /// Shortest time without leader contact after which a voter campaigns.
    pub election_min: Duration,
    /// Longest time without leader contact after which a voter campaigns.
    pub election_max: Duration,
    /// Interval of the coordinator's beacons.
    pub beacon_interval: Duration,
    /// Time that an auction waits for a member that does not reply.
    pub auction_window: Duration,
    /// Interval at which a node repeats its record.
    pub gossip_refresh: Duration,
    /// Interval at which a node compares digests with another node.
    pub anti_entropy_interval: Duration,
    /// Interval at which a random member is probed.
    pub probe_period: Duration,
    /// Time that a probed member has to reply.
    pub probe_timeout: Duration,
    /// Time that a suspect has to refute the suspicion.
    pub suspicion_timeout: Duration,
    /// Time that a voter must be gone before the autopilot replaces it.
    pub dead_after: Duration,
    /// Time for which a silent neighbor counts as linked.
    pub link_lease: Duration,
}

impl Timing {
    /// Returns the timing parameters of this preset.
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
