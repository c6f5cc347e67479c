//! Orders of simulated people to cancel a mission.

use consort_protocol::ids::{MissionId, RobotId};
use std::collections::VecDeque;

/// Number of recent cancel orders that are recognised as repetitions. The driver server repeats an
/// order for some publish intervals, 2.5 s with the defaults, and not later. People who each stand
/// at a place do not send more than this number meanwhile. Raised: more memory, no other effect.
const ORDERS_MAX: usize = 256;

/// Order of a person to cancel the mission of a robot that came.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct CancelOrder {
    /// Name of the person.
    pub(super) by: String,
    /// The robot.
    pub(super) robot: RobotId,
    /// World time of the order in milliseconds.
    pub(super) at_ms: u64,
}

/// Recent orders with their missions, oldest first. A repeated order must not cancel the next mission.
#[derive(Debug, Default)]
pub(super) struct RecentCancelOrders(VecDeque<(CancelOrder, MissionId)>);

impl RecentCancelOrders {
    /// Returns the mission of a repeated order.
    pub(super) fn mission(&self, order: &CancelOrder) -> Option<&MissionId> {
        self.0.iter().find(|(known, _)| known == order).map(|(_, mission)| mission)
    }

    /// Adds an order with the mission that it cancels.
    pub(super) fn add(&mut self, order: CancelOrder, mission: MissionId) {
        self.0.push_back((order, mission));
        if self.0.len() > ORDERS_MAX {
            self.0.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_repeated_order_keeps_its_mission_and_memory_is_bounded() {
        let order =
            |by: &str, robot: &str, at_ms| CancelOrder { by: by.to_owned(), robot: robot.parse().unwrap(), at_ms };
        let first = MissionId::new("vital-signs-1").unwrap();
        let mut orders = RecentCancelOrders::default();
        orders.add(order("Nia", "amber", 1000), first.clone());
        assert_eq!(orders.mission(&order("Nia", "amber", 1000)), Some(&first));
        // Another time may be that of a restarted world.
        for other in [order("Nia", "amber", 0), order("Ria", "amber", 1000), order("Nia", "birch", 1000)] {
            assert_eq!(orders.mission(&other), None);
        }
        for at_ms in 10_000..20_000 {
            orders.add(order("Nia", "amber", at_ms), first.clone());
        }
        assert_eq!(orders.0.len(), ORDERS_MAX, "the number is bounded");
        assert_eq!(orders.mission(&order("Nia", "amber", 1000)), None);
    }
}
