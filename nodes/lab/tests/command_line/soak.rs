//! `consort-lab soak`.

use crate::skip::skip;
use crate::support::{crate_file, run};
use consort_tests::host_network::hindrance;
use std::process::Command;

fn plants(name: &str) -> String {
    crate_file(&format!("../../examples/plants/{name}"))
}

#[test]
fn two_minutes_of_faults_violate_nothing() {
    if let Some(reason) = hindrance(&["ip", "nft"]) {
        return skip(&reason);
    }
    let mut soak = Command::new(env!("CARGO_BIN_EXE_consort-lab"));
    let (domain, mission) = (plants("domain.yaml"), plants("rounds.yaml"));
    soak.args(["soak", "--minutes", "2", "--seed", "1", "--json", "--domain", &domain, "--mission", &mission]);
    let ended = soak.output().expect("the program starts");
    let (verdict, log) = (String::from_utf8_lossy(&ended.stdout), String::from_utf8_lossy(&ended.stderr));
    assert!(ended.status.success(), "{verdict}\n{log}");
    let verdict: serde_json::Value = serde_json::from_str(&verdict).expect("a verdict in JSON");
    for counted in ["acknowledged", "own", "replies", "orders", "charges", "occurrences", "terms"] {
        assert!(verdict[counted].as_u64() > Some(0), "{counted}: {verdict}");
    }
    assert_eq!(verdict["violations"], serde_json::json!([]), "{verdict}");
}

/// The files are checked before anything is started.
#[test]
fn wrong_missions_of_a_user_are_reported() {
    let mission = plants("rounds.yaml");
    let ran = run(&["soak", "--mission", &mission]);
    assert!(ran.code == Some(2) && ran.err.contains("unknown task type `water_plant`"), "{}", ran.err);
    let ran = run(&["soak", "--domain", &mission]);
    assert!(ran.code == Some(2) && ran.err.contains("rounds.yaml"), "{}", ran.err);
}
