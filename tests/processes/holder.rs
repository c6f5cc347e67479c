//! The robot that carries the sample dies on its way to the nurse.

use crate::demo::each_once;
use crate::support::{Client, Fleet, example, until};
use serde_json::Value;
use std::time::Duration;
use toml::Table;

const LONG: Duration = Duration::from_secs(60);

fn with(mut table: Table, key: &str, value: impl Into<toml::Value>) -> Table {
    table.insert(key.to_owned(), value.into());
    table
}

/// Two robots that can carry; a station keeps the ledger. Leases are short, so that a lost robot is soon replaced.
fn hospital() -> Fleet {
    let lease: Table = "lease_ms = 1500\ngrace_ms = 500".parse().expect("TOML");
    let file = with(with(example("fleet"), "name", "relay"), "bootstrap_expect", 1);
    let mut fleet = Fleet::new(&with(file, "lease", lease));
    let mut world = with(example("world"), "speed", 10.0);
    let bodies = world["robot"].as_array_mut().expect("bodies");
    let ada = bodies[0].as_table().expect("a body").clone();
    bodies.push(with(with(ada, "id", "bob"), "place", "PC Room 4").into());
    fleet.start("world", world, &[]);
    fleet.start("station", example("station"), &["world"]);
    let robot = with(example("robot"), "may_vote", false);
    fleet.start("robot", robot.clone(), &["world", "station-1"]);
    fleet.start("robot", with(with(robot, "name", "bob"), "place", "PC Room 4"), &["world", "station-1"]);
    fleet.start("robot", with(example("arm"), "may_vote", false), &["world", "station-1"]);
    fleet
}

#[test]
fn the_role_of_a_robot_that_dies_before_it_has_told_anybody_is_carried_out_by_another() {
    let mut fleet = hospital();
    let mut client = Client::open(&fleet.address("world"), "relay");
    until("both carriers and the arm are members", LONG, || {
        let members = client.view("fleet")["ensembles"][0]["nodes"].clone();
        let members = members.as_array()?.iter().filter(|entry| entry["member"] == true).count();
        (members == 3).then_some(())
    });
    let asked = r#"{"mission": "lab-samples", "parameters": {"room": "IC Room 6"}}"#;
    let mission = client.ask("api/submit", asked)["mission"].as_str().expect("a mission").to_owned();
    let is = |event: &Value, name: &str| event["event"] == name && event["mission"] == mission.as_str();

    let began = client.hears("r1 sets out", LONG, |event| is(event, "task_began") && event["role"] == "r1");
    assert_eq!(began["task"], "navto_room");
    let lost = began["node"].as_str().expect("a name").to_owned();
    fleet.kill(&lost);
    let other = if lost == "ada" { "bob" } else { "ada" };

    let released = client.hears("the role is given up", LONG, |event| is(event, "released"));
    assert_eq!(released["role"], "r1");
    let awarded = |event: &Value| is(event, "awarded") && event["holders"]["r1"] == other;
    let award = client.hears("the role is given to the other robot", LONG, awarded);
    assert_eq!(award["holders"].as_object().map(serde_json::Map::len), Some(1), "the arm keeps its own: {award}");
    client.hears("the mission completes", LONG, |event| is(event, "mission") && event["state"] == "completed");

    // The way to the nurse was begun twice, by one and then by the other, and nothing else.
    let mut expected = each_once();
    expected.insert("r1/navto_room".to_owned(), (2, 1));
    assert_eq!(client.tasks(&mission), expected, "{}", fleet.logs());
    let view = client.view(&format!("mission/{mission}"));
    let r1 = view["roles"].as_array().expect("roles").iter().find(|role| role["role"] == "r1").expect("r1");
    assert_eq!(r1["holder"], other);
    assert_eq!(client.view("world")["samples"][0]["place"], "Laboratory");
    assert!(!client.present().contains(&format!("robot/{lost}")));
    assert_eq!(client.view(&format!("robot/{lost}"))["alive"], false);
    assert!(!fleet.names().contains(&lost.as_str()));
    fleet.stop();
}
