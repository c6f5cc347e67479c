use super::support::run;

const COMMANDS: [&str; 35] = [
    "robot",
    "station",
    "world",
    "submit",
    "missions",
    "cancel",
    "priority",
    "reassign",
    "fleet",
    "explain",
    "keys",
    "check",
    "schema",
    "cert",
    "doctor",
    "driver",
    "completions",
    "man",
    "dry-run",
    "recover",
    "map",
    "record",
    "replay",
    "resolve",
    "requests",
    "answer",
    "hold",
    "release",
    "maintenance",
    "audit",
    "history",
    "close",
    "open",
    "limit",
    "alarm",
];

#[test]
fn the_help_names_every_command_and_the_exit_codes() {
    let help = run(&["--help"]);
    assert_eq!(help.code, Some(0));
    for command in COMMANDS {
        assert!(help.out.contains(&format!("  {command} ")), "{command} is missing in\n{}", help.out);
    }
    assert!(help.out.contains("Exit codes: 0 success; 1"), "{}", help.out);
}

#[test]
fn the_help_of_each_command_teaches_by_examples() {
    for command in COMMANDS {
        let help = run(&[command, "--help"]);
        assert_eq!(help.code, Some(0), "{command}");
        assert!(help.out.contains(&format!("Examples:\n  consort {command}")), "{command}:\n{}", help.out);
    }
}

#[test]
fn wrong_flags_exit_with_code_2() {
    let ran = run(&["dry-run", "lab-samples"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("--workers <FILE>"), "{}", ran.err);
    let ran = run(&["submit", "lab-samples", "--set", "room"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("expected NAME=VALUE"), "{}", ran.err);
    let ran = run(&["robot"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("--config FILE is needed"), "{}", ran.err);
}

#[test]
fn closures_need_places_and_a_lane_two_ends() {
    let cases: [(&[&str], &str); 5] = [
        (&["close"], "PLACE"),
        (&["open"], "PLACE"),
        (&["close", "--lane", "IC Room 6"], "2 values required"),
        (&["close", "IC Room 6", "--for", "2d", "--until", "2026-12-31T18:00:00Z"], "cannot be used with"),
        (&["close", "IC Room 6", "--for", "400d"], "--for is longer than 8784 h"),
    ];
    for (args, expected) in cases {
        let ran = run(args);
        assert_eq!(ran.code, Some(2), "{args:?}: {}", ran.err);
        assert!(ran.err.contains(expected), "{args:?}: {}", ran.err);
    }
}

#[test]
fn a_speed_limit_needs_a_place_and_a_speed() {
    let cases: [(&[&str], &str); 5] = [
        (&["limit", "--speed", "0.3"], "PLACE"),
        (&["limit", "IC Room 6"], "--speed <M_PER_S>"),
        (&["limit", "IC Room 6", "--speed", "0"], "0 is not a speed"),
        (&["limit", "IC Room 6", "--speed", "0.3", "--clear"], "cannot be used with"),
        (&["limit", "IC Room 6", "--clear", "--reason", "dry"], "cannot be used with"),
    ];
    for (args, expected) in cases {
        let ran = run(args);
        assert_eq!(ran.code, Some(2), "{args:?}: {}", ran.err);
        assert!(ran.err.contains(expected), "{args:?}: {}", ran.err);
    }
}

#[test]
fn an_alarm_needs_a_name_unless_it_is_cleared() {
    let cases: [(&[&str], &str); 3] = [
        (&["alarm"], "<NAME>"),
        (&["alarm", "--clear", "--reason", "smoke"], "cannot be used with"),
        (&["alarm", "fire drill"], "cannot name an alarm"),
    ];
    for (args, expected) in cases {
        let ran = run(args);
        assert_eq!(ran.code, Some(2), "{args:?}: {}", ran.err);
        assert!(ran.err.contains(expected), "{args:?}: {}", ran.err);
    }
}

#[test]
fn a_cancelation_needs_missions_or_a_condition() {
    let cases: [(&[&str], &str); 3] = [
        (&["cancel"], "<MISSION"),
        (&["cancel", "rounds-1", "--where", "mission.age_s > 60"], "cannot be used with"),
        (&["cancel", "--where", "mission.prio < 0"], "--where: `mission` has no field `prio`"),
    ];
    for (args, expected) in cases {
        let ran = run(args);
        assert_eq!(ran.code, Some(2), "{args:?}: {}", ran.err);
        assert!(ran.err.contains(expected), "{args:?}: {}", ran.err);
    }
}

#[test]
fn a_priority_must_be_in_range() {
    for (value, allowed) in
        [("101", "allowed are -100 to 100"), ("-101", "allowed are -100 to 100"), ("high", "is not a whole number")]
    {
        let ran = run(&["priority", "rounds-1", value]);
        assert_eq!(ran.code, Some(2), "{value}: {}", ran.err);
        assert!(ran.err.contains(allowed), "{value}: {}", ran.err);
    }
}

#[test]
fn a_role_is_reassigned_or_pinned() {
    let cases: [(&[&str], &str); 3] = [
        (&["reassign", "rounds-1"], "<ROLE>"),
        (&["reassign", "rounds-1", "r1", "--to", "amber", "--pin", "amber"], "cannot be used with"),
        (&["reassign", "rounds-1", "r1", "--repeat", "--unpin"], "cannot be used with"),
    ];
    for (args, expected) in cases {
        let ran = run(args);
        assert_eq!(ran.code, Some(2), "{args:?}: {}", ran.err);
        assert!(ran.err.contains(expected), "{args:?}: {}", ran.err);
    }
}

#[test]
fn orders_to_robots_need_robots_and_maintenance_a_reason() {
    let cases: [(&[&str], &str); 6] = [
        (&["hold"], "<ROBOT"),
        (&["hold", "amber", "--all"], "cannot be used with"),
        (&["hold", "amber", "--for", "2d"], "--for is longer than 24 h"),
        (&["release", "--where", "robot.wheels >"], "--where: "),
        (&["maintenance", "amber"], "--reason <TEXT>"),
        (&["maintenance", "amber", "--end", "--reason", "tyres"], "cannot be used with"),
    ];
    for (args, expected) in cases {
        let ran = run(args);
        assert_eq!(ran.code, Some(2), "{args:?}: {}", ran.err);
        assert!(ran.err.contains(expected), "{args:?}: {}", ran.err);
    }
}
