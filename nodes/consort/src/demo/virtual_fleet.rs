//! The whole fleet in this process, on virtual time.

use super::fleet::DemoFleet;
use super::scenario::DemoScenario;
use crate::exit::Failure;
use crate::rendering::RenderFlags;
use crate::wiring::{self, NodeIncarnation, SkillResources};
use consort_bus::clock::Clock;
use consort_bus::{LinkModel, SharedBus, VirtualNetwork};
use consort_fleet::node::{NodeHandle, NodeSettings};
use consort_protocol::ids::NodeId;
use consort_raft::store::NodeStore;
use consort_skills::extensions::Extensions;
use consort_text::count;
use consort_world::SharedWorld;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// A fleet on virtual time.
pub(super) struct VirtualFleet {
    network: VirtualNetwork,
    client: SharedBus,
    scenario: DemoScenario,
    extensions: Extensions,
    equipment: SkillResources,
    nodes: BTreeMap<NodeId, NodeHandle>,
    world: SharedWorld,
    started: Instant,
    seed: u64,
    incarnations: u64,
}

impl VirtualFleet {
    /// Starts every node of the scenario, and the requested recordings of its world.
    pub(super) async fn start(
        scenario: &DemoScenario,
        seed: u64,
        render: &RenderFlags,
        extensions: Extensions,
    ) -> Result<VirtualFleet, Failure> {
        let network = VirtualNetwork::new(seed, LinkModel::LAN);
        let client = network.bus(NodeId::new("onlooker").expect("a slug"));
        let (world, shared) =
            wiring::world_node(&scenario.world, &scenario.fleet, incarnation(seed, 1, 0), extensions)?;
        render.start_recording(&shared)?;
        let mut fleet = VirtualFleet {
            client: Arc::new(client),
            network,
            scenario: scenario.clone(),
            extensions,
            equipment: wiring::fleet_skill_resources(&scenario.fleet, None, extensions)?,
            nodes: BTreeMap::new(),
            world: shared,
            started: Instant::now(),
            seed,
            incarnations: 1,
        };
        fleet.instantiate(world).await?;
        for node in scenario.voters() {
            fleet.restart(&node).await?;
        }
        Ok(fleet)
    }

    /// Returns the world, for inspection.
    pub(super) fn world(&self) -> SharedWorld {
        self.world.clone()
    }

    fn incarnation(&mut self) -> NodeIncarnation {
        self.incarnations += 1;
        let origin = u64::try_from(self.started.elapsed().as_millis()).unwrap_or(u64::MAX);
        incarnation(self.seed, self.incarnations, origin)
    }

    async fn instantiate(&mut self, settings: NodeSettings) -> Result<(), Failure> {
        let name = settings.node.clone();
        let bus = Arc::new(self.network.bus(name.clone()));
        let node = NodeHandle::start(settings, bus).await;
        let node = node.map_err(|problem| Failure::Unsuccessful(format!("{name} did not start: {problem}")))?;
        self.nodes.insert(name, node);
        Ok(())
    }
}

impl DemoFleet for VirtualFleet {
    fn bus(&self) -> SharedBus {
        Arc::clone(&self.client)
    }

    fn description(&self) -> String {
        let speed = self.scenario.world.speed;
        let nodes = count(self.nodes.len(), "node", "nodes");
        format!("{nodes} in this process, on virtual time ({speed} world seconds a second)")
    }

    async fn kill(&mut self, node: &NodeId) -> Result<(), Failure> {
        self.network.crash(node);
        if let Some(node) = self.nodes.remove(node) {
            node.kill().await;
        }
        Ok(())
    }

    async fn restart(&mut self, node: &NodeId) -> Result<(), Failure> {
        let incarnation = self.incarnation();
        let robot = self.scenario.robots.iter().find(|robot| robot.name.as_str() == node.as_str());
        let settings = match robot {
            Some(robot) => {
                wiring::robot_node_with(&self.equipment, robot, &self.scenario.fleet, incarnation, self.extensions)?
            }
            None => {
                let station = self.scenario.stations.iter().find(|station| station.name == *node);
                let station = station.ok_or_else(|| Failure::Unsuccessful(format!("{node} is not in the scenario")))?;
                wiring::station_node(station, &self.scenario.fleet, incarnation, self.extensions)?
            }
        };
        self.instantiate(settings).await
    }

    fn unexpected_exit(&mut self) -> Option<String> {
        None
    }

    async fn interrupted(&mut self) {
        // A run is shorter than the reaction time of a user; the signal's default action ends the
        // process.
        std::future::pending::<()>().await;
    }

    async fn shut_down(self) {
        for node in self.nodes.into_values() {
            node.kill().await;
        }
    }

    fn elapsed(&self) -> Duration {
        self.started.elapsed()
    }
}

/// Returns the incarnation with this number, which begins `origin` milliseconds after the fleet was
/// started.
fn incarnation(seed: u64, number: u64, origin: u64) -> NodeIncarnation {
    let seed = seed.wrapping_mul(1_000_003).wrapping_add(number);
    NodeIncarnation { clock: Clock::virtual_at(origin), incarnation: number, seed, store: NodeStore::in_memory(seed) }
}
