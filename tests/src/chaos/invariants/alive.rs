//! A node ends only when it is killed.
//!
//! By design, a failing actor ends its node, and the supervisor of the node restarts it. No fault
//! of the network, of another node or of a slow disk may cause that; a disk that cannot be written may.

use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use std::time::Duration;

pub(super) struct Alive;

impl Invariant for Alive {
    fn name(&self) -> &'static str {
        "alive"
    }

    fn observe(&mut self, _: Duration, _: &Observation, fleet: &Fleet) -> Result<(), InvariantViolation> {
        let running = fleet.nodes.iter().filter(|(name, _)| !fleet.unwritable.contains(*name));
        match running.filter_map(|(name, node)| Some((name, node.end_cause()?))).next() {
            Some((name, cause)) => Err(format!("the node {name} ended by itself: {cause}").into()),
            None => Ok(()),
        }
    }
}
