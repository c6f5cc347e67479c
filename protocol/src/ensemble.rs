//! Ensembles: who belongs together, as each node judges from what it has heard (thesis 3.4, after DEECo).
//!
//! An ensemble is a name, conditions on a member, conditions on its coordinator, and a bound on how old knowledge may
//! be to count. Conditions are CEL expressions over these variables:
//!
//! | variable | fields |
//! |---|---|
//! | `member`, `coordinator` | `name`, `may_vote`, `stationary`, `mains_powered`, `robot` (is it a robot's node), `skills` (list), `place`, `x_m`, `y_m`, `battery`, `discharge`, `speed` (0 if it does not drive), `free`, `estimator` |
//! | `ensemble` | `name`, `skills`: the skills that the ensemble's missions need |
//!
//! All conditions of a list must hold. Membership is a belief with an age: it says what the evaluating node
//! thinks, and how old its knowledge of the other is.

mod bounds;

use crate::ids::{EnsembleId, NodeId, TaskType};
use crate::knowledge::{Availability, Knowledge, KnowledgeBase};
use crate::units::NodeTime;
use bounds::LOOP_DEPTH_MAX;
use cel::{Context, Env, Program, Value};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// An ensemble as a fleet file declares it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EnsembleSpec {
    /// Its name.
    pub name: EnsembleId,
    /// The skills that its missions need, for the conditions to name.
    #[serde(default)]
    pub skills: BTreeSet<TaskType>,
    /// Conditions on a member, all of which must hold.
    pub membership: Vec<String>,
    /// Conditions on the coordinator. While one does not hold, nobody is a member. None: whoever coordinates will do.
    #[serde(default)]
    pub coordinator: Vec<String>,
    /// Knowledge older than this does not count, in milliseconds. Raised: members are believed in for longer after they
    /// fell silent.
    pub stale_after_ms: u64,
}

impl EnsembleSpec {
    /// The ensemble of the thesis (Listing 3.1): robots with at least one of the skills of interest.
    pub fn with_any_skill_of(name: EnsembleId, skills: BTreeSet<TaskType>) -> EnsembleSpec {
        EnsembleSpec {
            name,
            skills,
            membership: vec!["member.robot".to_owned(), "member.skills.exists(s, s in ensemble.skills)".to_owned()],
            coordinator: vec![],
            stale_after_ms: 10_000,
        }
    }
}

/// Why a condition cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("ensemble {ensemble}: condition `{condition}`: {problem}")]
pub struct ConditionError {
    /// The ensemble.
    pub ensemble: EnsembleId,
    /// The condition's text.
    pub condition: String,
    /// What is wrong with it.
    pub problem: String,
}

/// Longest condition in bytes.
const CONDITION_MAX: usize = 1024;

/// An ensemble ready to be evaluated.
pub struct Ensemble {
    spec: EnsembleSpec,
    membership: Vec<Condition>,
    coordinator: Vec<Condition>,
    /// CEL's own functions. They take longer to set up than any condition to evaluate, so this is done once.
    functions: Arc<Env>,
    /// What the conditions said last of each node, and from what: they are asked many times a second, and knowledge changes
    /// once a second at most.
    judged: Mutex<BTreeMap<NodeId, Judged>>,
}

/// What the conditions said, and of whom as known when.
struct Judged {
    member: Knowledge,
    coordinator: NodeId,
    coordinator_knows: Knowledge,
    verdict: Result<(), String>,
}

impl fmt::Debug for Ensemble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Ensemble").field(&self.spec).finish()
    }
}

#[derive(Debug)]
struct Condition {
    text: String,
    program: Program,
}

/// What a node believes of another's membership.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Membership {
    /// Yes or no.
    pub member: bool,
    /// Why, in words.
    pub reason: String,
    /// How old the knowledge is that this was judged from, in milliseconds.
    pub age_ms: u64,
}

/// The fields of a node that conditions may name.
#[derive(Serialize)]
struct Facts<'a> {
    name: &'a str,
    may_vote: bool,
    stationary: bool,
    mains_powered: bool,
    robot: bool,
    skills: Vec<&'a str>,
    place: &'a str,
    x_m: f64,
    y_m: f64,
    battery: f64,
    discharge: f64,
    speed: f64,
    free: bool,
    estimator: &'a str,
}

impl<'a> Facts<'a> {
    fn of(name: &'a NodeId, knowledge: &'a Knowledge) -> Facts<'a> {
        let worker = knowledge.robot.as_ref();
        Facts {
            name: name.as_str(),
            may_vote: knowledge.may_vote,
            stationary: knowledge.stationary,
            mains_powered: knowledge.mains_powered,
            robot: worker.is_some(),
            skills: worker.map(|w| w.skills.iter().map(TaskType::as_str).collect()).unwrap_or_default(),
            place: worker.map_or("", |w| w.place.as_str()),
            x_m: worker.map_or(0.0, |w| w.pose.x),
            y_m: worker.map_or(0.0, |w| w.pose.y),
            battery: worker.map_or(0.0, |w| w.battery.get()),
            discharge: worker.map_or(0.0, |w| w.discharge.get()),
            speed: worker.and_then(|w| w.speed).map_or(0.0, |speed| speed.get()),
            free: knowledge.is_free(),
            estimator: worker.map_or("", |w| &w.estimator),
        }
    }
}

impl Ensemble {
    /// Compiles the conditions, and tries them on an example so that a misspelt field is found now and not at run time.
    ///
    /// # Errors
    /// [`ConditionError`] for the first condition that cannot be read, names what is not there, or gives no yes or no.
    pub fn compile(spec: EnsembleSpec) -> Result<Ensemble, ConditionError> {
        let membership = compile_all(&spec, &spec.membership)?;
        let coordinator = compile_all(&spec, &spec.coordinator)?;
        let ensemble =
            Ensemble { spec, membership, coordinator, functions: Arc::new(Env::stdlib()), judged: Mutex::default() };
        let example = NodeId::new("example").expect("a slug");
        let knowledge = example_knowledge();
        let facts = ensemble.facts((&example, &knowledge), (&example, &knowledge)).expect("an example can be told");
        for condition in ensemble.membership.iter().chain(&ensemble.coordinator) {
            condition.holds(&facts).map_err(|problem| ConditionError {
                ensemble: ensemble.spec.name.clone(),
                condition: condition.text.clone(),
                problem,
            })?;
        }
        Ok(ensemble)
    }

    /// What was declared.
    pub fn spec(&self) -> &EnsembleSpec {
        &self.spec
    }

    /// Whether `node` is a member of the ensemble that `coordinator` coordinates, by what `base` has heard.
    pub fn membership_of(
        &self,
        node: &NodeId,
        coordinator: &NodeId,
        base: &KnowledgeBase,
        now: NodeTime,
    ) -> Membership {
        let Some(member) = base.get(node) else {
            return Membership { member: false, reason: format!("nothing heard of {node}"), age_ms: 0 };
        };
        let age_ms = millis(member.age(now));
        let verdict = |member, reason| Membership { member, reason, age_ms };
        let limit = Duration::from_millis(self.spec.stale_after_ms);
        if member.age(now) > limit {
            return verdict(false, format!("last heard of {node} {age_ms} ms ago, more than {} ms", limit.as_millis()));
        }
        let Some(head) = base.get(coordinator) else {
            return verdict(false, format!("nothing heard of the coordinator {coordinator}"));
        };
        match self.ask(node, &member.record.knowledge, coordinator, &head.record.knowledge) {
            Ok(()) => verdict(true, "all conditions hold".to_owned()),
            Err(reason) => verdict(false, reason),
        }
    }

    /// Whether all conditions hold, and if not, which does not and of whom.
    fn ask(
        &self,
        node: &NodeId,
        knows: &Knowledge,
        coordinator: &NodeId,
        coordinator_knows: &Knowledge,
    ) -> Result<(), String> {
        // A verdict is replaced as a whole, so a poisoned lock still guards sound ones.
        let mut judged = self.judged.lock().unwrap_or_else(PoisonError::into_inner);
        let as_before = |known: &&Judged| {
            known.coordinator == *coordinator && known.member == *knows && known.coordinator_knows == *coordinator_knows
        };
        if let Some(known) = judged.get(node).filter(as_before) {
            return known.verdict.clone();
        }
        let verdict = self.evaluate(node, knows, coordinator, coordinator_knows);
        let (member, coordinator_knows) = (knows.clone(), coordinator_knows.clone());
        let known = Judged { member, coordinator: coordinator.clone(), coordinator_knows, verdict: verdict.clone() };
        judged.insert(node.clone(), known);
        verdict
    }

    fn evaluate(
        &self,
        node: &NodeId,
        knows: &Knowledge,
        coordinator: &NodeId,
        coordinator_knows: &Knowledge,
    ) -> Result<(), String> {
        let facts = self
            .facts((node, knows), (coordinator, coordinator_knows))
            .map_err(|problem| format!("{node} cannot be judged: {problem}"))?;
        for (conditions, whose) in [(&self.coordinator, coordinator), (&self.membership, node)] {
            for condition in conditions {
                match condition.holds(&facts) {
                    Ok(true) => {}
                    Ok(false) => return Err(format!("`{}` is false for {whose}", condition.text)),
                    Err(problem) => return Err(format!("`{}` for {whose}: {problem}", condition.text)),
                }
            }
        }
        Ok(())
    }

    /// Everyone this node believes to be a member.
    pub fn members(&self, coordinator: &NodeId, base: &KnowledgeBase, now: NodeTime) -> BTreeSet<NodeId> {
        base.iter()
            .map(|(node, _)| node)
            .filter(|n| self.membership_of(n, coordinator, base, now).member)
            .cloned()
            .collect()
    }

    /// The variables that conditions may name.
    fn facts(
        &self,
        (member, knows): (&NodeId, &Knowledge),
        (coordinator, coordinator_knows): (&NodeId, &Knowledge),
    ) -> Result<Context<'static, 'static>, String> {
        #[derive(Serialize)]
        struct Declared<'a> {
            name: &'a str,
            skills: Vec<&'a str>,
        }
        let declared =
            Declared { name: self.spec.name.as_str(), skills: self.spec.skills.iter().map(TaskType::as_str).collect() };
        let mut context = Context::with_env(Arc::clone(&self.functions));
        let mut set = |name: &str, value: Result<Value, _>| {
            context.add_variable_from_value(name, value.map_err(|e: cel::SerializationError| e.to_string())?);
            Ok::<(), String>(())
        };
        set("member", cel::to_value(Facts::of(member, knows)))?;
        set("coordinator", cel::to_value(Facts::of(coordinator, coordinator_knows)))?;
        set("ensemble", cel::to_value(declared))?;
        Ok(context)
    }
}

impl Condition {
    fn holds(&self, facts: &Context<'static, 'static>) -> Result<bool, String> {
        match self.program.execute(facts) {
            Ok(Value::Bool(holds)) => Ok(holds),
            Ok(other) => Err(format!("gives {other:?}, where true or false is needed")),
            Err(problem) => Err(problem.to_string()),
        }
    }
}

fn millis(age: Duration) -> u64 {
    u64::try_from(age.as_millis()).unwrap_or(u64::MAX)
}

fn compile_all(spec: &EnsembleSpec, texts: &[String]) -> Result<Vec<Condition>, ConditionError> {
    let refuse = |condition: &String, problem| ConditionError {
        ensemble: spec.name.clone(),
        condition: condition.clone(),
        problem,
    };
    let compile = |text: &String| {
        if text.len() > CONDITION_MAX {
            return Err(refuse(text, format!("{} bytes long, where {CONDITION_MAX} are allowed", text.len())));
        }
        let program = Program::compile(text).map_err(|e| refuse(text, e.to_string()))?;
        let loops = bounds::loop_depth(program.expression());
        if loops > LOOP_DEPTH_MAX {
            return Err(refuse(
                text,
                format!("its loops stand {loops} deep in one another, where {LOOP_DEPTH_MAX} are allowed"),
            ));
        }
        Ok(Condition { text: text.clone(), program })
    };
    texts.iter().map(compile).collect()
}

fn example_knowledge() -> Knowledge {
    use crate::ids::PlaceId;
    use crate::pose::Pose;
    use crate::units::{BatteryShare, SharePerSecond};
    Knowledge {
        may_vote: true,
        stationary: false,
        mains_powered: false,
        replica: None,
        cluster: None,
        leaving: false,
        supported_versions: crate::versions::VersionRange::OWN,
        robot: Some(crate::knowledge::RobotKnowledge {
            skills: BTreeSet::from([TaskType::new("navigation").expect("a slug")]),
            place: PlaceId::new("dock").expect("a label"),
            pose: Pose::default(),
            battery: BatteryShare::FULL,
            discharge: SharePerSecond::new(0.0).expect("a rate"),
            useful_charge: BatteryShare::new(0.0).expect("a share"),
            speed: None,
            availability: Availability::Free,
            estimator: String::new(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::knowledge::{Record, RecordStamp};

    fn at(ms: u64) -> NodeTime {
        NodeTime::at(Duration::from_millis(ms))
    }

    fn node(name: &str) -> NodeId {
        NodeId::new(name).unwrap()
    }

    fn heard(name: &str, skills: &[&str]) -> Record {
        let mut knowledge = example_knowledge();
        knowledge.robot.as_mut().unwrap().skills = skills.iter().map(|s| TaskType::new(*s).unwrap()).collect();
        Record { owner: node(name), stamp: RecordStamp::default(), knowledge, proof: None }
    }

    fn drawers() -> EnsembleSpec {
        let skills = BTreeSet::from([TaskType::new("operate_drawer").unwrap()]);
        EnsembleSpec::with_any_skill_of(EnsembleId::new("samples").unwrap(), skills)
    }

    #[test]
    fn a_robot_with_a_skill_of_interest_is_a_member_until_its_knowledge_is_stale() {
        let ensemble = Ensemble::compile(drawers()).unwrap();
        let mut base = KnowledgeBase::default();
        base.merge(heard("ada", &["navigation", "operate_drawer"]), at(0));
        base.merge(heard("bob", &["navigation"]), at(0));
        let judge = |name: &str, now| ensemble.membership_of(&node(name), &node("ada"), &base, now);

        let yes = Membership { member: true, reason: "all conditions hold".to_owned(), age_ms: 10_000 };
        assert_eq!(judge("ada", at(10_000)), yes);
        assert_eq!(judge("ada", at(10_001)).reason, "last heard of ada 10001 ms ago, more than 10000 ms");
        let no = judge("bob", at(0));
        assert_eq!(
            (no.member, no.reason.as_str()),
            (false, "`member.skills.exists(s, s in ensemble.skills)` is false for bob")
        );
        assert_eq!(judge("cyd", at(0)).reason, "nothing heard of cyd");
        assert_eq!(ensemble.members(&node("ada"), &base, at(0)), BTreeSet::from([node("ada")]));
    }

    #[test]
    fn a_condition_that_cannot_work_is_refused_when_it_is_read() {
        for (condition, expected) in [
            ("member.skills.", "ensemble samples: condition `member.skills.`:"),
            ("member.wheels > 3", "ensemble samples: condition `member.wheels > 3`:"),
            ("member.battery", "true or false is needed"),
            ("wheels", "ensemble samples"),
        ] {
            let spec = EnsembleSpec { membership: vec![condition.to_owned()], ..drawers() };
            let error = Ensemble::compile(spec).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn the_coordinator_has_conditions_of_its_own() {
        let spec = EnsembleSpec { coordinator: vec!["coordinator.mains_powered".to_owned()], ..drawers() };
        let ensemble = Ensemble::compile(spec).unwrap();
        let mut base = KnowledgeBase::default();
        base.merge(heard("ada", &["operate_drawer"]), at(0));
        let verdict = ensemble.membership_of(&node("ada"), &node("ada"), &base, at(0));
        assert_eq!(verdict.reason, "`coordinator.mains_powered` is false for ada");
    }
}
