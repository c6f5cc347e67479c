//! `consort fleet`: shows the nodes of a fleet and its coordinator.

use crate::client::{Client, QueryFlags};
use crate::exit::Failure;
use crate::output;
use consort_protocol::keys::Key;
use serde_json::{Value, json};

/// Show the nodes of a fleet and its coordinator
///
/// The data comes from the nearest node; each row has the age of its last contact.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort fleet
  consort fleet --json --connect tcp/192.0.2.7:7447")]
pub struct Args {
    #[command(flatten)]
    ask: QueryFlags,
}

/// Runs the command.
///
/// # Errors
/// See [`Client::query_view`].
pub fn run(args: Args) -> Result<(), Failure> {
    let look = async |client: &mut Client| {
        let fleet = client.query_view(&Key::ViewFleet).await?;
        let coordinator = client.query_view(&Key::ViewCoordinator).await?;
        Ok(json!({ "fleet": fleet, "coordinator": coordinator }))
    };
    args.ask.print(look, |seen| format_fleet(&seen["fleet"], &seen["coordinator"]))
}

fn format_fleet(fleet: &Value, coordinator: &Value) -> String {
    let heads = ["NODE", "ALIVE", "VOTES", "PLACE", "BATTERY", "SPEED", "HOLDS", "MEMBER", "CONTACT", "SKILLS"];
    let nodes = fleet.get("nodes").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    let rows = nodes.iter().map(|node| row(node, fleet, coordinator));
    let rows: Vec<Vec<String>> = std::iter::once(heads.map(str::to_owned).to_vec()).chain(rows).collect();
    format!("{}\n{}", format_coordinator(coordinator), output::table(&rows))
}

fn format_coordinator(coordinator: &Value) -> String {
    let text = |key: &str| coordinator.get(key).and_then(Value::as_str).unwrap_or("?");
    let number = |key: &str| coordinator.get(key).and_then(Value::as_u64).unwrap_or(0);
    let list = |key: &str| {
        let names = coordinator.get(key).and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str);
        let names: Vec<&str> = names.collect();
        if names.is_empty() { "none".to_owned() } else { names.join(", ") }
    };
    let (term, voters) = (number("term"), list("voters"));
    if coordinator.get("node").is_none_or(Value::is_null) {
        return format!("no coordinator, as seen by {}; the last term was {term}; voters: {voters}", text("seen_by"));
    }
    let since = number("since_ms") as f64 / 1000.0;
    let node = text("node");
    format!("{node} is the coordinator for {since:.1} s, term {term}; voters: {voters}")
}

fn row(node: &Value, fleet: &Value, coordinator: &Value) -> Vec<String> {
    let name = node.get("node").and_then(Value::as_str).unwrap_or("?");
    let yes_no = |value: Option<&Value>| value.and_then(Value::as_bool).map_or("?", |is| if is { "yes" } else { "no" });
    let number = |pointer: &str| node.pointer(pointer).and_then(Value::as_f64);
    let dash = || "-".to_owned();
    let member = fleet.pointer("/ensembles/0/nodes").and_then(Value::as_array).into_iter().flatten();
    let member = member.into_iter().find(|entry| entry.get("node").and_then(Value::as_str) == Some(name));
    let holds = node.get("holds").filter(|holds| holds.is_object()).map(|holds| {
        let text = |key: &str| holds.get(key).and_then(Value::as_str).unwrap_or("?");
        format!("{} of {}", text("role"), text("mission"))
    });
    let skills = node
        .pointer("/robot/skills")
        .and_then(Value::as_array)
        .map(|skills| skills.iter().filter_map(Value::as_str).collect::<Vec<_>>().join(", "));
    let among = |list: &str| {
        let list = coordinator.get(list).and_then(Value::as_array);
        list.is_some_and(|list| list.iter().any(|node| node.as_str() == Some(name)))
    };
    let coordinates = coordinator.get("node").and_then(Value::as_str) == Some(name);
    vec![
        name.to_owned(),
        match node.get("status").and_then(Value::as_str) {
            Some("suspect") => "suspect",
            _ => yes_no(node.get("alive")),
        }
        .to_owned(),
        if coordinates {
            "coordinates"
        } else if among("voters_lost") {
            "lost"
        } else if among("voters") {
            "votes"
        } else {
            "-"
        }
        .to_owned(),
        node.pointer("/robot/place").and_then(Value::as_str).map_or_else(dash, str::to_owned),
        number("/robot/battery").map_or_else(dash, |share| format!("{:.1} %", share * 100.0)),
        number("/robot/speed").map_or_else(dash, |speed| format!("{speed:.2} m/s")),
        holds.unwrap_or_else(dash),
        yes_no(member.and_then(|member| member.get("member"))).to_owned(),
        number("/age_ms").map_or_else(dash, |age| format!("{:.1} s ago", age / 1000.0)),
        skills.unwrap_or_else(dash),
    ]
}
