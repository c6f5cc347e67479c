//! Missions for the tests of invariants.

use crate::slug;
use consort_protocol::auction::{AuctionId, AuctionRecord};
use consort_protocol::ids::MissionId;
use consort_protocol::ledger::{Branch, Command, MissionCancelation, OrderRequest, Submission};
use consort_protocol::mission::{Format, MissionTemplate};
use consort_protocol::plan::divide_and_check;
use consort_skills::domain::hospital;
use std::collections::BTreeMap;

const REST: &str = r#"{"mission": "rest", "roles": {"r1": {"kind": "managed"}},
    "root": {"task": "rest", "type": "wait", "roles": ["r1"], "parameters": {"seconds": "5"}}}"#;

/// Returns the request for a rest. The first mission is `rest-1`.
pub(in crate::chaos) fn submit_rest(request: &str) -> Command {
    let mission = MissionTemplate::parse(REST, Format::Json).unwrap();
    let mission = mission.instantiate(&BTreeMap::new(), &hospital()).unwrap();
    let division = divide_and_check(&mission).unwrap();
    Command::Submit(Box::new(Submission::of(slug(request), mission, division)))
}

/// Returns the award of a rest to a robot.
pub(in crate::chaos) fn award_rest(number: u32, robot: &str) -> Command {
    let mission: MissionId = slug(&format!("rest-{number}"));
    let holders = BTreeMap::from([(slug("r1"), slug(robot))]);
    let auction = AuctionRecord::empty(AuctionId { mission: mission.clone(), term: 1, round: 1 });
    Command::Award { mission, branch: Branch::Main, holders, auction }
}

/// Returns the cancelation of several missions by a person.
pub(in crate::chaos) fn cancel(by: &str, missions: &[&str]) -> Command {
    let missions = missions.iter().map(|mission| (slug(mission), BTreeMap::new())).collect();
    let change = MissionCancelation { missions };
    Command::CancelMissions { order: OrderRequest { change, by: by.to_owned(), at_ms: 9, request: None } }
}
