//! Every send has its wait, and every wait that was passed its send.
//!
//! A wait is passed only after what it waits for was said, by somebody who was active in that role then (which
//! [`under_lease`](super::under_lease) sees to). When a mission was carried out, nothing that was said in it is unheard.

use super::Invariant;
use crate::{Entry, Fleet};
use consort_protocol::event::Happening;
use consort_protocol::ids::MissionId;
use consort_protocol::ledger::MissionState;
use consort_protocol::plan::Signal;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

#[derive(Default)]
pub(super) struct Signals {
    said: BTreeMap<MissionId, BTreeSet<Signal>>,
    heard: BTreeMap<MissionId, BTreeSet<Signal>>,
}

impl Invariant for Signals {
    fn name(&self) -> &'static str {
        "signals"
    }

    fn see(&mut self, _: Duration, entry: &Entry, _: &Fleet) -> Result<(), String> {
        match entry.happening() {
            Some(Happening::Sent { mission, signal }) => {
                self.said.entry(mission.clone()).or_default().insert(signal.clone());
            }
            Some(Happening::Heard { mission, signal }) => {
                if !self.said.get(mission).is_some_and(|said| said.contains(signal)) {
                    return Err(format!("{} goes on in {mission} after {signal:?}, which nobody said", entry.node()));
                }
                self.heard.entry(mission.clone()).or_default().insert(signal.clone());
            }
            _ => {}
        }
        Ok(())
    }

    fn end(&mut self, fleet: &Fleet) -> Result<(), String> {
        for (mission, said) in &self.said {
            if fleet.state_of(mission) != Some(MissionState::Completed) {
                continue;
            }
            let heard = self.heard.get(mission);
            if let Some(signal) = said.iter().find(|signal| !heard.is_some_and(|heard| heard.contains(signal))) {
                return Err(format!("{mission} was carried out, and nobody heard {signal:?}"));
            }
        }
        Ok(())
    }
}
