//! Priorities of messages on a link.
//!
//! On a slow link messages wait for each other. A heartbeat that waits for a backup of the ledger is late, and
//! its sender is replaced although it works. So each kind of key has a priority, and a link sends messages of a
//! higher priority first. A reply has the priority of its query.

use super::call::{ApiCall, RaftCall};
use super::key::{Key, read};

/// Priority of a message, highest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Priority {
    /// Votes, heartbeats and entries of the ledger. Late ones replace a leader that works.
    Consensus,
    /// What keeps a coordinator, a member, a role or a goal alive: beacons, probes, reports, awards, commands to
    /// drivers. Late ones end it. Also requests that stop robots, and those that release them.
    Liveness,
    /// Progress of missions: bids, signals, requests that change something. Missions wait for them.
    Mission,
    /// Records and their comparisons. They are repeated, so a late record is replaced by the next.
    Knowledge,
    /// Events, for people and recordings. Nothing waits for them.
    Event,
    /// Views and read-only requests. A person waits.
    View,
    /// Snapshots and backups: the largest messages, and the least urgent.
    Bulk,
}

impl Key {
    /// Returns the priority of messages on this key.
    pub fn priority(&self) -> Priority {
        match self {
            // Appends and heartbeats stay in order: a voter that received a heartbeat before an earlier append
            // would report the append as lost, and the leader would send it again.
            Key::Raft(
                _,
                RaftCall::Vote
                | RaftCall::Append
                | RaftCall::PreVote
                | RaftCall::TransferLeadership
                | RaftCall::Heartbeat,
            ) => Priority::Consensus,
            Key::Raft(_, RaftCall::Snapshot | RaftCall::SnapshotBlocks) => Priority::Bulk,
            // Messages of an unknown author are lost until its certificate has arrived.
            Key::Certificate(_) | Key::KnownCertificate(_) => Priority::Liveness,
            Key::Swim(_) | Key::Bootstrap(_) | Key::Beacon | Key::Leader(_) => Priority::Liveness,
            Key::Award(_) | Key::Report(_) | Key::Driver(..) => Priority::Liveness,
            // Tokens are declarations, which Zenoh sends before all messages.
            Key::AliveRobot(_) | Key::AliveNode(_) | Key::AliveCoordinator(..) => Priority::Liveness,
            Key::Bid(_) | Key::Signal(..) | Key::SignalHistory(..) | Key::People(_) | Key::Clock(_) => {
                Priority::Mission
            }
            Key::Leave(_) => Priority::Mission,
            // A hold that overtook an earlier release would be ended by it.
            Key::Api(ApiCall::Hold | ApiCall::Release | ApiCall::Alarm) => Priority::Liveness,
            Key::Api(ApiCall::Backup) => Priority::Bulk,
            Key::Api(call) if call.is_read_only() => Priority::View,
            Key::Api(_) => Priority::Mission,
            Key::Knowledge(_) | Key::Motion(_) | Key::Gossip(_) | Key::Ensemble(..) => Priority::Knowledge,
            Key::Events(_) => Priority::Event,
            Key::ViewFleet
            | Key::ViewRobot(_)
            | Key::ViewCoordinator
            | Key::ViewMissions
            | Key::ViewRequests
            | Key::ViewSchedules
            | Key::ViewAudit
            | Key::ViewMission(_)
            | Key::ViewAuctions
            | Key::ViewEnsembles
            | Key::ViewEnsemble(_)
            | Key::ViewMap
            | Key::ViewHealth
            | Key::ViewWorld
            | Key::World
            | Key::Seen(..)
            | Key::Help(_) => Priority::View,
        }
    }
}

impl Priority {
    /// Returns the priority of messages on a key or key expression of any fleet. Expressions for several kinds of
    /// keys are queries for views.
    pub fn of(text: &str) -> Priority {
        let below_fleet = text.splitn(3, '/').nth(2).unwrap_or_default();
        // A wildcard stands for a name, which does not change the kind.
        read(&below_fleet.replace('*', "any")).map_or(Priority::View, |key| key.priority())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::FleetId;
    use crate::keys::{KeyKind, Keys};

    fn keys() -> Keys {
        Keys::new(&FleetId::new("ward").unwrap())
    }

    #[test]
    fn the_text_of_each_key_has_the_priority_of_the_key() {
        for key in crate::keys::tests::all() {
            assert_eq!(Priority::of(&keys().write(&key)), key.priority(), "{key}");
        }
    }

    #[test]
    fn expressions_for_a_kind_of_keys_have_its_priority() {
        let keys = keys();
        assert_eq!(Priority::of(&keys.any_bid()), Priority::Mission);
        assert_eq!(Priority::of(&keys.any_bootstrap()), Priority::Liveness);
        assert_eq!(Priority::of(&keys.any_knowledge()), Priority::Knowledge);
        for views in [keys.any_view(), keys.any_robot_view(), keys.any_seen_coordinator(), keys.any_help()] {
            assert_eq!(Priority::of(&views), Priority::View, "{views}");
        }
        assert_eq!(Priority::of("other"), Priority::View);
    }

    #[test]
    fn messages_with_a_timeout_precede_all_others() {
        let urgent = [
            KeyKind::Certificate,
            KeyKind::Swim,
            KeyKind::RaftHeartbeat,
            KeyKind::RaftAppend,
            KeyKind::Beacon,
            KeyKind::DriverCommand,
            KeyKind::DriverState,
            KeyKind::Work,
        ];
        for key in crate::keys::tests::all() {
            let kind = KeyKind::of(&keys().write(&key));
            // Calls of several priorities, and tokens.
            if !matches!(kind, KeyKind::Raft | KeyKind::Other) && !matches!(key, Key::Api(_)) {
                assert_eq!(key.priority() <= Priority::Liveness, urgent.contains(&kind), "{key}");
            }
        }
        for call in RaftCall::ALL {
            let is_bulk = matches!(call, RaftCall::Snapshot | RaftCall::SnapshotBlocks);
            let expected = if is_bulk { Priority::Bulk } else { Priority::Consensus };
            assert_eq!(Key::Raft(7, *call).priority(), expected, "{call:?}");
        }
    }

    #[test]
    fn requests_precede_views_and_those_that_stop_or_release_robots_are_urgent() {
        for call in ApiCall::ALL {
            let urgent = [ApiCall::Hold, ApiCall::Release, ApiCall::Alarm].contains(call);
            let changes = !call.is_read_only() && *call != ApiCall::Backup;
            let priority = Key::Api(*call).priority();
            assert_eq!((priority <= Priority::Liveness, priority <= Priority::Mission), (urgent, changes), "{call:?}");
        }
    }
}
