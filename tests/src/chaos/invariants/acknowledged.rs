//! An acknowledged mission is in the ledger of every later coordinator, exactly once. A request
//! without a name counts as a new request each time it is sent. No request is executed twice, acknowledged or not, also
//! after the ledger has forgotten its outcome.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation, slug};
use consort_protocol::ids::{MissionId, NodeId, RequestId};
use consort_protocol::lease::Epoch;
use consort_protocol::ledger::{Command, Ledger};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

#[derive(Default)]
pub(super) struct Acknowledged {
    /// Missions of named requests.
    missions: BTreeMap<String, MissionId>,
    /// Missions of unnamed requests.
    unnamed: BTreeSet<MissionId>,
    /// Missions of all requests in the log.
    executed: BTreeMap<RequestId, MissionId>,
    /// Shows which ended missions are no longer remembered.
    reference: ReferenceLedger,
}

impl Acknowledged {
    /// Checks whether the limits of the history permit to forget a mission: a ledger that never restarts
    /// has forgotten it. It has been submitted, since each mission is acknowledged after its entry is applied.
    fn is_forgotten(&self, mission: &MissionId) -> bool {
        self.reference.ledger.mission_state(mission).is_none()
    }

    /// Applies new commands, and checks that they execute no request again.
    fn apply(&mut self, at: Epoch, commands: &[Command]) -> Result<(), InvariantViolation> {
        if !self.reference.is_new(at) {
            return Ok(());
        }
        for command in commands {
            self.reference.apply_command(at, command);
            if let Command::Submit(submission) = command {
                self.check_executed_once(&submission.request)?;
            }
        }
        self.reference.index = at.index;
        Ok(())
    }

    fn check_executed_once(&mut self, request: &RequestId) -> Result<(), InvariantViolation> {
        // It was refused, or its mission has ended.
        let Some(entry) = self.reference.ledger.mission_of_request(request) else { return Ok(()) };
        let first = self.executed.entry(request.clone()).or_insert_with(|| entry.id.clone());
        if *first == entry.id {
            return Ok(());
        }
        Err(format!("{request} was executed as {first} and again as {}", entry.id).into())
    }

    fn all_in_ledger_of(&self, node: &NodeId, fleet: &Fleet) -> Result<(), InvariantViolation> {
        let Some(replica) = fleet.nodes.get(node.as_str()).and_then(|node| node.replica.as_ref()) else {
            return Ok(());
        };
        replica.read(|ledger| {
            let is_lost = |mission: &&MissionId| ledger.mission_state(mission).is_none() && !self.is_forgotten(mission);
            if let Some(lost) = self.missions.values().chain(&self.unnamed).find(is_lost) {
                return Err(format!("{lost} was acknowledged, but the leader {node} does not have it").into());
            }
            for (request, mission) in &self.missions {
                let found = ledger.mission_of_request(&slug(request)).map(|entry| &entry.id);
                if let Some(found) = found.filter(|found| *found != mission) {
                    return Err(format!(
                        "{request} was acknowledged as {mission}, but the leader {node} has {found} for it"
                    )
                    .into());
                }
            }
            once_each(ledger)
        })
    }
}

fn once_each(ledger: &Ledger) -> Result<(), InvariantViolation> {
    let mut seen = BTreeMap::new();
    for entry in ledger.missions() {
        if let Some(other) = seen.insert(&entry.submission.request, &entry.id) {
            return Err(format!("request {} stands for both {other} and {}", entry.submission.request, entry.id).into());
        }
    }
    Ok(())
}

impl Invariant for Acknowledged {
    fn name(&self) -> &'static str {
        "acknowledged"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, fleet: &Fleet) -> Result<(), InvariantViolation> {
        match entry {
            Observation::EntryApplied { at, commands, .. } => self.apply(*at, commands),
            Observation::RequestAcknowledged { request: None, mission, .. } => {
                let asked_for = self.missions.values().any(|known| known == mission);
                if asked_for || !self.unnamed.insert(mission.clone()) {
                    return Err(
                        format!("{mission} was acknowledged to an unnamed request and to another request").into()
                    );
                }
                Ok(())
            }
            Observation::RequestAcknowledged { request: Some(request), mission, .. } => {
                match self.missions.get(request) {
                    Some(known) if known != mission => {
                        Err(format!("{request} was acknowledged as {known} and then as {mission}").into())
                    }
                    _ => {
                        self.missions.insert(request.clone(), mission.clone());
                        Ok(())
                    }
                }
            }
            Observation::LeadershipChanged { node, leading_as: Some(_), .. } => self.all_in_ledger_of(node, fleet),
            _ => Ok(()),
        }
    }

    fn check_end(&mut self, fleet: &Fleet) -> Result<(), InvariantViolation> {
        fleet.coordinating().map_or(Ok(()), |node| self.all_in_ledger_of(&node, fleet))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chaos::invariants::test_missions::{cancel, submit_rest};
    use consort_protocol::ledger::HistoryLimits;

    #[test]
    fn a_request_that_is_executed_again_after_it_was_forgotten_is_found() {
        let (mut state, mut index) = (Acknowledged::default(), 0);
        let mut apply = |command| {
            index += 1;
            state.apply(Epoch { term: 1, index }, &[command])
        };
        let limits = HistoryLimits { missions_max: 0, outcome_bytes_max: 0, ..HistoryLimits::default() };
        let first = [
            Command::first_wire_version(3),
            Command::SetHistoryLimits(limits),
            submit_rest("a"),
            submit_rest("a"),
            cancel("Nia", &["rest-1"]),
            submit_rest("b"),
        ];
        for command in first {
            assert_eq!(apply(command), Ok(()));
        }
        // The name contains no time, so the ledger cannot refuse it.
        let violation = apply(submit_rest("a")).unwrap_err().0;
        assert_eq!(violation, "a was executed as rest-1 and again as rest-3");
    }
}
