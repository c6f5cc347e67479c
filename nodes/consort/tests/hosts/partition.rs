//! A partitioned network: ports are plugged into different bridges.

use crate::lab::{Lab, inside};
use crate::scenario::{
    assert_completes_once, assert_rejects_requests, coordinator, hospital, submit, wait_for_agreement,
    wait_for_completion, wait_for_first_task,
};

const STATIONS: [&str; 5] = ["s1", "s2", "s3", "s4", "s5"];

/// Returns the stations, the coordinator first.
fn from_coordinator(first: &str) -> Vec<&'static str> {
    let (mut chosen, others): (Vec<&str>, Vec<&str>) = STATIONS.into_iter().partition(|station| *station == first);
    chosen.extend(others);
    chosen
}

/// Joins the parts and waits until all agree on a coordinator.
fn heal(lab: &mut Lab) -> String {
    for station in STATIONS {
        lab.plug(station, "br0");
    }
    wait_for_agreement(lab, &STATIONS)
}

#[test]
fn three_stations_continue_without_the_coordinator_and_another() {
    inside("partition::three_stations_continue_without_the_coordinator_and_another", &[], || {
        let (mut lab, mut client) = hospital(5.0, false);
        let mission = submit(&client, "three-two");
        wait_for_first_task(&mut client, &mission);
        let (first, _) = coordinator(&client);
        let stations = from_coordinator(&first);
        for station in &stations[..2] {
            lab.plug(station, "br1");
        }
        assert_completes_once(&mut client, &mission, &lab);
        assert!(!stations[..2].contains(&coordinator(&client).0.as_str()));
        assert_rejects_requests(&mut lab, stations[0]);
        assert_rejects_requests(&mut lab, stations[1]);
        let last = heal(&mut lab);
        assert_eq!(last, coordinator(&client).0);
        assert_eq!(client.view("missions")["missions"].as_array().map(Vec::len), Some(1));
    });
}

#[test]
fn parts_without_a_majority_serve_no_requests_but_robots_continue() {
    inside("partition::parts_without_a_majority_serve_no_requests_but_robots_continue", &[], || {
        let (mut lab, mut client) = hospital(5.0, false);
        let mission = submit(&client, "two-two-one");
        wait_for_first_task(&mut client, &mission);
        let (first, _) = coordinator(&client);
        let stations = from_coordinator(&first);
        for (station, bridge) in stations[..3].iter().zip(["br1", "br1", "br2"]) {
            lab.plug(station, bridge);
        }
        for station in [stations[0], stations[2], stations[4]] {
            assert_rejects_requests(&mut lab, station);
        }
        let last = heal(&mut lab);
        assert_eq!(last, coordinator(&client).0);
        wait_for_completion(&mut client, &mission);
        // The previous coordinator may have stored a request that was never acknowledged.
        let known = client.view("missions");
        assert_eq!(known["missions"][0]["mission"], mission.as_str(), "{known}");
        assert_eq!(known["missions"][0]["state"], "completed", "{known}");
    });
}
