//! Allocation of the jobs of an instance on the virtual bus: a node for each robot, and one for the auctioneer.

use crate::slug;
use bytes::Bytes;
use consort_bus::{Bus, Encoding, LinkModel, VirtualBus, VirtualNetwork};
use consort_evaluation::allocation::{AllocationPolicy, Bidder, Instance, Market, Order, Prices, allocate};
use consort_protocol::codec;
use futures::future::join_all;
use std::sync::Arc;
use std::time::Duration;

/// Limit for the reply of a robot. No message is lost.
const REPLY_LIMIT: Duration = Duration::from_secs(10);

/// Allocation with its messages.
#[derive(Debug, Clone, PartialEq)]
pub struct AllocationRun {
    /// Jobs of each robot in their order.
    pub routes: Vec<Vec<usize>>,
    /// Messages between auctioneer and robots: orders and replies.
    pub messages: u64,
}

/// Allocates the jobs of an instance. The same seed gives the same messages. `orders_max` bounds the orders of
/// [`AllocationPolicy::Consort`].
pub fn allocate_on_bus(instance: &Instance, policy: AllocationPolicy, orders_max: usize, seed: u64) -> AllocationRun {
    crate::paused_runtime().block_on(async {
        let network = VirtualNetwork::new(seed, LinkModel::steady(Duration::from_millis(1)));
        let instance = Arc::new(instance.clone());
        for robot in 0..instance.robots {
            let queries = network.bus(slug(&format!("robot-{robot}"))).serve(&key(robot)).await.expect("a valid key");
            tokio::spawn(serve(Bidder::new(Arc::clone(&instance)), key(robot), queries));
        }
        let mut market = BusMarket { bus: network.bus(slug("auctioneer")) };
        let routes = allocate(&instance, policy, &mut market, orders_max, seed).await;
        AllocationRun { routes, messages: network.counters().sent }
    })
}

fn key(robot: usize) -> String {
    format!("allocation/robot-{robot}")
}

/// Executes the orders to a robot.
async fn serve(mut bidder: Bidder, key: String, mut queries: consort_bus::Stream<consort_bus::Query>) {
    while let Some(query) = queries.recv().await {
        let sent = match codec::decode::<Order>(&query.payload) {
            Ok(order) => {
                let prices = codec::encode(&bidder.execute(&order)).expect("prices are plain data");
                query.replier.reply(&key, prices.into(), Encoding::Wire).await
            }
            Err(problem) => query.replier.refuse(&problem.to_string()).await,
        };
        if sent.is_err() {
            return; // the network has ended
        }
    }
}

/// Auctioneer on the bus.
struct BusMarket {
    bus: VirtualBus,
}

impl Market for BusMarket {
    async fn ask(&mut self, orders: Vec<(usize, Order)>) -> Vec<Prices> {
        let ask = async |(robot, order): (usize, Order)| {
            let payload = Bytes::from(codec::encode(&order).expect("an order is plain data"));
            let mut replies = self.bus.query(&key(robot), payload, REPLY_LIMIT).await.expect("a valid key");
            let reply = replies.recv().await.expect("a robot replies").payload.expect("the order is valid");
            codec::decode(&reply).expect("the robot encoded it")
        };
        join_all(orders.into_iter().map(ask)).await
    }
}
