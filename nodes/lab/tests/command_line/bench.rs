use super::support::run;
use serde_json::Value;

#[test]
fn each_swarm_prints_a_json_line_and_flies_deterministically() {
    let args = ["bench", "swarm", "--drones", "3,20", "--seed", "7", "--json"];
    let measure = || {
        let ran = run(&args);
        assert_eq!(ran.code, Some(0), "{}", ran.err);
        let lines = ran.out.lines().map(|line| serde_json::from_str::<Value>(line).expect("a line of JSON"));
        lines.collect::<Vec<Value>>()
    };
    let rows = measure();
    let number = |row: &Value, key: &str| row[key].as_f64().unwrap_or_else(|| panic!("{key} in {row}"));
    assert_eq!(rows.iter().map(|row| number(row, "drones")).collect::<Vec<_>>(), [3.0, 20.0]);
    for row in &rows {
        assert_eq!((number(row, "crashed"), number(row, "arrived")), (0.0, number(row, "drones")), "{row}");
        assert!(number(row, "simulated_s") > 1.0, "{row}");
        assert!((0.0..=number(row, "max_s")).contains(&number(row, "min_s")), "{row}");
        assert!(number(row, "average_s") > 0.0, "{row}");
    }
    let again: Vec<Value> = measure().iter().map(|row| row["simulated_s"].clone()).collect();
    assert_eq!(again, rows.iter().map(|row| row["simulated_s"].clone()).collect::<Vec<_>>());
}

#[test]
fn bench_prints_the_published_columns_and_rejects_invalid_sizes() {
    let ran = run(&["bench", "swarm", "--drones", "2"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let heading = ran.out.lines().next().expect("a heading");
    for column in ["Swarm size", "Simulation time", "Min. time 1s", "Max. time 1s", "Average"] {
        assert!(heading.contains(column), "{heading}");
    }
    for drones in ["0", "10001", "many"] {
        let ran = run(&["bench", "swarm", "--drones", drones]);
        assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{drones}: {}", ran.err);
    }
    let ran = run(&["bench", "takeover", "--kills", "0"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "no takeovers: {}", ran.err);
    let ran = run(&["bench", "regions", "--sites", "1"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "a single site: {}", ran.err);
}

#[test]
fn the_help_of_scale_explains_the_backlog_and_a_wrong_number_is_rejected() {
    let help = run(&["bench", "scale", "--help"]);
    assert_eq!(help.code, Some(0), "{}", help.err);
    for text in ["--backlog <N>", "consort-lab bench scale --robots 200 --backlog 500", "up to 1000"] {
        assert!(help.out.contains(text), "{text} is missing in\n{}", help.out);
    }
    for backlog in ["1001", "-1", "many"] {
        let ran = run(&["bench", "scale", "--backlog", backlog]);
        assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{backlog}: {}", ran.err);
    }
}
