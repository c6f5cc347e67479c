use super::published::reference;
use super::support::{CommandOutput, crate_file, run, test_file};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

fn lines(out: &str) -> Vec<Value> {
    out.lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect()
}

fn number(value: &Value, key: &str) -> Option<f64> {
    value.get(key).and_then(Value::as_f64)
}

#[test]
fn bids_match_a_small_ward_computed_by_hand() {
    let (map, scenarios) = (crate_file("tests/data/ward_map.json"), crate_file("tests/data/ward_scenarios.json"));
    let ran = run(&["dry-run", "lab-samples", "--map", &map, "--scenarios", &scenarios, "--json"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    // 7 m from Room 1 to the laboratory, although there is a 9 m lane; 11 steps of 2 s; 0.5 m/s; a
    // discharge of 0.001 per second.
    let expected = concat!(
        r#"{"code":"small","bids":["#,
        r#"{"worker":"near","time_s":36.0,"energy":0.036,"remaining":0.074,"viable":false,"#,
        r#""reason":"7.4 % charge left is not above 8.0 %"},"#,
        r#"{"worker":"far","time_s":42.0,"energy":0.042,"remaining":0.458,"viable":true,"reason":null},"#,
        r#"{"worker":"shy","time_s":null,"energy":null,"remaining":null,"viable":false,"#,
        r#""reason":"lacks approach_person, authenticate_person"},"#,
        r#"{"worker":"lost","time_s":null,"energy":null,"remaining":null,"viable":false,"reason":""#,
    );
    let close = |text: &str| {
        let mut value: Value = serde_json::from_str(text).expect("JSON");
        for bid in value["bids"].as_array_mut().expect("bids") {
            for key in ["time_s", "energy", "remaining"] {
                if let Some(exact) = number(bid, key) {
                    bid[key] = Value::from((exact * 1e9).round() / 1e9);
                }
            }
        }
        value.to_string()
    };
    let ours = close(ran.out.trim());
    let why = lines(&ran.out)[0]["bids"][3]["reason"].as_str().expect("a reason").to_owned();
    assert_eq!(ours, close(&format!("{expected}{why}\"}}],\"selected\":\"far\"}}")));
    assert!(why.contains("navto_room") && why.contains("Shed"), "{why}");
}

#[test]
fn every_role_is_auctioned_among_the_workers_of_a_file() {
    let workers = crate_file("../../examples/workers.toml");
    let args = ["dry-run", "lab-samples", "--workers", &workers, "--set", "room=IC Room 6"];
    let ran = run(&args);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    for expected in [
        "lab-samples, room = IC Room 6",
        "    ada      140.3 s  uses 5.6 %  leaves 84.4 %  chosen",
        "not viable: 3.2 % charge left is not above 8.0 %",
        "refuses: lacks approach_person, authenticate_person",
        "  assignment: lab_arm = lab-arm, r1 = ada (the viable bids of different robots that are fastest together)",
    ] {
        assert!(ran.out.contains(expected), "{expected:?} is missing in\n{}", ran.out);
    }
    let ran = run(&[&args[..], &["--json"]].concat());
    let answer = &lines(&ran.out)[0];
    assert_eq!(answer["selected"], serde_json::json!({ "lab_arm": "lab-arm", "r1": "ada" }));
    let parts = answer["roles"][1]["bids"][0]["parts"].as_array().expect("parts");
    let sum: f64 = parts.iter().filter_map(|part| number(part, "time")).sum();
    assert_eq!((parts.len(), (sum * 10.0).round()), (13, 1403.0));
}

#[test]
fn a_busy_worker_is_promised_a_role_with_its_planned_start() {
    let workers = std::fs::read_to_string(crate_file("../../examples/workers.toml")).expect("the example");
    let dry_run = |name: &str, busy_s: u32, more: &[&str]| {
        // The last worker is the arm.
        let workers = test_file(name, &format!("{workers}busy_s = {busy_s}\n"));
        run(&[&["dry-run", "lab-samples", "--workers", &workers, "--set", "room=IC Room 6"], more].concat())
    };
    let ran = dry_run("busy_json.toml", 100, &["--json"]);
    let answer = &lines(&ran.out)[0];
    // The arm is free after 100 s, and its role begins when the carrier has opened its drawer; messages count as immediate.
    let bids = answer["roles"][1]["bids"].as_array().expect("bids");
    let parts = bids.iter().find(|bid| bid["worker"] == "ada").expect("its bid")["parts"].as_array().expect("parts");
    let before = parts.iter().take_while(|part| part["label"] != "done:open_drawer_lab:r1:lab_arm");
    let tasks = before.filter(|part| !matches!(part["skill"].as_str(), Some("send_message" | "wait_message")));
    let opened_s: f64 = tasks.filter_map(|part| number(part, "time")).sum();
    assert!(opened_s > 130.0 && opened_s < 140.0, "{parts:?}");
    let start_s = number(&answer["promised"], "lab_arm").expect("a promise");
    assert!((start_s - opened_s).abs() < 1e-6, "{start_s} s, and the drawer is open after {opened_s} s");
    let ran = dry_run("busy.toml", 100, &[]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let why = format!("  lab_arm: lab-arm gets the role in about {start_s:.0} s with ");
    assert!(ran.out.contains(&why), "{why:?} is missing in\n{}", ran.out);
    assert_eq!(answer["selected"], serde_json::json!({ "lab_arm": "lab-arm", "r1": "ada" }));
    let ran = dry_run("too_busy.toml", 500, &[]);
    assert_eq!(ran.code, Some(1), "{}", ran.out);
    assert!(ran.err.contains("the mission would stay pending: no viable bid for lab_arm"), "{}", ran.err);
}

#[test]
fn a_mission_without_viable_bids_fails_with_the_reason() {
    let workers = test_file("arm_only.json", r#"[{ "name": "arm", "place": "Laboratory", "skills": ["pick_up"] }]"#);
    let ran = run(&["dry-run", "lab-samples", "--workers", &workers]);
    assert_eq!(ran.code, Some(1));
    assert!(ran.err.contains("the mission would stay pending: no viable bid for r1"), "{}", ran.err);
}

#[test]
fn a_worker_without_the_attributes_of_a_role_is_not_eligible() {
    let worker = |name: &str, attributes: &str| {
        format!(
            "[[worker]]\nname = {name:?}\nplace = \"Laboratory\"\nskills = [\"pick_up\"]\nattributes = {attributes}\n"
        )
    };
    let workers = ["{ section = \"icu\" }", "{ section = \"er\", floor = 3 }", "{}"];
    let workers = ["ada", "bob", "cyd"].iter().zip(workers).map(|(name, attributes)| worker(name, attributes));
    let workers = test_file("sections.toml", &workers.collect::<String>());
    let mission = "mission: m\nparameters: { section: { kind: text } }\n\
        roles: { r1: { kind: managed, eligible: 'robot.attributes.section == ${section}' } }\n\
        root: { task: pick, type: pick_up, roles: [r1], parameters: { from_role: r1 } }\n";
    let mission = test_file("section.yaml", mission);
    let dry_run = |section: &str| run(&["dry-run", &mission, "--workers", &workers, "--set", section]);
    let ran = dry_run("section=er");
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    for expected in [
        "refuses: not eligible: `robot.attributes.section == \"er\"` is false",
        "refuses: not eligible: `robot.attributes.section == \"er\"`: there is no attribute `section`",
        "r1 = bob",
    ] {
        assert!(ran.out.contains(expected), "{expected:?} is missing in\n{}", ran.out);
    }
    let ran = dry_run("section=radiology");
    assert_eq!(ran.code, Some(1), "{}", ran.out);
}

const ENSEMBLES: &str = "\
    [[ensemble]]\nname = \"icu\"\nmembership = [\"member.attributes.section == 'icu'\"]\n\
    coordinator = [\"coordinator.mains_powered\"]\nstale_after_ms = 1000\n\
    [[ensemble]]\nname = \"charged\"\nmembership = [\"member.robot\", \"member.battery > 0.3\"]\nstale_after_ms = 1000\n";

/// Dry-runs a mission for these ensembles among a slow member of `icu` and `charged`, a member of `charged`, and
/// a robot in none.
fn ran_with_ensembles(name: &str, ensembles: &str, fleet: Option<&str>) -> CommandOutput {
    let worker = |name: &str, rest: &str| {
        format!("[[worker]]\nname = {name:?}\nplace = \"Laboratory\"\nskills = [\"navigation\"]\n{rest}\n")
    };
    let workers = [
        worker("ada", "speed_mps = 0.3\nattributes = { section = \"icu\" }"),
        worker("bob", "speed_mps = 0.6\nattributes = { section = \"er\" }"),
        worker("cyd", "speed_mps = 0.9\nbattery = 0.2"),
    ];
    let workers = test_file(&format!("{name}_workers.toml"), &workers.concat());
    let mission = format!(
        "mission: m\nensembles: {ensembles}\nroles: {{ r1: {{ kind: managed }} }}\n\
        root: {{ task: go, type: navigation, roles: [r1], parameters: {{ to: Dock }} }}\n"
    );
    let mission = test_file(&format!("{name}_mission.yaml"), &mission);
    let fleet = fleet.map(|fleet| test_file(&format!("{name}_fleet.toml"), fleet));
    let fleet: Vec<&str> = fleet.iter().flat_map(|fleet| ["--fleet", fleet.as_str()]).collect();
    run(&[&["dry-run", &mission, "--workers", &workers], &fleet[..]].concat())
}

#[test]
fn a_worker_outside_the_ensembles_of_the_fleet_refuses_with_the_condition() {
    let ran = ran_with_ensembles("icu", "[icu]", Some(ENSEMBLES));
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    for expected in [
        "refuses: not a member of icu: `member.attributes.section == 'icu'` is false for bob",
        "refuses: not a member of icu: `member.attributes.section == 'icu'` for cyd: there is no attribute `section`",
        "r1 = ada",
    ] {
        assert!(ran.out.contains(expected), "{expected:?} is missing in\n{}", ran.out);
    }
    let ran = ran_with_ensembles("all", "[]", Some(ENSEMBLES));
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let why = "charged: `member.battery > 0.3` is false for cyd";
    assert!(ran.out.contains("r1 = bob") && ran.out.contains(why), "{}", ran.out);
    let unknown = ran_with_ensembles("unknown", "[er]", Some(ENSEMBLES));
    assert_eq!(unknown.code, Some(2), "{}", unknown.out);
    assert!(unknown.err.contains("er") && unknown.err.contains("icu"), "{}", unknown.err);
}

#[test]
fn members_of_the_first_ensemble_come_before_faster_robots() {
    let ran = ran_with_ensembles("first", "[icu, charged]", Some(ENSEMBLES));
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert!(ran.out.contains("r1 = ada"), "{}", ran.out);
    let ran = ran_with_ensembles("no_fleet", "[icu, charged]", None);
    assert!(ran.out.contains("r1 = cyd"), "without a fleet file each worker is a member\n{}", ran.out);
}

#[test]
fn a_worker_that_could_not_reach_a_charger_afterwards_refuses() {
    let worker = |name: &str, battery: f64| {
        format!(
            "[[worker]]\nname = {name:?}\nplace = \"Laboratory\"\nskills = [\"navigation\"]\nspeed_mps = 0.5\n\
            discharge_share_per_s = 0.001\nbattery = {battery}\n"
        )
    };
    let workers = test_file("charger_workers.toml", &(worker("ada", 0.2) + &worker("bob", 0.9)));
    let mission = "mission: m\nroles: { r1: { kind: managed } }\n\
        root: { task: go, type: navigation, roles: [r1], parameters: { to: IC Room 6 } }\n";
    let mission = test_file("charger_mission.yaml", mission);
    let fleet = test_file("charger_fleet.toml", "[[charging.charger]]\nplace = \"Dock\"\n");
    let ran = run(&["dry-run", &mission, "--workers", &workers, "--fleet", &fleet]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    // The 39 m to the room take 7.8 %, and the 32 m to the charger 6.4 %.
    let why =
        "refuses: could not reach a charger afterwards: 5.8 % charge left at Dock is not above the reserve of 8.0 %";
    assert!(ran.out.contains(why) && ran.out.contains("r1 = bob"), "{}", ran.out);
    let ran = run(&["dry-run", &mission, "--workers", &workers]);
    assert!(!ran.out.contains("refuses"), "without chargers a robot bids\n{}", ran.out);
}

/// Writes a domain whose task `enter` asks a nurse twice, workers, and a mission: a clerk
/// acknowledges an alert, which is escalated to `other`, and a robot enters, whose first question
/// is escalated to `head`.
fn asking_mission(name: &str, other: &str, head: &str) -> [String; 3] {
    let tree = format!("{name}_enter.xml");
    let domain = format!(
        "domain: doors\ntasks:\n  enter:\n    \
        parameters: {{ patience_s: {{ type: integer }}, head: {{ type: text }} }}\n    \
        tree: {tree}\n    estimate: {{ time_s: \"5.0\" }}\n"
    );
    test_file(
        &tree,
        r#"<root BTCPP_format="4" main_tree_to_execute="enter">
        <BehaviorTree ID="enter"><Sequence>
          <SubTree ID="ask" patience_s="{patience_s}" other="{head}"/>
          <AskPerson role="nurse" message="which bed?"/>
        </Sequence></BehaviorTree>
        <BehaviorTree ID="ask">
          <AskPerson role="nurse" message="may I enter?" patience_s="{patience_s}"
                     escalate_to="{other}" escalate_after_s="30"/>
        </BehaviorTree></root>"#,
    );
    let mission = format!(
        "mission: visit\nroles: {{ r1: {{ kind: managed }}, clerk: {{ kind: unmanaged }} }}\nroot:\n  task: all\n  \
        method: sequential\n  tasks:\n    \
        - {{ task: call, type: alert, roles: [clerk], parameters: {{ message: hello, level: info }}, patience_s: 600, \
        escalate: {{ to: {other}, after_s: 300 }} }}\n    \
        - {{ task: see, type: enter, roles: [r1], parameters: {{ patience_s: \"60\", head: {head} }} }}\n"
    );
    let workers = "[[worker]]\nname = \"ada\"\nplace = \"Dock\"\nskills = [\"enter\"]\n";
    let files = [("domain.yaml", domain.as_str()), ("mission.yaml", mission.as_str()), ("workers.toml", workers)];
    files.map(|(file, text)| test_file(&format!("{name}_{file}"), text))
}

#[test]
fn the_requests_to_people_are_shown_with_their_escalation() {
    let [domain, mission, workers] = asking_mission("asking", "head", "head");
    let args = ["dry-run", &mission, "--domain", &domain, "--workers", &workers];
    let ran = run(&args);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    let people = "\n  people\n    call asks clerk, waits 600 s, escalates to head after 300 s\n    \
        see of r1 asks nurse \"may I enter?\", waits 60 s, escalates to head after 30 s\n    \
        see of r1 asks nurse \"which bed?\", waits 3600 s\n  r1\n";
    assert!(ran.out.contains(people), "{}", ran.out);
    let ran = run(&[&args[..], &["--json"]].concat());
    let asked = &lines(&ran.out)[0]["people"];
    let alert = serde_json::json!({ "role": "clerk", "task": "call", "question": null, "patience_s": 600,
        "escalate_to": "head", "escalate_after_s": 300 });
    assert_eq!(asked[0], alert);
    let question = serde_json::json!({ "role": "nurse", "task": "see",
        "question": { "by": "r1", "message": "may I enter?" }, "patience_s": 60,
        "escalate_to": "head", "escalate_after_s": 30 });
    assert_eq!(asked[1], question);
}

#[test]
fn an_escalation_to_a_robot_or_to_those_already_asked_is_rejected() {
    for (name, other, head, expected) in [
        ("to_robot", "r1", "head", "root/call: escalates to r1, which is a managed role; only people are asked"),
        ("to_asked", "clerk", "head", "root/call: escalates to clerk, which is asked from the beginning"),
        (
            "question_to_robot",
            "head",
            "r1",
            "see: the question \"may I enter?\" of r1 escalates to r1, which is a managed",
        ),
        (
            "question_to_asked",
            "head",
            "nurse",
            "see: the question \"may I enter?\" of r1 escalates to nurse, which is asked",
        ),
    ] {
        let [domain, mission, _] = asking_mission(name, other, head);
        let ran = run(&["check", &mission, "--domain", &domain]);
        assert_eq!(ran.code, Some(1), "{name}: {}{}", ran.out, ran.err);
        assert!(ran.out.contains(expected), "{name}: {}", ran.out);
    }
    let [domain, mission, _] = asking_mission("to_people", "head", "porter");
    let ran = run(&["check", &mission, "--domain", &domain]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
}

fn ours(folder: &std::path::Path) -> BTreeMap<String, Value> {
    let path = |name: &str| folder.join(name).display().to_string();
    let (map, scenarios) = (path("hospital_map.json"), path("scenarios_81.json"));
    let ran = run(&["dry-run", "lab-samples", "--map", &map, "--scenarios", &scenarios, "--json"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    lines(&ran.out).into_iter().map(|line| (line["code"].as_str().expect("a code").to_owned(), line)).collect()
}

#[test]
fn all_published_bids_are_reproduced() {
    let Some(folder) = reference() else { return };
    let ours = ours(&folder);
    let logged = std::fs::read_to_string(folder.join("bids_27.jsonl")).expect("a file that is there");
    let (mut scenarios, mut bids) = (0, 0);
    for theirs in lines(&logged) {
        let code = theirs["code"].as_str().expect("a code");
        let line = &ours[code];
        let by_worker: BTreeMap<&str, &Value> = line["bids"]
            .as_array()
            .expect("bids")
            .iter()
            .map(|bid| (bid["worker"].as_str().expect("a name"), bid))
            .collect();
        let refused = by_worker.iter().filter(|(_, bid)| bid["time_s"].is_null()).map(|(name, _)| *name);
        let incompatible = theirs["incompatible"].as_array().expect("a list");
        let names = incompatible.iter().map(|entry| entry["worker"].as_str().expect("a name"));
        assert_eq!(refused.collect::<BTreeSet<_>>(), names.collect::<BTreeSet<_>>(), "{code}");
        for entry in incompatible {
            let mut missing: Vec<&str> =
                entry["missing_skills"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
            missing.sort_unstable();
            let reason = &by_worker[entry["worker"].as_str().expect("a name")]["reason"];
            assert_eq!(*reason, Value::from(format!("lacks {}", missing.join(", "))), "{code}");
        }
        for bid in theirs["bids"].as_array().expect("a list") {
            let same = by_worker[bid["worker"].as_str().expect("a name")];
            assert_eq!(same["viable"], bid["is_viable"], "{code}: {bid}");
            for (our_key, their_key) in [("time_s", "time"), ("energy", "energy"), ("remaining", "remaining_battery")] {
                // The published log omits the time and energy of bids that are not viable.
                if let Some(published) = number(bid, their_key) {
                    let own = number(same, our_key).expect("a bid");
                    assert!((own - published).abs() <= 1e-9, "{code}: {our_key} {own}, published {published}");
                }
            }
            bids += 1;
        }
        let selected = theirs["selected"].get("worker").unwrap_or(&Value::Null);
        assert_eq!(&line["selected"], selected, "{code}");
        scenarios += 1;
    }
    assert_eq!(scenarios, 27);
    assert!(bids > 100, "{bids} bids");
}

#[test]
fn all_81_selections_agree_with_a_plain_recomputation() {
    let Some(folder) = reference() else { return };
    let ours = ours(&folder);
    let read = |name: &str| -> Value {
        let text = std::fs::read_to_string(folder.join(name)).expect("a file that is there");
        serde_json::from_str(&text).expect("JSON")
    };
    let metres = all_pairs(&read("hospital_map.json"));
    let scenarios = read("scenarios_81.json");
    let scenarios = scenarios.as_array().expect("a list");
    assert_eq!((scenarios.len(), ours.len()), (81, 81));
    let needed = ["navigation", "approach_person", "authenticate_person", "operate_drawer", "approach_robot"];
    for scenario in scenarios {
        let text = |value: &Value, key: &str| value[key].as_str().expect("a text").to_owned();
        let code = text(scenario, "code");
        let room = text(&scenario["nurses"][0], "location");
        let mut best: Option<(f64, String)> = None;
        for robot in scenario["robots"].as_array().expect("a list") {
            let skills: Vec<&str> =
                robot["skills"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
            if !needed.iter().all(|skill| skills.contains(skill)) {
                continue;
            }
            let number = |key: &str| number(robot, key).expect("a number");
            let way =
                metres[&(text(robot, "location"), room.clone())] + metres[&(room.clone(), "Laboratory".to_owned())];
            let time = way / number("avg_speed") + 22.0;
            let left = number("battery_charge") - time * number("battery_discharge_rate");
            if left > 0.08 && best.as_ref().is_none_or(|(fastest, _)| time < *fastest - 1e-6) {
                best = Some((time, text(robot, "name")));
            }
        }
        let selected = best.map_or(Value::Null, |(_, name)| Value::from(name));
        assert_eq!(ours[&code]["selected"], selected, "{code}");
    }
}

/// Computes all shortest distances with the Floyd-Warshall algorithm.
fn all_pairs(map: &Value) -> BTreeMap<(String, String), f64> {
    let text = |value: &Value| value.as_str().expect("a text").to_owned();
    let names: Vec<String> = map["nodes"].as_array().expect("a list").iter().map(|node| text(&node["label"])).collect();
    let mut metres = BTreeMap::new();
    for a in &names {
        for b in &names {
            metres.insert((a.clone(), b.clone()), if a == b { 0.0 } else { f64::INFINITY });
        }
    }
    for edge in map["edges"].as_array().expect("a list") {
        let (a, b, length) = (text(&edge["a"]), text(&edge["b"]), number(edge, "length_m").expect("a length"));
        metres.insert((a.clone(), b.clone()), length);
        metres.insert((b, a), length);
    }
    for via in &names {
        for a in &names {
            for b in &names {
                let detour = metres[&(a.clone(), via.clone())] + metres[&(via.clone(), b.clone())];
                if detour < metres[&(a.clone(), b.clone())] {
                    metres.insert((a.clone(), b.clone()), detour);
                }
            }
        }
    }
    metres
}
