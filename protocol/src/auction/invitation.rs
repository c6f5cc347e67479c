//! Invitation to an auction: the robots, and those that come first.

use crate::ids::{EnsembleId, RobotId};
use std::collections::{BTreeMap, BTreeSet};

/// Robots that are invited to an auction.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Invitation {
    /// All invited robots.
    pub robots: BTreeSet<RobotId>,
    /// Ensembles whose members come first, in this order, with their members. Other robots get roles only
    /// if the members of these ensembles cannot fill all of them.
    pub preferred: Vec<(EnsembleId, BTreeSet<RobotId>)>,
}

impl Invitation {
    /// Invites the members of the ensembles that a mission names. The members of an ensemble come before
    /// those of the ensembles named after it. A mission without a name invites the members of all
    /// ensembles alike.
    pub fn of(named: &[EnsembleId], members: &BTreeMap<EnsembleId, BTreeSet<RobotId>>) -> Invitation {
        let members_of = |name: &EnsembleId| (name.clone(), members.get(name).cloned().unwrap_or_default());
        let Some((_, earlier)) = named.split_last() else {
            return Invitation { robots: members.values().flatten().cloned().collect(), preferred: vec![] };
        };
        Invitation {
            robots: named.iter().flat_map(|name| members_of(name).1).collect(),
            preferred: earlier.iter().map(members_of).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(robots: &BTreeSet<RobotId>) -> Vec<&str> {
        robots.iter().map(RobotId::as_str).collect()
    }

    #[test]
    fn the_members_of_the_named_ensembles_are_invited() {
        let group = |ensemble: &str, robots: &[&str]| {
            (ensemble.parse().unwrap(), robots.iter().map(|robot| robot.parse().unwrap()).collect())
        };
        let members =
            BTreeMap::from([group("er", &["cyd"]), group("hospital", &["ada", "cyd"]), group("icu", &["ada"])]);
        let invited = |named: &[&str]| {
            let named: Vec<EnsembleId> = named.iter().map(|name| name.parse().unwrap()).collect();
            Invitation::of(&named, &members)
        };
        let all = invited(&[]);
        assert_eq!((names(&all.robots), all.preferred.len()), (vec!["ada", "cyd"], 0));
        let section = invited(&["icu", "hospital"]);
        assert_eq!(names(&section.robots), ["ada", "cyd"]);
        let [(first, robots)] = &section.preferred[..] else { panic!("{section:?}") };
        assert_eq!((first.as_str(), names(robots)), ("icu", vec!["ada"]));
        let one = invited(&["er"]);
        assert_eq!((names(&one.robots), one.preferred.len()), (vec!["cyd"], 0));
        assert_eq!(invited(&["unknown"]), Invitation::default());
    }
}
