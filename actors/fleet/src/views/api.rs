//! Read-only requests, served by any node.

use super::ViewService;
use super::draw::json;
use super::linearizable::retry;
use super::mission::time_text;
use crate::api_help;
use consort_protocol::api::{
    ErrorReply, ExplainReply, MissionQuery, ReadOptions, UninvitedRobot, parse_read_options, parse_request,
};
use consort_protocol::auction::{AuctionEntry, Explanation, RoleOfMission, explain};
use consort_protocol::ids::{EnsembleId, MissionId, NodeId};
use consort_protocol::keys::{ApiCall, Key};
use consort_protocol::ledger::{MissionState, RoleRelease};
use consort_protocol::view::{
    EnsembleView, EnsemblesView, MissionBrief, MissionView, PromiseView, RoleView, WithProvenance,
};
use consort_text::count;
use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::time::Instant;
use zenoh_keyexpr::keyexpr;

/// Time for which a node waits for an unknown mission: an acknowledged mission may not have arrived
/// yet.
const MISSION_WAIT: Duration = Duration::from_millis(500);

/// Polling interval meanwhile.
const POLL_INTERVAL: Duration = Duration::from_millis(25);

impl ViewService {
    /// Returns the reply to a request.
    pub(super) async fn answer_request(&self, call: ApiCall, payload: &[u8]) -> Value {
        let reply = match call {
            ApiCall::List => self.list(call, payload, &Key::ViewMissions).await,
            ApiCall::Requests => self.list(call, payload, &Key::ViewRequests).await,
            ApiCall::Schedules => self.list(call, payload, &Key::ViewSchedules).await,
            ApiCall::Audit => self.list(call, payload, &Key::ViewAudit).await,
            ApiCall::Get => match parse_request(call, payload) {
                Ok(query) => self.mission(&query).await,
                Err(problem) => Err(error_reply(problem.to_string())),
            },
            ApiCall::Explain => match parse_request(call, payload) {
                Ok(query) => self.explain(&query).await,
                Err(problem) => Err(error_reply(problem.to_string())),
            },
            ApiCall::Help => Ok(json(api_help::help())),
            ApiCall::Submit
            | ApiCall::Cancel
            | ApiCall::CancelMissions
            | ApiCall::Priority
            | ApiCall::Reassign
            | ApiCall::Resolve
            | ApiCall::Answer
            | ApiCall::Schedule
            | ApiCall::Hold
            | ApiCall::Release
            | ApiCall::Maintenance
            | ApiCall::Close
            | ApiCall::Open
            | ApiCall::Limit
            | ApiCall::Alarm
            | ApiCall::Backup
            | ApiCall::Upgrade => Err(error_reply(format!("{} is served by the coordinator only", call.as_str()))),
        };
        reply.unwrap_or_else(|error| error)
    }

    /// Returns a view of the whole ledger, or an error.
    async fn list(&self, call: ApiCall, payload: &[u8], key: &Key) -> Result<Value, Value> {
        match parse_read_options(call, payload) {
            Ok(ReadOptions { linearizable: true }) => self.linearizable_view(key).await,
            Ok(ReadOptions { linearizable: false }) => {
                self.view(key).await.ok_or_else(|| error_reply("missions are unknown"))
            }
            Err(problem) => Err(error_reply(problem.to_string())),
        }
    }

    async fn view(&self, key: &Key) -> Option<Value> {
        let text = self.views.keys.write(key);
        let mut all = self.requested_views(keyexpr::new(text.as_str()).ok()?).await;
        all.pop().map(|(_, value)| value)
    }

    /// Returns a mission, or an error. The error allows a retry unless a node with a copy of the ledger
    /// lacks the mission and a coordinator is known.
    async fn mission(&self, MissionQuery { mission, linearizable }: &MissionQuery) -> Result<Value, Value> {
        let key = Key::ViewMission(mission.clone());
        if *linearizable {
            return self.linearizable_view(&key).await;
        }
        let deadline = Instant::now() + MISSION_WAIT;
        loop {
            let unavailable = match self.view(&key).await {
                Some(view) if view.get("retry_after_ms").is_none() => return Ok(view),
                unavailable => unavailable,
            };
            let coordinator = self.context().await.status.coordinator;
            // The coordinator has all missions.
            if coordinator.as_ref() == Some(&self.views.node) || Instant::now() >= deadline {
                return Err(unavailable.unwrap_or_else(|| match coordinator {
                    Some(_) => unknown_mission(mission, &self.views.node),
                    None => retry("no coordinator yet"),
                }));
            }
            tokio::time::sleep(POLL_INTERVAL).await;
        }
    }

    async fn explain(&self, query: &MissionQuery) -> Result<Value, Value> {
        let (mission, view) = (&query.mission, self.mission(query).await?);
        let read = WithProvenance::<MissionView>::deserialize(&view);
        let WithProvenance { provenance, content: view } =
            read.map_err(|problem| error_reply(format!("mission {mission} cannot be read: {problem}")))?;
        if view.tasks.is_empty() {
            let state = view.brief.status.detail.as_str();
            let problem =
                format!("mission {mission} is {state}; it ended long ago, and its auctions are no longer stored");
            return Err(error_reply(problem));
        }
        let explanation = view.auction.as_ref().map(explain);
        let entries = view.auction.iter().flat_map(|record| &record.entries);
        let recorded: BTreeSet<NodeId> = entries.flat_map(AuctionEntry::robots).cloned().map(NodeId::from).collect();
        let MissionView { brief, releases, ensembles, roles, .. } = view;
        let has_omitted = explanation.as_ref().is_some_and(|explanation| explanation.omitted > 0);
        let not_asked = self.not_recorded(&recorded, &ensembles, has_omitted).await;
        let mut text = text(mission, &brief.status.detail, explanation.as_ref(), &not_asked, &releases);
        text.extend(roles.iter().filter_map(promise_text));
        text.extend(energy_text(&brief));
        let content =
            ExplainReply { mission: brief.mission, state: brief.status.state, explanation, not_asked, releases, text };
        Ok(json(WithProvenance { provenance, content }))
    }

    /// Returns the robots that are not in the record of the auction, with the reason they are not
    /// members, as far as this node can determine now. With `has_omitted` the record lacks some robots.
    async fn not_recorded(
        &self,
        recorded: &BTreeSet<NodeId>,
        called: &[EnsembleId],
        has_omitted: bool,
    ) -> Vec<UninvitedRobot> {
        let seen = self.view(&Key::ViewEnsembles).await;
        let mut ensembles = seen.and_then(|seen| EnsemblesView::deserialize(seen).ok()).unwrap_or_default().ensembles;
        ensembles.retain(|ensemble| called.is_empty() || called.contains(&ensemble.name));
        let robots = self.views.robot_nodes().into_iter().filter(|node| !recorded.contains(node));
        let uninvited = |robot: NodeId| {
            let joined = ensembles.iter().find(|ensemble| ensemble.members.contains(&robot));
            let why = match joined {
                Some(EnsembleView { name, .. }) if has_omitted => {
                    format!("the stored record lacks {robot}: it was left out, or it became a member of {name} later")
                }
                Some(EnsembleView { name, .. }) => format!("{robot} was not asked; it became a member of {name} later"),
                None => {
                    let reason = |ensemble: &EnsembleView| {
                        let reason = ensemble.not_members.get(&robot).map_or("no record received", String::as_str);
                        format!("{}: {reason}", ensemble.name)
                    };
                    let reasons = ensembles.iter().map(reason).collect::<Vec<_>>().join("; ");
                    format!("{robot} was not asked; it is not a member of {reasons}")
                }
            };
            UninvitedRobot { robot, why }
        };
        robots.map(uninvited).collect()
    }
}

/// Returns the error of a node whose copy of the ledger lacks the mission.
pub(super) fn unknown_mission(mission: &MissionId, node: &NodeId) -> Value {
    error_reply(format!("no mission {mission} is known at {node}; see api/list"))
}

fn error_reply(problem: impl Into<String>) -> Value {
    json(ErrorReply::rejected(problem))
}

fn release_text(release: &RoleRelease) -> String {
    let RoleRelease { role, robot, cause, .. } = release;
    let again = if release.excludes_robot() { ", and it is not asked for it again" } else { "" };
    format!("{role} was taken from {robot}: {cause}{again}")
}

/// Returns a text like `arm is promised to gorse, which is free for it at about 2026-11-27T14:05:00Z, after r1 of m-1`.
fn promise_text(RoleView { role, holder, promise, .. }: &RoleView) -> Option<String> {
    let (robot, PromiseView { planned_at_ms, can_start, after, charging, .. }) = (holder.as_ref()?, promise.as_ref()?);
    let at = time_text(*planned_at_ms)?;
    let after: Vec<String> =
        after.iter().map(|RoleOfMission { mission, role }| format!("{role} of {mission}")).collect();
    let charging = charging.iter().map(|stop| format!("charging at {}", stop.charger));
    let after: Vec<String> = after.into_iter().chain(charging).collect();
    let after = if after.is_empty() { String::new() } else { format!(", after {}", after.join(", ")) };
    let wait = if *can_start { "" } else { "; the role waits for other roles" };
    Some(format!("{role} is promised to {robot}, which is free for it at about {at}{after}{wait}"))
}

/// Returns the energy of a mission that has a bound on it.
fn energy_text(brief: &MissionBrief) -> Option<String> {
    let limit = brief.terms.energy_max?;
    Some(format!(
        "its awards are estimated at {:.3} of a full battery; energy_max is {limit:.3}",
        brief.progress.energy
    ))
}

/// Returns the explanation as text, with 1 entry per line.
fn text(
    mission: &MissionId,
    state: &MissionState,
    explanation: Option<&Explanation>,
    uninvited: &[UninvitedRobot],
    releases: &[RoleRelease],
) -> Vec<String> {
    let state = state.as_str().replace('_', " ");
    let mut lines = vec![match explanation {
        Some(explanation) => {
            // While a mission waits, its latest auctions may not be stored.
            let has_result = explanation.roles.iter().any(|role| role.winner.is_some());
            let at = time_text(explanation.at_ms).filter(|_| !has_result).map(|at| format!(" at {at}"));
            format!("{mission} is {state}; auction {}{}:", explanation.round, at.unwrap_or_default())
        }
        None => format!("{mission} is {state}; no auction was held for it yet"),
    }];
    for role in explanation.iter().flat_map(|explanation| &explanation.roles) {
        lines.push(format!("{}: {}", role.role, role.why));
        for robot in &role.robots {
            lines.push(format!("  {}", robot.why));
            lines.extend(robot.parts_text().map(|parts| format!("    {parts}")));
        }
    }
    if let Some(omitted) = explanation.map(|explanation| explanation.omitted).filter(|omitted| *omitted > 0) {
        lines.push(count(omitted, "more response was not stored", "more responses were not stored"));
    }
    lines.extend(uninvited.iter().map(|robot| robot.why.clone()));
    lines.extend(releases.iter().map(release_text));
    lines
}
