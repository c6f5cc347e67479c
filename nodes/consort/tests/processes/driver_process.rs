//! A robot whose driver is a Python program that the node starts, or connects to.

use crate::support::{Client, Closed, Fleet, LONG, Program, until};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::process::{Child, Command};
use toml::Table;

/// Returns an example file of the vacuum cleaner.
fn example(name: &str) -> String {
    let path = format!("{}/../../examples/vacuum/{name}", env!("CARGO_MANIFEST_DIR"));
    fs::read_to_string(&path).unwrap_or_else(|problem| panic!("{path}: {problem}"))
}

/// Starts the robot of the example, in the folder of a fleet of its own.
fn start(fleet_name: &str) -> Fleet {
    let mut robot: Table = example("robot.toml").parse().expect("TOML");
    robot["fleet"].as_table_mut().expect("a table").insert("name".to_owned(), fleet_name.into());
    let mut fleet = Fleet::new(robot["fleet"].as_table().expect("a table"));
    write_files(&fleet);
    fleet.start("robot", faster(robot), &[]);
    fleet
}

/// Returns the file of a faster robot, which shortens a test.
fn faster(mut robot: Table) -> Table {
    robot.insert("driver".to_owned(), vec!["python3", "driver.py", "20"].into());
    robot
}

/// Writes the other files of the robot. The driver also records the goals that it receives.
fn write_files(fleet: &Fleet) {
    for name in ["domain.yaml", "clean_room.xml"] {
        fs::write(fleet.path(name), example(name)).expect("the folder can be written to");
    }
    let handle = "    def handle(self, kind, message, id):\n";
    let goals = fleet.path("goals.jsonl");
    let record =
        format!("{handle}        if kind == \"goal\": open({goals:?}, \"a\").write(json.dumps(message) + \"\\n\")\n");
    let driver = example("driver.py").replace(handle, &record);
    assert!(driver.contains("goals.jsonl"), "the example has no such method");
    fs::write(fleet.path("driver.py"), driver).expect("the folder can be written to");
}

/// Returns the goals that the driver has received, in order.
fn goals(fleet: &Fleet) -> Vec<Value> {
    let goals = fs::read_to_string(fleet.path("goals.jsonl")).expect("the driver records its goals");
    goals.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect()
}

/// Asserts that exactly one goal was sent a second time, as resumed and with its id, and that no other
/// goal took its place.
fn assert_one_goal_was_resumed(fleet: &Fleet) {
    let goals = goals(fleet);
    let (resumed, first): (Vec<&Value>, Vec<&Value>) = goals.iter().partition(|goal| goal["resumed"] == true);
    let [again] = resumed[..] else { panic!("one goal is resumed: {goals:?}") };
    let same: Vec<_> = first.iter().filter(|goal| goal["id"] == again["id"]).collect();
    assert_eq!((same.len(), &again["action"]), (1, &Value::from("vacuum")), "{goals:?}");
    // The first room, the second, and the second again.
    let work = first.iter().filter(|goal| goal["action"] == "vacuum").count();
    let ids: BTreeSet<_> = first.iter().map(|goal| goal["id"].to_string()).collect();
    assert_eq!((work, ids.len()), (3, first.len()), "{goals:?}");
}

/// Returns the process of the driver.
fn driver_process(fleet: &Fleet) -> Option<String> {
    let script = fleet.path("driver.py").display().to_string();
    let pids = fs::read_dir("/proc").expect("Linux lists its processes").flatten();
    let mut pids = pids.map(|entry| entry.file_name().to_string_lossy().into_owned());
    pids.find(|pid| {
        let line = fs::read_to_string(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        // `python3` may be a script that starts the interpreter. A listener names the script later.
        let mut words = line.split('\0');
        let program = words.next().and_then(|path| path.rsplit('/').next()).unwrap_or_default();
        program.starts_with("python") && words.next() == Some(&script)
    })
}

fn kill(pid: &str) {
    let killed = Command::new("kill").args(["-KILL", pid]).status().expect("there is a program `kill`");
    assert!(killed.success(), "{pid} has ended already");
}

/// Submits the mission of the example, with more passes in the first room.
fn submit(fleet: &mut Fleet) -> Program {
    let mission = fleet.path("mission.yaml");
    fs::write(&mission, example("mission.yaml").replace(r#"passes: "1""#, r#"passes: "4""#)).expect("a folder");
    fleet.begin(&["submit", &mission.display().to_string(), "--wait"], "cleaner")
}

fn place(client: &Client) -> Option<String> {
    let (_, view) = client.all("view/fleet", "").into_iter().next()?;
    let nodes = view["nodes"].as_array()?;
    let cleaner = nodes.iter().find(|node| node["node"] == "cleaner")?;
    Some(cleaner["robot"]["place"].as_str()?.to_owned())
}

#[test]
fn a_driver_in_python_performs_a_mission_and_survives_its_death() {
    let mut fleet = start("cleaning-1");
    let waiting = submit(&mut fleet);
    let client = Client::open(&fleet.address("cleaner"), "cleaning-1");
    // It cleans the first room for 8 s.
    until("the robot is in the first room", LONG, || (place(&client)? == "IC Room 6").then_some(()));
    let first = driver_process(&fleet).expect("the driver runs");
    kill(&first);
    let second = until("the driver runs again", LONG, || driver_process(&fleet).filter(|pid| *pid != first));
    let ended = waiting.end(LONG).expect(0);
    assert!(ended.stdout.contains("clean-rooms-1 completed\n  dust_g: "), "{}", ended.stdout);
    assert_eq!(place(&client).as_deref(), Some("PC Room 3"));
    assert_eq!(driver_process(&fleet), Some(second), "the second process has performed the rest");
    let log = fleet.node("cleaner").stderr();
    assert!(log.contains("the driver has ended: signal: 9 (SIGKILL)"), "{log}");
    assert_eq!(log.matches("is ready, with the actions").count(), 2, "{log}");
    assert_one_goal_was_resumed(&fleet);
    drop(client);
    // Its driver ends with the node.
    fleet.stop();
}

/// The bag contains 2 g after the first room and 6 g after the second: the tree empties it above 5 g. Clients
/// see the reading, and so does an operator of the fleet.
#[test]
fn a_condition_on_a_reading_decides_what_the_robot_does() {
    let mut fleet = start("cleaning-6");
    let mission = fleet.path("mission.yaml");
    fs::write(&mission, example("mission.yaml")).expect("the folder can be written to");
    let waiting = fleet.begin(&["submit", &mission.display().to_string(), "--wait"], "cleaner");
    let client = Client::open(&fleet.address("cleaner"), "cleaning-6");
    let bag_g = || {
        let (_, view) = client.all("view/robot/cleaner", "").into_iter().next()?;
        view["readings"]["bag_g"].as_f64()
    };
    until("the bag contains more than 5 g", LONG, || bag_g().filter(|bag| *bag > 5.0));
    assert_the_fleet_command_shows_the_reading(&mut fleet);
    until("the bag was emptied", LONG, || bag_g().filter(|bag| *bag <= 5.0));
    let ended = waiting.end(LONG).expect(0);
    assert!(ended.stdout.contains("clean-rooms-1 completed\n"), "{}", ended.stdout);
    let work: Vec<String> = goals(&fleet)
        .iter()
        .filter_map(|goal| goal["action"].as_str())
        .filter(|action| *action != "navigate_to_pose")
        .map(str::to_owned)
        .collect();
    assert_eq!(work, ["vacuum", "vacuum", "empty_bag", "vacuum"]);
    let log = fleet.node("cleaner").stderr();
    assert!(!log.contains("readings: values."), "{log}");
    drop(client);
    fleet.stop();
}

/// Asserts that `consort fleet` shows the reading of the robot, as text and as JSON.
fn assert_the_fleet_command_shows_the_reading(fleet: &mut Fleet) {
    let shown = fleet.run(&["fleet", "--json"], "cleaner").expect(0).json();
    let readings = shown["readings"].as_object().expect("an object");
    assert_eq!(readings.keys().collect::<Vec<_>>(), ["cleaner"], "{shown}");
    assert!(readings["cleaner"]["bag_g"].is_number(), "{shown}");
    let text = fleet.run(&["fleet"], "cleaner").expect(0).stdout;
    let lines: Vec<&str> = text.lines().collect();
    let robot = lines.last().expect("a row for the robot");
    let reading = robot.rsplit("  ").next().and_then(|cell| cell.trim().strip_prefix("bag_g "));
    assert!(lines[1].ends_with("READINGS") && reading.is_some_and(|grams| grams.parse::<f64>().is_ok()), "{text}");
}

/// Ends the process on drop.
struct Server(Child);

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts a program that listens on a Unix socket and runs the driver for each connection.
fn serve_driver(fleet: &Fleet) -> Server {
    let listen = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/listen.py");
    let (socket, driver) = (fleet.path("driver.sock"), fleet.path("driver.py"));
    let child = Command::new("python3").arg(listen).arg(socket).arg("python3").arg(driver).arg("20").spawn();
    Server(child.expect("there is a program `python3`"))
}

#[test]
fn a_driver_on_a_socket_is_connected_to_again_and_its_goal_is_resumed() {
    let mut robot: Table = example("robot.toml").parse().expect("TOML");
    robot["fleet"].as_table_mut().expect("a table").insert("name".to_owned(), "cleaning-5".into());
    robot.insert("driver".to_owned(), "unix:driver.sock".into());
    let mut fleet = Fleet::new(robot["fleet"].as_table().expect("a table"));
    write_files(&fleet);
    fleet.start("robot", robot, &[]);
    // The node is there before its driver.
    until("the node logs that there is no driver", LONG, || {
        fleet.node("cleaner").stderr().contains("no connection to unix:").then_some(())
    });
    let server = serve_driver(&fleet);
    let waiting = submit(&mut fleet);
    let client = Client::open(&fleet.address("cleaner"), "cleaning-5");
    until("the robot is in the first room", LONG, || (place(&client)? == "IC Room 6").then_some(()));
    kill(&driver_process(&fleet).expect("the driver runs"));
    let ended = waiting.end(LONG).expect(0);
    assert!(ended.stdout.contains("clean-rooms-1 completed\n  dust_g: "), "{}", ended.stdout);
    assert_one_goal_was_resumed(&fleet);
    let log = fleet.node("cleaner").stderr();
    assert!(log.contains("it closed the connection"), "{log}");
    drop((client, server));
    // The driver of the last connection ends with it.
    fleet.stop();
}

/// The node signs the messages of its driver server with its own certificate.
#[test]
fn a_driver_serves_a_robot_of_a_fleet_with_certificates() {
    let mut closed = Closed::new();
    closed.cert(&["node", "cleaner", "--roles", "robot,voter,host", "--serves", "cleaner"]);
    let mut robot: Table = example("robot.toml").parse().expect("TOML");
    robot["fleet"].as_table_mut().expect("a table").insert("name".to_owned(), "ward".into());
    robot.insert("bus".to_owned(), Table::new().into());
    write_files(&closed.fleet);
    closed.start("robot", faster(robot), &[]);
    let mission = closed.fleet.path("mission.yaml");
    fs::write(&mission, example("mission.yaml")).expect("the folder can be written to");
    let operator = closed.of("operate").display().to_string();
    let submit = ["submit", &mission.display().to_string(), "--wait", "--certs", &operator];
    let ended = closed.fleet.begin(&submit, "cleaner").end(LONG).expect(0);
    assert!(ended.stdout.contains("clean-rooms-1 completed\n  dust_g: "), "{}", ended.stdout);
    assert_eq!(closed.refused("cleaner"), "");
    closed.fleet.stop();
}

#[test]
fn a_driver_ends_with_its_killed_node() {
    let mut fleet = start("cleaning-2");
    until("the driver runs", LONG, || driver_process(&fleet));
    fleet.address("cleaner");
    fleet.kill("cleaner");
    until("the driver has ended", LONG, || driver_process(&fleet).is_none().then_some(()));
}

#[test]
fn a_driver_that_offers_an_undeclared_action_is_not_used() {
    let mut fleet = start("cleaning-3");
    fleet.kill("cleaner");
    let wrong = example("driver.py").replace(r#""vacuum": VACUUM"#, r#""vacum": VACUUM"#);
    fs::write(fleet.path("driver.py"), wrong).expect("the folder can be written to");
    fleet.start_again("cleaner");
    until("the node logs the wrong hello", LONG, || {
        let log = fleet.node("cleaner").stderr();
        log.contains("hello: actions.vacum: no domain declares this action; allowed: ").then_some(())
    });
    let client = Client::open(&fleet.address("cleaner"), "cleaning-3");
    until("the robot is out of service", LONG, || {
        let (_, view) = client.all("view/fleet", "").into_iter().next()?;
        view.to_string().contains("its driver does not reply").then_some(())
    });
}

/// The domain file of the robot has another content than the file of the coordinator. The health of the fleet says so
/// before any mission is submitted.
#[test]
fn a_robot_with_another_domain_refuses_with_the_reason() {
    let mut robot: Table = example("robot.toml").parse().expect("TOML");
    let settings = robot["fleet"].as_table_mut().expect("a table");
    settings.insert("name".to_owned(), "cleaning-4".into());
    let mut fleet = Fleet::new(settings);
    write_files(&fleet);
    let changed = example("domain.yaml").replace("maximum: 10", "maximum: 12");
    fs::write(fleet.path("changed.yaml"), changed).expect("the folder can be written to");
    let own = settings.clone();
    settings.insert("domains".to_owned(), vec!["changed.yaml"].into());
    // The robot's node does not vote, so the station is the coordinator.
    robot.insert("may_vote".to_owned(), false.into());
    let station = [("name".to_owned(), "office".into()), ("fleet".to_owned(), own.into())].into_iter().collect();
    fleet.start("station", station, &[]);
    fleet.start("robot", faster(robot), &["office"]);
    let client = Client::open(&fleet.address("office"), "cleaning-4");
    until("the robot is at its place", LONG, || place(&client));
    until("the health names the domain", LONG, || {
        let (_, view) = client.all("view/health", "").into_iter().next()?;
        view.to_string().contains("the files of the domain cleaning differ: ").then_some(())
    });
    drop(client);
    let mission = fleet.path("mission.yaml");
    fs::write(&mission, example("mission.yaml")).expect("the folder can be written to");
    fleet.run(&["submit", &mission.display().to_string()], "office").expect(0);
    until("the refusal", LONG, || {
        let explained = fleet.run(&["explain", "clean-rooms-1"], "office").expect(0).stdout;
        explained.contains("the mission has clean_room of the domain cleaning ").then(|| {
            assert!(explained.contains("their files differ"), "{explained}");
        })
    });
    fleet.stop();
}
