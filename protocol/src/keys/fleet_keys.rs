//! Keys and key expressions of a fleet, with its prefix.

use super::call::DriverCall;
use super::key::{Key, read};
use crate::ids::{EnsembleId, FleetId, NodeId};

/// Formats and parses the keys of a fleet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Keys {
    fleet: FleetId,
    prefix: String,
}

impl Keys {
    /// Creates the keys of a fleet.
    pub fn new(fleet: &FleetId) -> Keys {
        Keys { fleet: fleet.clone(), prefix: format!("consort/{fleet}") }
    }

    /// Returns the fleet.
    pub fn fleet(&self) -> &FleetId {
        &self.fleet
    }

    /// Formats a key.
    pub fn write(&self, key: &Key) -> String {
        format!("{}/{key}", self.prefix)
    }

    /// Parses a key. `None` if the text is not a key of this fleet.
    pub fn read(&self, text: &str) -> Option<Key> {
        read(self.strip_fleet(text)?)
    }

    /// Checks whether messages on this key or key expression concern missions or ensembles and are wrapped in a
    /// [`ClusterEnvelope`](crate::message::ClusterEnvelope).
    pub fn is_cluster_scoped(&self, text: &str) -> bool {
        let below = text.strip_prefix(&self.prefix).and_then(|rest| rest.strip_prefix("/wire/"));
        let kind = below.map(|rest| rest.split('/').next().unwrap_or(rest));
        kind.is_some_and(|kind| {
            ["beacon", "bid", "award", "report", "leader", "signal", "signal_history", "ensemble"].contains(&kind)
        })
    }

    /// Returns the part of a key or key expression below the fleet's prefix: `wire/bid/*`.
    pub fn strip_fleet<'a>(&self, text: &'a str) -> Option<&'a str> {
        text.strip_prefix(&self.prefix)?.strip_prefix('/')
    }

    /// Returns the key expression for all certificates.
    pub fn any_certificate(&self) -> String {
        format!("{}/wire/certificate/*", self.prefix)
    }

    /// Returns the key expression on which a node serves all certificates that it knows.
    pub fn any_known_certificate(&self) -> String {
        format!("{}/wire/certificate/*/known", self.prefix)
    }

    /// Returns the key expression for the records of all nodes.
    pub fn any_knowledge(&self) -> String {
        format!("{}/wire/knowledge/*", self.prefix)
    }

    /// Returns the key expression for the places, poses and charges of all robots of a large fleet.
    pub fn any_motion(&self) -> String {
        format!("{}/wire/motion/*", self.prefix)
    }

    /// Returns the key expression for calls for bids to all robots.
    pub fn any_bid(&self) -> String {
        format!("{}/wire/bid/*", self.prefix)
    }

    /// Returns the key expression for the signals of all missions to all roles.
    pub fn any_signal(&self) -> String {
        format!("{}/wire/signal/*/*", self.prefix)
    }

    /// Returns the key expression for the values that the members of an ensemble publish.
    pub fn any_of_ensemble(&self, ensemble: &EnsembleId) -> String {
        format!("{}/wire/ensemble/{ensemble}/*", self.prefix)
    }

    /// Returns the key expression for the commands to all robots, which a driver server serves.
    pub fn any_driver_command(&self) -> String {
        format!("{}/wire/driver/*/{}", self.prefix, DriverCall::Command.as_str())
    }

    /// Returns the key expression for the states of all robots, which shows the connected robots.
    pub fn any_driver_state(&self) -> String {
        format!("{}/wire/driver/*/{}", self.prefix, DriverCall::State.as_str())
    }

    /// Returns the key expression for the consensus calls to a member.
    pub fn any_raft(&self, member: u64) -> String {
        format!("{}/wire/raft/{member:016x}/*", self.prefix)
    }

    /// Returns the key expression for bootstrap requests to all nodes that may vote.
    pub fn any_bootstrap(&self) -> String {
        format!("{}/wire/bootstrap/*", self.prefix)
    }

    /// Returns the key expression for all views.
    pub fn any_view(&self) -> String {
        format!("{}/view/**", self.prefix)
    }

    /// Returns the key expression for the views of all robots.
    pub fn any_robot_view(&self) -> String {
        format!("{}/view/robot/*", self.prefix)
    }

    /// Returns the key expression for all views of a single node.
    pub fn any_seen(&self, node: &NodeId) -> String {
        format!("{}/seen/{node}/**", self.prefix)
    }

    /// Returns the key expression for all views of each node.
    pub(crate) fn any_seen_by_any(&self) -> String {
        format!("{}/seen/**", self.prefix)
    }

    /// Returns the key expression for the coordinator as seen by each node.
    pub fn any_seen_coordinator(&self) -> String {
        format!("{}/seen/*/coordinator", self.prefix)
    }

    /// Returns the key expression for requests to leave.
    pub(crate) fn any_leave(&self) -> String {
        format!("{}/api/leave/*", self.prefix)
    }

    /// Returns the key expression for the help on each call.
    pub fn any_help(&self) -> String {
        format!("{}/api/*/help", self.prefix)
    }

    /// Returns the key expression for all requests.
    pub fn any_api(&self) -> String {
        format!("{}/api/*", self.prefix)
    }

    /// Returns the key expression for the events of all nodes.
    pub fn any_events(&self) -> String {
        format!("{}/events/**", self.prefix)
    }

    /// Returns the key expression for all presence tokens.
    pub fn any_alive(&self) -> String {
        format!("{}/alive/**", self.prefix)
    }

    /// Returns the key expression for the presence tokens of nodes.
    pub fn any_alive_node(&self) -> String {
        format!("{}/alive/node/*", self.prefix)
    }
}
