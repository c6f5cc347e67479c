//! `consort requests`: lists the requests to people.

use crate::client::{ClientFlags, ReadFlags, read_answer};
use crate::exit::Failure;
use crate::output;
use consort_protocol::ids::RoleId;
use consort_protocol::keys::ApiCall;
use consort_protocol::mission::ValueKind;
use consort_protocol::view::{PersonRequestView, RequestsView};
use std::collections::BTreeMap;

/// Show the requests to people
///
/// Missions ask people for tasks that no robot does. A request shows what to do, where, and for which
/// mission; `consort answer` answers it. The first answer counts.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort requests
  consort requests --role nurse
  consort requests --all --json")]
pub(crate) struct Args {
    /// Only requests to people with this role, also those that have been escalated to it
    #[arg(long, value_name = "ROLE")]
    role: Option<RoleId>,
    /// Also closed requests, with their answers
    #[arg(long)]
    all: bool,
    #[command(flatten)]
    read: ReadFlags,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    client: ClientFlags,
}

/// Runs the command.
///
/// # Errors
/// See [`Client::api`](crate::client::Client::api).
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let Args { role, all, read, json, client } = args;
    let answer = client.with_client(async |client| client.api(ApiCall::Requests, &read.options()).await)?;
    let mut view: RequestsView = read_answer(&answer)?;
    view.requests
        .retain(|request| (all || request.phase.is_open()) && role.as_ref().is_none_or(|role| request.is_for(role)));
    if json {
        return output::json(&view);
    }
    if view.requests.is_empty() {
        return output::line(if all { "no requests" } else { "no open requests" });
    }
    let heads = ["REQUEST", "ROLE", "TASK", "WHERE", "WITH", "RESULTS", "STATE"].map(str::to_owned).to_vec();
    let rows: Vec<Vec<String>> = std::iter::once(heads).chain(view.requests.iter().map(row)).collect();
    output::line(output::table(&rows))
}

fn row(request: &PersonRequestView) -> Vec<String> {
    let task = match &request.task_type {
        Some(task_type) if task_type.as_str() != request.task.as_str() => format!("{} ({task_type})", request.task),
        _ => request.task.to_string(),
    };
    let robots: Vec<&str> = request.robots.values().map(|robot| robot.as_str()).collect();
    let escalated = request.escalated_to().filter(|_| request.phase.is_open());
    let or_dash = |text: String| if text.is_empty() { "-".to_owned() } else { text };
    vec![
        request.request.to_string(),
        request.role.to_string(),
        task,
        or_dash(request.place.as_ref().map(ToString::to_string).unwrap_or_default()),
        or_dash(robots.join(", ")),
        or_dash(form_text(&request.form)),
        format!("{}{}", request.phase, escalated.map_or_else(String::new, |to| format!(", escalated to {to}"))),
    ]
}

/// Formats a form: `pulse_bpm (a whole number from 0 to 300)`.
pub(super) fn form_text(form: &BTreeMap<String, ValueKind>) -> String {
    form.iter().map(|(name, kind)| format!("{name} ({kind})")).collect::<Vec<_>>().join(", ")
}
