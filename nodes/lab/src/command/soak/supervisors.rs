//! People who give orders, the logs of what robots do, and what the logs show.

use super::fleet::ProcessFleet;
use super::names::{CARRIERS, ROBOTS, STATIONS, WORLD};
use super::orders::{Draw, GivenOrder, IN_FORCE_MS, Logs, Subject, all_over};
use consort_bus::SharedBus;
use consort_nodes::exit::Failure;
use consort_protocol::keys::{DriverCall, Key};
use consort_tests::history::RecordingClient;
use consort_tests::slug;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::ops::Range;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, timeout};

/// The people. Each gives an order at a time.
const PEOPLE: [Person; 2] = [
    Person { name: "soak person", salt: 0x0a5d, pause_ms: 15_000..25_000, draw: Subject::hold_or_closure },
    Person {
        name: "soak technician",
        salt: 0x7ec4,
        pause_ms: 20_000..40_000,
        draw: Subject::maintenance_limit_or_alarm,
    },
];

/// Interval at which a person ends all orders at the end: a request without a reply may have been executed later.
const ALL_OVER_INTERVAL: Duration = Duration::from_secs(10);

/// A person.
struct Person {
    name: &'static str,
    /// Changes the seed, so that the people draw different orders.
    salt: u64,
    /// Milliseconds between two orders. A request without a reply may be executed until the fault of its node has ended.
    pause_ms: Range<u64>,
    draw: Draw,
}

/// The people at work, and the logs.
pub(super) struct Supervisors {
    people: JoinSet<Vec<GivenOrder>>,
    given: Vec<GivenOrder>,
    logs: Logs,
    tasks: JoinSet<()>,
    client: RecordingClient,
    /// Client of the host of the world, for the log of bodies.
    _bus: SharedBus,
}

/// What the logs show.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Followed {
    /// Number of acknowledged orders of each kind.
    pub(super) orders: BTreeMap<&'static str, usize>,
    /// Number of states of robots and of the ledger that show that orders are followed.
    pub(super) states: usize,
    /// Number of times for which a carrier was connected to a charger.
    pub(super) charges: usize,
    /// What robots did instead.
    pub(super) violations: Vec<String>,
}

impl Supervisors {
    /// Starts the people, who work until the end, and the logs.
    ///
    /// # Errors
    /// [`Failure::Unsuccessful`] if the client for the log of bodies cannot be opened.
    pub(super) async fn start(
        fleet: &ProcessFleet,
        client: RecordingClient,
        seed: u64,
        end: &watch::Receiver<bool>,
    ) -> Result<Supervisors, Failure> {
        let bus = fleet.client(&[WORLD]).await?;
        let (logs, mut tasks) = (Logs::default(), JoinSet::new());
        for carrier in CARRIERS {
            let states = bus.subscribe(&fleet.keys.write(&Key::Driver(slug(carrier), DriverCall::State))).await;
            let states = states.map_err(|problem| Failure::Unsuccessful(problem.to_string()))?;
            tasks.spawn(logs.bodies.clone().record(states));
            tasks.spawn(logs.records.clone().record(client.bus.clone(), fleet.keys.clone(), slug(carrier)));
        }
        for station in STATIONS {
            let robots = ROBOTS.into_iter().map(slug).collect();
            tasks.spawn(logs.copies.clone().record(client.bus.clone(), fleet.keys.clone(), slug(station), robots));
        }
        let mut people = JoinSet::new();
        for person in PEOPLE {
            people.spawn(give_orders(client.clone(), person, seed, end.clone()));
        }
        Ok(Supervisors { people, given: vec![], logs, tasks, client, _bus: bus })
    }

    /// Waits until the last orders have ended. From then on a person ends all orders again and again.
    pub(super) async fn finish(&mut self) {
        while let Some(given) = self.people.join_next().await {
            self.given.extend(given.unwrap_or_default());
        }
        self.tasks.spawn(end_all(self.client.clone()));
    }

    /// Ends the logs, and returns what they show.
    pub(super) async fn end(mut self) -> Followed {
        self.tasks.shutdown().await;
        Followed::of(&self.given, &self.logs)
    }
}

impl Followed {
    fn of(given: &[GivenOrder], logs: &Logs) -> Followed {
        let mut followed = Followed::default();
        for order in given {
            *followed.orders.entry(order.subject.kind()).or_default() += 1;
            match order.check(given, logs) {
                Ok(states) => followed.states += states,
                Err(violation) => followed.violations.push(violation),
            }
        }
        match logs.records.check_chargers() {
            Ok(charges) => followed.charges = charges,
            Err(violation) => followed.violations.push(violation),
        }
        followed
    }
}

/// Gives orders, one at a time, until the end. The last is ended, too. Returns those that were acknowledged.
async fn give_orders(
    client: RecordingClient,
    person: Person,
    seed: u64,
    mut end: watch::Receiver<bool>,
) -> Vec<GivenOrder> {
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ person.salt);
    let mut given = vec![];
    for number in 1_u64.. {
        if ends_within(&mut end, chance.random_range(person.pause_ms.clone())).await {
            break;
        }
        let subject = (person.draw)(&mut chance);
        let [(begin, begin_request), (finish, finish_request)] = subject.requests();
        let name = format!("{} {number}", person.name);
        let is_acknowledged = client.order(begin, begin_request, &name).await.is_some();
        let from = Instant::now();
        ends_within(&mut end, chance.random_range(IN_FORCE_MS)).await;
        let in_force = from..Instant::now();
        client.order(finish, finish_request, &format!("{name}, afterwards")).await;
        let order = GivenOrder { person: format!("{name}, attempt"), subject, in_force };
        given.extend(is_acknowledged.then_some(order));
    }
    given
}

/// Ends all orders again and again.
async fn end_all(client: RecordingClient) {
    loop {
        for (call, request) in all_over() {
            client.order(call, request, "soak person, at the end").await;
        }
        sleep(ALL_OVER_INTERVAL).await;
    }
}

/// Waits for this time, or until the end. Returns whether the end has come.
async fn ends_within(end: &mut watch::Receiver<bool>, for_ms: u64) -> bool {
    timeout(Duration::from_millis(for_ms), end.wait_for(|end| *end)).await.is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_are_counted_by_kind() {
        let now = Instant::now();
        let order = |subject| GivenOrder { person: "person 1, attempt".to_owned(), subject, in_force: now..now };
        let given = [Subject::Alarm("fire"), Subject::Maintenance(slug("ada")), Subject::Alarm("freeze")].map(order);
        let orders = BTreeMap::from([("alarms", 2), ("maintenance", 1)]);
        assert_eq!(Followed::of(&given, &Logs::default()), Followed { orders, ..Followed::default() });
    }
}
