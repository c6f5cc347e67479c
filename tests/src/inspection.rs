//! How things stand, looked at from inside and from the world.

use crate::{Fleet, slug};
use consort_actors::bus::LinkModel;
use consort_actors::gossip::SharedKnowledge;
use consort_actors::node::NodeHandle;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, RobotId};
use consort_protocol::knowledge::RobotKnowledge;
use consort_protocol::ledger::{Ledger, MissionState};
use consort_sim::world::{LoggedEvent, SampleHolder, WorldEvent as InWorld};
use consort_skills::actions::RobotBackend;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::time::Instant;

/// Who of these coordinates: of several who believe that they do, the latest elected.
pub(crate) fn current_coordinator<'a>(nodes: impl Iterator<Item = &'a NodeHandle>) -> Option<NodeId> {
    let leads = |node: &NodeHandle| {
        let leadership = node.replica.as_ref()?.leadership().borrow().clone();
        leadership.is_leader.then(|| (leadership.term, node.node.clone()))
    };
    nodes.filter_map(leads).max().map(|(_, node)| node)
}

impl Fleet {
    /// Waits until somebody coordinates, and says who.
    pub async fn wait_for_coordinator(&mut self) -> NodeId {
        self.wait_until("an election", Duration::from_secs(20), |fleet| fleet.coordinating().is_some()).await;
        self.coordinating().expect("just seen")
    }

    /// Who coordinates at this moment: of several who believe that they do, the latest elected.
    pub fn coordinating(&self) -> Option<NodeId> {
        current_coordinator(self.nodes.values())
    }

    /// The names of the nodes that run.
    pub fn running(&self) -> Vec<String> {
        self.nodes.keys().cloned().collect()
    }

    /// What the coordinator's ledger says; `None` while nobody coordinates.
    pub fn ledger<T>(&self, look: impl FnOnce(&Ledger) -> T) -> Option<T> {
        let coordinator = self.coordinating()?;
        Some(self.nodes[coordinator.as_str()].replica.as_ref()?.read(look))
    }

    /// How a mission stands, as the ledger of that node says which has come furthest.
    pub fn mission_state(&self, mission: &MissionId) -> Option<MissionState> {
        let states = self.nodes.values().filter_map(|node| {
            let read = |ledger: &Ledger| {
                let entry = ledger.mission(mission)?;
                Some((entry.state.is_final(), entry.progress().0, entry.state.clone()))
            };
            node.replica.as_ref()?.read(read)
        });
        states.max_by_key(|(over, done, _)| (*over, *done)).map(|(_, _, state)| state)
    }

    /// The same in one word.
    pub fn state(&self, mission: &MissionId) -> Option<String> {
        self.mission_state(mission).map(|state| state.as_str().to_owned())
    }

    /// Waits for the end of a mission and says how it ended.
    pub async fn wait_for_end(&mut self, mission: &MissionId) -> MissionState {
        let over = |fleet: &Fleet| fleet.mission_state(mission).filter(MissionState::is_final);
        self.wait_until(&format!("the end of {mission}"), Duration::from_secs(300), |fleet| over(fleet).is_some())
            .await;
        over(self).expect("just seen")
    }

    /// Waits until missions are completed; tells the whole tale if one ends otherwise.
    pub async fn assert_completes(&mut self, mission: &MissionId) {
        let end = self.wait_for_end(mission).await;
        assert_eq!(end, MissionState::Completed, "seed {}: {mission}\n{}", self.seed, self.event_log_text());
    }

    /// Who holds a role of a mission, as the coordinator's ledger says.
    pub fn holder(&self, mission: &MissionId, role: &str) -> Option<RobotId> {
        let role = slug(role);
        self.ledger(|ledger| {
            ledger.mission(mission)?.roles.get(&role)?.holder.as_ref().map(|holder| holder.robot.clone())
        })?
    }

    /// Every robot to which a role of the mission was ever given.
    pub fn all_holders(&self, mission: &MissionId) -> BTreeSet<String> {
        let mut robots: BTreeSet<String> = self
            .ledger(|ledger| ledger.mission(mission).map(|entry| entry.holders()))
            .flatten()
            .into_iter()
            .flatten()
            .map(|(_, robot)| robot.to_string())
            .collect();
        for what in self.events() {
            if let EventKind::Awarded { mission: of, holders, .. } = what
                && of == *mission
            {
                robots.extend(holders.into_values().map(|robot| robot.to_string()));
            }
        }
        robots.extend(
            self.event_log
                .role_intervals()
                .into_iter()
                .filter(|spell| spell.mission == *mission)
                .map(|spell| spell.robot.to_string()),
        );
        robots
    }

    /// All that nodes told, in order.
    pub fn events(&self) -> Vec<EventKind> {
        self.event_log.entries().iter().filter_map(|(_, entry)| entry.event_kind().cloned()).collect()
    }

    /// Whether something of the kind has happened.
    pub fn has_event(&self, what: impl Fn(&EventKind) -> bool) -> bool {
        self.event_log.count(what) > 0
    }

    /// How often each task of a mission was begun and ended well, by name.
    pub fn task_counts(&self, mission: &MissionId) -> BTreeMap<String, (usize, usize)> {
        let doers = self.event_log.task_executors(mission);
        doers.into_iter().map(|(task, (began, ended))| (task, (began.len(), ended.len()))).collect()
    }

    /// What a node has heard.
    pub fn knowledge(&self, node: &str) -> &SharedKnowledge {
        &self.nodes[node].knowledge
    }

    /// What a node knows of a robot.
    pub fn knowledge_of(&self, node: &str, robot: &NodeId) -> Option<RobotKnowledge> {
        let knowledge = &self.nodes.get(node)?.knowledge;
        knowledge.read(|base| base.get(robot)?.record.knowledge.robot.clone())
    }

    /// Where a robot's body is, in metres.
    pub fn position(&self, robot: &str) -> (f64, f64) {
        let telemetry = self.world.telemetry(&slug(robot)).expect("a body of this world");
        (telemetry.pose.x, telemetry.pose.y)
    }

    /// How many goals a robot's body has begun and ended, as the world's own journal says.
    pub fn goal_counts(&self, robot: &str) -> (usize, usize) {
        self.journal().iter().fold((0, 0), |(began, ended), entry| match &entry.event {
            InWorld::GoalStarted { robot: body, .. } if body.as_str() == robot => (began + 1, ended),
            InWorld::GoalEnded { robot: body, .. } if body.as_str() == robot => (began, ended + 1),
            _ => (began, ended),
        })
    }

    /// Waits until a robot's body has ended all that it has begun, and what its driver last said has reached it: a goal that was
    /// sent and canceled at once begins and ends within some crossings of the network.
    pub async fn wait_for_rest(&mut self, robot: &str) {
        // The order to begin, its answer, the order to end; and some more.
        let crossings = LinkModel::LAN.latency_max * 4;
        let (mut goals, mut since) = (self.goal_counts(robot), Instant::now());
        let at_rest = |fleet: &Fleet| {
            let now = fleet.goal_counts(robot);
            if now != goals {
                (goals, since) = (now, Instant::now());
            }
            now.0 == now.1 && since.elapsed() > crossings
        };
        self.wait_until(&format!("the body of {robot} to be at rest"), Duration::from_secs(1), at_rest).await;
    }

    /// Who has the sample of a room.
    pub fn sample_holder(&self, room: &str) -> SampleHolder {
        let id = format!("sample of {room}").as_str().into();
        self.world.with(|world| world.sample(&id).expect("a sample of this world").keeper)
    }

    /// What happened in the world so far.
    pub fn journal(&self) -> &[LoggedEvent] {
        &self.journal
    }
}
