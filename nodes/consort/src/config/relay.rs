//! Decision whether a node relays for others, or is a client of nodes that relay.
//!
//! A node that relays is a Zenoh router. Each router computes routes to all others after each change of a link, so a
//! fleet has a limited number of them. A client has a link to a single relay, and moves to another when that relay
//! fails.
//!
//! The decision depends on configuration alone, so every start of a node gives the same result. The number of nodes is
//! the planned one: after a power failure all nodes start at the same time, and each would count only a few others.

use super::{CommonConfig, FleetConfig, RelaySetting};
use consort_protocol::ids::NodeId;
use consort_text::count;
use std::fmt;
use std::hash::{DefaultHasher, Hash, Hasher};

/// Planned number of nodes from which on not every node relays. Fleets of 100 routers miss beacons for more than a
/// second (`docs/figures.md`).
pub(crate) const LARGE_FLEET: usize = 30;

/// Maximum number of relays of a client.
const RELAYS_MAX: usize = 4;

/// Role of a node towards its neighbours.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum LinkRole {
    /// Relays for its neighbours.
    Relay(RoleReason),
    /// Is a client of the first of these relays that can be reached.
    Client(RoleReason, Vec<String>),
}

/// Reason for the role of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RoleReason {
    /// The node's setting.
    Setting,
    /// The node is a station or a world, or runs on mains power.
    Powered,
    /// Every node of a small fleet relays.
    SmallFleet,
    /// The node connects to no others, so others connect to it.
    NoNeighbours,
    /// The fleet is large, and the node is a robot on battery power.
    LargeFleet,
}

impl fmt::Display for RoleReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            RoleReason::Setting => f.write_str("bus.relay is set"),
            RoleReason::Powered => f.write_str("it is a station or a world, or runs on mains power"),
            RoleReason::SmallFleet => write!(f, "the fleet has no planned_nodes, or fewer than {LARGE_FLEET}"),
            RoleReason::NoNeighbours => f.write_str("bus.connect names no node that could relay for it"),
            RoleReason::LargeFleet => {
                write!(f, "the fleet has {LARGE_FLEET} planned_nodes or more, and it runs on a battery")
            }
        }
    }
}

impl fmt::Display for LinkRole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            LinkRole::Relay(reason) => write!(f, "relays, since {reason}"),
            LinkRole::Client(reason, relays) => {
                let number = count(relays.len(), "relay", "relays");
                write!(f, "client of {number}, since {reason}; in this order: {}", relays.join(", "))
            }
        }
    }
}

/// The settings contradict each other. The node does not start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum RelayError {
    /// A client without a relay would reach no node.
    #[error(
        "bus.relay is \"no\", and bus.connect is empty: name two to four nodes that relay, or set bus.relay to \"yes\""
    )]
    NoRelay,
    /// Programs and nodes that use these addresses would no longer reach the fleet.
    #[error(
        "bus.listen: this node does not relay (bus.relay, planned_nodes of the fleet), so nothing can connect to it: remove \
         bus.listen, or set bus.relay to \"yes\""
    )]
    ClientListens,
}

/// Facts that decide about the role of a node.
struct LinkFacts<'a> {
    name: &'a NodeId,
    setting: RelaySetting,
    is_powered: bool,
    planned_nodes: Option<usize>,
    listen: &'a [String],
    connect: &'a [String],
}

impl LinkFacts<'_> {
    fn decide(&self) -> Result<LinkRole, RelayError> {
        let is_small = !is_large(self.planned_nodes);
        match self.setting {
            RelaySetting::Yes => Ok(LinkRole::Relay(RoleReason::Setting)),
            RelaySetting::No if self.connect.is_empty() => Err(RelayError::NoRelay),
            RelaySetting::No => self.client(RoleReason::Setting),
            RelaySetting::Auto if self.is_powered => Ok(LinkRole::Relay(RoleReason::Powered)),
            RelaySetting::Auto if is_small => Ok(LinkRole::Relay(RoleReason::SmallFleet)),
            RelaySetting::Auto if self.connect.is_empty() => Ok(LinkRole::Relay(RoleReason::NoNeighbours)),
            RelaySetting::Auto => self.client(RoleReason::LargeFleet),
        }
    }

    fn client(&self, reason: RoleReason) -> Result<LinkRole, RelayError> {
        if !self.listen.is_empty() {
            return Err(RelayError::ClientListens);
        }
        Ok(LinkRole::Client(reason, self.relays()))
    }

    /// Returns the relays of a client in an order that depends on its name, so that the clients of a relay are spread
    /// over all others when it fails (rendezvous hashing: Thaler, Ravishankar 1998).
    fn relays(&self) -> Vec<String> {
        let mut relays = self.connect.to_vec();
        relays.sort_by_cached_key(|address| {
            let mut hasher = DefaultHasher::new();
            (self.name.as_str(), address).hash(&mut hasher);
            hasher.finish()
        });
        relays.dedup();
        relays.truncate(RELAYS_MAX);
        relays
    }
}

/// Checks whether a fleet with this setting is large.
fn is_large(planned_nodes: Option<usize>) -> bool {
    planned_nodes.is_some_and(|nodes| nodes >= LARGE_FLEET)
}

impl FleetConfig {
    /// Checks whether the fleet is large: nodes on battery power connect to relays, and receive what they use.
    pub(crate) fn is_large(&self) -> bool {
        is_large(self.planned_nodes)
    }
}

impl CommonConfig<'_> {
    /// Returns the role of the node with this name towards its neighbours.
    ///
    /// # Errors
    /// [`RelayError`] if the settings contradict each other.
    pub(crate) fn link_role(&self, name: &NodeId, fleet: &FleetConfig) -> Result<LinkRole, RelayError> {
        let facts = LinkFacts {
            name,
            setting: self.bus.relay,
            is_powered: self.is_powered,
            planned_nodes: fleet.planned_nodes,
            listen: &self.bus.listen,
            connect: &self.bus.connect,
        };
        facts.decide()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn a_fleet_is_large_from_thirty_planned_nodes_on() {
        let fleet = |planned_nodes| FleetConfig { planned_nodes, ..FleetConfig::default() };
        let large = [None, Some(LARGE_FLEET - 1), Some(LARGE_FLEET)].map(|nodes| fleet(nodes).is_large());
        assert_eq!(large, [false, false, true]);
    }

    fn stations() -> Vec<String> {
        (1..=3).map(|number| format!("tcp/station-{number}.ward.example:7447")).collect()
    }

    fn node(name: &str) -> NodeId {
        NodeId::new(name).unwrap()
    }

    /// Decides for a robot on battery power.
    fn decide(setting: RelaySetting, planned_nodes: Option<usize>, connect: &[String]) -> Result<LinkRole, RelayError> {
        let name = &node("ada");
        LinkFacts { name, setting, is_powered: false, planned_nodes, listen: &[], connect }.decide()
    }

    #[test]
    fn every_node_of_a_small_fleet_relays() {
        for planned in [None, Some(LARGE_FLEET - 1)] {
            let role = decide(RelaySetting::Auto, planned, &stations());
            assert_eq!(role, Ok(LinkRole::Relay(RoleReason::SmallFleet)), "{planned:?}");
        }
    }

    #[test]
    fn a_robot_on_battery_power_is_a_client_in_a_large_fleet() {
        let Ok(LinkRole::Client(RoleReason::LargeFleet, relays)) =
            decide(RelaySetting::Auto, Some(LARGE_FLEET), &stations())
        else {
            panic!("the robot relays")
        };
        assert_eq!(relays.len(), 3);
        assert!(stations().iter().all(|station| relays.contains(station)), "{relays:?}");
    }

    #[test]
    fn powered_nodes_relay_in_a_large_fleet() {
        let (name, connect) = (&node("station-1"), &stations());
        let facts = LinkFacts {
            name,
            setting: RelaySetting::Auto,
            is_powered: true,
            planned_nodes: Some(300),
            listen: connect,
            connect,
        };
        assert_eq!(facts.decide(), Ok(LinkRole::Relay(RoleReason::Powered)));
    }

    #[test]
    fn a_node_without_neighbours_relays() {
        let role = decide(RelaySetting::Auto, Some(300), &[]);
        assert_eq!(role, Ok(LinkRole::Relay(RoleReason::NoNeighbours)));
    }

    #[test]
    fn the_setting_prevails() {
        let relays = decide(RelaySetting::Yes, Some(300), &stations());
        assert_eq!(relays, Ok(LinkRole::Relay(RoleReason::Setting)));
        assert!(matches!(decide(RelaySetting::No, None, &stations()), Ok(LinkRole::Client(RoleReason::Setting, _))));
        assert_eq!(decide(RelaySetting::No, None, &[]), Err(RelayError::NoRelay));
    }

    #[test]
    fn a_client_does_not_listen() {
        let (name, connect, listen) = (&node("ada"), &stations(), &["tcp/127.0.0.1:7447".to_owned()]);
        let of = |setting, planned_nodes| {
            LinkFacts { name, setting, is_powered: false, planned_nodes, listen, connect }.decide()
        };
        assert_eq!(of(RelaySetting::Auto, Some(300)), Err(RelayError::ClientListens));
        assert_eq!(of(RelaySetting::No, None), Err(RelayError::ClientListens));
        assert_eq!(of(RelaySetting::Auto, Some(7)), Ok(LinkRole::Relay(RoleReason::SmallFleet)));
        assert_eq!(of(RelaySetting::Yes, Some(300)), Ok(LinkRole::Relay(RoleReason::Setting)));
    }

    #[test]
    fn clients_are_spread_over_their_relays_and_over_the_second_choices() {
        let connect = &stations();
        let mut choices: BTreeMap<(String, String), usize> = BTreeMap::new();
        for number in 0..300 {
            let name = &node(&format!("robot-{number}"));
            let facts = LinkFacts {
                name,
                setting: RelaySetting::No,
                is_powered: false,
                planned_nodes: None,
                listen: &[],
                connect,
            };
            assert_eq!(facts.decide(), facts.decide(), "{name}");
            let relays = facts.relays();
            *choices.entry((relays[0].clone(), relays[1].clone())).or_default() += 1;
        }
        assert_eq!(choices.len(), 6, "{choices:?}");
        assert!(choices.values().all(|clients| (25..=75).contains(clients)), "{choices:?}");
    }

    #[test]
    fn a_client_has_at_most_four_relays_each_once() {
        let mut connect: Vec<String> = (1..=6).map(|number| format!("tcp/192.0.2.{number}:7447")).collect();
        connect.push(connect[0].clone());
        let Ok(LinkRole::Client(_, mut relays)) = decide(RelaySetting::No, None, &connect) else { panic!("it relays") };
        relays.sort_unstable();
        relays.dedup();
        assert_eq!(relays.len(), RELAYS_MAX);
    }
}
