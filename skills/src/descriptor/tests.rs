//! Pricing on a small map; `tests/published_bids.rs` repeats the published evaluation.

use super::*;
use crate::environment::{Edge, Environment, Routes, TopologicalMap};
use consort_protocol::ids::{PlaceId, RoleId, TaskId, TaskType};
use consort_protocol::mission::TaskSpec;
use consort_protocol::plan::{LocalPlan, Signal, SignalKind, Step, StepAction};
use consort_protocol::pose::Pose;
use consort_protocol::units::{MetresPerSecond, SharePerSecond};

fn place(name: &str) -> PlaceId {
    PlaceId::new(name).unwrap()
}

fn task(name: &str, parameters: &[(&str, &str)]) -> TaskSpec {
    TaskSpec {
        parameters: parameters.iter().map(|(name, value)| (name.to_string(), value.to_string())).collect(),
        ..TaskSpec::of(TaskType::new(name).unwrap(), vec![RoleId::new("r1").unwrap()])
    }
}

fn plan(actions: Vec<StepAction>) -> LocalPlan {
    let steps = actions.into_iter().map(|action| Step { action, after: vec![] }).collect();
    LocalPlan::of(RoleId::new("r1").unwrap(), steps)
}

fn doing(id: &str, spec: TaskSpec) -> StepAction {
    StepAction::Task { id: TaskId::new(id).unwrap(), spec }
}

fn signal() -> Signal {
    let role = |name| RoleId::new(name).unwrap();
    Signal { kind: SignalKind::Done, task: TaskId::new("open").unwrap(), from: role("r1"), to: role("nurse") }
}

/// A – B – C in a line, 10 m and 30 m long, and D apart.
fn environment() -> Environment {
    let names = ["A", "B", "C", "D"];
    let edge = |a, b, length_m| Edge { a: place(a), b: place(b), length_m, one_way: false };
    let map = TopologicalMap {
        places: names.map(|name| (place(name), Pose::default())).into(),
        edges: vec![edge("A", "B", 10.0), edge("B", "C", 30.0)],
    };
    Environment::new().with(Routes::new(&map).unwrap())
}

fn estimator() -> Estimator {
    DescriptorRegistry::standard().resolve(environment()).unwrap()
}

fn robot(at: &str) -> EstimateContext {
    EstimateContext::at(place(at), MetresPerSecond::new(0.5).unwrap(), SharePerSecond::new(0.001).unwrap())
}

#[test]
fn each_step_is_priced_from_the_end_of_the_previous_step() {
    let plan = plan(vec![
        doing("to_b", task("navigation", &[("to", "B")])),
        doing("open", task("operate_drawer", &[("action", "open")])),
        StepAction::Send(signal()),
        StepAction::Wait(signal()),
        doing("pause", task("wait", &[("seconds", "7.5")])),
        doing("to_c", task("navigation", &[("to", "C")])),
    ]);
    let parts = estimator().price(&plan, &robot("A")).unwrap();
    let seen: Vec<_> = parts
        .iter()
        .map(|part| (part.step, part.skill.as_str(), part.label.as_str(), part.time.get(), part.energy))
        .collect();
    assert_eq!(
        seen,
        [
            (0, "navigation", "to_b", 20.0, 0.02),
            (1, "operate_drawer", "open", 2.0, 0.002),
            (2, "send_message", "done:open:r1:nurse", 2.0, 0.002),
            (3, "wait_message", "done:open:r1:nurse", 2.0, 0.002),
            (4, "wait", "pause", 7.5, 0.0075),
            (5, "navigation", "to_c", 60.0, 0.06),
        ]
    );
}

#[test]
fn an_unreachable_destination_gives_no_bid() {
    let plan = plan(vec![StepAction::Wait(signal()), doing("to_d", task("navigation", &[("to", "D")]))]);
    let error = estimator().price(&plan, &robot("A")).unwrap_err();
    assert_eq!((error.step, error.task.as_str()), (1, "to_d"));
    assert_eq!(error.to_string(), "step 1 (to_d): no route from A to D: the map has no way between them");
}

#[test]
fn a_closed_lane_is_priced_by_a_detour_or_rejected() {
    let to_c = plan(vec![doing("to_c", task("navigation", &[("to", "C")]))]);
    let closed = EstimateContext { closed: vec![(place("B"), place("A"))], ..robot("A") };
    let error = estimator().price(&to_c, &closed).unwrap_err();
    assert_eq!(error.to_string(), "step 0 (to_c): no route from A to C: the ways between them are closed");
    let elsewhere = EstimateContext { closed: vec![(place("A"), place("D")), (place("A"), place("X"))], ..robot("A") };
    assert_eq!(estimator().price(&to_c, &elsewhere), estimator().price(&to_c, &robot("A")), "no such way");
}

#[test]
fn a_closed_place_is_not_entered_and_may_be_left() {
    let to = |name| plan(vec![doing("go", task("navigation", &[("to", name)]))]);
    let closed = |at| EstimateContext { closed: vec![(place("B"), place("B"))], ..robot(at) };
    let error = estimator().price(&to("C"), &closed("A")).unwrap_err();
    assert_eq!(error.to_string(), "step 0 (go): no route from A to C: the ways between them are closed");
    let error = estimator().price(&to("B"), &closed("A")).unwrap_err();
    assert_eq!(error.to_string(), "step 0 (go): no route from A to B: the ways between them are closed");
    assert_eq!(estimator().price(&to("C"), &closed("B")), estimator().price(&to("C"), &robot("B")));
}

#[test]
fn a_speed_limit_is_priced() {
    let to_c = plan(vec![doing("to_c", task("navigation", &[("to", "C")]))]);
    let time = |limit: f64| {
        let limit = ((place("B"), place("A")), MetresPerSecond::new(limit).unwrap());
        let robot = EstimateContext { limits: [limit].into_iter().collect(), ..robot("A") };
        estimator().price(&to_c, &robot).unwrap()[0].time.get()
    };
    assert_eq!(time(0.25), 10.0 / 0.25 + 30.0 / 0.5);
    assert_eq!(time(3.0), 40.0 / 0.5, "the robot is slower");
}

#[test]
fn a_missing_parameter_is_named() {
    let price = |spec| estimator().price(&plan(vec![doing("t", spec)]), &robot("A")).unwrap_err().source.to_string();
    assert_eq!(price(task("navigation", &[])), "the navigation task has no parameter `to`");
    assert!(price(task("wait", &[("seconds", "-1")])).starts_with("the wait task has `seconds` = \"-1\": "));
    assert!(price(task("juggle", &[])).starts_with("no skill descriptor for juggle; descriptors exist for alert, "));
}

#[test]
fn an_environment_without_routes_names_the_skills_that_need_them() {
    let error = DescriptorRegistry::standard().resolve(Environment::new()).err().unwrap();
    assert_eq!(
        error.to_string(),
        "the environment lacks descriptors: carry needs `routes`, follow_path needs `routes`, navigation needs `routes`; \
         it has none"
    );
}

/// Drives with an uncertainty of half the energy.
struct Rough(TaskType, Estimator);

impl SkillDescriptor for Rough {
    fn task_type(&self) -> &TaskType {
        &self.0
    }

    fn required_descriptors(&self) -> Vec<&'static str> {
        vec![]
    }

    fn estimate(&self, task: &TaskSpec, context: &EstimateContext, _: &Environment) -> Result<Estimate, EstimateError> {
        let plain = self.1.estimate(task, context)?;
        Ok(Estimate { energy_sd: plain.energy / 2.0, ..plain })
    }
}

#[test]
fn a_cautious_robot_keeps_a_reserve_for_the_plan_as_a_whole() {
    let there_and_back = plan(vec![
        doing("to_b", task("navigation", &[("to", "B")])),
        doing("open", task("operate_drawer", &[("action", "open")])),
        doing("to_a", task("navigation", &[("to", "A")])),
    ]);
    let budget = |margin_sds: f64| {
        let rough = DescriptorRegistry::standard().with(Rough(TaskType::new("navigation").unwrap(), estimator()));
        let estimator = rough.with_energy_margin(margin_sds).resolve(environment()).unwrap();
        let budget = estimator.budget(&there_and_back, &robot("A")).unwrap();
        assert_eq!(budget.parts, estimator.price(&there_and_back, &robot("A")).unwrap());
        budget.energy
    };
    // Two drives of 0.02 and a drawer of 0.002. Each drive has a deviation of 0.01, both together
    // less than 0.02.
    assert!((budget(0.0) - 0.042).abs() < 1e-12);
    assert!((budget(2.0) - (0.042 + 2.0 * 0.01 * 2.0_f64.sqrt())).abs() < 1e-12);
    let sure = estimator().budget(&there_and_back, &robot("A")).unwrap();
    assert_eq!(sure.parts.iter().map(|part| part.energy).sum::<f64>(), sure.energy);
}

#[test]
fn the_estimate_of_a_plan_is_a_bound_if_those_of_all_its_tasks_grow_with_drives() {
    let navigation = TaskType::new("navigation").unwrap();
    let rough = DescriptorRegistry::standard().with(Rough(navigation, estimator())).resolve(environment()).unwrap();
    let open = || doing("open", task("operate_drawer", &[("action", "open")]));
    let there = || doing("to_b", task("navigation", &[("to", "B")]));
    for (actions, expected) in [
        (vec![open(), StepAction::Send(signal())], [true, true]),
        (vec![open(), there()], [true, false]),
        (vec![doing("dance", task("dance", &[]))], [false, false]),
    ] {
        let plan = plan(actions);
        assert_eq!([estimator().grows_with_drives(&plan), rough.grows_with_drives(&plan)], expected, "{plan:?}");
    }
}
