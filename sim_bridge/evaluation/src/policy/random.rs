//! The random baseline of the thesis (4.1.1).

use super::Coalition;
use consort_protocol::ids::{RobotId, RoleId};
use rand::Rng;
use rand::seq::IndexedRandom;
use std::collections::{BTreeMap, BTreeSet};

/// Assigns each role a random robot among the candidates without a role, all with the same
/// probability. Skills and batteries are ignored: in the published evaluation 175 of 648 such
/// trials failed because of a missing skill. The caller gives the candidates of each role, so a
/// stationary arm is not sent to fetch a sample. `None` if a role remains open.
pub(crate) fn random(candidates: &BTreeMap<RoleId, BTreeSet<RobotId>>, rng: &mut impl Rng) -> Option<Coalition> {
    let mut chosen = Coalition::new();
    for (role, robots) in candidates {
        let free: Vec<&RobotId> = robots.iter().filter(|robot| !chosen.values().any(|taken| taken == *robot)).collect();
        chosen.insert(role.clone(), (*free.choose(rng)?).clone());
    }
    Some(chosen)
}

#[cfg(test)]
mod tests {
    use super::super::super::seeds::generator;
    use super::*;

    #[test]
    fn all_robots_are_equally_likely_and_none_gets_two_roles() {
        let robots: BTreeSet<RobotId> = ["ada", "bob", "cyd"].map(|name| RobotId::new(name).unwrap()).into();
        let roles = ["r1", "r2"].map(|name| RoleId::new(name).unwrap());
        let candidates = roles.clone().map(|role| (role, robots.clone())).into();
        let mut counts: BTreeMap<RobotId, u32> = BTreeMap::new();
        let mut rng = generator(7, &["random"]);
        for _ in 0..3000 {
            let chosen = random(&candidates, &mut rng).unwrap();
            assert_ne!(chosen[&roles[0]], chosen[&roles[1]]);
            *counts.entry(chosen[&roles[0]].clone()).or_default() += 1;
        }
        // The bound is five standard deviations of a third of 3000.
        assert!(counts.values().all(|count| count.abs_diff(1000) < 130), "{counts:?}");
        let single_robot = roles.map(|role| (role, robots.iter().take(1).cloned().collect())).into();
        assert_eq!(random(&single_robot, &mut rng), None);
    }
}
