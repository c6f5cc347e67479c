//! What anybody can see of a fleet.

use crate::usual::{began, fleet};
use consort_protocol::event::Happening;
use consort_tests::{Fleet, tell};
use serde_json::json;
use std::collections::BTreeSet;
use std::time::Duration;

const SEEDS: [u64; 2] = [121, 122];
const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

#[test]
fn every_view_is_answered_once_and_says_how_things_stand() {
    tell(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        let mission = fleet.submit("a", ROOM).await;
        let began = began("deposit");
        fleet.until("the deposit", SOON, |fleet| fleet.happened(&began)).await;
        // What robots say of themselves comes by gossip.
        let told = async |fleet: &Fleet| {
            let views = fleet.view("**").await;
            (views["robot/gorse"]["robot"]["availability"]["holding"]["role"] == "r1").then_some(views)
        };
        let views = fleet.seen("gorse's word that it holds r1", Duration::from_secs(2), told).await;
        let names: Vec<&str> = views.keys().map(String::as_str).collect();
        let expected = [
            "auctions",
            "coordinator",
            "fleet",
            "mission/lab-samples-1",
            "missions",
            "robot/fern",
            "robot/gorse",
            "robot/lab-arm",
            "world",
        ];
        assert_eq!(names, expected, "seed {seed}");

        let coordinator = &views["coordinator"];
        assert_eq!((&coordinator["node"], &coordinator["term"]), (&json!("aster"), &json!(1)), "seed {seed}");
        let voters: BTreeSet<&str> =
            coordinator["voters"].as_array().expect("a list").iter().filter_map(|voter| voter.as_str()).collect();
        assert_eq!(voters, BTreeSet::from(["aster", "basil", "clove", "fern", "lab-arm"]), "seed {seed}");

        let nodes = views["fleet"]["nodes"].as_array().expect("a list");
        let alive: Vec<&str> =
            nodes.iter().filter(|node| node["alive"] == true).filter_map(|node| node["node"].as_str()).collect();
        let all = ["aster", "basil", "clove", "fern", "gorse", "lab-arm", "world"];
        assert_eq!(alive, all, "seed {seed}: alive");
        let ensemble = &views["fleet"]["ensembles"][0];
        assert_eq!(ensemble["name"], "logistics", "seed {seed}");
        let members: Vec<&str> = ensemble["nodes"]
            .as_array()
            .expect("a list")
            .iter()
            .filter(|node| node["member"] == true)
            .filter_map(|node| node["node"].as_str())
            .collect();
        assert_eq!(members, ["fern", "gorse", "lab-arm"], "seed {seed}: members");

        let gorse = &views["robot/gorse"];
        let held = (&gorse["holds"]["mission"], &gorse["holds"]["role"]);
        assert_eq!(held, (&json!(mission), &json!("r1")), "seed {seed}: {gorse}");
        assert_eq!(views["robot/fern"]["holds"], json!(null), "seed {seed}");
        assert_eq!(views["robot/fern"]["robot"]["availability"], "free", "seed {seed}");

        let shown = &views["mission/lab-samples-1"];
        assert_eq!(shown["state"], "running", "seed {seed}");
        let roles: Vec<_> = shown["roles"].as_array().expect("a list").iter().collect();
        let told = |role: &serde_json::Value| {
            let text = |field: &str| role[field].as_str().unwrap_or("-").to_owned();
            (text("role"), text("kind"), text("holder"))
        };
        let told: Vec<_> = roles.into_iter().map(told).collect();
        let line = |role: &str, kind: &str, holder: &str| (role.to_owned(), kind.to_owned(), holder.to_owned());
        assert_eq!(
            told,
            [line("lab_arm", "managed", "lab-arm"), line("nurse", "unmanaged", "-"), line("r1", "managed", "gorse")],
            "seed {seed}"
        );
        assert_eq!(views["missions"]["missions"][0]["done"], shown["done"], "seed {seed}");
        assert_eq!(views["auctions"]["auctions"][0]["chosen"], json!({ "lab_arm": "lab-arm", "r1": "gorse" }));
    });
}

#[test]
fn presence_follows_life_and_office() {
    tell(SEEDS, async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        let nodes = ["aster", "basil", "clove", "fern", "gorse", "lab-arm", "world"];
        let expected = |coordinator: &str, gone: &[&str]| {
            let nodes = nodes.iter().filter(|node| !gone.contains(node)).map(|node| format!("node/{node}"));
            let robots = ["fern", "gorse", "lab-arm"].into_iter().filter(|robot| !gone.contains(robot));
            let robots = robots.map(|robot| format!("robot/{robot}"));
            nodes.chain(robots).chain([format!("coordinator/{coordinator}")]).collect::<BTreeSet<_>>()
        };
        assert_eq!(fleet.present().await, expected("1/aster", &[]), "seed {seed}");
        fleet.kill("gorse").await;
        assert_eq!(fleet.present().await, expected("1/aster", &["gorse"]), "seed {seed}");
        fleet.kill("aster").await;
        let next = fleet.coordinator().await;
        let elected = |what: &Happening| matches!(what, Happening::Elected { term, .. } if *term > 1);
        fleet.until("the next term", SOON, |fleet| fleet.happened(elected)).await;
        let term = fleet.happenings().iter().rev().find_map(|what| match what {
            Happening::Elected { term, .. } => Some(*term),
            _ => None,
        });
        let office = format!("{}/{next}", term.expect("just seen"));
        assert_eq!(fleet.present().await, expected(&office, &["gorse", "aster"]), "seed {seed}");
        fleet.start_robot("gorse").await;
        assert_eq!(fleet.present().await, expected(&office, &["aster"]), "seed {seed}");
    });
}
