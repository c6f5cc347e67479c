//! `consort-lab soak`.

use crate::skip::skip;
use consort_tests::host_network::hindrance;
use std::process::Command;

#[test]
fn two_minutes_of_faults_violate_nothing() {
    if let Some(reason) = hindrance(&["ip", "nft"]) {
        return skip(&reason);
    }
    let mut soak = Command::new(env!("CARGO_BIN_EXE_consort-lab"));
    let ended = soak.args(["soak", "--minutes", "2", "--seed", "1", "--json"]).output().expect("the program starts");
    let (verdict, log) = (String::from_utf8_lossy(&ended.stdout), String::from_utf8_lossy(&ended.stderr));
    assert!(ended.status.success(), "{verdict}\n{log}");
    let verdict: serde_json::Value = serde_json::from_str(&verdict).expect("a verdict in JSON");
    for counted in ["acknowledged", "replies", "terms"] {
        assert!(verdict[counted].as_u64() > Some(0), "{counted}: {verdict}");
    }
    assert_eq!(verdict["violations"], serde_json::json!([]), "{verdict}");
}
