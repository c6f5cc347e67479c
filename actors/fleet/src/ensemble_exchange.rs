//! Exchange of knowledge between the members of ensembles, over the bus.
//!
//! [`KnowledgeExchange`](consort_protocol::ensemble::KnowledgeExchange) decides; this module evaluates
//! the membership, and performs its actions.

use crate::followed_coordinator::{LastBeacon, follow_beacons};
use crate::robot_driver::RobotDriver;
use crate::shared_exchanges::SharedExchanges;
use bytes::Bytes;
use consort_bus::clock::Clock;
use consort_bus::tasks::Tasks;
use consort_bus::{BusError, Delivery, Encoding, Sample, SharedBus, Stream};
use consort_gossip::SharedKnowledge;
use consort_protocol::codec;
use consort_protocol::ensemble::{Ensembles, ExchangeAction, MemberValues, VALUE_AGE_MAX};
use consort_protocol::ids::{EnsembleId, NodeId, RobotId};
use consort_protocol::keys::{Key, Keys};
use consort_protocol::knowledge::Attributes;
use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock, PoisonError};
use std::time::Duration;
use tracing::debug;

/// Interval of evaluations of the membership.
const UPDATE_INTERVAL: Duration = Duration::from_millis(250);

/// Inputs of the exchanges of a node.
pub(crate) struct EnsembleExchange {
    pub(crate) node: NodeId,
    pub(crate) keys: Keys,
    pub(crate) bus: SharedBus,
    pub(crate) clock: Clock,
    pub(crate) knowledge: SharedKnowledge,
    pub(crate) ensembles: Arc<Ensembles>,
    /// Attributes of the node's robot; `None` without a robot.
    pub(crate) attributes: Option<Attributes>,
    /// The driver of the node's robot, once it is connected.
    pub(crate) driver: Arc<OnceLock<RobotDriver>>,
    pub(crate) exchanges: SharedExchanges,
}

impl EnsembleExchange {
    /// Exchanges knowledge for as long as `tasks` lives. Without an ensemble that lists values, nothing
    /// is started.
    ///
    /// # Errors
    /// [`BusError`] if the bus is closed.
    pub(crate) async fn start(self, tasks: &mut Tasks) -> Result<(), BusError> {
        if self.exchanges.lock().is_empty() {
            return Ok(());
        }
        let latest_beacon = LastBeacon::default();
        let beacons = self.bus.subscribe(&self.keys.write(&Key::Beacon)).await?;
        tasks.spawn(follow_beacons(beacons, Arc::clone(&latest_beacon), self.clock));
        tasks.spawn(self.run(latest_beacon));
        Ok(())
    }

    async fn run(self, latest_beacon: LastBeacon) {
        // A subscription ends when its tasks are dropped.
        let mut subscriptions: BTreeMap<EnsembleId, Tasks> = BTreeMap::new();
        loop {
            for (ensemble, action) in self.update(&latest_beacon) {
                let done = match action {
                    ExchangeAction::Subscribe => self.subscribe(&ensemble).await.map(|subscription| {
                        subscriptions.insert(ensemble.clone(), subscription);
                    }),
                    ExchangeAction::Unsubscribe => {
                        subscriptions.remove(&ensemble);
                        Ok(())
                    }
                    ExchangeAction::Publish(values) => self.publish(&ensemble, &values).await,
                };
                if let Err(problem) = done {
                    debug!(%ensemble, %problem, "failed to exchange knowledge");
                }
            }
            tokio::time::sleep(UPDATE_INTERVAL).await;
        }
    }

    /// Evaluates the membership in each ensemble.
    fn update(&self, latest_beacon: &LastBeacon) -> Vec<(EnsembleId, ExchangeAction)> {
        let now = self.clock.now();
        let followed = latest_beacon.lock().unwrap_or_else(PoisonError::into_inner);
        let coordinator = followed.beacon().map_or_else(|| self.node.clone(), |beacon| beacon.node.clone());
        drop(followed);
        // The last readings of a silent driver would look recent to the other members.
        let driver = self.driver.get().filter(|driver| driver.silent_for() <= VALUE_AGE_MAX);
        let readings = driver.and_then(RobotDriver::readings).unwrap_or_default();
        let mut actions = vec![];
        for (name, exchange) in self.exchanges.lock().iter_mut() {
            let Some(ensemble) = self.ensembles.get(name) else { continue };
            let mut members = self.knowledge.read(|base| ensemble.members(&coordinator, base, now));
            members.retain(|node| *node == self.node || self.knowledge.is_alive(node));
            let values = |attributes| MemberValues::select(exchange.listed(), attributes, &readings);
            let own_values = self.attributes.as_ref().map(values);
            actions.extend(exchange.update(members, own_values, now).into_iter().map(|action| (name.clone(), action)));
        }
        actions
    }

    async fn publish(&self, ensemble: &EnsembleId, values: &MemberValues) -> Result<(), BusError> {
        let key = self.keys.write(&Key::Ensemble(ensemble.clone(), RobotId::from(self.node.clone())));
        match codec::encode(values) {
            Ok(bytes) => self.bus.publish(&key, Bytes::from(bytes), Encoding::Wire, Delivery::Drop).await,
            Err(problem) => {
                debug!(%ensemble, %problem, "the values of the robot cannot be encoded");
                Ok(())
            }
        }
    }

    /// Subscribes to the values of the members.
    async fn subscribe(&self, ensemble: &EnsembleId) -> Result<Tasks, BusError> {
        let samples = self.bus.subscribe(&self.keys.any_of_ensemble(ensemble)).await?;
        let mut tasks = Tasks::default();
        tasks.spawn(receive(samples, self.keys.clone(), self.exchanges.clone(), self.clock));
        Ok(tasks)
    }
}

/// Stores the values of members.
async fn receive(mut samples: Stream<Sample>, keys: Keys, exchanges: SharedExchanges, clock: Clock) {
    while let Some(sample) = samples.recv().await {
        let Some(Key::Ensemble(ensemble, robot)) = keys.read(&sample.key) else { continue };
        let values = codec::decode::<MemberValues>(&sample.payload).ok().filter(|values| values.check().is_ok());
        let Some(values) = values else {
            debug!(%ensemble, %robot, "dropped invalid values of a member");
            continue;
        };
        if let Some(exchange) = exchanges.lock().get_mut(&ensemble) {
            exchange.receive(robot, values, clock.now());
        }
    }
}
