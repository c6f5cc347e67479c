//! What a robot would reply for a role, by its record.

use crate::auction::bid::{CallForBids, bounded_cost};
use crate::auction::insertion::Objective;
use crate::auction::record::NotAskedReason;
use crate::ensemble::Eligibility;
use crate::ids::{RobotId, RoleId};
use crate::knowledge::{Availability, RobotKnowledge};
use crate::plan::LocalPlan;
use crate::units::Seconds;
use std::collections::{BTreeMap, BTreeSet};

/// Expected reply of a robot for a role.
#[derive(Debug, Clone, PartialEq)]
pub enum Expectation {
    /// The robot would refuse.
    Refuses(NotAskedReason),
    /// The robot may bid this cost or more, in seconds of the objective.
    CostsAtLeast(f64),
}

/// Price of a plan for a robot, as far as its record shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Price {
    /// The robot needs at least this time and this energy, as a share of a full battery.
    AtLeast {
        /// The time.
        time: Seconds,
        /// The energy.
        energy: f64,
    },
    /// The record does not show it.
    Unknown,
    /// The robot cannot do the tasks.
    Impossible,
}

/// Conditions of a role on its robot.
#[derive(Debug)]
pub struct RoleTerms<'a> {
    plan: &'a LocalPlan,
    /// Compiled condition; `Err` for an invalid condition, which no robot meets.
    eligible: Option<Result<Eligibility, String>>,
    /// Robots with promised roles in the call.
    with_promises: BTreeSet<&'a RobotId>,
    objective: Objective,
}

impl<'a> RoleTerms<'a> {
    /// Returns the conditions of each role of a call.
    pub fn of(call: &'a CallForBids) -> BTreeMap<&'a RoleId, RoleTerms<'a>> {
        let with_promises: BTreeSet<&RobotId> =
            call.timelines.promised.iter().map(|promised| &promised.robot).collect();
        let terms = |(role, plan): (&'a RoleId, &'a LocalPlan)| {
            let eligible = call.eligible.get(role).map(|condition| Eligibility::compile(condition));
            let with_promises = with_promises.clone();
            (role, RoleTerms { plan, eligible, with_promises, objective: call.timelines.objective })
        };
        call.roles.iter().map(terms).collect()
    }

    /// Returns the plan of the role.
    pub fn plan(&self) -> &'a LocalPlan {
        self.plan
    }

    /// Returns what a robot would reply. `price` returns its price from its place.
    pub fn expect(&self, robot: &RobotId, worker: &RobotKnowledge, price: impl FnOnce() -> Price) -> Expectation {
        let missing = self.plan.skills_missing_in(&worker.skills);
        if !missing.is_empty() {
            return Expectation::Refuses(NotAskedReason::MissingSkills { skills: missing });
        }
        if matches!(worker.availability, Availability::OutOfService { .. }) {
            return Expectation::Refuses(NotAskedReason::OutOfService);
        }
        // The record contains changes of the charge and the place in steps, and later.
        let may_be_eligible = |condition: &Result<Eligibility, String>| {
            condition.as_ref().is_ok_and(|condition| condition.may_be_met(robot, worker))
        };
        if !self.eligible.iter().all(may_be_eligible) {
            return Expectation::Refuses(NotAskedReason::NotEligible);
        }
        // The place at which it would begin is unknown: the role may begin where a held or promised role ends, and
        // shorten the drive to another.
        if matches!(worker.availability, Availability::Holding { .. }) || self.with_promises.contains(robot) {
            return Expectation::CostsAtLeast(0.0);
        }
        match price() {
            Price::Unknown => Expectation::CostsAtLeast(0.0),
            Price::Impossible => Expectation::Refuses(NotAskedReason::NotFeasible),
            // A robot that lacks the charge is asked, too: it charges after it has refused.
            Price::AtLeast { time, energy } => {
                Expectation::CostsAtLeast(bounded_cost(self.objective, time.get(), energy))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::auction::bid::AuctionId;
    use crate::auction::insertion::{PromisedRole, RoleOfMission, RoleSpan, Timelines};
    use crate::mission::TaskSpec;
    use crate::plan::{Step, StepAction};
    use crate::pose::Pose;
    use crate::units::{BatteryShare, Energy, SharePerSecond};

    fn robot(availability: Availability) -> RobotKnowledge {
        RobotKnowledge {
            skills: BTreeSet::from(["navigation".parse().unwrap()]),
            attributes: serde_json::from_value(serde_json::json!({ "section": "icu" })).unwrap(),
            place: "dock".parse().unwrap(),
            pose: Pose::default(),
            battery: BatteryShare::new(0.5).unwrap(),
            discharge: SharePerSecond::new(0.001).unwrap(),
            useful_charge: BatteryShare::new(0.1).unwrap(),
            speed: None,
            availability,
            estimator: String::new(),
            charging: None,
        }
    }

    fn call(skill: &str, condition: &str) -> CallForBids {
        let role: RoleId = "r1".parse().unwrap();
        let spec = TaskSpec::of(skill.parse().unwrap(), vec![role.clone()]);
        let action = StepAction::Task { id: "go".parse().unwrap(), spec };
        let plan = LocalPlan::of(role.clone(), vec![Step { action, after: vec![] }]);
        CallForBids {
            auction: AuctionId { mission: "visit-1".parse().unwrap(), term: 1, round: 1 },
            ensembles: vec![],
            roles: BTreeMap::from([(role.clone(), plan)]),
            eligible: BTreeMap::from([(role.clone(), condition.to_owned())]),
            spread: BTreeSet::new(),
            timelines: Timelines { objective: Objective::LeastEnergy, ..Timelines::default() },
        }
    }

    fn expect(call: &CallForBids, worker: &RobotKnowledge, price: Price) -> Expectation {
        let role: RoleId = "r1".parse().unwrap();
        RoleTerms::of(call)[&role].expect(&"ada".parse().unwrap(), worker, || price)
    }

    #[test]
    fn the_record_of_a_robot_shows_a_refusal_or_a_bound() {
        use NotAskedReason::{MissingSkills, NotEligible, NotFeasible, OutOfService};
        let free = robot(Availability::Free);
        let (mission, role) = ("visit-0".parse().unwrap(), "r1".parse().unwrap());
        let busy = robot(Availability::Holding { mission, role, suspended: false });
        let broken = robot(Availability::OutOfService { problem: "no driver".to_owned() });
        let price = |energy| Price::AtLeast { time: Seconds::new(20.0).unwrap(), energy };
        let icu = r#"robot.attributes.section == "icu""#;
        let refuses = Expectation::Refuses;
        let skills = vec!["pick_up".parse().unwrap()];
        for (worker, skill, condition, price, expected) in [
            (&free, "navigation", icu, price(0.1), Expectation::CostsAtLeast(100_020.0)),
            (&free, "navigation", icu, Price::Unknown, Expectation::CostsAtLeast(0.0)),
            (&free, "navigation", icu, Price::Impossible, refuses(NotFeasible)),
            (&free, "navigation", icu, price(0.5), Expectation::CostsAtLeast(500_020.0)),
            (&free, "navigation", "robot.battery > 0.9", price(0.1), Expectation::CostsAtLeast(100_020.0)),
            (&free, "navigation", r#"robot.attributes.section == "er""#, price(0.1), refuses(NotEligible)),
            (&free, "navigation", "robot.batery > 0.9", price(0.1), refuses(NotEligible)),
            (&free, "pick_up", icu, price(0.1), refuses(MissingSkills { skills })),
            (&busy, "navigation", icu, price(0.1), Expectation::CostsAtLeast(0.0)),
            (&busy, "navigation", r#"robot.attributes.section == "er""#, price(0.1), refuses(NotEligible)),
            (&broken, "navigation", icu, price(0.1), refuses(OutOfService)),
        ] {
            let found = expect(&call(skill, condition), worker, price);
            assert_eq!(found, expected, "{skill}, {condition}, {price:?}");
        }
    }

    #[test]
    fn a_robot_with_promised_roles_has_no_bound() {
        let price = Price::AtLeast { time: Seconds::new(20.0).unwrap(), energy: 0.1 };
        let mut call = call("navigation", "true");
        let worker = robot(Availability::Free);
        assert_eq!(expect(&call, &worker, price), Expectation::CostsAtLeast(100_020.0));
        let span = RoleSpan { from: None, to: None, time: Seconds::ZERO, energy: Energy::ZERO };
        let role = RoleOfMission { mission: "visit-0".parse().unwrap(), role: "r1".parse().unwrap() };
        let (robot, slack, release, charges) = ("ada".parse().unwrap(), None, Seconds::ZERO, false);
        call.timelines.promised = vec![PromisedRole { robot, role, span, slack, release, charges }];
        assert_eq!(expect(&call, &worker, price), Expectation::CostsAtLeast(0.0));
        assert_eq!(
            expect(&call, &worker, Price::Impossible),
            Expectation::CostsAtLeast(0.0),
            "it drives from elsewhere"
        );
    }
}
