//! Every wait that passes has its send, and every send has its wait.
//!
//! A wait passes only after its signal was sent by the active holder of the role
//! ([`under_lease`](super::under_lease) checks that it is active). When a mission has completed,
//! every sent signal was received. There are two exceptions: the receiving role was released when
//! only cleanup remained, or the signal was sent before a recovery branch was taken. The roles of
//! people are executed in the ledger, so it shows which signals they have received; a coordinator
//! that ends may leave its event unpublished.

use super::reference_ledger::ReferenceLedger;
use super::{Invariant, InvariantViolation};
use crate::{Fleet, Observation};
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, RoleId};
use consort_protocol::ledger::{MissionEntry, MissionState};
use consort_protocol::mission::RoleKind;
use consort_protocol::plan::{Signal, Step, StepAction};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

pub(super) struct Signals {
    sent: BTreeMap<MissionId, BTreeSet<Signal>>,
    received: BTreeMap<MissionId, BTreeSet<Signal>>,
    /// Signals in the ledger, for cases in which no voter is left.
    reference: ReferenceLedger,
}

impl Default for Signals {
    fn default() -> Signals {
        Signals { sent: BTreeMap::new(), received: BTreeMap::new(), reference: ReferenceLedger::keeping_all() }
    }
}

/// Checks whether a role ended before all of its steps because it was released.
fn cut_short(entry: &MissionEntry, role: &RoleId) -> bool {
    let steps = entry.plan(role).map_or(0, |plan| plan.steps.len());
    let ended = entry.roles.get(role).map_or(0, |role| role.ended.len());
    ended < steps && entry.releases.iter().any(|released| released.role == *role)
}

/// Checks whether the executed plans contain the signal. Plans of a recovery branch do not contain
/// earlier signals.
fn concerns(entry: &MissionEntry, signal: &Signal) -> bool {
    let sends = |step: &Step| matches!(&step.action, StepAction::Send(of) if of == signal);
    entry.plan(&signal.from).is_some_and(|plan| plan.steps.iter().any(sends))
}

/// Checks whether the ledger contains the wait for a signal as ended, in the role of a person.
fn has_ended_wait(entry: &MissionEntry, signal: &Signal) -> bool {
    let is_wait = |step: &Step| matches!(&step.action, StepAction::Wait(of) if of == signal);
    let wait = entry.plan(&signal.to).and_then(|plan| (0..).zip(&plan.steps).find(|(_, step)| is_wait(step)));
    let role = entry.roles.get(&signal.to).filter(|role| role.kind == RoleKind::Unmanaged);
    role.zip(wait).is_some_and(|(role, (index, _))| role.ended.contains(&index))
}

impl Invariant for Signals {
    fn name(&self) -> &'static str {
        "signals"
    }

    fn observe(&mut self, _: Duration, entry: &Observation, _: &Fleet) -> Result<(), InvariantViolation> {
        self.reference.observe(entry);
        match entry.event_kind() {
            Some(EventKind::Sent { mission, signal }) => {
                self.sent.entry(mission.clone()).or_default().insert(signal.clone());
            }
            Some(EventKind::Received { mission, signal }) => {
                let sent = self.sent.get(mission).is_some_and(|sent| sent.contains(signal));
                // A sender that was lost while sending has reported to the ledger before it sent to
                // any robot.
                let of_mission = self.reference.ledger.mission(mission);
                let in_ledger = of_mission.is_some_and(|entry| entry.signals_to(&signal.to).contains(signal));
                if !sent && !in_ledger {
                    return Err(format!(
                        "{} continues in {mission} after {signal:?}, which was never sent",
                        entry.node()
                    )
                    .into());
                }
                self.received.entry(mission.clone()).or_default().insert(signal.clone());
            }
            _ => {}
        }
        Ok(())
    }

    fn check_end(&mut self, _: &Fleet) -> Result<(), InvariantViolation> {
        for (mission, sent) in &self.sent {
            let Some(entry) = self.reference.ledger.mission(mission) else { continue };
            if entry.state != MissionState::Completed {
                continue;
            }
            let received = self.received.get(mission);
            let not_received = sent.iter().filter(|signal| !received.is_some_and(|received| received.contains(signal)));
            for signal in not_received {
                if !cut_short(entry, &signal.to) && concerns(entry, signal) && !has_ended_wait(entry, signal) {
                    return Err(format!("{mission} has completed, but {signal:?} was never received").into());
                }
            }
        }
        Ok(())
    }
}
