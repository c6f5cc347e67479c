//! Inspection of a fleet: from the state of its nodes and from the world.

use crate::{Fleet, slug};
use consort_bus::LinkModel;
use consort_fleet::node::NodeHandle;
use consort_gossip::SharedKnowledge;
use consort_protocol::event::EventKind;
use consort_protocol::ids::{MissionId, NodeId, RobotId};
use consort_protocol::knowledge::RobotKnowledge;
use consort_protocol::ledger::{Ledger, MissionState};
use consort_skills::actions::RobotBackend;
use consort_world::world::{LoggedEvent, SampleHolder, WorldEvent as InWorld};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use tokio::time::Instant;

/// Returns the coordinator among these nodes. Of several nodes that count themselves leader, it is
/// the node of the latest term.
pub(crate) fn current_coordinator<'a>(nodes: impl Iterator<Item = &'a NodeHandle>) -> Option<NodeId> {
    let leads = |node: &NodeHandle| {
        let leadership = node.replica.as_ref()?.leadership().borrow().clone();
        leadership.is_leader.then(|| (leadership.term, node.node.clone()))
    };
    nodes.filter_map(leads).max().map(|(_, node)| node)
}

impl Fleet {
    /// Waits until a node coordinates and returns it.
    pub async fn wait_for_coordinator(&mut self) -> NodeId {
        self.wait_until("an election", Duration::from_secs(20), |fleet| fleet.coordinating().is_some()).await;
        self.coordinating().expect("checked before")
    }

    /// Waits until the ledger keeps an audit trail: once it has the present wire version.
    pub async fn wait_for_audit_trail(&mut self) {
        let keeps = |fleet: &Fleet| fleet.ledger(|ledger| ledger.history_limits().is_some()) == Some(true);
        self.wait_until("the present wire version", Duration::from_secs(20), keeps).await;
    }

    /// Returns the current coordinator. Of several nodes that count themselves leader, it is the
    /// node of the latest term.
    pub fn coordinating(&self) -> Option<NodeId> {
        current_coordinator(self.nodes.values())
    }

    /// Returns the names of the running nodes.
    pub fn running(&self) -> Vec<String> {
        self.nodes.keys().cloned().collect()
    }

    /// Reads the ledger of the coordinator; `None` without a coordinator.
    pub fn ledger<T>(&self, look: impl FnOnce(&Ledger) -> T) -> Option<T> {
        let coordinator = self.coordinating()?;
        Some(self.nodes[coordinator.as_str()].replica.as_ref()?.read(look))
    }

    /// Returns the state of a mission from the replica that has applied most of it.
    pub fn mission_state(&self, mission: &MissionId) -> Option<MissionState> {
        let states = self.nodes.values().filter_map(|node| {
            let read = |ledger: &Ledger| {
                let (state, entry) = (ledger.mission_state(mission)?, ledger.mission(mission));
                Some((state.is_final(), entry.map_or(0, |entry| entry.progress().0), state.clone()))
            };
            node.replica.as_ref()?.read(read)
        });
        states.max_by_key(|(over, done, _)| (*over, *done)).map(|(_, _, state)| state)
    }

    /// Returns the same state as a word.
    pub fn state(&self, mission: &MissionId) -> Option<String> {
        self.mission_state(mission).map(|state| state.as_str().to_owned())
    }

    /// Waits for the end of a mission and returns its final state.
    pub async fn wait_for_end(&mut self, mission: &MissionId) -> MissionState {
        let over = |fleet: &Fleet| fleet.mission_state(mission).filter(MissionState::is_final);
        self.wait_until(&format!("the end of {mission}"), Duration::from_secs(300), |fleet| over(fleet).is_some())
            .await;
        over(self).expect("checked before")
    }

    /// Waits until a mission completes; panics with the event log if it ends otherwise.
    pub async fn assert_completes(&mut self, mission: &MissionId) {
        let end = self.wait_for_end(mission).await;
        assert_eq!(end, MissionState::Completed, "seed {}: {mission}\n{}", self.seed, self.event_log_text());
    }

    /// Returns the holder of a role from the ledger of the coordinator.
    pub fn holder(&self, mission: &MissionId, role: &str) -> Option<RobotId> {
        let role = slug(role);
        self.ledger(|ledger| {
            ledger.mission(mission)?.roles.get(&role)?.holder.as_ref().map(|holder| holder.robot.clone())
        })?
    }

    /// Returns every robot that a role of the mission was ever assigned to.
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
                .filter(|interval| interval.mission == *mission)
                .map(|interval| interval.robot.to_string()),
        );
        robots
    }

    /// Returns all published events in order.
    pub fn events(&self) -> Vec<EventKind> {
        self.event_log.entries().iter().filter_map(|(_, entry)| entry.event_kind().cloned()).collect()
    }

    /// Checks whether an event of the kind has happened.
    pub fn has_event(&self, what: impl Fn(&EventKind) -> bool) -> bool {
        self.event_log.count(what) > 0
    }

    /// Counts, by name, how often each task of a mission began and how often it ended well.
    pub fn task_counts(&self, mission: &MissionId) -> BTreeMap<String, (usize, usize)> {
        let doers = self.event_log.task_executors(mission);
        doers.into_iter().map(|(task, (began, ended))| (task, (began.len(), ended.len()))).collect()
    }

    /// Returns the knowledge base of a node.
    pub fn knowledge(&self, node: &str) -> &SharedKnowledge {
        &self.nodes[node].knowledge
    }

    /// Returns the record of a robot in the knowledge base of a node.
    pub fn knowledge_of(&self, node: &str, robot: &NodeId) -> Option<RobotKnowledge> {
        let knowledge = &self.nodes.get(node)?.knowledge;
        knowledge.read(|base| base.get(robot)?.knowledge().robot.clone())
    }

    /// Returns the position of a simulated robot in metres.
    pub fn position(&self, robot: &str) -> (f64, f64) {
        let telemetry = self.world.telemetry(&slug(robot)).expect("a robot of this world");
        (telemetry.pose.x, telemetry.pose.y)
    }

    /// Returns the time of the simulated world in seconds.
    pub fn world_time_s(&self) -> f64 {
        self.world.with(|world| world.now().as_secs())
    }

    /// Counts the begun and the ended goals of a simulated robot from the journal of the world.
    pub fn goal_counts(&self, robot: &str) -> (usize, usize) {
        self.journal().iter().fold((0, 0), |(began, ended), entry| match &entry.event {
            InWorld::GoalStarted { robot: body, .. } if body.as_str() == robot => (began + 1, ended),
            InWorld::GoalEnded { robot: body, .. } if body.as_str() == robot => (began, ended + 1),
            _ => (began, ended),
        })
    }

    /// Waits until a simulated robot has ended all of its goals and has received the last command
    /// of its driver. A goal that is sent and canceled at once begins and ends within a few network
    /// latencies.
    pub async fn wait_for_rest(&mut self, robot: &str) {
        // Goal request, reply, cancel request, and a latency in reserve.
        let crossings = LinkModel::LAN.latency_max * 4;
        let (mut goals, mut since) = (self.goal_counts(robot), Instant::now());
        let at_rest = |fleet: &Fleet| {
            let now = fleet.goal_counts(robot);
            if now != goals {
                (goals, since) = (now, Instant::now());
            }
            now.0 == now.1 && since.elapsed() > crossings
        };
        self.wait_until(&format!("{robot} at rest"), Duration::from_secs(1), at_rest).await;
    }

    /// Returns the holder of the sample of a room.
    pub fn sample_holder(&self, room: &str) -> SampleHolder {
        let id = format!("sample of {room}").as_str().into();
        self.world.with(|world| world.sample(&id).expect("a sample of this world").holder)
    }

    /// Returns the journal of the world so far.
    pub fn journal(&self) -> &[LoggedEvent] {
        &self.journal
    }
}
