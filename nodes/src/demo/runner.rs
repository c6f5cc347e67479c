//! The play: wait for a coordinator, submit, kill the coordinator on the way, wait for the end, look where the samples are.

use super::fleet::DemoFleet;
use super::reporter::DemoReporter;
use super::scenario::DemoScenario;
use crate::dashboard::Dashboard;
use crate::exit::Failure;
use crate::query::{QueryError, QueryTarget, query_once};
use crate::{extensions, inputs};
use consort_actors::bus::{Sample, Stream};
use consort_protocol::count::count;
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::{MissionId, NodeId};
use consort_protocol::keys::{ApiCall, Key, Keys};
use consort_protocol::ledger::MissionState;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;

/// How long the fleet may take to meet and elect a coordinator.
const ELECTION_LIMIT: Duration = Duration::from_secs(60);

/// How long one query may take.
const QUERY_LIMIT: Duration = Duration::from_secs(2);

/// How long a killed node stays down after the takeover, as under a service manager with a restart delay.
const RESTART_AFTER: Duration = Duration::from_secs(2);

/// What is to be played.
pub(super) struct DemoOptions {
    /// Whether the coordinator is killed.
    pub(super) kill: bool,
    /// Whether the fleet stays up after the summary.
    pub(super) keep_running: bool,
    /// The mission to submit, as the API takes it: a name, or a whole file.
    pub(super) mission: Value,
}

/// Plays a demo on a stage.
pub(super) struct DemoRunner<S> {
    plan: DemoOptions,
    cast: DemoScenario,
    stage: S,
    narrator: DemoReporter,
    keys: Keys,
    coordinator: Option<NodeId>,
    /// When and whom.
    killed: Option<(Duration, NodeId)>,
    takeover: Option<(Duration, NodeId, Duration)>,
    restarted: bool,
    missions: BTreeMap<MissionId, Fate>,
    /// What is served for people to look in, as long as the demo is played.
    dashboard: Option<Dashboard>,
}

/// How a mission fares.
struct Fate {
    room: String,
    submitted: Duration,
    award_ms: Option<f64>,
    holders: String,
    auctions: u32,
    end: Option<(Duration, MissionState)>,
}

/// The mission that a flag names, as the API takes it: checked before anything is started.
///
/// # Errors
/// [`Failure::Usage`] says what is wrong with it, or which are shipped.
pub(super) fn mission_request(text: &str) -> Result<Value, Failure> {
    let template = inputs::mission(text).map_err(|problems| Failure::Usage(format!("--mission {problems}")))?;
    if !template.parameters().contains_key("room") {
        return Err(Failure::Usage(format!(
            "--mission {text}: it has no parameter `room`, which the demo gives each mission"
        )));
    }
    let room = BTreeMap::from([("room".to_owned(), "IC Room 6".to_owned())]);
    template
        .instantiate(&room, &extensions::domain())
        .map_err(|problem| Failure::Usage(format!("--mission {text}: {problem}")))?;
    Ok(inputs::mission_request(text)?)
}

impl<S: DemoFleet> DemoRunner<S> {
    pub(super) fn new(
        plan: DemoOptions,
        cast: DemoScenario,
        stage: S,
        narrator: DemoReporter,
        dashboard: Option<Dashboard>,
    ) -> DemoRunner<S> {
        let keys = Keys::new(&cast.fleet.name);
        DemoRunner {
            plan,
            cast,
            stage,
            narrator,
            keys,
            coordinator: None,
            killed: None,
            takeover: None,
            restarted: false,
            missions: BTreeMap::new(),
            dashboard,
        }
    }

    /// Plays it from beginning to end, and ends the stage whatever happens.
    ///
    /// # Errors
    /// [`Failure`] unless every sample ends up in the laboratory.
    pub(super) async fn run(mut self) -> Result<(), Failure> {
        let mut outcome = self.acts().await;
        if outcome.is_ok() && self.plan.keep_running {
            let at = self.stage.elapsed();
            let words = "the fleet stays up until Ctrl-C";
            outcome = self.narrator.demo_event(at, "running", words, json!({ "event": "demo_keeps_running" }));
            self.stage.interrupted().await;
        }
        self.stage.shut_down().await;
        outcome
    }

    async fn acts(&mut self) -> Result<(), Failure> {
        let bus = self.stage.bus();
        let mut events = bus
            .subscribe(&self.keys.any_events())
            .await
            .map_err(|problem| Failure::Unreachable(problem.to_string()))?;
        self.narrator.begin(&self.stage.description())?;
        if let Some(dashboard) = &self.dashboard {
            let (at, url) = (self.stage.elapsed(), dashboard.url());
            self.narrator.demo_event(at, "dashboard", &url, json!({ "event": "demo_dashboard", "url": url }))?;
        }
        self.await_coordinator(&mut events).await?;
        self.submit_all(&mut events).await?;
        self.watch(&mut events).await?;
        self.conclude().await
    }

    async fn await_coordinator(&mut self, events: &mut Stream<Sample>) -> Result<(), Failure> {
        let deadline = self.stage.elapsed() + ELECTION_LIMIT;
        while self.coordinator.is_none() {
            if self.stage.elapsed() >= deadline {
                let voters = count(self.cast.voters().len(), "node", "nodes");
                let words = format!("nobody coordinates after {ELECTION_LIMIT:?}, though {voters} may");
                return Err(Failure::Unreachable(words));
            }
            self.listen(events, Duration::from_millis(100)).await?;
            if let Some(view) = self.look(&Key::ViewCoordinator).await {
                self.coordinator = view["node"].as_str().and_then(|node| node.parse().ok());
            }
        }
        Ok(())
    }

    async fn submit_all(&mut self, events: &mut Stream<Sample>) -> Result<(), Failure> {
        for request in self.cast.requests.clone() {
            let asked = json!({
                "mission": self.plan.mission,
                "parameters": { "room": request.room },
                "request": request.request,
            });
            let deadline = self.stage.elapsed() + ELECTION_LIMIT;
            let mission: MissionId = loop {
                let problem = match self.ask(&Key::Api(ApiCall::Submit), &asked.to_string(), QueryTarget::All).await {
                    Ok(answer) => match answer["mission"].as_str().and_then(|id| id.parse().ok()) {
                        Some(mission) => break mission,
                        None => "an answer without a mission".to_owned(),
                    },
                    Err(QueryError::Rejected(problem) | QueryError::Retryable(problem, _)) => problem,
                    Err(QueryError::NoReply) => "nobody answered".to_owned(),
                };
                if self.stage.elapsed() >= deadline {
                    return Err(Failure::Unsuccessful(format!("{} was not acknowledged: {problem}", request.request)));
                }
                self.listen(events, Duration::from_millis(200)).await?;
            };
            let (submitted, room) = (self.stage.elapsed(), request.room.to_string());
            let fate = Fate { room, submitted, award_ms: None, holders: String::new(), auctions: 0, end: None };
            self.missions.entry(mission).or_insert(fate);
        }
        Ok(())
    }

    /// Follows the fleet until all missions have ended.
    async fn watch(&mut self, events: &mut Stream<Sample>) -> Result<(), Failure> {
        let arms = self.cast.robots.iter().filter(|robot| robot.speed_mps.is_none()).count().max(1);
        let rounds = u32::try_from(self.cast.requests.len().div_ceil(arms)).unwrap_or(u32::MAX);
        // Ten minutes of world time for each mission, and a minute for what is not driving.
        let each = Duration::from_secs_f64(600.0 / self.cast.world.speed);
        let deadline = self.stage.elapsed() + Duration::from_secs(60) + each * rounds;
        while self.missions.values().any(|fate| fate.end.is_none()) {
            if self.stage.elapsed() >= deadline {
                return Err(Failure::Unsuccessful(format!(
                    "not all missions have ended after {:.0} s",
                    deadline.as_secs_f64()
                )));
            }
            self.listen(events, Duration::from_millis(500)).await?;
            self.catch_up().await;
        }
        // What is still under way belongs to the story too.
        self.listen(events, Duration::from_millis(300)).await
    }

    /// Takes in events for a while.
    async fn listen(&mut self, events: &mut Stream<Sample>, time: Duration) -> Result<(), Failure> {
        let until = tokio::time::Instant::now() + time;
        loop {
            if let Some(trouble) = self.stage.unexpected_exit() {
                return Err(Failure::Unsuccessful(trouble));
            }
            let sample = tokio::select! {
                biased;
                sample = events.recv() => sample,
                () = self.stage.interrupted() => return Err(Failure::Interrupted),
                () = tokio::time::sleep_until(until) => return self.restart_the_killed().await,
            };
            let Some(sample) = sample else { return Err(Failure::Unreachable("the bus was closed".to_owned())) };
            match serde_json::from_slice::<Event>(&sample.payload) {
                Ok(event) => self.take_in(&event).await?,
                Err(problem) => tracing::warn!(%problem, "an event that cannot be read"),
            }
        }
    }

    async fn take_in(&mut self, event: &Event) -> Result<(), Failure> {
        let at = self.stage.elapsed();
        self.narrator.event(at, event)?;
        match &event.kind {
            EventKind::Elected { .. } => {
                self.coordinator = Some(event.node.clone());
                self.note_takeover(at, &event.node)?;
            }
            EventKind::Called { mission, .. } => {
                if let Some(fate) = self.missions.get_mut(mission) {
                    fate.auctions += 1;
                }
            }
            EventKind::Awarded { mission, after_ms, .. } => {
                if let Some(fate) = self.missions.get_mut(mission) {
                    fate.award_ms = fate.award_ms.or(*after_ms);
                }
            }
            EventKind::Mission { mission, state, .. } if state.is_final() => {
                if let Some(fate) = self.missions.get_mut(mission) {
                    fate.end.get_or_insert((at, state.clone()));
                }
            }
            // The mission runs and its robots are under way: now.
            EventKind::TaskEnded { .. } if self.plan.kill && self.killed.is_none() => self.kill().await?,
            _ => {}
        }
        Ok(())
    }

    async fn kill(&mut self) -> Result<(), Failure> {
        let Some(victim) = self.coordinator.clone() else { return Ok(()) };
        let at = self.stage.elapsed();
        self.killed = Some((at, victim.clone()));
        let words = format!("SIGKILL to {victim}, the coordinator");
        self.narrator.demo_event(at, "KILL", &words, json!({ "event": "demo_killed", "node": victim }))?;
        self.stage.kill(&victim).await
    }

    fn note_takeover(&mut self, at: Duration, node: &NodeId) -> Result<(), Failure> {
        let Some((killed_at, victim)) = &self.killed else { return Ok(()) };
        if self.takeover.is_some() || node == victim {
            return Ok(());
        }
        let took = at.saturating_sub(*killed_at);
        let ms = took.as_secs_f64() * 1000.0;
        let words = format!("{node} coordinates {ms:.0} ms after the kill");
        let value = json!({ "event": "demo_takeover", "node": node, "after_ms": ms });
        self.takeover = Some((at, node.clone(), took));
        self.narrator.demo_event(at, "TAKEOVER", &words, value)
    }

    async fn restart_the_killed(&mut self) -> Result<(), Failure> {
        let (Some((_, victim)), Some((at, _, _))) = (&self.killed, &self.takeover) else { return Ok(()) };
        let now = self.stage.elapsed();
        if self.restarted || now < *at + RESTART_AFTER {
            return Ok(());
        }
        self.restarted = true;
        let victim = victim.clone();
        let words = format!("{victim} is started again");
        self.narrator.demo_event(now, "restart", &words, json!({ "event": "demo_restarted", "node": victim }))?;
        self.stage.restart(&victim).await
    }

    /// Events may be lost; the coordinator knows how missions stand.
    async fn catch_up(&mut self) {
        let Some(view) = self.look(&Key::ViewMissions).await else { return };
        let at = self.stage.elapsed();
        for entry in view["missions"].as_array().into_iter().flatten() {
            let id = entry["mission"].as_str().and_then(|id| id.parse::<MissionId>().ok());
            let Some(fate) = id.and_then(|id| self.missions.get_mut(&id)) else { continue };
            let holders = entry["holders"].as_object().into_iter().flatten();
            let holders = holders.map(|(role, robot)| format!("{role}: {}", robot.as_str().unwrap_or("?")));
            fate.holders = holders.collect::<Vec<_>>().join(", ");
            if let Ok(state) = serde_json::from_value::<MissionState>(entry["detail"].clone())
                && state.is_final()
            {
                fate.end.get_or_insert((at, state));
            }
        }
    }

    async fn conclude(&mut self) -> Result<(), Failure> {
        self.catch_up().await;
        let world = self.look(&Key::ViewWorld).await.unwrap_or(Value::Null);
        let samples: Vec<(String, String)> = world["samples"].as_array().into_iter().flatten().map(sample).collect();
        let delivered = samples.iter().filter(|(_, place)| place == "Laboratory").count();

        let (rows, missions) = self.table();
        let completed =
            self.missions.values().filter(|fate| matches!(fate.end, Some((_, MissionState::Completed)))).count();
        let all = self.missions.len();
        let mut words: Vec<String> = self.takeover_in_words().into_iter().collect();
        words.push(format!(
            "{completed} of {all} missions completed; {delivered} of {} samples in the laboratory",
            samples.len()
        ));
        let takeover = self
            .takeover
            .as_ref()
            .map(|(_, node, took)| json!({ "node": node, "after_ms": took.as_secs_f64() * 1000.0 }));
        let value = json!({
            "event": "demo_summary", "missions": missions, "completed": completed, "samples": samples.len(),
            "delivered": delivered, "killed": self.killed.as_ref().map(|(_, node)| node), "takeover": takeover,
        });
        self.narrator.summary(&rows, &words, &value)?;
        let killed_in_vain = self.killed.is_some() && self.takeover.is_none();
        if completed == all && delivered == samples.len() && !killed_in_vain {
            return Ok(());
        }
        Err(Failure::Unsuccessful("the demo did not end as it should".to_owned()))
    }

    /// What has become of each mission: a table for people, and the same for programs.
    fn table(&self) -> (Vec<Vec<String>>, Vec<Value>) {
        let heads = ["mission", "room", "outcome", "award", "took", "auctions", "roles"];
        let mut rows = vec![heads.map(str::to_owned).to_vec()];
        let mut missions = vec![];
        for (mission, fate) in &self.missions {
            let (outcome, took) = match &fate.end {
                Some((at, state)) => (state.as_str(), at.saturating_sub(fate.submitted)),
                None => ("unknown", Duration::ZERO),
            };
            let award = fate.award_ms.map_or_else(|| "-".to_owned(), |ms| format!("{ms:.1} ms"));
            let took = took.as_secs_f64();
            let row = [
                mission.as_str(),
                &fate.room,
                outcome,
                &award,
                &format!("{took:.1} s"),
                &fate.auctions.to_string(),
                &fate.holders,
            ];
            rows.push(row.map(str::to_owned).to_vec());
            missions.push(json!({
                "mission": mission, "room": fate.room, "outcome": outcome, "award_ms": fate.award_ms,
                "took_s": took, "auctions": fate.auctions, "holders": fate.holders,
            }));
        }
        (rows, missions)
    }

    /// What has come of the kill, if there was one.
    fn takeover_in_words(&self) -> Option<String> {
        let (_, victim) = self.killed.as_ref()?;
        Some(match &self.takeover {
            Some((_, node, took)) => {
                let ms = took.as_secs_f64() * 1000.0;
                format!("coordinator {victim} killed; {node} took over within {ms:.0} ms")
            }
            None => format!("coordinator {victim} killed; nobody was heard to take over"),
        })
    }

    async fn look(&self, key: &Key) -> Option<Value> {
        self.ask(key, "", QueryTarget::Nearest).await.ok()
    }

    async fn ask(&self, key: &Key, payload: &str, whom: QueryTarget) -> Result<Value, QueryError> {
        query_once(&*self.stage.bus(), &self.keys.write(key), payload, QUERY_LIMIT, whom).await
    }
}

fn sample(report: &Value) -> (String, String) {
    let text = |key: &str| report[key].as_str().unwrap_or("?").to_owned();
    (text("id"), text("place"))
}
