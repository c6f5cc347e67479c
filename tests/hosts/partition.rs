//! The network falls apart: ports are plugged into different switches.

use crate::lab::{Lab, inside};
use crate::story::{agreed, begins, completes, completes_once, coordinator, hospital, serves_nobody, submit};

const STATIONS: [&str; 5] = ["s1", "s2", "s3", "s4", "s5"];

/// The stations, the coordinator first.
fn from_coordinator(first: &str) -> Vec<&'static str> {
    let (mut chosen, others): (Vec<&str>, Vec<&str>) = STATIONS.into_iter().partition(|station| *station == first);
    chosen.extend(others);
    chosen
}

/// What was parted is joined, and all agree on one coordinator.
fn heal(lab: &mut Lab) -> String {
    for station in STATIONS {
        lab.plug(station, "br0");
    }
    agreed(lab, &STATIONS)
}

#[test]
fn three_go_on_without_the_two_among_whom_the_coordinator_was() {
    inside("partition::three_go_on_without_the_two_among_whom_the_coordinator_was", &[], || {
        let (mut lab, mut client) = hospital(5.0, false);
        let mission = submit(&client, "three-two");
        begins(&mut client, &mission);
        let (first, _) = coordinator(&client);
        let stations = from_coordinator(&first);
        for station in &stations[..2] {
            lab.plug(station, "br1");
        }
        completes_once(&mut client, &mission, &lab);
        assert!(!stations[..2].contains(&coordinator(&client).0.as_str()));
        serves_nobody(&mut lab, stations[0]);
        serves_nobody(&mut lab, stations[1]);
        let last = heal(&mut lab);
        assert_eq!(last, coordinator(&client).0);
        assert_eq!(client.view("missions")["missions"].as_array().map(Vec::len), Some(1));
    });
}

#[test]
fn where_no_part_has_a_majority_nobody_is_served_and_what_is_under_way_goes_on() {
    inside("partition::where_no_part_has_a_majority_nobody_is_served_and_what_is_under_way_goes_on", &[], || {
        let (mut lab, mut client) = hospital(5.0, false);
        let mission = submit(&client, "two-two-one");
        begins(&mut client, &mission);
        let (first, _) = coordinator(&client);
        let stations = from_coordinator(&first);
        for (station, bridge) in stations[..3].iter().zip(["br1", "br1", "br2"]) {
            lab.plug(station, bridge);
        }
        for station in [stations[0], stations[2], stations[4]] {
            serves_nobody(&mut lab, station);
        }
        let last = heal(&mut lab);
        assert_eq!(last, coordinator(&client).0);
        completes(&mut client, &mission);
        // A request that nobody acknowledged may have been written down all the same by who coordinated until then.
        let known = client.view("missions");
        assert_eq!(known["missions"][0]["mission"], mission.as_str(), "{known}");
        assert_eq!(known["missions"][0]["state"], "completed", "{known}");
    });
}
