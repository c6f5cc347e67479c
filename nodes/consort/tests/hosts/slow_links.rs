//! Slow links: voters with cables of 1 Mbit/s, while clients download views.

use crate::lab::{Lab, inside};
use crate::scenario::{FLEET, coordinator, fleet, with};
use crate::support::{LONG, config, example, until};
use std::time::{Duration, Instant};
use zenoh::{Session, Wait};

const STATIONS: [&str; 3] = ["s1", "s2", "s3"];

/// Queries of each client that are open at the same time. Their replies would delay a heartbeat by several seconds.
const QUERIES: usize = 60;

/// Bytes to download. Over two cables this takes eight seconds, longer than several elections.
const BYTES: usize = 2_000_000;

/// Minimum time for that, by the rate of the cables. A shorter download did not fill them.
const DOWNLOAD_MIN: Duration = Duration::from_secs(7);

/// Starts three voters. Each has a slow cable to each other, and a fast one to the switch, for the clients.
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
    for (number, station) in STATIONS.into_iter().enumerate() {
        lab.start("station", with(example("station"), "name", station), &STATIONS[..number]);
    }
    lab.await_open();
    lab
}

/// Connects a client to the fast cable of a station.
fn client(lab: &Lab, station: &str) -> Session {
    zenoh::open(config(&lab.address(station, ""), None)).wait().expect("the station is open")
}

/// Returns the number of bytes of all replies to some queries for the views of a node.
fn download(clients: &[Session], of: &str) -> usize {
    let views = format!("consort/{FLEET}/seen/{of}/**");
    let query = |client: &Session| client.get(&views).timeout(LONG).wait().expect("a query can be sent");
    let streams: Vec<_> = clients.iter().flat_map(|client| (0..QUERIES).map(move |_| query(client))).collect();
    let replies = streams.iter().flat_map(|stream| std::iter::from_fn(move || stream.recv().ok()));
    replies.map(|reply| reply.result().map_or(0, |sample| sample.payload().len())).sum()
}

#[test]
fn downloads_over_slow_links_replace_no_coordinator() {
    inside("slow_links::downloads_over_slow_links_replace_no_coordinator", &["tc"], || {
        let lab = slow_fleet();
        let mut first = lab.client("s1", FLEET);
        until("there are three voters", LONG, || {
            let (_, view) = first.all("view/coordinator", "").into_iter().next()?;
            (view["voters"].as_array()?.len() == 3).then_some(())
        });
        let (leader, term) = coordinator(&first);
        let followers = STATIONS.into_iter().filter(|station| *station != leader);
        let followers: Vec<Session> = followers.map(|station| client(&lab, station)).collect();
        let started = Instant::now();
        let mut downloaded = 0;
        while downloaded < BYTES {
            let bytes = download(&followers, &leader);
            assert!(bytes > 0, "no view of {leader} arrives\n{}", lab.logs());
            downloaded += bytes;
        }
        let took = started.elapsed();
        assert!(took > DOWNLOAD_MIN, "the links are not slow: {downloaded} bytes in {took:?}");
        for station in STATIONS {
            let seen = coordinator(&lab.client(station, FLEET));
            assert_eq!(seen, (leader.clone(), term), "at {station}\n{}", lab.logs());
        }
        let elected = first.events().iter().filter(|event| event["event"] == "elected" && event["term"] != term);
        assert_eq!(elected.count(), 0, "{}", lab.logs());
    });
}
