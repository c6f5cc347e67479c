//! The coordinator actor: active only while its node leads the ledger.

use super::leader_session::LeaderSession;
use super::no_leader::{no_leader_reply, retry_reply};
use super::rate_limit::RequestLimits;
use crate::autopilot::ActionResult;
use crate::events::EventPublisher;
use crate::views::CoordinatorStatus;
use consort_bus::clock::Clock;
use consort_bus::reply;
use consort_bus::tasks::Tasks;
use consort_bus::wire_version::WireVersion;
use consort_bus::{BusError, Query, Sample, SharedBus};
use consort_gossip::SharedKnowledge;
use consort_protocol::auction::{Allocator, AuctionId, BidLimits, BidResponse, CallForBids};
use consort_protocol::codec;
use consort_protocol::ensemble::Ensemble;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::lease::{Epoch, LeaseTerms};
use consort_protocol::ledger::{CommandOutcome, Ledger};
use consort_protocol::message::{AwardReply, Beacon};
use consort_protocol::mission::Domain;
use consort_protocol::units::NodeTime;
use consort_raft::{ProposeError, Replica};
use ractor::{Actor, ActorProcessingErr, ActorRef};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::time::Instant;
use tracing::info;

/// Settings of a coordinator. Most are the same in the whole fleet.
#[derive(Clone)]
pub struct CoordinatorSettings {
    /// Id of this node.
    pub node: NodeId,
    /// The fleet's keys.
    pub keys: Keys,
    /// The bus.
    pub bus: SharedBus,
    /// The node's clock.
    pub clock: Clock,
    /// The node's copy of the ledger.
    pub replica: Replica<Ledger>,
    /// Records received from other nodes.
    pub knowledge: SharedKnowledge,
    /// Wire version that the node writes.
    pub wire_version: WireVersion,
    /// Event publisher.
    pub events: EventPublisher,
    /// The ensemble: its members receive calls for bids.
    pub ensemble: Arc<Ensemble>,
    /// The task types that missions may use.
    pub domain: Arc<Domain>,
    /// Limits that bids must meet.
    pub limits: BidLimits,
    /// Limits of accepted requests and missions.
    pub request_limits: RequestLimits,
    /// Allocation rule of the auctions.
    pub allocator: Arc<dyn Allocator>,
    /// Durations of leases.
    pub lease_terms: LeaseTerms,
    /// Time for which an auction waits for missing bids. Raised: robots on slow links still win
    /// roles, unreachable robots delay every auction for longer. Default 200 ms.
    pub bid_window: Duration,
    /// Maximum time for a held role without an ended step, while it could make progress. Then the
    /// role is taken from its holder. Zero means never. Raised: long drives are not interrupted,
    /// idle holders keep their roles for longer.
    pub stall_timeout: Duration,
    /// Interval of the beacon and of the periodic work. Default 250 ms.
    pub tick_interval: Duration,
    /// Seed of the cluster id, in case this node founds the ledger.
    pub cluster_seed: u64,
    /// Number of voters that the autopilot aims at.
    pub voters: usize,
    /// Time without contact after which the autopilot replaces a voter.
    pub dead_after: Duration,
    /// Age of the last reply up to which a voter counts as reachable: several heartbeats.
    pub contact_timeout: Duration,
}

/// Delay before a request that was left to another coordinator is checked again: that node may have
/// been gone already. A killed node is detected in less time.
const RECHECK_DELAY: Duration = Duration::from_millis(100);

/// Message for the coordinator actor.
pub enum CoordinatorMessage {
    /// The leader of the ledger has changed.
    Leadership,
    /// The ledger has changed.
    Ledger,
    /// Periodic timer: publish the beacon and perform all periodic work.
    Tick,
    /// All bids have arrived, or the bid window has closed.
    BidsCollected {
        /// The call for bids.
        call: Box<CallForBids>,
        /// Robots that were expected to reply.
        expected: BTreeSet<RobotId>,
        /// The bid responses.
        responses: Vec<BidResponse>,
    },
    /// The ledger has committed or refused an award or a deferral.
    AuctionRecorded {
        /// Id of the auction.
        auction: AuctionId,
        /// Outcome of the proposal.
        outcome: Result<CommandOutcome, ProposeError>,
    },
    /// A robot has replied to an award notice.
    NoticeReplied {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// The robot.
        robot: RobotId,
        /// Epoch of the award.
        epoch: Epoch,
        /// The robot's reply.
        reply: AwardReply,
    },
    /// A voter change has ended, with or without success.
    VotersChanged(ActionResult),
    /// Report of a robot.
    Report(Query),
    /// Query for the active missions.
    ActiveMissions(Query),
    /// Beacon of a coordinator.
    Beacon(Sample),
    /// Request of a client.
    Api(Query),
    /// Request of a client that arrived while another node was the coordinator, to be checked
    /// again.
    ApiRecheck(Query),
    /// Query for the status of this node's session. Without a session the query is dropped.
    QueryStatus(oneshot::Sender<CoordinatorStatus>),
}

/// The coordinator actor.
pub struct Coordinator;

/// State of [`Coordinator`].
pub struct CoordinatorState {
    settings: CoordinatorSettings,
    session: Option<LeaderSession>,
    /// Latest other coordinator with a beacon, and the time of that beacon.
    last_beacon: Option<(NodeId, NodeTime)>,
    /// Last time this node transferred leadership to a better placed node.
    yielded_at: Option<Instant>,
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
        let mut tasks = Tasks::default();
        tasks.on_change(settings.replica.leadership(), &myself, || CoordinatorMessage::Leadership);
        tasks.on_change(settings.replica.applied(), &myself, || CoordinatorMessage::Ledger);
        myself.cast(CoordinatorMessage::Leadership)?;
        let requests = settings.bus.serve(&settings.keys.any_api()).await?;
        tasks.forward(requests, &myself, CoordinatorMessage::Api);
        let beacons = settings.bus.subscribe(&settings.keys.write(&Key::Beacon)).await?;
        tasks.forward(beacons, &myself, CoordinatorMessage::Beacon);
        tasks.send_every(settings.tick_interval, &myself, || CoordinatorMessage::Tick);
        Ok(CoordinatorState { settings, session: None, last_beacon: None, yielded_at: None, tasks })
    }

    async fn handle(
        &self,
        myself: ActorRef<Self::Msg>,
        message: Self::Msg,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        let settings = &state.settings;
        match (message, &mut state.session) {
            (CoordinatorMessage::Leadership, _) => state.follow_leadership(&myself).await?,
            (CoordinatorMessage::Beacon(sample), _) => state.follow_beacon(&sample),
            // Any node replies to read-only requests: see `views`.
            (CoordinatorMessage::Api(query), _) if is_read_only(settings, &query) => {}
            (CoordinatorMessage::Api(query), None) => state.leave_to_coordinator(&myself, query).await,
            (CoordinatorMessage::ApiRecheck(query), None) => drop(state.reply_without_leader(query).await),
            (_, None) => {} // message of an ended session
            (CoordinatorMessage::Ledger, Some(session)) => session.reconcile(settings, &myself),
            (CoordinatorMessage::Tick, Some(session)) => session.tick(settings, &myself).await,
            (CoordinatorMessage::VotersChanged(done), Some(session)) => {
                session.handle_voters_changed(settings, done);
                // A node in decommission waits for a beacon without its name among the voters.
                session.publish_beacon(settings).await;
            }
            (CoordinatorMessage::BidsCollected { call, expected, responses }, Some(session)) => {
                session.close_bidding(settings, &myself, *call, expected, responses);
            }
            (CoordinatorMessage::AuctionRecorded { auction, outcome }, Some(session)) => {
                session.handle_auction_recorded(settings, &auction, outcome);
                session.reconcile(settings, &myself);
            }
            (CoordinatorMessage::NoticeReplied { mission, role, robot, epoch, reply }, Some(session)) => {
                if let AwardReply::Declined(why) = reply {
                    let cause = format!("{robot} declined: {why}");
                    session.release_role(settings, mission, role, &robot, epoch, cause, false);
                }
            }
            (CoordinatorMessage::Report(query), Some(session)) => session.handle_report(settings, query).await,
            (CoordinatorMessage::ActiveMissions(query), Some(session)) => {
                session.handle_active_missions(settings, query).await;
            }
            (CoordinatorMessage::Api(query), Some(session)) => session.handle_api(settings, query),
            (CoordinatorMessage::ApiRecheck(query), Some(_)) => {
                // The former coordinator may or may not have executed the request. A repeated
                // request shows it.
                reply::json(&query, &query.key, &retry_reply(String::new())).await;
            }
            // The requester may have stopped waiting.
            (CoordinatorMessage::QueryStatus(to), Some(session)) => drop(to.send(session.status(settings))),
        }
        Ok(())
    }
}

fn is_read_only(settings: &CoordinatorSettings, query: &Query) -> bool {
    matches!(settings.keys.read(&query.key), Some(Key::Api(call)) if call.is_read_only())
}

impl CoordinatorState {
    fn follow_beacon(&mut self, sample: &Sample) {
        if let Ok(beacon) = codec::decode::<Beacon>(&sample.payload)
            && beacon.node != self.settings.node
        {
            self.last_beacon = Some((beacon.node, self.settings.clock.now()));
        }
    }

    /// Leaves a request to the active coordinator, and checks it again after a short delay if this
    /// node cannot reply now.
    async fn leave_to_coordinator(&mut self, myself: &ActorRef<CoordinatorMessage>, query: Query) {
        if let Some(query) = self.reply_without_leader(query).await {
            self.tasks.send_after(RECHECK_DELAY, myself, CoordinatorMessage::ApiRecheck(query));
        }
    }

    /// Replies to a request while this node is not the coordinator, if the reply is up to this
    /// node. Otherwise returns the request.
    async fn reply_without_leader(&self, query: Query) -> Option<Query> {
        let CoordinatorSettings { node, replica, knowledge, .. } = &self.settings;
        let leadership = replica.leadership().borrow().clone();
        let now = self.settings.clock.now();
        let last_beacon = self.last_beacon.as_ref().map(|(node, at)| (node, now.since(*at)));
        if let Some(reply) = no_leader_reply(node, &leadership, knowledge, last_beacon) {
            reply::json(&query, &query.key, &reply).await;
            return None;
        }
        Some(query)
    }

    async fn follow_leadership(&mut self, myself: &ActorRef<CoordinatorMessage>) -> Result<(), BusError> {
        let leadership = self.settings.replica.leadership().borrow().clone();
        let term = leadership.is_leader.then_some(leadership.term);
        if self.session.as_ref().map(|session| session.term) == term {
            return Ok(());
        }
        if let Some(session) = self.session.take() {
            self.yielded_at = session.yielded_at();
            info!(node = %self.settings.node, term = session.term, "no longer coordinates");
            self.settings.events.publish(EventKind::SteppedDown { term: session.term });
        }
        if let Some(term) = term {
            let mut session = LeaderSession::start(&self.settings, &leadership, term, self.yielded_at, myself).await?;
            session.publish_beacon(&self.settings).await;
            session.update_members(&self.settings);
            session.reconcile(&self.settings, myself);
            self.session = Some(session);
        }
        Ok(())
    }
}
