//! Cut cables: a link is down in both directions.

use crate::lab::Lab;
use crate::lab::inside;
use crate::scenario::{
    FLEET, assert_completes_once, assert_rejects_requests, coordinator, fleet, hospital, robot, submit,
    wait_for_agreement, wait_for_completion, wait_for_first_task, wait_for_successor, with, world,
};
use crate::support::{Client, LONG, example, until};
use serde_json::json;
use toml::Table;

#[test]
fn a_mission_completes_although_the_coordinator_loses_its_cable() {
    inside("link_failures::a_mission_completes_although_the_coordinator_loses_its_cable", &[], || {
        let (mut lab, mut client) = hospital(5.0, false);
        let mission = submit(&client, "cable-1");
        wait_for_first_task(&mut client, &mission);
        let (first, term) = coordinator(&client);
        lab.unplug(&first);
        let second = wait_for_successor(&mut client, &first, term);
        assert_completes_once(&mut client, &mission, &lab);

        assert_rejects_requests(&mut lab, &first);
        lab.plug(&first, "br0");
        assert_eq!(wait_for_agreement(&mut lab, &[&first, &second, "world"]), coordinator(&client).0);
        assert_eq!(client.view("missions")["missions"].as_array().map(Vec::len), Some(1));
    });
}

#[test]
fn a_role_holder_without_its_cable_suspends_and_is_replaced() {
    inside("link_failures::a_role_holder_without_its_cable_suspends_and_is_replaced", &[], || {
        let lease: Table = "lease_ms = 1500\ngrace_ms = 1300".parse().expect("TOML");
        let mut lab = Lab::new(&with(fleet(1), "lease", lease));
        for host in ["s1", "world", "ada", "bob", "lab-arm"] {
            lab.add(host);
        }
        lab.start("station", with(example("station"), "name", "s1"), &[]);
        lab.start("world", world(5.0), &["s1"]);
        lab.start("robot", robot("robot"), &["world", "s1"]);
        lab.start("robot", with(with(robot("robot"), "name", "bob"), "place", "PC Room 4"), &["world", "s1"]);
        lab.start("robot", robot("arm"), &["world", "s1"]);
        lab.await_open();
        let mut client = Client::open(&lab.address("world", ""), FLEET);
        until("three are members", LONG, || {
            let (_, view) = client.all("view/fleet", "").into_iter().next()?;
            let members =
                view["ensembles"][0]["nodes"].as_array()?.iter().filter(|entry| entry["member"] == true).count();
            (members == 3).then_some(())
        });
        let mission = submit(&client, "cable-2");
        let lost = wait_for_first_task(&mut client, &mission)["node"].as_str().expect("a name").to_owned();
        let other = if lost == "ada" { "bob" } else { "ada" };
        lab.unplug(&lost);
        client.wait_for_event("the role is given to the other robot", LONG, |event| {
            event["event"] == "awarded" && event["mission"] == mission.as_str() && event["holders"]["r1"] == other
        });
        // By then it has stopped by itself, without a link.
        assert!(lab.log(&lost).contains("suspend"), "{}", lab.log(&lost));
        lab.plug(&lost, "br0");
        wait_for_completion(&mut client, &mission);
        let tasks = client.tasks(&mission);
        assert_eq!(tasks.values().filter(|counts| **counts != (1, 1)).count(), 1, "{tasks:?}");
        assert_eq!(tasks["r1/navto_room"].1, 1, "{tasks:?}");
        until("the robot that came back is free", LONG, || {
            let (_, view) = client.all(&format!("view/robot/{lost}"), "").into_iter().next()?;
            (view["alive"] == true && view["robot"]["availability"] == json!("free")).then_some(())
        });
    });
}
