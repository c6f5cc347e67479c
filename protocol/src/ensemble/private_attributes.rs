//! Private attributes: those that an ensemble exchanges. Members receive them, and the records of robots
//! do not contain them. Every node evaluates the conditions of ensembles on records, so these conditions
//! use other attributes.

use super::{ConditionError, Ensemble, ExchangedValue};

/// Returns a problem for each condition that uses an attribute which an ensemble exchanges.
pub fn private_attribute_problems(ensembles: &[Ensemble]) -> Vec<ConditionError> {
    let mut problems = vec![];
    for exchanging in ensembles {
        for attribute in private_attributes(exchanging) {
            let name = &exchanging.spec.name;
            let problem = format!(
                "every node evaluates it, so `attributes.{attribute}` in the `exchange` of ensemble {name} cannot be \
                 private to members; remove it there, or write a condition on other attributes, each as \
                 `member.attributes.NAME`"
            );
            for ensemble in ensembles {
                let conditions = ensemble.membership.iter().chain(&ensemble.coordinator);
                let using = conditions.filter(|condition| condition.may_use_attribute(attribute));
                problems.extend(using.map(|condition| ConditionError {
                    ensemble: ensemble.spec.name.clone(),
                    condition: condition.text.clone(),
                    problem: problem.clone(),
                }));
            }
        }
    }
    problems
}

/// Returns the attributes that an ensemble exchanges.
pub(super) fn private_attributes(ensemble: &Ensemble) -> impl Iterator<Item = &str> {
    ensemble.spec.exchange.iter().filter_map(|value| match value {
        ExchangedValue::Attribute(name) => Some(name.as_str()),
        ExchangedValue::Reading(_) => None,
    })
}

#[cfg(test)]
mod tests {
    use super::super::facts::example_robot;
    use super::super::{Eligibility, EnsembleSpec, Ensembles};
    use super::*;
    use crate::ids::EnsembleId;
    use crate::knowledge::{Attributes, RobotKnowledge};
    use std::collections::BTreeSet;

    fn spec(name: &str, condition: &str, exchange: &[&str]) -> EnsembleSpec {
        let exchange = exchange.iter().map(|text| ExchangedValue::try_from((*text).to_owned()).unwrap()).collect();
        let name = EnsembleId::new(name).unwrap();
        let membership = vec![condition.to_owned()];
        EnsembleSpec { membership, exchange, ..EnsembleSpec::with_any_skill_of(name, BTreeSet::new()) }
    }

    #[test]
    fn a_published_robot_has_no_exchanged_attribute() {
        let icu = spec("icu", "member.attributes.section == 'icu'", &["attributes.code", "readings.floor"]);
        let ensembles = Ensembles::compile(vec![icu, spec("all", "member.robot", &[])]).unwrap();
        let attributes = |json| serde_json::from_value::<Attributes>(json).unwrap();
        let all = attributes(serde_json::json!({ "code": "4711", "section": "icu", "floor": 3 }));
        let robot = ensembles.published(RobotKnowledge { attributes: all, ..example_robot() });
        assert_eq!(robot.attributes, attributes(serde_json::json!({ "section": "icu", "floor": 3 })));
    }

    #[test]
    fn a_condition_on_robots_that_uses_an_exchanged_attribute_is_found() {
        let ensembles = Ensembles::compile(vec![spec("icu", "member.robot", &["attributes.code"])]).unwrap();
        for (condition, is_used) in [
            ("robot.attributes.code == 'a'", true),
            ("has(robot.attributes.code)", true),
            ("robot.attributes['code'] == 'a'", true),
            ("[robot].exists(one, one.battery > 0.5)", true),
            ("robot.attributes.section == 'code' && robot.battery > 0.5", false),
        ] {
            let found = ensembles.private_attribute_of(&Eligibility::compile(condition).unwrap());
            let found = found.map(|(ensemble, attribute)| (ensemble.as_str(), attribute));
            assert_eq!(found, is_used.then_some(("icu", "code")), "{condition}");
        }
    }

    #[test]
    fn a_condition_of_any_ensemble_uses_no_exchanged_attribute() {
        for (condition, is_used) in [
            ("member.attributes.code == 'a'", true),
            ("has(member.attributes.code)", true),
            ("coordinator.attributes.code != member.attributes.section", true),
            ("member.attributes.exists(name, name == 'code')", true),
            ("member.attributes['code'] == 'a'", true),
            ("[member].exists(node, node.battery > 0.5)", true),
            ("member.attributes.section == 'code'", false),
            ("member.attributes.codes == 'a'", false),
            ("member.skills.exists(skill, skill in ensemble.skills) && member.battery > coordinator.battery", false),
        ] {
            let specs = || vec![spec("icu", "member.robot", &["attributes.code"]), spec("er", condition, &[])];
            let problem = Ensembles::compile(specs()).err().map(|problem| problem.to_string());
            let expected = format!(
                "ensemble er: condition `{condition}`: every node evaluates it, so `attributes.code` in the `exchange` of \
                 ensemble icu cannot be private to members; "
            );
            assert_eq!(problem.as_ref().is_some_and(|problem| problem.starts_with(&expected)), is_used, "{problem:?}");
            assert_eq!(problem.is_some(), is_used, "{condition}");
        }
    }
}
