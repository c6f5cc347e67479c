//! Checks of the role of a node: whether it relays for others, and by which relays it is reached.

use super::Finding;
use crate::config::{LARGE_FLEET, LinkRole, RelayError};

/// A node's role towards its neighbours, and the facts that make it a good or a bad choice.
pub(super) struct RoleTarget {
    pub(super) role: Result<LinkRole, RelayError>,
    pub(super) may_vote: bool,
    pub(super) planned_nodes: Option<usize>,
}

impl RoleTarget {
    /// Checks whether other nodes can connect to this node.
    pub(super) fn accepts_links(&self) -> bool {
        !matches!(self.role, Ok(LinkRole::Client(..)))
    }

    /// Explains the role.
    pub(super) fn check(&self) -> Vec<Finding> {
        let about = "role";
        let role = match &self.role {
            Ok(role) => role,
            Err(problem) => return vec![Finding::error(about, problem, "`consort check` checks the file again")],
        };
        let LinkRole::Client(_, relays) = role else { return vec![Finding::ok(about, role)] };
        let mut findings = vec![match relays.len() {
            1 => {
                let advice =
                    "name two to four nodes that relay in bus.connect: without its only relay this node is alone";
                Finding::warning(about, role, advice)
            }
            _ => Finding::ok(about, role),
        }];
        if self.may_vote {
            let text = "it may vote, and reaches the other voters through its relay only: a failure of the relay interrupts its vote";
            let advice = "set may_vote = false, or bus.relay = \"yes\"";
            findings.push(Finding::warning(about, text, advice));
        }
        findings
    }

    /// Compares the planned number of nodes with the number that reply.
    pub(super) fn check_size(&self, nodes: usize) -> Option<Finding> {
        if nodes < LARGE_FLEET || self.planned_nodes.is_some_and(|planned| planned >= LARGE_FLEET) {
            return None;
        }
        let text = format!("{nodes} nodes reply, and every one relays: each change of a link costs all of them");
        let advice = format!(
            "set planned_nodes = {nodes} or more in the fleet file, and restart the nodes one after the other: from \
             {LARGE_FLEET} on robots on battery power become clients of bus.connect"
        );
        Some(Finding::warning("planned_nodes", text, advice))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::RoleReason;
    use crate::doctor::Severity;

    fn client(relays: &[&str], may_vote: bool) -> RoleTarget {
        let relays = relays.iter().map(|relay| (*relay).to_owned()).collect();
        RoleTarget { role: Ok(LinkRole::Client(RoleReason::LargeFleet, relays)), may_vote, planned_nodes: Some(100) }
    }

    fn states(target: &RoleTarget) -> Vec<Severity> {
        target.check().iter().map(|finding| finding.state).collect()
    }

    #[test]
    fn the_reason_and_the_relays_are_explained() {
        let finding = &client(&["tcp/a:7447", "tcp/b:7447"], false).check()[0];
        let expected = "client of 2 relays, since the fleet has 30 planned_nodes or more, and it runs on a battery; in this \
                        order: tcp/a:7447, tcp/b:7447";
        assert_eq!((finding.state, finding.text.as_str()), (Severity::Ok, expected));
    }

    #[test]
    fn a_single_relay_and_a_voting_client_are_warnings() {
        assert_eq!(states(&client(&["tcp/a:7447"], false)), [Severity::Warning]);
        assert_eq!(states(&client(&["tcp/a:7447", "tcp/b:7447"], true)), [Severity::Ok, Severity::Warning]);
    }

    #[test]
    fn contradictory_settings_are_an_error() {
        let target = RoleTarget { role: Err(RelayError::NoRelay), may_vote: false, planned_nodes: None };
        assert_eq!(states(&target), [Severity::Error]);
        assert!(target.accepts_links());
    }

    #[test]
    fn a_large_fleet_in_which_every_node_relays_is_a_warning() {
        let of = |planned_nodes| RoleTarget { planned_nodes, ..client(&[], false) };
        for (planned, nodes, expected) in [
            (None, LARGE_FLEET - 1, false),
            (None, LARGE_FLEET, true),
            (Some(7), LARGE_FLEET, true),
            (Some(LARGE_FLEET), 300, false),
        ] {
            assert_eq!(of(planned).check_size(nodes).is_some(), expected, "{planned:?} {nodes}");
        }
    }
}
