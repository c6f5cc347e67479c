//! The requests that change nothing: any node answers them from what it sees.

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

/// How long a node waits for a mission that it has not heard of: what was just acknowledged may be on its way to it.
const ON_ITS_WAY: Duration = Duration::from_millis(500);

/// How often it looks meanwhile.
const LOOK_AGAIN: Duration = Duration::from_millis(25);

impl ViewService {
    /// Answers a request.
    pub(super) async fn answer_request(&self, call: ApiCall, payload: &[u8]) -> Value {
        let answer = match call {
            ApiCall::List => {
                self.view(&Key::ViewMissions).await.ok_or_else(|| refusal("nothing is known of missions".to_owned()))
            }
            ApiCall::Get => match api_types::parse_request(call, payload) {
                Ok(MissionQuery { mission }) => self.mission(&mission).await,
                Err(problem) => Err(refusal(problem)),
            },
            ApiCall::Explain => match api_types::parse_request(call, payload) {
                Ok(MissionQuery { mission }) => self.explain(&mission).await,
                Err(problem) => Err(refusal(problem)),
            },
            ApiCall::Help => Ok(api_types::help()),
            ApiCall::Submit | ApiCall::Cancel | ApiCall::Resolve | ApiCall::Backup | ApiCall::Upgrade => {
                Err(refusal(format!("{} is the coordinator's", call.as_str())))
            }
        };
        answer.unwrap_or_else(|refusal| refusal)
    }

    async fn view(&self, key: &Key) -> Option<Value> {
        let text = self.views.keys.write(key);
        let mut all = self.requested_views(keyexpr::new(text.as_str()).ok()?).await;
        all.pop().map(|(_, value)| value)
    }

    /// A mission, or why it cannot be shown: where no keeper of the ledger is heard, there may be such a mission all the same,
    /// and it may be asked for again.
    async fn mission(&self, mission: &MissionId) -> Result<Value, Value> {
        let key = Key::ViewMission(mission.clone());
        let until = Instant::now() + ON_ITS_WAY;
        loop {
            if let Some(found) = self.view(&key).await {
                return Ok(found);
            }
            let standing = self.context().await.status;
            // The coordinator knows all there are.
            if standing.coordinator.as_ref() == Some(&self.views.node) || Instant::now() >= until {
                let missions = self.view(&Key::ViewMissions).await;
                let unheard = missions.filter(|view| view.get("retry_after_ms").is_some());
                return Err(unheard.unwrap_or_else(|| {
                    refusal(format!(
                        "no mission {mission} is known at {}; api/list has those there are",
                        self.views.node
                    ))
                }));
            }
            tokio::time::sleep(LOOK_AGAIN).await;
        }
    }

    async fn explain(&self, mission: &MissionId) -> Result<Value, Value> {
        let seen = self.mission(mission).await?;
        let record: Option<AuctionRecord> = serde_json::from_value(seen["auction"].clone()).ok();
        let explanation = record.as_ref().map(explain);
        let asked: BTreeSet<NodeId> =
            record.iter().flat_map(|record| &record.entries).map(|entry| NodeId::from(entry.robot.clone())).collect();
        let others = self.not_asked(&asked).await;
        let state = seen["state"].as_str().unwrap_or("unknown").to_owned();
        let releases: Vec<String> = seen["releases"].as_array().into_iter().flatten().map(release).collect();
        let words = words(mission, &state, explanation.as_ref(), &others, &releases);
        let mut answer = json!({
            "mission": mission,
            "state": state,
            "explanation": explanation,
            "not_asked": others.iter().map(|(robot, why)| json!({ "robot": robot, "why": why })).collect::<Vec<_>>(),
            "releases": seen["releases"],
            "words": words,
        });
        for mark in ["seen_by", "age_ms", "coordinator", "term", "at_ms", "version"] {
            answer[mark] = seen[mark].clone();
        }
        Ok(answer)
    }

    /// Robots that the auction has no answer of, and why they are no members, as far as this node can tell now.
    async fn not_asked(&self, asked: &BTreeSet<NodeId>) -> Vec<(NodeId, String)> {
        let Some(seen) = self.view(&Key::ViewEnsembles).await else { return vec![] };
        let robots: BTreeSet<NodeId> = self.views.knowledge.read(|base| {
            let robots = base.iter().filter(|(_, heard)| heard.record.knowledge.robot.is_some());
            robots.map(|(node, _)| node.clone()).filter(|node| !asked.contains(node)).collect()
        });
        let ensemble = &seen["ensembles"][0];
        let why = |robot: NodeId| {
            let why = match ensemble["not_members"][robot.as_str()].as_str() {
                Some(reason) => {
                    format!("{robot} was not asked; it is not a member of {}: {reason}", words_of(ensemble))
                }
                None => format!("{robot} was not asked; it became a member of {} later", words_of(ensemble)),
            };
            (robot, why)
        };
        robots.into_iter().map(why).collect()
    }
}

fn refusal(problem: String) -> Value {
    json!({ "error": problem })
}

fn words_of(ensemble: &Value) -> &str {
    ensemble["name"].as_str().unwrap_or("the ensemble")
}

fn release(released: &Value) -> String {
    let text = |key: &str| released[key].as_str().unwrap_or("?").to_owned();
    let again = if released["blamed"] == true { ", and it is not asked for it again" } else { "" };
    format!("{} was taken from {}: {}{again}", text("role"), text("robot"), text("cause"))
}

/// The whole in sentences, one a line.
fn words(
    mission: &MissionId,
    state: &str,
    explanation: Option<&Explanation>,
    others: &[(NodeId, String)],
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
        lines.push(count(omitted, "more answer was not kept", "more answers were not kept"));
    }
    lines.extend(others.iter().map(|(_, why)| why.clone()));
    lines.extend(releases.iter().cloned());
    lines
}
