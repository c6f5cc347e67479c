//! Eligibility: a condition of a role on the robot that fills it.

use super::condition::{Condition, Variables, context_of};
use super::facts::{CHANGING_FIELDS, example_robot, robot_facts};
use crate::ids::RobotId;
use crate::knowledge::RobotKnowledge;
use cel::SerializationError;

/// Compiled condition of a role on its robot, such as `robot.attributes.section == "icu"`.
#[derive(Debug)]
pub struct Eligibility(Condition);

/// Reason for which a robot is not eligible for a role.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ineligibility {
    /// Description, with the condition.
    pub why: String,
    /// True if nothing that the robot does changes it.
    pub permanent: bool,
}

impl Eligibility {
    /// Compiles a condition.
    ///
    /// # Errors
    /// Description of the problem: the text is not an expression, it is too long or too complex, or it
    /// uses an unknown name.
    pub fn compile(text: &str) -> Result<Eligibility, String> {
        let example = variables("example", &example_robot()).expect("the example can be converted");
        Condition::compile(text, &example).map(Eligibility)
    }

    /// Checks whether the result may depend on this attribute of the robot.
    pub(super) fn may_use_attribute(&self, name: &str) -> bool {
        self.0.may_use_attribute(name)
    }

    /// Checks whether a robot meets the condition by its record, or may meet it once its place or charge has changed.
    pub fn may_be_met(&self, name: &RobotId, robot: &RobotKnowledge) -> bool {
        self.check(name, robot).map_or_else(|found| !found.permanent, |()| true)
    }

    /// Compiles a condition and checks it for a robot.
    ///
    /// # Errors
    /// As [`check`](Self::check); a condition that cannot be compiled is met by no robot.
    pub fn check_text(text: &str, name: &RobotId, robot: &RobotKnowledge) -> Result<(), Ineligibility> {
        let compiled = Eligibility::compile(text);
        let invalid = |problem| Ineligibility { why: format!("`{text}`: {problem}"), permanent: true };
        compiled.map_err(invalid)?.check(name, robot)
    }

    /// Checks the condition for a robot.
    ///
    /// # Errors
    /// [`Ineligibility`] if the condition is false or has no value, for example because the robot lacks
    /// an attribute.
    pub fn check(&self, name: &RobotId, robot: &RobotKnowledge) -> Result<(), Ineligibility> {
        let Eligibility(condition) = self;
        let text = &condition.text;
        let ineligible =
            |why| Ineligibility { why, permanent: !condition.uses(|field| CHANGING_FIELDS.contains(&field)) };
        let variables = variables(name.as_str(), robot)
            .map_err(|problem| ineligible(format!("`{text}` cannot be evaluated: {problem}")))?;
        match condition.holds(&context_of(variables)) {
            Ok(true) => Ok(()),
            Ok(false) => Err(ineligible(format!("`{text}` is false"))),
            Err(problem) => Err(ineligible(format!("`{text}`: {problem}"))),
        }
    }
}

fn variables(name: &str, robot: &RobotKnowledge) -> Result<Variables, SerializationError> {
    Ok(vec![("robot", robot_facts(name, robot)?)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::BatteryShare;

    fn ada() -> (RobotId, RobotKnowledge) {
        let attributes = serde_json::json!({ "section": "icu", "payload_kg": 2.5, "floor": 3 });
        let attributes = serde_json::from_value(attributes).unwrap();
        let robot = RobotKnowledge { attributes, battery: BatteryShare::new(0.5).unwrap(), ..example_robot() };
        (RobotId::new("ada").unwrap(), robot)
    }

    #[test]
    fn a_condition_uses_attributes_skills_place_and_charge() {
        let (name, robot) = ada();
        for (text, why, permanent) in [
            (r#"robot.attributes.section == "icu""#, None, true),
            (r#"robot.attributes.section == "er""#, Some("is false"), true),
            ("robot.attributes.payload_kg >= 2.0 && robot.attributes.floor == 3", None, true),
            (r#"robot.name in ["ada", "bob"] && "navigation" in robot.skills"#, None, true),
            ("robot.attributes.floor == 3 && robot.battery > 0.6", Some("is false"), false),
            (r#"robot.place == "dock""#, None, false),
            ("robot.attributes.sterile", Some("there is no attribute `sterile`"), true),
            ("!has(robot.attributes.sterile) || robot.attributes.sterile", None, true),
        ] {
            match (Eligibility::compile(text).unwrap().check(&name, &robot), why) {
                (Ok(()), None) => {}
                (Err(reason), Some(why)) => {
                    assert!(reason.why.starts_with(&format!("`{text}`")) && reason.why.contains(why), "{reason:?}");
                    assert_eq!(reason.permanent, permanent, "{text}");
                }
                (result, _) => panic!("{text}: {result:?}"),
            }
        }
    }

    #[test]
    fn an_invalid_condition_is_rejected_when_it_is_compiled() {
        for (text, part) in [
            ("robot.attributes.section ==", "ERROR"),
            ("robot.wheels > 3", "`robot` has no field `wheels`"),
            ("robot.attributes.floor > 3 && robot.batery > 0.5", "did you mean `battery`"),
            ("member.battery > 0.5", "there is no variable `member`; allowed: `robot`"),
            ("robot.battery", "it must be true or false"),
            (&"true && ".repeat(200), "at most 1024 are allowed"),
        ] {
            let problem = Eligibility::compile(text).unwrap_err();
            assert!(problem.contains(part), "{text}: {problem}");
        }
    }
}
