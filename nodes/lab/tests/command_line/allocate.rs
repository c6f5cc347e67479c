//! `consort-lab allocate`.

use super::support::{run, test_file};
use serde_json::{Value, json};

/// Three robots can do all jobs; two cannot. Positions in rings around the depot, some with early and some with late
/// windows.
fn instance() -> String {
    let mut lines = vec!["customer,x,y,demand,ready,due,service".to_owned(), "0,50,50,0,0,400,0".to_owned()];
    for number in 1..=15_u32 {
        let (angle, radius) = (f64::from(number) * 2.4, 8.0 + f64::from(number * 7 % 11) * 3.0);
        let (x, y) = ((50.0 + radius * angle.cos()).round(), (50.0 + radius * angle.sin()).round());
        let ready = number * 37 % 180;
        lines.push(format!("{number},{x},{y},10,{ready},{},10", ready + 60));
    }
    lines.join("\n")
}

fn allocated(args: &[&str]) -> Value {
    let ran = run(&[&["allocate", "--json"], args].concat());
    assert_eq!((ran.code, ran.err.as_str()), (Some(0), ""), "{args:?}");
    serde_json::from_str(&ran.out).unwrap_or_else(|problem| panic!("{problem}: {}", ran.out))
}

#[test]
fn policies_are_compared_on_the_same_instance() {
    let file = test_file("ring.csv", &instance());
    let of = |policy: &str| allocated(&[&file, "--robots", "3", "--policy", policy]);
    let [consort, tessi, greedy] = ["consort", "tessi", "greedy"].map(of);
    for (result, policy) in [(&consort, "consort"), (&tessi, "tessi"), (&greedy, "greedy")] {
        assert_eq!((&result["instance"], &result["policy"]), (&json!("ring"), &json!(policy)));
        assert_eq!((&result["late"], &result["robots"]), (&json!(0), &json!(3)), "{result}");
        assert!(result["messages"].as_u64().is_some_and(|messages| messages > 20), "{result}");
        assert!(result["wall_ms"].is_number(), "{result}");
        let done =
            result["routes"].as_array().unwrap().iter().map(|route| route.as_array().unwrap().len()).sum::<usize>();
        assert_eq!(json!(15 - done), result["unassigned"], "{result}");
    }
    assert_eq!(consort["unassigned"], 0, "{consort}");
    let value = |result: &Value| (result["unassigned"].as_u64(), result["distance"].as_f64());
    assert!(value(&consort) < value(&tessi), "{consort} {tessi}");
    assert!(value(&tessi) < value(&greedy), "{tessi} {greedy}");
    let again = of("consort");
    assert_eq!((&again["routes"], &again["messages"]), (&consort["routes"], &consort["messages"]));
}

#[test]
fn limits_of_the_flags_are_kept() {
    let file = test_file("limits.csv", &instance());
    let one = allocated(&[&file, "--robots", "1", "--orders", "200"]);
    assert!(one["unassigned"].as_u64() > Some(0), "{one}");
    let small = allocated(&[&file, "--robots", "15", "--capacity", "20", "--orders", "2000"]);
    assert_eq!(small["unassigned"], 0, "{small}");
    assert!(small["routes"].as_array().unwrap().iter().all(|route| route.as_array().unwrap().len() <= 2), "{small}");
}

#[test]
fn problems_of_all_files_are_reported_before_anything_is_allocated() {
    let (good, bad) = (test_file("good.csv", &instance()), test_file("bad.csv", &instance().replace(",400,", ",end,")));
    let ran = run(&["allocate", &good, &bad, "nowhere.txt", "--robots", "3"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{}", ran.err);
    assert!(ran.err.contains("bad.csv: line 2: due: \"end\" is not a number, 0 or more"), "{}", ran.err);
    assert!(ran.err.contains("nowhere.txt"), "{}", ran.err);
    let ran = run(&["allocate", &good]);
    assert_eq!(ran.code, Some(2), "{}", ran.err);
    assert!(ran.err.contains("give it with --robots"), "{}", ran.err);
    let ran = run(&["allocate", &good, "--robots", "3", "--policy", "best"]);
    assert_eq!(ran.code, Some(2), "{}", ran.err);
    assert!(ran.err.contains("\"best\" is no policy; allowed: consort, tessi, greedy"), "{}", ran.err);
}
