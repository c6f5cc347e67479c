//! Actions of clients: requesting and canceling missions, and letting time pass.

use super::fixture::{Fixture, RefusedRequest};
use super::step_arguments::StepArguments;
use super::step_pattern::{ActionStep, action};
use super::step_result::{StepFailure, StepResult};
use consort_protocol::keys::ApiCall;
use consort_protocol::mission::{Format, MissionTemplate};
use consort_skills::missions::shipped;
use serde_json::{Map, Value, json};
use std::cell::Cell;
use std::path::Path;
use std::time::Duration;

/// Time for which a client repeats a request, in node time.
const RETRY_LIMIT: Duration = Duration::from_secs(120);

/// Returns the steps of this file, in the order of their documentation.
pub(super) fn steps() -> Vec<ActionStep> {
    vec![
        run_fleet(),
        let_time_pass(),
        request_sample(),
        request_sample_as(),
        request_mission(),
        request_mission_as(),
        request_mission_text(),
        cancel_mission(),
    ]
}

fn run_fleet() -> ActionStep {
    action("the fleet runs for {time}", "the fleet runs for 10 minutes", async |fixture, arguments| {
        fixture.start_nodes().await?;
        fixture.advance(arguments.seconds(0), |_| Ok(false)).await.map(drop)
    })
}

fn let_time_pass() -> ActionStep {
    action("{time} pass", "10 minutes pass", async |fixture, arguments| {
        fixture.advance(arguments.seconds(0), |_| Ok(false)).await.map(drop)
    })
}

fn request_sample() -> ActionStep {
    action(
        "a sample is requested from {text}",
        r#"a sample is requested from "IC Room 6""#,
        async |fixture, arguments| {
            let name = format!("sample-{}", fixture.missions.len() + 1);
            submit_sample(fixture, arguments, name).await
        },
    )
}

fn request_sample_as() -> ActionStep {
    action(
        "a sample is requested from {text} as {name}",
        r#"a sample is requested from "IC Room 6" as urgent"#,
        async |fixture, arguments| submit_sample(fixture, arguments, arguments.value(1).to_owned()).await,
    )
}

fn request_mission() -> ActionStep {
    action(
        "the mission {text} is requested",
        r#"the mission "lab-samples" is requested"#,
        async |fixture, arguments| {
            let name = default_name(fixture);
            submit_mission(fixture, arguments, name).await
        },
    )
}

fn request_mission_as() -> ActionStep {
    action(
        "the mission {text} is requested as {name}",
        r#"the mission "lab-samples" is requested as first"#,
        async |fixture, arguments| submit_mission(fixture, arguments, arguments.value(1).to_owned()).await,
    )
}

fn request_mission_text() -> ActionStep {
    action("this mission is requested:", "this mission is requested:", async |fixture, arguments| {
        let text = arguments.docstring.as_deref();
        let text = text.ok_or_else(|| StepFailure::invalid("the mission follows between lines of \"\"\""))?;
        let (mission, name) = (read_mission(text, None)?, default_name(fixture));
        submit(fixture, json!({ "mission": mission, "request": name }), name.clone()).await
    })
}

fn cancel_mission() -> ActionStep {
    action("{mission} is canceled by {text}", r#"the mission is canceled by "ward 3""#, async |fixture, arguments| {
        let mission = fixture.mission(arguments.value(0))?;
        let fleet = fixture.ensure_fleet().await?;
        let request = json!({ "mission": mission, "by": arguments.value(1) });
        match fleet.request(ApiCall::Cancel, &request).await {
            Some(answer) if answer.get("error").is_none() => Ok(()),
            Some(answer) => Err(StepFailure::Invalid(format!("the fleet replied {answer}"))),
            None => Err(StepFailure::invalid("no node replied")),
        }
    })
}

/// Returns the name of a request for which the scenario gives none.
fn default_name(fixture: &Fixture) -> String {
    format!("request-{}", fixture.missions.len() + 1)
}

async fn submit_sample(fixture: &mut Fixture, arguments: &StepArguments, name: String) -> StepResult {
    let request = json!({ "mission": "lab-samples", "parameters": { "room": arguments.value(0) }, "request": name });
    submit(fixture, request, name).await
}

/// Requests a mission. The table contains a column per parameter and a single row. The columns
/// `priority` and `deadline` (in seconds) apply to the request itself.
async fn submit_mission(fixture: &mut Fixture, arguments: &StepArguments, name: String) -> StepResult {
    let wanted = arguments.value(0);
    let mission = if shipped().contains_key(wanted) {
        json!(wanted)
    } else {
        let file = fixture.setup.folder.join(wanted);
        let text = std::fs::read_to_string(&file).map_err(|problem| {
            let known: Vec<&str> = shipped().keys().map(String::as_str).collect();
            let known = known.join(", ");
            StepFailure::Invalid(format!("{}: {problem}; missions that come with the program: {known}", file.display()))
        })?;
        read_mission(&text, Some(&file))?
    };
    let mut request = json!({ "mission": mission, "request": name });
    let mut parameters = Map::new();
    for (name, value) in arguments.named_values()? {
        match name {
            "priority" => request["priority"] = number(value)?,
            "deadline" => request["deadline_s"] = number(value)?,
            _ => drop(parameters.insert(name.to_owned(), json!(value))),
        }
    }
    request["parameters"] = Value::Object(parameters);
    submit(fixture, request, name).await
}

fn number(cell: &str) -> Result<Value, StepFailure> {
    cell.parse::<i64>().map(Value::from).map_err(|_| StepFailure::Invalid(format!("{cell:?} is no whole number")))
}

fn read_mission(text: &str, file: Option<&Path>) -> Result<Value, StepFailure> {
    MissionTemplate::request(text, Format::of(file, text)).map_err(StepFailure::invalid)
}

/// Repeats a request, as a client does, until it is acknowledged.
async fn submit(fixture: &mut Fixture, request: Value, name: String) -> StepResult {
    if fixture.missions.iter().any(|(request, _)| *request == name) {
        return Err(StepFailure::Invalid(format!("{name} was requested before: a request name may be used once")));
    }
    if let Some(unchecked) = fixture.refused.as_ref().and_then(RefusedRequest::unchecked_text) {
        return Err(StepFailure::Invalid(unchecked));
    }
    let fleet = fixture.ensure_fleet().await?;
    let deadline = fleet.elapsed() + RETRY_LIMIT;
    let mission = loop {
        let answer = fleet.request(ApiCall::Submit, &request).await;
        match answer.as_ref().and_then(|answer| answer["mission"].as_str()) {
            Some(mission) => break mission.to_owned(),
            None if answer.as_ref().is_some_and(|answer| answer.get("retry_after_ms").is_none()) => {
                let why = answer.map(|answer| answer["error"].as_str().unwrap_or_default().to_owned());
                let why = why.unwrap_or_default();
                fixture.refused = Some(RefusedRequest { request: name, why, checked: Cell::new(false) });
                return Ok(());
            }
            None if fleet.elapsed() >= deadline => {
                return Err(StepFailure::NotMet(format!("it was not acknowledged within {RETRY_LIMIT:?}")));
            }
            None => tokio::time::sleep(Duration::from_millis(100)).await,
        }
    };
    fixture.missions.push((name, crate::slug(&mission)));
    Ok(())
}
