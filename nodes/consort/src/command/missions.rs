//! `consort missions`: lists missions, or shows one with its tasks.

use crate::client::{Client, ClientFlags, read_answer};
use crate::exit::Failure;
use crate::output;
use consort_protocol::api::{MissionQuery, ReadOptions};
use consort_protocol::ids::{MissionId, TaskId};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{HeldItem, MissionState, Priority};
use consort_protocol::units::{Energy, EnergyLimit};
use consort_protocol::view::{
    MissionBrief, MissionProgress, MissionSummary, MissionView, MissionsView, TaskParticipant, TaskProgress, TaskView,
};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::time::Duration;

/// Show missions and their progress
///
/// In the order of submission: state, finished steps, the estimated energy of all its robots together in
/// per cent of a full battery, role holders, the reason why a mission is still pending, its priority unless
/// it is 0, orders about its roles, its results as far as they are known, and for a mission that needs
/// intervention, the items in each robot's hands and their places. With --watch a line is added for every
/// change, until Ctrl-C. With the name of a mission: also its tasks, with their results.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort missions
  consort missions lab-samples-1
  consort missions --watch
  consort missions --linearizable
  consort missions --json | head -c 2000")]
pub(crate) struct Args {
    /// Only this mission, with its tasks and their results
    #[arg(conflicts_with = "watch")]
    mission: Option<MissionId>,
    /// Keep running, and add a line for every change
    #[arg(long)]
    watch: bool,
    /// Print JSON: the whole list, or the mission; with --watch a line for every change
    #[arg(long)]
    json: bool,
    /// Show everything acknowledged before now, confirmed by a majority of the voters
    ///
    /// Without it the nearest node replies from its own copy of the ledger, which may lag behind.
    #[arg(long)]
    linearizable: bool,
    #[command(flatten)]
    client: ClientFlags,
}

/// Poll interval for changes.
const LOOK: Duration = Duration::from_millis(500);

/// Runs the command.
///
/// # Errors
/// See [`Client::api`].
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    args.client.with_client(async |client| {
        let options = ReadOptions { linearizable: args.linearizable };
        match args.mission {
            Some(mission) => single(client, mission, options, args.json).await,
            None if args.watch => watch(client, options, args.json).await,
            None => once(client, options, args.json).await,
        }
    })
}

async fn list(client: &mut Client, options: ReadOptions) -> Result<Value, Failure> {
    client.api(ApiCall::List, &options).await
}

async fn once(client: &mut Client, options: ReadOptions, in_json: bool) -> Result<(), Failure> {
    let answer = list(client, options).await?;
    if in_json {
        return output::line(&answer);
    }
    let MissionsView { missions } = read_answer(&answer)?;
    if missions.is_empty() {
        return output::line("no missions yet; `consort submit lab-samples` submits a mission");
    }
    output::line(mission_table(missions.iter().map(|mission| row(&mission.brief, mission.pending_reason.as_deref()))))
}

async fn single(
    client: &mut Client,
    mission: MissionId,
    ReadOptions { linearizable }: ReadOptions,
    in_json: bool,
) -> Result<(), Failure> {
    let answer: Value = client.api(ApiCall::Get, &MissionQuery { mission, linearizable }).await?;
    if in_json {
        return output::line(&answer);
    }
    let MissionView { brief, tree, auction, .. } = read_answer(&answer)?;
    let pending_reason = auction.and_then(|auction| auction.failure);
    output::line(mission_table([row(&brief, pending_reason.as_deref())]))?;
    let Some(tree) = tree else {
        return output::line("\nits tasks are no longer stored: it ended long ago");
    };
    let mut rows = vec![["TASK", "TYPE", "STATE", "ROLES", "RESULTS"].map(str::to_owned).to_vec()];
    add_task_rows(&tree, 0, &mut rows);
    output::line(format_args!("\n{}", output::table(&rows)))
}

fn mission_table(rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let heads = ["MISSION", "STATE", "STEPS", "ENERGY", "PARAMETERS", "ROLES", ""].map(str::to_owned).to_vec();
    output::table(&std::iter::once(heads).chain(rows).collect::<Vec<_>>())
}

async fn watch(client: &mut Client, options: ReadOptions, in_json: bool) -> Result<(), Failure> {
    let mut shown: BTreeMap<MissionId, MissionSummary> = BTreeMap::new();
    loop {
        let MissionsView { missions } = read_answer(&list(client, options).await?)?;
        for mission in missions {
            if shown.get(&mission.brief.mission) != Some(&mission) {
                client.progress().clear();
                if in_json {
                    output::json(&mission)?;
                } else {
                    let row = row(&mission.brief, mission.pending_reason.as_deref());
                    output::line(row.join("  ").trim_end())?;
                }
                shown.insert(mission.brief.mission.clone(), mission);
            }
        }
        tokio::time::sleep(LOOK).await;
    }
}

fn row(brief: &MissionBrief, pending_reason: Option<&str>) -> Vec<String> {
    let MissionBrief { mission, status, terms, progress, result, .. } = brief;
    let why = pending_reason.filter(|_| status.detail == MissionState::Pending);
    let why = why.map_or_else(|| detail(&status.detail).trim_start_matches(": ").to_owned(), str::to_owned);
    let result = (!result.is_empty()).then(|| pairs(result));
    let priority = (terms.priority != Priority::default()).then(|| format!("priority {}", terms.priority.get()));
    let is_active = matches!(status.detail, MissionState::Pending | MissionState::Running);
    let orders = progress.orders.iter().filter(|_| is_active).map(|(role, order)| format!("{role} is {order}"));
    vec![
        mission.to_string(),
        status.detail.as_str().replace('_', " "),
        format!("{}/{}", progress.done, progress.steps),
        energy(progress.energy, terms.energy_max),
        pairs(&terms.parameters),
        roles(progress),
        [why]
            .into_iter()
            .filter(|why| !why.is_empty())
            .chain(priority)
            .chain(orders)
            .chain(result)
            .collect::<Vec<_>>()
            .join("; "),
    ]
}

/// Adds a row for a task and for each task below it, indented by their depth in the tree.
fn add_task_rows(task: &TaskView, depth: usize, rows: &mut Vec<Vec<String>>) {
    let name = |task: &TaskId| format!("{:indent$}{task}", "", indent = 2 * depth);
    let word = |state: &TaskProgress| state.as_str().replace('_', " ");
    match task {
        TaskView::Abstract { task, state, children, .. } => {
            rows.push(vec![name(task), "-".to_owned(), word(state)]);
            for child in children {
                add_task_rows(child, depth + 1, rows);
            }
        }
        TaskView::Elementary { task, task_type, state, roles, results, .. } => {
            let roles: Vec<String> = roles.iter().map(participant).collect();
            rows.push(vec![name(task), task_type.to_string(), word(state), roles.join(", "), pairs(results)]);
        }
    }
}

/// Formats a role of a task with its robot: `r1=amber`, or `r1` without a robot.
fn participant(TaskParticipant { role, holder, .. }: &TaskParticipant) -> String {
    holder.as_ref().map_or_else(|| role.to_string(), |robot| format!("{role}={robot}"))
}

/// Formats the robots of a mission: `r1=amber, lab_arm=lab-arm later`.
fn roles(progress: &MissionProgress) -> String {
    let held = progress.holders.iter().map(|(role, robot)| (role, robot.to_string()));
    let promised = progress.promised.iter().map(|(role, robot)| (role, format!("{robot} later")));
    pairs(&held.chain(promised).collect())
}

/// Formats the estimated energy of a mission, with its bound: `3.1 % of 40.0 %`.
fn energy(estimated: Energy, max: Option<EnergyLimit>) -> String {
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let bound = max.map(|max| format!(" of {}", percent(max.get()))).unwrap_or_default();
    format!("{}{bound}", percent(estimated.get()))
}

fn pairs<K: Display, V: Display>(map: &BTreeMap<K, V>) -> String {
    let pairs: Vec<String> = map.iter().map(|(name, value)| format!("{name}={value}")).collect();
    if pairs.is_empty() { "-".to_owned() } else { pairs.join(", ") }
}

/// Formats the last known places of items: `sample with amber (r1) at IC Room 6, not certain`.
fn last_known_places(items: &[HeldItem]) -> String {
    let line = |HeldItem { item, role, robot, place, certain }: &HeldItem| {
        let place = place.as_ref().map(|place| format!(" at {place}")).unwrap_or_default();
        format!("{item} with {robot} ({role}){place}{}", if *certain { "" } else { ", not certain" })
    };
    items.iter().map(line).collect::<Vec<_>>().join("; ")
}

/// Formats the details of a mission's state, as `: cause`.
pub(super) fn detail(state: &MissionState) -> String {
    match state {
        MissionState::Pending | MissionState::Running | MissionState::Completed => String::new(),
        MissionState::Failed { cause, class } => format!(": {cause}; class {class}"),
        MissionState::Canceled { by } => format!(": by {by}"),
        MissionState::NeedsIntervention { cause, items, class } => {
            format!(": {cause}; class {class}; {}", last_known_places(items))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_tasks_of_a_mission_are_indented_and_have_their_results() {
        let task = |name: &str, state: &str, holder: Option<&str>, results: Value| {
            json!({ "kind": "elementary", "task": name, "type": "measure_vital_signs", "parameters": {}, "state": state,
                "roles": [{ "role": "r1", "holder": holder }], "results": results })
        };
        let inner = json!({ "kind": "abstract", "task": "again", "order": "sequential", "state": "under_way",
            "children": [task("second", "under_way", None, json!({}))] });
        let first = task("first", "done", Some("ada"), json!({ "fever": false, "pulse_bpm": 72 }));
        let all = json!({ "kind": "abstract", "task": "all", "order": "sequential", "state": "under_way",
            "children": [first, inner] });
        let mut rows = vec![];
        add_task_rows(&serde_json::from_value(all).unwrap(), 0, &mut rows);
        let expected: [&[&str]; 4] = [
            &["all", "-", "under way"],
            &["  first", "measure_vital_signs", "done", "r1=ada", "fever=false, pulse_bpm=72"],
            &["  again", "-", "under way"],
            &["    second", "measure_vital_signs", "under way", "r1", "-"],
        ];
        assert_eq!(rows, expected);
    }

    #[test]
    fn a_mission_shows_its_known_results_in_every_state() {
        let shown = |detail: Value, result: Value, pending_reason: Option<&str>| {
            let mission = json!({ "mission": "watch-1", "detail": detail, "result": result });
            row(&serde_json::from_value(mission).unwrap(), pending_reason).pop().unwrap()
        };
        let fever = json!({ "fever": true });
        assert_eq!(shown(json!("completed"), fever.clone(), None), "fever=true");
        assert_eq!(shown(json!("running"), fever.clone(), Some("no viable bid")), "fever=true");
        assert_eq!(shown(json!("pending"), fever.clone(), Some("no viable bid")), "no viable bid; fever=true");
        let failed = json!({ "failed": { "cause": "no cuff", "class": "task" } });
        assert_eq!(shown(failed, fever, None), "no cuff; class task; fever=true");
        assert_eq!(shown(json!("running"), json!({}), None), "");
    }
}
