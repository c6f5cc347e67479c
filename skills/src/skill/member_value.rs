//! The leaf of an exchanged value: a condition on the newest value that a member of an ensemble has sent
//! to the others. Its cause does not contain the value: events and the ledger show causes to every node.

use super::context::TaskContext;
use super::value_condition::{EQUALS, MAXIMUM, MINIMUM, VALUE, value_holds};
use crate::bt::{
    Cause, LeafContext, NodeKind, NodeSpec, PortSpec, PortType, Registry, RegistryError, TreeError, TreeErrorKind,
    TreeSpec, Value,
};
use consort_protocol::ensemble::{Ensembles, ExchangedValue};
use consort_protocol::ids::{EnsembleId, RobotId};
use consort_text::AllowedNames;

const ID: &str = "MemberValue";
const ENSEMBLE: &str = "ensemble";
const ROBOT: &str = "robot";
const EXCHANGED: &str = "exchanged";

/// Registers the condition. It fails while the value is unknown. A boolean without `equals` must be true.
pub(super) fn register_leaves(registry: &mut Registry<TaskContext>) -> Result<(), RegistryError> {
    let ports = [
        PortSpec::input(ENSEMBLE, PortType::Text),
        PortSpec::input(ROBOT, PortType::Robot),
        PortSpec::input(EXCHANGED, PortType::Text).exchanged_value(),
        PortSpec::input(MINIMUM, PortType::Number).optional(),
        PortSpec::input(MAXIMUM, PortType::Number).optional(),
        PortSpec::input(EQUALS, PortType::Any).optional(),
        PortSpec::output(VALUE, PortType::Any).optional(),
    ];
    registry.register_condition(ID, ports, holds)
}

fn holds(leaf: &mut LeafContext<'_, '_>) -> Result<bool, Cause> {
    let invalid = |port: &str, problem: String| Cause::new(format!("port `{port}`: {problem}"));
    let ensemble = EnsembleId::new(leaf.read::<String>(ENSEMBLE)?);
    let ensemble = ensemble.map_err(|problem| invalid(ENSEMBLE, problem.to_string()))?;
    let exchanged = ExchangedValue::try_from(leaf.read::<String>(EXCHANGED)?);
    let exchanged = exchanged.map_err(|problem| invalid(EXCHANGED, problem.to_string()))?;
    let robot: RobotId = leaf.read(ROBOT)?;
    let subject = format!("`{exchanged}` of {robot} in {ensemble}");
    let value = leaf.actions().member_value(&ensemble, &robot, &exchanged);
    let value =
        value.ok_or_else(|| Cause::new(format!("{subject} is unknown: this robot has not received it lately")))?;
    let value = match Value::from(value) {
        // The declaration of the value is not known here, and both forms of a number are equal in trees.
        Value::Integer(number) => Value::Number(number as f64),
        value => value,
    };
    for limit in [MINIMUM, MAXIMUM] {
        if leaf.read_optional::<f64>(limit)?.is_some() && !matches!(value, Value::Number(_)) {
            return Err(Cause::new(format!("{subject} is no number; `{limit}` is for numbers")));
        }
    }
    value_holds(&format!("{subject} is"), &value, leaf)
}

/// Returns the error of each node that reads a value which its ensemble does not exchange. Ports that are
/// bound to keys are not checked.
pub fn member_value_errors(tree: &TreeSpec, ensembles: &Ensembles) -> Vec<TreeError> {
    let mut errors = vec![];
    for (name, root) in &tree.trees {
        let mut open = vec![root];
        while let Some(node) = open.pop() {
            open.extend(&node.children);
            if node.id != ID || node.kind == Some(NodeKind::SubTree) {
                continue;
            }
            let kind = fixed(node, ENSEMBLE).and_then(|ensemble| error_of(ensemble, fixed(node, EXCHANGED), ensembles));
            errors.extend(kind.map(|kind| TreeError {
                source: tree.source.clone(),
                line: node.line,
                node: Some(format!("{name}/{ID}")),
                kind: Box::new(kind),
            }));
        }
    }
    errors.sort_by_key(|error| error.line);
    errors
}

/// Returns the text of a port that is not bound to a key.
fn fixed<'a>(node: &'a NodeSpec, port: &str) -> Option<&'a str> {
    node.ports.get(port).map(String::as_str).filter(|text| !text.starts_with('{'))
}

fn error_of(ensemble: &str, exchanged: Option<&str>, ensembles: &Ensembles) -> Option<TreeErrorKind> {
    let Some(declared) = ensembles.iter().find(|declared| declared.spec().name.as_str() == ensemble) else {
        let allowed = AllowedNames::suggest_for(ensemble, ensembles.names()).to_string();
        return Some(TreeErrorKind::UnknownEnsemble { ensemble: ensemble.to_owned(), allowed });
    };
    let listed = &declared.spec().exchange;
    let exchanged = exchanged.filter(|text| !listed.iter().any(|listed| listed.to_string() == *text))?;
    let allowed = AllowedNames::suggest_for(exchanged, listed).to_string();
    Some(TreeErrorKind::NotExchanged { ensemble: ensemble.to_owned(), exchanged: exchanged.to_owned(), allowed })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::actions::{Goal, GoalId, GoalStatus, RobotActions, Telemetry};
    use crate::bt::xml::read_xml;
    use crate::environment::Environment;
    use crate::library::{SkillLibrary, SkillStatus};
    use crate::skill::SkillContext;
    use consort_protocol::ensemble::EnsembleSpec;
    use consort_protocol::ids::TaskType;
    use consort_protocol::mission::TaskSpec;
    use consort_protocol::scalar::Scalar;
    use std::collections::BTreeSet;

    /// A robot that has received values of `bob` in the ensemble `icu`.
    struct Member;

    impl RobotActions for Member {
        fn send_goal(&mut self, _: Goal) -> GoalId {
            unreachable!("the trees have no actions")
        }
        fn status(&self, _: GoalId) -> Option<GoalStatus> {
            None
        }
        fn cancel(&mut self, _: GoalId) {}
        fn telemetry(&self) -> Option<&Telemetry> {
            None
        }
        fn member_value(&self, ensemble: &EnsembleId, robot: &RobotId, value: &ExchangedValue) -> Option<Scalar> {
            match (ensemble.as_str(), robot.as_str(), value.to_string().as_str()) {
                ("icu", "bob", "readings.bag_g") => Some(Scalar::Integer(12)),
                ("icu", "bob", "readings.lid") => Some(Scalar::Bool(false)),
                ("icu", "bob", "attributes.owner") => Some(Scalar::Text("ward 3".to_owned())),
                _ => None,
            }
        }
    }

    fn xml(nodes: &str) -> String {
        format!(
            "<root BTCPP_format=\"4\"><BehaviorTree ID=\"look\"><Sequence>\n{nodes}\n</Sequence></BehaviorTree></root>"
        )
    }

    /// Executes these nodes in a sequence. Returns the cause of a failure.
    fn run(nodes: &str) -> Option<String> {
        let task_type = TaskType::new("look").unwrap();
        let mut library = SkillLibrary::with_leaves(Environment::new());
        library.register_xml(task_type.clone(), "look.xml", &xml(nodes)).unwrap();
        let task = TaskSpec::of(task_type, vec!["r1".parse().unwrap()]);
        match library.load(&task, &SkillContext::default()).unwrap().tick(&mut Member) {
            SkillStatus::Succeeded(_) => None,
            SkillStatus::Failed { cause, .. } => Some(cause),
            SkillStatus::Running => panic!("a condition ends at once"),
        }
    }

    #[test]
    fn an_exchanged_value_is_a_condition_of_trees() {
        let bag = "MemberValue: `readings.bag_g` of bob in icu is";
        let owner = "MemberValue: `attributes.owner` of bob in icu is";
        for (exchanged, ports, cause) in [
            ("readings.bag_g", "", None),
            ("readings.bag_g", "minimum=\"12\" maximum=\"12.5\" equals=\"12.0\"", None),
            ("readings.bag_g", "maximum=\"11\"", Some(format!("{bag} above the maximum 11"))),
            ("readings.bag_g", "minimum=\"12.5\"", Some(format!("{bag} below the minimum 12.5"))),
            ("readings.bag_g", "equals=\"13\"", Some(format!("{bag} not 13"))),
            ("readings.lid", "equals=\"false\"", None),
            ("readings.lid", "", Some("MemberValue: `readings.lid` of bob in icu is not true".to_owned())),
            ("attributes.owner", "equals=\"ward 3\"", None),
            ("attributes.owner", "equals=\"ward 4\"", Some(format!("{owner} not ward 4"))),
            ("attributes.owner", "minimum=\"1\"", Some(format!("{owner} no number; `minimum` is for numbers"))),
        ] {
            let node = format!("<MemberValue ensemble=\"icu\" robot=\"bob\" exchanged=\"{exchanged}\" {ports}/>");
            assert_eq!(run(&node), cause, "{node}");
        }
    }

    #[test]
    fn an_unknown_value_fails_with_its_cause() {
        for (ensemble, robot, exchanged) in
            [("er", "bob", "readings.bag_g"), ("icu", "cyd", "readings.bag_g"), ("icu", "bob", "attributes.bag_g")]
        {
            let node = format!(
                "<MemberValue ensemble=\"{ensemble}\" robot=\"{robot}\" exchanged=\"{exchanged}\" value=\"{{x}}\"/>"
            );
            let expected = format!(
                "MemberValue: `{exchanged}` of {robot} in {ensemble} is unknown: this robot has not received it lately"
            );
            assert_eq!(run(&node), Some(expected));
        }
    }

    #[test]
    fn scripts_use_an_exchanged_value() {
        let nodes = |limit: &str| {
            format!(
                "<Script code=\"who := 'bob'\"/>\
                 <MemberValue ensemble=\"icu\" robot=\"{{who}}\" exchanged=\"readings.bag_g\" value=\"{{bag}}\"/>\
                 <AlwaysFailure _skipIf=\"bag &gt; {limit}\"/>"
            )
        };
        assert_eq!(run(&nodes("11")), None);
        assert!(run(&nodes("12")).is_some());
    }

    #[test]
    fn a_tree_that_reads_what_no_member_sends_is_found() {
        let exchange = BTreeSet::from([ExchangedValue::Reading("bag_g".to_owned())]);
        let icu = EnsembleSpec {
            exchange,
            ..EnsembleSpec::with_any_skill_of(EnsembleId::new("icu").unwrap(), BTreeSet::new())
        };
        let ensembles = Ensembles::compile(vec![icu]).unwrap();
        let node = |ensemble: &str, exchanged: &str| {
            format!("<MemberValue ensemble=\"{ensemble}\" robot=\"bob\" exchanged=\"{exchanged}\"/>\n")
        };
        let nodes = [
            node("icu", "readings.bag_g"),
            node("icu", "readings.bag"),
            node("icv", "readings.bag_g"),
            node("{of}", "readings.bag_g"),
            node("icu", "{what}"),
        ];
        let tree = read_xml("look.xml", &xml(&nodes.concat())).unwrap();
        let errors: Vec<String> = member_value_errors(&tree, &ensembles).iter().map(ToString::to_string).collect();
        let expected = [
            "look.xml:3: look/MemberValue: ensemble icu exchanges no `readings.bag`; allowed: readings.bag_g; did you mean \
             `readings.bag_g`?",
            "look.xml:4: look/MemberValue: the fleet has no ensemble `icv`; allowed: icu; did you mean `icu`?",
        ];
        assert_eq!(errors, expected);
        let mut library = SkillLibrary::with_leaves(Environment::new());
        let invalid = library.register_xml(TaskType::new("look").unwrap(), "look.xml", &xml(&node("icu", "bag_g")));
        let problem = invalid.unwrap_err().to_string();
        assert!(problem.contains("allowed are attributes.NAME and readings.NAME"), "{problem}");
    }
}
