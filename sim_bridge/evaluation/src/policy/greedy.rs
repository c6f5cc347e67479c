//! The allocation rule of MissionControl (thesis 3.7, Algorithm 1).

use super::Coalition;
use consort_protocol::auction::{Bid, BidLimits};
use consort_protocol::ids::RoleId;
use std::collections::BTreeSet;

/// Assigns the roles in the order of their names. Each role gets the fastest viable bid of a robot
/// without a role; of equally fast bids the first by the robot's name. Returns `None` if a role
/// remains open. Unlike the original it never gives a robot two roles: the same code executes the
/// plans of all policies, and it cannot execute two roles of a robot.
pub(crate) fn greedy(roles: &BTreeSet<RoleId>, bids: &[Bid], limits: &BidLimits) -> Option<Coalition> {
    let mut chosen = Coalition::new();
    for role in roles {
        let free = |bid: &&Bid| !chosen.values().any(|robot| *robot == bid.robot);
        let open = bids.iter().filter(|bid| bid.role == *role && bid.check_viable(limits).is_ok()).filter(free);
        let best = open.min_by(|a, b| a.time.get().total_cmp(&b.time.get()).then_with(|| a.robot.cmp(&b.robot)))?;
        chosen.insert(role.clone(), best.robot.clone());
    }
    Some(chosen)
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::ids::{PlaceId, RobotId};
    use consort_protocol::units::{BatteryShare, Seconds};

    fn bid(robot: &str, role: &str, time: f64, remaining: f64) -> Bid {
        Bid {
            robot: RobotId::new(robot).unwrap(),
            role: RoleId::new(role).unwrap(),
            time: Seconds::new(time).unwrap(),
            energy: 0.1,
            remaining,
            useful_charge: BatteryShare::new(0.08).unwrap(),
            from: PlaceId::new("Dock").unwrap(),
            age_ms: 0,
            parts: vec![],
            present: None,
            planned: None,
        }
    }

    fn chosen(roles: &[&str], bids: &[Bid]) -> Option<Vec<String>> {
        let roles = roles.iter().map(|role| RoleId::new(*role).unwrap()).collect();
        Some(greedy(&roles, bids, &BidLimits::default())?.values().map(ToString::to_string).collect())
    }

    #[test]
    fn the_fastest_robot_with_enough_battery_is_chosen() {
        let bids = [bid("ada", "r1", 5.0, 0.06), bid("bob", "r1", 9.0, 0.5), bid("cyd", "r1", 9.0, 0.9)];
        assert_eq!(chosen(&["r1"], &bids).unwrap(), ["bob"], "ada would fall below its useful charge");
        assert_eq!(chosen(&["r1"], &bids[..1]), None);
    }

    #[test]
    fn the_rule_is_greedy_and_gives_no_robot_two_roles() {
        let bids = [bid("ada", "r1", 10.0, 0.5), bid("ada", "r2", 10.0, 0.5), bid("bob", "r1", 12.0, 0.5)];
        assert_eq!(chosen(&["r1", "r2"], &bids), None, "an optimal assignment is bob and ada");
        let bids = [bids.as_slice(), &[bid("bob", "r2", 99.0, 0.5)]].concat();
        assert_eq!(chosen(&["r1", "r2"], &bids).unwrap(), ["ada", "bob"]);
    }
}
