//! Injection of a bug into the nodes of a run.

use super::Mutant;
use super::bus::FaultyBus;
use super::known_ledger::KnownLedger;
use super::log_store::FaultyLogStore;
use consort_bus::SharedBus;
use consort_fleet::autopilot::{AutopilotAction, AutopilotInput, decide};
use consort_fleet::node::NodeSettings;
use consort_fleet::observe::SharedObserver;
use consort_protocol::lease::LeaseTerms;
use std::sync::Arc;

/// Injection of a bug into all nodes of a run. In a closed fleet the bug is above the signatures: a
/// node signs the messages that its bug has changed.
#[derive(Clone)]
pub(in crate::chaos) struct MutantInjection {
    mutant: Mutant,
    ledger: KnownLedger,
}

impl MutantInjection {
    /// Creates the injection for a new run.
    pub(in crate::chaos) fn new(mutant: Mutant) -> MutantInjection {
        MutantInjection { mutant, ledger: KnownLedger::default() }
    }

    /// Changes the settings of a node before it starts.
    pub(in crate::chaos) fn equip(&self, settings: &mut NodeSettings) {
        let known: SharedObserver = Arc::new(self.ledger.clone());
        let observers: Vec<SharedObserver> = settings.observer.take().into_iter().chain([known]).collect();
        settings.observer = Some(Arc::new(observers));
        match self.mutant {
            Mutant::SkipFsync | Mutant::DoubleVote => {
                let inner = Arc::clone(&settings.store.log_store);
                settings.store.log_store = Arc::new(FaultyLogStore { mutant: self.mutant, inner });
            }
            // The lease of a robot must not change with the wait of the coordinator.
            Mutant::EarlyRelease if settings.robot.is_none() => {
                let LeaseTerms { lease, grace } = settings.fleet.lease_terms;
                settings.fleet.lease_terms = LeaseTerms { lease: lease / 3, grace: grace / 3 };
            }
            Mutant::TwoRemoved => settings.fleet.autopilot_rule = remove_two_voters,
            _ => {}
        }
    }

    /// Wraps the bus of a node.
    pub(in crate::chaos) fn wrap_bus(&self, settings: &NodeSettings, bus: SharedBus) -> SharedBus {
        Arc::new(FaultyBus::new(self.mutant, settings, self.ledger.clone(), bus))
    }
}

/// Decides as [`decide`] does, but removes a second voter together with each removed voter.
fn remove_two_voters(input: &AutopilotInput) -> Option<AutopilotAction> {
    match decide(input)? {
        AutopilotAction::SetVoters { mut voters, reason } if !input.voters.keys().all(|id| voters.contains(id)) => {
            let second = voters.iter().copied().find(|id| *id != input.me && input.voters.contains_key(id));
            second.map(|id| voters.remove(&id));
            Some(AutopilotAction::SetVoters { voters, reason })
        }
        action => Some(action),
    }
}
