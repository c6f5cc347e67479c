//! Slow links: voters and a robot with cables of 1 Mbit/s, while clients download views.

use crate::lab::{Lab, inside};
use crate::scenario::{FLEET, coordinator, fleet, robot, submit, wait_for_first_task, wait_for_members, with, world};
use crate::support::{LONG, config, example};
use std::time::{Duration, Instant};
use zenoh::{Session, Wait};

const STATIONS: [&str; 3] = ["s1", "s2", "s3"];

const ROBOT: &str = "ada";

/// Queries of each client that are open at the same time. Their replies would delay a heartbeat by several seconds.
const QUERIES: usize = 60;

/// Bytes to download. Over at most three cables this takes at least eight seconds: longer than several elections, and than
/// the lease of a role.
const BYTES: usize = 3_000_000;

/// Minimum time for that, by the rate of the cables. A shorter download did not fill them.
const DOWNLOAD_MIN: Duration = Duration::from_secs(7);

/// Starts three voters and a robot, and a world and an arm for its missions. The voters have slow cables to each other, the
/// robot to the first of them, and all a fast one to the switch, for the clients.
fn slow_fleet() -> Lab {
    let mut settings = with(fleet(3), "timing", "wifi");
    settings.remove("link_lease_ms"); // that of the timing
    let mut lab = Lab::new(&settings);
    for (number, station) in STATIONS.into_iter().enumerate() {
        lab.add(station);
        for other in &STATIONS[..number] {
            lab.link(station, other);
            lab.limit(station, other, "1mbit");
        }
    }
    for host in [ROBOT, "world", "lab-arm"] {
        lab.add(host);
    }
    lab.link("s1", ROBOT);
    lab.limit("s1", ROBOT, "1mbit");
    for (number, station) in STATIONS.into_iter().enumerate() {
        lab.start("station", with(example("station"), "name", station), &STATIONS[..number]);
    }
    lab.start("world", world(1.0), &["s1"]); // a link with another node would lead around a slow cable
    for kind in ["robot", "arm"] {
        lab.start("robot", robot(kind), &["s1"]);
    }
    lab.await_open();
    lab
}

/// Connects a client to the fast cable of a node.
fn client(lab: &Lab, node: &str) -> Session {
    zenoh::open(config(&lab.address(node, ""), None)).wait().expect("the node is open")
}

/// Returns the number of bytes of all replies to some queries for the views of a node, except those of single missions and
/// robots.
fn download(clients: &[Session], of: &str) -> usize {
    let views = format!("consort/{FLEET}/seen/{of}/*");
    let query = |client: &Session| client.get(&views).timeout(LONG).wait().expect("a query can be sent");
    let streams: Vec<_> = clients.iter().flat_map(|client| (0..QUERIES).map(move |_| query(client))).collect();
    let replies = streams.iter().flat_map(|stream| std::iter::from_fn(move || stream.recv().ok()));
    replies.map(|reply| reply.result().map_or(0, |sample| sample.payload().len())).sum()
}

#[test]
fn downloads_over_slow_links_cost_no_coordinator_and_no_robot_its_role() {
    inside("slow_links::downloads_over_slow_links_cost_no_coordinator_and_no_robot_its_role", &["tc"], || {
        let lab = slow_fleet();
        let mut first = lab.client("s1", FLEET);
        wait_for_members(&first, STATIONS.len());
        let mission = submit(&first, "slow-1");
        wait_for_first_task(&mut first, &mission);
        let (leader, term) = coordinator(&first);
        let others = STATIONS.into_iter().chain([ROBOT]).filter(|node| *node != leader);
        let others: Vec<Session> = others.map(|node| client(&lab, node)).collect();
        let started = Instant::now();
        let mut downloaded = 0;
        while downloaded < BYTES {
            let bytes = download(&others, &leader);
            assert!(bytes > 0, "no view of {leader} arrives\n{}", lab.logs());
            downloaded += bytes;
        }
        let took = started.elapsed();
        assert!(took > DOWNLOAD_MIN, "the links are not slow: {downloaded} bytes in {took:?}");
        for node in STATIONS.into_iter().chain([ROBOT]) {
            let seen = coordinator(&lab.client(node, FLEET));
            assert_eq!(seen, (leader.clone(), term), "at {node}\n{}", lab.logs());
        }
        let is_later = |event: &&serde_json::Value| event["event"] == "elected" && event["term"].as_u64() > Some(term);
        assert_eq!(first.events().iter().filter(is_later).count(), 0, "{}", lab.logs());
        // The robot has kept its lease.
        assert!(!lab.log(ROBOT).contains("suspend"), "{}", lab.log(ROBOT));
        let view = first.view(&format!("mission/{mission}"));
        let carrier = view["roles"].as_array().into_iter().flatten().find(|role| role["role"] == "r1");
        assert_eq!(carrier.and_then(|role| role["holder"].as_str()), Some(ROBOT), "{view}");
        assert_eq!(view["released"], 0, "{view}");
    });
}
