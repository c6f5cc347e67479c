//! A fleet on the hosts of a laboratory, with a mission.

use crate::lab::Lab;
use crate::support::{Client, LONG, example, until};
use serde_json::Value;
use std::collections::BTreeMap;
use std::time::Duration;
use toml::Table;

/// Name of the fleet.
pub(crate) const FLEET: &str = "hosts";

pub(crate) fn with(mut table: Table, key: &str, value: impl Into<toml::Value>) -> Table {
    table.insert(key.to_owned(), value.into());
    table
}

/// Returns the fleet file for this number of first voters.
pub(crate) fn fleet(voters: i64) -> Table {
    with(with(example("fleet"), "name", FLEET), "bootstrap_expect", voters)
}

/// Returns the world file with a second carrier and this speed.
pub(crate) fn world(speed: f64) -> Table {
    let mut world = with(example("world"), "speed", speed);
    let bodies = world["robot"].as_array_mut().expect("bodies");
    let ada = bodies[0].as_table().expect("a body").clone();
    bodies.push(with(with(ada, "id", "bob"), "place", "PC Room 4").into());
    world
}

/// Returns the file of a robot that is no voter.
pub(crate) fn robot(kind: &str) -> Table {
    with(example(kind), "may_vote", false)
}

/// Starts five stations as voters, a world, a carrier and an arm, each on its own host, and a
/// client at the switch, linked to the world host. In a closed fleet all of them have certificates.
pub(crate) fn hospital(speed: f64, closed: bool) -> (Lab, Client) {
    let mut lab = Lab::new(&fleet(5));
    let stations = ["s1", "s2", "s3", "s4", "s5"];
    if closed {
        let voters = stations.map(|station| (station, "voter"));
        lab.close(&[&voters[..], &[("world", "host"), ("ada", "robot"), ("lab-arm", "robot")]].concat());
    }
    for host in stations.into_iter().chain(["world", "ada", "lab-arm"]) {
        lab.add(host);
    }
    for (number, station) in stations.into_iter().enumerate() {
        lab.start("station", with(example("station"), "name", station), &stations[..number]);
    }
    lab.start("world", world(speed), &stations);
    lab.start("robot", robot("robot"), &["world", "s1", "s2", "s3"]);
    lab.start("robot", robot("arm"), &["world", "s1", "s2", "s3"]);
    lab.await_open();
    let client = lab.client("world", FLEET);
    wait_for_members(&client, stations.len());
    (lab, client)
}

/// Waits until the carrier and the arm are members, and there is this number of voters.
pub(crate) fn wait_for_members(client: &Client, voters: usize) {
    until(&format!("the carrier and the arm are members, and there are {voters} voters"), LONG, || {
        let members = client.all("view/fleet", "").into_iter().next()?.1["ensembles"][0]["nodes"].clone();
        let members = members.as_array()?.iter().filter(|entry| entry["member"] == true).count();
        let present = client.all("view/coordinator", "").into_iter().next()?.1["voters"].as_array()?.len();
        (members == 2 && present == voters).then_some(())
    });
}

/// Returns the coordinator and its term from the views.
pub(crate) fn coordinator(client: &Client) -> (String, u64) {
    until("there is a coordinator", LONG, || {
        let (_, view) = client.all("view/coordinator", "").into_iter().next()?;
        Some((view["node"].as_str()?.to_owned(), view["term"].as_u64()?))
    })
}

/// Requests lab samples and returns the name of the mission.
pub(crate) fn submit(client: &Client, request: &str) -> String {
    let payload =
        format!(r#"{{"mission": "lab-samples", "parameters": {{"room": "IC Room 6"}}, "request": "{request}"}}"#);
    until("the mission is acknowledged", LONG, || {
        let (_, answer) = client.all("api/submit", &payload).into_iter().next()?;
        answer["mission"].as_str().map(str::to_owned)
    })
}

/// Waits until a robot has begun the first task of the mission.
pub(crate) fn wait_for_first_task(client: &mut Client, mission: &str) -> Value {
    client.wait_for_event("the carrier sets out", LONG, |event| {
        event["event"] == "task_began" && event["role"] == "r1" && event["mission"] == mission
    })
}

/// Waits for the election of another node in a later term.
pub(crate) fn wait_for_successor(client: &mut Client, before: &str, term: u64) -> String {
    let elected = client.wait_for_event("another is elected", LONG, |event| {
        event["event"] == "elected" && event["node"] != before && event["term"].as_u64() > Some(term)
    });
    elected["node"].as_str().expect("a name").to_owned()
}

/// Waits until the mission has completed, with each task begun and ended once.
#[track_caller]
pub(crate) fn assert_completes_once(client: &mut Client, mission: &str, lab: &Lab) {
    wait_for_completion(client, mission);
    let tasks = client.tasks(mission);
    assert_eq!(tasks.len(), 11, "{tasks:?}");
    let once: BTreeMap<_, _> = tasks.keys().map(|task| (task.clone(), (1, 1))).collect();
    assert_eq!(tasks, once, "{}", lab.logs());
}

/// Does the same on hosts that lose packets, where events are lost, too: the view has all steps, and
/// no task began or ended twice in the received events.
#[track_caller]
pub(crate) fn assert_completes_once_despite_loss(client: &mut Client, mission: &str, lab: &Lab) {
    until("the view shows the mission as completed", LONG * 2, || {
        let (_, view) = client.all(&format!("view/mission/{mission}"), "").into_iter().next()?;
        (view["state"] == "completed" && view["done"] == 16 && view["steps"] == 16).then_some(())
    });
    let tasks = client.tasks(mission);
    assert!(tasks.values().all(|(begun, ended)| *begun <= 1 && *ended <= 1), "{tasks:?}\n{}", lab.logs());
}

pub(crate) fn wait_for_completion(client: &mut Client, mission: &str) {
    client.wait_for_event("the mission completes", LONG * 2, |event| {
        event["event"] == "mission" && event["mission"] == mission && event["state"] == "completed"
    });
}

/// Waits until all these hosts report the same coordinator, and returns it.
pub(crate) fn wait_for_agreement(lab: &mut Lab, hosts: &[&str]) -> String {
    until("all hosts name the same coordinator", LONG * 2, || {
        let mut coordinators: Vec<String> = vec![];
        for host in hosts {
            let ended = lab.run(&["fleet", "--json"], host, Duration::from_secs(20));
            coordinators.push(
                (ended.status.success()).then(|| ended.json()["coordinator"]["node"].as_str().map(str::to_owned))??,
            );
        }
        coordinators.dedup();
        (coordinators.len() == 1).then(|| coordinators.remove(0))
    })
}

/// Asserts that a host without a majority acknowledges no request.
#[track_caller]
pub(crate) fn assert_rejects_requests(lab: &mut Lab, host: &str) {
    let ended = lab.run(&["submit", "lab-samples", "--set", "room=IC Room 6"], host, Duration::from_secs(4));
    assert_ne!(ended.status.code(), Some(0), "{host} acknowledged a mission: {}\n{}", ended.stdout, lab.log(host));
}
