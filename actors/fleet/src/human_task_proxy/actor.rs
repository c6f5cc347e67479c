//! The actor of the human task proxy: mailbox, queries and mission cancellation by people.

use super::requests::{PendingCancellations, RecentCancelOrders};
use super::roles::{ProxyRole, RoleKey, query_signals, send_person_request};
use crate::events::EventPublisher;
use crate::robot::SignalExchange;
use crate::robot_driver::{PersonEvent, PersonRequestState};
use bytes::Bytes;
use consort_bus::tasks::Tasks;
use consort_bus::{Sample, SharedBus};
use consort_protocol::codec;
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::keys::{ApiCall, Key, Keys, PeopleCall};
use consort_protocol::ledger::Branch;
use consort_protocol::message::{ActiveMissions, Beacon, ReportReply, SignalHistory};
use consort_skills::actions::GoalId;
use ractor::{Actor, ActorProcessingErr, ActorRef};
use std::collections::BTreeMap;
use std::time::Duration;
use tracing::{debug, warn};

/// Timeout for the coordinator to record that a mission was canceled.
const CANCEL_TIMEOUT: Duration = Duration::from_secs(2);

/// Settings of a human task proxy.
pub struct HumanTaskProxySettings {
    /// Id of its node.
    pub node: NodeId,
    /// The fleet's keys.
    pub keys: Keys,
    /// The bus.
    pub bus: SharedBus,
    /// Event publisher.
    pub events: EventPublisher,
    /// Interval of the periodic work. Messages are handled at once. Default 1 s.
    pub tick_interval: Duration,
}

/// Message for the human task proxy.
pub enum HumanTaskProxyMessage {
    /// Periodic timer: repeat queries, requests and reports.
    Tick,
    /// Beacon of the coordinator.
    Beacon(Sample),
    /// The active missions have changed.
    MissionsChanged(Sample),
    /// Active missions, as a coordinator reports them, with the number of the query.
    ActiveMissions(u64, ActiveMissions),
    /// Signal of a role.
    Signal(Sample),
    /// Signal history of a role, in reply to a query.
    SignalHistory(SignalHistory),
    /// Event of a person.
    PersonEvent(Sample),
    /// State of a person request, in reply to a command.
    RequestReplied(GoalId, PersonRequestState),
    /// Reply to a report for this branch.
    ReportReplied(MissionId, RoleId, Branch, ReportReply),
}

/// The human task proxy actor.
pub struct HumanTaskProxy;

/// State of [`HumanTaskProxy`].
pub struct HumanTaskProxyState {
    pub(super) settings: HumanTaskProxySettings,
    pub(super) coordinator: Option<Beacon>,
    pub(super) roles: BTreeMap<RoleKey, ProxyRole>,
    /// Number of queries for the active missions so far. The next field is the latest query with an
    /// accepted reply: replies may arrive out of order.
    queries_sent: u64,
    latest_reply: u64,
    pub(super) cancellations: PendingCancellations,
    /// Missions canceled by people, with the name of the person. The cancellation is repeated until
    /// the mission is no longer active.
    canceled_missions: BTreeMap<MissionId, String>,
    recent_orders: RecentCancelOrders,
    pub(super) signals: SignalExchange,
    pub(super) tasks: Tasks,
}

#[ractor::async_trait]
impl Actor for HumanTaskProxy {
    type Msg = HumanTaskProxyMessage;
    type State = HumanTaskProxyState;
    type Arguments = HumanTaskProxySettings;

    async fn pre_start(
        &self,
        myself: ActorRef<Self::Msg>,
        settings: HumanTaskProxySettings,
    ) -> Result<Self::State, ActorProcessingErr> {
        let HumanTaskProxySettings { keys, bus, .. } = &settings;
        let mut tasks = Tasks::default();
        tasks.forward(bus.subscribe(&keys.write(&Key::Beacon)).await?, &myself, HumanTaskProxyMessage::Beacon);
        tasks.forward(
            bus.subscribe(&keys.write(&Key::Changed)).await?,
            &myself,
            HumanTaskProxyMessage::MissionsChanged,
        );
        tasks.forward(bus.subscribe(&keys.any_signal()).await?, &myself, HumanTaskProxyMessage::Signal);
        let done = keys.write(&Key::People(PeopleCall::Done));
        tasks.forward(bus.subscribe(&done).await?, &myself, HumanTaskProxyMessage::PersonEvent);
        tasks.send_every(settings.tick_interval, &myself, || HumanTaskProxyMessage::Tick);
        let (bus, keys) = (bus.clone(), keys.clone());
        Ok(HumanTaskProxyState {
            settings,
            coordinator: None,
            roles: BTreeMap::new(),
            queries_sent: 0,
            latest_reply: 0,
            cancellations: PendingCancellations::default(),
            canceled_missions: BTreeMap::new(),
            recent_orders: RecentCancelOrders::default(),
            signals: SignalExchange::new(bus, keys),
            tasks,
        })
    }

    async fn handle(
        &self,
        myself: ActorRef<Self::Msg>,
        message: Self::Msg,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        match message {
            HumanTaskProxyMessage::Tick => state.tick(&myself).await,
            HumanTaskProxyMessage::Beacon(sample) => state.follow_coordinator(&myself, &sample),
            HumanTaskProxyMessage::MissionsChanged(_) => state.query_missions(&myself),
            HumanTaskProxyMessage::ActiveMissions(query_number, active) => {
                if query_number > state.latest_reply {
                    state.latest_reply = query_number;
                    state.update_missions(&myself, active).await?;
                }
            }
            HumanTaskProxyMessage::Signal(sample) => match codec::decode::<SignalHistory>(&sample.payload) {
                Ok(history) => state.receive_signals(&myself, &history).await,
                Err(problem) => warn!(key = sample.key, %problem, "signal cannot be decoded"),
            },
            HumanTaskProxyMessage::SignalHistory(history) => state.receive_signals(&myself, &history).await,
            HumanTaskProxyMessage::PersonEvent(sample) => match codec::decode::<PersonEvent>(&sample.payload) {
                Ok(PersonEvent::RequestEnded { id, result }) => state.handle_request_ended(&myself, id, result).await,
                Ok(PersonEvent::CancelMission { by, role, robot, at_ms }) => {
                    state.cancel_mission(&by, &role, &robot, at_ms);
                }
                Err(problem) => warn!(%problem, "event of a person cannot be decoded"),
            },
            HumanTaskProxyMessage::RequestReplied(_, PersonRequestState::Requested) => {}
            HumanTaskProxyMessage::RequestReplied(id, PersonRequestState::Ended(result)) => {
                state.cancellations.confirm(id);
                state.handle_request_ended(&myself, id, result).await;
            }
            HumanTaskProxyMessage::RequestReplied(id, PersonRequestState::Canceled) => {
                state.cancellations.confirm(id);
                state.renew_request(&myself, id);
            }
            HumanTaskProxyMessage::ReportReplied(mission, role, branch, reply) => {
                state.handle_report_reply(&myself, &(mission, role), branch, reply).await;
            }
        }
        Ok(())
    }
}

impl HumanTaskProxyState {
    async fn tick(&mut self, myself: &ActorRef<HumanTaskProxyMessage>) {
        self.query_missions(myself);
        for ((mission, _), proxied) in &self.roles {
            query_signals(&self.signals, &mut self.tasks, myself, mission, &proxied.sequencer);
            if let Some(request) = &proxied.request {
                send_person_request(&self.settings, &mut self.tasks, myself, request.id(), Some(request.request()));
            }
        }
        let roles = &self.roles;
        self.canceled_missions.retain(|mission, _| roles.keys().any(|(active, _)| active == mission));
        for (mission, by) in self.canceled_missions.clone() {
            self.send_cancel(mission, by);
        }
        for id in self.cancellations.pending() {
            send_person_request(&self.settings, &mut self.tasks, myself, id, None);
        }
        for key in self.roles.keys().cloned().collect::<Vec<_>>() {
            self.report(myself, &key);
        }
    }

    fn follow_coordinator(&mut self, myself: &ActorRef<HumanTaskProxyMessage>, sample: &Sample) {
        let Ok(beacon) = codec::decode::<Beacon>(&sample.payload) else { return };
        if !beacon.supersedes(self.coordinator.as_ref()) {
            return;
        }
        let new = beacon.is_other_leader_session(self.coordinator.as_ref());
        self.coordinator = Some(beacon);
        if new {
            self.query_missions(myself);
        }
    }

    /// Queries the coordinator for the active missions.
    fn query_missions(&mut self, myself: &ActorRef<HumanTaskProxyMessage>) {
        let Some(beacon) = &self.coordinator else { return };
        let key = self.settings.keys.write(&Key::ActiveMissions(beacon.node.clone()));
        let (bus, to) = (self.settings.bus.clone(), myself.clone());
        self.queries_sent += 1;
        let query_number = self.queries_sent;
        self.tasks.spawn(async move {
            match query_active_missions(bus, &key).await {
                // A stopped proxy needs no reply.
                Some(active) => drop(to.cast(HumanTaskProxyMessage::ActiveMissions(query_number, active))),
                None => debug!(key, "active missions not received completely; the next timer repeats the query"),
            }
        });
    }

    /// Cancels the mission for which a robot came to a person: the mission in which both the robot
    /// and the person's role take part.
    fn cancel_mission(&mut self, by: &str, role: &RoleId, robot: &RobotId, at_ms: u64) {
        let takes_part = |((_, role_id), proxied): &(&RoleKey, &ProxyRole)| {
            role_id == role && proxied.sequencer.holders().values().any(|holding| holding.robot == *robot)
        };
        let Some(mission) = self.roles.iter().find(takes_part).map(|((mission, _), _)| mission.clone()) else { return };
        if self.recent_orders.is_new(by, robot, at_ms) {
            self.canceled_missions.insert(mission.clone(), by.to_owned());
            self.send_cancel(mission, by.to_owned());
        }
    }

    /// Sends a cancel request to the coordinator, as any client does. The timer repeats it while
    /// the mission is active.
    fn send_cancel(&mut self, mission: MissionId, by: String) {
        let request = serde_json::json!({ "mission": mission, "by": by }).to_string();
        let (bus, key) = (self.settings.bus.clone(), self.settings.keys.write(&Key::Api(ApiCall::Cancel)));
        self.tasks.spawn(async move {
            let Ok(mut replies) = bus.query(&key, Bytes::from(request), CANCEL_TIMEOUT).await else { return };
            while let Some(reply) = replies.recv().await {
                debug!(%mission, answered = reply.payload.is_ok(), "cancel request got a reply");
            }
        });
    }
}

/// Returns `None` if the reply was incomplete.
async fn query_active_missions(bus: SharedBus, key: &str) -> Option<ActiveMissions> {
    let mut replies = bus.query(key, Bytes::new(), Duration::from_millis(500)).await.ok()?;
    let mut parts: Vec<ActiveMissions> = vec![];
    while let Some(reply) = replies.recv().await {
        parts.push(codec::decode(&reply.payload.ok()?).ok()?);
    }
    ActiveMissions::join(parts)
}
