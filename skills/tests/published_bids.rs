//! The bids of the published evaluation, repeated: every third scenario, with the time and energy
//! of each robot.

use consort_protocol::ids::{PlaceId, RoleId, TaskId, TaskType};
use consort_protocol::knowledge::Attributes;
use consort_protocol::mission::TaskSpec;
use consort_protocol::plan::{LocalPlan, Signal, SignalKind, Step, StepAction};
use consort_protocol::units::{MetresPerSecond, SharePerSecond};
use consort_skills::descriptor::{DescriptorRegistry, EstimateContext, Estimator};
use consort_skills::environment::{Environment, Routes, SpeedLimits, TopologicalMap};
use serde_json::Value;
use std::path::PathBuf;

#[path = "../../tests/support/skip.rs"]
mod skip;

use skip::skip;

fn reference() -> Option<PathBuf> {
    let root = match std::env::var_os("CONSORT_REFERENCE") {
        Some(root) => PathBuf::from(root),
        None => PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/reference"),
    };
    let folder = root.join("mission_control");
    if folder.is_dir() {
        return Some(folder);
    }
    skip("no published evaluation (CONSORT_REFERENCE names the folder that contains it)");
    None
}

fn task(id: &str, task_type: &str, parameters: &[(&str, &str)]) -> StepAction {
    let parameters = parameters.iter().map(|(name, value)| (name.to_string(), value.to_string())).collect();
    let spec =
        TaskSpec { parameters, ..TaskSpec::of(TaskType::new(task_type).unwrap(), vec![RoleId::new("r1").unwrap()]) };
    StepAction::Task { id: TaskId::new(id).unwrap(), spec }
}

fn done(task: &str, from: &str, to: &str) -> Signal {
    let role = |name| RoleId::new(name).unwrap();
    Signal { kind: SignalKind::Done, task: TaskId::new(task).unwrap(), from: role(from), to: role(to) }
}

/// The plan of r1 in the lab-samples mission: 13 steps.
fn plan(room: &str) -> LocalPlan {
    let actions = [
        task("navto_room", "navigation", &[("to", room)]),
        task("approach_nurse", "approach_person", &[("person_role", "nurse")]),
        task("authenticate_nurse", "authenticate_person", &[("person_role", "nurse")]),
        task("open_drawer_for_nurse", "operate_drawer", &[("action", "open")]),
        StepAction::Send(done("open_drawer_for_nurse", "r1", "nurse")),
        StepAction::Wait(done("deposit", "nurse", "r1")),
        task("close_drawer_nurse", "operate_drawer", &[("action", "close")]),
        task("navto_lab", "navigation", &[("to", "Laboratory")]),
        task("approach_arm", "approach_robot", &[("robot_role", "lab_arm")]),
        task("open_drawer_lab", "operate_drawer", &[("action", "open")]),
        StepAction::Send(done("open_drawer_lab", "r1", "lab_arm")),
        StepAction::Wait(done("pick_up_sample", "lab_arm", "r1")),
        task("close_drawer_lab", "operate_drawer", &[("action", "close")]),
    ];
    let step =
        |(index, action): (u32, StepAction)| Step { action, after: if index == 0 { vec![] } else { vec![index - 1] } };
    LocalPlan::of(RoleId::new("r1").unwrap(), (0..).zip(actions).map(step).collect())
}

fn close(ours: f64, theirs: f64) -> bool {
    (ours - theirs).abs() <= 1e-9 * theirs.abs()
}

struct Published {
    estimator: Estimator,
    scenarios: Value,
    bids: Vec<Value>,
}

impl Published {
    fn read(folder: PathBuf) -> Published {
        let text = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
        let map = TopologicalMap::from_reference_json(&text("hospital_map.json")).unwrap();
        let environment = Environment::new().with(Routes::new(&map).unwrap());
        Published {
            estimator: DescriptorRegistry::standard().resolve(environment).unwrap(),
            scenarios: serde_json::from_str(&text("scenarios_81.json")).unwrap(),
            bids: text("bids_27.jsonl").lines().map(|line| serde_json::from_str(line).unwrap()).collect(),
        }
    }

    fn scenario(&self, code: &Value) -> &Value {
        self.scenarios.as_array().unwrap().iter().find(|scenario| scenario["code"] == *code).unwrap()
    }
}

fn robot<'s>(scenario: &'s Value, name: &Value) -> &'s Value {
    scenario["robots"].as_array().unwrap().iter().find(|robot| robot["name"] == *name).unwrap()
}

fn context(robot: &Value) -> EstimateContext {
    EstimateContext {
        pose: None,
        place: PlaceId::new(robot["location"].as_str().unwrap()).unwrap(),
        speed: MetresPerSecond::new(robot["avg_speed"].as_f64().unwrap()).unwrap(),
        discharge: SharePerSecond::new(robot["battery_discharge_rate"].as_f64().unwrap()).unwrap(),
        closed: vec![],
        limits: SpeedLimits::default(),
        attributes: Attributes::default(),
        readings: None,
    }
}

#[test]
fn every_published_bid_is_repeated() {
    let Some(folder) = reference() else { return };
    let published = Published::read(folder);
    let (mut bids, mut priced) = (0, 0);
    for record in &published.bids {
        let scenario = published.scenario(&record["code"]);
        let plan = plan(scenario["nurses"][0]["location"].as_str().unwrap());
        for bid in record["bids"].as_array().unwrap() {
            let robot = robot(scenario, &bid["worker"]);
            let parts = published.estimator.price(&plan, &context(robot)).unwrap();
            let time: f64 = parts.iter().map(|part| part.time.get()).sum();
            let energy: f64 = parts.iter().map(|part| part.energy).sum();
            let at = format!("{} {}", record["code"], bid["worker"]);
            bids += 1;
            // The remaining charge gives the energy also where the log omits it.
            let left = robot["battery_charge"].as_f64().unwrap() - energy;
            assert!((left - bid["remaining_battery"].as_f64().unwrap()).abs() <= 1e-9, "{at}: {left}");
            if let Some(logged) = bid["time"].as_f64() {
                priced += 1;
                assert!(close(time, logged), "{at}: {time} s, logged {logged} s");
                assert!(close(energy, bid["energy"].as_f64().unwrap()), "{at}: energy {energy}");
            }
        }
        if record["selected"].is_object() {
            selected_agrees(&published, scenario, &record["selected"], &plan);
        }
    }
    assert!(bids >= 50 && priced >= 20, "{bids} bids, {priced} with their time: the log has shrunk");
}

fn selected_agrees(published: &Published, scenario: &Value, selected: &Value, plan: &LocalPlan) {
    let parts = published.estimator.price(plan, &context(robot(scenario, &selected["worker"]))).unwrap();
    let logged = selected["plan"].as_array().unwrap();
    assert_eq!(parts.len(), logged.len());
    for (part, logged) in parts.iter().zip(logged) {
        assert_eq!(logged["skill"], part.skill.as_str());
        assert!(close(part.time.get(), logged["time"].as_f64().unwrap()), "{part:?}, logged {logged}");
        assert!(close(part.energy, logged["energy"].as_f64().unwrap()), "{part:?}, logged {logged}");
    }
}
