//! Hosts in a row, each with cables to its neighbours only.

use crate::lab::{Lab, inside};
use crate::scenario::{fleet, robot, with, world};
use crate::support::{LONG, example, until};
use std::time::Duration;

#[test]
fn knowledge_and_bids_cross_a_chain_of_hosts() {
    inside("multi_hop::knowledge_and_bids_cross_a_chain_of_hosts", &[], || {
        let mut lab = Lab::new(&fleet(1));
        let chain = ["s1", "lab-arm", "world", "ada"];
        for host in chain {
            lab.add_apart(host);
        }
        for pair in chain.windows(2) {
            lab.link(pair[0], pair[1]);
        }
        lab.start("station", with(example("station"), "name", "s1"), &[]);
        lab.start("robot", robot("arm"), &["s1"]);
        lab.start("world", world(5.0), &["lab-arm"]);
        lab.start("robot", robot("robot"), &["world"]);
        lab.await_open();
        for (here, there) in [("s1", "ada"), ("ada", "s1")] {
            until(&format!("{here} lists {there} as alive"), LONG, || {
                let seen = lab.run(&["fleet", "--json"], here, Duration::from_secs(30));
                seen.status.success().then_some(())?;
                let seen = seen.json();
                let nodes = seen["fleet"]["nodes"].as_array()?;
                nodes.iter().any(|node| node["node"] == there && node["alive"] == true).then_some(())
            });
        }
        let submit = ["submit", "lab-samples", "--set", "room=IC Room 6", "--wait"];
        let ended = lab.run(&submit, "ada", Duration::from_secs(60)).expect(0);
        assert!(ended.stdout.ends_with(" completed\n"), "{}", ended.stdout);
        let missions = lab.run(&["missions", "--json"], "s1", Duration::from_secs(30)).expect(0).json();
        assert_eq!(missions["missions"][0]["holders"]["r1"], "ada", "{missions}");
    });
}
