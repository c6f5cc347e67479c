//! A full disk.

use crate::crashes::{completes, submit, with, world};
use crate::support::{Client, Fleet, LONG, example, skip, until};
use std::fs::File;
use std::io::Write;
use std::process::Command;

/// Starts a program with its own small disk at `$1`.
const SMALL_DISK: &str = "mkdir -p \"$1\" && mount -t tmpfs -o size=16m none \"$1\" && shift && exec \"$@\"";

#[test]
fn a_node_with_a_full_disk_ends_and_the_fleet_continues() {
    let allowed = Command::new("unshare").args(["-Urm", "mount", "-t", "tmpfs", "none", "/mnt"]).output();
    if !allowed.as_ref().is_ok_and(|tried| tried.status.success()) {
        return skip("a user namespace may not mount a tmpfs");
    }
    let mut fleet = Fleet::new(&with(example("fleet"), "name", "disks"));
    fleet.start("world", world(20.0), &[]);
    for station in ["station-1", "station-2", "station-3"] {
        let data = fleet.path(&format!("{station}-data")).display().to_string();
        let table = with(with(example("station"), "name", station), "data_dir", data.clone());
        match station {
            "station-3" => {
                fleet.start_by(&["unshare", "-Urm", "sh", "-c", SMALL_DISK, "sh", &data], "station", table, &["world"]);
            }
            _ => fleet.start("station", table, &["world"]),
        }
    }
    for kind in ["robot", "arm"] {
        fleet.start("robot", with(example(kind), "may_vote", false), &["world", "station-1"]);
    }
    let mut client = Client::open(&fleet.address("world"), "disks");
    until("all three are voters", LONG, || {
        let (_, view) = client.all("view/coordinator", "").into_iter().next()?;
        (view["voters"].as_array()?.len() == 3).then_some(())
    });
    let first = submit(&client, "room-enough");
    completes(&mut client, &first);

    // The disk is reached through the process of the node.
    let disk = fleet.path("station-3-data");
    let disk = format!("/proc/{}/root{}", fleet.node("station-3").id(), disk.display());
    let mut ballast = File::create(format!("{disk}/ballast")).expect("its disk can be reached");
    while ballast.write_all(&[1; 4096]).is_ok() {}
    let mut number = 0;
    until("it ends", LONG, || {
        number += 1;
        let mission = submit(&client, &format!("no-room-{number}"));
        assert!(!mission.is_empty());
        fleet.node("station-3").has_ended().then_some(())
    });
    let ended = fleet.take("station-3").end(LONG);
    assert_ne!(ended.status.code(), Some(0), "{}", ended.stderr);
    let errors = ended.stderr.to_lowercase();
    assert!(errors.contains("no space left"), "{}", ended.stderr);
    let last = submit(&client, "the-others");
    client.wait_for_event("its auction is called", LONG, |event| {
        event["event"] == "bids_requested" && event["mission"] == last.as_str()
    });
    fleet.stop();
}
