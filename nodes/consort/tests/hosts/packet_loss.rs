//! Packet loss: some packets at all hosts, or all packets in a direction.

use crate::lab::inside;
use crate::scenario::{
    assert_completes_once, assert_completes_once_despite_loss, coordinator, hospital, submit, wait_for_agreement,
    wait_for_first_task, wait_for_successor,
};
use consort_tests::host_network::Way;

const HOSTS: [&str; 8] = ["s1", "s2", "s3", "s4", "s5", "world", "ada", "lab-arm"];

#[test]
fn missions_and_takeovers_survive_a_tenth_of_packet_loss() {
    inside("packet_loss::missions_and_takeovers_survive_a_tenth_of_packet_loss", &["nft"], || {
        let (mut lab, mut client) = hospital(5.0, false);
        for host in HOSTS {
            lab.lose(host, Way::In, 10);
        }
        let mission = submit(&client, "loss-1");
        wait_for_first_task(&mut client, &mission);
        let (first, term) = coordinator(&client);
        lab.kill(&first);
        wait_for_successor(&mut client, &first, term);
        assert_completes_once_despite_loss(&mut client, &mission, &lab);
    });
}

fn the_coordinator_loses_all(way: Way, request: &str) {
    let (mut lab, mut client) = hospital(5.0, false);
    let mission = submit(&client, request);
    wait_for_first_task(&mut client, &mission);
    let (first, term) = coordinator(&client);
    lab.lose(&first, way, 100);
    wait_for_successor(&mut client, &first, term);
    assert_completes_once(&mut client, &mission, &lab);
    lab.lose_nothing(&first);
    let last = wait_for_agreement(&mut lab, &[&first, "world", "ada"]);
    assert_eq!(last, coordinator(&client).0);
}

#[test]
fn a_coordinator_whose_packets_are_lost_is_replaced() {
    inside("packet_loss::a_coordinator_whose_packets_are_lost_is_replaced", &["nft"], || {
        the_coordinator_loses_all(Way::Out, "unheard");
    });
}

#[test]
fn a_coordinator_that_receives_no_packets_is_replaced() {
    inside("packet_loss::a_coordinator_that_receives_no_packets_is_replaced", &["nft"], || {
        the_coordinator_loses_all(Way::In, "deaf");
    });
}
