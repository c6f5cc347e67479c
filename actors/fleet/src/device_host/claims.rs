//! The claim that a device serves, from the records of the robots.

use super::control::Served;
use consort_protocol::ids::{DeviceId, NodeId, RobotId};
use consort_protocol::knowledge::{DeviceClaim, KnowledgeBase, KnownRecord};

/// Claim of a robot to a device, with a lease.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct LeasedClaim {
    /// Node of the robot.
    pub(super) node: NodeId,
    /// Lease, and the guarded place.
    pub(super) served: Served,
}

/// Returns the latest lease of a device that a robot claims, with the place. `in_force` is the lease in the ledger, which
/// counts for its robot only; `None` for a node without a copy of the ledger.
///
/// The `last` claim counts on while its robot may be inside: the robot is lost, also after its record is forgotten, or its
/// node has restarted and does not know its claim or its lease. While the robot itself claims it, no other claim replaces it:
/// without the ledger, an invented lease must not take the device from the robot inside.
pub(super) fn served_claim(
    base: &KnowledgeBase,
    device: &DeviceId,
    in_force: Option<&Option<(RobotId, u64)>>,
    last: Option<&LeasedClaim>,
) -> Option<LeasedClaim> {
    let of_node = |(node, known): (&NodeId, &KnownRecord)| {
        let DeviceClaim { lease, place } = known.record.knowledge.devices.claims.as_ref()?.get(device)?;
        Some(LeasedClaim { node: node.clone(), served: ((*lease)?, place.clone()) })
    };
    let is_known = |node: &NodeId| {
        let claims = base.get(node).and_then(|known| known.record.knowledge.devices.claims.as_ref());
        claims.is_some_and(|claims| claims.get(device).is_none_or(|claim| claim.lease.is_some()))
    };
    let is_in_force = |claim: &LeasedClaim| {
        let is_it =
            |(robot, lease): &(RobotId, u64)| claim.node == NodeId::from(robot.clone()) && claim.served.0 == *lease;
        in_force.is_none_or(|in_force| in_force.as_ref().is_some_and(is_it))
    };
    let stands = |claim: &LeasedClaim| {
        last.is_some_and(|last| last.node == claim.node && last.served.0 == claim.served.0) && is_known(&claim.node)
    };
    let kept = last.filter(|claim| !is_known(&claim.node)).cloned();
    let claims = base.iter().filter_map(of_node).chain(kept).filter(is_in_force);
    claims.max_by(|a, b| (stands(a), &a.served).cmp(&(stands(b), &b.served)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::knowledge::{DeviceClaims, DeviceKnowledge, Knowledge, Record, RecordStamp};
    use consort_protocol::units::NodeTime;

    fn door() -> DeviceId {
        "door".parse().unwrap()
    }

    /// Returns the records of robots with these claims; the leases count for the door.
    fn base(records: &[(&str, Option<Option<u64>>)]) -> KnowledgeBase {
        let mut base = KnowledgeBase::default();
        for (owner, lease) in records {
            let claims = lease.map(|lease| DeviceClaims::from([(door(), DeviceClaim { lease, place: None })]));
            let devices = DeviceKnowledge { claims, ..DeviceKnowledge::default() };
            let knowledge = Knowledge { devices, ..Knowledge::of(None) };
            let record =
                Record { owner: owner.parse().unwrap(), stamp: RecordStamp::default(), knowledge, proof: None };
            assert!(base.merge(record, NodeTime::default()));
        }
        base
    }

    fn claim(node: &str, lease: u64) -> LeasedClaim {
        LeasedClaim { node: node.parse().unwrap(), served: (lease, None) }
    }

    fn in_force(robot: &str, lease: u64) -> Option<(RobotId, u64)> {
        Some((robot.parse().unwrap(), lease))
    }

    #[test]
    fn the_lease_in_force_counts_for_its_robot_only() {
        let both = base(&[("ada", Some(Some(7))), ("bob", Some(Some(9)))]);
        assert_eq!(served_claim(&both, &door(), None, None), Some(claim("bob", 9)));
        assert_eq!(served_claim(&both, &door(), Some(&in_force("ada", 7)), None), Some(claim("ada", 7)));
        assert_eq!(served_claim(&both, &door(), Some(&in_force("bob", 7)), None), None, "a lease of another robot");
        assert_eq!(served_claim(&both, &door(), Some(&None), None), None);
    }

    #[test]
    fn without_the_ledger_an_invented_lease_displaces_no_robot_that_is_served() {
        let ada = claim("ada", 7);
        let both = base(&[("ada", Some(Some(7))), ("eve", Some(Some(u64::MAX)))]);
        assert_eq!(served_claim(&both, &door(), None, Some(&ada)), Some(ada.clone()));
        let later = base(&[("ada", Some(Some(9))), ("eve", Some(Some(8)))]);
        assert_eq!(served_claim(&later, &door(), None, Some(&ada)), Some(claim("ada", 9)), "a lease of its own");
        let lost = base(&[("bob", Some(Some(9)))]);
        assert_eq!(
            served_claim(&lost, &door(), None, Some(&ada)),
            Some(claim("bob", 9)),
            "a person has ended its lease"
        );
    }

    #[test]
    fn the_claim_of_a_robot_that_may_be_inside_counts_on() {
        let last = claim("ada", 7);
        let after = |base: &KnowledgeBase, lease: Option<(RobotId, u64)>| {
            served_claim(base, &door(), Some(&lease), Some(&last))
        };
        let (lost, restarted, lacks_lease) = (base(&[]), base(&[("ada", None)]), base(&[("ada", Some(None))]));
        for records in [lost, restarted, lacks_lease] {
            assert_eq!(after(&records, in_force("ada", 7)), Some(last.clone()));
            assert_eq!(after(&records, None), None, "its lease has ended");
            assert_eq!(served_claim(&records, &door(), None, Some(&last)), Some(last.clone()));
        }
        let mut left = base(&[]);
        let knowledge = Knowledge::of(None);
        let devices = DeviceKnowledge { claims: Some(DeviceClaims::new()), ..DeviceKnowledge::default() };
        let knowledge = Knowledge { devices, ..knowledge };
        let record = Record { owner: "ada".parse().unwrap(), stamp: RecordStamp::default(), knowledge, proof: None };
        assert!(left.merge(record, NodeTime::default()));
        assert_eq!(after(&left, in_force("ada", 7)), None, "it is not inside");
    }
}
