//! The baseline of the thesis (4.1.1).

use super::Coalition;
use consort_protocol::ids::{RobotId, RoleId};
use rand::Rng;
use rand::seq::IndexedRandom;
use std::collections::{BTreeMap, BTreeSet};

/// Role by role, any of the robots that may fill it and have no role yet, each as likely as the others. Nothing is asked of
/// skills or batteries: in the published evaluation 175 of 648 such trials failed for want of a skill. Who may fill a role
/// is said by the caller, so that an arm that cannot move is not sent to fetch. `None` where nobody is left for a role.
pub fn random(candidates: &BTreeMap<RoleId, BTreeSet<RobotId>>, rng: &mut impl Rng) -> Option<Coalition> {
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
    fn everybody_is_as_likely_and_nobody_gets_two_roles() {
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
        // Five standard deviations of a third of 3000.
        assert!(counts.values().all(|count| count.abs_diff(1000) < 130), "{counts:?}");
        let one = roles.map(|role| (role, robots.iter().take(1).cloned().collect())).into();
        assert_eq!(random(&one, &mut rng), None);
    }
}
