//! Packets get lost: some of them everywhere, or all of them one way.

use crate::lab::{Way, inside};
use crate::story::{agreed, begins, completes_once, coordinator, hospital, submit, succession};

const HOSTS: [&str; 8] = ["s1", "s2", "s3", "s4", "s5", "world", "ada", "lab-arm"];

#[test]
fn a_tenth_of_all_packets_is_lost_and_missions_and_takeovers_go_on() {
    inside("loss::a_tenth_of_all_packets_is_lost_and_missions_and_takeovers_go_on", &["nft"], || {
        let (mut lab, mut client) = hospital(5.0, false);
        for host in HOSTS {
            lab.lose(host, Way::In, 10);
        }
        let mission = submit(&client, "loss-1");
        begins(&mut client, &mission);
        let (first, term) = coordinator(&client);
        lab.kill(&first);
        succession(&mut client, &first, term);
        completes_once(&mut client, &mission, &lab);
    });
}

fn the_coordinator_loses_all(way: Way, request: &str) {
    let (mut lab, mut client) = hospital(5.0, false);
    let mission = submit(&client, request);
    begins(&mut client, &mission);
    let (first, term) = coordinator(&client);
    lab.lose(&first, way, 100);
    succession(&mut client, &first, term);
    completes_once(&mut client, &mission, &lab);
    lab.lose_nothing(&first);
    let last = agreed(&mut lab, &[&first, "world", "ada"]);
    assert_eq!(last, coordinator(&client).0);
}

#[test]
fn nobody_hears_the_coordinator_any_more_and_another_is_elected() {
    inside("loss::nobody_hears_the_coordinator_any_more_and_another_is_elected", &["nft"], || {
        the_coordinator_loses_all(Way::Out, "unheard");
    });
}

#[test]
fn the_coordinator_hears_nobody_any_more_and_another_is_elected() {
    inside("loss::the_coordinator_hears_nobody_any_more_and_another_is_elected", &["nft"], || {
        the_coordinator_loses_all(Way::In, "deaf");
    });
}
