//! The queue of the robots that would use a charger.

use super::ChargerUser;
use crate::ids::{PlaceId, RobotId};
use crate::knowledge::Charging;
use std::collections::BTreeMap;

/// Maximum number of robots in the queue; those with the most charge are left out. A guess.
const QUEUE_MAX: usize = 256;

/// Share of a full battery by which a waiting robot must have less charge to overtake another. Raised: the order changes
/// less often while the robots wait. As large as the changes of charge that robots publish.
const OVERTAKE_MIN: f64 = 0.02;

/// Robots that would use a charger, in the order in which they get one: less charge first.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ChargerQueue(Vec<RobotId>);

impl ChargerQueue {
    /// Adopts the wishes in the records of the robots.
    pub fn update(&mut self, robots: &[ChargerUser]) {
        let wishes = robots.iter().filter(|user| user.is_alive && user.wishes().next().is_some());
        let charges: BTreeMap<&RobotId, f64> = wishes.map(|user| (&user.robot, charge(user))).collect();
        self.0.retain(|robot| charges.contains_key(robot));
        for (robot, charge) in &charges {
            if !self.0.contains(robot) {
                let follows = self.0.iter().position(|other| charges[other] > *charge);
                self.0.insert(follows.unwrap_or(self.0.len()), (*robot).clone());
            }
        }
        for end in 1..self.0.len() {
            let mut at = end;
            while at > 0 && charges[&self.0[at]] + OVERTAKE_MIN < charges[&self.0[at - 1]] {
                self.0.swap(at, at - 1);
                at -= 1;
            }
        }
        self.0.truncate(QUEUE_MAX);
    }

    /// Returns the robots in their order.
    pub fn robots(&self) -> impl Iterator<Item = &RobotId> {
        self.0.iter()
    }

    /// Returns the robots that wait for each charger, by these records.
    pub fn waiting(robots: &[ChargerUser]) -> BTreeMap<PlaceId, Vec<RobotId>> {
        let mut queue = ChargerQueue::default();
        queue.update(robots);
        let users: BTreeMap<&RobotId, &ChargerUser> = robots.iter().map(|user| (&user.robot, user)).collect();
        let mut waiting: BTreeMap<PlaceId, Vec<RobotId>> = BTreeMap::new();
        for robot in queue.robots() {
            if let Some(Charging::Waiting { chargers }) = users.get(robot).and_then(|user| user.charging.as_ref()) {
                for charger in chargers {
                    waiting.entry(charger.clone()).or_default().push(robot.clone());
                }
            }
        }
        waiting
    }
}

/// Returns the charge that counts: that at the time of its claim, or its present charge.
fn charge(user: &ChargerUser) -> f64 {
    let claim = user.charging.as_ref().and_then(Charging::claim);
    claim.map_or(user.battery, |claim| claim.battery).get()
}
