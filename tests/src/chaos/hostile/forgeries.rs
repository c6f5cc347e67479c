//! Well-formed messages and requests that no node may accept from the hostile node, and bids that it never confirms.
//!
//! They draw random numbers of their own, so that the other attacks of a seed stay the same.

use super::{Attacker, HOSTILE, MAX_EPOCH, latest, wire};
use crate::slug;
use bytes::Bytes;
use consort_bus::record_signer::SharedRecordSigner;
use consort_bus::{Encoding, Query, Stream};
use consort_fleet::robot_driver::{DriverCommand, DriverState, GoalRequest, Permit, StateStamp};
use consort_gossip::SharedKnowledge;
use consort_protocol::auction::{Bid, BidResponse, CallForBids, RoleReply};
use consort_protocol::codec;
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::keys::{ApiCall, DriverCall, Key};
use consort_protocol::knowledge::{Digest, DigestScope};
use consort_protocol::lease::EndReason;
use consort_protocol::ledger::{Ledger, PersonRequestId, RolePhase};
use consort_protocol::message::{AlarmNotice, AwardNotice, Exchange, OrderNotice, OrdersNotice};
use consort_protocol::units::{BatteryShare, Seconds};
use consort_protocol::versions::VersionRange;
use consort_raft::Replica;
use consort_skills::actions::{RobotBackend as _, Telemetry};
use consort_world::SharedWorld;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

/// Time between two forgeries.
const PAUSE_MS: Range<u64> = 300..1_500;

/// Share of the calls for bids to which the hostile node bids.
const BIDS: f64 = 0.2;

/// A place of the map.
const PLACE: &str = "IC Room 6";

/// Sources of the content that the hostile node forges: the whole state of the fleet.
pub(super) struct Sources {
    pub(super) replicas: Vec<Replica<Ledger>>,
    pub(super) known: Option<SharedKnowledge>,
    pub(super) world: SharedWorld,
    /// Signs records with the key of the hostile node.
    pub(super) signer: SharedRecordSigner,
}

/// What a request changes.
#[derive(Default)]
struct Target {
    mission: Option<MissionId>,
    role: Option<RoleId>,
    question: Option<PersonRequestId>,
}

impl Attacker {
    /// Sends forgeries of all kinds, until it is aborted.
    pub(super) async fn forge(self: Arc<Self>, sources: Sources, seed: u64) {
        let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0xf04e);
        loop {
            let victim = self.victims.choose(&mut chance).expect("a fleet has nodes").clone();
            let robot = RobotId::from(victim.clone());
            match chance.random_range(0..5) {
                0 | 1 => self.change(&sources, &mut chance).await,
                2 => self.notify(&sources, &robot).await,
                3 => self.drive(&sources, &robot, &mut chance).await,
                _ => self.pass_on_a_record(&sources, victim, &mut chance).await,
            }
            let pause = Duration::from_millis(chance.random_range(PAUSE_MS));
            tokio::time::sleep(pause).await; // virtual time
        }
    }

    /// Requests a change as people do, with its own signature and with the captured signature of another request.
    async fn change(&self, sources: &Sources, chance: &mut ChaCha8Rng) {
        let changes: Vec<ApiCall> = ApiCall::ALL.iter().copied().filter(|call| !call.is_read_only()).collect();
        let call = *changes.choose(chance).expect("some calls change something");
        let targets: Vec<Target> = latest(&sources.replicas, |ledger| {
            let targets = ledger.missions().map(|entry| Target {
                mission: Some(entry.id.clone()),
                role: entry.roles.keys().next().cloned(),
                question: entry.person_requests().next().map(|(id, _)| id),
            });
            targets.collect()
        });
        let target = targets.choose(chance);
        let request = format!("{HOSTILE}-{}", chance.random::<u32>());
        let Some(payload) = payload_of(call, target.unwrap_or(&Target::default()), &request) else { return };
        let (key, payload) = (self.keys.write(&Key::Api(call)), Bytes::from(payload.to_string()));
        self.query(&self.signing, &key, payload.clone(), Bytes::new()).await;
        let captured: Vec<Bytes> = {
            let requests = self.requests.lock().unwrap_or_else(PoisonError::into_inner);
            requests.iter().map(|(_, _, attachment)| attachment.clone()).collect()
        };
        if let Some(attachment) = captured.choose(chance) {
            self.query(&self.plain, &key, payload, attachment.clone()).await;
        }
    }

    /// Sends a robot the notices of a coordinator: it is held, there is an alarm, and its role has ended.
    async fn notify(&self, sources: &Sources, robot: &RobotId) {
        let order = OrderNotice { text: format!("held by {HOSTILE}"), remaining_ms: None };
        let alarm = AlarmNotice { order: order.clone(), places: BTreeSet::new(), closes: BTreeSet::new() };
        let (hold, alarm) = (Some(order), Some(alarm));
        let orders = OrdersNotice { as_of: MAX_EPOCH, hold, alarm, ..OrdersNotice::default() };
        let award = latest(&sources.replicas, |ledger| {
            let roles = ledger.missions().flat_map(|entry| entry.roles.values());
            let current = roles.filter(|role| matches!(role.phase, RolePhase::Awarded | RolePhase::Active));
            let mut holders = current.filter_map(|role| role.holder.as_ref());
            holders.find(|holder| holder.robot == *robot).map(|holder| holder.epoch)
        });
        let end = award.map(|epoch| AwardNotice::Revoked { epoch, reason: EndReason::Canceled });
        let key = self.keys.write(&Key::Award(robot.clone()));
        for notice in [AwardNotice::Orders(Box::new(orders))].into_iter().chain(end) {
            self.query(&self.in_cluster, &key, wire(&notice), Bytes::new()).await;
        }
    }

    /// States for the driver server of a robot that it is elsewhere and does not move, and cancels its latest goal in
    /// the name of its node.
    async fn drive(&self, sources: &Sources, robot: &RobotId, chance: &mut ChaCha8Rng) {
        let Some(telemetry) = sources.world.telemetry(robot) else { return };
        let telemetry = Telemetry { place: slug(HOSTILE), able: false, ..telemetry };
        let stamp = StateStamp { boot: chance.random(), sequence: u64::MAX };
        let state = DriverState { robot: robot.clone(), stamp, telemetry, goals: vec![], completed: vec![] };
        let key = self.keys.write(&Key::Driver(robot.clone(), DriverCall::State));
        self.publish(&self.signing, &key, wire(&state), Bytes::new()).await;
        let cancel = sources.world.goals(robot).last().map(|id| GoalRequest::Cancel { id: *id });
        let command = DriverCommand { request: cancel, permit: Permit::default() };
        let key = self.keys.write(&Key::Driver(robot.clone(), DriverCall::Command));
        self.query(&self.signing, &key, wire(&command), Bytes::new()).await;
    }

    /// Passes on a later record of a third node, with its own name in it: without a proof, with one by its own key, or
    /// with that of the owner.
    async fn pass_on_a_record(&self, sources: &Sources, to: NodeId, chance: &mut ChaCha8Rng) {
        let about = self.victims.choose(chance).expect("a fleet has nodes");
        let known = sources.known.as_ref().filter(|_| *about != to);
        let record = known.and_then(|known| known.read(|base| base.get(about).map(|stored| stored.record.clone())));
        let Some(mut record) = record else { return };
        let Some(robot) = &mut record.knowledge.robot else { return };
        robot.estimator = HOSTILE.to_owned();
        record.stamp.version += chance.random_range(1..1_000);
        match chance.random_range(0..3) {
            0 => record.proof = None,
            1 => record.proof = Some(sources.signer.sign(&record)),
            _ => {}
        }
        let exchange = Exchange { sums: vec![], scope: DigestScope::ALL, digest: Digest::new(), records: vec![record] };
        let payload = codec::encode_for_version(VersionRange::OWN.newest, exchange).expect("a small message");
        self.query(&self.signing, &self.keys.write(&Key::Gossip(to)), payload.into(), Bytes::new()).await;
    }

    /// Bids for roles at no cost, and confirms no award. Only a certificate with the role `robot` permits bids.
    pub(super) async fn bid(self: Arc<Self>, mut calls: Stream<Query>, seed: u64) {
        let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0xb1d);
        while let Some(query) = calls.recv().await {
            let Ok(CallForBids { auction, roles, .. }) = codec::decode(&query.payload) else { continue };
            if !chance.random_bool(BIDS) {
                continue;
            }
            let robot: RobotId = slug(HOSTILE);
            let replies = roles.into_keys().map(|role| RoleReply::Bid(cheap_bid(robot.clone(), role))).collect();
            let key = self.keys.write(&Key::Bid(robot.clone()));
            let response = wire(&BidResponse { robot, auction, replies });
            // A failed attempt is no failure of the run.
            let _ = query.replier.reply(&key, response, Encoding::Wire).await;
        }
    }
}

/// Answers readings of the clocks of voters with times far ahead, or refuses them.
pub(super) async fn answer_clock_readings(mut readings: Stream<Query>, seed: u64) {
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0xc10c);
    while let Some(Query { key, replier, .. }) = readings.recv().await {
        // A failed attempt is no failure of the run.
        let _ = match chance.random_bool(0.5) {
            true => replier.reply(&key, wire(&u64::MAX), Encoding::Wire).await,
            false => replier.refuse("no").await,
        };
    }
}

/// Returns a bid that costs nothing.
fn cheap_bid(robot: RobotId, role: RoleId) -> Bid {
    Bid {
        robot,
        role,
        time: Seconds::ZERO,
        energy: 0.0,
        remaining: 1.0,
        useful_charge: BatteryShare::new(0.0).expect("a share"),
        from: slug(PLACE),
        age_ms: 0,
        parts: vec![],
        present: None,
        planned: None,
    }
}

/// Returns the payload of a request that would change the target; `None` for a call that only reads. An order has this
/// request id.
fn payload_of(call: ApiCall, target: &Target, request: &str) -> Option<Value> {
    let Target { mission, role, question } = target;
    let submit = json!({ "mission": "lab-samples", "parameters": { "room": PLACE } });
    let mut payload = match call {
        ApiCall::Submit => submit,
        ApiCall::Cancel | ApiCall::Resolve => json!({ "mission": mission }),
        ApiCall::CancelMissions => json!({ "missions": { "where": "true" } }),
        ApiCall::Priority => json!({ "mission": mission, "priority": 100 }),
        ApiCall::Reassign => json!({ "mission": mission, "role": role }),
        ApiCall::Answer => json!({ "request": question, "answer": "done" }),
        ApiCall::Schedule => {
            json!({ "schedule": HOSTILE, "action": "add", "cron": "* * * * *", "submit": submit })
        }
        ApiCall::Hold | ApiCall::Release => json!({ "robots": "all" }),
        ApiCall::Maintenance => json!({ "robots": "all", "action": "begin" }),
        ApiCall::Close | ApiCall::Open => json!({ "places": [PLACE] }),
        ApiCall::Limit => json!({ "places": [PLACE], "action": "set", "speed_mps": 0.05 }),
        ApiCall::Alarm => json!({ "action": "clear" }),
        ApiCall::Backup => return Some(json!({})),
        ApiCall::Upgrade => return Some(json!({ "finish": true })),
        ApiCall::Get
        | ApiCall::List
        | ApiCall::Requests
        | ApiCall::Schedules
        | ApiCall::Audit
        | ApiCall::Explain
        | ApiCall::Help => return None,
    };
    payload["by"] = json!(HOSTILE);
    let has_no_id = matches!(call, ApiCall::Cancel | ApiCall::Resolve | ApiCall::Answer | ApiCall::Schedule);
    if !has_no_id {
        payload["request"] = json!(request);
    }
    Some(payload)
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::api::{
        AlarmRequest, AnswerRequest, CancelMissionsRequest, CloseRequest, HoldRequest, LimitRequest,
        MaintenanceRequest, MissionChangeRequest, OpenRequest, PriorityRequest, ReassignRequest, ReleaseRequest,
        ScheduleRequest, SubmitRequest, UpgradeRequest,
    };
    use serde::de::DeserializeOwned;

    fn is_read<T: DeserializeOwned>(payload: &Value) -> bool {
        serde_json::from_value::<T>(payload.clone()).is_ok()
    }

    /// Only the signature may be the reason for which a request is rejected.
    #[test]
    fn every_change_is_requested_with_a_valid_payload() {
        let mission: MissionId = slug("rest-1");
        let question = Some(PersonRequestId { mission: mission.clone(), number: 1 });
        let target = Target { mission: Some(mission), role: Some(slug("r1")), question };
        for call in ApiCall::ALL.iter().copied() {
            let payload = payload_of(call, &target, "mallory-1");
            assert_eq!(payload.is_none(), call.is_read_only(), "{call:?}");
            let Some(payload) = payload else { continue };
            let is_valid = match call {
                ApiCall::Submit => is_read::<SubmitRequest>(&payload),
                ApiCall::Cancel | ApiCall::Resolve => is_read::<MissionChangeRequest>(&payload),
                ApiCall::CancelMissions => is_read::<CancelMissionsRequest>(&payload),
                ApiCall::Priority => is_read::<PriorityRequest>(&payload),
                ApiCall::Reassign => is_read::<ReassignRequest>(&payload),
                ApiCall::Answer => is_read::<AnswerRequest>(&payload),
                ApiCall::Schedule => is_read::<ScheduleRequest>(&payload),
                ApiCall::Hold => is_read::<HoldRequest>(&payload),
                ApiCall::Release => is_read::<ReleaseRequest>(&payload),
                ApiCall::Maintenance => is_read::<MaintenanceRequest>(&payload),
                ApiCall::Close => is_read::<CloseRequest>(&payload),
                ApiCall::Open => is_read::<OpenRequest>(&payload),
                ApiCall::Limit => is_read::<LimitRequest>(&payload),
                ApiCall::Alarm => is_read::<AlarmRequest>(&payload),
                ApiCall::Upgrade => is_read::<UpgradeRequest>(&payload),
                _ => true,
            };
            assert!(is_valid, "{call:?}: {payload}");
        }
    }
}
