//! Orders of people: what they are about, the requests that give and end them, and what must hold meanwhile.

use super::names::{CARRIERS, ROBOTS, ROOMS};
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::keys::ApiCall;
use consort_protocol::lease::LeaseTerms;
use consort_tests::body_log::BodyLog;
use consort_tests::ledger_copies::LedgerCopies;
use consort_tests::own_records::OwnRecords;
use consort_tests::slug;
use rand::RngExt;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::ops::Range;
use std::time::Duration;
use tokio::time::Instant;
use toml::Table;

/// Milliseconds for which an order is in force. Robots have to follow it within a part of this time.
pub(super) const IN_FORCE_MS: Range<u64> = 25_000..40_000;

/// Time before and after an order in which another closure may already or still be followed: it may be executed before its
/// acknowledgement, and robots without contact follow it after its end.
const AROUND: Duration = Duration::from_secs(60);

/// Seconds after which a hold or a speed limit would end by itself: longer than it is in force.
const FOR_S: u32 = 120;

/// Places besides the rooms that people close, and to which they limit the speed: many ways lead through them.
const CORRIDORS: [&str; 3] = ["Crossing", "IC Corridor 4", "PC Corridor 5"];

/// Speed limits in metres per second. The carriers drive at 0.6 m/s.
const SPEEDS_MPS: [f64; 3] = [0.2, 0.3, 0.4];

/// Shares of maintenance and of speed limits among the orders of the second person. The others are alarms, which stop all
/// robots.
const MAINTENANCE: f64 = 0.4;
const LIMITS: f64 = 0.4;

/// Alarm of the example of a fleet file: robots drive to assembly places, and these rooms are closed.
const FIRE: &str = "fire";
const CLOSED_BY_FIRE: [&str; 3] = ["IC Room 4", "IC Room 5", "IC Room 6"];

/// Alarm at which robots stand still.
const FREEZE: &str = "freeze";

/// Draws what the next order of a person is about.
pub(super) type Draw = fn(&mut ChaCha8Rng) -> Subject;

/// What an order is about.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Subject {
    /// Robots to hold.
    Robots(Vec<RobotId>),
    /// Place to close.
    Place(PlaceId),
    /// Robot to take out of service.
    Maintenance(RobotId),
    /// Place at which the speed is limited, and the limit in metres per second.
    Limit(PlaceId, f64),
    /// Alarm to raise.
    Alarm(&'static str),
}

/// An acknowledged order.
#[derive(Debug, Clone)]
pub(super) struct GivenOrder {
    /// The person, as the ledger and the robots name it: the beginning of the name.
    pub(super) person: String,
    pub(super) subject: Subject,
    /// Period from the acknowledgement to the request that ended the order.
    pub(super) in_force: Range<Instant>,
}

/// Logs that show how robots follow orders.
#[derive(Debug, Clone, Default)]
pub(super) struct Logs {
    /// Bodies of the carriers.
    pub(super) bodies: BodyLog,
    /// Own records of the carriers.
    pub(super) records: OwnRecords,
    /// The ledger of the stations.
    pub(super) copies: LedgerCopies,
}

/// Declares the second alarm in the example of a fleet file.
pub(super) fn change_fleet(fleet: &mut Table) {
    if let Some(alarms) = fleet.get_mut("alarms").and_then(toml::Value::as_table_mut) {
        alarms.insert(FREEZE.to_owned(), Table::from_iter([("robots".to_owned(), "stop".into())]).into());
    }
}

/// Returns the requests that end all orders, also those of requests without a reply that were executed later.
pub(super) fn all_over() -> [(ApiCall, Value); 5] {
    let places: Vec<&str> = places().collect();
    [
        (ApiCall::Alarm, json!({ "action": "clear" })),
        (ApiCall::Release, json!({ "robots": "all" })),
        (ApiCall::Maintenance, json!({ "robots": "all", "action": "end" })),
        (ApiCall::Open, json!({ "places": places })),
        (ApiCall::Limit, json!({ "places": places, "action": "clear" })),
    ]
}

fn places() -> impl Iterator<Item = &'static str> {
    ROOMS.into_iter().chain(CORRIDORS)
}

fn draw_place(chance: &mut ChaCha8Rng) -> PlaceId {
    let places: Vec<&str> = places().collect();
    slug(places[chance.random_range(0..places.len())])
}

impl Subject {
    /// Draws a hold or a closure.
    pub(super) fn hold_or_closure(chance: &mut ChaCha8Rng) -> Subject {
        if chance.random_bool(0.5) {
            return Subject::Place(draw_place(chance));
        }
        let robots: Vec<RobotId> = CARRIERS.into_iter().map(slug).collect();
        match robots.get(chance.random_range(0..=robots.len())) {
            Some(robot) => Subject::Robots(vec![robot.clone()]),
            None => Subject::Robots(robots),
        }
    }

    /// Draws a maintenance, a speed limit or an alarm.
    pub(super) fn maintenance_limit_or_alarm(chance: &mut ChaCha8Rng) -> Subject {
        let kind = chance.random_range(0.0..1.0);
        if kind < MAINTENANCE {
            return Subject::Maintenance(slug(CARRIERS[chance.random_range(0..CARRIERS.len())]));
        }
        if kind < MAINTENANCE + LIMITS {
            let speed_mps = *SPEEDS_MPS.choose(chance).expect("there are three");
            return Subject::Limit(draw_place(chance), speed_mps);
        }
        Subject::Alarm(if chance.random_bool(0.5) { FIRE } else { FREEZE })
    }

    /// Returns the kind of the order, for the verdict.
    pub(super) fn kind(&self) -> &'static str {
        match self {
            Subject::Robots(_) => "holds",
            Subject::Place(_) => "closures",
            Subject::Maintenance(_) => "maintenance",
            Subject::Limit(..) => "limits",
            Subject::Alarm(_) => "alarms",
        }
    }

    /// Returns the places that the order closes.
    fn closed(&self) -> BTreeSet<PlaceId> {
        match self {
            Subject::Place(place) => BTreeSet::from([place.clone()]),
            Subject::Alarm(FIRE) => CLOSED_BY_FIRE.into_iter().map(slug).collect(),
            _ => BTreeSet::new(),
        }
    }

    /// Returns the requests that begin and end the order.
    pub(super) fn requests(&self) -> [(ApiCall, Value); 2] {
        match self {
            Subject::Robots(robots) => [
                (ApiCall::Hold, json!({ "robots": robots, "for_s": FOR_S, "reason": "soak" })),
                (ApiCall::Release, json!({ "robots": robots })),
            ],
            Subject::Place(place) => [
                (ApiCall::Close, json!({ "places": [place], "reason": "soak" })),
                (ApiCall::Open, json!({ "places": [place] })),
            ],
            Subject::Maintenance(robot) => [
                (ApiCall::Maintenance, json!({ "robots": [robot], "action": "begin", "reason": "soak" })),
                (ApiCall::Maintenance, json!({ "robots": [robot], "action": "end" })),
            ],
            Subject::Limit(place, speed_mps) => {
                let set = json!({
                    "places": [place], "action": "set", "speed_mps": speed_mps, "for_s": FOR_S, "reason": "soak",
                });
                [(ApiCall::Limit, set), (ApiCall::Limit, json!({ "places": [place], "action": "clear" }))]
            }
            Subject::Alarm(alarm) => [
                (ApiCall::Alarm, json!({ "action": "raise", "alarm": alarm, "reason": "soak" })),
                (ApiCall::Alarm, json!({ "action": "clear", "alarm": alarm })),
            ],
        }
    }
}

impl GivenOrder {
    /// Checks that the robots have followed the order, one of `given`. Returns the number of states of robots and of the
    /// ledger that show it.
    ///
    /// # Errors
    /// Description of what a robot did.
    pub(super) fn check(&self, given: &[GivenOrder], logs: &Logs) -> Result<usize, String> {
        let all: Vec<RobotId> = ROBOTS.into_iter().map(slug).collect();
        match &self.subject {
            Subject::Robots(robots) => Ok(self.check_still(robots, logs)? + self.check_no_award(robots, logs)?),
            Subject::Place(_) => self.check_closed(given, logs),
            Subject::Maintenance(robot) => self.check_no_award(std::slice::from_ref(robot), logs),
            Subject::Limit(place, speed_mps) => self.check_limited((place, *speed_mps), logs),
            Subject::Alarm(FREEZE) => Ok(self.check_still(&carriers(), logs)? + self.check_no_award(&all, logs)?),
            Subject::Alarm(_) => Ok(self.check_closed(given, logs)? + self.check_no_award(&all, logs)?),
        }
    }

    fn check_still(&self, robots: &[RobotId], logs: &Logs) -> Result<usize, String> {
        let parts = parts(robots, |robot| logs.records.bound(robot, &self.person, &self.in_force));
        parts.iter().map(|(robot, part)| logs.bodies.check_still(robot, part, lease())).sum()
    }

    fn check_closed(&self, given: &[GivenOrder], logs: &Logs) -> Result<usize, String> {
        let overlaps = |other: &&GivenOrder| {
            other.in_force.start < self.in_force.end + AROUND && self.in_force.start < other.in_force.end + AROUND
        };
        let others: BTreeSet<PlaceId> =
            given.iter().filter(overlaps).flat_map(|other| other.subject.closed()).collect();
        let (closed, parts) = (self.subject.closed(), self.in_role(logs));
        parts.iter().map(|(robot, part)| logs.bodies.check_closed(robot, (&closed, &others), part, lease())).sum()
    }

    fn check_limited(&self, limit: (&PlaceId, f64), logs: &Logs) -> Result<usize, String> {
        let parts = self.in_role(logs);
        parts.iter().map(|(robot, part)| logs.bodies.check_limited(robot, limit, part, lease())).sum()
    }

    fn check_no_award(&self, robots: &[RobotId], logs: &Logs) -> Result<usize, String> {
        robots.iter().map(|robot| logs.copies.check_no_award(robot, &self.person, &self.in_force)).sum()
    }

    /// Returns the periods in which the carriers have roles: others may lack closures and limits.
    fn in_role(&self, logs: &Logs) -> Vec<(RobotId, Range<Instant>)> {
        parts(&carriers(), |robot| logs.records.in_role(robot, &self.in_force))
    }
}

fn carriers() -> Vec<RobotId> {
    CARRIERS.into_iter().map(slug).collect()
}

/// Returns the duration of leases in the example of a fleet file.
fn lease() -> Duration {
    LeaseTerms::default().lease
}

/// Returns the periods of each of these robots.
fn parts(robots: &[RobotId], of: impl Fn(&RobotId) -> Vec<Range<Instant>>) -> Vec<(RobotId, Range<Instant>)> {
    robots.iter().flat_map(|robot| of(robot).into_iter().map(move |part| (robot.clone(), part))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_nodes::config::{FleetConfig, from_text};
    use consort_protocol::api::{
        AlarmRequest, CloseRequest, HoldRequest, LimitRequest, MaintenanceRequest, OpenRequest, ReleaseRequest,
    };
    use consort_protocol::ids::{AlarmId, ZoneId};
    use consort_protocol::ledger::AlarmResponse;
    use consort_skills::extensions::Extensions;
    use consort_tests::example_files::example;
    use rand::SeedableRng;

    /// Returns the duration that a request states, if any, and checks that the API accepts the request.
    fn for_s((call, request): (ApiCall, Value)) -> Option<u32> {
        let for_s = request["for_s"].as_u64().and_then(|for_s| for_s.try_into().ok());
        match call {
            ApiCall::Hold => drop(serde_json::from_value::<HoldRequest>(request).unwrap()),
            ApiCall::Release => drop(serde_json::from_value::<ReleaseRequest>(request).unwrap()),
            ApiCall::Close => drop(serde_json::from_value::<CloseRequest>(request).unwrap()),
            ApiCall::Open => drop(serde_json::from_value::<OpenRequest>(request).unwrap()),
            ApiCall::Maintenance => drop(serde_json::from_value::<MaintenanceRequest>(request).unwrap()),
            ApiCall::Limit => drop(serde_json::from_value::<LimitRequest>(request).unwrap()),
            ApiCall::Alarm => drop(serde_json::from_value::<AlarmRequest>(request).unwrap()),
            call => panic!("{call:?} is no order"),
        }
        for_s
    }

    #[test]
    fn requests_are_those_of_the_api() {
        use ApiCall::{Alarm, Close, Hold, Limit, Maintenance, Open, Release};
        let (ada, crossing) = (slug::<RobotId>("ada"), slug::<PlaceId>("Crossing"));
        for (subject, calls) in [
            (Subject::Robots(vec![ada.clone()]), [Hold, Release]),
            (Subject::Place(crossing.clone()), [Close, Open]),
            (Subject::Maintenance(ada), [Maintenance; 2]),
            (Subject::Limit(crossing, 0.3), [Limit; 2]),
            (Subject::Alarm(FIRE), [Alarm; 2]),
        ] {
            let requests = subject.requests();
            assert_eq!(requests.clone().map(|(call, _)| call), calls);
            let longest_s = requests.into_iter().filter_map(for_s).max();
            assert!(
                longest_s.is_none_or(|for_s| u64::from(for_s) * 1_000 > IN_FORCE_MS.end),
                "a person ends {subject:?}"
            );
        }
        for request in all_over() {
            for_s(request);
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_orders_of_all_kinds() {
        let people: [(Draw, Vec<&str>); 2] = [
            (Subject::hold_or_closure, vec!["closures", "holds"]),
            (Subject::maintenance_limit_or_alarm, vec!["alarms", "limits", "maintenance"]),
        ];
        for (draw, kinds) in people {
            let orders = |seed| {
                let mut chance = ChaCha8Rng::seed_from_u64(seed);
                (0..50).map(|_| draw(&mut chance)).collect::<Vec<_>>()
            };
            assert_eq!(orders(7), orders(7));
            assert_ne!(orders(7), orders(8));
            let drawn: BTreeSet<&str> = orders(7).iter().map(Subject::kind).collect();
            assert_eq!(drawn.into_iter().collect::<Vec<_>>(), kinds);
        }
    }

    #[test]
    fn the_places_are_on_the_map() {
        let map = consort_world::map::shipped("hospital").expect("it is shipped");
        assert!(places().chain(CLOSED_BY_FIRE).all(|place| map.place(&slug(place)).is_some()));
    }

    #[test]
    fn the_fleet_file_declares_the_alarms() {
        let mut fleet = example("fleet");
        change_fleet(&mut fleet);
        let domain = Extensions::default().domain();
        let fleet: FleetConfig = from_text(&fleet.to_string(), "fleet.toml", &domain).expect("a fleet file");
        assert_eq!(fleet.alarms[&slug::<AlarmId>(FREEZE)].robots, AlarmResponse::Stop);
        assert_eq!(fleet.alarms[&slug::<AlarmId>(FIRE)].robots, AlarmResponse::Assemble);
        let closed: BTreeSet<PlaceId> = CLOSED_BY_FIRE.into_iter().map(slug).collect();
        assert_eq!(fleet.zones[&slug::<ZoneId>("icu")], closed);
        assert_eq!(Duration::from_millis(fleet.lease.lease_ms), lease());
    }

    #[test]
    fn orders_without_any_log_are_not_violated() {
        let now = Instant::now();
        let mut chance = ChaCha8Rng::seed_from_u64(7);
        for _ in 0..50 {
            let subject = Subject::maintenance_limit_or_alarm(&mut chance);
            let order = GivenOrder { person: "person 1, attempt".to_owned(), subject, in_force: now..now };
            assert_eq!(order.check(&[], &Logs::default()), Ok(0));
        }
    }
}
