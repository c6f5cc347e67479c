use super::support::{run, written};

#[test]
fn a_run_is_told_in_json_and_is_the_same_each_time() {
    let args = ["chaos", "--seed", "7", "--nodes", "4", "--minutes", "0.5", "--json"];
    let (one, other) = (run(&args), run(&args));
    assert_eq!(one.code, Some(0), "{}{}", one.out, one.err);
    assert_eq!(one.out, other.out);
    let outcome: serde_json::Value = serde_json::from_str(&one.out).expect("a line of JSON");
    assert_eq!(outcome["seed"], 7);
    assert_eq!(outcome["violation"], serde_json::Value::Null);
    assert_eq!(outcome["tally"]["lost"], 0);
}

#[test]
fn a_schedule_that_names_what_is_not_there_is_refused_with_what_there_is() {
    let file = written("nobody.json", r#"{"steps": [{"at_ms": 9, "act": "pause", "node": "nobody", "for_ms": 5}]}"#);
    let ran = run(&["chaos", "--seed", "7", "--nodes", "4", "--schedule", &file]);
    assert_eq!(ran.code, Some(2), "{}", ran.err);
    let expected = "at 9 ms: \"nobody\" is not known; there are aster, basil, garnet, lab-arm, world";
    assert!(ran.err.contains(expected), "{}", ran.err);
}

#[test]
fn seeds_are_a_first_and_a_last() {
    let ran = run(&["chaos", "--seeds", "9..1"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("\"9..1\" is not FIRST..LAST, as in 1..1000"), "{}", ran.err);
}
