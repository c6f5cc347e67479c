//! A person who holds robots, and closes and opens places.

use super::fleet::{CARRIERS, ProcessFleet, ROOMS, WORLD};
use consort_bus::SharedBus;
use consort_nodes::exit::Failure;
use consort_protocol::ids::{PlaceId, RobotId};
use consort_protocol::keys::{ApiCall, DriverCall, Key};
use consort_protocol::lease::LeaseTerms;
use consort_tests::body_log::BodyLog;
use consort_tests::history::RecordingClient;
use consort_tests::slug;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::ops::Range;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::{JoinHandle, JoinSet};
use tokio::time::{Instant, timeout};

/// Milliseconds between two orders. A request without a reply may be executed until the fault of its node has ended.
const PAUSE_MS: Range<u64> = 15_000..25_000;

/// Milliseconds for which an order is in force. Robots have to follow it within a part of this time.
const IN_FORCE_MS: Range<u64> = 25_000..40_000;

/// Seconds after which a hold would end by itself: longer than it is in force.
const HOLD_S: u32 = 120;

/// Places besides the rooms that the person closes: many ways lead through them.
const CORRIDORS: [&str; 3] = ["Crossing", "IC Corridor 4", "PC Corridor 5"];

/// What an order is about.
#[derive(Debug, Clone)]
enum Subject {
    Robots(Vec<RobotId>),
    Place(PlaceId),
}

/// An acknowledged order, and the period from its acknowledgement to the request that ended it.
#[derive(Debug, Clone)]
struct GivenOrder {
    subject: Subject,
    in_force: Range<Instant>,
}

/// The person at work, and the log that shows how the robots follow the orders.
pub(super) struct Supervisor {
    giver: JoinHandle<Vec<GivenOrder>>,
    given: Vec<GivenOrder>,
    bodies: BodyLog,
    recorders: JoinSet<()>,
    /// Client of the host of the world, for the log.
    _bus: SharedBus,
}

impl Supervisor {
    /// Starts the person, who works until the end, and the log.
    ///
    /// # Errors
    /// [`Failure::Unsuccessful`] if the client for the log cannot be opened.
    pub(super) async fn start(
        fleet: &ProcessFleet,
        client: RecordingClient,
        seed: u64,
        end: watch::Receiver<bool>,
    ) -> Result<Supervisor, Failure> {
        let bus = fleet.client(&[WORLD]).await?;
        let (bodies, mut recorders) = (BodyLog::default(), JoinSet::new());
        for carrier in CARRIERS {
            let states = bus.subscribe(&fleet.keys.write(&Key::Driver(slug(carrier), DriverCall::State))).await;
            let states = states.map_err(|problem| Failure::Unsuccessful(problem.to_string()))?;
            recorders.spawn(bodies.clone().record(states));
        }
        let giver = tokio::spawn(give_orders(client, seed, end));
        Ok(Supervisor { giver, given: vec![], bodies, recorders, _bus: bus })
    }

    /// Waits until the last order has ended.
    pub(super) async fn finish(&mut self) {
        if let Ok(given) = (&mut self.giver).await {
            self.given = given;
        }
    }

    /// Ends the log. Returns for each order the number of states of robots that follow it, or what a robot did instead.
    pub(super) async fn end(mut self) -> Vec<Result<usize, String>> {
        self.recorders.shutdown().await;
        self.given.iter().map(|order| order.check(&self.bodies)).collect()
    }
}

impl Subject {
    fn draw(chance: &mut ChaCha8Rng) -> Subject {
        if chance.random_bool(0.5) {
            let places: Vec<&str> = ROOMS.into_iter().chain(CORRIDORS).collect();
            return Subject::Place(slug(places[chance.random_range(0..places.len())]));
        }
        let robots: Vec<RobotId> = CARRIERS.into_iter().map(slug).collect();
        match robots.get(chance.random_range(0..=robots.len())) {
            Some(robot) => Subject::Robots(vec![robot.clone()]),
            None => Subject::Robots(robots),
        }
    }

    /// Returns the requests that begin and end the order.
    fn requests(&self) -> [(ApiCall, Value); 2] {
        match self {
            Subject::Robots(robots) => [
                (ApiCall::Hold, json!({ "robots": robots, "for_s": HOLD_S, "reason": "soak" })),
                (ApiCall::Release, json!({ "robots": robots })),
            ],
            Subject::Place(place) => [
                (ApiCall::Close, json!({ "places": [place], "reason": "soak" })),
                (ApiCall::Open, json!({ "places": [place] })),
            ],
        }
    }
}

impl GivenOrder {
    /// Checks that the robots have followed the order. Returns the number of states of robots that show it.
    ///
    /// # Errors
    /// Description of what a robot did.
    fn check(&self, log: &BodyLog) -> Result<usize, String> {
        let lease = LeaseTerms::default().lease;
        match &self.subject {
            Subject::Robots(robots) => robots.iter().map(|robot| log.check_held(robot, &self.in_force, lease)).sum(),
            Subject::Place(place) => {
                let carriers = CARRIERS.into_iter().map(slug);
                carriers.map(|robot: RobotId| log.check_closed(&robot, place, &self.in_force, lease)).sum()
            }
        }
    }
}

/// Gives orders, one at a time, until the end. The last is ended, too. Returns those that were acknowledged.
async fn give_orders(client: RecordingClient, seed: u64, mut end: watch::Receiver<bool>) -> Vec<GivenOrder> {
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0x0a5d);
    let mut given = vec![];
    for number in 1_u64.. {
        if ends_within(&mut end, chance.random_range(PAUSE_MS)).await {
            break;
        }
        let subject = Subject::draw(&mut chance);
        let [(begin, begin_request), (finish, finish_request)] = subject.requests();
        let person = format!("soak person {number}");
        let is_acknowledged = client.order(begin, begin_request, &person).await.is_some();
        let from = Instant::now();
        ends_within(&mut end, chance.random_range(IN_FORCE_MS)).await;
        let in_force = from..Instant::now();
        client.order(finish, finish_request, &format!("{person}, afterwards")).await;
        given.extend(is_acknowledged.then_some(GivenOrder { subject, in_force }));
    }
    given
}

/// Waits for this time, or until the end. Returns whether the end has come.
async fn ends_within(end: &mut watch::Receiver<bool>, for_ms: u64) -> bool {
    timeout(Duration::from_millis(for_ms), end.wait_for(|end| *end)).await.is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::api::{CloseRequest, HoldRequest, OpenRequest, ReleaseRequest};

    #[test]
    fn requests_are_those_of_the_api() {
        let [(begin, hold), (finish, release)] = Subject::Robots(vec![slug("ada")]).requests();
        assert_eq!((begin, finish), (ApiCall::Hold, ApiCall::Release));
        let longest_ms = u64::from(serde_json::from_value::<HoldRequest>(hold).unwrap().for_s.unwrap()) * 1_000;
        assert!(longest_ms > IN_FORCE_MS.end, "the person ends the hold");
        serde_json::from_value::<ReleaseRequest>(release).unwrap();
        let [(begin, close), (finish, open)] = Subject::Place(slug("Crossing")).requests();
        assert_eq!((begin, finish), (ApiCall::Close, ApiCall::Open));
        serde_json::from_value::<CloseRequest>(close).unwrap();
        serde_json::from_value::<OpenRequest>(open).unwrap();
    }

    #[test]
    fn the_closed_places_are_on_the_map() {
        let map = consort_world::map::shipped("hospital").expect("it is shipped");
        assert!(ROOMS.into_iter().chain(CORRIDORS).all(|place| map.place(&slug(place)).is_some()));
    }
}
