//! The ensembles of a fleet.

use super::private_attributes::{private_attribute_problems, private_attributes};
use super::{ConditionError, Eligibility, Ensemble, EnsembleSpec, Membership};
use crate::ids::{EnsembleId, NodeId};
use crate::knowledge::{KnowledgeBase, RobotKnowledge};
use crate::units::NodeTime;
use std::collections::{BTreeMap, BTreeSet};

/// Ensembles of a fleet, in the order of the fleet file.
#[derive(Debug)]
pub struct Ensembles(Vec<Ensemble>);

impl Ensembles {
    /// Compiles the conditions of all ensembles.
    ///
    /// # Errors
    /// As [`Ensemble::compile`], and if a condition uses an attribute that an ensemble exchanges.
    pub fn compile(specs: Vec<EnsembleSpec>) -> Result<Ensembles, ConditionError> {
        let ensembles = specs.into_iter().map(Ensemble::compile).collect::<Result<Vec<_>, _>>()?;
        match private_attribute_problems(&ensembles).into_iter().next() {
            Some(problem) => Err(problem),
            None => Ok(Ensembles(ensembles)),
        }
    }

    /// Returns the ensembles.
    pub fn iter(&self) -> impl Iterator<Item = &Ensemble> {
        self.0.iter()
    }

    /// Returns the names of the ensembles.
    pub fn names(&self) -> impl Iterator<Item = &EnsembleId> {
        self.iter().map(|ensemble| &ensemble.spec().name)
    }

    /// Returns the ensemble with this name.
    pub fn get(&self, name: &EnsembleId) -> Option<&Ensemble> {
        self.iter().find(|ensemble| ensemble.spec().name == *name)
    }

    /// Returns what every node receives of a robot: all but its private attributes.
    pub fn published(&self, mut robot: RobotKnowledge) -> RobotKnowledge {
        let is_private = |name: &str| self.iter().flat_map(private_attributes).any(|private| private == name);
        robot.attributes.retain(|name| !is_private(name));
        robot
    }

    /// Returns a private attribute that the condition may use, with the ensemble that exchanges it: the records of
    /// robots do not contain it.
    pub fn private_attribute_of(&self, condition: &Eligibility) -> Option<(&EnsembleId, &str)> {
        let mut attributes = self
            .iter()
            .flat_map(|ensemble| private_attributes(ensemble).map(move |name| (&ensemble.spec().name, name)));
        attributes.find(|(_, name)| condition.may_use_attribute(name))
    }

    /// Returns the nodes that this node evaluates to be members of each ensemble.
    pub fn members(
        &self,
        coordinator: &NodeId,
        base: &KnowledgeBase,
        now: NodeTime,
    ) -> BTreeMap<EnsembleId, BTreeSet<NodeId>> {
        let of = |ensemble: &Ensemble| (ensemble.spec().name.clone(), ensemble.members(coordinator, base, now));
        self.iter().map(of).collect()
    }

    /// Evaluates whether a node is a member of any of the called ensembles. None called: of any ensemble.
    /// The reason of a node that is none contains the names of the ensembles.
    pub fn membership_of(
        &self,
        called: &[EnsembleId],
        node: &NodeId,
        coordinator: &NodeId,
        base: &KnowledgeBase,
        now: NodeTime,
    ) -> Membership {
        let called: Vec<&EnsembleId> = if called.is_empty() { self.names().collect() } else { called.iter().collect() };
        let mut reasons = vec![];
        let mut age_ms = 0;
        for name in called {
            let Some(ensemble) = self.get(name) else {
                reasons.push(format!("{name}: this node does not know it"));
                continue;
            };
            let membership = ensemble.membership_of(node, coordinator, base, now);
            if membership.member {
                return membership;
            }
            age_ms = membership.age_ms;
            reasons.push(format!("{name}: {}", membership.reason));
        }
        Membership { member: false, reason: reasons.join("; "), age_ms }
    }
}
