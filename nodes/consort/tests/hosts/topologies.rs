//! The shipped topologies, each with the failure that it must survive.

use crate::lab::inside;
use crate::shipped_topology::ShippedTopology;
use crate::support::{LONG, until};
use consort_tests::host_network::within;
use serde_json::Value;
use std::cell::RefCell;
use std::process::{Child, Command};

/// The world runs ten times as fast as real time, which the file sets.
const QUICK: [&str; 1] = ["CONSORT_SPEED=10"];

/// Requests a sample and waits for the end of the mission.
const SUBMIT: [&str; 7] = ["submit", "lab-samples", "--set", "room=IC Room 6", "--wait", "--timeout", "60"];

/// The page with the commands that the tests run.
const DEPLOYMENT: &str = include_str!("../../../../docs/deployment.md");

/// Counts the nodes that a node sees alive.
fn alive(fleet: &Value) -> usize {
    let nodes = fleet["fleet"]["nodes"].as_array().into_iter().flatten();
    nodes.filter(|node| node["alive"] == true).count()
}

/// Returns the coordinator.
fn coordinator(fleet: &Value) -> Option<String> {
    fleet["coordinator"]["node"].as_str().map(str::to_owned)
}

/// Waits until a node sees `count` nodes alive and a coordinator, and returns the coordinator.
fn settled(shipped: &mut ShippedTopology, count: usize, on: &str, more: &[&str]) -> String {
    let command = [&["fleet", "--json"], more].concat();
    shipped.wait_for_json(&format!("{count} are there"), &command, on, |fleet| {
        (alive(fleet) == count).then(|| coordinator(fleet)).flatten()
    })
}

#[test]
fn a_network_survives_the_loss_of_its_coordinator() {
    inside("topologies::a_network_survives_the_loss_of_its_coordinator", &[], || {
        let stations = ["station-1", "station-2", "station-3"];
        let mut shipped = ShippedTopology::new(
            "lan",
            &[
                ("10.0.0.1", "station-1.ward.example"),
                ("10.0.0.2", "station-2.ward.example"),
                ("10.0.0.3", "station-3.ward.example"),
            ],
        );
        for (number, name) in stations.into_iter().chain(["world", "ada", "lab-arm"]).enumerate() {
            shipped.machine(name, &[("lan", &format!("10.0.0.{}", number + 1))]);
        }
        for station in stations {
            shipped.start("station", station, &[]);
        }
        shipped.start("world", "world", &QUICK);
        shipped.start("robot", "ada", &[]);
        shipped.start("robot", "lab-arm", &[]);
        shipped.await_started();
        let first = settled(&mut shipped, 6, "ada", &[]);
        assert!(stations.contains(&first.as_str()), "{first} coordinates");
        let mission = shipped.begin(&SUBMIT, "ada");
        shipped.wait_for_task("ada", "navto_room");
        shipped.unplug(&first, "lan");
        let ended = mission.end(LONG).expect(0);
        assert!(ended.stdout.ends_with(" completed\n"), "{}", ended.stdout);
        let second = settled(&mut shipped, 5, "ada", &[]);
        assert!(second != first && stations.contains(&second.as_str()), "{second} coordinates after {first}");
        shipped.plug(&first, "lan");
        assert_eq!(settled(&mut shipped, 6, &first, &[]), settled(&mut shipped, 6, "ada", &[]));
    });
}

/// Number of carts of the campus in a test: fewer than it is for, since each is a process.
const CARTS: usize = 6;

/// Variable with another number of carts: up to 200.
const CARTS_VARIABLE: &str = "CONSORT_CAMPUS_CARTS";

/// Waits until one of these robots has begun a task, and returns it.
fn first_to_begin<'a>(shipped: &ShippedTopology, robots: &'a [String], task: &str) -> &'a str {
    let task = format!("task=\"{task}\"");
    until(&format!("a robot begins {task}"), LONG, || {
        let begins = |robot: &&String| {
            shipped.log(robot).lines().any(|line| line.contains("task_began") && line.contains(&task))
        };
        robots.iter().find(begins).map(String::as_str)
    })
}

#[test]
fn a_campus_survives_the_loss_of_the_station_that_coordinates() {
    inside("topologies::a_campus_survives_the_loss_of_the_station_that_coordinates", &[], || {
        let stations = ["station-1", "station-2", "station-3"];
        let mut shipped = ShippedTopology::new(
            "campus",
            &[
                ("10.0.0.1", "station-1.ward.example"),
                ("10.0.0.2", "station-2.ward.example"),
                ("10.0.0.3", "station-3.ward.example"),
            ],
        );
        let number = std::env::var(CARTS_VARIABLE).ok().and_then(|text| text.parse().ok()).unwrap_or(CARTS);
        shipped.prepare(&commands_for_carts(number));
        let carts: Vec<String> = (1..=number).map(|number| format!("cart-{number}")).collect();
        let names = stations.into_iter().chain(["world", "lab-arm"]).chain(carts.iter().map(String::as_str));
        for (number, name) in names.enumerate() {
            shipped.machine(name, &[("campus", &format!("10.0.0.{}", number + 1))]);
        }
        for station in stations {
            shipped.start("station", station, &[]);
        }
        shipped.start("world", "world", &QUICK);
        shipped.start("robot", "lab-arm", &[]);
        for cart in &carts {
            shipped.start("robot", cart, &[]);
        }
        shipped.await_started();
        let all = stations.len() + 2 + carts.len();
        let first = settled(&mut shipped, all, "station-1", &[]);
        let asked = stations.into_iter().find(|station| *station != first).expect("there are three");
        let mission = shipped.begin(&SUBMIT, asked);
        let carrier = first_to_begin(&shipped, &carts, "navto_room");
        shipped.unplug(&first, "campus");
        let ended = mission.end(LONG).expect(0);
        assert!(ended.stdout.ends_with(" completed\n"), "{}", ended.stdout);
        let second = settled(&mut shipped, all - 1, asked, &[]);
        assert!(second != first && stations.contains(&second.as_str()), "{second} coordinates after {first}");
        // The carrier kept its role, also if the lost station was its relay.
        assert!(!shipped.log(carrier).contains("suspend"), "{}", shipped.log(carrier));
        shipped.plug(&first, "campus");
        assert_eq!(settled(&mut shipped, all, &first, &[]), settled(&mut shipped, all, asked, &[]));
    });
}

/// Returns the documented commands that write the files of the carts, for this number of carts.
fn commands_for_carts(number: usize) -> String {
    let lines = DEPLOYMENT.lines().filter(|line| line.contains("$(seq 2 100)"));
    let lines: Vec<String> = lines.map(|line| line.replace("$(seq 2 100)", &format!("$(seq 2 {number})"))).collect();
    assert_eq!(lines.len(), 2, "{lines:?}");
    lines.join("\n")
}

/// Kills and restarts the router of a site with `count` nodes while a mission runs.
fn a_router_is_restarted(count: usize, start: impl Fn(&mut ShippedTopology), kill: impl Fn(&mut ShippedTopology)) {
    let stations = ["station-1", "station-2", "station-3"];
    let mut shipped = ShippedTopology::new(
        "site",
        &[
            ("10.0.0.1", "station-1.ward.example"),
            ("10.0.0.2", "station-2.ward.example"),
            ("10.0.0.3", "station-3.ward.example"),
            // Its address for stations on the wired network; robots use its address on theirs.
            ("10.0.1.254", "router.ward.example"),
        ],
    );
    for (number, name) in stations.into_iter().enumerate() {
        shipped.machine(name, &[("wired", &format!("10.0.0.{}", number + 1))]);
    }
    shipped.machine("router", &[("wired", "10.0.0.254"), ("robots", "10.0.1.254")]);
    for (number, name) in ["world", "ada", "lab-arm"].into_iter().enumerate() {
        shipped.machine(name, &[("robots", &format!("10.0.1.{}", number + 1))]);
    }
    for station in stations {
        shipped.start("station", station, &[]);
    }
    start(&mut shipped);
    shipped.start("world", "world", &QUICK);
    shipped.start("robot", "ada", &[]);
    shipped.start("robot", "lab-arm", &[]);
    shipped.await_started();
    let coordinator = settled(&mut shipped, count, "ada", &[]);
    assert!(stations.contains(&coordinator.as_str()), "{coordinator} coordinates");
    let mission = shipped.begin(&SUBMIT, "ada");
    shipped.wait_for_task("ada", "navto_room");
    kill(&mut shipped);
    shipped.wait_for_links("ada", &[]);
    start(&mut shipped);
    let ended = mission.end(LONG).expect(0);
    assert!(ended.stdout.ends_with(" completed\n"), "{}", ended.stdout);
    // ada kept her role, and no station declared another node dead.
    assert!(!shipped.log("ada").contains("suspend"), "{}", shipped.log("ada"));
    assert_eq!(settled(&mut shipped, count, "ada", &[]), coordinator);
}

#[test]
fn a_site_survives_a_restart_of_its_router() {
    inside("topologies::a_site_survives_a_restart_of_its_router", &[], || {
        let start = |shipped: &mut ShippedTopology| shipped.start("station", "router", &[]);
        a_router_is_restarted(7, start, |shipped| shipped.kill("router"));
    });
}

/// Zenoh's own router, built by `tests/foreign/zenoh/router.sh`.
const ZENOHD: &str = concat!(env!("CARGO_TARGET_TMPDIR"), "/foreign-router/zenohd");

#[test]
fn a_site_survives_a_restart_of_zenohd() {
    inside("topologies::a_site_survives_a_restart_of_zenohd", &[ZENOHD], || {
        let stations = [1, 2, 3].map(|number| format!("--connect=tcp/station-{number}.ward.example:7447"));
        let running = RefCell::new(None);
        let start = |_: &mut ShippedTopology| {
            let mut zenohd = Command::new(within("router")[0]);
            zenohd.args(&within("router")[1..]).args([ZENOHD, "--no-multicast-scouting", "--listen=tcp/0.0.0.0:7447"]);
            zenohd.args(&stations).env("RUST_LOG", "off");
            running.replace(Some(zenohd.spawn().expect("it was there a moment ago")));
        };
        a_router_is_restarted(6, start, |_| {
            let mut zenohd: Child = running.take().expect("it was started");
            zenohd.kill().and_then(|()| zenohd.wait()).expect("a child can be killed");
        });
    });
}

/// Creates the certificates of both sites with the commands of the documentation.
fn certify(shipped: &mut ShippedTopology) {
    let dir = shipped.path("certs").display().to_string();
    for line in documented("consort cert ") {
        let arguments = [&["cert", "--dir", &dir][..], &line.iter().map(String::as_str).collect::<Vec<_>>()].concat();
        shipped.tool(&arguments).expect(0);
    }
}

/// Returns the arguments of documented command lines that begin with `command`.
fn documented(command: &str) -> Vec<Vec<String>> {
    let lines: Vec<_> = DEPLOYMENT.lines().filter_map(|line| line.strip_prefix(command)).collect();
    assert!(lines.len() > 5, "the documentation has too few certificate commands: {lines:?}");
    lines.iter().map(|line| line.split_whitespace().map(str::to_owned).collect()).collect()
}

#[test]
fn a_robot_roams_between_sites_while_an_uplink_is_cut() {
    inside("topologies::a_robot_roams_between_sites_while_an_uplink_is_cut", &[], || {
        let mut shipped = ShippedTopology::new(
            "sites",
            &[
                ("10.1.0.1", "north-1.ward.example"),
                ("10.1.0.2", "north-2.ward.example"),
                ("10.1.0.3", "north-3.ward.example"),
                ("192.0.2.1", "north-1.public.ward.example"),
                ("192.0.2.2", "north-2.public.ward.example"),
                ("10.2.0.1", "gate-south.ward.example"),
            ],
        );
        certify(&mut shipped);
        shipped.machine("north-1", &[("north", "10.1.0.1"), ("between", "192.0.2.1")]);
        shipped.machine("north-2", &[("north", "10.1.0.2"), ("between", "192.0.2.2")]);
        for (number, name) in ["north-3", "world", "lab-arm", "ada"].into_iter().enumerate() {
            shipped.machine(name, &[("north", &format!("10.1.0.{}", number + 3))]);
        }
        shipped.machine("gate-south", &[("south", "10.2.0.1"), ("between", "192.0.2.101")]);
        for station in ["north-1", "north-2", "north-3", "gate-south"] {
            shipped.start("station", station, &[]);
        }
        shipped.start("world", "world", &QUICK);
        shipped.start("robot", "ada", &[]);
        shipped.start("robot", "lab-arm", &[]);
        shipped.await_started();
        let kim = shipped.path("certs/kim").display().to_string();
        let by_kim = ["--certs", &kim, "--connect", "tls/127.0.0.1:7447"];
        // Queried at the gate: a node in the south has the knowledge of the north.
        let coordinator = settled(&mut shipped, 7, "gate-south", &by_kim);
        assert!(coordinator.starts_with("north-"), "{coordinator} coordinates");
        let mut mission = shipped.begin(&[&SUBMIT[..], &by_kim].concat(), "gate-south");
        shipped.wait_for_task("ada", "navto_room");

        shipped.move_to_network("ada", "north", "south", "10.2.0.2");
        shipped.wait_for_links("ada", &["gate-south"]);
        shipped.wait_for_task("ada", "approach_nurse");

        shipped.unplug("gate-south", "between");
        shipped.wait_for_links("gate-south", &["ada"]);
        assert!(!mission.has_ended(), "{}{}", mission.stdout(), mission.stderr());
        shipped.plug("gate-south", "between");
        shipped.wait_for_links("gate-south", &["ada", "north-1", "north-2"]);
        let ended = mission.end(LONG).expect(0);
        assert!(ended.stdout.ends_with(" completed\n"), "{}", ended.stdout);
        assert!(!shipped.log("ada").contains("suspend"), "{}", shipped.log("ada"));
        assert_eq!(settled(&mut shipped, 7, "gate-south", &by_kim), coordinator);
    });
}
