//! Backups of the ledger taken from a fleet under load. After the loss of all disks, the fleet
//! continues from a backup.

use crate::crashes::{STATIONS, coordinator_and_term, start_hospital, submit, with};
use crate::support::{Client, Fleet, LONG, example, until};
use consort_protocol::ledger::Ledger;
use consort_raft::store::Backup;
use serde_json::json;
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

const SPEED: f64 = 8.0;

/// Below the number of ended missions that a ledger keeps.
const MOST: usize = 400;

/// Request and mission of each acknowledgement.
type Acknowledged = Arc<Mutex<Vec<(String, String)>>>;

/// Submits missions without a pause until `ended` is set. All but the first few are canceled at
/// once, because the robots could not carry out that many.
fn load(address: String, acknowledged: Acknowledged, ended: Arc<AtomicBool>) {
    let client = Client::open(&address, "backups");
    for number in 0..MOST {
        if ended.load(Ordering::SeqCst) {
            return;
        }
        let request = format!("load-{number}");
        let mission = submit(&client, &request);
        if number >= 3 {
            client.all("api/cancel", &json!({ "mission": mission, "by": "the load" }).to_string());
        }
        acknowledged.lock().expect("no panic while it is locked").push((request, mission));
    }
}

fn ledger(file: &Path) -> (Backup, Ledger) {
    let backup: Backup = serde_json::from_slice(&fs::read(file).expect("the copy was written")).expect("a copy");
    let (ledger, _) = backup.decode().expect("it is whole");
    (backup, ledger)
}

fn has_all(ledger: &Ledger, acknowledged: &[(String, String)]) {
    for (request, mission) in acknowledged {
        let found = ledger.mission_of_request(&request.parse().expect("a name")).map(|entry| entry.id.as_str());
        assert_eq!(found, Some(mission.as_str()), "{request} was acknowledged before the backup was requested");
    }
}

#[test]
fn a_fleet_without_disks_continues_from_a_backup_made_under_load() {
    let mut fleet = Fleet::new(&with(example("fleet"), "name", "backups"));
    start_hospital(&mut fleet, SPEED);
    let address = fleet.address("world");
    let client = Client::open(&address, "backups");
    coordinator_and_term(&client);
    let (acknowledged, ended) = (Acknowledged::default(), Arc::new(AtomicBool::new(false)));
    let (load_acknowledged, stop) = (Arc::clone(&acknowledged), Arc::clone(&ended));
    let worker = std::thread::spawn(move || load(address, load_acknowledged, stop));
    until("there is something to be lost", LONG, || (acknowledged.lock().ok()?.len() >= 10).then_some(()));

    let mut positions = vec![];
    for number in 0..4 {
        let before = acknowledged.lock().expect("no panic while it is locked").clone();
        let file = fleet.path(&format!("copy-{number}.json"));
        let ran = fleet.run(&["backup", "--out", &file.display().to_string()], "world").expect(0);
        let (backup, copied_ledger) = ledger(&file);
        assert!(ran.stdout.contains(&format!("up to entry {}.{}", backup.term, backup.index)), "{}", ran.stdout);
        assert!(before.len() >= 10, "there is load");
        has_all(&copied_ledger, &before);
        positions.push((backup.term, backup.index));
        if number == 1 {
            // The next coordinator can create backups too.
            fleet.kill(&coordinator_and_term(&client).0);
        }
    }
    assert!(positions.is_sorted() && positions[0] < positions[3], "{positions:?}");
    assert!(positions[0].0 < positions[3].0, "another gave the last: {positions:?}");
    let again = fleet.path("copy-3.json").display().to_string();
    let refused = fleet.run(&["backup", "--out", &again], "world").expect(2);
    assert!(
        refused.stderr.contains("copy-3.json: this file exists already; --force replaces it"),
        "{}",
        refused.stderr
    );
    ended.store(true, Ordering::SeqCst);
    worker.join().expect("the load was borne");

    // Kills all nodes and removes all disks. Only a backup stored elsewhere remains.
    for name in fleet.names().into_iter().map(str::to_owned).collect::<Vec<_>>() {
        fleet.kill(&name);
    }
    let copy = fs::read(fleet.path("copy-3.json")).expect("the copy");
    drop((client, fleet));
    let mut fleet = Fleet::new(&with(example("fleet"), "name", "backups"));
    let (file, data) = (fleet.path("copy.json"), fleet.path("station-1-data").display().to_string());
    fs::write(&file, copy).expect("the folder can be written to");
    let file = file.display().to_string();
    let restore = ["restore", "--from", &file, "--node", STATIONS[0], "--data-dir", &data];
    let output = fleet.tool(&restore).expect(0).stdout;
    assert!(output.contains("station-1, the only voter of backups, with "), "{output}");
    let refused = fleet.tool(&restore).expect(2).stderr;
    assert!(refused.contains("this is the store of node station-1 of fleet backups; nothing was changed"), "{refused}");

    start_hospital(&mut fleet, SPEED);
    let mut client = Client::open(&fleet.address("world"), "backups");
    let (_, ledger) = ledger(Path::new(&file));
    let under_way: Vec<String> = ledger.active_missions().iter().map(|entry| entry.id.to_string()).collect();
    assert!(!under_way.is_empty(), "the first few missions were not canceled");
    let (request, mission) = acknowledged.lock().expect("no panic while it is locked")[0].clone();
    assert_eq!(submit(&client, &request), mission, "an acknowledged request is not a new request");
    client.wait_for_event("a mission of before completes", LONG * 2, |event| {
        event["event"] == "mission"
            && event["state"] == "completed"
            && under_way.iter().any(|mission| event["mission"] == mission.as_str())
    });
    until("the other stations vote again", LONG, || {
        let (_, view) = client.all("view/coordinator", "").into_iter().next()?;
        (view["voters"].as_array()?.len() == 3).then_some(())
    });
    fleet.stop();
}
