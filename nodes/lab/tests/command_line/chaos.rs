use super::support::{command, run, test_file};
use serde_json::Value;
use std::path::PathBuf;

#[test]
fn a_run_is_printed_as_json_and_is_deterministic() {
    let args = ["chaos", "--seed", "7", "--nodes", "4", "--minutes", "0.5", "--json"];
    let (one, other) = (run(&args), run(&args));
    assert_eq!(one.code, Some(0), "{}{}", one.out, one.err);
    assert_eq!(one.out, other.out);
    let outcome: Value = serde_json::from_str(&one.out).expect("a line of JSON");
    assert_eq!(outcome["seed"], 7);
    assert_eq!(outcome["violation"], Value::Null);
    assert_eq!(outcome["counters"]["lost"], 0);
}

#[test]
fn a_schedule_with_an_unknown_name_is_rejected_with_the_known_names() {
    let file =
        test_file("nobody.json", r#"{"steps": [{"at_ms": 9, "action": "pause", "node": "nobody", "for_ms": 5}]}"#);
    let ran = run(&["chaos", "--seed", "7", "--nodes", "4", "--schedule", &file]);
    assert_eq!(ran.code, Some(2), "{}", ran.err);
    let expected = "at 9 ms: \"nobody\" is not known; there are aster, basil, garnet, lab-arm, world";
    assert!(ran.err.contains(expected), "{}", ran.err);
}

#[test]
fn seeds_must_be_an_ascending_range() {
    let ran = run(&["chaos", "--seeds", "9..1"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("\"9..1\" is not FIRST..LAST, as in 1..1000"), "{}", ran.err);
}

#[test]
fn flags_of_another_mode_are_rejected_with_the_valid_flags() {
    let mutants = "consort-lab chaos --mutants [--jobs JOBS] [--json]";
    let scoreboard =
        "consort-lab chaos --scoreboard [--runs N] [--minutes MINUTES] [--save FILE] [--jobs JOBS] [--json]";
    let one = "consort-lab chaos --seed SEED [--schedule FILE | --faults KIND,…]";
    for (mode, expected, others) in [
        (&["--mutants"][..], mutants, &["--seeds 1..3", "--seed 3", "--scoreboard", "--minutes 1", "--nodes 5"][..]),
        (&["--mutants"], mutants, &["--faults loss", "--mutant double-vote", "--runs 3", "--save x.json", "--verbose"]),
        (&["--scoreboard"], scoreboard, &["--seeds 1..3", "--seed 3", "--nodes 5", "--faults loss", "--verbose"]),
        (&["--scoreboard"], scoreboard, &["--mutant double-vote", "--schedule x.json"]),
        (&["--seed", "3"], one, &["--seeds 1..3", "--jobs 2", "--runs 3", "--save x.json"]),
        (&["--seed", "3", "--schedule", "x.json"], one, &["--faults loss"]),
        (
            &["--seeds", "1..3"],
            "consort-lab chaos [--seeds FIRST..LAST]",
            &["--verbose", "--schedule x.json", "--runs 3"],
        ),
    ] {
        for other in others {
            let args: Vec<&str> = ["chaos"].iter().chain(mode).copied().chain(other.split(' ')).collect();
            let ran = run(&args);
            assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{args:?}: {}", ran.err);
            assert!(ran.err.contains(expected), "{args:?}: {}", ran.err);
            let flag = other.split(' ').next().expect("a flag");
            assert!(ran.err.contains(flag), "{args:?}: {}", ran.err);
        }
    }
}

fn lines_of_json(out: &str) -> Vec<Value> {
    let line = |line: &str| serde_json::from_str(line).unwrap_or_else(|problem| panic!("{problem}: {line}"));
    out.lines().map(line).collect()
}

#[test]
fn json_mode_prints_only_json_to_the_standard_output() {
    let steps = r#"{"steps": [{"at_ms": 600, "action": "partition", "groups": [["client"]], "for_ms": 100}]}"#;
    let file = test_file("parted.json", steps);
    let small = ["--nodes", "4", "--minutes", "0.5", "--json"];
    for (mode, prints_actions) in [
        (&["--seed", "7", "--verbose"][..], true),
        (&["--seed", "7", "--verbose", "--schedule", &file], true),
        (&["--seeds", "7..8"], false),
    ] {
        let ran = run(&[&["chaos"], mode, &small].concat());
        assert_eq!(ran.code, Some(0), "{mode:?}: {}{}", ran.out, ran.err);
        assert!(lines_of_json(&ran.out).iter().all(|outcome| outcome["seed"].is_u64()), "{}", ran.out);
        assert_eq!(!ran.err.is_empty(), prints_actions, "actions are printed to the standard error only: {}", ran.err);
    }
    let ran = run(&["chaos", "--scoreboard", "--runs", "1", "--minutes", "0.5", "--json"]);
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    let [rows] = &lines_of_json(&ran.out)[..] else { panic!("expected a single line: {}", ran.out) };
    assert!(rows.as_array().is_some_and(|rows| rows.iter().all(|row| row["fault"].is_string())), "{rows}");
}

#[test]
fn a_violation_prints_json_and_the_suggested_commands_reproduce_it() {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("violation");
    std::fs::create_dir_all(&folder).expect("cargo's own folder");
    let run = |words: &[&str]| {
        let ran = command(words).current_dir(&folder).output().expect("the binary starts");
        let text = |bytes| String::from_utf8(bytes).expect("the binary writes UTF-8");
        let (out, err) = (text(ran.stdout), text(ran.stderr));
        assert_eq!(ran.status.code(), Some(1), "{words:?}: {out}{err}");
        let [outcome] = &lines_of_json(&out)[..] else { panic!("expected a single line: {out}") };
        assert_eq!(outcome["violation"]["invariant"], "signals", "{outcome}");
        err
    };
    let mode = ["--seed", "3", "--nodes", "5", "--minutes", "1", "--mutant", "wait-skipped", "--faults", "loss"];
    let err = run(&[&["chaos"], &mode[..], &["--json"]].concat());
    let again: Vec<&str> = err.lines().filter_map(|line| line.strip_prefix("  consort-lab ")).collect();
    let [alone, all] = again[..] else { panic!("two lines: {err}") };
    assert!(alone.ends_with(" --schedule chaos-3.json") && all.ends_with(" --faults loss"), "{again:?}");
    for line in again {
        run(&line.split(' ').chain(["--json"]).collect::<Vec<_>>());
    }
}

fn plants(name: &str) -> String {
    format!("{}/../../examples/plants/{name}", env!("CARGO_MANIFEST_DIR"))
}

/// Missions and domains of a user run under faults, and are completed. Missing values are reported with their names.
#[test]
fn a_mission_of_a_domain_runs_under_faults() {
    let (domain, mission) = (plants("domain.yaml"), plants("rounds.yaml"));
    let of_domain = ["chaos", "--domain", &domain, "--mission", &mission, "--minutes", "1"];
    let ran = run(&[&of_domain[..], &["--seeds", "1..4", "--json"]].concat());
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
    let counters: Vec<Value> = lines_of_json(&ran.out).into_iter().map(|outcome| outcome["counters"].clone()).collect();
    let sum = |name: &str| counters.iter().filter_map(|counters| counters[name].as_u64()).sum::<u64>();
    assert!(sum("completed") > 0 && sum("completed") * 2 >= sum("acknowledged"), "{counters:#?}");

    let ran = run(&["chaos", "--mission", &mission, "--seeds", "1..1"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{}", ran.err);
    assert!(ran.err.contains("--mission: the mission water-plants: "), "{}", ran.err);
    assert!(ran.err.contains("unknown task type `water_plant`"), "{}", ran.err);

    let open = "mission: pause\nparameters:\n  time: { kind: seconds }\nroles:\n  r1: { kind: managed }\n\
                root: { task: rest, type: wait, roles: [r1], parameters: { seconds: \"${time}\" } }\n";
    let ran = run(&["chaos", "--mission", &test_file("open.yaml", open), "--seeds", "1..1"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{}", ran.err);
    assert!(
        ran.err.contains("--mission: the mission pause: ") && ran.err.contains("parameters/time: is not given"),
        "{}",
        ran.err
    );
}
