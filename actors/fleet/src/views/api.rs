//! Read-only requests, served by any node.

use super::ViewService;
use crate::api_types::{self, MissionQuery};
use consort_protocol::auction::{AuctionRecord, Explanation, explain};
use consort_protocol::count::count;
use consort_protocol::ids::{MissionId, NodeId};
use consort_protocol::keys::{ApiCall, Key};
use serde_json::{Value, json};
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
            ApiCall::List => {
                self.view(&Key::ViewMissions).await.ok_or_else(|| error_reply("missions are unknown".to_owned()))
            }
            ApiCall::Get => match api_types::parse_request(call, payload) {
                Ok(MissionQuery { mission }) => self.mission(&mission).await,
                Err(problem) => Err(error_reply(problem)),
            },
            ApiCall::Explain => match api_types::parse_request(call, payload) {
                Ok(MissionQuery { mission }) => self.explain(&mission).await,
                Err(problem) => Err(error_reply(problem)),
            },
            ApiCall::Help => Ok(api_types::help()),
            ApiCall::Submit | ApiCall::Cancel | ApiCall::Resolve | ApiCall::Backup | ApiCall::Upgrade => {
                Err(error_reply(format!("{} is served by the coordinator only", call.as_str())))
            }
        };
        reply.unwrap_or_else(|error| error)
    }

    async fn view(&self, key: &Key) -> Option<Value> {
        let text = self.views.keys.write(key);
        let mut all = self.requested_views(keyexpr::new(text.as_str()).ok()?).await;
        all.pop().map(|(_, value)| value)
    }

    /// Returns a mission, or an error. If no voter is reachable, the mission may exist all the
    /// same, and the error allows a retry.
    async fn mission(&self, mission: &MissionId) -> Result<Value, Value> {
        let key = Key::ViewMission(mission.clone());
        let deadline = Instant::now() + MISSION_WAIT;
        loop {
            if let Some(found) = self.view(&key).await {
                return Ok(found);
            }
            let status = self.context().await.status;
            // The coordinator has all missions.
            if status.coordinator.as_ref() == Some(&self.views.node) || Instant::now() >= deadline {
                let missions = self.view(&Key::ViewMissions).await;
                let unavailable = missions.filter(|view| view.get("retry_after_ms").is_some());
                return Err(unavailable.unwrap_or_else(|| {
                    error_reply(format!("no mission {mission} is known at {}; see api/list", self.views.node))
                }));
            }
            tokio::time::sleep(POLL_INTERVAL).await;
        }
    }

    async fn explain(&self, mission: &MissionId) -> Result<Value, Value> {
        let view = self.mission(mission).await?;
        let record: Option<AuctionRecord> = serde_json::from_value(view["auction"].clone()).ok();
        let explanation = record.as_ref().map(explain);
        let asked: BTreeSet<NodeId> =
            record.iter().flat_map(|record| &record.entries).map(|entry| NodeId::from(entry.robot.clone())).collect();
        let uninvited = self.not_asked(&asked).await;
        let state = view["state"].as_str().unwrap_or("unknown").to_owned();
        let releases: Vec<String> = view["releases"].as_array().into_iter().flatten().map(release_text).collect();
        let text = text(mission, &state, explanation.as_ref(), &uninvited, &releases);
        let mut reply = json!({
            "mission": mission,
            "state": state,
            "explanation": explanation,
            "not_asked": uninvited.iter().map(|(robot, why)| json!({ "robot": robot, "why": why })).collect::<Vec<_>>(),
            "releases": view["releases"],
            "text": text,
        });
        for field in ["seen_by", "age_ms", "coordinator", "term", "at_ms", "version"] {
            reply[field] = view[field].clone();
        }
        Ok(reply)
    }

    /// Returns the robots without a bid response in the auction, with the reason they are not
    /// members, as far as this node can determine now.
    async fn not_asked(&self, asked: &BTreeSet<NodeId>) -> Vec<(NodeId, String)> {
        let Some(seen) = self.view(&Key::ViewEnsembles).await else { return vec![] };
        let robots: BTreeSet<NodeId> = self.views.knowledge.read(|base| {
            let robots = base.iter().filter(|(_, stored)| stored.record.knowledge.robot.is_some());
            robots.map(|(node, _)| node.clone()).filter(|node| !asked.contains(node)).collect()
        });
        let ensemble = &seen["ensembles"][0];
        let why = |robot: NodeId| {
            let why = match ensemble["not_members"][robot.as_str()].as_str() {
                Some(reason) => {
                    format!("{robot} was not asked; it is not a member of {}: {reason}", ensemble_name(ensemble))
                }
                None => format!("{robot} was not asked; it became a member of {} later", ensemble_name(ensemble)),
            };
            (robot, why)
        };
        robots.into_iter().map(why).collect()
    }
}

fn error_reply(problem: String) -> Value {
    json!({ "error": problem })
}

fn ensemble_name(ensemble: &Value) -> &str {
    ensemble["name"].as_str().unwrap_or("the ensemble")
}

fn release_text(released: &Value) -> String {
    let text = |key: &str| released[key].as_str().unwrap_or("?").to_owned();
    let again = if released["robot_failed"] == true { ", and it is not asked for it again" } else { "" };
    format!("{} was taken from {}: {}{again}", text("role"), text("robot"), text("cause"))
}

/// Returns the explanation as text, with 1 entry per line.
fn text(
    mission: &MissionId,
    state: &str,
    explanation: Option<&Explanation>,
    uninvited: &[(NodeId, String)],
    releases: &[String],
) -> Vec<String> {
    let mut lines = vec![match explanation {
        Some(explanation) => format!("{mission} is {}; auction {}:", state.replace('_', " "), explanation.round),
        None => format!("{mission} is {}; no auction was held for it yet", state.replace('_', " ")),
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
    lines.extend(uninvited.iter().map(|(_, why)| why.clone()));
    lines.extend(releases.iter().cloned());
    lines
}
