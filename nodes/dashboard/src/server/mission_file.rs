//! Mission files that a user submits with the form.

use super::json::{Rejection, json_reply, parse_body, rejection};
use axum::body::Bytes;
use axum::http::{HeaderMap, StatusCode};
use axum::response::Response;
use consort_protocol::ids::TaskId;
use consort_protocol::mission::{Format, IhtnFields, MissionDocument, TemplateParameter};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// A mission file that the user has chosen.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MissionFile {
    name: String,
    text: String,
}

/// The mission of a file, for the form of a request.
#[derive(Serialize)]
struct ReadMission<'a> {
    /// The mission, as in a request.
    mission: Value,
    /// Name of the mission.
    name: &'a TaskId,
    title: &'a str,
    parameters: &'a BTreeMap<String, TemplateParameter>,
    /// Agents of a flat iHTN, some of which may be people; empty for a mission file.
    agents: BTreeSet<String>,
}

/// Reads a mission file in YAML or JSON, or a flat iHTN. The coordinator checks the mission.
pub(super) async fn read(headers: HeaderMap, body: Bytes) -> Result<Response, Rejection> {
    let MissionFile { name, text } = parse_body(&headers, &body)?;
    let path = Path::new(&name);
    let format = Format::of(Some(path), &text);
    let read = MissionDocument::parse(&text, format, IhtnFields::default())
        .and_then(|document| Ok((document, MissionDocument::request(&text, format, IhtnFields::default())?)));
    let (document, mission) =
        read.map_err(|problem| rejection(StatusCode::BAD_REQUEST, &format!("{name}: {problem}")))?;
    let (document, agents) = match document {
        template @ MissionDocument::Template(_) => (template, BTreeSet::new()),
        ihtn @ MissionDocument::Ihtn { .. } => {
            let stem = path.file_stem().and_then(|stem| stem.to_str()).and_then(|stem| TaskId::new(stem).ok());
            let named = match stem {
                Some(stem) => ihtn.named(stem),
                None => ihtn,
            };
            (named, agents(&mission))
        }
    };
    let (name, title, parameters) = (document.name(), document.title(), document.parameters());
    Ok(json_reply(StatusCode::OK, &ReadMission { mission, name, title, parameters, agents }))
}

/// Returns the agents of a flat iHTN.
fn agents(mission: &Value) -> BTreeSet<String> {
    let nodes = mission.as_object().into_iter().flat_map(|nodes| nodes.values());
    let named = nodes.filter_map(|node| node.get("agents")).flat_map(|agents| match agents {
        Value::Array(agents) => agents.iter().filter_map(Value::as_str).collect(),
        Value::String(agent) if !agent.is_empty() => vec![agent.as_str()],
        _ => vec![],
    });
    named.map(str::to_owned).collect()
}
