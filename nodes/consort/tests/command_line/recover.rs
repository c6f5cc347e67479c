use super::support::{CommandOutput, Running, command, free_address, run};
use consort_bus::{LinkModel, VirtualNetwork};
use consort_nodes::config::FleetConfig;
use consort_protocol::ids::{ClusterId, NodeId, RequestId};
use consort_protocol::ledger::{Command, Ledger, Submission};
use consort_protocol::plan::divide_and_check;
use consort_raft::store::{DurableStore, LEDGER_FILE, StoreOwner, inspect_ledger};
use consort_raft::{RaftSettings, Replica, StoreIdentity};
use consort_skills::domain::hospital;
use consort_skills::missions::shipped;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Arc;
use std::time::Duration;

const NAMES: [&str; 3] = ["ada", "bob", "cyd"];

/// A folder that is removed on drop.
struct Folder(PathBuf);

impl Folder {
    fn new(test: &str) -> Folder {
        let path = std::env::temp_dir().join(format!("consort-recover-{test}-{}", std::process::id()));
        fs::create_dir_all(&path).expect("a folder");
        Folder(path)
    }

    fn of(&self, node: &str) -> PathBuf {
        self.0.join(node)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn recover(folder: &Path, more: &[&str]) -> CommandOutput {
    run(&[&["recover", "--from", &folder.display().to_string()], more].concat())
}

fn name(name: &str) -> NodeId {
    NodeId::new(name).expect("a slug")
}

/// Creates the data directories of a stopped fleet of three nodes with two missions, one of them
/// canceled.
fn three_voters(folder: &Folder) {
    let fleet = FleetConfig::default().name;
    let template = &shipped()["lab-samples"];
    let mission = template.instantiate(&BTreeMap::new(), &hospital()).expect("a shipped mission");
    let submit = |request: &str| {
        let (request, division) = (RequestId::new(request).expect("a slug"), divide_and_check(&mission));
        let division = division.expect("a shipped mission");
        Command::Submit(Box::new(Submission::of(request, mission.clone(), division)))
    };
    let commands = [
        Command::Bootstrap { cluster: ClusterId(1) },
        submit("a"),
        submit("b"),
        Command::Cancel {
            mission: "lab-samples-2".parse().expect("a slug"),
            by: "me".into(),
            places: BTreeMap::new(),
            at_ms: 0,
        },
    ];
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build();
    runtime.expect("a runtime").block_on(async {
        let network = VirtualNetwork::new(1, LinkModel::LAN);
        let mut replicas = BTreeMap::new();
        for (number, node) in (1..).zip(NAMES.map(name)) {
            let owner = StoreOwner { fleet: fleet.clone(), node: node.clone() };
            let store = DurableStore::open(&folder.of(node.as_str()), &owner, StoreIdentity(number)).expect("a store");
            let (settings, bus) = (RaftSettings::new(fleet.clone(), node.clone()), network.bus(node.clone()));
            let seed = u64::try_from(number).expect("a small number");
            let replica = Replica::<Ledger>::start(settings, Arc::new(bus), Arc::new(store), seed).await;
            replicas.insert(node, replica.expect("a start"));
        }
        let members = replicas.iter().map(|(node, replica)| (replica.id(), node.clone())).collect();
        let ada = &replicas[&name("ada")];
        ada.bootstrap(members).await.expect("a first founding");
        let mut leadership = ada.leadership();
        let leader = leadership.wait_for(|now| now.leader.is_some()).await.expect("a replica").leader.clone();
        let leader = &replicas[&leader.expect("a leader")];
        leader.leadership().wait_for(|now| now.is_leader).await.expect("a replica");
        for command in commands {
            leader.propose(command, Duration::from_secs(5)).await.expect("a commit");
        }
        let end = *leader.applied().borrow();
        for replica in replicas.values() {
            replica.applied().wait_for(|at| *at >= end).await.expect("a replica");
        }
        for replica in replicas.into_values() {
            replica.shutdown().await;
        }
    });
}

#[test]
fn an_unrecoverable_store_is_reported_and_left_unchanged() {
    let folder = Folder::new("refused");
    let ran = recover(&folder.of("nowhere"), &["--yes"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("nowhere: there is no ledger in this directory (file ledger.redb)"), "{}", ran.err);
    assert!(!folder.of("nowhere").exists());

    let owner = StoreOwner { fleet: FleetConfig::default().name, node: name("ada") };
    let store = DurableStore::open(&folder.of("ada"), &owner, StoreIdentity(1)).expect("a store");
    let ran = recover(&folder.of("ada"), &["--yes"]);
    assert_eq!(ran.code, Some(1));
    assert!(ran.err.contains("ada: another process uses this data directory"), "{}", ran.err);
    drop(store);
    let ran = recover(&folder.of("ada"), &["--yes"]);
    assert_eq!(ran.code, Some(1));
    assert!(ran.err.contains("it has no entries: there is nothing to recover"), "{}", ran.err);

    let file = folder.of("ada").join(LEDGER_FILE);
    let whole = fs::read(&file).expect("a file");
    fs::write(&file, &whole[..whole.len() / 2]).expect("a file");
    let ran = recover(&folder.of("ada"), &["--yes"]);
    assert_eq!(ran.code, Some(1));
    assert!(ran.err.contains("ledger.redb: it is damaged: "), "{}", ran.err);
    assert!(ran.err.contains("while a majority of the other voters is alive"), "{}", ran.err);
}

#[test]
fn the_last_of_three_becomes_the_only_voter_and_coordinates_again() {
    let folder = Folder::new("done");
    three_voters(&folder);
    let cyd = folder.of("cyd");

    // Without confirmation it shows the contents, warns, and changes nothing.
    let held = || {
        let store = DurableStore::open_existing(&cyd).expect("a store");
        let held = inspect_ledger(&store).expect("a ledger");
        (held.term, held.last, held.voters.len(), held.state)
    };
    let before = held();
    let ran = recover(&cyd, &[]);
    assert_eq!(ran.code, Some(1), "{}", ran.err);
    assert!(ran.err.contains("nothing was changed; confirm with y, or use --yes"), "{}", ran.err);
    for expected in [
        "is the store of node cyd of fleet ward.",
        "voters                   ada, bob, cyd",
        "missions                 2, of which 1 has not ended",
        "lab-samples-1  pending",
        "lab-samples-2  canceled",
        "that only the disks of ada, bob hold",
        "Before cyd is started: end ada, bob, and make sure that they do not restart",
    ] {
        assert!(ran.out.contains(expected), "{expected} is missing in\n{}", ran.out);
    }
    assert_eq!(held(), before);

    let ran = recover(&cyd, &["--yes"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert!(ran.out.contains("Done: cyd is the only voter."), "{}", ran.out);
    let after = held();
    assert_eq!((after.0, after.1, after.2), (before.0, before.1, 1));
    let missions = |ledger: &Ledger| ledger.missions().cloned().collect::<Vec<_>>();
    assert_eq!(missions(&after.3), missions(&before.3));
    let cluster = after.3.cluster();
    assert!(cluster.is_some() && cluster != before.3.cluster(), "{cluster:?}");
    let copy = ran.out.lines().find(|line| line.contains("ledger.redb.before-recovery-")).expect("a copy");
    assert!(Path::new(copy.trim()).exists(), "{copy}");
    let ran = recover(&cyd, &["--yes"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert!(ran.out.contains("cyd is the only voter already: start it as usual."), "{}", ran.out);

    let address = free_address();
    let data = cyd.display().to_string();
    let station = command(&["station", "--name", "cyd", "--listen", &address, "--data-dir", &data])
        .stderr(Stdio::null())
        .spawn()
        .expect("the binary starts");
    let _station = Running(station);
    let ran = run(&["missions", "--connect", &address, "--timeout", "30"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert!(ran.out.contains("lab-samples-1") && ran.out.contains("lab-samples-2"), "{}", ran.out);
    let ran = run(&["submit", "lab-samples", "--connect", &address, "--timeout", "30"]);
    assert_eq!(ran.out, "lab-samples-3\n", "{}", ran.err);
}
