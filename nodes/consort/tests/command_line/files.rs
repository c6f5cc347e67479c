use super::support::{command, crate_file, run, test_file};

#[test]
fn the_shipped_examples_missions_and_maps_are_valid() {
    let files = [
        ("../../examples/fleet.toml", "a fleet: ward"),
        ("../../examples/robot.toml", "a robot: ada"),
        ("../../examples/arm.toml", "a robot: lab-arm"),
        ("../../examples/station.toml", "a station: station-1"),
        ("../../examples/world.toml", "a world: 2 robots, 1 person"),
        ("../../examples/disinfect-rooms.yaml", "a mission: disinfect-rooms, 8 roles, 16 steps"),
        ("../../examples/workers.toml", "workers: 4 of them"),
        ("../../examples/follow-path.yaml", "a mission: follow-path, 1 role, 2 steps"),
        ("../../examples/calibration.toml", "a calibration: 0 skills, 0 legs"),
        ("tests/data/ward_map.json", "a map: 5 places, 4 ways"),
        ("tests/data/ward_scenarios.json", "scenarios: 1 of them"),
        ("../../skills/missions/lab-samples.yaml", "a mission: lab-samples, 3 roles, 19 steps"),
        ("../../sim_bridge/world/maps/hospital.yaml", "a map: 32 places, 31 ways"),
    ];
    let paths: Vec<String> = files.iter().map(|(path, _)| crate_file(path)).collect();
    let mut args = vec!["check"];
    args.extend(paths.iter().map(String::as_str));
    let ran = run(&args);
    let expected: String = paths.iter().zip(&files).map(|(path, (_, what))| format!("{path}: ok, {what}\n")).collect();
    assert_eq!((ran.code, ran.out), (Some(0), expected), "{}", ran.err);
}

#[test]
fn check_describes_the_relays_of_a_client_and_rejects_a_client_that_listens() {
    let fleet = test_file("large_fleet.toml", "name = \"ward\"\nplanned_nodes = 100\n");
    let check = |name: &str, bus: &str| {
        let text = format!(
            "name = \"a\"\nplace = \"Dock\"\nskills = [\"pick_up\"]\nfleet = {fleet:?}\n[bus]\n\
             connect = [\"tcp/station-1:7447\", \"tcp/station-2:7447\"]\n{bus}\n"
        );
        let ran = run(&["check", &test_file(name, &text)]);
        (ran.code, ran.out)
    };
    let (code, out) = check("client.toml", "");
    assert_eq!(code, Some(0), "{out}");
    assert!(
        out.contains(": ok, a robot: a, client of 2 relays, since the fleet has 30 planned_nodes or more"),
        "{out}"
    );
    let listen = "listen = [\"tcp/127.0.0.1:7447\"]";
    let (code, out) = check("client_that_listens.toml", listen);
    assert_eq!(code, Some(1), "{out}");
    assert!(out.contains("client_that_listens.toml: bus.listen: this node does not relay"), "{out}");
    let (code, out) = check("relay.toml", &format!("{listen}\nrelay = \"yes\""));
    assert_eq!(code, Some(0), "{out}");
    assert!(out.ends_with(": ok, a robot: a\n"), "{out}");
}

#[test]
fn check_reports_every_error_with_file_and_position() {
    let fleet = test_file("wrong_fleet.toml", "name = \"ward\"\nmapp = \"hospital\"\n[lease]\nlase_ms = 1\n");
    let robot = test_file("wrong_robot.toml", "name = \"a\"\nplace = \"Kitchen\"\nskills = [\"pick_up\"]\n");
    let map = test_file(
        "wrong_map.yaml",
        "name: m\nplaces:\n  - { name: A, kind: room, x_m: 0, y_m: 0 }\nlanes:\n  - { between: [A, B] }\n",
    );
    let mission = test_file(
        "wrong_mission.yaml",
        "mission: m\nroles:\n  r1: { kind: managed }\nroot: { task: go, type: navigate, roles: [r2] }\n",
    );
    let ran = run(&["check", &fleet, &robot, &map, &mission]);
    assert_eq!(ran.code, Some(1), "{}", ran.out);
    for expected in [
        format!("{fleet}:2:1: unknown key `mapp` in a fleet file; allowed: name, map, "),
        format!("{fleet}:4:1: unknown key `lase_ms` in a fleet file; allowed: lease_ms, grace_ms"),
        format!("{robot}: robot a: place: \"Kitchen\" is not on the fleet's map; allowed: "),
        format!("{map}: lane between \"A\" and \"B\": there is no place \"B\""),
        format!("{mission}: root"),
        "unknown task type `navigate`".to_owned(),
    ] {
        assert!(ran.out.contains(&expected), "{expected:?} is missing in\n{}", ran.out);
    }
    assert!(ran.err.contains("problems in 4 of 4 files"), "{}", ran.err);
}

#[test]
fn an_alarm_with_an_unknown_place_or_key_is_reported_with_what_is_allowed() {
    let of = |name: &str, text: &str| {
        let file = test_file(name, &format!("name = \"ward\"\n[alarms.fire]\n{text}"));
        let ran = run(&["check", &file]);
        assert_eq!(ran.code, Some(1), "{}{}", ran.out, ran.err);
        ran.out
    };
    let unknown_key = of("alarm_key.toml", "robots = \"stop\"\nplace = [\"Dock\"]\n");
    assert!(unknown_key.contains(":4:1: unknown key `place` in a fleet file; allowed: robots, places, closes"));
    let unknown_place = of("alarm_place.toml", "robots = \"assemble\"\nplaces = [\"Dok\"]\ncloses = [\"Kitchen\"]\n");
    for expected in
        ["alarms.fire: places: there is no place Dok; allowed: ", "alarms.fire: closes: there is no place Kitchen; "]
    {
        assert!(unknown_place.contains(expected), "{expected:?} is missing in\n{unknown_place}");
    }
    let response = of("alarm_response.toml", "robots = \"flee\"\n");
    assert!(response.contains("`stop`") && response.contains("`assemble`"), "{response}");
}

#[test]
fn invalid_policies_are_reported_with_what_is_allowed() {
    let ensemble = |name: &str, condition: &str| {
        format!("[[ensemble]]\nname = {name:?}\nmembership = [{condition:?}]\nstale_after_ms = 1000\n")
    };
    let icu = ensemble("icu", "member.attributes.section == 'icu'");
    let valid = test_file("two_ensembles.toml", &(icu.clone() + &ensemble("er", "member.attributes.floor > 2")));
    let twice = test_file("ensemble_twice.toml", &(icu.clone() + &icu));
    let wrong = test_file("ensemble_field.toml", &ensemble("icu", "member.attributes.floor > 2 && member.chrge > 0.5"));
    let exchanged = icu.clone() + "exchange = [\"attributes.section\", \"readings.temprature_c\"]\n";
    let exchanged = test_file("unknown_reading.toml", &exchanged);
    let private = ensemble("er", "member.robot") + "exchange = [\"attributes.section\"]\n";
    let private = test_file("private_attribute.toml", &(icu.clone() + &private));
    let text = "name = \"a\"\nplace = \"Dock\"\nskills = [\"pick_up\"]\nattributes = { \"floor-3\" = true }\n";
    let robot = test_file("wrong_attribute.toml", text);
    let mission = "mission: m\nroles:\n  r1: { kind: managed, eligible: 'robot.speeed > 0.5' }\n\
        root: { task: go, type: navigation, roles: [r1], parameters: { to: Dock } }\n";
    let mission = test_file("wrong_condition.yaml", mission);
    let ran = run(&["check", &valid, &twice, &wrong, &exchanged, &private, &robot, &mission]);
    assert_eq!(ran.code, Some(1), "{}", ran.out);
    for expected in [
        format!("{valid}: ok, a fleet"),
        format!("{twice}: ensemble icu: is declared twice"),
        format!(
            "{private}: ensemble icu: condition `member.attributes.section == 'icu'`: every node evaluates it, so \
             `attributes.section` in the `exchange` of ensemble er cannot be private to members; "
        ),
        format!("{exchanged}: ensemble icu: exchange: no domain declares the reading `temprature_c`; "),
        format!(
            "{wrong}: ensemble icu: condition `member.attributes.floor > 2 && member.chrge > 0.5`: `member` has no field `chrge`; allowed: "
        ),
        format!(
            "{robot}:4:14: the attribute `floor-3` has an invalid name; allowed are 1 to 64 letters, digits and `_`"
        ),
        format!("{mission}: roles/r1/eligible: `robot.speeed > 0.5`: `robot` has no field `speeed`; allowed: "),
    ] {
        assert!(ran.out.contains(&expected), "{expected:?} is missing in\n{}", ran.out);
    }
}

#[test]
fn invalid_zones_are_reported_with_what_is_allowed() {
    let zone = |name: &str, text: &str| test_file(name, &format!("[zones]\n{text}\n"));
    let valid = zone("zone.toml", "icu = [\"IC Room 5\", \"IC Room 6\"]\n\"Ward 1\" = [\"Dock\"]");
    let unknown = zone("zone_unknown.toml", "icu = [\"IC Rom 5\"]");
    let place = zone("zone_place.toml", "Dock = [\"IC Room 5\"]");
    let empty = zone("zone_empty.toml", "icu = []");
    let ran = run(&["check", &valid, &unknown, &place, &empty]);
    assert_eq!(ran.code, Some(1), "{}", ran.out);
    for expected in [
        format!("{valid}: ok, a fleet"),
        format!("{unknown}: zones.icu: \"IC Rom 5\" is not on the fleet's map; "),
        "did you mean `IC Room 5`?".to_owned(),
        format!("{place}: zones.Dock: is a place of the fleet's map; give the zone a name of its own"),
        format!("{empty}: zones.icu: has no places; name at least one"),
    ] {
        assert!(ran.out.contains(&expected), "{expected:?} is missing in\n{}", ran.out);
    }
}

#[test]
fn invalid_chargers_are_reported_with_what_is_allowed() {
    let charger = "[[charging.charger]]\nplace = ";
    let valid = test_file("charger.toml", &format!("{charger}\"Dock\"\npower_w = 200.0\n"));
    let place = test_file("charger_place.toml", &format!("{charger}\"Dok\"\n"));
    let power = test_file("charger_power.toml", &format!("{charger}\"Dock\"\npower_w = 0.0\n"));
    let none = test_file("no_charger.toml", "[charging]\nbelow = 0.2\n");
    let order = test_file("charging_order.toml", &format!("[charging]\nbelow = 0.95\n{charger}\"Dock\"\n"));
    let ran = run(&["check", &valid, &place, &power, &none, &order]);
    assert_eq!(ran.code, Some(1), "{}", ran.out);
    for expected in [
        format!("{valid}: ok, a fleet"),
        format!("{place}: charging.charger: place: \"Dok\" is not on the fleet's map; "),
        format!("{power}:3:"),
        "0 is not a power: allowed is a finite number of watts above 0".to_owned(),
        format!("{none}: charging: the fleet has no charger; "),
        format!("{order}: charging.below is 0.95, allowed is less than charging.until, 0.9"),
    ] {
        assert!(ran.out.contains(&expected), "{expected:?} is missing in\n{}", ran.out);
    }
}

#[test]
fn a_node_with_an_unknown_key_does_not_start() {
    let file = test_file("unknown_key.toml", "name = \"s\"\nstationery = true\n");
    let ran = run(&["station", "--config", &file]);
    assert_eq!(ran.code, Some(2));
    let expected =
        format!("consort: {file}:2:1: unknown key `stationery` in a station file; allowed: name, stationary, ");
    assert!(ran.err.starts_with(&expected), "{}", ran.err);
    assert!(ran.err.contains("did you mean `stationary`?"), "{}", ran.err);
}

#[test]
fn the_output_of_print_config_reads_back_unchanged() {
    for (command, file) in [("robot", "robot.toml"), ("station", "station.toml"), ("world", "world.toml")] {
        let first = run(&[command, "--config", &crate_file(&format!("../../examples/{file}")), "--print-config"]);
        assert_eq!(first.code, Some(0), "{}", first.err);
        let copy = test_file(&format!("printed_{file}"), &first.out);
        let second = run(&[command, "--config", &copy, "--print-config"]);
        assert_eq!((second.code, second.out), (Some(0), first.out), "{}", second.err);
    }
}

#[test]
fn flags_override_variables_and_variables_override_files() {
    let file = crate_file("../../examples/robot.toml");
    let args = ["robot", "--config", &file, "--print-config", "--lease-ms", "7000"];
    let mut command = command(&args);
    command.env("CONSORT_LEASE_MS", "9000").env("CONSORT_SPEED_MPS", "0.25").env("CONSORT_CONNECT", "tcp/a:1,tcp/b:2");
    let output = command.output().expect("the binary starts");
    let printed: toml::Table = String::from_utf8_lossy(&output.stdout).parse().expect("TOML");
    let at =
        |path: &[&str]| path.iter().try_fold(toml::Value::Table(printed.clone()), |value, key| value.get(key).cloned());
    assert_eq!(at(&["fleet", "lease", "lease_ms"]), Some(7000.into()));
    assert_eq!(at(&["fleet", "lease", "grace_ms"]), Some(2000.into()));
    assert_eq!(at(&["speed_mps"]), Some(0.25.into()));
    assert_eq!(at(&["battery"]), Some(0.9.into()));
    assert_eq!(at(&["bus", "connect"]), Some(vec!["tcp/a:1", "tcp/b:2"].into()));
}

#[test]
fn a_lease_that_lets_two_robots_act_is_rejected() {
    let file = crate_file("../../examples/station.toml");
    let ran = run(&["station", "--config", &file, "--lease-ms", "500", "--grace-ms", "200"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("lease.grace_ms is 200, allowed with lease.lease_ms 500 is 1235 or more"), "{}", ran.err);
    let fleet = test_file("short_lease.toml", "name = \"ward\"\n[lease]\nlease_ms = 4000\ngrace_ms = 1000\n");
    let ran = run(&["check", &fleet]);
    assert_eq!(ran.code, Some(1), "{}", ran.err);
    let text = format!("{}{}", ran.out, ran.err);
    assert!(text.contains("lease.grace_ms is 1000, allowed with lease.lease_ms 4000 is 1306 or more"), "{text}");
}

#[test]
fn a_lease_that_leaves_no_time_for_an_action_is_rejected() {
    test_file("slow_press.yaml", "domain: presses\nactions:\n  press: { cancel: { within_s: 3 } }\n");
    let check = |name: &str, lease_ms: u32| {
        let text = format!("domains = [\"slow_press.yaml\"]\n[lease]\nlease_ms = {lease_ms}\n");
        let ran = run(&["check", &test_file(name, &text)]);
        (ran.code, format!("{}{}", ran.out, ran.err))
    };
    let (code, text) = check("lease_4000.toml", 4000);
    let expected = "actions.press.cancel.within_s is 3, allowed with lease.lease_ms 4000 is 1.5 or less, and it is \
                    allowed with lease.lease_ms 7000 or more";
    assert!(code == Some(1) && text.contains(expected), "{text}");
    let (code, text) = check("lease_7000.toml", 7000);
    assert_eq!(code, Some(0), "{text}");
}

#[test]
fn a_flag_value_is_validated_like_a_file_value() {
    let file = crate_file("../../examples/station.toml");
    let ran = run(&["station", "--config", &file, "--print-config", "--lease-ms", "1"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("lease.lease_ms is 1, allowed is 500 to 3600000"), "{}", ran.err);
}

#[test]
fn a_node_file_is_validated_together_with_the_flags() {
    let text = "name = \"s\"\n[bus]\nlisten = [\"tls/127.0.0.1:0\"]\n";
    let file = test_file("tls_without_certs.toml", text);
    let combined = run(&["station", "--config", &file, "--certs", "certs", "--print-config"]);
    assert_eq!(combined.code, Some(0), "{}", combined.err);
    let alone = run(&["station", "--config", &file, "--print-config"]);
    assert_eq!(alone.code, Some(2));
    let expected = format!("consort: {file}: bus.listen: \"tls/127.0.0.1:0\": the protocol is tls only for a node");
    assert!(alone.err.starts_with(&expected), "{}", alone.err);
}

/// Returns the allowed keys of a table in this kind of file, from the error message about an
/// unknown key.
fn allowed_keys(kind: &str, table: &str) -> Vec<String> {
    let file = test_file(&format!("keys_wanted_of_{kind}.toml"), &format!("name = \"ward\"\n{table}\nnot_a_key = 1\n"));
    let ran = run(&["check", "--kind", kind, &file]);
    let (_, list) = ran.out.split_once("; allowed: ").unwrap_or_else(|| panic!("{table}: {}{}", ran.out, ran.err));
    let list = list.split([';', '\n']).next().unwrap_or_default();
    list.split(", ").map(str::to_owned).collect()
}

/// Returns the assignment to a key that a line contains behind a `#`.
fn omitted_key(line: &str) -> Option<&str> {
    let assignment = line.strip_prefix("# ")?;
    let (key, _) = assignment.split_once(" = ")?;
    key.chars().all(|letter| letter.is_ascii_lowercase() || letter == '_').then_some(assignment)
}

#[test]
fn the_example_fleet_file_contains_every_key() {
    let text = std::fs::read_to_string(crate_file("../../examples/fleet.toml")).expect("an example");
    // Omitted keys are in the example behind a `#`.
    let lines: Vec<&str> = text.lines().map(|line| omitted_key(line).unwrap_or(line)).collect();
    let example: toml::Table = lines.join("\n").parse().expect("TOML");
    let part = |name: &str| match &example[name] {
        toml::Value::Array(list) => list[0].as_table().expect("a table").clone(),
        value => value.as_table().expect("a table").clone(),
    };
    let mut missing = vec![];
    for (heading, table) in [
        ("", example.clone()),
        ("[limits]", part("limits")),
        ("[lease]", part("lease")),
        ("[auction]", part("auction")),
        ("[charging]", part("charging")),
        ("[alarms.fire]", part("alarms")["fire"].as_table().expect("a table").clone()),
        ("[[ensemble]]", part("ensemble")),
    ] {
        let keys = allowed_keys("fleet", heading);
        assert!(!keys.is_empty(), "{heading}");
        missing.extend(keys.into_iter().filter(|key| !table.contains_key(key)).map(|key| format!("{heading} {key}")));
    }
    assert_eq!(missing, [""; 0]);
}

#[test]
fn the_example_node_files_mention_every_common_key() {
    for kind in ["robot", "station", "world"] {
        let text = std::fs::read_to_string(crate_file(&format!("../../examples/{kind}.toml"))).expect("an example");
        // Omitted keys are in the example behind a `#`.
        let lines: Vec<&str> = text.lines().map(|line| line.trim_start_matches("# ")).collect();
        let names = |key: &str| {
            let forms = [format!("{key} = "), format!("[{key}]"), format!("[[{key}]]")];
            lines.iter().any(|line| forms.iter().any(|form| line.starts_with(form)))
        };
        for table in ["", "[bus]", "[telemetry]"] {
            let keys = allowed_keys(kind, table);
            assert!(keys.len() > 1, "{kind} {table}: {keys:?}");
            for key in keys {
                assert!(names(&key), "{kind}.toml does not mention {table} {key}");
            }
        }
    }
}

#[test]
fn telemetry_is_set_by_files_variables_and_flags() {
    let telemetry =
        "log = \"warn\"\nlog_format = \"json\"\nmetrics = \"127.0.0.1:9464\"\notlp = \"http://127.0.0.1:4318\"\n";
    let file = test_file("telemetry.toml", &format!("name = \"s\"\n[telemetry]\n{telemetry}"));
    let printed = |args: &[&str], variables: &[(&str, &str)]| {
        let mut command = command(&[&["station", "--config", &file, "--print-config"], args].concat());
        let output = command.envs(variables.iter().copied()).output().expect("the binary starts");
        let printed: toml::Table = String::from_utf8_lossy(&output.stdout).parse().expect("TOML");
        printed["telemetry"].as_table().expect("a table").clone()
    };
    assert_eq!(printed(&[], &[]), telemetry.parse::<toml::Table>().expect("TOML"));
    let variables = [("CONSORT_LOG", "debug"), ("CONSORT_METRICS", "127.0.0.1:1"), ("CONSORT_LOG_FORMAT", "human")];
    let by_variables = printed(&["--metrics", "127.0.0.1:2"], &variables);
    let expected =
        "log = \"debug\"\nlog_format = \"human\"\nmetrics = \"127.0.0.1:2\"\notlp = \"http://127.0.0.1:4318\"\n";
    assert_eq!(by_variables, expected.parse::<toml::Table>().expect("TOML"));
    // The common Rust variable also takes precedence over the file.
    assert_eq!(printed(&[], &[("RUST_LOG", "error")])["log"], "error".into());

    let wrong = test_file("telemetry_wrong.toml", "name = \"s\"\n[telemetry]\notlp = \"127.0.0.1:4318\"\n");
    let ran = run(&["check", "--kind", "station", &wrong]);
    assert_eq!(ran.code, Some(1), "{}", ran.out);
    assert!(ran.out.contains("telemetry.otlp: \"127.0.0.1:4318\" does not begin with http://"), "{}", ran.out);
    let wrong = test_file("telemetry_format.toml", "name = \"s\"\n[telemetry]\nlog_format = \"xml\"\n");
    let ran = run(&["check", "--kind", "station", &wrong]);
    assert!(ran.out.contains(&format!("{wrong}:3:")) && ran.out.contains("`human`"), "{}", ran.out);
}
