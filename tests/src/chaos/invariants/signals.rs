//! Every send has its wait, and every wait that was passed its send.
//!
//! A wait is passed only after what it waits for was said, by somebody who was active in that role then (which
//! [`under_lease`](super::under_lease) sees to). When a mission was carried out, nothing that was said in it is unheard, but by
//! a role that was taken from its holder when only cleaning up was left of it. What was said before a recovery branch was taken
//! is of no account then.

use super::Invariant;
use super::reference_ledger::ReferenceLedger;
use crate::{Fleet, Observation};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RoleId};
use consort_protocol::ledger::{MissionEntry, MissionState};
use consort_protocol::plan::{Signal, Step, StepAction};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

#[derive(Default)]
pub(super) struct Signals {
    said: BTreeMap<MissionId, BTreeSet<Signal>>,
    heard: BTreeMap<MissionId, BTreeSet<Signal>>,
    /// Of what was told to the ledger, for when nobody who keeps one is left.
    reference: ReferenceLedger,
}

/// Whether a role ended before all its steps had, because it was taken from its holder.
fn cut_short(entry: &MissionEntry, role: &RoleId) -> bool {
    let steps = entry.plan(role).map_or(0, |plan| plan.steps.len());
    let ended = entry.roles.get(role).map_or(0, |role| role.ended.len());
    ended < steps && entry.releases.iter().any(|released| released.role == *role)
}

/// Whether the plans that were carried out have it: those of a recovery branch do not have what was said before.
fn concerns(entry: &MissionEntry, signal: &Signal) -> bool {
    let says = |step: &Step| matches!(&step.action, StepAction::Send(of) if of == signal);
    entry.plan(&signal.from).is_some_and(|plan| plan.steps.iter().any(says))
}

impl Invariant for Signals {
    fn name(&self) -> &'static str {
        "signals"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), String> {
        self.reference.observe(entry);
        match entry.event_kind() {
            Some(EventKind::Sent { mission, signal }) => {
                self.said.entry(mission.clone()).or_default().insert(signal.clone());
            }
            Some(EventKind::Heard { mission, signal }) => {
                let said = self.said.get(mission).is_some_and(|said| said.contains(signal));
                // A teller that was lost in the act has told the ledger before it told anybody.
                let of_mission = self.reference.ledger.mission(mission);
                let told = of_mission.is_some_and(|entry| entry.signals_to(&signal.to).contains(signal));
                if !said && !told {
                    return Err(format!("{} goes on in {mission} after {signal:?}, which nobody said", entry.node()));
                }
                self.heard.entry(mission.clone()).or_default().insert(signal.clone());
            }
            _ => {}
        }
        Ok(())
    }

    fn check_end(&mut self, fleet: &Fleet) -> Result<(), String> {
        for (mission, said) in &self.said {
            if fleet.mission_state(mission) != Some(MissionState::Completed) {
                continue;
            }
            let heard = self.heard.get(mission);
            let unheard = said.iter().filter(|signal| !heard.is_some_and(|heard| heard.contains(signal)));
            for signal in unheard {
                let excused = |entry: &MissionEntry| cut_short(entry, &signal.to) || !concerns(entry, signal);
                if fleet.ledger(|ledger| ledger.mission(mission).is_some_and(excused)) != Some(true) {
                    return Err(format!("{mission} was carried out, and nobody heard {signal:?}"));
                }
            }
        }
        Ok(())
    }
}
