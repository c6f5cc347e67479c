//! Results of tasks, conditions on them, and results of missions.

use consort_protocol::event::EventKind;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::MissionState;
use consort_tests::{Fleet, RobotSpec, for_each_seed, slug};
use serde_json::{Value, json};

const SEEDS: [u64; 3] = [811, 812, 813];
const SKILLS: [&str; 4] = ["navigation", "operate_drawer", "measure_vital_signs", "wait"];

/// Two measurements by one robot. Another robot drives there and waits as long as the second pulse, if
/// the temperature is above a limit. A person attends otherwise.
fn mission(limit: f64) -> Value {
    let measure = |task: &str| json!({ "task": task, "type": "measure_vital_signs", "roles": ["r1"] });
    let wait = json!({ "task": "wait_there", "type": "wait", "roles": ["r2"],
        "parameters": { "seconds": "${second.pulse_bpm}" } });
    let attend = json!({ "task": "attend", "type": "attend", "roles": ["nurse"], "parameters": { "at": "Dock" } });
    json!({
        "mission": "watch", "roles": { "r1": { "kind": "managed" }, "r2": { "kind": "managed" }, "nurse": { "kind": "unmanaged" } },
        "parameters": { "limit": { "kind": "number", "default": limit.to_string() } },
        "root": { "task": "all", "method": "sequential", "tasks": [
            measure("first"), measure("second"),
            { "task": "react", "choose": [{ "when": "first.temperature_c > ${limit}", "do": wait }], "else": attend },
        ] },
        "result": { "fever": "first.temperature_c > ${limit}", "pulse": "second.pulse_bpm" },
    })
}

async fn fleet(seed: u64) -> Fleet {
    let robots = [("amber", "Dock"), ("birch", "Dock")]
        .map(|(name, place)| RobotSpec::carrier(name, place).with_skills(&SKILLS));
    Fleet::hospital(seed, robots.to_vec(), &["post"], &["IC Room 6"]).await
}

async fn submit(fleet: &mut Fleet, mission: &Value) -> MissionId {
    fleet.wait_for_coordinator().await;
    let answer = fleet.request_answered(ApiCall::Submit, &json!({ "mission": mission, "request": "a" })).await;
    slug(answer["mission"].as_str().unwrap_or_else(|| panic!("{answer}")))
}

fn skipped(fleet: &Fleet) -> Vec<String> {
    let skipped = |kind| if let EventKind::TaskSkipped { task, .. } = kind { Some(task.to_string()) } else { None };
    fleet.events().into_iter().filter_map(skipped).collect()
}

#[test]
fn a_condition_selects_a_branch_and_a_result_becomes_a_parameter() {
    for_each_seed(SEEDS, async |seed| {
        for (limit, fever, other) in [(20.0, true, "attend"), (45.0, false, "wait_there")] {
            let mut fleet = fleet(seed).await;
            let id = submit(&mut fleet, &mission(limit)).await;
            fleet.assert_completes(&id).await;
            assert_eq!(skipped(&fleet), [other], "seed {seed}");
            let view = fleet.request_answered(ApiCall::Get, &json!({ "mission": id })).await;
            assert_eq!(view["result"]["fever"], fever, "seed {seed}: {}", view["result"]);
            let tasks = view["tree"]["children"].as_array().expect("children");
            let pulse = &tasks[1]["results"]["pulse_bpm"];
            assert!(pulse.is_u64() && *pulse == view["result"]["pulse"], "seed {seed}: {}", tasks[1]);
            let react = tasks[2]["children"].as_array().expect("branches");
            let states: Vec<_> = react.iter().map(|task| task["state"].as_str().expect("a state")).collect();
            let expected = if fever { ["done", "skipped"] } else { ["skipped", "done"] };
            assert_eq!(states, expected, "seed {seed}");
        }
    });
}

/// The robot is lost after its first measurement. Its successor begins the role anew and measures again,
/// but the first result counts, since others may have used it.
#[test]
fn a_result_outlives_the_robot_that_returned_it() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        let id = submit(&mut fleet, &mission(20.0)).await;
        let result = async |fleet: &Fleet| {
            let view = fleet.request_answered(ApiCall::Get, &json!({ "mission": id })).await;
            let result = view["tree"]["children"][0]["results"]["temperature_c"].clone();
            result.is_number().then(|| (result, view["holders"]["r1"].as_str().map(str::to_owned)))
        };
        let limit = std::time::Duration::from_secs(60);
        let (temperature, holder) = fleet.poll_until("the first result", limit, result).await;
        let holder = holder.expect("a holder");
        fleet.kill(&holder).await;
        fleet.start_robot(&holder).await;
        fleet.assert_completes(&id).await;
        let view = fleet.request_answered(ApiCall::Get, &json!({ "mission": id })).await;
        assert_eq!(view["tree"]["children"][0]["results"]["temperature_c"], temperature, "seed {seed}");
    });
}

/// The condition uses a result of a task that was skipped.
#[test]
fn an_unknown_result_fails_the_mission_at_once_and_names_the_place() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed).await;
        let measure = |task: &str, when: &str| json!({ "task": task, "type": "measure_vital_signs", "roles": ["r1"], "when": when });
        let mission = json!({
            "mission": "watch", "roles": { "r1": { "kind": "managed" } },
            "root": { "task": "all", "method": "sequential", "tasks": [
                measure("first", "false"), measure("second", "first.pulse_bpm > 60"),
            ] },
        });
        let id = submit(&mut fleet, &mission).await;
        let MissionState::Failed { cause, .. } = fleet.wait_for_end(&id).await else { panic!("seed {seed}") };
        assert!(
            cause.contains(
                "could not do second: `first.pulse_bpm > 60`: the results of first are unknown: it was skipped"
            ),
            "seed {seed}: {cause}"
        );
        let awards = fleet.events().into_iter().filter(|kind| matches!(kind, EventKind::Awarded { .. })).count();
        assert_eq!(awards, 1, "seed {seed}: no other robot was asked");
    });
}
