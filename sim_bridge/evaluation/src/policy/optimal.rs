//! An oracle: an upper bound for the gain of better assignments.

use super::Coalition;
use consort_protocol::ids::{RobotId, RoleId};
use std::collections::{BTreeMap, BTreeSet};

/// Estimated result of a robot in a role.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SuccessEstimate {
    /// Probability of success: 0 to 1.
    pub success: f64,
    /// Mean duration of successful runs, in seconds.
    pub time_s: f64,
}

/// Returns the coalition with the greatest probability of success, assuming that the roles are
/// independent; of equally likely coalitions the quickest, then the first by the names of the
/// robots. All combinations are tried (number of robots to the power of the number of roles), so
/// this is for few roles. `None` if no coalition fills every role.
pub(crate) fn optimal(
    roles: &BTreeSet<RoleId>,
    estimates: &BTreeMap<(RoleId, RobotId), SuccessEstimate>,
) -> Option<Coalition> {
    let mut partial = vec![(Coalition::new(), 1.0_f64, 0.0_f64)];
    for role in roles {
        let candidates: Vec<_> = estimates.iter().filter(|((offered, _), _)| offered == role).collect();
        let extended = partial.iter().flat_map(|(chosen, success, time)| {
            let free = candidates.iter().filter(|((_, robot), _)| !chosen.values().any(|taken| taken == robot));
            free.map(move |((_, robot), estimate)| {
                let mut chosen = chosen.clone();
                chosen.insert(role.clone(), robot.clone());
                (chosen, success * estimate.success, time + estimate.time_s)
            })
        });
        partial = extended.collect();
    }
    let better = |a: &(Coalition, f64, f64), b: &(Coalition, f64, f64)| {
        b.1.total_cmp(&a.1).then(a.2.total_cmp(&b.2)).then_with(|| a.0.cmp(&b.0))
    };
    partial.into_iter().min_by(better).map(|(chosen, ..)| chosen)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen(roles: &[&str], estimates: &[(&str, &str, f64, f64)]) -> Option<Vec<String>> {
        let role = |name: &str| RoleId::new(name).unwrap();
        let known = estimates.iter().map(|(of, robot, success, time_s)| {
            ((role(of), RobotId::new(*robot).unwrap()), SuccessEstimate { success: *success, time_s: *time_s })
        });
        let coalition = optimal(&roles.iter().map(|name| role(name)).collect(), &known.collect())?;
        Some(coalition.values().map(ToString::to_string).collect())
    }

    #[test]
    fn the_likeliest_robot_wins_and_among_equals_the_quickest() {
        let known = [("r1", "ada", 0.9, 9.0), ("r1", "bob", 0.95, 99.0), ("r1", "cyd", 0.95, 98.0)];
        assert_eq!(chosen(&["r1"], &known).unwrap(), ["cyd"]);
        assert_eq!(chosen(&["r2"], &known), None);
    }

    #[test]
    fn roles_are_optimised_jointly() {
        let known =
            [("r1", "ada", 0.9, 1.0), ("r1", "bob", 0.8, 1.0), ("r2", "ada", 0.9, 1.0), ("r2", "bob", 0.1, 1.0)];
        assert_eq!(chosen(&["r1", "r2"], &known).unwrap(), ["bob", "ada"]);
    }
}
