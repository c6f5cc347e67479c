//! The actor that coordinates while its node leads the ledger, and does nothing otherwise.

use super::intake::IntakeLimits;
use super::interregnum::{nobody_yet, retry};
use super::reign::Reign;
use crate::answer;
use crate::autopilot::Done;
use crate::bus::{BusError, Query, Sample, SharedBus};
use crate::clock::Clock;
use crate::events::Events;
use crate::gossip::SharedKnowledge;
use crate::replica::{ProposeError, Replica};
use crate::tasks::Tasks;
use crate::views::Shown;
use crate::wire::Wire;
use consort_protocol::auction::{AuctionId, CallForBids, Choice, Limits, Tender};
use consort_protocol::codec;
use consort_protocol::ensemble::Ensemble;
use consort_protocol::event::Happening;
use consort_protocol::ids::{MissionId, NodeId, RobotId, RoleId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::lease::{Epoch, LeaseTerms};
use consort_protocol::ledger::{Ledger, Outcome};
use consort_protocol::message::{AwardAnswer, Beacon};
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
    pub wire: Wire,
    /// Where it tells what happens.
    pub events: Events,
    /// Whose members are asked for bids.
    pub ensemble: Arc<Ensemble>,
    /// The task types that missions may use.
    pub domain: Arc<Domain>,
    /// What bids must keep to.
    pub limits: Limits,
    /// What is taken on of all that is asked for.
    pub intake: IntakeLimits,
    /// The rule by which roles are given to robots.
    pub choice: Arc<dyn Choice>,
    /// How long awards last.
    pub terms: LeaseTerms,
    /// How long an auction waits for a member that does not answer. Raised: slow links still win roles, silent robots
    /// hold up everybody for longer. Default 200 ms.
    pub window: Duration,
    /// After how long a held role none of whose steps ends, although it waits for nobody, is taken from its holder; zero for
    /// never. Raised: longer drives are left alone, robots that do nothing keep their roles for longer.
    pub stall_after: Duration,
    /// How often the coordinator says that it is there and looks after its duties. Default 250 ms.
    pub beat: Duration,
    /// What the ledger's identity is drawn from, should this node be the first to coordinate.
    pub cluster_seed: u64,
    /// Voters that the autopilot aims at.
    pub voters: usize,
    /// How long a voter must be gone until the autopilot replaces it.
    pub dead_after: Duration,
    /// How long ago a voter may have answered last and still counts as there: several heartbeats.
    pub near: Duration,
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
    Beat,
    /// All bids are in, or the window has closed.
    Closed {
        /// The call that was answered.
        call: Box<CallForBids>,
        /// Who should have answered.
        expected: BTreeSet<RobotId>,
        /// The answers.
        tenders: Vec<Tender>,
    },
    /// The ledger has answered to an award or a deferral.
    Decided {
        /// Which auction.
        auction: AuctionId,
        /// What it said.
        outcome: Result<Outcome, ProposeError>,
    },
    /// A robot answered a notice.
    Noticed {
        /// The mission.
        mission: MissionId,
        /// The role.
        role: RoleId,
        /// Who.
        robot: RobotId,
        /// Which award.
        epoch: Epoch,
        /// What it said.
        answer: AwardAnswer,
    },
    /// A change of the ledger's keepers was made, or was not.
    Keepers(Done),
    /// A robot reports.
    Report(Query),
    /// Somebody asks which missions are under way.
    Live(Query),
    /// A coordinator says that it is there.
    Beacon(Sample),
    /// A client asks for something.
    Api(Query),
    /// A client has asked for something a moment ago, when somebody else was believed to coordinate.
    Unanswered(Query),
    /// Somebody looks: how does this node coordinate, if it does?
    Show(oneshot::Sender<Shown>),
}

/// The actor.
pub struct Coordinator;

/// State of [`Coordinator`].
pub struct CoordinatorState {
    settings: CoordinatorSettings,
    reign: Option<Reign>,
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
        tasks.beat(settings.beat, &myself, || CoordinatorMessage::Beat);
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
            (CoordinatorMessage::Unanswered(query), None) => drop(state.put_off(query).await),
            (_, None) => {} // of a reign that is over
            (CoordinatorMessage::Ledger, Some(reign)) => reign.attend(settings, &myself),
            (CoordinatorMessage::Beat, Some(reign)) => reign.beat(settings, &myself).await,
            (CoordinatorMessage::Keepers(done), Some(reign)) => {
                reign.keepers_changed(settings, done);
                // Whoever leaves waits to hear that nobody counts on it any more.
                reign.say_so(settings).await;
            }
            (CoordinatorMessage::Closed { call, expected, tenders }, Some(reign)) => {
                reign.close(settings, &myself, *call, expected, tenders);
            }
            (CoordinatorMessage::Decided { auction, outcome }, Some(reign)) => {
                reign.decided(settings, &auction, outcome);
                reign.attend(settings, &myself);
            }
            (CoordinatorMessage::Noticed { mission, role, robot, epoch, answer }, Some(reign)) => {
                if let AwardAnswer::Declined(why) = answer {
                    let cause = format!("{robot} declined: {why}");
                    reign.give_up(settings, mission, role, &robot, epoch, cause, false);
                }
            }
            (CoordinatorMessage::Report(query), Some(reign)) => reign.report(settings, query).await,
            (CoordinatorMessage::Live(query), Some(reign)) => reign.live(settings, query).await,
            (CoordinatorMessage::Api(query), Some(reign)) => reign.api(settings, query),
            (CoordinatorMessage::Unanswered(query), Some(_)) => {
                // Whether the former coordinator has carried it out, only the same request again can tell.
                answer::json(&query, &query.key, &retry(String::new())).await;
            }
            // Whoever looked may have given up.
            (CoordinatorMessage::Show(to), Some(reign)) => drop(to.send(reign.show(settings))),
        }
        Ok(())
    }
}

fn changes_nothing(settings: &CoordinatorSettings, query: &Query) -> bool {
    matches!(settings.keys.read(&query.key), Some(Key::Api(call)) if call.is_reading())
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
            self.tasks.after(SECOND_THOUGHT, myself, CoordinatorMessage::Unanswered(query));
        }
    }

    /// Answers a request while this node does not coordinate, if it is for this node to answer; else gives it back.
    async fn put_off(&self, query: Query) -> Option<Query> {
        let CoordinatorSettings { node, replica, knowledge, .. } = &self.settings;
        let leadership = replica.leadership().borrow().clone();
        let now = self.settings.clock.now();
        let heard = self.heard.as_ref().map(|(node, at)| (node, now.since(*at)));
        if let Some(said) = nobody_yet(node, &leadership, knowledge, heard) {
            answer::json(&query, &query.key, &said).await;
            return None;
        }
        Some(query)
    }

    async fn follow_leadership(&mut self, myself: &ActorRef<CoordinatorMessage>) -> Result<(), BusError> {
        let leadership = self.settings.replica.leadership().borrow().clone();
        let term = leadership.is_me.then_some(leadership.term);
        if self.reign.as_ref().map(|reign| reign.term) == term {
            return Ok(());
        }
        if let Some(reign) = self.reign.take() {
            self.yielded = reign.yielded();
            info!(node = %self.settings.node, term = reign.term, "no longer coordinates");
            self.settings.events.tell(Happening::SteppedDown { term: reign.term });
        }
        if let Some(term) = term {
            let mut reign = Reign::begin(&self.settings, &leadership, term, self.yielded, myself).await?;
            reign.say_so(&self.settings).await;
            reign.follow_members(&self.settings);
            reign.attend(&self.settings, myself);
            self.reign = Some(reign);
        }
        Ok(())
    }
}
