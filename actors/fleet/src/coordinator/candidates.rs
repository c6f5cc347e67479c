//! Candidates of an auction, by the records of the robots that the coordinator has received.
//!
//! The bound of a free robot is the price of the role from the place in its record. A robot between two places may reach a
//! neighbouring place before it bids, so its least price from any of these counts. Closed lanes and speed limits only make drives
//! longer, and do not count. A robot with promised roles has no bound, nor has a robot whose latest change may not have arrived, or
//! whose estimates may fall with longer drives.
//!
//! Changes of a record arrive within the delay of a message. A robot that changes in this time may be missed, as if it had changed
//! after the auction. A new coordinator asks all robots until it has their records.

use super::clearing::AuctionInputs;
use super::message::CollectedBids;
use super::rounds::Rounds;
use super::session_context::SessionContext;
use super::settings::{AuctionSettings, CandidateSettings};
use crate::robot::pricing_context;
use consort_protocol::auction::{CallForBids, Candidates, Expectation, Invitation, Price, RoleTerms};
use consort_protocol::ensemble::{Eligibility, Ensembles, ExchangedValue};
use consort_protocol::ids::{NodeId, PlaceId, RobotId, RoleId};
use consort_protocol::knowledge::{Attributes, KnowledgeBase, RobotKnowledge};
use consort_protocol::ledger::MissionEntry;
use consort_protocol::plan::LocalPlan;
use consort_protocol::units::{MetresPerSecond, NodeTime};
use consort_skills::descriptor::{EstimateContext, EstimateError, Estimator};
use consort_skills::environment::{RouteError, Routes, SpeedLimits};
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Maximum age of a record for a bound. Robots renew their records at least every 5 s, and a change that was lost arrives with the
/// next renewal. Raised: a robot without contact may be missed; lowered: more robots are asked. A guess: the interval and two rounds
/// of gossip.
const RECORD_AGE_MAX: Duration = Duration::from_secs(7);

/// Restricts a call to all robots to the best candidates, in a large fleet. A promised role is also offered to its robot.
pub(super) fn first_call(mut bids: CollectedBids, rounds: &Rounds, context: &SessionContext) -> CollectedBids {
    let Some(candidates) = candidates_of(&bids.call, &bids.invitation, context) else { return bids };
    let members = std::mem::take(&mut bids.invitation.robots);
    bids.candidates = candidates;
    let mut first = AuctionInputs::read(&bids, rounds, context).to_ask(&bids, context);
    if first.len() < bids.candidates.len() {
        first.extend(bids.again.as_ref().map(|again| again.promised.robot.clone()));
        bids.invite(first);
    } else {
        (bids.candidates, bids.invitation.robots) = (Candidates::default(), members);
    }
    bids
}

/// Returns what the invited robots would reply to a call; `None` if the auction asks all of them.
fn candidates_of(call: &CallForBids, invitation: &Invitation, context: &SessionContext) -> Option<Candidates> {
    let auctions = &context.settings.auctions;
    let AuctionSettings { candidates, ensembles, allocator, .. } = auctions;
    let settings = candidates.as_ref().filter(|_| auctions.asks_candidates(invitation.robots.len()))?;
    let now = context.now();
    if !allocator.allocates_together() || has_private_attributes(ensembles) || !context.has_all_records(now) {
        return None;
    }
    let robots = &invitation.robots;
    Some(context.settings.parts.knowledge.read(|base| expected_replies(call, robots, settings, base, now)))
}

/// Returns what these robots would reply to a call, by their records. Other nodes do not reply.
fn expected_replies(
    call: &CallForBids,
    robots: &BTreeSet<RobotId>,
    settings: &CandidateSettings,
    base: &KnowledgeBase,
    now: NodeTime,
) -> Candidates {
    let terms = RoleTerms::of(call);
    let mut prices = RecordPrices::new(settings);
    let mut expected = BTreeMap::new();
    for robot in robots {
        let Some(known) = base.get(&NodeId::from(robot.clone())) else { continue };
        let Some(worker) = &known.knowledge().robot else { continue };
        let is_recent = known.age(now) <= RECORD_AGE_MAX;
        let mut by_role = BTreeMap::new();
        for (role, terms) in &terms {
            let expectation = match is_recent {
                true => terms.expect(robot, worker, || prices.price(role, terms.plan(), worker)),
                false => Expectation::CostsAtLeast(0.0),
            };
            by_role.insert((*role).clone(), expectation);
        }
        expected.insert(robot.clone(), by_role);
    }
    Candidates::new(expected)
}

/// Checks whether robots have attributes that their records do not contain.
fn has_private_attributes(ensembles: &Ensembles) -> bool {
    let is_attribute = |value: &ExchangedValue| matches!(value, ExchangedValue::Attribute(_));
    ensembles.iter().any(|ensemble| ensemble.spec().exchange.iter().any(is_attribute))
}

/// Robots with their records, for the choice of missions that these robots may serve.
pub(super) struct RecordedRobots {
    robots: BTreeMap<RobotId, RecordedRobot>,
    /// For each condition that was checked, the robots that may meet it. Many missions have the same conditions.
    eligible: RefCell<BTreeMap<String, BTreeSet<RobotId>>>,
}

/// A robot by its record.
struct RecordedRobot {
    worker: RobotKnowledge,
    /// The record shows whether the robot may meet a condition: it is recent, and contains all attributes.
    shows_eligibility: bool,
}

impl RecordedRobots {
    fn new(robots: BTreeMap<RobotId, RecordedRobot>) -> RecordedRobots {
        RecordedRobots { robots, eligible: RefCell::default() }
    }

    /// Reads the records of robots.
    pub(super) fn read(robots: impl Iterator<Item = RobotId>, context: &SessionContext) -> RecordedRobots {
        let (now, has_all) = (context.now(), !has_private_attributes(&context.settings.auctions.ensembles));
        let recorded = context.settings.parts.knowledge.read(|base| {
            let recorded = |robot: RobotId| {
                let known = base.get(&NodeId::from(robot.clone()))?;
                let worker = known.knowledge().robot.clone()?;
                let shows_eligibility = has_all && known.age(now) <= RECORD_AGE_MAX;
                Some((robot, RecordedRobot { worker, shows_eligibility }))
            };
            robots.filter_map(recorded).collect()
        });
        RecordedRobots::new(recorded)
    }

    /// Checks whether a robot has the skills for an open role of a mission, may meet its condition, and no order of a person keeps
    /// it from the role.
    pub(super) fn may_serve(&self, entry: &MissionEntry) -> bool {
        let (roles, conditions) = (entry.roles_to_auction(), &entry.mission().roles);
        let may_get = |role: &RoleId, robot: &RobotId, recorded: &RecordedRobot| {
            let is_permitted = entry.role_orders().get(role).is_none_or(|order| order.restriction.permits(robot));
            let has_skills =
                || entry.plan(role).is_some_and(|plan| plan.skills_missing_in(&recorded.worker.skills).is_empty());
            let condition = conditions.get(role).and_then(|role| role.eligible.as_deref());
            let is_eligible = || condition.is_none_or(|condition| self.may_meet(condition, robot));
            is_permitted && has_skills() && is_eligible()
        };
        self.robots.iter().any(|(robot, recorded)| roles.iter().any(|role| may_get(role, robot, recorded)))
    }

    /// Checks whether a robot may meet a condition.
    fn may_meet(&self, condition: &str, robot: &RobotId) -> bool {
        let mut known = self.eligible.borrow_mut();
        if let Some(eligible) = known.get(condition) {
            return eligible.contains(robot);
        }
        let compiled = Eligibility::compile(condition);
        let may_meet = |(robot, recorded): &(&RobotId, &RecordedRobot)| {
            !recorded.shows_eligibility || compiled.as_ref().is_ok_and(|it| it.may_be_met(robot, &recorded.worker))
        };
        let eligible: BTreeSet<RobotId> = self.robots.iter().filter(may_meet).map(|(robot, _)| robot.clone()).collect();
        let is_eligible = eligible.contains(robot);
        known.insert(condition.to_owned(), eligible);
        is_eligible
    }
}

/// State of a robot that determines its price for a role, without its attributes.
type PriceKey<'a> = (&'a RoleId, Vec<&'a PlaceId>, u64, u64);

/// Prices of roles by the records of robots. Robots in the same state share a price.
struct RecordPrices<'a> {
    settings: &'a CandidateSettings,
    routes: Option<&'a Routes>,
    known: BTreeMap<PriceKey<'a>, Vec<(&'a Attributes, Price)>>,
}

impl<'a> RecordPrices<'a> {
    fn new(settings: &'a CandidateSettings) -> RecordPrices<'a> {
        RecordPrices { settings, routes: settings.estimator.environment().find(), known: BTreeMap::new() }
    }

    /// Returns the least price of a role from the places at which the robot may be when it bids.
    fn price(&mut self, role: &'a RoleId, plan: &LocalPlan, worker: &'a RobotKnowledge) -> Price {
        if worker.estimator != self.settings.estimator_version {
            return Price::Unknown;
        }
        let ahead = self.routes.map(|routes| routes.places_ahead(&worker.place, worker.pose)).unwrap_or_default();
        let places: Vec<&PlaceId> = std::iter::once(&worker.place).chain(ahead).collect();
        let speed = worker.speed.map_or(0.0, MetresPerSecond::get);
        let known = self.known.entry((role, places.clone(), speed.to_bits(), worker.discharge.get().to_bits()));
        let known = known.or_default();
        if let Some((_, price)) = known.iter().find(|(attributes, _)| **attributes == worker.attributes) {
            return *price;
        }
        let context = pricing_context(worker, &[], &SpeedLimits::default());
        let from = |place: &&PlaceId| {
            price_from(&self.settings.estimator, plan, &EstimateContext { place: (*place).clone(), ..context.clone() })
        };
        let price = match self.settings.estimator.grows_with_drives(plan) {
            true => places.iter().map(from).reduce(lower).unwrap_or(Price::Unknown),
            false => Price::Unknown,
        };
        known.push((&worker.attributes, price));
        price
    }
}

fn price_from(estimator: &Estimator, plan: &LocalPlan, context: &EstimateContext) -> Price {
    match estimator.budget(plan, context) {
        Ok(budget) => Price::AtLeast { time: budget.time(), energy: budget.energy },
        Err(problem) => match problem.source {
            EstimateError::MissingParameter { .. }
            | EstimateError::Parameter { .. }
            | EstimateError::Requirement { may_change: false, .. }
            | EstimateError::Route(RouteError::Closed { .. } | RouteError::Unreachable { .. }) => Price::Impossible,
            // The readings of the robot decide, or it has another program, domain file or map.
            EstimateError::Route(RouteError::UnknownPlace { .. })
            | EstimateError::Requirement { may_change: true, .. }
            | EstimateError::Expression { .. }
            | EstimateError::OtherDomain(_)
            | EstimateError::Environment(_)
            | EstimateError::NoDescriptor { .. } => Price::Unknown,
        },
    }
}

/// Returns a lower bound of two prices.
fn lower(one: Price, other: Price) -> Price {
    match (one, other) {
        (Price::Impossible, price) | (price, Price::Impossible) => price,
        (Price::Unknown, _) | (_, Price::Unknown) => Price::Unknown,
        (Price::AtLeast { time, energy }, Price::AtLeast { time: other_time, energy: other_energy }) => {
            Price::AtLeast { time: if other_time < time { other_time } else { time }, energy: energy.min(other_energy) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::test_values::idle_robot;
    use consort_protocol::auction::{AuctionId, NotAskedReason, Timelines};
    use consort_protocol::knowledge::{Knowledge, Record, RecordStamp};
    use consort_protocol::lease::Epoch;
    use consort_protocol::ledger::{Command, Ledger, Submission};
    use consort_protocol::mission::{Format, MissionTemplate};
    use consort_protocol::plan::divide_and_check;
    use consort_protocol::pose::Pose;
    use consort_protocol::units::BatteryShare;
    use consort_skills::descriptor::DescriptorRegistry;
    use consort_skills::domain::hospital;
    use consort_skills::environment::{Edge, Environment, Passages, TopologicalMap};
    use serde_json::json;
    use std::sync::Arc;

    fn place(name: &str) -> PlaceId {
        name.parse().unwrap()
    }

    /// Returns the settings of a fleet on a line: Dock, 20 m to Lab, 20 m to Store, and a Shed apart.
    fn settings() -> CandidateSettings {
        let at = |(name, x)| (place(name), Pose::new(x, 0.0, 0.0));
        let edge = |a, b| Edge { a: place(a), b: place(b), length_m: 20.0, one_way: false };
        let map = TopologicalMap {
            places: [("Dock", 0.0), ("Lab", 20.0), ("Store", 40.0), ("Shed", 99.0)].map(at).into(),
            edges: vec![edge("Dock", "Lab"), edge("Lab", "Store")],
        };
        let environment = Environment::new().with(Routes::shortest(&map, &Passages::default()).unwrap());
        let estimator = Arc::new(DescriptorRegistry::standard().resolve(environment).unwrap());
        CandidateSettings { count: 1, estimator, estimator_version: "standard".to_owned() }
    }

    /// Returns a call for a drive to the store.
    fn call() -> CallForBids {
        let spec = json!({ "type": "navigation", "roles": ["r1"], "parameters": { "to": "Store" } });
        let step = json!({ "action": { "Task": { "id": "go", "spec": spec } }, "after": [] });
        let plan = serde_json::from_value(json!({ "role": "r1", "steps": [step] })).unwrap();
        CallForBids {
            auction: AuctionId { mission: "m-1".parse().unwrap(), term: 1, round: 1 },
            ensembles: vec![],
            roles: BTreeMap::from([("r1".parse().unwrap(), plan)]),
            eligible: BTreeMap::new(),
            spread: BTreeSet::new(),
            timelines: Timelines::default(),
        }
    }

    /// Returns the record of a free robot of 1 m/s that drives.
    fn driver(at: &str, x: f64) -> RobotKnowledge {
        let skills = BTreeSet::from(["navigation".parse().unwrap()]);
        let speed = MetresPerSecond::new(1.0).ok();
        RobotKnowledge { skills, speed, place: place(at), pose: Pose::new(x, 0.0, 0.0), ..idle_robot() }
    }

    /// Returns the expected reply of a robot whose record has this age.
    fn expected(worker: RobotKnowledge, age: Duration) -> Candidates {
        let knowledge = Knowledge { may_vote: false, ..Knowledge::of(Some(worker)) };
        let owner: NodeId = "ada".parse().unwrap();
        let record = Record { owner: owner.clone(), stamp: RecordStamp::default(), knowledge, proof: None };
        let mut base = KnowledgeBase::default();
        base.merge(record, NodeTime::ZERO);
        // The second robot has no record.
        let robots = BTreeSet::from([RobotId::from(owner), "bob".parse().unwrap()]);
        expected_replies(&call(), &robots, &settings(), &base, NodeTime::ZERO + age)
    }

    #[test]
    fn the_bound_is_the_price_by_a_record_that_is_recent() {
        let costs = Expectation::CostsAtLeast;
        let other_version = RobotKnowledge { estimator: "other".to_owned(), ..driver("Dock", 0.0) };
        let apart = Expectation::Refuses(NotAskedReason::NotFeasible);
        let missing = NotAskedReason::MissingSkills { skills: vec!["navigation".parse().unwrap()] };
        for (worker, age_s, reply) in [
            (driver("Dock", 0.0), 7, costs(40.0)),
            (driver("Dock", 9.0), 7, costs(20.0)),
            (driver("Dock", 0.0), 8, costs(0.0)),
            (other_version, 0, costs(0.0)),
            (driver("Yard", 0.0), 0, costs(0.0)),
            (driver("Shed", 99.0), 0, apart),
            (idle_robot(), 0, Expectation::Refuses(missing)),
            (idle_robot(), 8, costs(0.0)),
        ] {
            let by_role = BTreeMap::from([("r1".parse().unwrap(), reply)]);
            let candidates = Candidates::new(BTreeMap::from([("ada".parse().unwrap(), by_role)]));
            assert_eq!(expected(worker.clone(), Duration::from_secs(age_s)), candidates, "{worker:?}, {age_s} s");
        }
    }

    /// Returns a ledger with a waiting mission for each of these conditions.
    fn ledger(conditions: impl Iterator<Item = &'static str>) -> Ledger {
        let mut ledger = Ledger::default();
        for (index, condition) in (1..).zip(conditions) {
            let mission = json!({
                "mission": "visit",
                "roles": { "r1": { "kind": "managed", "eligible": condition } },
                "root": { "task": "stay", "type": "wait", "roles": ["r1"], "parameters": { "seconds": "5" } },
            });
            let template = MissionTemplate::parse(&mission.to_string(), Format::Json).unwrap();
            let mission = template.instantiate(&BTreeMap::new(), &hospital()).unwrap();
            let division = divide_and_check(&mission).unwrap();
            let submission = Submission::of(format!("r-{index}").parse().unwrap(), mission, division);
            ledger.apply(Epoch { term: 1, index }, Command::Submit(Box::new(submission)));
        }
        ledger
    }

    #[test]
    fn a_robot_serves_only_missions_whose_condition_it_may_meet() {
        let (icu, er, full) =
            ("robot.attributes.section == 'icu'", "robot.attributes.section == 'er'", "robot.battery > 0.9");
        let ledger = ledger([er, icu, er, er, full].into_iter().cycle().take(50));
        let worker = RobotKnowledge {
            skills: BTreeSet::from(["wait".parse().unwrap()]),
            attributes: serde_json::from_value(json!({ "section": "icu" })).unwrap(),
            battery: BatteryShare::new(0.5).unwrap(),
            ..idle_robot()
        };
        for (shows_eligibility, count, conditions) in [(true, 20, 3), (false, 50, 3)] {
            let recorded = RecordedRobot { worker: worker.clone(), shows_eligibility };
            let robots = RecordedRobots::new(BTreeMap::from([("ada".parse().unwrap(), recorded)]));
            let missions = ledger.active_missions();
            let served = missions.into_iter().filter(|entry| robots.may_serve(entry)).count();
            assert_eq!(served, count, "the record shows eligibility: {shows_eligibility}");
            assert_eq!(robots.eligible.borrow().len(), conditions, "each condition is compiled once");
        }
    }
}
