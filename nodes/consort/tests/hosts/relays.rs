//! Robots that do not relay: each is a client of a station, and moves to another when that one fails.

use crate::lab::{Lab, inside};
use crate::scenario::{FLEET, assert_completes_once, fleet, robot, wait_for_first_task, wait_for_members, with, world};
use crate::support::{LONG, example, until};
use toml::Table;

const GATES: [&str; 2] = ["gate-1", "gate-2"];

/// Returns the gate that a robot is linked with.
fn gate_of(lab: &Lab, robot: &str) -> &'static str {
    until(&format!("{robot} is linked with a gate"), LONG, || {
        let log = lab.log(robot);
        let line = log.lines().rfind(|line| line.contains(" linked "))?;
        GATES.into_iter().find(|gate| {
            let log = lab.log(gate);
            let id = log.split_once(" id=\"").and_then(|(_, rest)| rest.split_once('"'));
            id.is_some_and(|(id, _)| line.contains(id))
        })
    })
}

/// With certificates, so it also shows that the link of a node that does not relay carries all messages of a node.
#[test]
fn a_robot_keeps_its_role_when_its_relay_loses_its_cable() {
    inside("relays::a_robot_keeps_its_role_when_its_relay_loses_its_cable", &[], || {
        let mut lab = Lab::new(&fleet(3));
        let stations = ["s1", "s2", "s3"];
        let voters = stations.map(|station| (station, "voter"));
        let gates = GATES.map(|gate| (gate, "robot"));
        lab.close(&[&voters[..], &gates, &[("world", "host"), ("ada", "robot"), ("lab-arm", "robot")]].concat());
        for host in stations.into_iter().chain(GATES).chain(["world", "ada", "lab-arm"]) {
            lab.add(host);
        }
        for (number, station) in stations.into_iter().enumerate() {
            lab.start("station", with(example("station"), "name", station), &stations[..number]);
        }
        lab.start("world", world(5.0), &stations);
        for gate in GATES {
            let gate = with(with(example("station"), "name", gate), "may_vote", false);
            lab.start("station", gate, &["world", "s1", "s2", "s3"]);
        }
        let client_of_gates: Table = "relay = \"no\"".parse().expect("TOML");
        lab.start("robot", with(robot("robot"), "bus", client_of_gates), &GATES);
        lab.start("robot", robot("arm"), &["world", "s1", "s2", "s3"]);
        lab.await_open();
        let mut client = lab.client("world", FLEET);
        wait_for_members(&client, stations.len());
        let relay = gate_of(&lab, "ada");

        let submitted = lab.run(&["submit", "lab-samples", "--set", "room=IC Room 6"], "world", LONG).expect(0);
        let mission = submitted.stdout.trim().to_owned();
        wait_for_first_task(&mut client, &mission);
        lab.unplug(relay);
        let other = until("ada is linked with the other gate", LONG, || {
            let gate = gate_of(&lab, "ada");
            (gate != relay).then_some(gate)
        });
        assert_completes_once(&mut client, &mission, &lab);
        assert!(!lab.log("ada").contains("suspend"), "{}", lab.log("ada"));
        assert_eq!(gate_of(&lab, "ada"), other);
    });
}
