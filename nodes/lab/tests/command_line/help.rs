//! `--help`, and files of designs.

use super::support::{run, test_file};
use serde_json::Value;

const COMMANDS: [&str; 8] = ["chaos", "soak", "test", "experiment", "allocate", "bench", "check", "schema"];

#[test]
fn the_help_of_each_command_teaches_by_examples() {
    let help = run(&["--help"]);
    assert_eq!(help.code, Some(0));
    for command in COMMANDS {
        assert!(help.out.contains(&format!("  {command} ")), "{command} is missing in\n{}", help.out);
        let help = run(&[command, "--help"]);
        assert_eq!(help.code, Some(0), "{command}");
        assert!(help.out.contains(&format!("Examples:\n  consort-lab {command}")), "{command}:\n{}", help.out);
    }
}

#[test]
fn the_shipped_designs_are_valid() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../sim_bridge/evaluation/designs");
    let published = format!("{folder}/published.toml");
    let ran = run(&["check", &published, &format!("{folder}/food.toml"), &format!("{folder}/rounds.toml")]);
    assert_eq!(ran.code, Some(0), "{}", ran.out);
    assert!(ran.out.starts_with(&format!("{published}: ok, a design: published, 1296 trials\n")), "{}", ran.out);
}

#[test]
fn a_wrong_design_is_reported_with_file_line_and_allowed_keys() {
    let file = test_file("wrong_design.toml", "name = \"thin\"\nsede = 7\n");
    let ran = run(&["check", &file]);
    assert_eq!(ran.code, Some(1), "{}", ran.err);
    assert!(ran.out.starts_with(&format!("{file}:2:1: unknown key `sede` in a design file; allowed: ")), "{}", ran.out);
}

#[test]
fn the_schema_of_a_design_is_json() {
    let ran = run(&["schema"]);
    let schema: Value = serde_json::from_str(&ran.out).expect("JSON");
    assert!(schema["properties"]["policies"].is_object(), "{schema}");
}
