//! Ensembles: groups of nodes, evaluated by each node from the records that it has received (thesis
//! 3.4, after DEECo).
//!
//! An ensemble has a name, conditions on a member, conditions on its coordinator, and a maximum age
//! of the knowledge used. A role of a mission may have a condition on its robot, too, its eligibility.
//! Conditions are CEL expressions over these variables:
//!
//! | variable | fields |
//! |---|---|
//! | `robot` (of a role), `member`, `coordinator` | `name`, `attributes` (as `member.attributes.section`), `skills` (list), `place`, `x_m`, `y_m`, `battery`, `discharge`, `speed` (0 if it does not drive) |
//! | `member`, `coordinator` | also `may_vote`, `stationary`, `mains_powered`, `robot` (true for a robot's node), `free`, `estimator` |
//! | `ensemble` | `name`, `skills`: the skills that the ensemble's missions need |
//!
//! An ensemble may also list values that its members [exchange](KnowledgeExchange). Other nodes do not
//! receive them, so conditions of ensembles use no exchanged attribute.
//!
//! All conditions of a list must hold. A condition on an attribute that a robot lacks does not hold. The
//! evaluated membership is local and has an age: it depends on the records that the evaluating node has
//! received.

mod condition;
mod eligibility;
mod ensembles;
mod exchange;
mod facts;
mod private_attributes;
mod spec;

pub use condition::ConditionError;
pub(crate) use condition::{Condition, Variables, context_of};
pub use eligibility::{Eligibility, Ineligibility};
pub use ensembles::Ensembles;
pub use exchange::{
    ExchangeAction, ExchangedValue, ExchangedValueError, KnowledgeExchange, MemberValues, VALUE_AGE_MAX,
};
pub use private_attributes::private_attribute_problems;
pub use spec::EnsembleSpec;

#[cfg(test)]
pub(crate) use facts::example_robot;

use self::condition::EvaluationError;
use self::facts::{example_knowledge, node_facts};
use crate::ids::{NodeId, TaskType};
use crate::knowledge::{Knowledge, KnowledgeBase};
use crate::units::NodeTime;
use cel::SerializationError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Ensemble with compiled conditions.
pub struct Ensemble {
    spec: EnsembleSpec,
    membership: Vec<Condition>,
    coordinator: Vec<Condition>,
    /// Latest result for each node and the knowledge it was computed from. Conditions are evaluated
    /// many times a second, and knowledge changes once a second at most.
    cache: Mutex<BTreeMap<NodeId, CachedVerdict>>,
}

/// Reason for which a node is not a member.
#[derive(Debug, Clone, thiserror::Error)]
enum NotMember {
    #[error("membership of {node} cannot be evaluated: {problem}")]
    NotEvaluated { node: NodeId, problem: String },
    #[error("`{condition}` is false for {node}")]
    ConditionFalse { condition: String, node: NodeId },
    #[error("`{condition}` for {node}: {problem}")]
    ConditionFailed { condition: String, node: NodeId, problem: EvaluationError },
}

/// Cached result of the conditions, with the knowledge it was computed from.
struct CachedVerdict {
    member: Knowledge,
    coordinator: NodeId,
    coordinator_knowledge: Knowledge,
    verdict: Result<(), NotMember>,
}

impl fmt::Debug for Ensemble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Ensemble").field(&self.spec).finish()
    }
}

/// Membership of a node, as evaluated by another node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Membership {
    /// True if the node is a member.
    pub member: bool,
    /// Reason, as text.
    pub reason: String,
    /// Age of the knowledge used, in milliseconds.
    pub age_ms: u64,
}

impl Ensemble {
    /// Compiles the conditions and evaluates them on an example, so that a misspelt field is found
    /// now and not at run time.
    ///
    /// # Errors
    /// [`ConditionError`] for the first condition that cannot be parsed, uses an unknown name, or
    /// does not evaluate to a boolean.
    pub fn compile(spec: EnsembleSpec) -> Result<Ensemble, ConditionError> {
        let example = NodeId::new("example").expect("a slug");
        let knowledge = example_knowledge();
        let variables =
            variables(&spec, (&example, &knowledge), (&example, &knowledge)).expect("the example can be converted");
        let compile = |text: &String| {
            Condition::compile(text, &variables).map_err(|problem| ConditionError {
                ensemble: spec.name.clone(),
                condition: text.clone(),
                problem,
            })
        };
        let membership = spec.membership.iter().map(compile).collect::<Result<_, _>>()?;
        let coordinator = spec.coordinator.iter().map(compile).collect::<Result<_, _>>()?;
        Ok(Ensemble { spec, membership, coordinator, cache: Mutex::default() })
    }

    /// Returns the declaration.
    pub fn spec(&self) -> &EnsembleSpec {
        &self.spec
    }

    /// Evaluates whether `node` is a member of the ensemble that `coordinator` coordinates, from
    /// the records in `base`.
    pub fn membership_of(
        &self,
        node: &NodeId,
        coordinator: &NodeId,
        base: &KnowledgeBase,
        now: NodeTime,
    ) -> Membership {
        let Some(member) = base.get(node) else {
            return Membership { member: false, reason: format!("no record of {node} received"), age_ms: 0 };
        };
        let age_ms = millis(member.age(now));
        let verdict = |member, reason| Membership { member, reason, age_ms };
        let limit = Duration::from_millis(self.spec.stale_after_ms);
        if member.age(now) > limit {
            return verdict(
                false,
                format!("last contact with {node} was {age_ms} ms ago, more than {} ms", limit.as_millis()),
            );
        }
        let Some(head) = base.get(coordinator) else {
            return verdict(false, format!("no record of the coordinator {coordinator} received"));
        };
        match self.cached_verdict(node, member.knowledge(), coordinator, head.knowledge()) {
            Ok(()) => verdict(true, "all conditions hold".to_owned()),
            Err(reason) => verdict(false, reason.to_string()),
        }
    }

    /// Checks all conditions, with cached results. The error names the condition that is false and
    /// the node concerned.
    fn cached_verdict(
        &self,
        node: &NodeId,
        knowledge: &Knowledge,
        coordinator: &NodeId,
        coordinator_knowledge: &Knowledge,
    ) -> Result<(), NotMember> {
        // A verdict is replaced as a whole, so the cache is consistent even if the lock is
        // poisoned.
        let mut cache = self.cache.lock().unwrap_or_else(PoisonError::into_inner);
        let as_before = |known: &&CachedVerdict| {
            known.coordinator == *coordinator
                && known.member == *knowledge
                && known.coordinator_knowledge == *coordinator_knowledge
        };
        if let Some(known) = cache.get(node).filter(as_before) {
            return known.verdict.clone();
        }
        let verdict = self.evaluate(node, knowledge, coordinator, coordinator_knowledge);
        let (member, coordinator_knowledge) = (knowledge.clone(), coordinator_knowledge.clone());
        let known =
            CachedVerdict { member, coordinator: coordinator.clone(), coordinator_knowledge, verdict: verdict.clone() };
        cache.insert(node.clone(), known);
        verdict
    }

    fn evaluate(
        &self,
        node: &NodeId,
        knowledge: &Knowledge,
        coordinator: &NodeId,
        coordinator_knowledge: &Knowledge,
    ) -> Result<(), NotMember> {
        let variables = variables(&self.spec, (node, knowledge), (coordinator, coordinator_knowledge))
            .map_err(|problem| NotMember::NotEvaluated { node: node.clone(), problem: problem.to_string() })?;
        let variables = context_of(variables);
        for (conditions, subject) in [(&self.coordinator, coordinator), (&self.membership, node)] {
            for condition in conditions {
                let (text, node) = (|| condition.text.clone(), || subject.clone());
                match condition.holds(&variables) {
                    Ok(true) => {}
                    Ok(false) => return Err(NotMember::ConditionFalse { condition: text(), node: node() }),
                    Err(problem) => {
                        return Err(NotMember::ConditionFailed { condition: text(), node: node(), problem });
                    }
                }
            }
        }
        Ok(())
    }

    /// Returns all nodes that this node evaluates to be members.
    pub fn members(&self, coordinator: &NodeId, base: &KnowledgeBase, now: NodeTime) -> BTreeSet<NodeId> {
        base.iter()
            .map(|(node, _)| node)
            .filter(|n| self.membership_of(n, coordinator, base, now).member)
            .cloned()
            .collect()
    }
}

fn variables(
    spec: &EnsembleSpec,
    (member, knowledge): (&NodeId, &Knowledge),
    (coordinator, coordinator_knowledge): (&NodeId, &Knowledge),
) -> Result<Variables, SerializationError> {
    #[derive(Serialize)]
    struct Declared<'a> {
        name: &'a str,
        skills: Vec<&'a str>,
    }
    let declared = Declared { name: spec.name.as_str(), skills: spec.skills.iter().map(TaskType::as_str).collect() };
    Ok(vec![
        ("member", node_facts(member, knowledge)?),
        ("coordinator", node_facts(coordinator, coordinator_knowledge)?),
        ("ensemble", cel::to_value(declared)?),
    ])
}

fn millis(age: Duration) -> u64 {
    u64::try_from(age.as_millis()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::EnsembleId;
    use crate::knowledge::{Record, RecordStamp};

    fn at(ms: u64) -> NodeTime {
        NodeTime::at(Duration::from_millis(ms))
    }

    fn node(name: &str) -> NodeId {
        NodeId::new(name).unwrap()
    }

    fn record(name: &str, skills: &[&str]) -> Record {
        let mut knowledge = example_knowledge();
        knowledge.robot.as_mut().unwrap().skills = skills.iter().map(|s| TaskType::new(*s).unwrap()).collect();
        Record { owner: node(name), stamp: RecordStamp::default(), knowledge, proof: None }
    }

    fn boxes() -> EnsembleSpec {
        let skills = BTreeSet::from([TaskType::new("operate_box").unwrap()]);
        EnsembleSpec::with_any_skill_of(EnsembleId::new("parcels").unwrap(), skills)
    }

    #[test]
    fn a_robot_with_a_needed_skill_is_a_member_until_its_record_is_stale() {
        let ensemble = Ensemble::compile(boxes()).unwrap();
        let mut base = KnowledgeBase::default();
        base.merge(record("ada", &["navigation", "operate_box"]), at(0));
        base.merge(record("bob", &["navigation"]), at(0));
        let membership = |name: &str, now| ensemble.membership_of(&node(name), &node("ada"), &base, now);

        let yes = Membership { member: true, reason: "all conditions hold".to_owned(), age_ms: 10_000 };
        assert_eq!(membership("ada", at(10_000)), yes);
        assert_eq!(membership("ada", at(10_001)).reason, "last contact with ada was 10001 ms ago, more than 10000 ms");
        let no = membership("bob", at(0));
        assert_eq!(
            (no.member, no.reason.as_str()),
            (false, "`member.skills.exists(s, s in ensemble.skills)` is false for bob")
        );
        assert_eq!(membership("cyd", at(0)).reason, "no record of cyd received");
        assert_eq!(ensemble.members(&node("ada"), &base, at(0)), BTreeSet::from([node("ada")]));
    }

    #[test]
    fn an_invalid_condition_is_rejected_when_it_is_compiled() {
        for (condition, expected) in [
            ("member.skills.", "ensemble parcels: condition `member.skills.`:"),
            (
                "member.wheels > 3",
                "ensemble parcels: condition `member.wheels > 3`: `member` has no field `wheels`; allowed: attributes",
            ),
            ("member.battery", "it must be true or false"),
            ("wheels", "ensemble parcels"),
        ] {
            let spec = EnsembleSpec { membership: vec![condition.to_owned()], ..boxes() };
            let error = Ensemble::compile(spec).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn conditions_on_the_coordinator_are_checked() {
        let spec = EnsembleSpec { coordinator: vec!["coordinator.mains_powered".to_owned()], ..boxes() };
        let ensemble = Ensemble::compile(spec).unwrap();
        let mut base = KnowledgeBase::default();
        base.merge(record("ada", &["operate_box"]), at(0));
        let verdict = ensemble.membership_of(&node("ada"), &node("ada"), &base, at(0));
        assert_eq!(verdict.reason, "`coordinator.mains_powered` is false for ada");
    }
}
