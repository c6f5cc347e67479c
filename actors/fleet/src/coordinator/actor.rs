//! The coordinator actor: active only while its node leads the ledger.

use super::leader_session::LeaderSession;
use super::message::CoordinatorMessage;
use super::no_leader::{may_reply, no_leader_reply, retry_reply};
use super::settings::{CoordinatorSettings, NodeParts};
use consort_bus::tasks::Tasks;
use consort_bus::{BusError, Query, Sample, reply};
use consort_protocol::codec;
use consort_protocol::event::EventKind;
use consort_protocol::ids::NodeId;
use consort_protocol::keys::{Key, Keys};
use consort_protocol::message::Beacon;
use consort_protocol::units::NodeTime;
use ractor::{Actor, ActorProcessingErr, ActorRef};
use std::time::Duration;
use tokio::time::Instant;
use tracing::info;

/// Delay before a request that was left to another coordinator is checked again: that node may have
/// been gone already. A killed node is detected in less time.
const RECHECK_DELAY: Duration = Duration::from_millis(100);

/// The coordinator actor.
pub(crate) struct Coordinator;

/// State of [`Coordinator`].
pub(crate) struct CoordinatorState {
    settings: CoordinatorSettings,
    session: Option<LeaderSession>,
    /// Latest other coordinator with a beacon, and the time of that beacon.
    last_beacon: Option<(NodeId, NodeTime)>,
    /// Last time this node transferred leadership to a better placed node.
    yielded_at: Option<Instant>,
    /// Voter change that was in progress at the end of the last session.
    voter_change: Tasks,
    /// Service of requests, while a reply may be up to this node.
    requests: Option<Tasks>,
    tasks: Tasks,
}

#[ractor::async_trait]
impl Actor for Coordinator {
    type Msg = CoordinatorMessage;
    type State = CoordinatorState;
    type Arguments = CoordinatorSettings;

    async fn pre_start(
        &self,
        myself: ActorRef<Self::Msg>,
        settings: Self::Arguments,
    ) -> Result<Self::State, ActorProcessingErr> {
        let NodeParts { replica, keys, bus, .. } = &settings.parts;
        let mut tasks = Tasks::default();
        tasks.on_change(replica.leadership(), &myself, |changed| CoordinatorMessage::Leadership(Some(changed)));
        tasks.on_change(replica.applied(), &myself, CoordinatorMessage::Ledger);
        myself.cast(CoordinatorMessage::Leadership(None))?;
        let beacons = bus.subscribe(&keys.write(&Key::Beacon)).await?;
        tasks.forward_samples(beacons, &myself, CoordinatorMessage::Beacon);
        tasks.send_every(settings.tick_interval, &myself, || CoordinatorMessage::Tick);
        let mut state = CoordinatorState {
            settings,
            session: None,
            last_beacon: None,
            yielded_at: None,
            voter_change: Tasks::default(),
            requests: None,
            tasks,
        };
        state.serve_requests(&myself).await?;
        Ok(state)
    }

    async fn handle(
        &self,
        myself: ActorRef<Self::Msg>,
        message: Self::Msg,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        match (message, &mut state.session) {
            (CoordinatorMessage::Leadership(changed), _) => {
                drop(changed); // later changes are a message of their own
                state.follow_leadership(&myself).await?;
            }
            (CoordinatorMessage::Beacon(sample), _) => {
                state.follow_beacon(&sample);
                state.serve_requests(&myself).await?;
            }
            // Any node replies to read-only requests: see `views`.
            (CoordinatorMessage::Api(query), _) if is_read_only(&state.settings.parts.keys, &query) => {}
            (CoordinatorMessage::Api(query), None) => state.leave_to_coordinator(&myself, query),
            (CoordinatorMessage::ApiRecheck(query), None) => drop(state.reply_without_leader(query)),
            (_, None) => {} // message of an ended session
            (CoordinatorMessage::Ledger(changed), Some(session)) => {
                drop(changed);
                session.follow_ledger();
            }
            (CoordinatorMessage::Tick, Some(session)) => session.tick(),
            (CoordinatorMessage::VotersChanged { term, result }, Some(session)) if term == session.term() => {
                session.handle_voters_changed(result).await;
            }
            (CoordinatorMessage::VotersChanged { .. }, Some(_)) => {}
            (CoordinatorMessage::BidsCollected(bids), Some(session)) => session.close_bidding(*bids),
            (CoordinatorMessage::AuctionRecorded { auction, outcome }, Some(session)) => {
                session.handle_auction_recorded(&auction, outcome);
            }
            (CoordinatorMessage::NoticeReplied(awarded, reply), Some(session)) => {
                session.handle_notice_reply(awarded, reply);
            }
            (CoordinatorMessage::OrdersAcknowledged { robot, as_of }, Some(session)) => {
                session.acknowledge_orders(&robot, as_of);
            }
            (CoordinatorMessage::Question { mission, role, epoch, question }, Some(session)) => {
                session.handle_question(mission, role, epoch, question);
            }
            (CoordinatorMessage::PersonEvent(sample), Some(session)) => session.handle_person_event(&sample),
            (CoordinatorMessage::PersonReplied(id, request, author), Some(session)) => {
                session.handle_person_reply(id, request, &author);
            }
            (CoordinatorMessage::ClockRead { voter, wall_ms }, Some(session)) => session.record_clock(voter, wall_ms),
            (CoordinatorMessage::Api(query), Some(session)) => session.handle_api(query),
            (CoordinatorMessage::ApiRecheck(query), Some(_)) => {
                // The former coordinator may or may not have executed the request. A repeated
                // request shows it.
                reply::json_in(&mut state.tasks, query, retry_reply(String::new()));
            }
            // The requester may have stopped waiting.
            (CoordinatorMessage::QueryStatus(to), Some(session)) => drop(to.send(session.status())),
        }
        Ok(())
    }
}

fn is_read_only(keys: &Keys, query: &Query) -> bool {
    matches!(keys.read(&query.key), Some(Key::Api(call)) if call.is_read_only())
}

impl CoordinatorState {
    fn follow_beacon(&mut self, sample: &Sample) {
        if let Ok(beacon) = codec::decode::<Beacon>(&sample.payload)
            && beacon.node != self.settings.parts.node
        {
            self.last_beacon = Some((beacon.node, self.settings.parts.clock.now()));
        }
    }

    /// Serves requests, if and only if a reply may be up to this node.
    async fn serve_requests(&mut self, myself: &ActorRef<CoordinatorMessage>) -> Result<(), BusError> {
        let NodeParts { node, replica, keys, bus, .. } = &self.settings.parts;
        let may_reply = may_reply(node, &replica.leadership().borrow(), self.last_beacon.is_some());
        if !may_reply {
            self.requests = None;
        } else if self.requests.is_none() {
            let requests = bus.serve(&keys.any_api()).await?;
            let mut tasks = Tasks::default();
            tasks.forward_queries(requests, myself, CoordinatorMessage::Api);
            self.requests = Some(tasks);
        }
        Ok(())
    }

    /// Leaves a request to the active coordinator, and checks it again after a short delay if this
    /// node cannot reply now.
    fn leave_to_coordinator(&mut self, myself: &ActorRef<CoordinatorMessage>, query: Query) {
        if let Some(query) = self.reply_without_leader(query) {
            self.tasks.send_after(RECHECK_DELAY, myself, CoordinatorMessage::ApiRecheck(query));
        }
    }

    /// Replies to a request while this node is not the coordinator, if the reply is up to this
    /// node. Otherwise returns the request.
    fn reply_without_leader(&mut self, query: Query) -> Option<Query> {
        let NodeParts { node, replica, knowledge, .. } = &self.settings.parts;
        let leadership = replica.leadership().borrow().clone();
        let now = self.settings.parts.clock.now();
        let last_beacon = self.last_beacon.as_ref().map(|(node, at)| (node, now.since(*at)));
        let Some(reply) = no_leader_reply(node, &leadership, knowledge, last_beacon) else { return Some(query) };
        reply::json_in(&mut self.tasks, query, reply);
        None
    }

    async fn follow_leadership(&mut self, myself: &ActorRef<CoordinatorMessage>) -> Result<(), BusError> {
        self.serve_requests(myself).await?;
        let NodeParts { node, replica, events, .. } = &self.settings.parts;
        let leadership = replica.leadership().borrow().clone();
        let term = leadership.is_leader.then_some(leadership.term);
        if self.session.as_ref().map(LeaderSession::term) == term {
            return Ok(());
        }
        if let Some(session) = self.session.take() {
            let term = session.term();
            self.yielded_at = session.yielded_at();
            self.voter_change = session.end();
            info!(%node, term, "no longer coordinates");
            events.publish(EventKind::SteppedDown { term });
        }
        if term.is_some() {
            let mut session = LeaderSession::start(&self.settings, &leadership, self.yielded_at, myself).await?;
            session.begin().await;
            self.session = Some(session);
        }
        Ok(())
    }
}
