//! A sample goes its way once: from a person into one drawer, from there to one arm.

use super::Invariant;
use crate::{Entry, Fleet};
use consort_sim::world::{Happening as InWorld, JournalEntry, Keeper, SampleId};
use std::collections::BTreeMap;
use std::time::Duration;

#[derive(Default)]
pub(super) struct Custody {
    /// How often each sample was handed out by a person, and how often it was delivered to an arm.
    samples: BTreeMap<SampleId, (u32, u32)>,
}

impl Invariant for Custody {
    fn name(&self) -> &'static str {
        "custody"
    }

    fn see(&mut self, _: Duration, _: &Entry, _: &Fleet) -> Result<(), String> {
        Ok(())
    }

    fn see_world(&mut self, _: Duration, entry: &JournalEntry, _: &Fleet) -> Result<(), String> {
        let InWorld::SampleMoved { sample, from, to } = &entry.what else { return Ok(()) };
        let counts = self.samples.entry(sample.clone()).or_default();
        match (from, to) {
            (Keeper::Person(_), _) => counts.0 += 1,
            (Keeper::Drawer(_), Keeper::Arm(_)) => counts.1 += 1,
            _ => {}
        }
        if counts.0 > 1 || counts.1 > 1 {
            let (out, delivered) = counts;
            return Err(format!("{} was handed out {out} times and delivered {delivered} times", sample.as_str()));
        }
        Ok(())
    }
}
