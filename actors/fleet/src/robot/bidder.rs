//! Bids: a robot prices its own work.

use super::charging::ChargerReserve;
use super::energy_check::pricing_context;
use consort_protocol::auction::{
    Bid, BidLimits, BidRefusal, BidResponse, CallForBids, PresentRole, RefusalReason, RoleReply, ViabilityError,
};
use consort_protocol::ensemble::{Eligibility, Ineligibility, Membership};
use consort_protocol::ids::{PlaceId, RobotId, RoleId, TaskType};
use consort_protocol::knowledge::{Availability, RobotKnowledge};
use consort_protocol::lease::Award;
use consort_protocol::plan::LocalPlan;
use consort_protocol::scalar::Scalar;
use consort_skills::descriptor::{EstimateContext, EstimateError, Estimator, PriceError};
use consort_skills::environment::RouteError;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Maximum number of closures in a refusal: a message must have room for all of them.
const CLOSURES_NAMED: usize = 3;

/// Prices plans for a single robot.
#[derive(Clone)]
pub struct Bidder {
    robot: RobotId,
    estimator: Arc<Estimator>,
    chargers: Option<ChargerReserve>,
}

/// State of the robot at the time of a call for bids.
#[derive(Debug, Clone)]
pub struct BidContext<'a> {
    /// The robot's own record.
    pub worker: &'a RobotKnowledge,
    /// Closed lanes, each by its 2 ends; a place twice is a closed place.
    pub closed_lanes: &'a [(PlaceId, PlaceId)],
    /// The lanes among them that people have not closed.
    pub found_closed: &'a [(PlaceId, PlaceId)],
    /// The closures of people, as text.
    pub closures: &'a [&'a str],
    /// Latest readings of the driver, by name; `None` if conditions on them do not count.
    pub readings: Option<&'a BTreeMap<String, Scalar>>,
    /// Age of that information in milliseconds.
    pub age_ms: u64,
    /// Membership of the robot in any of the called ensembles, by its own evaluation.
    pub membership: Membership,
    /// The role that the robot holds, if it can bid for a later one.
    pub present: Option<PresentWork>,
}

/// The role that a robot holds, and the state in which it ends.
#[derive(Debug, Clone)]
pub struct PresentWork {
    role: PresentRole,
    /// Charge that its remaining tasks need, as a share of a full battery.
    energy: f64,
    ends_at: PlaceId,
}

impl PresentWork {
    /// Estimates the rest of a role. Returns `None` if it cannot be estimated.
    pub(super) fn of(award: &Award, rest: &LocalPlan, estimator: &Estimator, now: &EstimateContext) -> Option<Self> {
        let budget = estimator.budget(rest, now).ok()?;
        let (mission, role, time) = (award.mission.clone(), award.role.clone(), budget.time());
        Some(PresentWork { role: PresentRole { mission, role, time }, energy: budget.energy, ends_at: budget.ends_at })
    }
}

impl Bidder {
    /// Creates a bidder that prices with this estimator.
    pub fn new(robot: RobotId, estimator: Arc<Estimator>) -> Bidder {
        Bidder { robot, estimator, chargers: None }
    }

    /// Refuses roles after which none of the chargers could be reached.
    #[must_use]
    pub fn with_chargers(self, chargers: Option<ChargerReserve>) -> Bidder {
        Bidder { chargers, ..self }
    }

    /// Returns a bid or a refusal for every role of a call.
    pub fn respond(&self, call: &CallForBids, context: &BidContext<'_>) -> BidResponse {
        let reply = |(role, plan)| match self.bid(call, role, plan, context) {
            Ok(bid) => RoleReply::Bid(bid),
            Err(reason) => RoleReply::Refusal(BidRefusal { robot: self.robot.clone(), role: role.clone(), reason }),
        };
        BidResponse {
            robot: self.robot.clone(),
            auction: call.auction.clone(),
            replies: call.roles.iter().map(reply).collect(),
        }
    }

    fn bid(
        &self,
        call: &CallForBids,
        role: &RoleId,
        plan: &LocalPlan,
        context: &BidContext<'_>,
    ) -> Result<Bid, RefusalReason> {
        let BidContext { worker, closed_lanes, found_closed, closures, readings, age_ms, membership, present } =
            context;
        // A lack of skills outlasts the present work: a mission that only robots without the skill could join fails,
        // and does not wait for them.
        let needed: BTreeSet<&TaskType> = plan.tasks().map(|(_, spec)| &spec.task_type).collect();
        let missing: Vec<TaskType> =
            needed.into_iter().filter(|skill| !worker.skills.contains(*skill)).cloned().collect();
        if !missing.is_empty() {
            return Err(RefusalReason::MissingSkills { skills: missing });
        }
        let present = match &worker.availability {
            Availability::Free => None,
            Availability::Holding { mission, role, .. } => {
                let busy = || RefusalReason::Busy { mission: mission.clone(), role: role.clone() };
                let other = present.as_ref().filter(|_| *mission != call.auction.mission);
                Some(other.ok_or_else(busy)?)
            }
            Availability::OutOfService { problem } => {
                return Err(RefusalReason::OutOfService { problem: problem.clone() });
            }
        };
        if !membership.member {
            return Err(RefusalReason::NotMember { why: membership.reason.clone() });
        }
        if let Some(condition) = call.eligible.get(role) {
            let eligible = Eligibility::check_text(condition, &self.robot, worker);
            eligible.map_err(|Ineligibility { why, permanent }| RefusalReason::NotEligible { why, permanent })?;
        }
        let from = present.map_or_else(|| worker.place.clone(), |present| present.ends_at.clone());
        let readings = readings.cloned();
        let context = EstimateContext { place: from.clone(), readings, ..pricing_context(worker, closed_lanes) };
        let budget = self.estimator.budget(plan, &context).map_err(|problem| {
            // What people have closed may be open later. A problem that is left without their closures counts.
            let open = EstimateContext { closed: found_closed.to_vec(), ..context.clone() };
            match self.estimator.budget(plan, &open) {
                Ok(_) => refusal_while_closed(&problem, closures),
                Err(problem) => refusal_of(&problem),
            }
        })?;
        let (time, energy) = (budget.time(), budget.energy);
        let remaining = worker.battery.get() - present.map_or(0.0, |present| present.energy) - energy;
        if let Some(chargers) = &self.chargers {
            let end = EstimateContext { place: budget.ends_at, ..context };
            let checked = chargers.check(remaining, worker.useful_charge, &self.estimator, &end);
            checked.map_err(|reason| without_charger(reason, closures))?;
        }
        Ok(Bid {
            robot: self.robot.clone(),
            role: role.clone(),
            time,
            energy,
            remaining,
            useful_charge: worker.useful_charge,
            from,
            age_ms: *age_ms,
            parts: budget.parts,
            present: present.map(|present| present.role.clone()),
        })
    }
}

/// Checks whether only the charge keeps the robot from a role.
pub(super) fn lacks_charge(reply: &RoleReply, limits: &BidLimits) -> bool {
    match reply {
        RoleReply::Bid(bid) => matches!(bid.check_viable(limits), Err(ViabilityError::LowCharge { .. })),
        RoleReply::Refusal(refusal) => {
            matches!(refusal.reason, RefusalReason::ChargerOutOfReach { charger: Some(_), .. })
        }
    }
}

/// Returns the refusal of a plan that can be priced without the closures of people.
fn refusal_while_closed(problem: &PriceError, closures: &[&str]) -> RefusalReason {
    // The closure of the destination comes first.
    let is_own = |closure: &&str| match &problem.source {
        EstimateError::Route(RouteError::Closed { to, .. }) => closure.starts_with(to.as_str()),
        _ => false,
    };
    let (own, other): (Vec<&str>, Vec<&str>) = closures.iter().copied().partition(is_own);
    let why = with_closures(problem.to_string(), own.into_iter().chain(other));
    RefusalReason::NotEligible { why, permanent: false }
}

/// Adds the closures to the refusal of a robot that could reach no charger at all.
fn without_charger(reason: RefusalReason, closures: &[&str]) -> RefusalReason {
    match reason {
        RefusalReason::ChargerOutOfReach { charger: None, problem } => {
            let problem = with_closures(problem, closures.iter().copied());
            RefusalReason::ChargerOutOfReach { charger: None, problem }
        }
        reason => reason,
    }
}

fn with_closures<'a>(problem: String, closures: impl Iterator<Item = &'a str>) -> String {
    closures.take(CLOSURES_NAMED).fold(problem, |text, closure| format!("{text}; {closure}"))
}

/// Returns the refusal of a plan that cannot be priced. The robot may get a role later whose condition on its readings
/// is false or unknown now.
fn refusal_of(problem: &PriceError) -> RefusalReason {
    match &problem.source {
        EstimateError::Requirement { may_change: true, .. } => {
            RefusalReason::NotEligible { why: problem.to_string(), permanent: false }
        }
        _ => RefusalReason::NotFeasible { task: problem.task.clone(), problem: problem.to_string() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::test_values::idle_robot;
    use consort_protocol::auction::AuctionId;
    use consort_protocol::pose::Pose;
    use consort_skills::descriptor::DescriptorRegistry;
    use consort_skills::domain_file::DomainFile;
    use consort_skills::environment::{Edge, Environment, Routes, TopologicalMap};
    use serde_json::{Value, json};

    const WATERING: &str = r#"{
        "domain": "watering",
        "actions": { "water": {} },
        "readings": { "tank_l": { "type": "number" } },
        "tasks": {
            "water": { "action": "water", "requires": "readings.tank_l >= 1.0" },
            "lift": { "action": "water", "requires": "attributes.payload_kg >= 1.0" }
        }
    }"#;

    /// Returns the reply of a robot that needs any of these chargers to a call for a task.
    fn reply(
        estimator: Estimator,
        chargers: Option<ChargerReserve>,
        spec: &Value,
        context: &BidContext<'_>,
    ) -> RoleReply {
        let step = json!({ "action": { "Task": { "id": "it", "spec": spec } }, "after": [] });
        let plan: LocalPlan = serde_json::from_value(json!({ "role": "r1", "steps": [step] })).unwrap();
        let call = CallForBids {
            auction: AuctionId { mission: "m-1".parse().unwrap(), term: 1, round: 1 },
            ensembles: vec![],
            roles: BTreeMap::from([("r1".parse().unwrap(), plan)]),
            eligible: BTreeMap::new(),
            spread: BTreeSet::new(),
        };
        let bidder = Bidder::new("ada".parse().unwrap(), Arc::new(estimator)).with_chargers(chargers);
        let response = bidder.respond(&call, context);
        response.replies.into_iter().next().expect("a reply")
    }

    /// Returns the context of a free robot in a world without closures.
    fn context<'a>(worker: &'a RobotKnowledge, readings: &'a BTreeMap<String, Scalar>) -> BidContext<'a> {
        BidContext {
            worker,
            closed_lanes: &[],
            found_closed: &[],
            closures: &[],
            readings: Some(readings),
            age_ms: 0,
            membership: Membership { member: true, reason: "has the skills".to_owned(), age_ms: 0 },
            present: None,
        }
    }

    fn robot_with(skills: &[&str]) -> RobotKnowledge {
        RobotKnowledge { skills: skills.iter().map(|skill| skill.parse().unwrap()).collect(), ..idle_robot() }
    }

    /// Returns the reply of a robot with these readings to a call for a task of this type.
    fn reply_to_call(task: &str, readings: &Value) -> RoleReply {
        let form = serde_json::from_str(WATERING).unwrap();
        let domain = DomainFile::check(form, &BTreeMap::new(), &[]).unwrap();
        let estimator = domain.extend_descriptors(DescriptorRegistry::new()).resolve(Environment::new()).unwrap();
        let spec = json!({ "type": task, "roles": ["r1"], "attempts": 2 });
        let readings = serde_json::from_value(readings.clone()).unwrap();
        reply(estimator, None, &spec, &context(&robot_with(&["water", "lift"]), &readings))
    }

    fn reason_of(reply: RoleReply) -> RefusalReason {
        match reply {
            RoleReply::Refusal(refusal) => refusal.reason,
            RoleReply::Bid(bid) => panic!("{bid:?}"),
        }
    }

    fn refusal(task: &str, readings: &Value) -> RefusalReason {
        reason_of(reply_to_call(task, readings))
    }

    #[test]
    fn a_robot_bids_only_while_its_readings_meet_the_condition() {
        assert!(matches!(reply_to_call("water", &json!({ "tank_l": 1 })), RoleReply::Bid(_)));
        let condition = "step 0 (it): water requires `readings.tank_l >= 1.0`, which";
        let unknown = "has no value: the reading `tank_l` is unknown: the driver has not published it";
        for (readings, problem) in [(json!({ "tank_l": 0.5 }), "is false"), (json!({}), unknown)] {
            let expected = RefusalReason::NotEligible { why: format!("{condition} {problem}"), permanent: false };
            assert_eq!(refusal("water", &readings), expected);
        }
    }

    #[test]
    fn a_refusal_names_the_closure_of_the_destination_first_and_is_not_permanent() {
        let place = |name: &str| -> PlaceId { name.parse().unwrap() };
        let source = EstimateError::Route(RouteError::Closed { from: place("Dock"), to: place("Ward") });
        let closed = PriceError { step: 0, task: "go".parse().unwrap(), source };
        let problem = "step 0 (go): no route from Dock to Ward: the ways between them are closed";
        let (hall, ward) = ("Hall is closed by Abe", "Ward is closed by Nia: a spill, until 2026-01-01 00:00 UTC");
        let why = format!("{problem}; {ward}; {hall}");
        let reason = refusal_while_closed(&closed, &[hall, ward]);
        assert_eq!(reason, RefusalReason::NotEligible { why, permanent: false });
        let reason = refusal_while_closed(&closed, &[hall, hall, hall, hall, ward]);
        let why = format!("{problem}; {ward}; {hall}; {hall}");
        assert_eq!(reason, RefusalReason::NotEligible { why, permanent: false });
    }

    /// Returns the reply to a call for a drive from the dock through the hall. People have closed the ward behind the
    /// hall, and the driver has found these lanes closed.
    fn reply_to_drive(to: &str, found: &[(&str, &str)], chargers: Option<ChargerReserve>) -> RoleReply {
        let place = |name: &str| -> PlaceId { name.parse().unwrap() };
        let edge = |a: &str, b: &str| Edge { a: place(a), b: place(b), length_m: 10.0, one_way: false };
        let places = [("Dock", 0.0), ("Hall", 10.0), ("Ward", 20.0), ("Island", 50.0)];
        let map = TopologicalMap {
            places: places.map(|(name, x)| (place(name), Pose::new(x, 0.0, 0.0))).into(),
            edges: vec![edge("Dock", "Hall"), edge("Hall", "Ward")],
        };
        let environment = Environment::new().with(Routes::new(&map).unwrap());
        let estimator = DescriptorRegistry::standard().resolve(environment).unwrap();
        let found_closed: Vec<_> = found.iter().map(|(a, b)| (place(a), place(b))).collect();
        let closed_lanes = [found_closed.clone(), vec![(place("Ward"), place("Ward"))]].concat();
        let (worker, readings) = (robot_with(&["navigation"]), BTreeMap::new());
        let context = BidContext {
            closed_lanes: &closed_lanes,
            found_closed: &found_closed,
            closures: &["Ward is closed by Nia"],
            ..context(&worker, &readings)
        };
        let spec = json!({ "type": "navigation", "roles": ["r1"], "parameters": { "to": to } });
        reply(estimator, chargers, &spec, &context)
    }

    #[test]
    fn only_what_people_have_closed_makes_a_refusal_temporary() {
        let closed = reason_of(reply_to_drive("Ward", &[], None));
        assert!(matches!(&closed, RefusalReason::NotEligible { permanent: false, .. }), "{closed:?}");
        for (to, found) in [("Ward", vec![("Hall", "Dock")]), ("Island", vec![])] {
            let reason = reason_of(reply_to_drive(to, &found, None));
            assert!(matches!(&reason, RefusalReason::NotFeasible { .. }), "{to}: {reason:?}");
        }
    }

    #[test]
    fn a_refusal_for_want_of_a_charger_names_the_closures() {
        let chargers = ChargerReserve::new(BTreeSet::from(["Ward".parse().unwrap()]), BidLimits::default());
        let reply = reply_to_drive("Hall", &[], Some(chargers));
        assert!(!lacks_charge(&reply, &BidLimits::default()), "more charge does not open the way");
        let problem = "there is no way to a charger from Hall; Ward is closed by Nia".to_owned();
        assert_eq!(reason_of(reply), RefusalReason::ChargerOutOfReach { charger: None, problem });
    }

    #[test]
    fn a_missing_attribute_is_a_permanent_refusal() {
        let reason = refusal("lift", &json!({ "tank_l": 1 }));
        assert!(matches!(&reason, RefusalReason::NotFeasible { .. }), "{reason:?}");
    }
}
