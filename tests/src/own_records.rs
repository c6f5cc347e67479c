//! Log of what the nodes of robots state in their own records, and what must hold in it about chargers.
//!
//! A robot in a role follows orders by its lease; a free robot, which charges and parks by itself, follows those that it has
//! received. So the log also shows from when on a robot is bound by an order.

use crate::order_bounds::CHARGER_CONTACT;
use bytes::Bytes;
use consort_bus::SharedBus;
use consort_protocol::ids::{NodeId, PlaceId, RobotId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::knowledge::{Availability, Charging};
use consort_protocol::view::FleetView;
use serde::de::DeserializeOwned;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::{Instant, sleep_until};

/// Interval at which a node is asked.
pub(crate) const INTERVAL: Duration = Duration::from_secs(1);

/// Timeout of a reply.
const REPLY_TIMEOUT: Duration = Duration::from_millis(800);

/// Longest time between two statements in a period without interruption: a lost reply.
const GAP: Duration = Duration::from_secs(3);

/// What a node states about its robot.
#[derive(Debug, Clone, PartialEq)]
struct Statement {
    /// Times of the request and of the reply.
    asked: Instant,
    replied: Instant,
    /// Number of the start of the node.
    incarnation: u64,
    availability: Availability,
    /// The charger to which the robot is connected.
    charger: Option<PlaceId>,
    /// Nodes that count as alive.
    alive: BTreeSet<NodeId>,
}

/// The log. Clones share the same statements.
#[derive(Debug, Clone, Default)]
pub struct OwnRecords(Arc<Mutex<BTreeMap<RobotId, Vec<Statement>>>>);

/// Queries a node for a view that it draws alone; `None` without a reply in time.
pub(crate) async fn view_of<T: DeserializeOwned>(bus: &SharedBus, keys: &Keys, node: &NodeId, view: Key) -> Option<T> {
    let key = keys.write(&Key::Seen(node.clone(), Box::new(view)));
    let mut replies = bus.query(&key, Bytes::new(), REPLY_TIMEOUT).await.ok()?;
    serde_json::from_slice(&replies.recv().await?.payload.ok()?).ok()
}

impl Statement {
    /// Returns what a node states in its view of the fleet; `None` if the view does not contain its robot.
    fn of(node: &NodeId, view: FleetView, asked: Instant, replied: Instant) -> Option<Statement> {
        let alive = view.nodes.iter().filter(|other| other.contact.alive).map(|other| other.node.clone()).collect();
        let record = view.nodes.into_iter().find(|own| own.node == *node)?.record;
        let robot = record.robot?;
        let charger = match robot.charging {
            Some(Charging::Connected(claim)) => Some(claim.charger),
            _ => None,
        };
        let (incarnation, availability) = (record.incarnation, robot.availability);
        Some(Statement { asked, replied, incarnation, availability, charger, alive })
    }

    fn is_in_role(&self) -> bool {
        matches!(self.availability, Availability::Holding { .. })
    }

    /// Checks whether the robot is out of service for an order of this person.
    fn names(&self, person: &str) -> bool {
        matches!(&self.availability, Availability::OutOfService { problem } if problem.contains(person))
    }

    /// Checks whether this is the next statement of the same process.
    fn continues(&self, earlier: &Statement) -> bool {
        self.incarnation == earlier.incarnation && self.replied - earlier.replied <= GAP
    }
}

impl OwnRecords {
    /// Records the statements of the node of a robot for ever.
    pub async fn record(self, bus: SharedBus, keys: Keys, robot: RobotId) {
        let node = NodeId::from(robot.clone());
        loop {
            let asked = Instant::now();
            let view: Option<FleetView> = view_of(&bus, &keys, &node, Key::ViewFleet).await;
            if let Some(statement) = view.and_then(|view| Statement::of(&node, view, asked, Instant::now())) {
                self.lock().entry(robot.clone()).or_default().push(statement);
            }
            sleep_until(asked + INTERVAL).await;
        }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<RobotId, Vec<Statement>>> {
        // Each write is a single step.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the parts of a period in which a robot has a role.
    pub fn in_role(&self, robot: &RobotId, period: &Range<Instant>) -> Vec<Range<Instant>> {
        self.parts(robot, period, Statement::is_in_role)
    }

    /// Returns the parts of a period in which a robot is bound by an order of this person: it has a role, or states the
    /// order.
    pub fn bound(&self, robot: &RobotId, person: &str, period: &Range<Instant>) -> Vec<Range<Instant>> {
        self.parts(robot, period, |statement| statement.is_in_role() || statement.names(person))
    }

    fn parts(
        &self,
        robot: &RobotId,
        period: &Range<Instant>,
        is_stated: impl Fn(&Statement) -> bool,
    ) -> Vec<Range<Instant>> {
        let log = self.lock();
        let stated = log.get(robot).map(|statements| runs(statements, is_stated));
        stated.unwrap_or_default().iter().filter_map(|run| common(run, period)).collect()
    }

    /// Checks that no robot connects to a charger at which another is connected, if their nodes were in contact then: two
    /// robots that have missed each other's claims may meet there, and one of them may be held before it can leave. Returns
    /// the number of periods in which a robot was connected.
    ///
    /// # Errors
    /// Description of the first two robots.
    pub fn check_chargers(&self) -> Result<usize, String> {
        let log = self.lock();
        let mut connections: Vec<(&RobotId, &PlaceId, Range<Instant>)> = vec![];
        for (robot, statements) in &*log {
            let chargers: BTreeSet<&PlaceId> = statements.iter().filter_map(|stated| stated.charger.as_ref()).collect();
            for charger in chargers {
                let connected = runs(statements, |stated| stated.charger.as_ref() == Some(charger));
                connections.extend(connected.into_iter().map(|period| (robot, charger, period)));
            }
        }
        // A robot connects up to `GAP` before it first states so.
        let in_contact = |robot: &RobotId, other: &RobotId, at: Instant| {
            let other = NodeId::from(other.clone());
            let stated = log.get(robot).map(|statements| runs(statements, |stated| stated.alive.contains(&other)));
            stated.unwrap_or_default().iter().any(|run| run.start + CHARGER_CONTACT + GAP <= at && at <= run.end)
        };
        for (number, (robot, charger, period)) in connections.iter().enumerate() {
            let others =
                connections[number + 1..].iter().filter(|(other, place, _)| other != robot && place == charger);
            for (other, _, others_period) in others {
                let Some(both) = common(period, others_period) else { continue };
                if in_contact(robot, other, both.start) && in_contact(other, robot, both.start) {
                    return Err(format!(
                        "{robot} and {other} were in contact, and both connected to the charger {charger}"
                    ));
                }
            }
        }
        Ok(connections.len())
    }
}

/// Returns the periods in which the statements of a robot continue and contain what `is_stated` looks for: from the first
/// reply to the last request.
fn runs(statements: &[Statement], is_stated: impl Fn(&Statement) -> bool) -> Vec<Range<Instant>> {
    let mut runs: Vec<Range<Instant>> = vec![];
    let mut last: Option<&Statement> = None;
    for statement in statements {
        if !is_stated(statement) {
            last = None;
            continue;
        }
        if last.is_some_and(|last| statement.continues(last))
            && let Some(run) = runs.last_mut()
        {
            run.end = statement.asked;
        } else {
            runs.push(statement.replied..statement.replied);
        }
        last = Some(statement);
    }
    runs.retain(|run| run.start < run.end);
    runs
}

/// Returns the common part of two periods, if there is any.
fn common(one: &Range<Instant>, other: &Range<Instant>) -> Option<Range<Instant>> {
    let common = one.start.max(other.start)..one.end.min(other.end);
    (common.start < common.end).then_some(common)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slug;

    fn seconds(seconds: f64) -> Duration {
        Duration::from_secs_f64(seconds)
    }

    /// Adds a statement each second of a period, with a reply after 0.2 s.
    fn add(log: &OwnRecords, robot: &str, start: Instant, period: Range<u32>, change: impl Fn(&mut Statement)) {
        for second in period {
            let asked = start + seconds(f64::from(second));
            let mut statement = Statement {
                asked,
                replied: asked + seconds(0.2),
                incarnation: 1,
                availability: Availability::Free,
                charger: None,
                alive: BTreeSet::from(["ada", "bob"].map(slug)),
            };
            change(&mut statement);
            log.lock().entry(slug(robot)).or_default().push(statement);
        }
    }

    fn hold_role(statement: &mut Statement) {
        let (mission, role) = ("lab-samples-1".parse().unwrap(), slug("r1"));
        statement.availability = Availability::Holding { mission, role, suspended: false };
    }

    fn state_hold(statement: &mut Statement) {
        let problem = "held by person 1, attempt 2: soak".to_owned();
        statement.availability = Availability::OutOfService { problem };
    }

    #[test]
    fn a_robot_is_bound_while_it_has_a_role_or_states_the_order() {
        let (log, start, ada) = (OwnRecords::default(), Instant::now(), slug::<RobotId>("ada"));
        add(&log, "ada", start, 0..10, hold_role);
        add(&log, "ada", start, 10..20, |_| ());
        add(&log, "ada", start, 20..30, hold_role);
        add(&log, "ada", start, 30..40, state_hold);
        let at = |from_s: f64, to_s: f64| start + seconds(from_s)..start + seconds(to_s);
        let all = at(5.0, 60.0);
        assert_eq!(log.in_role(&ada, &all), [at(5.0, 9.0), at(20.2, 29.0)]);
        assert_eq!(log.bound(&ada, "person 1,", &all), [at(5.0, 9.0), at(20.2, 39.0)]);
        assert_eq!(log.bound(&ada, "person 12,", &all), log.in_role(&ada, &all), "the order of another person");
        assert!(log.bound(&slug("bob"), "person 1,", &all).is_empty());
    }

    #[test]
    fn an_interruption_or_a_restart_begins_a_new_period() {
        let (log, start, ada) = (OwnRecords::default(), Instant::now(), slug::<RobotId>("ada"));
        add(&log, "ada", start, 0..10, hold_role);
        add(&log, "ada", start, 12..20, hold_role);
        add(&log, "ada", start, 23..30, hold_role);
        add(&log, "ada", start, 30..40, |statement| {
            hold_role(statement);
            statement.incarnation = 2;
        });
        let at = |from_s: f64, to_s: f64| start + seconds(from_s)..start + seconds(to_s);
        assert_eq!(log.in_role(&ada, &at(0.0, 60.0)), [at(0.2, 19.0), at(23.2, 29.0), at(30.2, 39.0)]);
    }

    #[test]
    fn a_robot_that_connects_beside_another_is_found_if_they_were_in_contact() {
        let connections = |bobs: &str, period: Range<u32>, contact_from: u32| {
            let (log, start) = (OwnRecords::default(), Instant::now());
            for second in 0..40 {
                let state = |statement: &mut Statement, charger: &str, connected: Range<u32>| {
                    statement.charger = connected.contains(&second).then(|| slug(charger));
                    if second < contact_from {
                        statement.alive.clear();
                    }
                };
                add(&log, "ada", start, second..second + 1, |statement| state(statement, "Dock", 5..30));
                add(&log, "bob", start, second..second + 1, |statement| state(statement, bobs, period.clone()));
            }
            log.check_chargers()
        };
        let violation = "ada and bob were in contact, and both connected to the charger Dock";
        assert_eq!(connections("Dock", 15..40, 0), Err(violation.to_owned()));
        assert_eq!(connections("Dock", 15..40, 5), Ok(2), "the claims may not have arrived");
        assert_eq!(connections("Dock", 15..40, 16), Ok(2), "the contact begins after they have met");
        assert_eq!(connections("PC Room 8", 15..40, 0), Ok(2));
        assert_eq!(connections("Dock", 31..40, 0), Ok(2), "one after the other");
    }
}
