//! The rule of MissionControl (thesis 3.7, Algorithm 1).

use super::Coalition;
use consort_protocol::auction::{Bid, BidLimits};
use consort_protocol::ids::RoleId;
use std::collections::BTreeSet;

/// Role by role, in the order of their names, the fastest viable bid of a robot that has no role yet; of equally fast ones
/// the first robot by name. `None` where a role gets nobody. Unlike its ancestor it never gives one robot two roles,
/// for what runs afterwards is the same code for all policies and could not carry that out.
pub fn greedy(roles: &BTreeSet<RoleId>, bids: &[Bid], limits: &BidLimits) -> Option<Coalition> {
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
        }
    }

    fn chosen(roles: &[&str], bids: &[Bid]) -> Option<Vec<String>> {
        let roles = roles.iter().map(|role| RoleId::new(*role).unwrap()).collect();
        Some(greedy(&roles, bids, &BidLimits::default())?.values().map(ToString::to_string).collect())
    }

    #[test]
    fn the_fastest_whose_battery_lasts_is_taken() {
        let bids = [bid("ada", "r1", 5.0, 0.06), bid("bob", "r1", 9.0, 0.5), bid("cyd", "r1", 9.0, 0.9)];
        assert_eq!(chosen(&["r1"], &bids).unwrap(), ["bob"], "ada would fall below her useful charge");
        assert_eq!(chosen(&["r1"], &bids[..1]), None);
    }

    #[test]
    fn it_is_greedy_and_gives_nobody_two_roles() {
        let bids = [bid("ada", "r1", 10.0, 0.5), bid("ada", "r2", 10.0, 0.5), bid("bob", "r1", 12.0, 0.5)];
        assert_eq!(chosen(&["r1", "r2"], &bids), None, "an exact assignment would have found bob and ada");
        let bids = [bids.as_slice(), &[bid("bob", "r2", 99.0, 0.5)]].concat();
        assert_eq!(chosen(&["r1", "r2"], &bids).unwrap(), ["ada", "bob"]);
    }
}
