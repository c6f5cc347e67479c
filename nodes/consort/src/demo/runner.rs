//! The demo's sequence: wait for a coordinator, submit, kill the coordinator during the mission,
//! wait for the end, check the samples' places.

use super::events::{DemoEvent, DemoSummary, MissionResult, Takeover};
use super::fleet::DemoFleet;
use super::reporter::DemoReporter;
use super::scenario::DemoScenario;
use crate::exit::Failure;
use crate::inputs;
use consort_bus::{Sample, Stream};
use consort_dashboard::query::{QueryError, QueryTarget, query_once};
use consort_dashboard::server::Dashboard;
use consort_protocol::api::{SubmitReply, SubmitRequest};
use consort_protocol::event::{Event, EventKind};
use consort_protocol::ids::{MissionId, NodeId, RoleId};
use consort_protocol::keys::{ApiCall, Key, Keys};
use consort_protocol::ledger::MissionState;
use consort_protocol::mission::{Domain, Mission};
use consort_protocol::view::{CoordinatorView, MissionsView};
use consort_skills::missions::NamedMissions;
use consort_text::count;
use consort_world::world::WorldReport;
use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::time::Duration;

/// Time limit for the first election.
const ELECTION_LIMIT: Duration = Duration::from_secs(60);

/// Time limit of a query.
const QUERY_LIMIT: Duration = Duration::from_secs(2);

/// Delay before a killed node is restarted after the takeover, as under a service manager with a
/// restart delay.
const RESTART_AFTER: Duration = Duration::from_secs(2);

/// Options of the demo.
pub(super) struct DemoOptions {
    /// True if the coordinator is killed.
    pub(super) kill: bool,
    /// True if the fleet stays up after the summary.
    pub(super) keep_running: bool,
    /// The mission to submit.
    pub(super) requested: RequestedMission,
}

/// Runs a demo on a fleet.
pub(super) struct DemoRunner<S> {
    options: DemoOptions,
    scenario: DemoScenario,
    fleet: S,
    reporter: DemoReporter,
    keys: Keys,
    coordinator: Option<NodeId>,
    /// Time of the kill, and the killed node.
    killed: Option<(Duration, NodeId)>,
    /// Time of the takeover, and the takeover.
    takeover: Option<(Duration, Takeover)>,
    restarted: bool,
    missions: BTreeMap<MissionId, MissionProgress>,
    /// The dashboard, served as long as the demo runs.
    dashboard: Option<Dashboard>,
}

/// Progress of a mission.
struct MissionProgress {
    room: String,
    submitted: Duration,
    award_ms: Option<f64>,
    holders: String,
    auctions: u32,
    end: Option<(Duration, MissionState)>,
}

/// Mission that the demo submits.
pub(super) struct RequestedMission {
    /// Request in the format of the API, without an id.
    request: SubmitRequest,
    /// True if each mission gets a room with a nurse.
    has_room: bool,
    /// True if every sample must end up in the laboratory.
    delivers: bool,
    /// The mission, in a room with a nurse.
    pub(super) mission: Mission,
}

/// Returns the mission of a flag, checked before anything is started. `people` are agents of a flat
/// iHTN.
///
/// # Errors
/// [`Failure::Usage`] with the problem, or with the bundled missions.
pub(super) fn request_mission(text: &str, people: &[RoleId], domain: &Domain) -> Result<RequestedMission, Failure> {
    let document = inputs::mission(text, people, &NamedMissions::default())
        .map_err(|problems| Failure::Usage(format!("--mission {problems}")))?;
    let has_room = document.parameters().contains_key("room");
    let room = has_room.then(|| ("room".to_owned(), "IC Room 6".to_owned())).into_iter().collect();
    let mission = document
        .instantiate(&room, domain)
        .map_err(|problem| Failure::Usage(format!("--mission {text}: {problem}")))?;
    let delivers = document.parameters().contains_key("laboratory");
    Ok(RequestedMission { request: inputs::mission_request(text, people)?, has_room, delivers, mission })
}

impl<S: DemoFleet> DemoRunner<S> {
    pub(super) fn new(
        options: DemoOptions,
        scenario: DemoScenario,
        fleet: S,
        reporter: DemoReporter,
        dashboard: Option<Dashboard>,
    ) -> DemoRunner<S> {
        let keys = Keys::new(&scenario.fleet.name);
        DemoRunner {
            options,
            scenario,
            fleet,
            reporter,
            keys,
            coordinator: None,
            killed: None,
            takeover: None,
            restarted: false,
            missions: BTreeMap::new(),
            dashboard,
        }
    }

    /// Runs the demo from beginning to end, and shuts the fleet down in any case.
    ///
    /// # Errors
    /// [`Failure`] unless every sample ends up in the laboratory.
    pub(super) async fn run(mut self) -> Result<(), Failure> {
        let mut outcome = self.run_phases().await;
        if outcome.is_ok() && self.options.keep_running {
            let at = self.fleet.elapsed();
            let words = "the fleet runs until Ctrl-C";
            outcome = self.reporter.demo_event(at, "running", words, DemoEvent::KeepsRunning);
            self.fleet.interrupted().await;
        }
        self.fleet.shut_down().await;
        outcome
    }

    async fn run_phases(&mut self) -> Result<(), Failure> {
        let bus = self.fleet.bus();
        let mut events = bus
            .subscribe(&self.keys.any_events())
            .await
            .map_err(|problem| Failure::Unreachable(problem.to_string()))?;
        self.reporter.begin(&self.fleet.description())?;
        if let Some(dashboard) = &self.dashboard {
            let (at, url) = (self.fleet.elapsed(), dashboard.url());
            self.reporter.demo_event(at, "dashboard", &url, DemoEvent::Dashboard { url: url.clone() })?;
        }
        self.await_coordinator(&mut events).await?;
        self.submit_all(&mut events).await?;
        self.watch(&mut events).await?;
        self.summarize().await
    }

    async fn await_coordinator(&mut self, events: &mut Stream<Sample>) -> Result<(), Failure> {
        let deadline = self.fleet.elapsed() + ELECTION_LIMIT;
        while self.coordinator.is_none() {
            if self.fleet.elapsed() >= deadline {
                let voters = count(self.scenario.voters().len(), "node", "nodes");
                let words = format!("no coordinator after {ELECTION_LIMIT:?}, with {voters} that may vote");
                return Err(Failure::Unreachable(words));
            }
            self.listen(events, Duration::from_millis(100)).await?;
            if let Some(view) = self.query_view::<CoordinatorView>(&Key::ViewCoordinator).await {
                self.coordinator = view.node;
            }
        }
        Ok(())
    }

    async fn submit_all(&mut self, events: &mut Stream<Sample>) -> Result<(), Failure> {
        for request in self.scenario.requests.clone() {
            let submission = SubmitRequest {
                parameters: match self.options.requested.has_room {
                    true => [("room".to_owned(), request.room.to_string())].into(),
                    false => BTreeMap::new(),
                },
                request: Some(request.request.clone()),
                ..self.options.requested.request.clone()
            };
            let payload = serde_json::to_string(&submission).expect("a request serializes to JSON");
            let deadline = self.fleet.elapsed() + ELECTION_LIMIT;
            let mission: MissionId = loop {
                let problem = match self.query(&Key::Api(ApiCall::Submit), &payload, QueryTarget::All).await {
                    Ok(answer) => match SubmitReply::deserialize(answer) {
                        Ok(reply) => break reply.mission,
                        Err(_) => "an answer without a mission".to_owned(),
                    },
                    Err(QueryError::Rejected(problem) | QueryError::Retryable(problem, _)) => problem,
                    Err(QueryError::NoReply) => "no reply".to_owned(),
                };
                if self.fleet.elapsed() >= deadline {
                    return Err(Failure::Unsuccessful(format!("{} was not acknowledged: {problem}", request.request)));
                }
                self.listen(events, Duration::from_millis(200)).await?;
            };
            let room = if self.options.requested.has_room { request.room.to_string() } else { "-".to_owned() };
            let submitted = self.fleet.elapsed();
            let progress =
                MissionProgress { room, submitted, award_ms: None, holders: String::new(), auctions: 0, end: None };
            self.missions.entry(mission).or_insert(progress);
        }
        Ok(())
    }

    /// Follows the fleet until all missions have ended.
    async fn watch(&mut self, events: &mut Stream<Sample>) -> Result<(), Failure> {
        let arms = self.scenario.robots.iter().filter(|robot| robot.speed_mps.is_none()).count().max(1);
        let rounds = u32::try_from(self.scenario.requests.len().div_ceil(arms)).unwrap_or(u32::MAX);
        // Ten minutes of world time for each mission, and a minute for everything but driving.
        let each = Duration::from_secs_f64(600.0 / self.scenario.world.speed);
        let deadline = self.fleet.elapsed() + Duration::from_secs(60) + each * rounds;
        while self.missions.values().any(|progress| progress.end.is_none()) {
            if self.fleet.elapsed() >= deadline {
                return Err(Failure::Unsuccessful(format!(
                    "not all missions have ended after {:.0} s",
                    deadline.as_secs_f64()
                )));
            }
            self.listen(events, Duration::from_millis(500)).await?;
            self.refresh_missions().await;
        }
        // Late events belong to the output too.
        self.listen(events, Duration::from_millis(300)).await
    }

    /// Processes events for a while.
    async fn listen(&mut self, events: &mut Stream<Sample>, time: Duration) -> Result<(), Failure> {
        let until = tokio::time::Instant::now() + time;
        loop {
            if let Some(trouble) = self.fleet.unexpected_exit() {
                return Err(Failure::Unsuccessful(trouble));
            }
            let sample = tokio::select! {
                biased;
                sample = events.recv() => sample,
                () = self.fleet.interrupted() => return Err(Failure::Interrupted),
                () = tokio::time::sleep_until(until) => return self.restart_killed_node().await,
            };
            let Some(sample) = sample else { return Err(Failure::Unreachable("the bus was closed".to_owned())) };
            match serde_json::from_slice::<Event>(&sample.payload) {
                Ok(event) => self.handle_event(&event).await?,
                Err(problem) => tracing::warn!(%problem, "an event that cannot be read"),
            }
        }
    }

    async fn handle_event(&mut self, event: &Event) -> Result<(), Failure> {
        let at = self.fleet.elapsed();
        self.reporter.event(at, event)?;
        match &event.kind {
            EventKind::Elected { .. } => {
                self.coordinator = Some(event.node.clone());
                self.note_takeover(at, &event.node)?;
            }
            EventKind::BidsRequested { mission, .. } => {
                if let Some(progress) = self.missions.get_mut(mission) {
                    progress.auctions += 1;
                }
            }
            EventKind::Awarded { mission, after_ms, .. } => {
                if let Some(progress) = self.missions.get_mut(mission) {
                    progress.award_ms = progress.award_ms.or(*after_ms);
                }
            }
            EventKind::Mission { mission, state, .. } if state.is_final() => {
                if let Some(progress) = self.missions.get_mut(mission) {
                    progress.end.get_or_insert((at, state.clone()));
                }
            }
            // The mission runs and its robots are active: kill now.
            EventKind::TaskEnded { .. } if self.options.kill && self.killed.is_none() => self.kill().await?,
            _ => {}
        }
        Ok(())
    }

    async fn kill(&mut self) -> Result<(), Failure> {
        let Some(victim) = self.coordinator.clone() else { return Ok(()) };
        let at = self.fleet.elapsed();
        self.killed = Some((at, victim.clone()));
        let words = format!("SIGKILL to {victim}, the coordinator");
        self.reporter.demo_event(at, "KILL", &words, DemoEvent::Killed { node: victim.clone() })?;
        self.fleet.kill(&victim).await
    }

    fn note_takeover(&mut self, at: Duration, node: &NodeId) -> Result<(), Failure> {
        let Some((killed_at, victim)) = &self.killed else { return Ok(()) };
        if self.takeover.is_some() || node == victim {
            return Ok(());
        }
        let after_ms = at.saturating_sub(*killed_at).as_secs_f64() * 1000.0;
        let words = format!("{node} is the coordinator {after_ms:.0} ms after the kill");
        let takeover = Takeover { node: node.clone(), after_ms };
        self.takeover = Some((at, takeover.clone()));
        self.reporter.demo_event(at, "TAKEOVER", &words, DemoEvent::Takeover(takeover))
    }

    async fn restart_killed_node(&mut self) -> Result<(), Failure> {
        let (Some((_, victim)), Some((at, _))) = (&self.killed, &self.takeover) else { return Ok(()) };
        let now = self.fleet.elapsed();
        if self.restarted || now < *at + RESTART_AFTER {
            return Ok(());
        }
        self.restarted = true;
        let victim = victim.clone();
        let words = format!("{victim} is started again");
        self.reporter.demo_event(now, "restart", &words, DemoEvent::Restarted { node: victim.clone() })?;
        self.fleet.restart(&victim).await
    }

    /// Events may be lost; the coordinator has the state of the missions.
    async fn refresh_missions(&mut self) {
        let Some(view) = self.query_view::<MissionsView>(&Key::ViewMissions).await else { return };
        let at = self.fleet.elapsed();
        for brief in view.missions.into_iter().map(|summary| summary.brief) {
            let Some(progress) = self.missions.get_mut(&brief.mission) else { continue };
            let holders = brief.progress.holders.iter().map(|(role, robot)| format!("{role}: {robot}"));
            progress.holders = holders.collect::<Vec<_>>().join(", ");
            if brief.status.detail.is_final() {
                progress.end.get_or_insert((at, brief.status.detail));
            }
        }
    }

    async fn summarize(&mut self) -> Result<(), Failure> {
        self.refresh_missions().await;
        let samples = self.query_view::<WorldReport>(&Key::ViewWorld).await.unwrap_or_default().samples;
        let delivered = samples.iter().filter(|sample| sample.place.as_str() == "Laboratory").count();

        let (rows, missions) = self.table();
        let completed = self
            .missions
            .values()
            .filter(|progress| matches!(progress.end, Some((_, MissionState::Completed))))
            .count();
        let all = self.missions.len();
        let mut words: Vec<String> = self.takeover_in_words().into_iter().collect();
        let in_laboratory = match self.options.requested.delivers {
            true => format!("; {delivered} of {} samples in the laboratory", samples.len()),
            false => String::new(),
        };
        words.push(format!("{completed} of {all} missions completed{in_laboratory}"));
        let summary = DemoSummary {
            missions,
            completed,
            samples: samples.len(),
            delivered,
            killed: self.killed.as_ref().map(|(_, node)| node.clone()),
            takeover: self.takeover.as_ref().map(|(_, takeover)| takeover.clone()),
        };
        self.reporter.summary(&rows, &words, DemoEvent::Summary(summary))?;
        let no_takeover = self.killed.is_some() && self.takeover.is_none();
        let all_delivered = !self.options.requested.delivers || delivered == samples.len();
        if completed == all && all_delivered && !no_takeover {
            return Ok(());
        }
        Err(Failure::Unsuccessful("the demo did not end as expected".to_owned()))
    }

    /// Returns the result of each mission: a table for people, and the same for programs.
    fn table(&self) -> (Vec<Vec<String>>, Vec<MissionResult>) {
        let heads = ["mission", "room", "outcome", "award", "took", "auctions", "roles"];
        let mut rows = vec![heads.map(str::to_owned).to_vec()];
        let mut missions = vec![];
        for (mission, progress) in &self.missions {
            let (outcome, took) = match &progress.end {
                Some((at, state)) => (state.as_str(), at.saturating_sub(progress.submitted)),
                None => ("unknown", Duration::ZERO),
            };
            let award = progress.award_ms.map_or_else(|| "-".to_owned(), |ms| format!("{ms:.1} ms"));
            let took_s = took.as_secs_f64();
            let row = [
                mission.as_str(),
                &progress.room,
                outcome,
                &award,
                &format!("{took_s:.1} s"),
                &progress.auctions.to_string(),
                &progress.holders,
            ];
            rows.push(row.map(str::to_owned).to_vec());
            missions.push(MissionResult {
                mission: mission.clone(),
                room: progress.room.clone(),
                outcome,
                award_ms: progress.award_ms,
                took_s,
                auctions: progress.auctions,
                holders: progress.holders.clone(),
            });
        }
        (rows, missions)
    }

    /// Describes the result of the kill, if there was a kill.
    fn takeover_in_words(&self) -> Option<String> {
        let (_, victim) = self.killed.as_ref()?;
        Some(match &self.takeover {
            Some((_, Takeover { node, after_ms })) => {
                format!("coordinator {victim} killed; {node} took over within {after_ms:.0} ms")
            }
            None => format!("coordinator {victim} killed; no takeover was received"),
        })
    }

    async fn query_view<T: for<'de> Deserialize<'de>>(&self, key: &Key) -> Option<T> {
        T::deserialize(self.query(key, "", QueryTarget::Nearest).await.ok()?).ok()
    }

    async fn query(&self, key: &Key, payload: &str, target: QueryTarget) -> Result<Value, QueryError> {
        query_once(&*self.fleet.bus(), &self.keys.write(key), payload, QUERY_LIMIT, target).await
    }
}
