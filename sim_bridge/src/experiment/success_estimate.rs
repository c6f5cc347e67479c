//! What would come of giving a role to a robot, by trying it many times on paper: the knowledge of the oracle.

use super::design::ScenarioRobot;
use super::outcome::TrialLimits;
use super::policy::SuccessEstimate;
use super::travel::TravelModel;
use consort_protocol::ids::PlaceId;
use consort_protocol::plan::{LocalPlan, StepAction};
use consort_protocol::units::{MetresPerSecond, SharePerSecond};
use consort_skills::descriptor::{EstimateContext, Estimator};
use rand_chacha::ChaCha8Rng;

/// The robot as an estimator sees it, where it starts.
pub fn start_context(robot: &ScenarioRobot) -> EstimateContext {
    EstimateContext {
        place: robot.place.clone(),
        pose: None,
        speed: MetresPerSecond::new(robot.speed_mps).expect("scenarios are checked"),
        discharge: SharePerSecond::new(robot.discharge).expect("scenarios are checked"),
        closed: vec![],
    }
}

/// How often a robot would carry a plan out before its battery or the time ends, and how long it would take, over so many
/// draws of the travel model. Waiting for others is taken to last as long as estimated. A robot that lacks a skill never would.
pub fn estimate_success(
    plan: &LocalPlan,
    robot: &ScenarioRobot,
    estimator: &Estimator,
    travel: &TravelModel,
    limits: &TrialLimits,
    draws: u32,
    rng: &mut ChaCha8Rng,
) -> SuccessEstimate {
    let hopeless = SuccessEstimate { success: 0.0, time_s: limits.sim_s };
    if plan.tasks().any(|(_, spec)| !robot.skills.contains(&spec.task_type)) {
        return hopeless;
    }
    let Ok(parts) = estimator.price(plan, &start_context(robot)) else { return hopeless };
    let mut place = robot.place.clone();
    // Each step's estimated time, and between which places it drives.
    let steps = parts.iter().zip(&plan.steps).map(|(part, step)| {
        let to = match &step.action {
            StepAction::Task { spec, .. } if spec.task_type.as_str() == "navigation" => spec.parameters.get("to"),
            _ => None,
        };
        let to = to.and_then(|to| to.parse::<PlaceId>().ok());
        let leg = to.map(|to| (std::mem::replace(&mut place, to.clone()), to));
        (part.time.get(), leg)
    });
    let steps: Vec<_> = steps.collect();
    let (mut successes, mut time_s) = (0_u32, 0.0);
    for _ in 0..draws {
        let takes: f64 = steps
            .iter()
            .map(|(time, leg)| leg.as_ref().map_or(*time, |(from, to)| time * travel.factor(from, to, rng)))
            .sum();
        let left = robot.charge - takes * robot.discharge;
        if left >= limits.battery_share && takes <= limits.sim_s {
            successes += 1;
            time_s += takes;
        }
    }
    match successes {
        0 => hopeless,
        _ => SuccessEstimate {
            success: f64::from(successes) / f64::from(draws.max(1)),
            time_s: time_s / f64::from(successes),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::super::design::{scenarios, shipped};
    use super::super::seeds::generator;
    use super::super::travel::TravelSettings;
    use super::*;
    use consort_protocol::ids::TaskType;
    use consort_protocol::mission::{Domain, shipped as missions};
    use consort_protocol::plan::divide_and_check;
    use consort_skills::descriptor::DescriptorRegistry;
    use consort_skills::environment::{Environment, Routes};

    #[test]
    fn a_robot_succeeds_as_often_as_its_battery_lasts_on_the_drives_that_are_drawn() {
        let design = shipped("published").unwrap().unwrap();
        let scenario = scenarios(&design).remove(0);
        let parameters = scenario.parameters(&design.mission).unwrap();
        let mission = missions()["lab-samples"].instantiate(&parameters, &Domain::hospital()).unwrap();
        let plan =
            divide_and_check(&mission).unwrap().plans[&"r1".parse::<consort_protocol::ids::RoleId>().unwrap()].clone();
        let map = crate::map::shipped("hospital").unwrap();
        let environment = Environment::new().with(Routes::new(&map.topology()).unwrap());
        let estimator = DescriptorRegistry::standard().resolve(environment).unwrap();
        let skills = design.robots[0].skills.clone();
        let able = ScenarioRobot { skills, charge: 0.9, discharge: 0.0004, ..scenario.robots[0].clone() };
        let limits = TrialLimits::default();
        let try_it = |robot: &ScenarioRobot, spread: f64| {
            let travel = TravelModel::Kinematic(TravelSettings { spread, ..TravelSettings::default() });
            estimate_success(&plan, robot, &estimator, &travel, &limits, 400, &mut generator(7, &["fate"]))
        };
        let sure = try_it(&able, 0.0);
        let time: f64 = estimator.price(&plan, &start_context(&able)).unwrap().iter().map(|part| part.time.get()).sum();
        assert_eq!((sure.success, (sure.time_s - time).abs() < 1e-6), (1.0, true));
        // A battery that lasts exactly as long as estimated fails about every other time.
        let exact = ScenarioRobot { charge: 0.05 + time * able.discharge, ..able.clone() };
        let even = try_it(&exact, 0.3);
        assert!((0.35..0.65).contains(&even.success), "{even:?}");
        let mut unable = able.clone();
        unable.skills.remove(&TaskType::new("approach_robot").unwrap());
        assert_eq!(try_it(&unable, 0.0).success, 0.0);
    }
}
