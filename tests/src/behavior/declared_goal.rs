//! Goals of declared actions, from the texts of a step.

use super::scenario_setup::coordinates;
use super::step_result::StepFailure;
use consort_protocol::ids::ActionName;
use consort_protocol::pose::Pose;
use consort_skills::actions::{Goal, JsonObject};
use consort_skills::domain_file::{ActionForm, ParameterForm, ParameterKind};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Returns a goal of an action with these parameters. An empty text is no value.
pub(super) fn declared_goal(
    actions: &BTreeMap<&ActionName, &ActionForm>,
    action: &ActionName,
    texts: &[(&str, &str)],
) -> Result<Goal, StepFailure> {
    let form = actions.get(action).ok_or_else(|| {
        let known: Vec<&str> = actions.keys().map(|name| name.as_str()).collect();
        StepFailure::Invalid(format!("no domain declares the action {action}; allowed: {}", known.join(", ")))
    })?;
    let mut parameters = JsonObject::new();
    for (name, text) in texts.iter().filter(|(_, text)| !text.is_empty()) {
        let parameter = form.parameters.get(*name).ok_or_else(|| {
            let known: Vec<&str> = form.parameters.keys().map(String::as_str).collect();
            StepFailure::Invalid(format!("{action} has no parameter `{name}`; allowed: {}", known.join(", ")))
        })?;
        let value = value(parameter, text).map_err(|allowed| {
            StepFailure::Invalid(format!("the parameter `{name}` of {action} is `{text}`, allowed is {allowed}"))
        })?;
        parameters.insert((*name).to_owned(), value);
    }
    let missing = form.parameters.iter().find(|(name, form)| !form.optional && !parameters.contains_key(*name));
    match missing {
        Some((name, _)) => Err(StepFailure::Invalid(format!("{action} needs the parameter `{name}`, in a table"))),
        None => Ok(Goal {
            action: action.clone(),
            parameters,
            repeatable: form.repeatable,
            hands_over: form.hands_over,
            since: None,
        }),
    }
}

/// Returns the value that a text denotes, or else what is allowed.
fn value(form: &ParameterForm, text: &str) -> Result<Value, String> {
    let pose = |text: &str| coordinates(text).ok().map(|(x, y)| Pose::new(x, y, 0.0));
    match form.kind {
        ParameterKind::Pose => {
            pose(text).map(|pose| json!(pose)).ok_or_else(|| "a position in metres, as 1, 1.5".to_owned())
        }
        ParameterKind::Waypoints => {
            let waypoints = text.split(';').map(|text| Some(json!({ "pose": pose(text)? }))).collect::<Option<Value>>();
            waypoints.ok_or_else(|| "positions in metres, as 1, 1.5; 2, 1.5".to_owned())
        }
        _ => {
            let kind = form.value_kind();
            kind.parse(text).map(|value| json!(value)).ok_or_else(|| kind.to_string())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_skills::domain::standard_domain;

    fn goal(action: &str, texts: &[(&str, &str)]) -> Result<Goal, String> {
        let actions = standard_domain().action_forms().collect();
        declared_goal(&actions, &action.parse().unwrap(), texts).map_err(|problem| format!("{problem:?}"))
    }

    #[test]
    fn a_goal_has_the_types_of_its_declaration() {
        let json = |action, texts: &[(&str, &str)]| serde_json::to_value(goal(action, texts).unwrap()).unwrap();
        assert_eq!(
            json("wait", &[("time", "5")]),
            json!({ "action": "wait", "parameters": { "time": 5.0 }, "repeatable": true })
        );
        assert_eq!(
            json("spin", &[("angle_rad", "-0.5")]),
            json!({ "action": "spin", "parameters": { "angle_rad": -0.5 } }),
            "a repeated spin has another effect"
        );
        assert_eq!(
            json("navigate_to_pose", &[("pose", "1, 2.5"), ("place", "")])["parameters"],
            json!({ "pose": { "x_m": 1.0, "y_m": 2.5, "yaw_rad": 0.0 } })
        );
        let points = json("follow_waypoints", &[("waypoints", "1, 1; 2, 1")]);
        assert_eq!(points["parameters"]["waypoints"][1]["pose"]["x_m"], json!(2.0));
    }

    #[test]
    fn mistakes_are_named() {
        let mistakes = [
            ("spinn", &[] as &[(&str, &str)], "no domain declares the action spinn; allowed: "),
            ("wait", &[], "wait needs the parameter `time`, in a table"),
            ("wait", &[("tine", "5")], "wait has no parameter `tine`; allowed: time"),
            ("wait", &[("time", "soon")], "the parameter `time` of wait is `soon`, allowed is "),
            (
                "operate_drawer",
                &[("action", "shut")],
                "the parameter `action` of operate_drawer is `shut`, allowed is ",
            ),
        ];
        for (action, texts, expected) in mistakes {
            let problem = goal(action, texts).unwrap_err();
            assert!(problem.contains(expected), "{problem}");
        }
    }
}
