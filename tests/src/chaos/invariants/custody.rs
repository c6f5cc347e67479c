//! A sample moves along its path once: from a person into a drawer, and from there to an arm. A person with endless
//! samples takes a used sample again, for another path.

use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_world::world::{LoggedEvent, SampleHolder, SampleId, WorldEvent as InWorld};
use std::collections::BTreeMap;
use std::time::Duration;

#[derive(Default)]
pub(super) struct Custody {
    /// Number of times that each sample left a person, and that it reached an arm.
    samples: BTreeMap<SampleId, (u32, u32)>,
}

impl Invariant for Custody {
    fn name(&self) -> &'static str {
        "custody"
    }

    fn observe(&mut self, _: Duration, _: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        Ok(())
    }

    fn observe_world(&mut self, _: Duration, entry: &LoggedEvent, _: &Fleet) -> Result<(), InvariantViolation> {
        let InWorld::SampleMoved { sample, from, to } = &entry.event else { return Ok(()) };
        let counts = self.samples.entry(sample.clone()).or_default();
        match (from, to) {
            (SampleHolder::Person(_), _) => counts.0 += 1,
            (SampleHolder::Table(_), SampleHolder::Person(_)) => *counts = (0, 0),
            (SampleHolder::Drawer(_), SampleHolder::Arm(_)) => counts.1 += 1,
            _ => {}
        }
        if counts.0 > 1 || counts.1 > 1 {
            let (out, delivered) = counts;
            return Err(
                format!("{} was handed out {out} times and delivered {delivered} times", sample.as_str()).into()
            );
        }
        Ok(())
    }
}
