use async_trait::async_trait;
use bytes::Bytes;
use consort_actors::bus::*;
use consort_protocol::ids::NodeId;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::mpsc;

#[derive(Default)]
struct State {
    next: u64,
    services: BTreeMap<u64, (NodeId, String, mpsc::UnboundedSender<Query>)>,
    cuts: BTreeSet<(NodeId, NodeId)>,
    groups: BTreeMap<NodeId, usize>,
    dead: BTreeSet<NodeId>,
}
#[derive(Clone)]
pub struct VirtualNetwork(Arc<Mutex<State>>, Arc<Mutex<ChaCha8Rng>>);
pub struct VirtualBus(VirtualNetwork, NodeId);

impl VirtualNetwork {
    pub fn new(seed: u64) -> Self {
        Self(Arc::default(), Arc::new(Mutex::new(ChaCha8Rng::seed_from_u64(seed))))
    }
    pub fn bus(&self, node: NodeId) -> VirtualBus {
        self.0.lock().unwrap().dead.remove(&node);
        VirtualBus(self.clone(), node)
    }
    pub fn crash(&self, node: &NodeId) {
        let mut s = self.0.lock().unwrap();
        s.dead.insert(node.clone());
        s.services.retain(|_, (n, _, _)| n != node);
    }
    pub fn partition(&self, groups: impl IntoIterator<Item = impl IntoIterator<Item = NodeId>>) {
        self.0.lock().unwrap().groups =
            groups.into_iter().enumerate().flat_map(|(i, g)| g.into_iter().map(move |n| (n, i))).collect();
    }
    pub fn cut(&self, from: NodeId, to: NodeId) {
        self.0.lock().unwrap().cuts.insert((from, to));
    }
    pub fn heal(&self) {
        let mut s = self.0.lock().unwrap();
        s.cuts.clear();
        s.groups.clear();
    }
    fn severed(&self, from: &NodeId, to: &NodeId) -> bool {
        let s = self.0.lock().unwrap();
        from != to
            && (s.dead.contains(from)
                || s.dead.contains(to)
                || s.groups.get(from) != s.groups.get(to)
                || s.cuts.contains(&(from.clone(), to.clone())))
    }
    fn latency(&self) -> Duration {
        Duration::from_micros(self.1.lock().unwrap().random_range(200..3000))
    }
}
struct Drops(VirtualNetwork, u64);
impl Drop for Drops {
    fn drop(&mut self) {
        self.0.0.lock().unwrap().services.remove(&self.1);
    }
}
struct Back {
    net: VirtualNetwork,
    from: NodeId,
    to: NodeId,
    tx: mpsc::UnboundedSender<Reply>,
    key: String,
}
impl Back {
    fn send(&self, reply: Reply) {
        let (net, from, to, tx) = (self.net.clone(), self.from.clone(), self.to.clone(), self.tx.clone());
        tokio::spawn(async move {
            tokio::time::sleep(net.latency()).await;
            if net.severed(&from, &to) {
                tokio::time::sleep(Duration::from_secs(60)).await;
                return;
            }
            let _ = tx.send(reply);
        });
    }
}
#[async_trait]
impl Replier for Back {
    async fn reply(&self, key: &str, payload: Bytes, _: Encoding) -> Result<(), BusError> {
        self.send(Reply { key: key.into(), payload: Ok(payload) });
        Ok(())
    }
    async fn refuse(&self, reason: &str) -> Result<(), BusError> {
        self.send(Reply { key: self.key.clone(), payload: Err(reason.into()) });
        Ok(())
    }
}
#[async_trait]
impl Bus for VirtualBus {
    async fn publish(&self, _: &str, _: Bytes, _: Encoding, _: Delivery) -> Result<(), BusError> {
        unimplemented!()
    }
    async fn subscribe(&self, _: &str) -> Result<Stream<Sample>, BusError> {
        unimplemented!()
    }
    async fn query(&self, key: &str, payload: Bytes, limit: Duration) -> Result<Stream<Reply>, BusError> {
        let (tx, rx) = mpsc::unbounded_channel();
        let (tx2, mut rx2) = mpsc::unbounded_channel();
        let net = self.0.clone();
        let me = self.1.clone();
        let key = key.to_owned();
        let expr = zenoh_keyexpr::OwnedKeyExpr::new(key.clone()).unwrap();
        let found: Vec<_> = net
            .0
            .lock()
            .unwrap()
            .services
            .values()
            .filter(|(_, k, _)| expr.intersects(zenoh_keyexpr::keyexpr::new(k).unwrap()))
            .cloned()
            .collect();
        for (node, _, service) in found {
            let (net, me, key, payload, tx2) = (net.clone(), me.clone(), key.clone(), payload.clone(), tx2.clone());
            tokio::spawn(async move {
                tokio::time::sleep(net.latency()).await;
                if net.severed(&me, &node) {
                    tokio::time::sleep(Duration::from_secs(60)).await;
                    return;
                }
                let replier = Box::new(Back { net, from: node, to: me, tx: tx2, key: key.clone() });
                let _ = service.send(Query { key, parameters: String::new(), payload, replier });
            });
        }
        drop(tx2);
        tokio::spawn(async move {
            let _ = tokio::time::timeout(limit, async {
                while let Some(r) = rx2.recv().await {
                    if tx.send(r).is_err() {
                        break;
                    }
                }
            })
            .await;
        });
        Ok(Stream::new(rx, Box::new(())))
    }
    async fn serve(&self, key: &str) -> Result<Stream<Query>, BusError> {
        let (tx, rx) = mpsc::unbounded_channel();
        let mut s = self.0.0.lock().unwrap();
        s.next += 1;
        let n = s.next;
        s.services.insert(n, (self.1.clone(), key.into(), tx));
        drop(s);
        Ok(Stream::new(rx, Box::new(Drops(self.0.clone(), n))))
    }
    async fn announce(&self, _: &str) -> Result<Token, BusError> {
        unimplemented!()
    }
    async fn watch(&self, _: &str) -> Result<Stream<Presence>, BusError> {
        unimplemented!()
    }
    async fn links(&self) -> Vec<Link> {
        vec![]
    }
}
