//! `consort missions`: lists missions and their progress.

use crate::client::{Client, ClientFlags};
use crate::exit::Failure;
use crate::output;
use consort_protocol::keys::ApiCall;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;

/// Show missions and their progress
///
/// In the order of submission: state, finished steps, role holders, the reason why a mission is
/// still pending, and for a mission that needs intervention, the items in each robot's hands and
/// their places. With --watch a line is added for every change, until Ctrl-C.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort missions
  consort missions --watch
  consort missions --json | head -c 2000")]
pub struct Args {
    /// Keep running, and add a line for every change
    #[arg(long)]
    watch: bool,
    /// Print JSON: the whole list; with --watch a line for every change
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    client: ClientFlags,
}

/// Poll interval for changes.
const LOOK: Duration = Duration::from_millis(500);

/// Runs the command.
///
/// # Errors
/// See [`Client::api`].
pub fn run(args: Args) -> Result<(), Failure> {
    args.client.with_client(
        async |client| {
            if args.watch { watch(client, args.json).await } else { once(client, args.json).await }
        },
    )
}

async fn list(client: &mut Client) -> Result<Value, Failure> {
    client.api(ApiCall::List, &json!(null)).await
}

fn entries(answer: &Value) -> &[Value] {
    answer.get("missions").and_then(Value::as_array).map_or(&[], Vec::as_slice)
}

async fn once(client: &mut Client, in_json: bool) -> Result<(), Failure> {
    let answer = list(client).await?;
    if in_json {
        return output::line(&answer);
    }
    let missions = entries(&answer);
    if missions.is_empty() {
        return output::line("no missions yet; `consort submit lab-samples` submits a mission");
    }
    let heads = ["MISSION", "STATE", "STEPS", "PARAMETERS", "ROLES", ""].map(str::to_owned).to_vec();
    let rows: Vec<Vec<String>> = std::iter::once(heads).chain(missions.iter().map(row)).collect();
    output::line(output::table(&rows))
}

async fn watch(client: &mut Client, in_json: bool) -> Result<(), Failure> {
    let mut shown: BTreeMap<String, Value> = BTreeMap::new();
    loop {
        let answer = list(client).await?;
        for mission in entries(&answer) {
            let id = text(mission, "mission");
            if shown.get(&id) != Some(mission) {
                client.progress().clear();
                if in_json {
                    output::line(mission)?;
                } else {
                    output::line(row(mission).join("  ").trim_end())?;
                }
                shown.insert(id, mission.clone());
            }
        }
        tokio::time::sleep(LOOK).await;
    }
}

fn text(value: &Value, key: &str) -> String {
    value.get(key).and_then(Value::as_str).unwrap_or("?").to_owned()
}

fn row(mission: &Value) -> Vec<String> {
    let number = |key: &str| mission.get(key).and_then(Value::as_u64).unwrap_or(0);
    let why = mission.get("pending_reason").and_then(Value::as_str).map(str::to_owned);
    let why = why.filter(|_| text(mission, "state") == "pending");
    vec![
        text(mission, "mission"),
        text(mission, "state").replace('_', " "),
        format!("{}/{}", number("done"), number("steps")),
        pairs(mission.get("parameters")),
        pairs(mission.get("holders")),
        why.unwrap_or_else(|| {
            mission.get("detail").map(detail).unwrap_or_default().trim_start_matches(": ").to_owned()
        }),
    ]
}

fn pairs(value: Option<&Value>) -> String {
    let Some(Value::Object(map)) = value else { return "-".to_owned() };
    let plain = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let pairs: Vec<String> = map.iter().map(|(name, value)| format!("{name}={}", plain(value))).collect();
    if pairs.is_empty() { "-".to_owned() } else { pairs.join(", ") }
}

/// Formats the last known places of items: `sample with amber (r1) at IC Room 6, not certain`.
fn last_known_places(items: &Value) -> String {
    let line = |kept: &Value| {
        let place = kept.get("place").and_then(Value::as_str).map(|place| format!(" at {place}"));
        let certain = kept.get("certain").and_then(Value::as_bool).unwrap_or(false);
        format!(
            "{} with {} ({}){}{}",
            text(kept, "item"),
            text(kept, "robot"),
            text(kept, "role"),
            place.unwrap_or_default(),
            if certain { "" } else { ", not certain" },
        )
    };
    items.as_array().into_iter().flatten().map(line).collect::<Vec<_>>().join("; ")
}

/// Formats the fields of a mission's state, as `: cause`.
pub(super) fn detail(state: &Value) -> String {
    let Value::Object(map) = state else { return String::new() };
    let fields = map.values().filter_map(Value::as_object).flat_map(|fields| fields.iter());
    let fields_text: Vec<String> = fields
        .map(|(name, value)| match (name.as_str(), value.as_str()) {
            ("items", None) => last_known_places(value),
            ("by", Some(who)) => format!("by {who}"),
            (_, Some(text)) => text.to_owned(),
            (name, None) => format!("{name} {value}"),
        })
        .collect();
    if fields_text.is_empty() { String::new() } else { format!(": {}", fields_text.join(", ")) }
}
