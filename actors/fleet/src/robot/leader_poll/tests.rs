use super::*;
use crate::robot::test_values::at;

const CLUSTER: Option<ClusterId> = Some(ClusterId(1));

fn node(name: &str) -> NodeId {
    name.parse().unwrap()
}

fn beacon(name: &str, term: u64, voters: &[&str]) -> Beacon {
    let voters = voters.iter().map(|voter| node(voter)).collect();
    Beacon { node: node(name), term, voters, since_ms: 0, cluster: CLUSTER, wire: None }
}

fn of_term(term: u64) -> Epoch {
    Epoch { term, index: 1 }
}

/// Polls with these statements: voter, leader, term.
fn poll(check: &mut LeaderCheck, now: NodeTime, statements: &[(&str, &str, u64)]) -> (LeaderPoll, LeaderChange) {
    poll_of(check, now, statements, |_| true)
}

/// Polls, where `may_vote` checks the records of the nodes.
fn poll_of(
    check: &mut LeaderCheck,
    now: NodeTime,
    statements: &[(&str, &str, u64)],
    may_vote: impl Fn(&NodeId) -> bool,
) -> (LeaderPoll, LeaderChange) {
    let mut poll = check.begin_poll(now, may_vote).unwrap();
    for (voter, leader, term) in statements {
        poll.statements.insert(node(voter), Some(FollowedLeader { node: node(leader), term: *term }));
    }
    let change = check.end_poll(&poll, now);
    (poll, change)
}

/// Returns a check that has the beacons of a true and of a false coordinator.
fn contested() -> LeaderCheck {
    let mut check = LeaderCheck::default();
    check.hear(&beacon("aster", 3, &["aster", "basil", "clove"]), at(0));
    check.hear(&beacon("dill", u64::MAX, &["dill"]), at(0));
    check
}

const TRUE: [(&str, &str, u64); 3] = [("aster", "aster", 3), ("basil", "aster", 3), ("clove", "aster", 3)];

#[test]
fn without_certificates_no_poll_is_needed() {
    assert_eq!(LeaderCheck::default().standing(&node("dill"), of_term(9), at(0)), Standing::Confirmed);
}

#[test]
fn a_node_that_only_itself_follows_is_refuted() {
    let mut check = contested();
    assert_eq!(check.standing(&node("dill"), of_term(9), at(0)), Standing::Unconfirmed);
    assert_eq!(check.standing(&node("eve"), of_term(9), at(0)), Standing::Refuted, "it sends no beacons");
    let lie = ("dill", "dill", u64::MAX);
    let (result, change) = poll(&mut check, at(0), &[TRUE[0], TRUE[1], lie]);
    assert_eq!(change, LeaderChange { new_session: true, other_cluster: false });
    assert!(result.is_impostor(&node("dill")) && !result.is_impostor(&node("aster")));
    assert!(!result.is_unopposed(&node("dill")) && !result.is_unopposed(&node("aster")));
    assert_eq!(check.standing(&node("aster"), of_term(3), at(0)), Standing::Confirmed);
    assert_eq!(check.standing(&node("aster"), of_term(4), at(0)), Standing::Unconfirmed, "a later term");
    assert_eq!(check.standing(&node("dill"), of_term(9), at(1_999)), Standing::Refuted);
    assert_eq!(check.standing(&node("dill"), of_term(9), at(2_000)), Standing::Unconfirmed);
}

#[test]
fn voters_that_a_false_coordinator_names_do_not_count_for_it() {
    let mut check = contested();
    check.hear(&beacon("dill", u64::MAX, &["basil", "clove", "dill"]), at(0));
    let (_, change) = poll(&mut check, at(0), &[("dill", "dill", u64::MAX), ("basil", "aster", 3)]);
    assert_eq!(change, LeaderChange::default(), "undecided");
    assert_eq!(check.standing(&node("dill"), of_term(9), at(0)), Standing::Unconfirmed);
}

#[test]
fn the_confirmed_coordinator_of_a_single_voter_keeps_its_place() {
    let mut check = LeaderCheck::default();
    check.hear(&beacon("aster", 3, &["aster"]), at(0));
    assert!(poll(&mut check, at(0), &TRUE[..1]).1.new_session);
    check.hear(&beacon("dill", u64::MAX, &["dill"]), at(0));
    let (_, change) = poll(&mut check, at(0), &[TRUE[0], ("dill", "dill", u64::MAX)]);
    assert_eq!(change, LeaderChange::default());
    assert_eq!(check.standing(&node("dill"), of_term(9), at(0)), Standing::Refuted);
}

#[test]
fn the_next_coordinator_is_confirmed_and_the_former_is_not() {
    let mut check = contested();
    poll(&mut check, at(0), &TRUE);
    check.hear(&beacon("basil", 4, &["aster", "basil", "clove"]), at(3_000));
    let (_, change) = poll(&mut check, at(3_000), &[("basil", "basil", 4), ("clove", "basil", 4), TRUE[0]]);
    assert_eq!(change, LeaderChange { new_session: true, other_cluster: false });
    assert_eq!(check.standing(&node("basil"), of_term(4), at(3_000)), Standing::Confirmed);
    assert_eq!(check.standing(&node("aster"), of_term(3), at(3_000)), Standing::Refuted);
}

#[test]
fn a_node_that_only_itself_follows_does_not_lead_while_others_are_late() {
    let mut check = contested();
    let (result, change) = poll(&mut check, at(0), &[("dill", "dill", u64::MAX)]);
    assert_eq!(change, LeaderChange::default());
    assert!(!result.is_unopposed(&node("dill")) && !result.is_impostor(&node("dill")));
    assert_eq!(check.standing(&node("dill"), of_term(9), at(0)), Standing::Unconfirmed);
}

#[test]
fn a_beacon_with_more_voters_than_a_fleet_has_is_ignored() {
    let mut check = LeaderCheck::default();
    let names: Vec<String> = (0..=VOTERS_MAX).map(|number| format!("v{number}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    assert!(!check.hear(&beacon("eve", 9, &names), at(0)) && check.hear(&beacon("eve", 9, &names[1..]), at(0)));
}

#[test]
fn invented_voters_of_a_false_coordinator_do_not_count_as_late() {
    let mut check = contested();
    check.hear(&beacon("dill", u64::MAX, &["dill", "v1", "v2", "v3", "v4"]), at(0));
    let may_vote = |node: &NodeId| !node.as_str().starts_with('v');
    let (_, change) = poll_of(&mut check, at(0), &TRUE, may_vote);
    assert!(change.new_session);
    assert_eq!(check.standing(&node("aster"), of_term(3), at(0)), Standing::Confirmed);
}

#[test]
fn a_beacon_of_a_later_term_ends_the_confirmation_until_the_next_poll() {
    let mut check = LeaderCheck::default();
    check.hear(&beacon("aster", 3, &["aster", "basil", "clove"]), at(0));
    poll(&mut check, at(0), &TRUE);
    check.hear(&Beacon { cluster: Some(ClusterId(2)), ..beacon("eve", 9, &["eve"]) }, at(5_000));
    check.hear(&beacon("aster", 3, &["aster", "basil", "clove"]), at(5_000));
    assert_eq!(check.standing(&node("aster"), of_term(3), at(5_000)), Standing::Confirmed, "of another cluster");
    check.hear(&beacon("basil", 4, &["aster", "basil", "clove"]), at(5_000));
    assert_eq!(check.standing(&node("aster"), of_term(3), at(5_000)), Standing::Unconfirmed);
    let (result, change) = poll(&mut check, at(5_000), &[TRUE[0], ("basil", "basil", 4), ("clove", "basil", 4)]);
    assert!(change.new_session);
    assert_eq!(check.standing_after(&result, &node("aster"), of_term(3), at(5_000)), Standing::Refuted);
    assert_eq!(check.standing(&node("aster"), of_term(3), at(7_000)), Standing::Unconfirmed, "the key is stolen");
}

/// A node that only itself follows does not keep the robots from a coordinator that was confirmed before.
#[test]
fn an_undecided_poll_keeps_a_confirmed_coordinator_with_a_follower() {
    let mut check = contested();
    poll(&mut check, at(0), &TRUE);
    check.hear(&beacon("aster", 3, &["aster", "basil", "clove"]), at(3_000));
    check.hear(&beacon("dill", u64::MAX, &["basil", "clove", "dill"]), at(3_000));
    let lie = ("dill", "dill", u64::MAX);
    for (statements, expected) in [
        (&[TRUE[1], lie][..], Standing::Confirmed),
        (&[TRUE[0], lie][..], Standing::Refuted), // it may have been replaced
        (&[TRUE[1], lie, ("clove", "dill", 4)][..], Standing::Refuted),
    ] {
        let (result, change) = poll(&mut check, at(3_000), statements);
        assert_eq!(change, LeaderChange::default(), "{statements:?}");
        let after = |name| check.standing_after(&result, &node(name), of_term(3), at(3_000));
        assert_eq!((after("aster"), after("dill")), (expected, Standing::Refuted), "{statements:?}");
    }
}

#[test]
fn a_poll_is_decided_once_late_statements_change_nothing() {
    let mut check = LeaderCheck::default();
    check.hear(&beacon("aster", 3, &["aster", "basil", "clove"]), at(0));
    let mut poll = check.begin_poll(at(0), |_| true).unwrap();
    assert!(check.begin_poll(at(599), |_| true).is_none() && check.begin_poll(at(600), |_| true).is_some());
    for (voter, leader, term) in &TRUE[..2] {
        assert_eq!(poll.leader(), None);
        poll.statements.insert(node(voter), Some(FollowedLeader { node: node(leader), term: *term }));
    }
    assert!(poll.leader().is_some() && poll.is_unopposed(&node("aster")));
}

#[test]
fn a_beacon_of_another_cluster_counts_once_its_voters_confirm_it() {
    let mut check = contested();
    poll(&mut check, at(0), &TRUE);
    let moved = Beacon { cluster: Some(ClusterId(2)), ..beacon("eve", 1, &["eve"]) };
    check.hear(&moved, at(1));
    assert!(check.has_moved(&moved, at(1)) && !check.has_moved(&beacon("basil", 4, &[]), at(1)));
    assert_eq!(poll(&mut check, at(1), &TRUE).1, LeaderChange::default());
    assert!(!check.has_moved(&moved, at(1)), "refuted");
    check.hear(&moved, at(11_000));
    let (_, change) = poll(&mut check, at(11_000), &[("eve", "eve", 1)]);
    assert_eq!(change, LeaderChange { new_session: true, other_cluster: true });
}
