//! What is asked of a fleet, and how it is refused or put off.

use super::support::{Running, consort, free_address, run};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read};
use std::process::Stdio;

/// A station of its own fleet, without robots, which listens there.
fn station(address: &str, more: &[&str]) -> Running {
    let args = [&["station", "--name", "s1", "--listen", address], more].concat();
    Running(consort(&args).stderr(Stdio::null()).spawn().expect("the binary starts"))
}

#[test]
fn a_priority_or_a_deadline_that_is_none_is_refused_before_anybody_is_asked() {
    let priority = "--priority <NUMBER>";
    let deadline = "--deadline <SECONDS>";
    for (flag, value, what, allowed) in [
        ("--priority", "101", priority, "101 is no priority; allowed are -100 to 100"),
        ("--priority", "-101", priority, "-101 is no priority; allowed are -100 to 100"),
        ("--priority", "99999999999999999999", priority, "is no whole number; allowed are -100 to 100"),
        ("--priority", "high", priority, "\"high\" is no whole number; allowed are -100 to 100"),
        ("--deadline", "0", deadline, "allowed are more than 0 and at most 315360000 seconds"),
        ("--deadline", "-60", deadline, "allowed are more than 0 and at most 315360000 seconds"),
        ("--deadline", "inf", deadline, "allowed are more than 0 and at most 315360000 seconds"),
        ("--deadline", "NaN", deadline, "allowed are more than 0 and at most 315360000 seconds"),
        ("--deadline", "17:30", deadline, "\"17:30\" is no number of seconds from now"),
    ] {
        let ran = run(&["submit", "lab-samples", flag, value]);
        assert_eq!(ran.code, Some(2), "{flag} {value}: {}", ran.err);
        let expected = format!("invalid value '{value}' for '{what}': ");
        assert!(ran.err.contains(&expected) && ran.err.contains(allowed), "{flag} {value}: {}", ran.err);
    }
}

#[test]
fn a_priority_and_a_deadline_are_kept_with_the_mission_and_past_its_deadline_it_fails() {
    let address = free_address();
    let _station = station(&address, &[]);
    let ask = |args: &[&str]| run(&[args, &["--connect", &address]].concat());

    let ran = ask(&["submit", "lab-samples", "--priority", "-7", "--deadline", "900", "--json"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let ran = ask(&["missions", "--json"]);
    let missions: Value = serde_json::from_str(&ran.out).unwrap_or_else(|problem| panic!("{problem}: {}", ran.out));
    let mission = &missions["missions"][0];
    assert_eq!(mission["priority"], -7, "{mission}");
    let (asked, due) = (mission["submitted_at_ms"].as_u64(), mission["deadline_at_ms"].as_u64());
    assert_eq!(due, asked.map(|asked| asked + 900_000), "{mission}");

    let ran = ask(&["submit", "lab-samples", "--deadline", "0.5", "--wait"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(1), "lab-samples-2\nlab-samples-2 failed\n"), "{}", ran.err);
    let expected = "consort: lab-samples-2 failed: its deadline passed while it waited: no viable bid for lab_arm, r1";
    assert!(ran.err.contains(expected), "{}", ran.err);
}

#[test]
fn a_mission_that_needs_no_rescue_cannot_be_closed() {
    let address = free_address();
    let _station = station(&address, &[]);
    let ask = |args: &[&str]| run(&[args, &["--connect", &address]].concat());
    let ran = ask(&["submit", "lab-samples"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    for (mission, expected) in [
        ("lab-samples-1", "lab-samples-1 is pending; only one that needs rescue can be closed"),
        ("lab-samples-9", "no mission lab-samples-9"),
    ] {
        let ran = ask(&["rescue", mission, "--by", "Nia"]);
        assert_eq!((ran.code, ran.out.as_str()), (Some(1), ""), "{}", ran.err);
        assert!(ran.err.contains(expected), "{}", ran.err);
    }
    let ran = ask(&["rescue", "Lab Samples"]);
    assert_eq!(ran.code, Some(2), "{}", ran.err);
    assert!(ran.err.contains("invalid value 'Lab Samples' for '<MISSION>'"), "{}", ran.err);
}

#[test]
fn while_nobody_coordinates_the_command_says_so_and_asks_again_until_somebody_does() {
    let address = free_address();
    let _first = station(&address, &["--bootstrap-expect", "2"]);
    let args = ["submit", "lab-samples", "--connect", &address, "--timeout", "60"];
    let asking = consort(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the binary starts");
    let mut asking = Running(asking);
    let said = asking.0.stderr.take().expect("it is piped");
    let retries = |line: &String| line.starts_with("no coordinator yet: trying again in 0.3 s");
    let mut said = BufReader::new(said).lines().map(|line| line.expect("it writes UTF-8"));
    assert!(said.any(|line| retries(&line)), "it ended without a word of it");

    let args = ["station", "--name", "s2", "--bootstrap-expect", "2", "--connect", &address];
    let _second = Running(consort(&args).stderr(Stdio::null()).spawn().expect("the binary starts"));
    let out = asking.0.stdout.take().expect("it is piped");
    let out: Vec<String> = BufReader::new(out).lines().map(|line| line.expect("it writes UTF-8")).collect();
    assert_eq!(out, ["lab-samples-1"], "{:?}", said.collect::<Vec<_>>());
    assert!(asking.0.wait().expect("a child of ours").success());

    // Nobody else comes, and it gives up in the time that it was given.
    let alone = free_address();
    let _alone = station(&alone, &["--bootstrap-expect", "2"]);
    let ran = run(&["submit", "lab-samples", "--connect", &alone, "--timeout", "4"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(3), ""), "{}", ran.err);
    assert!(ran.err.contains("consort: no coordinator, and none did in 4 s; linked to "), "{}", ran.err);
    assert!(ran.err.contains("Are as many nodes up that may vote as its bootstrap_expect says"), "{}", ran.err);
}

/// The words of the line by which a request may be repeated, as the command says it.
fn said_to_repeat(err: &str) -> Vec<String> {
    let line = err.lines().skip_while(|line| !line.contains("can be repeated safely")).nth(1);
    shlex::split(line.unwrap_or_else(|| panic!("not said: {err}"))).expect("a line for a shell")
}

#[test]
fn a_request_that_nobody_answers_can_be_made_again_as_the_command_says_and_gets_one_mission() {
    let address = free_address();
    let _first = station(&address, &["--bootstrap-expect", "2"]);
    let asked = ["submit", "lab-samples", "--set", "room=IC Room 6", "--json", "--connect", &address, "--timeout", "2"];
    let ran = run(&asked);
    assert_eq!((ran.code, ran.out.as_str()), (Some(3), ""), "{}", ran.err);
    let again = said_to_repeat(&ran.err);
    let flag = again.iter().position(|word| word == "--request").unwrap_or_else(|| panic!("no name: {again:?}"));
    let name = &again[flag + 1];
    assert!(ran.err.contains(&format!("Whether request {name} was taken is not known")), "{}", ran.err);
    let mut words = again[1..].to_vec();
    words.drain(flag - 1..=flag);
    assert_eq!(words, asked, "but for its name it is what was asked");

    let args = ["station", "--name", "s2", "--bootstrap-expect", "2", "--connect", &address];
    let _second = Running(consort(&args).stderr(Stdio::null()).spawn().expect("the binary starts"));
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
fn in_json_whoever_waits_is_told_the_mission_however_the_wait_ends() {
    let address = free_address();
    let mut station = station(&address, &[]);
    let args = ["submit", "lab-samples", "--request", "a", "--wait", "--json", "--connect", &address, "--timeout", "5"];
    let ran = run(&[&args[..], &["--deadline", "0.5"]].concat());
    assert_eq!(ran.code, Some(1), "{}", ran.err);
    let [acknowledged, ended] = &lines_of_json(&ran.out)[..] else { panic!("two lines: {}", ran.out) };
    assert_eq!(*acknowledged, json!({ "mission": "lab-samples-1", "again": false, "request": "a" }));
    assert_eq!((&ended["mission"], &ended["state"]), (&json!("lab-samples-1"), &json!("failed")), "{ended}");

    // The whole fleet is gone while somebody waits.
    let args = args.map(|word| if word == "a" { "b" } else { word });
    let waiting = consort(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the binary starts");
    let mut waiting = Running(waiting);
    let mut out = BufReader::new(waiting.0.stdout.take().expect("it is piped")).lines();
    let first = out.next().expect("a line").expect("it writes UTF-8");
    let expected = json!({ "mission": "lab-samples-2", "again": false, "request": "b" });
    assert_eq!(lines_of_json(&first), [expected]);
    station.0.kill().expect("a child of ours");
    assert!(out.next().is_none(), "nothing else is said there");
    assert_eq!(waiting.0.wait().expect("a child of ours").code(), Some(3));
    let mut err = String::new();
    waiting.0.stderr.take().expect("it is piped").read_to_string(&mut err).expect("it writes UTF-8");
    assert!(err.contains("lab-samples-2 was acknowledged, and is not lost"), "{err}");
    let line = err.lines().last().expect("a line");
    let again = shlex::split(line).unwrap_or_else(|| panic!("not for a shell: {line}"));
    assert_eq!(again[1..], args, "it has a name already");
}
