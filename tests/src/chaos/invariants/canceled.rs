//! A person that cancels several missions at once ends these missions, each once, and no other.
//!
//! The log states which missions a request has found. Each of them is among those that the schedule of the run selects, and
//! has ended, or needs intervention, after the entry; the others are as before. The audit trail has one entry for each
//! canceled mission.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::chaos::person_action::CancelSelection;
use crate::chaos::request_ids::is_named;
use crate::{Fleet, Observation};
use consort_protocol::ids::MissionId;
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{AuditAction, Command, Ledger, MissionEntry, MissionState};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

pub(super) struct Canceled {
    /// With all ended missions: a mission may end, and be dropped, before the entry that cancels it.
    reference: ReferenceLedger,
    /// What people cancel at once, by their names.
    selections: BTreeMap<String, CancelSelection>,
}

impl Canceled {
    pub(super) fn new(selections: BTreeMap<String, CancelSelection>) -> Canceled {
        Canceled { reference: ReferenceLedger::keeping_all(), selections }
    }

    fn apply(&mut self, at: Epoch, commands: &[Command]) -> Result<(), InvariantViolation> {
        if !self.reference.is_new(at) {
            return Ok(());
        }
        for command in commands {
            let Command::CancelMissions { order } = command else {
                self.reference.apply_command(at, command);
                continue;
            };
            let missions: BTreeSet<&MissionId> = order.change.missions.keys().collect();
            self.check_selected(&order.by, &missions)?;
            let before = open_missions(&self.reference.ledger);
            self.reference.apply_command(at, command);
            self.check_ended(&order.by, &missions, &before)?;
        }
        self.reference.index = at.index;
        Ok(())
    }

    /// Checks that a person has selected these missions.
    fn check_selected(&self, by: &str, missions: &BTreeSet<&MissionId>) -> Result<(), InvariantViolation> {
        let person = by.split(", attempt ").next().unwrap_or(by);
        let is_selected = |mission: &&&MissionId| {
            let entry = self.reference.ledger.mission(mission);
            entry.zip(self.selections.get(person)).is_some_and(|(entry, selection)| selects(selection, entry))
        };
        match missions.iter().find(|mission| !is_selected(mission)) {
            Some(mission) => Err(format!("{by} cancels {mission}, which is not selected").into()),
            None => Ok(()),
        }
    }

    /// Checks the missions that were open `before` the cancelation.
    fn check_ended(
        &self,
        by: &str,
        missions: &BTreeSet<&MissionId>,
        before: &BTreeMap<MissionId, MissionState>,
    ) -> Result<(), InvariantViolation> {
        let after = open_missions(&self.reference.ledger);
        for (mission, state) in before {
            match (missions.contains(mission), after.get(mission)) {
                (true, Some(_)) => return Err(format!("{mission} goes on after {by} has canceled it").into()),
                (false, other) if other != Some(state) => {
                    return Err(format!("{by} has canceled other missions, and {mission} has changed").into());
                }
                _ => {}
            }
        }
        Ok(())
    }
}

/// Checks whether a selection contains a mission.
fn selects(selection: &CancelSelection, entry: &MissionEntry) -> bool {
    match selection {
        CancelSelection::Requests(requests) => {
            requests.iter().any(|request| is_named(&entry.submission.request, request))
        }
        CancelSelection::Named(mission) => mission == entry.submission.mission.name.as_str(),
    }
}

/// Returns the states of the missions that wait or run.
fn open_missions(ledger: &Ledger) -> BTreeMap<MissionId, MissionState> {
    let is_open = |entry: &&MissionEntry| matches!(entry.state, MissionState::Pending | MissionState::Running);
    ledger.missions().filter(is_open).map(|entry| (entry.id.clone(), entry.state.clone())).collect()
}

/// Checks that no mission is canceled twice in the audit trail.
fn check_trail(ledger: &Ledger) -> Result<(), InvariantViolation> {
    let mut seen = BTreeSet::new();
    let mut canceled = ledger.audit_trail().filter(|entry| entry.action == AuditAction::Cancel);
    match canceled.find(|entry| !seen.insert(&entry.subject)) {
        Some(again) => Err(format!("{} is canceled twice in the audit trail", again.subject).into()),
        None => Ok(()),
    }
}

impl Invariant for Canceled {
    fn name(&self) -> &'static str {
        "canceled"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        match entry {
            Observation::EntryApplied { at, commands, .. } => self.apply(*at, commands),
            _ => Ok(()),
        }
    }

    fn check_end(&mut self, fleet: &Fleet) -> Result<(), InvariantViolation> {
        fleet.ledger(check_trail).unwrap_or(Ok(()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chaos::invariants::test_missions::{cancel, submit_rest};
    use crate::slug;

    /// Returns the result of a cancelation in a ledger with the missions of the requests `a` and `b`.
    fn canceled(selection: CancelSelection, missions: &[&str]) -> Result<Canceled, InvariantViolation> {
        let mut state = Canceled::new([("person 3".to_owned(), selection)].into());
        let submitted = [Command::first_wire_version(3), submit_rest("a"), submit_rest("b")];
        state.apply(Epoch { term: 1, index: 1 }, &submitted)?;
        state.apply(Epoch { term: 1, index: 2 }, &[cancel("person 3, attempt 2, according to client", missions)])?;
        Ok(state)
    }

    #[test]
    fn only_selected_missions_are_canceled() {
        let of_request = || CancelSelection::Requests(vec!["a".to_owned()]);
        let state = canceled(of_request(), &["rest-1"]).unwrap_or_else(|found| panic!("{found:?}"));
        assert_eq!(check_trail(&state.reference.ledger), Ok(()));
        let violation = canceled(of_request(), &["rest-1", "rest-2"]).map(|_| ()).unwrap_err().0;
        assert_eq!(violation, "person 3, attempt 2, according to client cancels rest-2, which is not selected");
        let of_name = |name: &str| canceled(CancelSelection::Named(name.to_owned()), &["rest-1", "rest-2"]);
        assert!(of_name("rest").is_ok());
        assert!(of_name("lab-samples").is_err());
    }

    #[test]
    fn a_mission_that_goes_on_or_ends_besides_is_found() {
        let state = canceled(CancelSelection::Named("rest".to_owned()), &["rest-1"]);
        let state = state.unwrap_or_else(|found| panic!("{found:?}"));
        let (one, two): (MissionId, MissionId) = (slug("rest-1"), slug("rest-2"));
        let before = BTreeMap::from([(one.clone(), MissionState::Pending), (two.clone(), MissionState::Pending)]);
        assert_eq!(state.check_ended("Nia", &[&one].into(), &before), Ok(()));
        let violation = state.check_ended("Nia", &[&one, &two].into(), &before).unwrap_err().0;
        assert_eq!(violation, "rest-2 goes on after Nia has canceled it");
        let violation = state.check_ended("Nia", &BTreeSet::new(), &before).unwrap_err().0;
        assert_eq!(violation, "Nia has canceled other missions, and rest-1 has changed");
    }
}
