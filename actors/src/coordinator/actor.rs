//! The actor that coordinates while its node leads the ledger, and does nothing otherwise.

use super::leader_session::LeaderSession;
use super::no_leader::{no_leader_reply, retry_reply};
use super::rate_limit::RequestLimits;
use crate::autopilot::ActionResult;
use crate::bus::{BusError, Query, Sample, SharedBus};
use crate::clock::Clock;
use crate::events::EventPublisher;
use crate::gossip::SharedKnowledge;
use crate::raft::{ProposeError, Replica};
use crate::reply;
use crate::tasks::Tasks;
use crate::views::CoordinatorStatus;
use crate::wire_version::WireVersion;
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
use ractor::{Actor, ActorProcessingErr, ActorRef};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::time::Instant;
use tracing::info;

/// How a coordinator works. Fleet-wide but for the first few.
#[derive(Clone)]
pub struct CoordinatorSettings {
    /// This node.
    pub node: NodeId,
    /// The fleet's keys.
    pub keys: Keys,
    /// The bus.
    pub bus: SharedBus,
    /// The node's clock.
    pub clock: Clock,
    /// The node's copy of the ledger.
    pub replica: Replica<Ledger>,
    /// What the node has heard.
    pub knowledge: SharedKnowledge,
    /// Which version of the wire the node writes.
    pub wire_version: WireVersion,
    /// Where it tells what happens.
    pub events: EventPublisher,
    /// Whose members are asked for bids.
    pub ensemble: Arc<Ensemble>,
    /// The task types that missions may use.
    pub domain: Arc<Domain>,
    /// What bids must keep to.
    pub limits: BidLimits,
    /// What is taken on of all that is asked for.
    pub request_limits: RequestLimits,
    /// The rule by which roles are given to robots.
    pub allocator: Arc<dyn Allocator>,
    /// How long awards last.
    pub lease_terms: LeaseTerms,
    /// How long an auction waits for a member that does not answer. Raised: slow links still win roles, silent robots
    /// hold up everybody for longer. Default 200 ms.
    pub bid_window: Duration,
    /// After how long a held role none of whose steps ends, although it waits for nobody, is taken from its holder; zero for
    /// never. Raised: longer drives are left alone, robots that do nothing keep their roles for longer.
    pub stall_timeout: Duration,
    /// How often the coordinator says that it is there and looks after its duties. Default 250 ms.
    pub tick_interval: Duration,
    /// What the ledger's identity is drawn from, should this node be the first to coordinate.
    pub cluster_seed: u64,
    /// Voters that the autopilot aims at.
    pub voters: usize,
    /// How long a voter must be gone until the autopilot replaces it.
    pub dead_after: Duration,
    /// How long ago a voter may have answered last and still counts as there: several heartbeats.
    pub contact_timeout: Duration,
}

/// After how long a request that was left to another coordinator is looked at again: that one may have been gone already. A
/// killed node is noticed in less.
const SECOND_THOUGHT: Duration = Duration::from_millis(100);

/// To a coordinator.
pub enum CoordinatorMessage {
    /// Who leads the ledger has changed.
    Leadership,
    /// The ledger has changed.
    Ledger,
    /// Time to look after everything.
    Tick,
    /// All bids are in, or the window has closed.
    BidsCollected {
        /// The call that was answered.
        call: Box<CallForBids>,
        /// Who should have answered.
        expected: BTreeSet<RobotId>,
        /// The answers.
        responses: Vec<BidResponse>,
    },
    /// The ledger has answered to an award or a deferral.
    AuctionRecorded {
        /// Which auction.
        auction: AuctionId,
        /// What it said.
        outcome: Result<CommandOutcome, ProposeError>,
    },
    /// A robot answered a notice.
    NoticeReplied {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// Who.
        robot: RobotId,
        /// Which award.
        epoch: Epoch,
        /// What it said.
        reply: AwardReply,
    },
    /// A change of the ledger's keepers was made, or was not.
    VotersChanged(ActionResult),
    /// A robot reports.
    Report(Query),
    /// Somebody asks which missions are under way.
    ActiveMissions(Query),
    /// A coordinator says that it is there.
    Beacon(Sample),
    /// A client asks for something.
    Api(Query),
    /// A client has asked for something a moment ago, when somebody else was believed to coordinate.
    ApiRecheck(Query),
    /// Somebody looks: how does this node coordinate, if it does?
    QueryStatus(oneshot::Sender<CoordinatorStatus>),
}

/// The actor.
pub struct Coordinator;

/// State of [`Coordinator`].
pub struct CoordinatorState {
    settings: CoordinatorSettings,
    reign: Option<LeaderSession>,
    /// Who was last heard to coordinate, and when.
    heard: Option<(NodeId, NodeTime)>,
    /// When this node last gave the lead away because another was better placed.
    yielded: Option<Instant>,
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
        Ok(CoordinatorState { settings, reign: None, heard: None, yielded: None, tasks })
    }

    async fn handle(
        &self,
        myself: ActorRef<Self::Msg>,
        message: Self::Msg,
        state: &mut Self::State,
    ) -> Result<(), ActorProcessingErr> {
        let settings = &state.settings;
        match (message, &mut state.reign) {
            (CoordinatorMessage::Leadership, _) => state.follow_leadership(&myself).await?,
            (CoordinatorMessage::Beacon(sample), _) => state.hear_of_another(&sample),
            // Any node answers those that change nothing: see `views`.
            (CoordinatorMessage::Api(query), _) if changes_nothing(settings, &query) => {}
            (CoordinatorMessage::Api(query), None) => state.leave_to_another(&myself, query).await,
            (CoordinatorMessage::ApiRecheck(query), None) => drop(state.put_off(query).await),
            (_, None) => {} // of a reign that is over
            (CoordinatorMessage::Ledger, Some(reign)) => reign.reconcile(settings, &myself),
            (CoordinatorMessage::Tick, Some(reign)) => reign.tick(settings, &myself).await,
            (CoordinatorMessage::VotersChanged(done), Some(reign)) => {
                reign.handle_voters_changed(settings, done);
                // Whoever leaves waits to hear that nobody counts on it any more.
                reign.publish_beacon(settings).await;
            }
            (CoordinatorMessage::BidsCollected { call, expected, responses: tenders }, Some(reign)) => {
                reign.close_bidding(settings, &myself, *call, expected, tenders);
            }
            (CoordinatorMessage::AuctionRecorded { auction, outcome }, Some(reign)) => {
                reign.handle_auction_recorded(settings, &auction, outcome);
                reign.reconcile(settings, &myself);
            }
            (CoordinatorMessage::NoticeReplied { mission, role, robot, epoch, reply: answer }, Some(reign)) => {
                if let AwardReply::Declined(why) = answer {
                    let cause = format!("{robot} declined: {why}");
                    reign.release_role(settings, mission, role, &robot, epoch, cause, false);
                }
            }
            (CoordinatorMessage::Report(query), Some(reign)) => reign.handle_report(settings, query).await,
            (CoordinatorMessage::ActiveMissions(query), Some(reign)) => {
                reign.handle_active_missions(settings, query).await
            }
            (CoordinatorMessage::Api(query), Some(reign)) => reign.handle_api(settings, query),
            (CoordinatorMessage::ApiRecheck(query), Some(_)) => {
                // Whether the former coordinator has carried it out, only the same request again can tell.
                reply::json(&query, &query.key, &retry_reply(String::new())).await;
            }
            // Whoever looked may have given up.
            (CoordinatorMessage::QueryStatus(to), Some(reign)) => drop(to.send(reign.status(settings))),
        }
        Ok(())
    }
}

fn changes_nothing(settings: &CoordinatorSettings, query: &Query) -> bool {
    matches!(settings.keys.read(&query.key), Some(Key::Api(call)) if call.is_read_only())
}

impl CoordinatorState {
    fn hear_of_another(&mut self, sample: &Sample) {
        if let Ok(beacon) = codec::decode::<Beacon>(&sample.payload)
            && beacon.node != self.settings.node
        {
            self.heard = Some((beacon.node, self.settings.clock.now()));
        }
    }

    /// Leaves a request to whoever coordinates, and looks at it again in a moment if this node has nothing to say to it now.
    async fn leave_to_another(&mut self, myself: &ActorRef<CoordinatorMessage>, query: Query) {
        if let Some(query) = self.put_off(query).await {
            self.tasks.send_after(SECOND_THOUGHT, myself, CoordinatorMessage::ApiRecheck(query));
        }
    }

    /// Answers a request while this node does not coordinate, if it is for this node to answer; else gives it back.
    async fn put_off(&self, query: Query) -> Option<Query> {
        let CoordinatorSettings { node, replica, knowledge, .. } = &self.settings;
        let leadership = replica.leadership().borrow().clone();
        let now = self.settings.clock.now();
        let heard = self.heard.as_ref().map(|(node, at)| (node, now.since(*at)));
        if let Some(said) = no_leader_reply(node, &leadership, knowledge, heard) {
            reply::json(&query, &query.key, &said).await;
            return None;
        }
        Some(query)
    }

    async fn follow_leadership(&mut self, myself: &ActorRef<CoordinatorMessage>) -> Result<(), BusError> {
        let leadership = self.settings.replica.leadership().borrow().clone();
        let term = leadership.is_leader.then_some(leadership.term);
        if self.reign.as_ref().map(|reign| reign.term) == term {
            return Ok(());
        }
        if let Some(reign) = self.reign.take() {
            self.yielded = reign.yielded_at();
            info!(node = %self.settings.node, term = reign.term, "no longer coordinates");
            self.settings.events.publish(EventKind::SteppedDown { term: reign.term });
        }
        if let Some(term) = term {
            let mut reign = LeaderSession::start(&self.settings, &leadership, term, self.yielded, myself).await?;
            reign.publish_beacon(&self.settings).await;
            reign.update_members(&self.settings);
            reign.reconcile(&self.settings, myself);
            self.reign = Some(reign);
        }
        Ok(())
    }
}
