//! Candidates among robots that bid for the best positions in their timelines.

use super::*;
use crate::auction::insertion::{
    PlannedRole, PromisedRole, RoleInsertion, RoleOfMission, RoleSpan, TimelineStart, insert_role,
};
use crate::ids::PlaceId;
use crate::knowledge::{Attributes, Availability, RobotKnowledge};
use crate::pose::Pose;
use crate::timeline::Travel;
use crate::units::SharePerSecond;

/// Share of the battery that a robot uses in a second.
const DISCHARGE: f64 = 1e-7;

/// Width of the plane, and maximum of other times, in microseconds: so large that sums are equal by chance in one of many millions of
/// fleets.
const RANGE: u64 = 1_000_000_000_000;

/// Coordinates in microseconds.
type Point = (u64, u64);

/// Straight drives in the plane. On a line the sums of drives of two robots to two places are often equal.
struct Plane;

impl Travel<PlaceId> for Plane {
    fn seconds(&self, from: &PlaceId, to: &PlaceId) -> f64 {
        let at = |place: &PlaceId| {
            let (x, y) = place.as_str().split_once(',').unwrap();
            (x.parse::<f64>().unwrap(), y.parse::<f64>().unwrap())
        };
        let ((x, y), (to_x, to_y)) = (at(from), at(to));
        (to_x - x).hypot(to_y - y) / 1e6
    }
}

fn place((x, y): Point) -> PlaceId {
    format!("{x},{y}").parse().unwrap()
}

fn used_in(time: Seconds) -> f64 {
    DISCHARGE * time.get()
}

/// First place, last place, and time beside the way between them.
type Work = (Point, Point, u64);

fn span((from, to, time): Work) -> RoleSpan {
    let (from, to) = (place(from), place(to));
    let time = seconds(time) + Seconds::new(Plane.seconds(&from, &to)).unwrap();
    RoleSpan { from: Some(from), to: Some(to), time, energy: Energy::of_share(used_in(time)) }
}

/// Returns the time for a role from a place.
fn time_from(at: &PlaceId, span: &RoleSpan) -> Seconds {
    Seconds::new(Plane.seconds(at, span.from.as_ref().unwrap()) + span.time.get()).unwrap()
}

/// A robot with a timeline.
#[derive(Debug, Clone)]
struct Worker {
    /// Place in its record.
    at: Point,
    /// Charge in hundredths.
    charge: u32,
    /// Bound of its cost, in quarters.
    bound: u64,
    /// Time and end of the role that it holds.
    held: Option<(u64, Point)>,
    /// Its record is older than that role.
    is_outdated: bool,
    /// It returns that role for now.
    yields: bool,
    /// Promised roles, with the time by which each may be delayed.
    promised: Vec<(Work, Option<u64>)>,
    /// The call contains them.
    is_called: bool,
    /// They have ended since the call.
    has_ended: bool,
}

impl Worker {
    fn record(&self) -> RobotKnowledge {
        let (mission, role) = ("other".parse().unwrap(), role(0));
        let holds = self.held.is_some() && !self.is_outdated;
        RobotKnowledge {
            skills: BTreeSet::new(),
            attributes: Attributes::default(),
            place: place(self.at),
            pose: Pose::default(),
            battery: BatteryShare::new(f64::from(self.charge) / 100.0).unwrap(),
            discharge: SharePerSecond::new(DISCHARGE).unwrap(),
            useful_charge: BatteryShare::new(0.1).unwrap(),
            speed: None,
            availability: if holds {
                Availability::Holding { mission, role, suspended: false }
            } else {
                Availability::Free
            },
            estimator: String::new(),
            charging: None,
        }
    }

    fn price(&self, span: &RoleSpan) -> Price {
        let time = Seconds::new(time_from(&place(self.at), span).get() * self.bound as f64 / 4.0).unwrap();
        Price::AtLeast { time, energy: used_in(time) }
    }

    fn queue(&self) -> Option<RobotQueue> {
        let promised: &[(Work, Option<u64>)] = if self.has_ended { &[] } else { &self.promised };
        let preceding: Vec<RoleSpan> =
            promised.iter().filter(|(_, slack)| slack.is_some()).map(|(work, _)| span(*work)).collect();
        let estimate = |(time, _): (u64, Point)| RoleEstimate { time: seconds(time), energy: Energy::ZERO };
        let count = |number: usize| u32::try_from(number).unwrap();
        (self.held.is_some() || !promised.is_empty()).then(|| RobotQueue {
            held: self.held.map(estimate),
            promised: count(promised.len()),
            preceding: count(preceding.len()),
            time: preceding.iter().map(|span| span.time).sum(),
            energy: preceding.iter().map(|span| span.energy).sum(),
            yields: self.held.is_some() && self.yields,
            reason: RefusalReason::Busy { mission: "other".parse().unwrap(), role: role(0) },
        })
    }

    /// Returns the promised roles for the call.
    fn promises(&self, number: usize) -> Vec<PromisedRole> {
        let promise = |(index, (work, slack)): (usize, &(Work, Option<u64>))| {
            let mission = format!("m-{number}-{index}").parse().unwrap();
            let role = RoleOfMission { mission, role: role(0) };
            let release = Seconds::ZERO;
            let (robot, span, slack, charges) = (robot(number), span(*work), slack.map(seconds), false);
            PromisedRole { robot, role, span, slack, release, charges }
        };
        self.promised.iter().enumerate().filter(|_| self.is_called).map(promise).collect()
    }

    /// Returns the bid for a role, as the robot computes it.
    fn bid(&self, call: &CallForBids, number: usize, of: &RoleId, span: &RoleSpan) -> Bid {
        let Timelines { objective, promised, startable, ends_within, releases } = &call.timelines;
        let own: Vec<&PromisedRole> = promised.iter().filter(|promised| promised.robot == robot(number)).collect();
        let (held, end) = self.held.unwrap_or((0, self.at));
        let end = place(end);
        let start = TimelineStart {
            place: &end,
            time: seconds(held),
            discharge: SharePerSecond::new(DISCHARGE).unwrap(),
            comes_first: self.held.is_none() && startable.contains(of),
            ends_within: *ends_within,
            release: releases.get(of).copied().unwrap_or(Seconds::ZERO),
        };
        let inserted = (!own.is_empty()).then(|| insert_role(start, &own, span.clone(), *objective, &Plane)).flatten();
        let (from, planned) = match inserted {
            Some(RoleInsertion { from, planned, .. }) => (from, planned),
            None => (end.clone(), PlannedRole::alone(span.clone(), start.begin())),
        };
        let time = time_from(&from, span);
        let (mission, held) = ("other".parse().unwrap(), role(0));
        Bid {
            robot: robot(number),
            role: of.clone(),
            time,
            energy: used_in(time),
            remaining: f64::from(self.charge) / 100.0 - used_in(time),
            useful_charge: BatteryShare::new(0.1).unwrap(),
            from,
            age_ms: 0,
            parts: vec![],
            present: self.held.map(|_| PresentRole { mission, role: held, time: start.time }),
            planned: Some(Box::new(planned)),
        }
    }
}

fn point() -> impl Strategy<Value = Point> {
    (0..RANGE, 0..RANGE)
}

fn work() -> impl Strategy<Value = Work> {
    (point(), point(), 0..RANGE)
}

fn workers() -> impl Strategy<Value = Vec<Worker>> {
    let promised = prop::collection::vec((work(), prop::option::of(0..RANGE)), 0..4);
    let state = (point(), 0_u32..=100, 0_u64..=4, prop::option::weighted(0.3, (0..RANGE, point())));
    let flags = (any::<bool>(), any::<bool>(), prop::bool::weighted(0.8), prop::bool::weighted(0.2));
    let promised = prop_oneof![Just(vec![]), promised];
    let worker = (state, promised, flags).prop_map(|((at, charge, bound, held), mut promised, flags)| {
        // The roles of a lower priority are the last.
        promised.sort_by_key(|(_, slack)| slack.is_none());
        let (is_outdated, yields, is_called, has_ended) = flags;
        Worker { at, charge, bound, held, is_outdated, yields, promised, is_called, has_ended }
    });
    prop::collection::vec(worker, 0..10)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(5_000))]

    #[test]
    fn candidates_give_the_result_of_insertions_among_all(
        workers in workers(),
        works in prop::collection::vec(work(), 1..3),
        objective in prop_oneof![
            Just(Objective::EarliestEnd),
            Just(Objective::LeastEnergy),
            Just(Objective::Weighted { battery_s: Seconds::new(1e8).unwrap() }),
        ],
        (starts, may_wait, promises_max) in (prop::collection::vec(any::<bool>(), 2), any::<bool>(), 0_u32..4),
        ends_within in prop::option::of((0..RANGE).prop_map(seconds)),
        releases in prop::collection::vec((0..RANGE).prop_map(seconds), 2),
        count in 1_usize..4,
    ) {
        let spans: BTreeMap<RoleId, RoleSpan> = (0..).map(role).zip(works.into_iter().map(span)).collect();
        let startable = spans.keys().zip(starts).filter(|(_, starts)| *starts).map(|(role, _)| role.clone());
        let startable: BTreeSet<RoleId> = startable.collect();
        let promised = workers.iter().enumerate().flat_map(|(number, worker)| worker.promises(number)).collect();
        let later = spans.keys().filter(|role| !startable.contains(*role));
        let releases = later.zip(releases).map(|(role, release)| (role.clone(), release)).collect();
        let timelines = Timelines { objective, promised, startable: startable.clone(), ends_within, releases };
        let call = CallForBids { timelines, ..call("visit", spans.len()) };
        let terms = RoleTerms::of(&call);
        let candidates = workers.iter().enumerate().map(|(number, worker)| {
            let record = worker.record();
            let expect = |role: &RoleId| terms[role].expect(&robot(number), &record, || worker.price(&spans[role]));
            let by_role: BTreeMap<RoleId, Expectation> =
                spans.keys().map(|role| (role.clone(), expect(role))).collect();
            (robot(number), by_role)
        });
        let candidates = Candidates::new(candidates.collect());
        let queues = workers.iter().enumerate().filter_map(|(number, worker)| Some((robot(number), worker.queue()?)));
        let inputs = Inputs { queues: queues.collect(), excluded: BTreeMap::new(), startable, may_wait, promises_max };
        let reply = |of: &RobotId| {
            let (number, worker) = workers.iter().enumerate().find(|(number, _)| robot(*number) == *of)?;
            let bids = spans.iter().map(|(role, span)| RoleReply::Bid(worker.bid(&call, number, role, span)));
            Some(BidResponse { robot: of.clone(), auction: call.auction.clone(), replies: bids.collect() })
        };
        let auction = |count| inputs.auction(&call, candidates.clone(), reply, count).0;
        let (found, among_all) = (auction(Some(count)), auction(None));
        prop_assert_eq!(&found.holders, &among_all.holders);
        prop_assert_eq!(found.record.promised, among_all.record.promised);
        prop_assert_eq!(found.record.planned, among_all.record.planned);
        prop_assert_eq!(found.record.failure.is_some(), among_all.record.failure.is_some());
    }
}
