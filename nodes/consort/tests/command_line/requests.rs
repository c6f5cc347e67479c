//! Requests to a fleet, and their rejection or delay.

use super::support::{Running, command, free_address, run, test_file};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read};
use std::process::Stdio;

/// Starts a station without robots at this address, in its own fleet.
fn station(address: &str, more: &[&str]) -> Running {
    let args = [&["station", "--name", "s1", "--listen", address], more].concat();
    Running(command(&args).stderr(Stdio::null()).spawn().expect("the binary starts"))
}

#[test]
fn an_invalid_priority_start_or_deadline_is_rejected_before_connecting() {
    let priority = "--priority <NUMBER>";
    let deadline = "--deadline <SECONDS>";
    let start = "--not-before <TIME>";
    for (flag, value, what, allowed) in [
        ("--priority", "101", priority, "101 is not a valid priority; allowed are -100 to 100"),
        ("--priority", "-101", priority, "-101 is not a valid priority; allowed are -100 to 100"),
        ("--priority", "99999999999999999999", priority, "is not a whole number; allowed are -100 to 100"),
        ("--priority", "high", priority, "\"high\" is not a whole number; allowed are -100 to 100"),
        ("--not-before", "8:00", start, "\"8:00\" is no time; allowed is a date and time with its offset"),
        ("--not-before", "2026-11-27T08:00:00", start, "as 2026-11-27T08:00:00+01:00, or a time from now, as 15m"),
        ("--deadline", "0", deadline, "the time must be more than 0 and at most 315360000 seconds"),
        ("--deadline", "-60", deadline, "the time must be more than 0 and at most 315360000 seconds"),
        ("--deadline", "inf", deadline, "the time must be more than 0 and at most 315360000 seconds"),
        ("--deadline", "NaN", deadline, "the time must be more than 0 and at most 315360000 seconds"),
        ("--deadline", "17:30", deadline, "\"17:30\" is not a number of seconds from now"),
    ] {
        let ran = run(&["submit", "lab-samples", flag, value]);
        assert_eq!(ran.code, Some(2), "{flag} {value}: {}", ran.err);
        let expected = format!("invalid value '{value}' for '{what}': ");
        assert!(ran.err.contains(&expected) && ran.err.contains(allowed), "{flag} {value}: {}", ran.err);
    }
}

#[test]
fn a_mission_keeps_its_priority_and_start_and_fails_after_its_deadline() {
    let address = free_address();
    let _station = station(&address, &[]);
    let command = |args: &[&str]| run(&[args, &["--connect", &address]].concat());

    let ran = command(&["submit", "lab-samples", "--priority", "-7", "--deadline", "900", "--json"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let ran = command(&["missions", "--json"]);
    let missions: Value = serde_json::from_str(&ran.out).unwrap_or_else(|problem| panic!("{problem}: {}", ran.out));
    let mission = &missions["missions"][0];
    assert_eq!(mission["priority"], -7, "{mission}");
    let (submitted_at, deadline_at) = (mission["submitted_at_ms"].as_u64(), mission["deadline_at_ms"].as_u64());
    assert_eq!(deadline_at, submitted_at.map(|submitted_at| submitted_at + 900_000), "{mission}");
    let ran = command(&["missions", "lab-samples-1"]);
    assert!(ran.code == Some(0) && ran.out.starts_with("MISSION "), "{}{}", ran.out, ran.err);
    let task = ran.out.lines().find(|line| line.trim_start().starts_with("navto_room ")).expect("its task");
    assert_eq!(task.split_whitespace().collect::<Vec<_>>(), ["navto_room", "navigation", "waiting", "r1", "-"]);
    let ran = command(&["missions", "lab-samples-1", "--json"]);
    let mission: Value = serde_json::from_str(&ran.out).unwrap_or_else(|problem| panic!("{problem}: {}", ran.out));
    assert_eq!(mission["tree"]["state"], "waiting", "{mission}");
    let ran = command(&["missions", "lab-samples-9"]);
    assert!(ran.code == Some(1) && ran.err.contains("no mission lab-samples-9"), "{}", ran.err);

    let ran = command(&["submit", "lab-samples", "--deadline", "0.5", "--wait"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(1), "lab-samples-2\nlab-samples-2 failed\n"), "{}", ran.err);
    let expected = "consort: lab-samples-2 failed: its deadline passed while it waited: no viable bid for lab_arm, r1; class transient";
    assert!(ran.err.contains(expected), "{}", ran.err);

    let ran = command(&["submit", "lab-samples", "--not-before", "2999-01-01T01:00:00+01:00"]);
    assert!(ran.code == Some(1) && ran.err.contains("a date and time in the next ten years"), "{}", ran.err);
    let ran = command(&["submit", "lab-samples", "--not-before", "15m"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(0), "lab-samples-3\n"), "{}", ran.err);
    let ran = command(&["missions"]);
    assert!(ran.out.contains("it may not start before 20"), "{}", ran.out);
}

/// The fleet keeps one ended mission whole, so a client that waits for the end of an earlier mission finds only its outcome.
#[test]
fn a_wait_sees_the_end_of_a_mission_that_is_not_kept() {
    let address = free_address();
    let fleet = test_file("short_history.toml", "name = \"ward\"\n[history]\nmissions = 1\n");
    let _station = station(&address, &["--fleet", &fleet]);
    let wait = |request: &str, mission: &str, remark: &str| {
        let args =
            ["submit", "lab-samples", "--request", request, "--deadline", "0.5", "--wait", "--connect", &address];
        let ran = run(&args);
        let expected = format!("{mission}{remark}\n{mission} failed\n");
        assert_eq!((ran.code, ran.out), (Some(1), expected), "{}", ran.err);
        assert!(ran.err.contains(&format!("consort: {mission} failed: its deadline passed")), "{}", ran.err);
    };
    wait("first", "lab-samples-1", "");
    wait("second", "lab-samples-2", "");
    let ran = run(&["missions", "lab-samples-1", "--connect", &address]);
    assert!(ran.out.contains("its tasks are no longer stored"), "{}{}", ran.out, ran.err);
    wait("first", "lab-samples-1", " (requested before)");
}

#[test]
fn a_mission_without_need_of_intervention_cannot_be_resolved() {
    let address = free_address();
    let _station = station(&address, &[]);
    let command = |args: &[&str]| run(&[args, &["--connect", &address]].concat());
    let ran = command(&["submit", "lab-samples"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    for (mission, expected) in [
        ("lab-samples-1", "lab-samples-1 is pending; only a mission that needs intervention can be resolved"),
        ("lab-samples-9", "no mission lab-samples-9"),
    ] {
        let ran = command(&["resolve", mission, "--by", "Nia"]);
        assert_eq!((ran.code, ran.out.as_str()), (Some(1), ""), "{}", ran.err);
        assert!(ran.err.contains(expected), "{}", ran.err);
    }
    let ran = command(&["resolve", "Lab Samples"]);
    assert_eq!(ran.code, Some(2), "{}", ran.err);
    assert!(ran.err.contains("invalid value 'Lab Samples' for '<MISSION>'"), "{}", ran.err);
}

#[test]
fn a_command_retries_until_there_is_a_coordinator() {
    let address = free_address();
    let _first = station(&address, &["--bootstrap-expect", "2"]);
    let args = ["submit", "lab-samples", "--connect", &address, "--timeout", "60"];
    let asking = command(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the binary starts");
    let mut asking = Running(asking);
    let errors = asking.0.stderr.take().expect("it is piped");
    let retries = |line: &String| line.starts_with("no coordinator yet: trying again in 0.3 s");
    let mut errors = BufReader::new(errors).lines().map(|line| line.expect("it writes UTF-8"));
    assert!(errors.any(|line| retries(&line)), "it ended without a word of it");

    let args = ["station", "--name", "s2", "--bootstrap-expect", "2", "--connect", &address];
    let _second = Running(command(&args).stderr(Stdio::null()).spawn().expect("the binary starts"));
    let out = asking.0.stdout.take().expect("it is piped");
    let out: Vec<String> = BufReader::new(out).lines().map(|line| line.expect("it writes UTF-8")).collect();
    assert_eq!(out, ["lab-samples-1"], "{:?}", errors.collect::<Vec<_>>());
    assert!(asking.0.wait().expect("a child of ours").success());

    // Without a second node the command gives up after its timeout.
    let alone = free_address();
    let _alone = station(&alone, &["--bootstrap-expect", "2"]);
    let ran = run(&["submit", "lab-samples", "--connect", &alone, "--timeout", "4"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(3), ""), "{}", ran.err);
    assert!(ran.err.contains("consort: no coordinator, and none did in 4 s; linked to "), "{}", ran.err);
    assert!(ran.err.contains("Are at least bootstrap_expect nodes with may_vote running"), "{}", ran.err);
}

/// Returns the command line that the error output suggests for repeating a request.
fn said_to_repeat(err: &str) -> Vec<String> {
    let line = err.lines().skip_while(|line| !line.contains("can be repeated safely")).nth(1);
    shlex::split(line.unwrap_or_else(|| panic!("the suggestion is missing: {err}"))).expect("a line for a shell")
}

#[test]
fn an_unanswered_request_can_be_repeated_and_gets_a_single_mission() {
    let address = free_address();
    let _first = station(&address, &["--bootstrap-expect", "2"]);
    let arguments =
        ["submit", "lab-samples", "--set", "room=IC Room 6", "--json", "--connect", &address, "--timeout", "2"];
    let ran = run(&arguments);
    assert_eq!((ran.code, ran.out.as_str()), (Some(3), ""), "{}", ran.err);
    let again = said_to_repeat(&ran.err);
    let flag = again.iter().position(|word| word == "--request").unwrap_or_else(|| panic!("no name: {again:?}"));
    let name = &again[flag + 1];
    assert!(ran.err.contains(&format!("It is unknown if request {name} was accepted")), "{}", ran.err);
    let mut words = again[1..].to_vec();
    words.drain(flag - 1..=flag);
    assert_eq!(words, arguments, "the suggestion differs in the name only");

    let args = ["station", "--name", "s2", "--bootstrap-expect", "2", "--connect", &address];
    let _second = Running(command(&args).stderr(Stdio::null()).spawn().expect("the binary starts"));
    let mut words: Vec<&str> = again[1..].iter().map(String::as_str).collect();
    *words.last_mut().expect("the time-out") = "60";
    for before in [false, true] {
        let ran = run(&words);
        assert_eq!(ran.code, Some(0), "{}", ran.err);
        let answer: Value = serde_json::from_str(&ran.out).unwrap_or_else(|problem| panic!("{problem}: {}", ran.out));
        assert_eq!(answer, json!({ "mission": "lab-samples-1", "again": before, "request": name }));
    }
}

fn lines_of_json(out: &str) -> Vec<Value> {
    let line = |line: &str| serde_json::from_str(line).unwrap_or_else(|problem| panic!("{problem}: {line}"));
    out.lines().map(line).collect()
}

#[test]
fn json_output_names_the_mission_however_the_wait_ends() {
    let address = free_address();
    let mut station = station(&address, &[]);
    let args = ["submit", "lab-samples", "--request", "a", "--wait", "--json", "--connect", &address, "--timeout", "5"];
    let ran = run(&[&args[..], &["--deadline", "0.5"]].concat());
    assert_eq!(ran.code, Some(1), "{}", ran.err);
    let [acknowledged, ended] = &lines_of_json(&ran.out)[..] else { panic!("two lines: {}", ran.out) };
    assert_eq!(*acknowledged, json!({ "mission": "lab-samples-1", "again": false, "request": "a" }));
    assert_eq!((&ended["mission"], &ended["state"]), (&json!("lab-samples-1"), &json!("failed")), "{ended}");

    // The whole fleet ends while a command waits.
    let args = args.map(|word| if word == "a" { "b" } else { word });
    let waiting = command(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the binary starts");
    let mut waiting = Running(waiting);
    let mut out = BufReader::new(waiting.0.stdout.take().expect("it is piped")).lines();
    let first = out.next().expect("a line").expect("it writes UTF-8");
    let expected = json!({ "mission": "lab-samples-2", "again": false, "request": "b" });
    assert_eq!(lines_of_json(&first), [expected]);
    station.0.kill().expect("a child of ours");
    assert!(out.next().is_none(), "there is no further output");
    assert_eq!(waiting.0.wait().expect("a child of ours").code(), Some(3));
    let mut err = String::new();
    waiting.0.stderr.take().expect("it is piped").read_to_string(&mut err).expect("it writes UTF-8");
    assert!(err.contains("lab-samples-2 was acknowledged, and is not lost"), "{err}");
    let line = err.lines().last().expect("a line");
    let again = shlex::split(line).unwrap_or_else(|| panic!("not for a shell: {line}"));
    assert_eq!(again[1..], args, "it has a name already");
}
