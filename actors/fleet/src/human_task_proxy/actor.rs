//! The actor of the human task proxy: mailbox, timer, and mission cancellation by people.

use super::message::HumanTaskProxyMessage;
use super::proxy_role::RoleKey;
use super::requests::{CancelOrder, CanceledMissions, PendingCancellations};
use super::state::{HumanTaskProxySettings, HumanTaskProxyState, MissionQueries};
use crate::followed_coordinator::FollowedCoordinator;
use crate::robot::{ReceivedSignals, SignalExchange};
use crate::robot_driver::{PersonEvent, PersonRequestState};
use consort_bus::tasks::Tasks;
use consort_bus::{Author, Sample};
use consort_protocol::codec;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, PeopleCall};
use consort_protocol::message::{ActiveMissions, Beacon};
use consort_skills::actions::GoalId;
use ractor::{Actor, ActorProcessingErr, ActorRef};
use std::collections::BTreeMap;
use tracing::warn;

/// The human task proxy actor.
pub(crate) struct HumanTaskProxy;

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
        let changes = bus.subscribe(&keys.write(&Key::Changed)).await?;
        tasks.forward(changes, &myself, |_| HumanTaskProxyMessage::MissionsChanged);
        tasks.forward(bus.subscribe(&keys.any_signal()).await?, &myself, HumanTaskProxyMessage::Signal);
        let done = keys.write(&Key::People(PeopleCall::Done));
        tasks.forward(bus.subscribe(&done).await?, &myself, HumanTaskProxyMessage::PersonEvent);
        tasks.send_every(settings.tick_interval, &myself, || HumanTaskProxyMessage::Tick);
        Ok(HumanTaskProxyState {
            signals: SignalExchange::new(bus.clone(), keys.clone()),
            settings,
            myself,
            coordinator: FollowedCoordinator::default(),
            roles: BTreeMap::new(),
            queries: MissionQueries::default(),
            cancellations: PendingCancellations::default(),
            canceled_missions: CanceledMissions::default(),
            tasks,
        })
    }

    async fn handle(
        &self,
        _: ActorRef<Self::Msg>,
        message: Self::Msg,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        match message {
            HumanTaskProxyMessage::Tick => state.tick(),
            HumanTaskProxyMessage::Beacon(sample) => state.follow_coordinator(&sample),
            HumanTaskProxyMessage::MissionsChanged => state.query_missions(),
            HumanTaskProxyMessage::ActiveMissions { node, query_number, active } => {
                state.receive_missions(&node, query_number, active).await;
            }
            HumanTaskProxyMessage::Signal(sample) => {
                if let Some(received) = ReceivedSignals::of(sample) {
                    state.receive_signals(&received).await;
                }
            }
            HumanTaskProxyMessage::SignalHistory(received) => state.receive_signals(&received).await,
            HumanTaskProxyMessage::PersonEvent(sample) => state.receive_person_event(&sample).await,
            HumanTaskProxyMessage::RequestReplied(id, request, author) => {
                state.handle_request_reply(id, request, &author).await;
            }
            HumanTaskProxyMessage::ReportReplied(mission, role, branch, reply) => {
                state.handle_report_reply(&(mission, role), branch, reply).await;
            }
        }
        Ok(())
    }
}

impl HumanTaskProxyState {
    fn tick(&mut self) {
        self.query_missions();
        let keys: Vec<RoleKey> = self.roles.keys().cloned().collect();
        for key in &keys {
            self.query_signals(key);
            self.send_open_request(key);
        }
        self.canceled_missions.retain(|mission| keys.iter().any(|(active, _)| active == mission));
        for (mission, by) in self.canceled_missions.pending() {
            self.send_cancel(mission, by);
        }
        for id in self.cancellations.pending().collect::<Vec<_>>() {
            self.send_person_request(id, None);
        }
        for key in &keys {
            self.report(key);
        }
    }

    fn follow_coordinator(&mut self, sample: &Sample) {
        let Ok(beacon) = codec::decode::<Beacon>(&sample.payload) else { return };
        let change = self.coordinator.receive(beacon, self.settings.clock.now());
        if change.is_some_and(|change| change.new_session) {
            self.query_missions();
        }
    }

    async fn receive_missions(&mut self, node: &NodeId, query_number: u64, active: Option<ActiveMissions>) {
        let Some(active) = active else {
            return self.coordinator.not_answered(node, self.settings.clock.now());
        };
        self.coordinator.answered(node);
        if self.queries.accept(query_number) {
            self.update_missions(active).await;
        }
    }

    async fn receive_person_event(&mut self, sample: &Sample) {
        match codec::decode::<PersonEvent>(&sample.payload) {
            Ok(PersonEvent::RequestEnded { id, result }) => self.handle_request_ended(id, result, &sample.author).await,
            Ok(PersonEvent::CancelMission { role, .. }) if !sample.author.may_serve(role.as_str()) => {
                warn!(author = %sample.author, %role, "the author does not serve this person: event ignored");
            }
            Ok(PersonEvent::CancelMission { by, role, robot, at_ms }) => {
                self.cancel_mission(CancelOrder { by: &by, role: &role, robot: &robot, at_ms });
            }
            Err(problem) => warn!(%problem, "event of a person cannot be decoded"),
        }
    }

    async fn handle_request_reply(&mut self, id: GoalId, request: PersonRequestState, author: &Author) {
        match request {
            PersonRequestState::Requested => {}
            PersonRequestState::Ended(result) => {
                self.cancellations.confirm(id);
                self.handle_request_ended(id, result, author).await;
            }
            PersonRequestState::Canceled => {
                self.cancellations.confirm(id);
                self.renew_request(id);
            }
        }
    }

    /// Cancels the mission for which a robot came to a person: the mission in which both the robot
    /// and the person's role take part.
    fn cancel_mission(&mut self, order: CancelOrder<'_>) {
        let mut roles = self.roles.iter();
        let found = roles.find(|((_, role), proxied)| role == order.role && proxied.is_with(order.robot));
        let Some(mission) = found.map(|((mission, _), _)| mission.clone()) else { return };
        if self.canceled_missions.add(&mission, order) {
            self.send_cancel(mission, order.by.to_owned());
        }
    }
}
