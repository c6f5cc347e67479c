//! Voters leave for good or for a while.

use crate::crashes::{STATIONS, coordinator_and_term, start_voters, submit};
use crate::support::{Client, Fleet, LONG, until};
use serde_json::Value;
use std::collections::BTreeSet;

/// Returns the names in a list of a view.
fn names(list: &Value) -> BTreeSet<&str> {
    list.as_array().into_iter().flatten().filter_map(Value::as_str).collect()
}

/// Waits until a station coordinates, these stations are the voters, and there are no learners.
fn kept_by(client: &Client, start_voters: &BTreeSet<&str>) {
    until(&format!("{start_voters:?} are the voters"), LONG, || {
        let (_, view) = client.all("view/coordinator", "").into_iter().next()?;
        let by_them = names(&view["voters"]) == *start_voters && names(&view["learners"]).is_empty();
        (by_them && start_voters.contains(view["node"].as_str()?)).then_some(())
    });
}

/// Returns the missions in the ledger.
fn missions(client: &Client) -> Vec<String> {
    let view = client.view("missions");
    let missions = view["missions"].as_array().expect("a list").iter();
    missions.map(|entry| entry["mission"].as_str().expect("a name").to_owned()).collect()
}

/// Waits for an election after a term and returns the new coordinator.
fn elected_after(client: &mut Client, term: u64) -> String {
    let is_later = |event: &Value| event["event"] == "elected" && event["term"].as_u64() > Some(term);
    let elected = client.wait_for_event("another is elected", LONG, is_later);
    elected["node"].as_str().expect("a name").to_owned()
}

/// Returns the Raft member id of a node from its log.
fn member(fleet: &mut Fleet, node: &str) -> String {
    until(&format!("{node} replica started"), LONG, || {
        let output = fleet.node(node).stderr();
        let (_, rest) = output.split_once(&format!("replica started node={node} raft="))?;
        let (member, _) = rest.split_once('\n')?;
        Some(member.to_owned())
    })
}

#[test]
fn a_coordinator_is_decommissioned_and_the_others_stay_voters() {
    let mut fleet = start_voters("farewell", 1.0);
    let mut client = Client::open(&fleet.address("world"), "farewell");
    kept_by(&client, &BTreeSet::from(STATIONS));
    let before = submit(&client, "before");
    let (leaver, term) = coordinator_and_term(&client);

    let output = fleet.run(&["leave", &leaver], "world").expect(0).stdout;
    let successor = output.strip_prefix(&format!("{leaver} has left; "));
    let successor = successor.and_then(|rest| rest.strip_suffix(" is the coordinator; it is no longer a voter\n"));
    let left: BTreeSet<&str> = STATIONS.into_iter().filter(|station| *station != leaver).collect();
    assert!(successor.is_some_and(|successor| left.contains(successor)), "{output:?}\n{}", fleet.logs());
    let ended = fleet.ends(&leaver);
    assert!(ended.stderr.contains("decommissioned"), "{}", ended.stderr);

    assert_eq!(Some(elected_after(&mut client, term).as_str()), successor);
    kept_by(&client, &left);
    assert!(!client.present().contains(&format!("coordinator/{leaver}")), "{:?}", client.present());
    assert_eq!(submit(&client, "before"), before, "it is known still");
    let after = submit(&client, "after");
    assert_eq!(missions(&client), [before, after]);
    // The node is gone: no other node answers for it.
    let output = fleet.run(&["leave", &leaver], "world").expect(3).stderr;
    assert!(output.contains(&format!("no node {leaver} answers in fleet farewell")), "{output}");
    fleet.stop();
}

#[test]
fn a_terminated_coordinator_transfers_the_lead_and_rejoins() {
    let mut fleet = start_voters("interlude", 1.0);
    let mut client = Client::open(&fleet.address("world"), "interlude");
    kept_by(&client, &BTreeSet::from(STATIONS));
    let before = submit(&client, "before");
    let (first, term) = coordinator_and_term(&client);
    let was = member(&mut fleet, &first);

    fleet.node(&first).signal("TERM");
    let ended = fleet.ends(&first);
    assert!(ended.stderr.contains("leadership transferred"), "{}", ended.stderr);
    let second = elected_after(&mut client, term);
    assert_ne!(second, first);
    kept_by(&client, &BTreeSet::from(STATIONS));
    let meanwhile = submit(&client, "meanwhile");

    fleet.start_again(&first);
    assert_eq!(member(&mut fleet, &first), was);
    // Two of three votes are needed, so its own vote is required now.
    fleet.kill(&second);
    let after = submit(&client, "after");
    assert_eq!(missions(&client), [before, meanwhile, after]);
    let lost = client.view("coordinator")["voters_lost"].clone();
    assert!(!names(&lost).contains(first.as_str()), "{lost}");
    fleet.stop();
}
