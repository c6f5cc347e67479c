//! How a replica is set up.

use crate::timing::Timing;
use consort_protocol::ids::{FleetId, NodeId};
use openraft::{Config, SnapshotPolicy};
use std::sync::Arc;
use std::time::Duration;

/// How long a voter may take to bring an append, as long as it says that it is at it, or a vote to its disk and answer. Higher
/// bears slower disks, lower gives up one that hangs sooner. A guess: a hundred times what a sync takes on a disk in order.
pub(super) const APPEND_TIMEOUT: Duration = Duration::from_secs(2);

/// How one node takes part in the replicated ledger. All nodes of a fleet use the same times.
#[derive(Debug, Clone)]
pub struct RaftSettings {
    /// The fleet: part of every key.
    pub fleet: FleetId,
    /// This node.
    pub node: NodeId,
    /// How often a leader says that it is there; so it exceeds a round trip.
    /// Lower finds a dead leader sooner and costs messages. This and the next two: see [`crate::timing`].
    pub heartbeat: Duration,
    /// The shortest time without a leader after which a node stands for election, and the time for which a voter
    /// refuses every candidate after its leader's last word. At least three heartbeats, so that two may be lost.
    pub election_min: Duration,
    /// The longest; it is drawn anew for each wait. The wider the range, the rarer do two candidates meet.
    pub election_max: Duration,
    /// A leader that no majority has acknowledged for so long no longer counts itself leader. At most `election_min`:
    /// until then no other can have been elected. Default: that, less 1/15 for clocks that run unevenly.
    pub check_quorum_timeout: Duration,
    /// Applied entries after which a snapshot is taken. Higher saves work, lower saves memory and restart time.
    pub snapshot_every: u64,
    /// Entries kept although a snapshot holds them, so that a follower that lags a little need not be sent all.
    pub log_entries_kept: u64,
}

impl RaftSettings {
    /// The defaults, for `node` of `fleet`, with the times of [`Timing::Lan`].
    pub fn new(fleet: FleetId, node: NodeId) -> Self {
        let times = Timing::Lan.parameters();
        let settings = RaftSettings {
            fleet,
            node,
            heartbeat: times.heartbeat,
            election_min: times.election_min,
            election_max: times.election_max,
            check_quorum_timeout: times.election_min,
            snapshot_every: 5000,
            log_entries_kept: 1000,
        };
        settings.with_timing(Timing::Lan)
    }

    /// The same with the times of a preset.
    #[must_use]
    pub fn with_timing(self, timing: Timing) -> Self {
        let times = timing.parameters();
        self.with_times(times.heartbeat, times.election_min, times.election_max)
    }

    /// The same with other times; the bound on a leader's silence follows `election_min`.
    #[must_use]
    pub fn with_times(mut self, heartbeat: Duration, election_min: Duration, election_max: Duration) -> Self {
        self.heartbeat = heartbeat;
        self.election_min = election_min;
        self.election_max = election_max;
        self.check_quorum_timeout = election_min.mul_f64(14.0 / 15.0);
        self
    }

    pub(super) fn to_config(&self) -> Result<Arc<Config>, RaftSettingsError> {
        if self.check_quorum_timeout > self.election_min {
            return Err(RaftSettingsError::CheckQuorumTimeout {
                silence: self.check_quorum_timeout,
                lease: self.election_min,
            });
        }
        if self.election_min >= self.election_max {
            return Err(RaftSettingsError::ElectionTimeoutRange { min: self.election_min, max: self.election_max });
        }
        if self.snapshot_every == 0 {
            return Err(RaftSettingsError::SnapshotInterval);
        }
        let config = Config {
            cluster_name: self.fleet.to_string(),
            heartbeat_interval: millis(self.heartbeat),
            // Beats and elections are driven by `canvass`, and `runtime` has a longer limit for a request for a vote, which
            // would be the first of these two. What is left of the second: the time for which voters refuse candidates.
            election_timeout_min: millis(self.election_min) * 2 / 3,
            election_timeout_max: millis(self.election_min),
            enable_elect: false,
            enable_heartbeat: false,
            // One chunk over a link of 1 Mbit/s takes 0.4 s.
            install_snapshot_timeout: 2000,
            snapshot_max_chunk_size: super::network::SNAPSHOT_CHUNK as u64,
            snapshot_policy: SnapshotPolicy::LogsSinceLast(self.snapshot_every),
            replication_lag_threshold: self.snapshot_every.saturating_mul(2),
            max_in_snapshot_log_to_keep: self.log_entries_kept,
            ..Config::default()
        };
        let mut config = config.validate().map_err(|error| RaftSettingsError::Raft(Box::new(error)))?;
        // openraft gives each append one interval and then sends it anew: a disk that needs longer would never get on. It
        // wants the interval below the time of refusal for the sake of its own beats, which are switched off; so this
        // comes after its check. Its tick, with which a leader that was removed steps down, takes 1.5 of them.
        config.heartbeat_interval = millis(APPEND_TIMEOUT);
        Ok(Arc::new(config))
    }
}

fn millis(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}

/// Settings that contradict one another. Nothing was started.
#[derive(Debug, thiserror::Error)]
pub enum RaftSettingsError {
    /// A leader would count itself leader while another may already be elected.
    #[error("a leader's silence bound {silence:?} exceeds the shortest election timeout {lease:?}")]
    CheckQuorumTimeout {
        /// The bound.
        silence: Duration,
        /// The time in which voters refuse other candidates.
        lease: Duration,
    },
    /// Nothing to draw from.
    #[error("the shortest election timeout {min:?} is not below the longest, {max:?}")]
    ElectionTimeoutRange {
        /// The shortest.
        min: Duration,
        /// The longest.
        max: Duration,
    },
    /// The log would grow for ever.
    #[error("a snapshot after every 0 entries")]
    SnapshotInterval,
    /// What openraft says.
    #[error("{0}")]
    Raft(Box<openraft::ConfigError>),
}
