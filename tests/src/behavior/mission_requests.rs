//! Deeds of clients: missions are asked for and withdrawn; time passes.

use super::fixture::{Fixture, RefusedRequest};
use super::step_arguments::StepArguments;
use super::step_pattern::{ActionFn, StepFailure, StepPattern};
use consort_protocol::keys::ApiCall;
use consort_protocol::mission::{Format, MissionTemplate, shipped};
use futures::FutureExt;
use serde_json::{Map, Value, json};
use std::cell::Cell;
use std::path::Path;
use std::time::Duration;

/// How long a client asks again, in seconds of the nodes' time.
const ASKS_FOR: Duration = Duration::from_secs(120);

/// All of them.
pub(super) fn phrases() -> Vec<StepPattern<ActionFn>> {
    let does = |pattern, example, does: ActionFn| StepPattern::new(pattern, example, does);
    vec![
        does("the fleet runs for {time}", "the fleet runs for 10 minutes", |stage, said| {
            async move {
                stage.start_nodes().await?;
                stage.advance(said.seconds(0), |_| Ok(false)).await.map(drop)
            }
            .boxed_local()
        }),
        does("{time} pass", "10 minutes pass", |stage, said| {
            async move { stage.advance(said.seconds(0), |_| Ok(false)).await.map(drop) }.boxed_local()
        }),
        does("a sample is requested from {text}", r#"a sample is requested from "IC Room 6""#, |stage, said| {
            let name = format!("sample-{}", stage.missions.len() + 1);
            sample(stage, said, name).boxed_local()
        }),
        does(
            "a sample is requested from {text} as {name}",
            r#"a sample is requested from "IC Room 6" as urgent"#,
            |stage, said| sample(stage, said, said.value(1).to_owned()).boxed_local(),
        ),
        does("the mission {text} is requested", r#"the mission "lab-samples" is requested"#, |stage, said| {
            let name = format!("request-{}", stage.missions.len() + 1);
            requested(stage, said, name).boxed_local()
        }),
        does(
            "the mission {text} is requested as {name}",
            r#"the mission "lab-samples" is requested as first"#,
            |stage, said| requested(stage, said, said.value(1).to_owned()).boxed_local(),
        ),
        does("this mission is requested:", "this mission is requested:", |stage, said| {
            async move {
                let text = said.docstring.as_deref();
                let text = text.ok_or_else(|| StepFailure::invalid("the mission follows between lines of \"\"\""))?;
                let mission = read(text, None)?;
                let name = format!("request-{}", stage.missions.len() + 1);
                ask(stage, json!({ "mission": mission, "request": name }), name.clone()).await
            }
            .boxed_local()
        }),
        does("{mission} is withdrawn by {text}", r#"the mission is withdrawn by "ward 3""#, |stage, said| {
            async move {
                let mission = stage.mission(said.value(0))?;
                let fleet = stage.ensure_fleet().await?;
                let asked = json!({ "mission": mission, "by": said.value(1) });
                match fleet.request(ApiCall::Cancel, &asked).await {
                    Some(answer) if answer.get("error").is_none() => Ok(()),
                    Some(answer) => Err(StepFailure::Invalid(format!("the fleet answered {answer}"))),
                    None => Err(StepFailure::invalid("nobody answered")),
                }
            }
            .boxed_local()
        }),
    ]
}

async fn sample(stage: &mut Fixture, said: &StepArguments, name: String) -> Result<(), StepFailure> {
    let asked = json!({ "mission": "lab-samples", "parameters": { "room": said.value(0) }, "request": name });
    ask(stage, asked, name).await
}

/// The parameters are in the table: a column each, one row. `priority` and `deadline` (in seconds) are the request's own.
async fn requested(stage: &mut Fixture, said: &StepArguments, name: String) -> Result<(), StepFailure> {
    let wanted = said.value(0);
    let mission = if shipped().contains_key(wanted) {
        json!(wanted)
    } else {
        let file = stage.setup.folder.join(wanted);
        let text = std::fs::read_to_string(&file).map_err(|problem| {
            let known: Vec<&str> = shipped().keys().map(String::as_str).collect();
            let known = known.join(", ");
            StepFailure::Invalid(format!("{}: {problem}; missions that come with the program: {known}", file.display()))
        })?;
        read(&text, Some(&file))?
    };
    let mut asked = json!({ "mission": mission, "request": name });
    let mut parameters = Map::new();
    if let Some([heads, row]) = said.table.as_deref() {
        for (head, cell) in heads.iter().zip(row) {
            match head.as_str() {
                "priority" => asked["priority"] = number(cell)?,
                "deadline" => asked["deadline_s"] = number(cell)?,
                _ => drop(parameters.insert(head.clone(), json!(cell))),
            }
        }
    } else if said.table.is_some() {
        return Err(StepFailure::invalid("its parameters are a table of two lines: names, and values"));
    }
    asked["parameters"] = Value::Object(parameters);
    ask(stage, asked, name).await
}

fn number(cell: &str) -> Result<Value, StepFailure> {
    cell.parse::<i64>().map(Value::from).map_err(|_| StepFailure::Invalid(format!("{cell:?} is no whole number")))
}

fn read(text: &str, file: Option<&Path>) -> Result<Value, StepFailure> {
    MissionTemplate::request(text, Format::of(file, text)).map_err(StepFailure::invalid)
}

/// Asks, as a client would, until somebody acknowledges it.
async fn ask(stage: &mut Fixture, asked: Value, name: String) -> Result<(), StepFailure> {
    if stage.missions.iter().any(|(request, _)| *request == name) {
        return Err(StepFailure::Invalid(format!("{name} was asked for before: one request gets one mission")));
    }
    if let Some(unheeded) = stage.refused.as_ref().and_then(RefusedRequest::unchecked_text) {
        return Err(StepFailure::Invalid(unheeded));
    }
    let fleet = stage.ensure_fleet().await?;
    let deadline = fleet.elapsed() + ASKS_FOR;
    let mission = loop {
        let answer = fleet.request(ApiCall::Submit, &asked).await;
        match answer.as_ref().and_then(|answer| answer["mission"].as_str()) {
            Some(mission) => break mission.to_owned(),
            None if answer.as_ref().is_some_and(|answer| answer.get("retry_after_ms").is_none()) => {
                let why = answer.map(|answer| answer["error"].as_str().unwrap_or_default().to_owned());
                let why = why.unwrap_or_default();
                stage.refused = Some(RefusedRequest { request: name, why, checked: Cell::new(false) });
                return Ok(());
            }
            None if fleet.elapsed() >= deadline => {
                return Err(StepFailure::NotMet(format!("nobody acknowledged it within {ASKS_FOR:?}")));
            }
            None => tokio::time::sleep(Duration::from_millis(100)).await,
        }
    };
    stage.missions.push((name, crate::slug(&mission)));
    Ok(())
}
