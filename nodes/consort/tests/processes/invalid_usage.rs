//! Missing or wrong arguments are reported with a remedy; no process starts.

use crate::support::{Folder, LONG, Program};
use std::net::TcpListener;

/// Runs the demo, which must reject its arguments, and returns its error output.
fn refused(folder: &Folder, arguments: &[&str]) -> String {
    let all: Vec<&str> = ["demo"].into_iter().chain(arguments.iter().copied()).collect();
    let ended = Program::start(folder, "demo", &all).end(LONG).expect(2);
    assert_eq!(ended.stdout, "", "{all:?}");
    folder.await_no_process();
    assert_eq!(folder.temporary_files(), Vec::<String>::new(), "{all:?}");
    ended.stderr
}

#[test]
fn an_occupied_port_is_reported() {
    let folder = Folder::new();
    let taken = TcpListener::bind(("127.0.0.1", 0)).expect("a free port");
    let port = taken.local_addr().expect("it has an address").port().to_string();
    let error = refused(&folder, &["--port", &port]);
    assert!(error.contains(&format!("port {port} of {port} to ")), "{error}");
    assert!(error.contains("choose other ports with --port, or leave it out to use free ports"), "{error}");
    let error = refused(&folder, &["--port", "65530"]);
    assert!(error.contains("--port 65530: 8 ports are needed, up to 65537; allowed is up to 65535"), "{error}");
}

#[test]
fn an_unknown_or_invalid_mission_is_rejected_before_the_start() {
    let folder = Folder::new();
    let error = refused(&folder, &["--mission", "nope"]);
    for word in [
        "nope",
        "no such file",
        "bed-transfer, food-logistics, lab-samples, lab-samples-watched, vital-signs, ward-disinfection",
    ] {
        assert!(error.contains(word), "{word:?} in {error}");
    }
    let shipped = include_str!("../../../../skills/missions/lab-samples.yaml");
    let wrong =
        shipped.replace("task: approach_nurse, type: approach_person", "task: approach_nurse, type: approach_persn");
    let file = folder.write("wrong.yaml", &wrong).display().to_string();
    for stage in [&["--mission", &file][..], &["--mission", &file, "--virtual"]] {
        let error = refused(&folder, stage);
        for word in ["wrong.yaml", "meet_nurse/approach_nurse: ", "approach_persn", "approach_person"] {
            assert!(error.contains(word), "{word:?} in {error}");
        }
    }
    // A parameter without a default that the demo does not set.
    let needs = shipped.replace("laboratory: { kind: place, default: Laboratory,", "laboratory: { kind: place,");
    let file = folder.write("needs.yaml", &needs).display().to_string();
    let error = refused(&folder, &["--mission", &file]);
    assert!(error.contains("laboratory"), "{error}");
}
