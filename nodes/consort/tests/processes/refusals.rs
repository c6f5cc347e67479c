//! A stock Zenoh client with the certificate of a robot answers the queries of consensus and the reports of robots, over
//! TLS: it refuses them at once, in place of the nodes that they are for.

use crate::closed::session;
use crate::support::{Client, Closed, LONG, example, until};
use consort_protocol::lease::LeaseTerms;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;
use zenoh::Wait;

const STATIONS: [&str; 3] = ["station-1", "station-2", "station-3"];

/// Starts stations as voters, and the robots without votes. `eve` has a certificate, and no node.
fn start() -> Closed {
    let mut file = example("fleet");
    // An election on a busy machine would be mistaken for the effect of a refusal.
    file.insert("timing".to_owned(), "wifi".into());
    file.remove("link_lease_ms"); // that of the timing
    let mut closed = Closed::with_fleet(&file);
    closed.cert(&["node", "eve", "--roles", "robot"]);
    for (number, name) in STATIONS.into_iter().enumerate() {
        if number > 0 {
            closed.cert(&["node", name, "--roles", "voter"]);
        }
        let mut station = example("station");
        station.insert("name".to_owned(), name.into());
        closed.start("station", station, &STATIONS[..number]);
    }
    // At the speed of the example the mission takes longer than a lease and its grace.
    closed.start("world", example("world"), &["station-1"]);
    for kind in ["robot", "arm"] {
        let mut robot = example(kind);
        robot.insert("may_vote".to_owned(), false.into());
        closed.start("robot", robot, &["station-1", "world"]);
    }
    closed
}

/// Refuses all queries on a key at once, until the session is closed. Counts the refusals.
fn refuse_all(session: &zenoh::Session, key: &str, refused: &Arc<AtomicU64>) {
    let refused = Arc::clone(refused);
    let refuse = move |query: zenoh::query::Query| {
        // The node that asks may have a reply already.
        let _ = query.reply_err("no").wait();
        refused.fetch_add(1, Ordering::Relaxed);
    };
    let declared = session.declare_queryable(format!("consort/ward/{key}")).callback(refuse).background().wait();
    declared.expect("a queryable can be declared");
}

#[test]
fn a_stock_client_that_refuses_everything_deposes_no_leader() {
    let mut closed = start();
    let mut client = Client::open_with(&closed.fleet.address("station-1"), "ward", Some(&closed.of("read")));
    let before = until("a coordinator of three voters", LONG, || {
        let view = client.view("coordinator");
        (view["node"].is_string() && view["voters"].as_array()?.len() == STATIONS.len()).then_some(view)
    });
    let coordinator = before["node"].as_str().expect("checked before").to_owned();

    let attacked = client.events().len();
    // With a link to each node it refuses sooner than the addressed node replies.
    let refused: [Arc<AtomicU64>; 2] = Default::default();
    let eve = STATIONS.into_iter().chain(["ada", "lab-arm"]).map(|name| {
        let address = closed.fleet.address(name);
        let eve = session(&address, Some(&closed.of("eve"))).expect("a link");
        for (key, refused) in ["wire/raft/**", "wire/report/*"].into_iter().zip(&refused) {
            refuse_all(&eve, key, refused);
        }
        eve
    });
    let eve: Vec<zenoh::Session> = eve.collect();
    until("refusals of consensus", LONG, || (refused[0].load(Ordering::Relaxed) > 0).then_some(()));

    let certs = closed.of("submit").display().to_string();
    let submit = ["submit", "lab-samples", "--set", "room=IC Room 6", "--wait", "--certs", &certs];
    let waiting = closed.fleet.begin(&submit, "station-1");
    client.wait_for_event("a robot begins", LONG, |event| event["event"] == "task_began");
    let began = Instant::now();
    let ended = waiting.end(LONG).expect(0);
    assert!(ended.stdout.ends_with("completed\n"), "{}", ended.stdout);
    let (held, terms) = (began.elapsed(), LeaseTerms::default());
    assert!(held > terms.lease + terms.grace, "the leases of the robots were renewed: {held:?}");

    let after = client.view("coordinator");
    assert_eq!((&after["node"], &after["term"]), (&before["node"], &before["term"]), "the leader leads on");
    for event in &client.events()[attacked..] {
        let kind = event["event"].as_str().expect("a kind");
        assert!(!["elected", "stepped_down", "suspended", "released"].contains(&kind), "{event}");
    }
    let counts = refused.each_ref().map(|refused| refused.load(Ordering::Relaxed));
    assert!(counts.iter().all(|count| *count > 5), "refused queries of consensus, and reports: {counts:?}");
    until("the coordinator logs unsigned refusals", LONG, || {
        let log = closed.refused(&coordinator);
        log.lines()
            .any(|line| line.contains("message on wire/raft/") && line.contains("it is not signed"))
            .then_some(())
    });
    drop((client, eve));
    closed.fleet.stop();
}
