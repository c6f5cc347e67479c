//! Calls in keys, and the categories of keys.

use crate::word_enum::words;

words! {
    /// Consensus call.
    RaftCall {
        /// A candidate requests a vote.
        Vote = "vote",
        /// The leader appends entries, or confirms its leadership.
        Append = "append",
        /// The leader sends a snapshot, in chunks.
        Snapshot = "snapshot",
        /// Before it campaigns, a node asks the voters whether they would vote for it.
        PreVote = "pre_vote",
        /// A leader that leaves transfers its leadership.
        TransferLeadership = "transfer_leadership",
        /// A leader that waits for a reply checks that the voter is reachable.
        Heartbeat = "heartbeat",
        /// The leader asks which blocks of a snapshot the voter lacks.
        SnapshotBlocks = "snapshot_blocks",
    }
    /// Call between a robot's node and its driver server.
    DriverCall {
        /// Query to the server: start or cancel a goal, or only return the state.
        Command = "command",
        /// Publication by the server: telemetry and the state of goals.
        State = "state",
    }
    /// Call between the coordinator and the host of simulated people.
    PeopleCall {
        /// Query to the host: ask or dismiss a person.
        Ask = "ask",
        /// Publication by the host: a task that a person has completed.
        Done = "done",
    }
    /// Request of clients in any language, in JSON.
    ApiCall {
        /// Submit a mission.
        Submit = "submit",
        /// Cancel a mission.
        Cancel = "cancel",
        /// Cancel several missions, by name or by a condition.
        CancelMissions = "cancel_missions",
        /// Change the priority of a mission.
        Priority = "priority",
        /// Give a role to another robot, or pin it to a robot.
        Reassign = "reassign",
        /// Resolve an intervention: a person has taken care of the items that robots had.
        Resolve = "resolve",
        /// Answer a request to a person.
        Answer = "answer",
        /// Add, pause, resume or remove a schedule.
        Schedule = "schedule",
        /// Hold robots: they stand still, and keep their roles.
        Hold = "hold",
        /// Release held robots.
        Release = "release",
        /// Take robots out of service for maintenance, or return them to service.
        Maintenance = "maintenance",
        /// Close places or lanes: no robot enters them.
        Close = "close",
        /// Open closed places or lanes.
        Open = "open",
        /// Set or clear speed limits.
        Limit = "limit",
        /// Raise an alarm, or clear alarms.
        Alarm = "alarm",
        /// Get a backup of the ledger.
        Backup = "backup",
        /// Get the progress of an upgrade to the next wire version, and complete it.
        Upgrade = "upgrade",
        /// Get a mission.
        Get = "get",
        /// List all missions.
        List = "list",
        /// List the requests to people.
        Requests = "requests",
        /// List the schedules.
        Schedules = "schedules",
        /// List the changes that people have requested.
        Audit = "audit",
        /// Explain for each role of a mission the outcome of each robot's bid.
        Explain = "explain",
        /// List the calls with their parameters.
        Help = "help",
    }
    /// Category of the messages on a key, for metrics.
    KeyKind {
        /// Certificates.
        Certificate = "certificate",
        /// Records of knowledge.
        Knowledge = "knowledge",
        /// Places, poses and charges of robots in a large fleet, and confirmations of records.
        Motion = "motion",
        /// Comparisons of knowledge.
        Gossip = "gossip",
        /// Failure detection.
        Swim = "swim",
        /// Heartbeats of the leader to its voters.
        RaftHeartbeat = "raft/heartbeat",
        /// Entries of the ledger, and confirmations of the leadership.
        RaftAppend = "raft/append",
        /// Other consensus messages, and readings of the clocks of voters.
        Raft = "raft",
        /// Beacons of the coordinator.
        Beacon = "beacon",
        /// Commands to driver servers.
        DriverCommand = "driver/command",
        /// States published by driver servers.
        DriverState = "driver/state",
        /// Calls for bids, and bids.
        Bid = "bid",
        /// Awards and reports.
        Work = "work",
        /// Signals of missions, and queries for them.
        Signal = "signal",
        /// Values that members of ensembles exchange.
        Ensemble = "ensemble",
        /// Views and requests of people.
        People = "people",
        /// All other messages.
        Other = "other",
    }
}

impl ApiCall {
    /// Checks whether the call changes nothing and any node can answer it from its own data. A
    /// backup of the ledger is not such a call: only the coordinator can ensure that it is
    /// complete.
    pub fn is_read_only(self) -> bool {
        match self {
            ApiCall::Submit
            | ApiCall::Cancel
            | ApiCall::CancelMissions
            | ApiCall::Priority
            | ApiCall::Reassign
            | ApiCall::Resolve
            | ApiCall::Answer
            | ApiCall::Schedule
            | ApiCall::Hold
            | ApiCall::Release
            | ApiCall::Maintenance
            | ApiCall::Close
            | ApiCall::Open
            | ApiCall::Limit
            | ApiCall::Alarm
            | ApiCall::Backup
            | ApiCall::Upgrade => false,
            ApiCall::Get
            | ApiCall::List
            | ApiCall::Requests
            | ApiCall::Schedules
            | ApiCall::Audit
            | ApiCall::Explain
            | ApiCall::Help => true,
        }
    }
}

impl KeyKind {
    /// Returns the category of a key or key expression, of any fleet.
    pub fn of(text: &str) -> KeyKind {
        let mut segments = text.split('/').skip(2);
        match (segments.next(), segments.next()) {
            (Some("wire"), Some(kind)) => match (kind, segments.last()) {
                ("certificate", _) => KeyKind::Certificate,
                ("knowledge", _) => KeyKind::Knowledge,
                ("motion", _) => KeyKind::Motion,
                ("gossip", _) => KeyKind::Gossip,
                ("swim", _) => KeyKind::Swim,
                ("raft", Some("heartbeat")) => KeyKind::RaftHeartbeat,
                ("raft", Some("append")) => KeyKind::RaftAppend,
                ("raft" | "bootstrap" | "clock" | "leader", _) => KeyKind::Raft,
                ("beacon", _) => KeyKind::Beacon,
                ("driver", Some("state")) => KeyKind::DriverState,
                ("driver", _) => KeyKind::DriverCommand,
                ("bid", _) => KeyKind::Bid,
                ("award" | "report", _) => KeyKind::Work,
                ("signal" | "signal_history", _) => KeyKind::Signal,
                ("ensemble", _) => KeyKind::Ensemble,
                ("people" | "world", _) => KeyKind::People,
                _ => KeyKind::Other,
            },
            (Some("view" | "seen" | "api" | "events"), _) => KeyKind::People,
            _ => KeyKind::Other,
        }
    }
}
