//! Settings of a replica.

use consort_protocol::ids::{FleetId, NodeId};
use consort_protocol::timing::Timing;
use openraft::{Config, SnapshotPolicy};
use std::sync::Arc;
use std::time::Duration;

/// Time that a voter has to write a vote to its disk and reply, or an append while it reports that
/// the append is pending. Higher tolerates slower disks, lower detects a hung disk sooner. A guess:
/// a hundred times the sync time of a healthy disk.
pub(super) const APPEND_TIMEOUT: Duration = Duration::from_secs(2);

/// Size of a snapshot chunk, in bytes; with its frame, the message stays within
/// [`MESSAGE_BYTES_MAX`](consort_protocol::codec::MESSAGE_BYTES_MAX).
pub(super) const SNAPSHOT_CHUNK: usize = 48 * 1024;

/// Size limit of an append of several entries, in bytes. A follower writes it with a single sync,
/// and a slow link carries it within a second; larger appends save little. A single entry may fill
/// a message.
pub(super) const APPEND_BYTES: usize = 32 * 1024;

/// Settings of a replica. All nodes of a fleet use the same times.
#[derive(Debug, Clone)]
pub struct RaftSettings {
    /// Fleet; part of every key.
    pub fleet: FleetId,
    /// This node.
    pub node: NodeId,
    /// Interval of a leader's heartbeats; must exceed a round trip. Lower detects a dead leader
    /// sooner and costs messages. For this and the next two fields see
    /// [`consort_protocol::timing`].
    pub heartbeat: Duration,
    /// Shortest time without leader contact after which a node campaigns, and the time for which a
    /// voter rejects every candidate after the last contact from its leader, unless it has lost that
    /// leader's presence and service. At least three heartbeats, so that two may be lost.
    pub election_min: Duration,
    /// Longest time without leader contact after which a node campaigns. The timeout is drawn anew
    /// for each wait. A wider range makes split votes rarer.
    pub election_max: Duration,
    /// Check-quorum timeout: a leader that no majority has acknowledged for so long no longer
    /// counts itself leader. At most `election_min`: until then no other leader can have been
    /// elected, unless a majority has lost this leader's presence and service. Default:
    /// `election_min` less 1/15 for clock drift.
    pub check_quorum_timeout: Duration,
    /// Number of applied entries after which a snapshot is taken. Higher saves work, lower saves
    /// memory and restart time.
    pub snapshot_every: u64,
    /// Number of entries kept in the log although a snapshot covers them, so that a follower with a
    /// small lag does not need a snapshot.
    pub log_entries_kept: u64,
}

/// Default number of applied entries after which a snapshot is taken.
pub const SNAPSHOT_EVERY: u64 = 5000;

/// Default number of entries kept in the log although a snapshot covers them.
pub const LOG_ENTRIES_KEPT: u64 = 1000;

impl RaftSettings {
    /// Creates the default settings for `node` of `fleet`, with the times of [`Timing::Lan`].
    pub fn new(fleet: FleetId, node: NodeId) -> Self {
        let parameters = Timing::Lan.parameters();
        let settings = RaftSettings {
            fleet,
            node,
            heartbeat: parameters.heartbeat,
            election_min: parameters.election_min,
            election_max: parameters.election_max,
            check_quorum_timeout: parameters.election_min,
            snapshot_every: SNAPSHOT_EVERY,
            log_entries_kept: LOG_ENTRIES_KEPT,
        };
        settings.with_timing(Timing::Lan)
    }

    /// Replaces the times by those of a preset.
    #[must_use]
    pub fn with_timing(self, timing: Timing) -> Self {
        let parameters = timing.parameters();
        self.with_times(parameters.heartbeat, parameters.election_min, parameters.election_max)
    }

    /// Replaces the times; the check-quorum timeout follows from `election_min`.
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
                timeout: self.check_quorum_timeout,
                election_min: self.election_min,
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
            // Heartbeats and elections are driven by `election`, and `runtime` has a longer limit
            // for a vote request, which is the purpose of the first of these two values. The second
            // is still used: the time for which voters reject candidates.
            election_timeout_min: millis(self.election_min) * 2 / 3,
            election_timeout_max: millis(self.election_min),
            enable_elect: false,
            enable_heartbeat: false,
            // A chunk over a link of 1 Mbit/s takes 0.4 s.
            install_snapshot_timeout: 2000,
            snapshot_max_chunk_size: SNAPSHOT_CHUNK as u64,
            snapshot_policy: SnapshotPolicy::LogsSinceLast(self.snapshot_every),
            replication_lag_threshold: self.snapshot_every.saturating_mul(2),
            max_in_snapshot_log_to_keep: self.log_entries_kept,
            ..Config::default()
        };
        let mut config = config.validate().map_err(|error| RaftSettingsError::Raft(Box::new(error)))?;
        // openraft gives each append a heartbeat interval and then sends it again: a slower disk
        // would never make progress. It requires an interval below the election timeout for the
        // sake of its own heartbeats, which are switched off, so the value is set after the
        // validation. Its tick, by which a removed leader steps down, takes 1.5 intervals.
        config.heartbeat_interval = millis(APPEND_TIMEOUT);
        Ok(Arc::new(config))
    }
}

fn millis(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}

/// Contradictory settings. Nothing was started.
#[derive(Debug, thiserror::Error)]
pub enum RaftSettingsError {
    /// A leader could still count itself leader after another was elected.
    #[error("the check-quorum timeout {timeout:?} exceeds the shortest election timeout {election_min:?}")]
    CheckQuorumTimeout {
        /// Check-quorum timeout.
        timeout: Duration,
        /// Time for which voters reject other candidates.
        election_min: Duration,
    },
    /// The range of election timeouts is empty.
    #[error("the shortest election timeout {min:?} is not below the longest, {max:?}")]
    ElectionTimeoutRange {
        /// Shortest timeout.
        min: Duration,
        /// Longest timeout.
        max: Duration,
    },
    /// The log would grow without bound.
    #[error("the snapshot interval is 0 entries")]
    SnapshotInterval,
    /// Rejected by openraft.
    #[error("{0}")]
    Raft(Box<openraft::ConfigError>),
}
