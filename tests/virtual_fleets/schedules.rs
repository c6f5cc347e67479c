//! Schedules: missions that are submitted at certain times.

use crate::support::with_wrong_clock;
use consort_bus::clock::Clock;
use consort_fleet::node::NodeSettings;
use consort_protocol::event::{EventKind, ScheduleChange};
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::Ledger;
use consort_tests::{Fleet, RobotSpec, for_each_seed};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::time::Duration;

const SEEDS: [u64; 3] = [94, 95, 96];
const MINUTE: Duration = Duration::from_secs(60);

async fn fleet(seed: u64, stations: &[&str]) -> Fleet {
    let robots = vec![RobotSpec::carrier("amber", "Dock").with_skill("wait")];
    let mut fleet = Fleet::hospital(seed, robots, stations, &[]).await;
    fleet.wait_for_coordinator().await;
    fleet
}

/// Returns a request for a rest of 1 s every minute.
fn every_minute(missed: &str) -> Value {
    let rest = json!({ "task": "rest", "type": "wait", "roles": ["r1"], "parameters": { "seconds": "1" } });
    let mission = json!({ "mission": "rest", "roles": { "r1": { "kind": "managed" } }, "root": rest });
    json!({
        "schedule": "rests", "action": "add", "cron": "* * * * *", "zone": "Europe/Berlin", "missed": missed,
        "submit": { "mission": mission }, "by": "Nia",
    })
}

/// Sends a request, again while the coordinator asks for that.
async fn request(fleet: &Fleet, request: &Value) -> Value {
    let reply = async |fleet: &Fleet| {
        let reply = fleet.request_answered(ApiCall::Schedule, request).await;
        reply.get("retry_after_ms").is_none().then_some(reply)
    };
    fleet.poll_until("a reply", MINUTE, reply).await
}

async fn change(fleet: &Fleet, action: &str) -> Value {
    request(fleet, &json!({ "schedule": "rests", "action": action, "by": "Nia" })).await
}

/// Returns the missions in the order of their numbers, with the minutes after 1970 at which they were due.
fn missions(fleet: &Fleet) -> Vec<(MissionId, u64)> {
    let due = |request: &str| request.split('.').nth(1).and_then(|due_ms| due_ms.parse::<u64>().ok());
    let missions = fleet.ledger(|ledger| {
        let due_of = |id: &MissionId| Some(due(ledger.mission(id)?.submission.request.as_str())? / 60_000);
        let ids = ledger.missions().map(|entry| (entry.number, entry.id.clone()));
        let mut all: Vec<_> = ids.filter_map(|(number, id)| Some((number, id.clone(), due_of(&id)?))).collect();
        all.sort();
        all.into_iter().map(|(_, id, due)| (id, due)).collect()
    });
    missions.unwrap_or_default()
}

fn minutes(fleet: &Fleet) -> Vec<u64> {
    missions(fleet).into_iter().map(|(_, due)| due).collect()
}

async fn wait_for_missions(fleet: &mut Fleet, count: usize) {
    fleet.wait_until("the occurrences", 8 * MINUTE, |fleet| missions(fleet).len() >= count).await;
}

/// Returns the missions of the events about occurrences, with the minutes after 1970 at which they were due.
fn announced(fleet: &Fleet) -> Vec<(MissionId, u64)> {
    let announced = fleet.events().into_iter().filter_map(|event| match event {
        EventKind::OccurrenceSubmitted { due_ms, mission, .. } => Some((mission, due_ms / 60_000)),
        _ => None,
    });
    announced.collect()
}

/// Returns the published changes of the schedule with the responsible people.
fn changes(fleet: &Fleet) -> Vec<(ScheduleChange, String)> {
    let changes = fleet.events().into_iter().filter_map(|event| match event {
        EventKind::ScheduleChanged { schedule, change, by } if schedule.as_str() == "rests" => Some((change, by)),
        _ => None,
    });
    changes.collect()
}

/// Asserts that the missions are those of consecutive minutes, each once.
fn assert_consecutive(fleet: &Fleet, seed: u64) {
    let minutes = minutes(fleet);
    assert!(minutes.windows(2).all(|pair| pair[1] == pair[0] + 1), "seed {seed}: {minutes:?}");
}

#[test]
fn each_occurrence_is_submitted_once_across_takeovers() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, &["aba", "bab", "cab", "dab", "eba"]).await;
        let reply = request(&fleet, &every_minute("skip")).await;
        assert!(reply["schedule"]["next_ms"].is_u64(), "seed {seed}: {reply}");
        assert_eq!(request(&fleet, &every_minute("skip")).await, reply, "seed {seed}: again");
        wait_for_missions(&mut fleet, 1).await;
        fleet.kill_coordinator().await;
        wait_for_missions(&mut fleet, 3).await;
        fleet.kill_coordinator().await;
        wait_for_missions(&mut fleet, 5).await;
        assert_consecutive(&fleet, seed);
        let (announced, submitted) = (announced(&fleet), missions(&fleet));
        // A coordinator that is killed may not have published its last one.
        assert!(announced.len() >= 3, "seed {seed}: {announced:?}");
        let is_once = |event: &&(MissionId, u64)| announced.iter().filter(|other| other == event).count() == 1;
        assert!(
            announced.iter().all(|event| is_once(&event) && submitted.contains(event)),
            "seed {seed}: {announced:?}"
        );
        for (mission, _) in &missions(&fleet)[..4] {
            fleet.assert_completes(mission).await;
            fleet.assert_each_task_once(mission);
        }
        let view = serde_json::to_string(&fleet.view("schedules").await).expect("JSON");
        assert!(view.contains(r#""schedule":"rests""#) && view.contains(r#""by":"Nia""#), "{view}");
        let people = |ledger: &Ledger| ledger.audit_trail().map(|entry| entry.by.clone()).collect::<Vec<_>>();
        assert_eq!(fleet.ledger(people), Some(vec!["Nia".to_owned()]), "seed {seed}: the trail names the person alone");
        let by = |ledger: &Ledger| ledger.missions().map(|entry| entry.submission.by.clone()).collect::<BTreeSet<_>>();
        assert_eq!(fleet.ledger(by), Some(BTreeSet::from(["Nia, schedule rests".to_owned()])), "seed {seed}");
    });
}

#[test]
fn a_paused_or_removed_schedule_submits_nothing() {
    for_each_seed(SEEDS, async |seed| {
        let mut fleet = fleet(seed, &["aba"]).await;
        request(&fleet, &every_minute("all")).await;
        wait_for_missions(&mut fleet, 1).await;
        let reply = change(&fleet, "pause").await;
        assert_eq!(reply["schedule"]["pause"]["by"], "Nia", "seed {seed}: {reply}");
        tokio::time::sleep(3 * MINUTE).await; // virtual time
        assert_eq!(missions(&fleet).len(), 1, "seed {seed}");
        change(&fleet, "resume").await;
        wait_for_missions(&mut fleet, 3).await;
        let due = minutes(&fleet);
        assert!(due[1] >= due[0] + 3 && due[2] == due[1] + 1, "seed {seed}: {due:?}");
        assert_eq!(change(&fleet, "remove").await, json!({ "schedule": null }), "seed {seed}");
        tokio::time::sleep(3 * MINUTE).await; // virtual time
        assert_eq!(missions(&fleet).len(), 3, "seed {seed}");
        assert_eq!(announced(&fleet), missions(&fleet), "seed {seed}");
    });
}

#[test]
fn each_change_of_a_schedule_is_published_once_with_the_person() {
    use ScheduleChange::{Added, Paused, Removed, Resumed};
    for_each_seed(SEEDS, async |seed| {
        let fleet = fleet(seed, &["aba"]).await;
        request(&fleet, &every_minute("skip")).await;
        request(&fleet, &every_minute("skip")).await;
        for action in ["resume", "pause", "pause", "resume", "remove", "remove"] {
            change(&fleet, action).await;
        }
        let expected = [Added, Paused, Resumed, Removed].map(|change| (change, "Nia".to_owned()));
        assert_eq!(changes(&fleet), expected, "seed {seed}");
    });
}

#[test]
fn a_closed_fleet_publishes_the_signer_of_a_change() {
    for_each_seed([SEEDS[0]], async |seed| {
        let robots = vec![RobotSpec::carrier("amber", "Dock").with_skill("wait")];
        let mut fleet = Fleet::closed_hospital(seed, robots, &["aba"], &[]).await;
        fleet.wait_for_coordinator().await;
        request(&fleet, &every_minute("skip")).await;
        change(&fleet, "pause").await;
        let changes = changes(&fleet);
        assert_eq!(changes.len(), 2, "{changes:?}");
        assert!(changes.iter().all(|(_, by)| by.starts_with("Nia, according to ")), "{changes:?}");
    });
}

/// All nodes but the world are down while two occurrences are due.
#[test]
fn occurrences_of_an_outage_are_skipped_or_submitted_late() {
    for (missed, submitted_late) in [("skip", &[][..]), ("last", &[6]), ("all", &[3, 6])] {
        for_each_seed([SEEDS[0]], async |seed| {
            // The clock of a node that restarts goes on.
            let clock = Clock::virtual_at(0);
            let adjust = move |settings: &mut NodeSettings| settings.clock = clock;
            let robots = vec![RobotSpec::carrier("amber", "Dock").with_skill("wait")];
            let mut fleet = Fleet::adjusted_hospital(seed, robots, &["aba", "bab"], &[], Box::new(adjust)).await;
            fleet.wait_for_coordinator().await;
            let mut schedule = every_minute(missed);
            schedule["cron"] = json!("*/3 * * * *");
            request(&fleet, &schedule).await;
            wait_for_missions(&mut fleet, 1).await;
            let first = minutes(&fleet)[0];
            for node in ["amber", "aba", "bab"] {
                fleet.kill(node).await;
            }
            tokio::time::sleep(8 * MINUTE).await; // virtual time
            for node in ["amber", "aba", "bab"] {
                fleet.restart(node).await;
            }
            let expected = [&[0][..], submitted_late, &[9]].concat().into_iter().map(|after| first + after);
            let expected: Vec<u64> = expected.collect();
            fleet.wait_until("the next occurrence", 4 * MINUTE, |fleet| minutes(fleet).last() == expected.last()).await;
            assert_eq!(minutes(&fleet), expected, "seed {seed}: {missed}");
        });
    }
}

/// The clock of one voter is a day ahead.
#[test]
fn a_wrong_clock_submits_nothing_early_or_twice() {
    for_each_seed(SEEDS, async |seed| {
        for wrong in ["aba", "abb", "abc"] {
            let mut fleet = with_wrong_clock(seed, wrong, &[]).await;
            request(&fleet, &every_minute("all")).await;
            wait_for_missions(&mut fleet, 2).await;
            fleet.kill_coordinator().await;
            wait_for_missions(&mut fleet, 4).await;
            assert_consecutive(&fleet, seed);
            let last = minutes(&fleet)[3];
            assert!(last <= fleet.elapsed().as_secs() / 60, "seed {seed}, {wrong}: minute {last}");
        }
    });
}

#[test]
fn wrong_schedules_are_rejected_with_the_reason() {
    for_each_seed([SEEDS[0]], async |_| {
        let fleet = fleet(SEEDS[0], &["aba"]).await;
        for (field, value, expected) in [
            ("cron", json!("61 * * * *"), "cron is \"61 * * * *\""),
            ("zone", json!("Europe/Atlantis"), "zone is \"Europe/Atlantis\"; allowed are UTC and"),
            ("until", json!("soon"), "until is \"soon\"; allowed is a date and time in RFC 3339"),
            ("missed", json!("some"), "expected one of `skip`, `last`, `all`"),
            (
                "submit",
                json!({ "mission": "no-such" }),
                "the fleet has no mission \"no-such\"; allowed: bed-transfer, ",
            ),
            ("submit", json!({ "mission": "vital-signs", "request": "a" }), "`request` of `submit` is not allowed"),
            ("submit", Value::Null, "`submit` is missing"),
            ("cron", Value::Null, "`cron` is missing"),
            ("action", json!("pause"), "belong to the action `add`"),
            ("schedule", json!("x".repeat(41)), "at most 40 are allowed"),
        ] {
            let mut wrong = every_minute("skip");
            wrong[field] = value;
            let reply = request(&fleet, &wrong).await;
            let error = reply["error"].as_str().unwrap_or_default();
            assert!(error.contains(expected), "{field}: {reply}");
        }
        let reply = change(&fleet, "pause").await;
        assert_eq!(reply["error"], "there is no schedule rests; see api/schedules");
    });
}
