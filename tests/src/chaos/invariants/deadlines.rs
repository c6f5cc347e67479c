//! A mission fails by its deadline only after the deadline, by the true time.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::chaos::dates::DATE_MS;
use crate::{Fleet, Observation};
use consort_protocol::ledger::Command;
use std::time::Duration;

/// Largest difference between the confirmed time and the true time: clocks that drift by 5 % for five
/// minutes, and the time between two readings of the clocks.
const TOLERANCE: Duration = Duration::from_secs(20);

#[derive(Default)]
pub(super) struct Deadlines {
    reference: ReferenceLedger,
}

impl Invariant for Deadlines {
    fn name(&self) -> &'static str {
        "deadlines"
    }

    fn observe(&mut self, at: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        if let Observation::EntryApplied { commands, .. } = entry {
            // Only a deadline fails a mission in whatever branch.
            let failed = commands.iter().filter_map(|command| match command {
                Command::Fail { mission, branch: None, .. } => self.reference.ledger.mission(mission),
                _ => None,
            });
            for entry in failed.filter(|entry| !entry.state.is_final()) {
                let deadline = entry.submission.deadline_ms.map(|date_ms| date_ms.saturating_sub(DATE_MS));
                if let Some(early) = deadline.and_then(|ms| Duration::from_millis(ms).checked_sub(at + TOLERANCE)) {
                    return Err(format!(
                        "{} failed by its deadline, which is more than {:.1} s ahead",
                        entry.id,
                        early.as_secs_f64()
                    )
                    .into());
                }
            }
        }
        self.reference.observe(entry);
        Ok(())
    }
}
