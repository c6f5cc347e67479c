//! Monte Carlo estimate of the success of a robot in a role, for the oracle policy.

use super::design::ScenarioRobot;
use super::outcome::TrialLimits;
use super::policy::SuccessEstimate;
use super::travel::TravelModel;
use consort_protocol::ids::PlaceId;
use consort_protocol::knowledge::Attributes;
use consort_protocol::plan::{LocalPlan, StepAction};
use consort_protocol::units::{MetresPerSecond, SharePerSecond};
use consort_skills::descriptor::{EstimateContext, Estimator};
use consort_skills::environment::SpeedLimits;
use rand_chacha::ChaCha8Rng;

/// Returns the estimator's context of a robot at its start.
pub fn start_context(robot: &ScenarioRobot) -> EstimateContext {
    EstimateContext {
        place: robot.place.clone(),
        pose: None,
        speed: MetresPerSecond::new(robot.speed_mps).expect("scenarios are checked"),
        discharge: SharePerSecond::new(robot.discharge).expect("scenarios are checked"),
        closed: vec![],
        limits: SpeedLimits::default(),
        attributes: Attributes::default(),
        readings: None,
    }
}

/// Estimates the probability that a robot carries a plan out before its battery is empty or the
/// time limit passes, and the mean duration, from `draws` draws of the travel model. A wait for
/// other robots is assumed to last as long as estimated. A robot without a required skill never
/// succeeds.
pub fn estimate_success(
    plan: &LocalPlan,
    robot: &ScenarioRobot,
    estimator: &Estimator,
    travel: &TravelModel,
    limits: &TrialLimits,
    draws: u32,
    rng: &mut ChaCha8Rng,
) -> SuccessEstimate {
    let failure = SuccessEstimate { success: 0.0, time_s: limits.sim_s };
    if plan.tasks().any(|(_, spec)| !robot.skills.contains(&spec.task_type)) {
        return failure;
    }
    let Ok(parts) = estimator.price(plan, &start_context(robot)) else { return failure };
    let mut place = robot.place.clone();
    // The estimated time of each step, and the places between which it drives.
    let steps = parts.iter().zip(&plan.steps).map(|(part, step)| {
        let to = match &step.action {
            StepAction::Task { spec, .. } => spec.parameters.get("to"),
            _ => None,
        };
        let to = to.and_then(|to| to.parse::<PlaceId>().ok());
        let leg = to.map(|to| (std::mem::replace(&mut place, to.clone()), to));
        (part.time.get(), leg)
    });
    let steps: Vec<_> = steps.collect();
    let (mut successes, mut time_s) = (0_u32, 0.0);
    for _ in 0..draws {
        let duration_s: f64 = steps
            .iter()
            .map(|(time, leg)| leg.as_ref().map_or(*time, |(from, to)| time * travel.factor(from, to, rng)))
            .sum();
        let charge_left = robot.charge - duration_s * robot.discharge;
        if charge_left >= limits.battery_share && duration_s <= limits.sim_s {
            successes += 1;
            time_s += duration_s;
        }
    }
    match successes {
        0 => failure,
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
    use consort_protocol::plan::divide_and_check;
    use consort_skills::descriptor::DescriptorRegistry;
    use consort_skills::domain::hospital;
    use consort_skills::environment::{Environment, Routes};
    use consort_skills::missions::shipped as missions;

    #[test]
    fn success_depends_on_battery_skills_and_drawn_drives() {
        let design = shipped("published").unwrap().unwrap();
        let scenario = scenarios(&design).remove(0);
        let parameters = scenario.parameters(&design.mission).unwrap();
        let mission = missions()["lab-samples"].instantiate(&parameters, &hospital()).unwrap();
        let plan =
            divide_and_check(&mission).unwrap().plans[&"r1".parse::<consort_protocol::ids::RoleId>().unwrap()].clone();
        let map = consort_world::map::shipped("hospital").unwrap();
        let environment = Environment::new().with(Routes::new(&map.topology()).unwrap());
        let estimator = DescriptorRegistry::standard().resolve(environment).unwrap();
        let skills = design.robots[0].skills.clone();
        let able = ScenarioRobot { skills, charge: 0.9, discharge: 0.0004, ..scenario.robots[0].clone() };
        let limits = TrialLimits::default();
        let estimate = |robot: &ScenarioRobot, spread: f64| {
            let travel = TravelModel::Kinematic(TravelSettings { spread, ..TravelSettings::default() });
            estimate_success(&plan, robot, &estimator, &travel, &limits, 400, &mut generator(7, &["fate"]))
        };
        let certain = estimate(&able, 0.0);
        let time: f64 = estimator.price(&plan, &start_context(&able)).unwrap().iter().map(|part| part.time.get()).sum();
        assert_eq!((certain.success, (certain.time_s - time).abs() < 1e-6), (1.0, true));
        // A battery that lasts exactly as long as estimated fails in about half of the draws.
        let exact = ScenarioRobot { charge: 0.05 + time * able.discharge, ..able.clone() };
        let even = estimate(&exact, 0.3);
        assert!((0.35..0.65).contains(&even.success), "{even:?}");
        let mut unable = able.clone();
        unable.skills.remove(&TaskType::new("approach_robot").unwrap());
        assert_eq!(estimate(&unable, 0.0).success, 0.0);
    }
}
