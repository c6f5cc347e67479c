//! Processes are killed, stopped and restarted at any step of a mission.

use crate::demo::each_once;
use crate::support::{Client, Fleet, LONG, example, until};
use consort_raft::store::LEDGER_FILE;
use serde_json::Value;
use toml::Table;

pub(crate) const STATIONS: [&str; 3] = ["station-1", "station-2", "station-3"];

pub(crate) fn with(mut table: Table, key: &str, value: impl Into<toml::Value>) -> Table {
    table.insert(key.to_owned(), value.into());
    table
}

/// Returns the configuration of a world with samples for many missions.
pub(crate) fn world(speed: f64) -> Table {
    let mut world = with(example("world"), "speed", speed);
    let samples: Vec<String> = (1..=12).map(|number| format!("blood-{number}")).collect();
    world["person"][0].as_table_mut().expect("a person").insert("samples".to_owned(), samples.into());
    world
}

/// Starts three stations as voters, each with its own data directory. They connect to the world,
/// which a real fleet does not contain.
pub(crate) fn start_voters(name: &str, speed: f64) -> Fleet {
    let mut fleet = Fleet::new(&with(example("fleet"), "name", name));
    start_voters_in(&mut fleet, speed);
    fleet
}

fn start_voters_in(fleet: &mut Fleet, speed: f64) {
    fleet.start("world", world(speed), &[]);
    for station in STATIONS {
        let data = fleet.path(&format!("{station}-data")).display().to_string();
        let table = with(with(example("station"), "name", station), "data_dir", data);
        let neighbours: Vec<&str> =
            ["world"].into_iter().chain(STATIONS).take_while(|other| *other != station).collect();
        fleet.start("station", table, &neighbours);
    }
}

/// Starts the same fleet with two robots: a carrier and an arm.
fn hospital(name: &str, speed: f64) -> Fleet {
    let mut fleet = Fleet::new(&with(example("fleet"), "name", name));
    start_hospital(&mut fleet, speed);
    fleet
}

/// Starts the nodes of such a hospital.
pub(crate) fn start_hospital(fleet: &mut Fleet, speed: f64) {
    start_voters_in(fleet, speed);
    for (kind, robot) in [("robot", "ada"), ("arm", "lab-arm")] {
        let data = fleet.path(&format!("{robot}-data")).display().to_string();
        fleet.start("robot", with(with(example(kind), "may_vote", false), "data_dir", data), &["world", "station-1"]);
    }
}

/// Waits for a coordinator and returns its name.
fn coordinator(client: &Client) -> String {
    coordinator_and_term(client).0
}

/// Waits for a coordinator and returns its name and term.
pub(crate) fn coordinator_and_term(client: &Client) -> (String, u64) {
    until("there is a coordinator", LONG, || {
        let answers = client.all("view/coordinator", "");
        let latest = answers.iter().max_by_key(|(_, view)| view["term"].as_u64())?;
        Some((latest.1["node"].as_str()?.to_owned(), latest.1["term"].as_u64()?))
    })
}

/// Repeats a request under the same name until it is acknowledged.
pub(crate) fn submit(client: &Client, request: &str) -> String {
    let payload =
        format!(r#"{{"mission": "lab-samples", "parameters": {{"room": "IC Room 6"}}, "request": "{request}"}}"#);
    until("the mission is acknowledged", LONG, || {
        let answers = client.all("api/submit", &payload);
        answers.iter().find_map(|(_, answer)| answer["mission"].as_str().map(str::to_owned))
    })
}

fn ready(client: &Client, members: usize) {
    until("the robots are members", LONG, || {
        let (_, view) = client.all("view/fleet", "").into_iter().next()?;
        let nodes = view["ensembles"][0]["nodes"].as_array()?;
        (nodes.iter().filter(|entry| entry["member"] == true).count() == members).then_some(())
    });
}

fn is_of(event: &Value, name: &str, mission: &str) -> bool {
    event["event"] == name && event["mission"] == mission
}

/// Waits until a mission has completed. A coordinator that is killed right after the commit publishes no event of it.
pub(crate) fn completes(client: &mut Client, mission: &str) {
    until(&format!("{mission} completes"), LONG, || {
        let is_end = |event: &Value| is_of(event, "mission", mission) && event["state"] == "completed";
        let is_published = client.events().iter().any(is_end);
        (is_published || state(client, mission) == "completed").then_some(())
    });
}

fn state(client: &Client, mission: &str) -> Value {
    until(&format!("the state of {mission} is known"), LONG, || {
        let answers = client.all(&format!("view/mission/{mission}"), "");
        answers.into_iter().map(|(_, view)| view["state"].clone()).find(Value::is_string)
    })
}

/// Asserts that each task of a mission was executed once, although coordinators were killed. Events of the
/// tasks of people follow the entry in the ledger, so a coordinator that is killed in between publishes
/// them never: for those tasks the ledger counts.
fn assert_each_task_once(client: &mut Client, mission: &str, context: &str) {
    let is_of_person = |task: &str| task.starts_with("nurse/");
    let (of_people, of_robots): (Vec<_>, Vec<_>) =
        client.tasks(mission).into_iter().partition(|(task, _)| is_of_person(task));
    let expected: Vec<_> = each_once().into_iter().filter(|(task, _)| !is_of_person(task)).collect();
    assert_eq!(of_robots, expected, "{context}");
    assert!(of_people.iter().all(|(_, (begun, ended))| *begun <= 1 && *ended <= 1), "{of_people:?}: {context}");
    let done = until(&format!("a view of {mission}"), LONG, || {
        let views = client.all(&format!("view/mission/{mission}"), "");
        let view = views.into_iter().map(|(_, view)| view).find(|view| view["roles"].is_array())?;
        let nurse = view["roles"].as_array()?.iter().find(|role| role["role"] == "nurse")?;
        Some(nurse["steps"].as_array()?.iter().map(|step| step["done"] == true).collect::<Vec<_>>())
    });
    assert!(!done.is_empty() && done.iter().all(|done| *done), "{done:?}: {context}");
}

/// Kills the coordinator and restarts it.
fn kill_and_start_again(fleet: &mut Fleet, client: &Client) {
    let victim = coordinator(client);
    fleet.kill(&victim);
    fleet.start_again(&victim);
}

#[test]
fn missions_survive_coordinator_kills_at_each_protocol_step() {
    let mut fleet = hospital("steps", 20.0);
    let mut client = Client::open(&fleet.address("world"), "steps");
    ready(&client, 2);
    let mut steps_seen = 0;
    for (number, step) in
        ["submitted", "bids_requested", "awarded", "started", "sent", "progress"].into_iter().enumerate()
    {
        let mission = format!("lab-samples-{}", number + 1);
        // The reply may be missing: the coordinator may be dead before it replies.
        let asking = submit(&client, step);
        assert_eq!(asking, mission, "{step}");
        // A restarted node may publish an event before it has discovered its subscribers.
        let seen = until(&format!("{mission} is {step}, or over"), LONG, || {
            let events = client.events();
            let over = events.iter().any(|event| is_of(event, "mission", &mission) && event["state"] == "completed");
            let seen = events.iter().any(|event| is_of(event, step, &mission));
            (seen || over).then_some(seen)
        });
        steps_seen += usize::from(seen);
        kill_and_start_again(&mut fleet, &client);
        assert_eq!(
            submit(&client, step),
            mission,
            "{step}: what was acknowledged is not lost, nor is it something new"
        );
        completes(&mut client, &mission);
        assert_each_task_once(&mut client, &mission, &format!("killed when it was {step}\n{}", fleet.logs()));
        // The last step has been reported; the coordinator is killed before the next query.
        kill_and_start_again(&mut fleet, &client);
        assert_eq!(state(&client, &mission), "completed", "{step}");
    }
    assert!(steps_seen > 3, "{steps_seen} of 6");
    fleet.stop();
}

#[test]
fn a_mission_survives_a_coordinator_kill_at_each_task() {
    let mut fleet = hospital("tasks", 4.0);
    let mut client = Client::open(&fleet.address("world"), "tasks");
    ready(&client, 2);
    let mission = submit(&client, "every-task");
    let mut kills = 0;
    for task in each_once().keys().filter(|task| !task.starts_with("nurse/")) {
        let (_, task) = task.split_once('/').expect("ROLE/TASK");
        let seen = until("the mission goes on", LONG, || {
            let events = client.events();
            let over = events.iter().any(|event| is_of(event, "mission", &mission) && event["state"] == "completed");
            let began = events.iter().any(|event| is_of(event, "task_began", &mission) && event["task"] == task);
            (began || over).then_some(over)
        });
        if seen {
            break;
        }
        kill_and_start_again(&mut fleet, &client);
        kills += 1;
    }
    completes(&mut client, &mission);
    assert!(kills > 2, "{kills}");
    assert_each_task_once(&mut client, &mission, &format!("{kills} kills\n{}", fleet.logs()));
    fleet.stop();
}

#[test]
fn a_coordinator_that_was_stopped_returns_without_authority() {
    let mut fleet = hospital("still", 4.0);
    let mut client = Client::open(&fleet.address("world"), "still");
    ready(&client, 2);
    let mission = submit(&client, "still-1");
    client.wait_for_event("the carrier sets out", LONG, |event| {
        is_of(event, "task_began", &mission) && event["role"] == "r1"
    });
    let first = coordinator(&client);
    fleet.node(&first).signal("STOP");
    let elected = client.wait_for_event("another is elected", LONG, |event| {
        event["event"] == "elected" && event["node"] != first.as_str()
    });
    let before = client.events().len();
    fleet.node(&first).signal("CONT");
    until("the stopped node has noticed that it no longer coordinates", LONG, || {
        fleet.node(&first).stderr().contains("no longer coordinates").then_some(())
    });
    completes(&mut client, &mission);
    assert_each_task_once(&mut client, &mission, &fleet.logs());
    let acts_as_coordinator = |event: &&Value| {
        let what = event["event"].as_str().unwrap_or("?");
        event["node"] == first.as_str()
            && ["awarded", "released", "mission", "bids_requested", "closed"].contains(&what)
    };
    assert_eq!(client.events()[before..].iter().filter(acts_as_coordinator).collect::<Vec<_>>(), Vec::<&Value>::new());
    let last = coordinator(&client);
    assert_eq!(elected["node"], last.as_str());
    assert!(
        client.present().iter().filter(|key| key.starts_with("coordinator/")).count() == 1,
        "{:?}",
        client.present()
    );
    fleet.stop();
}

#[test]
fn a_running_mission_completes_after_all_nodes_were_killed() {
    let mut fleet = hospital("all", 8.0);
    let mut client = Client::open(&fleet.address("world"), "all");
    ready(&client, 2);
    let under_way = submit(&client, "all-1");
    let waiting = submit(&client, "all-2");
    client.wait_for_event("the carrier sets out", LONG, |event| {
        is_of(event, "task_began", &under_way) && event["role"] == "r1"
    });
    let nodes: Vec<String> = fleet.names().into_iter().filter(|name| *name != "world").map(str::to_owned).collect();
    for node in &nodes {
        fleet.kill(node);
    }
    for node in &nodes {
        fleet.start_again(node);
    }
    let missions = until("the ledger is served again", LONG, || {
        let (_, view) = client.all("view/missions", "").into_iter().next()?;
        view["missions"].as_array().cloned()
    });
    let known: Vec<&str> = missions.iter().filter_map(|entry| entry["mission"].as_str()).collect();
    assert_eq!(known, [under_way.as_str(), waiting.as_str()], "what was acknowledged is there");
    completes(&mut client, &under_way);
    completes(&mut client, &waiting);
    let delivered = client.view("world")["samples"]
        .as_array()
        .expect("samples")
        .iter()
        .filter(|s| s["place"] == "Laboratory")
        .count();
    assert_eq!(delivered, 2, "{}", fleet.logs());
    fleet.stop();
}

#[test]
fn the_fleet_continues_after_a_restart_of_the_world() {
    let mut fleet = Fleet::new(&with(with(example("fleet"), "name", "worldless"), "bootstrap_expect", 1));
    fleet.start("station", example("station"), &[]);
    fleet.start("world", world(10.0), &["station-1"]);
    for kind in ["robot", "arm"] {
        fleet.start("robot", with(example(kind), "may_vote", false), &["station-1"]);
    }
    let mut client = Client::open(&fleet.address("station-1"), "worldless");
    ready(&client, 2);
    let first = submit(&client, "before");
    client.wait_for_event("the carrier sets out", LONG, |event| {
        is_of(event, "task_began", &first) && event["role"] == "r1"
    });
    fleet.kill("world");
    until("the carrier reports that its driver server does not reply, or has ended its mission", LONG, || {
        let (_, view) = client.all("view/robot/ada", "").into_iter().next()?;
        view["robot"].is_object().then_some(())
    });
    fleet.start_again("world");
    until("the earlier mission has ended in any state", LONG, || {
        let (_, view) = client.all(&format!("view/mission/{first}"), "").into_iter().next()?;
        let over = !["pending", "running"].contains(&view["state"].as_str()?);
        over.then_some(())
    });
    ready(&client, 2);
    let second = submit(&client, "after");
    completes(&mut client, &second);
    fleet.stop();
}

/// Damages the ledger file of a stopped node.
fn damage_ledger(fleet: &Fleet, node: &str) {
    let path = fleet.path(&format!("{node}-data")).join(LEDGER_FILE);
    let mut bytes = std::fs::read(&path).expect("a ledger");
    for byte in bytes.iter_mut().skip(4096) {
        *byte ^= 0x55;
    }
    std::fs::write(&path, bytes).expect("a ledger");
}

#[test]
fn a_voter_with_a_damaged_store_joins_again() {
    let mut fleet = start_voters("damage", 20.0);
    let client = Client::open(&fleet.address("world"), "damage");
    let leader = coordinator(&client);
    let first = submit(&client, "first");
    let victim = STATIONS.into_iter().find(|name| *name != leader).expect("three stations");
    fleet.kill(victim);
    damage_ledger(&fleet, victim);
    let mut observer = Client::open(&fleet.address("world"), "damage");
    fleet.start_again(victim);
    // The coordinator replaces the former member of this name by the new one.
    let reason = format!("{victim} came back with an empty store: {victim} replaces it");
    observer.wait_for_event("the node is a voter again", LONG, |event| {
        event["event"] == "voters" && event["reason"] == *reason
    });
    assert!(fleet.path(&format!("{victim}-data")).join("damaged-1").join(LEDGER_FILE).exists());
    // Without the leader a majority needs the rebuilt voter.
    fleet.kill(&leader);
    let second = submit(&client, "second");
    let known = |mission: &str| !client.view(&format!("mission/{mission}"))["state"].is_null();
    assert!(known(&first) && known(&second));
}
