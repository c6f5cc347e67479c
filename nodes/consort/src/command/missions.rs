//! `consort missions`: lists missions and their progress.

use crate::client::{Client, ClientFlags, read_answer};
use crate::exit::Failure;
use crate::output;
use consort_protocol::api::ReadOptions;
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{HeldItem, MissionState};
use consort_protocol::units::{Energy, EnergyLimit};
use consort_protocol::view::{MissionBrief, MissionProgress, MissionSummary, MissionsView};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::time::Duration;

/// Show missions and their progress
///
/// In the order of submission: state, finished steps, the estimated energy of all its robots together in
/// per cent of a full battery, role holders, the reason why a mission is
/// still pending, and for a mission that needs intervention, the items in each robot's hands and
/// their places. With --watch a line is added for every change, until Ctrl-C.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort missions
  consort missions --watch
  consort missions --linearizable
  consort missions --json | head -c 2000")]
pub(crate) struct Args {
    /// Keep running, and add a line for every change
    #[arg(long)]
    watch: bool,
    /// Print JSON: the whole list; with --watch a line for every change
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
        if args.watch { watch(client, options, args.json).await } else { once(client, options, args.json).await }
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
    let heads = ["MISSION", "STATE", "STEPS", "ENERGY", "PARAMETERS", "ROLES", ""].map(str::to_owned).to_vec();
    let rows: Vec<Vec<String>> = std::iter::once(heads).chain(missions.iter().map(row)).collect();
    output::line(output::table(&rows))
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
                    output::line(row(&mission).join("  ").trim_end())?;
                }
                shown.insert(mission.brief.mission.clone(), mission);
            }
        }
        tokio::time::sleep(LOOK).await;
    }
}

fn row(mission: &MissionSummary) -> Vec<String> {
    let MissionSummary { brief: MissionBrief { mission, status, terms, progress, result, .. }, pending_reason } =
        mission;
    let why = pending_reason.clone().filter(|_| status.detail == MissionState::Pending);
    vec![
        mission.to_string(),
        status.detail.as_str().replace('_', " "),
        format!("{}/{}", progress.done, progress.steps),
        energy(progress.energy, terms.energy_max),
        pairs(&terms.parameters),
        roles(progress),
        match why {
            Some(why) => why,
            None if status.detail == MissionState::Completed && !result.is_empty() => pairs(result),
            None => detail(&status.detail).trim_start_matches(": ").to_owned(),
        },
    ]
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
        MissionState::Failed { cause } => format!(": {cause}"),
        MissionState::Canceled { by } => format!(": by {by}"),
        MissionState::NeedsIntervention { cause, items } => format!(": {cause}, {}", last_known_places(items)),
    }
}
