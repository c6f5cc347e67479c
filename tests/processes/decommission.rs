//! Keepers of the ledger go: for good, and for a while.

use crate::crashes::{STATIONS, keepers, reign, submit};
use crate::support::{Client, Fleet, until};
use serde_json::Value;
use std::collections::BTreeSet;
use std::time::Duration;

const LONG: Duration = Duration::from_secs(60);

/// The names in a list of a view.
fn names(list: &Value) -> BTreeSet<&str> {
    list.as_array().into_iter().flatten().filter_map(Value::as_str).collect()
}

/// Waits until a station coordinates, these have the votes, and nobody else has a copy of the ledger.
fn kept_by(client: &Client, keepers: &BTreeSet<&str>) {
    until(&format!("{keepers:?} keep the ledger"), LONG, || {
        let (_, view) = client.all("view/coordinator", "").into_iter().next()?;
        let by_them = names(&view["voters"]) == *keepers && names(&view["observers"]).is_empty();
        (by_them && keepers.contains(view["node"].as_str()?)).then_some(())
    });
}

/// The missions that the ledger has.
fn missions(client: &Client) -> Vec<String> {
    let view = client.view("missions");
    let missions = view["missions"].as_array().expect("a list").iter();
    missions.map(|entry| entry["mission"].as_str().expect("a name").to_owned()).collect()
}

/// Waits until a node begins to coordinate after a term, and says which.
fn elected_after(client: &mut Client, term: u64) -> String {
    let is_later = |event: &Value| event["event"] == "elected" && event["term"].as_u64() > Some(term);
    let elected = client.hears("another is elected", LONG, is_later);
    elected["node"].as_str().expect("a name").to_owned()
}

/// Which member of the ledger a node takes part as, by its own words.
fn member(fleet: &mut Fleet, node: &str) -> String {
    until(&format!("{node} takes part in the ledger"), LONG, || {
        let said = fleet.node(node).stderr();
        let (_, rest) = said.split_once(&format!("takes part in the ledger node={node} raft="))?;
        let (member, _) = rest.split_once('\n')?;
        Some(member.to_owned())
    })
}

#[test]
fn a_coordinator_leaves_for_good_and_the_others_keep_the_ledger_without_it() {
    let mut fleet = keepers("farewell", 1.0);
    let mut client = Client::open(&fleet.address("world"), "farewell");
    kept_by(&client, &BTreeSet::from(STATIONS));
    let before = submit(&client, "before");
    let (leaver, term) = reign(&client);

    let said = fleet.run(&["leave", &leaver], "world").expect(0).stdout;
    let successor = said.strip_prefix(&format!("{leaver} has left; "));
    let successor = successor.and_then(|rest| rest.strip_suffix(" coordinates; it keeps the ledger no more\n"));
    let left: BTreeSet<&str> = STATIONS.into_iter().filter(|station| *station != leaver).collect();
    assert!(successor.is_some_and(|successor| left.contains(successor)), "{said:?}\n{}", fleet.logs());
    let ended = fleet.ends(&leaver);
    assert!(ended.stderr.contains("it has left the fleet for good"), "{}", ended.stderr);

    assert_eq!(Some(elected_after(&mut client, term).as_str()), successor);
    kept_by(&client, &left);
    assert!(!client.present().contains(&format!("coordinator/{leaver}")), "{:?}", client.present());
    assert_eq!(submit(&client, "before"), before, "it is known still");
    let after = submit(&client, "after");
    assert_eq!(missions(&client), [before, after]);
    // It is gone: nobody answers in its stead.
    let said = fleet.run(&["leave", &leaver], "world").expect(3).stderr;
    assert!(said.contains(&format!("no node {leaver} answers in fleet farewell")), "{said}");
    fleet.stop();
}

#[test]
fn a_coordinator_that_is_terminated_hands_over_and_comes_back_as_the_member_that_it_was() {
    let mut fleet = keepers("interlude", 1.0);
    let mut client = Client::open(&fleet.address("world"), "interlude");
    kept_by(&client, &BTreeSet::from(STATIONS));
    let before = submit(&client, "before");
    let (first, term) = reign(&client);
    let was = member(&mut fleet, &first);

    fleet.node(&first).signal("TERM");
    let ended = fleet.ends(&first);
    assert!(ended.stderr.contains("handed over the coordination"), "{}", ended.stderr);
    let second = elected_after(&mut client, term);
    assert_ne!(second, first);
    kept_by(&client, &BTreeSet::from(STATIONS));
    let meanwhile = submit(&client, "meanwhile");

    fleet.start_again(&first);
    assert_eq!(member(&mut fleet, &first), was);
    // Of three votes two are needed: now its own is one of them.
    fleet.kill(&second);
    let after = submit(&client, "after");
    assert_eq!(missions(&client), [before, meanwhile, after]);
    let lost = client.view("coordinator")["voters_lost"].clone();
    assert!(!names(&lost).contains(first.as_str()), "{lost}");
    fleet.stop();
}
