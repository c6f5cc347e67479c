//! A publication in transit.

use super::routing_table::Route;
use crate::bus::Sample;
use std::sync::Arc;

/// Number of entries in the table of the latest arrivals before past entries are removed.
pub(super) const EARLIEST_ARRIVALS_MIN: usize = 4_096;

/// A publication in transit, shared by all its receivers.
pub(super) struct Publication {
    pub(super) sample: Sample,
    pub(super) route: Arc<Route>,
    pub(super) edition: u64,
}

impl Publication {
    pub(super) fn bytes(&self) -> usize {
        self.route.key.len() + self.sample.payload.len() + self.sample.attachment.len()
    }
}
