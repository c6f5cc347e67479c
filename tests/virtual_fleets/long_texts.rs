//! Texts of other nodes and of clients that are nearly as long as a message.

use crate::support::fleet;
use consort_bus::{Bus as _, reply};
use consort_protocol::auction::{BidRefusal, BidResponse, CallForBids, RefusalReason, RoleReply};
use consort_protocol::codec;
use consort_protocol::ids::RobotId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::Command;
use consort_protocol::message::ClusterEnvelope;
use consort_tests::{Fleet, Observation, for_each_seed};
use serde_json::json;
use std::time::Duration;

const ROOM: &str = "IC Room 6";
const SOON: Duration = Duration::from_secs(60);

/// Answers calls for bids as a robot that refuses each role at length.
async fn refuse_at_length(fleet: &Fleet, name: &str) {
    let (robot, key) = (RobotId::new(name).expect("a name"), format!("consort/ward/wire/bid/{name}"));
    let bus = fleet.network.bus(name.parse().expect("a name"));
    let mut calls = bus.serve(&key).await.expect("a virtual bus");
    tokio::spawn(async move {
        while let Some(query) = calls.recv().await {
            let envelope: ClusterEnvelope = codec::decode(&query.payload).expect("an envelope");
            let call: CallForBids = codec::decode(&envelope.payload).expect("a call");
            let refusal = |role: &_| {
                let reason = RefusalReason::OutOfService { problem: "no route; ".repeat(2_500) };
                RoleReply::Refusal(BidRefusal { robot: robot.clone(), role: Clone::clone(role), reason })
            };
            let replies = call.roles.keys().map(refusal).collect();
            let response = BidResponse { robot: robot.clone(), auction: call.auction, replies };
            reply::wire(&query, &key, &response).await;
        }
        drop(bus);
    });
}

#[test]
fn long_refusals_do_not_prevent_an_award() {
    for_each_seed([131, 132], async |seed| {
        let mut fleet = fleet(seed, ROOM).await;
        for name in ["quince", "rowan", "sorrel"] {
            refuse_at_length(&fleet, name).await;
        }
        // The coordinator waits for the bids of this robot, and receives the refusals meanwhile.
        fleet.network.cut("aster".parse().expect("a name"), "gorse".parse().expect("a name"));
        let mission = fleet.submit("a", ROOM).await;
        fleet.assert_completes(&mission).await;
    });
}

#[test]
fn the_log_contains_no_long_text_of_a_client() {
    for_each_seed([131, 132], async |seed| {
        let fleet = fleet(seed, ROOM).await;
        let mission = fleet.submit("a", ROOM).await;
        let (by, reason) = ("Nia ".repeat(5_000), "a spill ".repeat(2_500));
        let hold = json!({ "robots": "all", "reason": reason, "by": by });
        // The coordinator first needs the records of the robots.
        let held = async |fleet: &Fleet| {
            let reply = fleet.request(ApiCall::Hold, &hold).await?;
            reply.get("error").is_none().then_some(reply)
        };
        fleet.poll_until("a hold", SOON, held).await;
        fleet.request_answered(ApiCall::Cancel, &json!({ "mission": mission, "by": by })).await;
        let entries = fleet.event_log.entries();
        let commands = entries.iter().flat_map(|(_, entry)| match entry {
            Observation::EntryApplied { commands, .. } => &commands[..],
            _ => &[],
        });
        let of_clients: Vec<_> = commands
            .filter(|command| matches!(command, Command::OrderRobots { .. } | Command::Cancel { .. }))
            .collect();
        assert!(of_clients.iter().any(|command| matches!(command, Command::OrderRobots { .. })), "seed {seed}");
        assert!(of_clients.iter().any(|command| matches!(command, Command::Cancel { .. })), "seed {seed}");
        for command in of_clients {
            assert_eq!(command.clone().limited(), *command, "seed {seed}");
        }
    });
}
