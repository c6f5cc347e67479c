//! Robots that do not relay: each is a client of a station, or of a robot that relays where no station is in reach, and moves to
//! another relay when its own fails.

use crate::lab::{Lab, inside};
use crate::scenario::{FLEET, assert_completes_once, fleet, robot, wait_for_first_task, wait_for_members, with, world};
use crate::support::{LONG, example, until};
use toml::Table;

const GATES: [&str; 2] = ["gate-1", "gate-2"];

/// Robot that relays where no station is in reach.
const ARM: &str = "lab-arm";

/// Returns the relay that a robot is linked with.
fn relay_of(lab: &Lab, robot: &str) -> &'static str {
    until(&format!("{robot} is linked with a relay"), LONG, || {
        let log = lab.log(robot);
        let line = log.lines().rfind(|line| line.contains(" linked "))?;
        GATES.into_iter().chain([ARM]).find(|relay| {
            let log = lab.log(relay);
            let id = log.split_once(" id=\"").and_then(|(_, rest)| rest.split_once('"'));
            id.is_some_and(|(id, _)| line.contains(id))
        })
    })
}

/// Returns the file of a node with this setting of `relay`.
fn with_relay(node: Table, setting: &str) -> Table {
    with(node, "bus", with(Table::new(), "relay", setting))
}

/// With certificates, so it also shows that the link of a node that does not relay carries all messages of a node. The fleet
/// is large by its setting, so that robots on battery power relay only if they are configured to.
#[test]
fn a_robot_keeps_its_role_when_its_relays_are_lost_one_after_the_other() {
    inside("relays::a_robot_keeps_its_role_when_its_relays_are_lost_one_after_the_other", &[], || {
        let mut lab = Lab::new(&with(fleet(3), "planned_nodes", 30));
        let stations = ["s1", "s2", "s3"];
        let voters = stations.map(|station| (station, "voter"));
        let gates = GATES.map(|gate| (gate, "robot"));
        lab.close(&[&voters[..], &gates, &[("world", "host"), ("ada", "robot"), (ARM, "robot")]].concat());
        for host in stations.into_iter().chain(GATES).chain(["world", "ada", ARM]) {
            lab.add(host);
        }
        // The arm is out of reach until the corridor.
        lab.link(ARM, "ada");
        lab.cut(ARM, "ada");
        for (number, station) in stations.into_iter().enumerate() {
            lab.start("station", with(example("station"), "name", station), &stations[..number]);
        }
        lab.start("world", world(5.0), &stations);
        for gate in GATES {
            let gate = with(with(example("station"), "name", gate), "may_vote", false);
            lab.start("station", gate, &["world", "s1", "s2", "s3"]);
        }
        lab.start("robot", with_relay(robot("robot"), "no"), &["gate-1", "gate-2", ARM]);
        let arm = with(robot("arm"), "mains_powered", false);
        lab.start("robot", with_relay(arm, "yes"), &["world", "s1", "s2", "s3"]);
        lab.await_open();
        let mut client = lab.client("world", FLEET);
        wait_for_members(&client, stations.len());
        let relay = relay_of(&lab, "ada");

        let submitted = lab.run(&["submit", "lab-samples", "--set", "room=IC Room 6"], "world", LONG).expect(0);
        let mission = submitted.stdout.trim().to_owned();
        wait_for_first_task(&mut client, &mission);
        lab.unplug(relay);
        let other = until("ada is linked with the other gate", LONG, || {
            let gate = relay_of(&lab, "ada");
            (gate != relay).then_some(gate)
        });
        assert_ne!(other, ARM, "the arm is not in reach");

        client.wait_for_event("ada drives to the laboratory", LONG, |event| {
            event["event"] == "task_began" && event["mission"] == mission.as_str() && event["task"] == "navto_lab"
        });
        assert_eq!(relay_of(&lab, "ada"), other);
        // A corridor away from all stations: only the arm is in reach.
        lab.restore(ARM, "ada");
        lab.unplug("ada");
        assert_completes_once(&mut client, &mission, &lab);
        assert!(!lab.log("ada").contains("suspend"), "{}", lab.log("ada"));
        assert_eq!(relay_of(&lab, "ada"), ARM);
    });
}
