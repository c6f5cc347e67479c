//! What people are asked to do, and what is said for them, while robots are lost and replaced.

use crate::usual::began;
use consort_actors::bus::Bus;
use consort_protocol::codec;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::{ApiCall, Key};
use consort_protocol::lease::{Ending, Epoch};
use consort_protocol::ledger::{Branch, MissionState};
use consort_protocol::message::{Report, ReportAnswer, Within};
use consort_sim::world::Keeper;
use consort_tests::{Fleet, Member, slug, tell};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const OTHER: &str = "PC Room 2";
const SOON: Duration = Duration::from_secs(60);

async fn submit(fleet: &mut Fleet, mission: Value) -> MissionId {
    let answer = fleet.answer(ApiCall::Submit, &json!({ "mission": mission, "request": "a" })).await;
    slug(answer["mission"].as_str().unwrap_or_else(|| panic!("{answer}")))
}

/// The parts of whoever meets a nurse in a room: the tasks' names end with `mark`.
fn meeting(role: &str, room: &str, mark: &str) -> Vec<Value> {
    let task = |name: &str, of: &str, role: &str, parameters: Value| json!({ "task": format!("{name}{mark}"), "type": of, "roles": [role], "parameters": parameters });
    vec![
        task("navto_room", "navigation", role, json!({ "to": room })),
        task("approach", "approach_person", role, json!({ "person_role": "nurse" })),
        task("open", "operate_drawer", role, json!({ "action": "open" })),
        task("deposit", "deposit", "nurse", json!({ "into_role": role })),
        task("close", "operate_drawer", role, json!({ "action": "close" })),
    ]
}

/// `amber` is lost with the sample; `birch` is to fetch another one, from the nurse of another room. What was done for the
/// first is reported once more.
#[test]
fn what_a_nurse_did_before_is_not_taken_for_what_she_does_in_the_recovery_branch() {
    tell([711, 712], async |seed| {
        let robots = vec![Member::carrier("amber", "IC Room 4"), Member::carrier("birch", "Dock")];
        let stations = ["post-1", "post-2", "post-3"];
        let mut fleet = Fleet::hospital(seed, robots, &stations, &[ROOM, OTHER]).await;
        fleet.coordinator().await;
        let mut tasks = meeting("r1", ROOM, "");
        tasks[3]["acquires"] = json!({ "sample": "r1" });
        tasks.push(
            json!({ "task": "navto_lab", "type": "navigation", "roles": ["r1"], "parameters": { "to": "Laboratory" } }),
        );
        let managed = json!({ "kind": "managed" });
        let mission = json!({
            "mission": "another", "roles": { "nurse": { "kind": "unmanaged" }, "r1": managed, "r2": managed },
            "root": { "task": "fetch", "method": "sequential", "tasks": tasks },
            "recovery": { "task": "again", "method": "sequential", "tasks": meeting("r2", OTHER, "-2") },
        });
        let mission = submit(&mut fleet, mission).await;
        fleet.until("the way to the laboratory", SOON, |fleet| fleet.happened(began("navto_lab"))).await;
        fleet.kill("amber").await;
        fleet.until("another way to a room", SOON, |fleet| fleet.happened(began("navto_room-2"))).await;

        let report = Report {
            robot: slug("client"),
            incarnation: 0,
            mission: mission.clone(),
            role: slug("nurse"),
            epoch: Epoch::default(),
            branch: Branch::Main,
            ended: BTreeSet::from([0, 1, 2]),
            at: None,
            place: None,
            resumes: false,
            failure: None,
        };
        let said = codec::encode(&report).expect("a small message");
        let said = codec::encode(&Within { cluster: None, said }).expect("a small message");
        let coordinator = fleet.coordinator().await;
        let key = fleet.keys().write(&Key::Report(coordinator));
        let mut replies = fleet.client().query(&key, said.into(), SOON).await.expect("a bus");
        let reply = replies.recv().await.expect("an answer").payload.expect("no refusal");
        let (epoch, reason) = (Epoch::default(), Ending::Replaced);
        let answer: ReportAnswer = codec::decode(&reply).expect("an answer");
        assert_eq!(answer, ReportAnswer::Ended { epoch, reason, current: None }, "seed {seed}");

        let MissionState::NeedsRescue { cause, .. } = fleet.end_of(&mission).await else {
            panic!("seed {seed}: it ended otherwise\n{}", fleet.tale())
        };
        assert!(cause.starts_with("the recovery branch was carried out; the sample is with amber"), "{cause}");
        let tasks = fleet.tasks(&mission);
        let story = format!("seed {seed}: {tasks:?}\n{}", fleet.tale());
        assert_eq!((tasks["deposit"], tasks["deposit-2"], tasks["close-2"]), ((1, 1), (1, 1), (1, 1)), "{story}");
        assert_eq!(fleet.keeper(ROOM), Keeper::Drawer(slug("amber")), "{story}");
        assert_eq!(fleet.keeper(OTHER), Keeper::Drawer(slug("birch")), "{story}");
    });
}
