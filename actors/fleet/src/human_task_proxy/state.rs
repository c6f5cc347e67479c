//! State of the human task proxy, and the effects that it performs: queries, requests to people,
//! reports and cancellations.

use super::message::HumanTaskProxyMessage;
use super::proxy_role::{ProxyRole, RoleKey};
use super::requests::{CanceledMissions, PendingCancellations};
use crate::events::EventPublisher;
use crate::followed_coordinator::FollowedCoordinator;
use crate::robot::{SignalExchange, send_report};
use crate::robot_driver::{PersonCommand, PersonRequestState};
use bytes::Bytes;
use consort_bus::clock::Clock;
use consort_bus::tasks::Tasks;
use consort_bus::{Reply, SharedBus};
use consort_protocol::api::MissionChangeRequest;
use consort_protocol::codec;
use consort_protocol::ids::{MissionId, NodeId, RobotId};
use consort_protocol::keys::{ApiCall, Key, Keys, PeopleCall};
use consort_protocol::lease::Epoch;
use consort_protocol::message::{ActiveMissions, Report};
use consort_skills::actions::{GoalId, PersonRequest};
use ractor::ActorRef;
use std::collections::BTreeMap;
use std::time::Duration;
use tracing::{debug, warn};

/// Timeout for the coordinator to record that a mission was canceled.
const CANCEL_TIMEOUT: Duration = Duration::from_secs(2);

/// Settings of a human task proxy.
pub(crate) struct HumanTaskProxySettings {
    /// Id of its node.
    pub(crate) node: NodeId,
    /// The fleet's keys.
    pub(crate) keys: Keys,
    /// The bus.
    pub(crate) bus: SharedBus,
    /// The node's clock.
    pub(crate) clock: Clock,
    /// Event publisher.
    pub(crate) events: EventPublisher,
    /// Interval of the periodic work. Messages are handled at once. Default 1 s.
    pub(crate) tick_interval: Duration,
}

/// State of the human task proxy actor.
pub(crate) struct HumanTaskProxyState {
    pub(super) settings: HumanTaskProxySettings,
    /// The actor itself: recipient of replies.
    pub(super) myself: ActorRef<HumanTaskProxyMessage>,
    pub(super) coordinator: FollowedCoordinator,
    pub(super) roles: BTreeMap<RoleKey, ProxyRole>,
    pub(super) queries: MissionQueries,
    pub(super) cancellations: PendingCancellations,
    pub(super) canceled_missions: CanceledMissions,
    pub(super) signals: SignalExchange,
    pub(super) tasks: Tasks,
}

/// Numbers of the queries for the active missions: replies may arrive out of order.
#[derive(Debug, Default)]
pub(super) struct MissionQueries {
    sent: u64,
    /// Latest query with an accepted reply.
    latest_reply: u64,
}

impl MissionQueries {
    fn next(&mut self) -> u64 {
        self.sent += 1;
        self.sent
    }

    /// Accepts a reply, unless a later query was replied to before.
    pub(super) fn accept(&mut self, query_number: u64) -> bool {
        let is_latest = query_number > self.latest_reply;
        self.latest_reply = self.latest_reply.max(query_number);
        is_latest
    }
}

impl HumanTaskProxyState {
    /// Queries the coordinator for the active missions.
    pub(super) fn query_missions(&mut self) {
        let Some(node) = self.coordinator.beacon().map(|beacon| beacon.node.clone()) else { return };
        let key = self.settings.keys.write(&Key::ActiveMissions(node.clone()));
        let (bus, to) = (self.settings.bus.clone(), self.myself.clone());
        let query_number = self.queries.next();
        self.tasks.spawn(async move {
            let active = query_active_missions(bus, &key).await;
            if active.is_none() {
                debug!(key, "active missions not received completely; the next timer repeats the query");
            }
            // A stopped proxy needs no reply.
            let _ = to.cast(HumanTaskProxyMessage::ActiveMissions { node, query_number, active });
        });
    }

    /// Queries the signal histories of all roles from which this role awaits a signal.
    pub(super) fn query_signals(&mut self, key: &RoleKey) {
        let Some(proxied) = self.roles.get(key) else { return };
        let (to, awaited) = (self.myself.clone(), proxied.sequencer.awaited_signals());
        self.signals.query_history(&key.0, &awaited, &mut self.tasks, move |history| {
            // A stopped proxy needs no reply.
            let _ = to.cast(HumanTaskProxyMessage::SignalHistory(history));
        });
    }

    /// Sends the open request of a role.
    pub(super) fn send_open_request(&mut self, key: &RoleKey) {
        let request = self.roles.get(key).and_then(|proxied| proxied.request.as_ref());
        let Some((id, request)) = request.map(|request| (request.id(), request.request())) else { return };
        self.send_person_request(id, Some(request));
    }

    /// Sends a person request, or cancels it if `request` is `None`.
    pub(super) fn send_person_request(&mut self, id: GoalId, request: Option<PersonRequest>) {
        let bytes = match codec::encode(&PersonCommand { id, request }) {
            Ok(bytes) => Bytes::from(bytes),
            Err(problem) => return warn!(%problem, "person request does not fit a message"),
        };
        let key = self.settings.keys.write(&Key::People(PeopleCall::Ask));
        let (bus, to) = (self.settings.bus.clone(), self.myself.clone());
        self.tasks.spawn(async move {
            let Ok(mut replies) = bus.query(&key, bytes, Duration::from_millis(500)).await else { return };
            while let Some(reply) = replies.recv().await {
                let Reply { payload, author, .. } = reply;
                match payload.map(|bytes| codec::decode::<PersonRequestState>(&bytes)) {
                    // A stopped proxy needs no reply.
                    Ok(Ok(state)) => drop(to.cast(HumanTaskProxyMessage::RequestReplied(id, state, author))),
                    other => debug!(?other, "person request got no reply"),
                }
            }
        });
    }

    /// Cancels a request. The timer repeats this until it is confirmed, so that no person serves
    /// the request during the next mission.
    pub(super) fn cancel_request(&mut self, id: GoalId) {
        self.cancellations.add(id);
        self.send_person_request(id, None);
    }

    /// Sends a cancel request to the coordinator, as any client does. The timer repeats it while
    /// the mission is active.
    pub(super) fn send_cancel(&mut self, mission: MissionId, by: String) {
        let request = MissionChangeRequest { mission: mission.clone(), by: Some(by) };
        let request = serde_json::to_vec(&request).expect("a request serializes to JSON");
        let (bus, key) = (self.settings.bus.clone(), self.settings.keys.write(&Key::Api(ApiCall::Cancel)));
        self.tasks.spawn(async move {
            let Ok(mut replies) = bus.query(&key, Bytes::from(request), CANCEL_TIMEOUT).await else { return };
            while let Some(reply) = replies.recv().await {
                debug!(%mission, answered = reply.payload.is_ok(), "cancel request got a reply");
            }
        });
    }

    /// Reports the progress of a role to the ledger.
    pub(super) fn report(&mut self, key: &RoleKey) {
        let (Some(proxied), Some(beacon)) = (self.roles.get(key), self.coordinator.beacon()) else { return };
        if !proxied.has_news() {
            return;
        }
        let ((mission, role), branch) = (key.clone(), proxied.branch);
        let report = Report {
            robot: RobotId::from(self.settings.node.clone()),
            incarnation: 0,
            mission: mission.clone(),
            role: role.clone(),
            epoch: Epoch::default(),
            branch,
            ended: proxied.sequencer.ended().clone(),
            outcomes: proxied.sequencer.own_outcomes().clone(),
            current_task: proxied.sequencer.current_task().cloned(),
            place: None,
            from_checkpoint: false,
            failure: proxied.failure.clone(),
        };
        let to_node = self.settings.keys.write(&Key::Report(beacon.node.clone()));
        let (bus, limit, to) = (self.settings.bus.clone(), self.settings.tick_interval, self.myself.clone());
        self.tasks.spawn(async move {
            match send_report(bus, &to_node, &report, limit).await {
                // A stopped proxy needs no reply.
                Some(reply) => drop(to.cast(HumanTaskProxyMessage::ReportReplied(mission, role, branch, reply))),
                None => debug!(%mission, %role, "report got no reply; the next timer repeats it"),
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
