//! A node on the ROS 2 graph with messages of any type, in the format of `rmw_zenoh`.
//!
//! ```text
//!  key of a topic or service   {domain}/{name}/{type}/{hash}
//!  token of an endpoint        @ros2_lv/{domain}/{session}/{node}/{id}/{kind}/{enclave}/{ns}/{node}/{name}/{type}/{hash}/{qos}
//! ```
//!
//! The tokens of all nodes are the graph: they tell which endpoints exist, with their types and
//! hashes. A type with an unknown hash is requested from the node of the endpoint.

use super::cdr::{self, CdrError};
use super::types::{TypeError, TypeRegistry, dds_name, ros_name};
use crate::ros::RosError;
use hiroz::attachment::Attachment;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicI64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::sync::watch;
use tracing::{debug, warn};
use zenoh::bytes::ZBytes;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::query::{ConsolidationMode, QueryTarget, ReplyKeyExpr};
use zenoh::sample::{Sample, SampleKind};

/// Time limit of a request for the definition of a type.
const DESCRIPTION_TIMEOUT: Duration = Duration::from_secs(3);

/// Quality of service in tokens: reliable, volatile, depth 10.
const QOS: &str = "::,10:,:,:,,";

/// The service of a node that describes types.
const DESCRIBES: &str = "type_description_interfaces/srv/GetTypeDescription";

/// Kind of an endpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum EndpointKind {
    /// Publisher of a topic.
    Publisher,
    /// Subscription of a topic.
    Subscription,
    /// Server of a service.
    Server,
    /// Client of a service.
    Client,
}

impl EndpointKind {
    fn of_token(text: &str) -> Option<EndpointKind> {
        Some(match text {
            "MP" => EndpointKind::Publisher,
            "MS" => EndpointKind::Subscription,
            "SS" => EndpointKind::Server,
            "SC" => EndpointKind::Client,
            _ => return None,
        })
    }

    fn token(self) -> &'static str {
        match self {
            EndpointKind::Publisher => "MP",
            EndpointKind::Subscription => "MS",
            EndpointKind::Server => "SS",
            EndpointKind::Client => "SC",
        }
    }
}

/// An endpoint on the graph.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Endpoint {
    /// Topic or service, with a leading slash.
    pub name: String,
    /// Kind.
    pub kind: EndpointKind,
    /// Type, as `std_msgs/msg/Bool`.
    pub type_name: String,
    /// RIHS01 hash of the type.
    pub hash: String,
    /// Its node, with the namespace and a leading slash.
    pub node: String,
}

/// A part of the graph.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Entity {
    Node(String),
    Endpoint(Endpoint),
}

/// Reads a token.
fn parse_token(token: &str) -> Option<Entity> {
    let parts: Vec<&str> = token.split('/').collect();
    let name = |part: &str| if part == "%" { String::new() } else { part.replace('%', "/") };
    let node = || Some(format!("{}/{}", name(parts.get(7)?).trim_end_matches('/'), name(parts.get(8)?)));
    match *parts.get(5)? {
        "NN" => Some(Entity::Node(node()?)),
        kind => Some(Entity::Endpoint(Endpoint {
            kind: EndpointKind::of_token(kind)?,
            name: name(parts.get(9)?),
            type_name: ros_name(&name(parts.get(10)?)),
            hash: (*parts.get(11)?).to_owned(),
            node: node()?,
        })),
    }
}

/// A request to a service failed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CallError {
    /// No server of the service is on the graph.
    #[error("no node offers the service {0}")]
    NotServed(String),
    /// The server did not reply in time, or is gone.
    #[error("no reply of the service {0}")]
    NoReply(String),
    /// The service has another type.
    #[error("the service {name} has the type {found}; expected {expected}")]
    OtherType {
        /// The service.
        name: String,
        /// Its type.
        found: String,
        /// The expected type.
        expected: String,
    },
    /// A message does not fit its type.
    #[error(transparent)]
    Message(#[from] CdrError),
    /// Zenoh refused the request.
    #[error(transparent)]
    Ros(#[from] RosError),
}

impl From<TypeError> for CallError {
    fn from(error: TypeError) -> CallError {
        CallError::Message(error.into())
    }
}

/// A received message.
#[derive(Debug, Clone, PartialEq)]
pub struct Received {
    /// Number of the subscription.
    pub subscription: usize,
    /// The message, or the problem that it cannot be read.
    pub message: Result<Value, String>,
}

/// Settings of the session.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GraphSettings {
    /// Routers of `rmw_zenoh` to connect to.
    pub routers: Vec<String>,
    /// `ROS_DOMAIN_ID`.
    pub domain: usize,
    /// Name of the own node.
    pub node: String,
    /// Namespace of the own node, with a leading slash; empty for none.
    pub namespace: String,
}

/// Name and hash of a type.
type TypeId = (String, String);

/// A node on the graph. Dropping it removes the node.
pub struct Graph {
    session: zenoh::Session,
    settings: GraphSettings,
    next_id: AtomicUsize,
    sequence: AtomicI64,
    entities: Arc<Mutex<BTreeMap<String, Entity>>>,
    changes: watch::Receiver<u64>,
    types: Mutex<BTreeMap<TypeId, Arc<TypeRegistry>>>,
    known: TypeRegistry,
    /// Token of the own node.
    node: Mutex<Option<LivelinessToken>>,
    /// The own publishers, by key.
    publishers: Mutex<BTreeMap<String, OwnPublisher>>,
    _graph: Subscriber<()>,
}

/// A publisher of this node.
struct OwnPublisher {
    _token: LivelinessToken,
    gid: [u8; 16],
    /// Number of its last message: subscribers count the messages that they miss.
    sequence: i64,
}

impl std::fmt::Debug for Graph {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Graph").field("settings", &self.settings).finish_non_exhaustive()
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Graph {
    /// Joins the graph with a node. `types` are the known definitions.
    ///
    /// # Errors
    /// [`RosError`] if the session cannot be opened.
    pub async fn join(settings: GraphSettings, types: TypeRegistry) -> Result<Graph, RosError> {
        let failed = |problem| RosError::of("join the graph", problem);
        // The settings of the nodes of `rmw_zenoh`: the router may start later.
        let mut config = hiroz::config::session_config().map_err(failed)?;
        for (key, value) in
            [("connect/endpoints", json!(settings.routers)), ("listen/endpoints", json!(["tcp/127.0.0.1:0"]))]
        {
            config.insert_json5(key, &value.to_string()).map_err(failed)?;
        }
        let session = zenoh::open(config).await.map_err(failed)?;
        let entities: Arc<Mutex<BTreeMap<String, Entity>>> = Arc::default();
        let (change, changes) = watch::channel(0);
        let seen = Arc::clone(&entities);
        let graph = session
            .liveliness()
            .declare_subscriber(format!("@ros2_lv/{}/**", settings.domain))
            .history(true)
            .callback(move |sample: Sample| {
                let token = sample.key_expr().as_str();
                match (sample.kind(), parse_token(token)) {
                    (SampleKind::Put, Some(entity)) => drop(locked(&seen).insert(token.to_owned(), entity)),
                    (SampleKind::Put, None) => debug!(token, "unreadable token on the graph"),
                    (SampleKind::Delete, _) => drop(locked(&seen).remove(token)),
                }
                change.send_modify(|count| *count += 1);
            })
            .await
            .map_err(failed)?;
        let graph = Graph {
            session,
            settings,
            next_id: AtomicUsize::new(1),
            sequence: AtomicI64::new(1),
            entities,
            changes,
            types: Mutex::default(),
            known: types,
            node: Mutex::default(),
            publishers: Mutex::default(),
            _graph: graph,
        };
        let node = graph.declare_token(graph.token_prefix("NN", 0)).await?;
        *locked(&graph.node) = Some(node);
        Ok(graph)
    }

    /// Returns the prefix of a token of this node.
    fn token_prefix(&self, kind: &str, id: usize) -> String {
        let GraphSettings { domain, node, namespace, .. } = &self.settings;
        let namespace = if namespace.is_empty() { "%".to_owned() } else { namespace.replace('/', "%") };
        format!("@ros2_lv/{domain}/{}/0/{id}/{kind}/%/{namespace}/{node}", self.session.zid())
    }

    async fn declare_token(&self, token: String) -> Result<LivelinessToken, RosError> {
        let failed = |problem| RosError::of(format!("declare {token}"), problem);
        self.session.liveliness().declare_token(token.clone()).await.map_err(failed)
    }

    /// Shows an own endpoint on the graph until its token is dropped.
    async fn declare(
        &self,
        kind: EndpointKind,
        name: &str,
        type_name: &str,
        hash: &str,
    ) -> Result<LivelinessToken, RosError> {
        let id = self.next_id.fetch_add(1, Ordering::Relaxed);
        let prefix = self.token_prefix(kind.token(), id);
        let token = format!("{prefix}/{}/{}/{hash}/{QOS}", name.replace('/', "%"), dds_name(type_name));
        self.declare_token(token).await
    }

    /// Returns the name of a topic, a service or an action with the namespace.
    pub fn resolve(&self, name: &str) -> String {
        match name.starts_with('/') {
            true => name.to_owned(),
            false => format!("{}/{name}", self.settings.namespace),
        }
    }

    /// Returns the endpoints of other nodes, in order.
    pub fn endpoints(&self) -> Vec<Endpoint> {
        let own = self.session.zid().to_string();
        let entities = locked(&self.entities);
        let others = entities.iter().filter(|(token, _)| token.split('/').nth(2) != Some(own.as_str()));
        let mut endpoints: Vec<Endpoint> = others
            .filter_map(|(_, entity)| match entity {
                Entity::Endpoint(endpoint) => Some(endpoint.clone()),
                Entity::Node(_) => None,
            })
            .collect();
        endpoints.sort();
        endpoints
    }

    /// Returns the other nodes, in order; a name occurs as often as nodes have it.
    pub fn nodes(&self) -> Vec<String> {
        let own = self.session.zid().to_string();
        let entities = locked(&self.entities);
        let others = entities.iter().filter(|(token, _)| token.split('/').nth(2) != Some(own.as_str()));
        let mut nodes: Vec<String> = others
            .filter_map(|(_, entity)| match entity {
                Entity::Node(node) => Some(node.clone()),
                Entity::Endpoint(_) => None,
            })
            .collect();
        nodes.sort();
        nodes
    }

    /// Waits until the graph fulfils a condition, or the time has passed. Returns whether it does.
    pub async fn wait_for(&self, limit: Duration, holds: impl Fn(&Graph) -> bool) -> bool {
        let mut changes = self.changes.clone();
        let wait = async {
            while !holds(self) {
                if changes.changed().await.is_err() {
                    return;
                }
            }
        };
        tokio::time::timeout(limit, wait).await.is_ok()
    }

    /// Returns an endpoint of another node.
    pub fn find(&self, kind: EndpointKind, name: &str) -> Option<Endpoint> {
        self.endpoints().into_iter().find(|endpoint| endpoint.kind == kind && endpoint.name == name)
    }

    /// Returns the definitions with which a message of this type and hash is read: the known ones, or
    /// those that a node describes.
    ///
    /// # Errors
    /// [`CallError`] if the hash is not that of the known definition, and no node describes it.
    pub async fn types_of(&self, type_name: &str, hash: &str) -> Result<Arc<TypeRegistry>, CallError> {
        let key = (type_name.to_owned(), hash.to_owned());
        if let Some(types) = locked(&self.types).get(&key) {
            return Ok(Arc::clone(types));
        }
        let known = self.known.hash(type_name);
        let types = match &known {
            Ok(known) if known == hash => self.known.clone(),
            _ => self.described_types(type_name, hash).await?,
        };
        let types = Arc::new(types);
        locked(&self.types).insert(key, Arc::clone(&types));
        Ok(types)
    }

    /// Requests the definition of a type from the nodes that use it.
    async fn described_types(&self, type_name: &str, hash: &str) -> Result<TypeRegistry, CallError> {
        let endpoints = self.endpoints();
        let uses = endpoints.iter().filter(|endpoint| endpoint.type_name == type_name && endpoint.hash == hash);
        let mut nodes: Vec<&str> = uses.map(|endpoint| endpoint.node.as_str()).collect();
        nodes.dedup();
        let describing = self.known.hash(DESCRIBES)?;
        for node in nodes {
            let service = format!("{node}/get_type_description");
            let request = json!({"type_name": type_name, "type_hash": hash, "include_type_sources": false});
            let target = Target { name: &service, type_name: DESCRIBES, hash: &describing };
            match self.call_with(&target, &self.known, &request, DESCRIPTION_TIMEOUT).await {
                Ok(reply) if reply["successful"] == true => {
                    let mut types = self.known.clone();
                    match types.add_description(&reply["type_description"], hash) {
                        Ok(()) => return Ok(types),
                        Err(problem) => warn!(node, %problem, "the description of a type is refused"),
                    }
                }
                Ok(reply) => debug!(node, type_name, reason = %reply["failure_reason"], "no description"),
                Err(problem) => debug!(node, type_name, %problem, "no description"),
            }
        }
        Err(TypeError::Unknown(format!("{type_name} with the hash {hash}")).into())
    }

    /// Returns the attachment of a request.
    fn request_attachment(&self) -> Attachment {
        attachment(self.session.zid().to_le_bytes(), self.sequence.fetch_add(1, Ordering::Relaxed))
    }

    /// Returns the attachment of the next message of an own publisher.
    fn message_attachment(&self, key: &str) -> Option<Attachment> {
        let mut publishers = locked(&self.publishers);
        let publisher = publishers.get_mut(key)?;
        publisher.sequence += 1;
        Some(attachment(publisher.gid, publisher.sequence))
    }

    /// Declares a publisher, unless it is declared. Returns the attachment of its next message.
    async fn declare_publisher(
        &self,
        key: &str,
        topic: &str,
        type_name: &str,
        hash: &str,
    ) -> Result<Attachment, RosError> {
        if let Some(attachment) = self.message_attachment(key) {
            return Ok(attachment);
        }
        let token = self.declare(EndpointKind::Publisher, topic, type_name, hash).await?;
        let mut gid = [0; 16];
        gid.copy_from_slice(&Sha256::digest(format!("{}/{key}", self.session.zid()))[..16]);
        locked(&self.publishers).insert(key.to_owned(), OwnPublisher { _token: token, gid, sequence: 1 });
        Ok(attachment(gid, 1))
    }

    fn key(&self, name: &str, type_name: &str, hash: &str) -> String {
        format!("{}/{}/{}/{hash}", self.settings.domain, name.trim_matches('/'), dds_name(type_name))
    }

    /// Publishes a message on a topic with a known type. The first message of a topic declares its
    /// publisher.
    ///
    /// # Errors
    /// [`CallError`] if the message does not fit the type.
    pub async fn publish(&self, topic: &str, type_name: &str, message: &Value) -> Result<(), CallError> {
        let subscribed = self.find(EndpointKind::Subscription, topic).filter(|found| found.type_name == type_name);
        let hash = match subscribed {
            Some(endpoint) => endpoint.hash,
            None => self.known.hash(type_name)?,
        };
        let types = self.types_of(type_name, &hash).await?;
        let bytes = cdr::encode(&types, type_name, message)?;
        let key = self.key(topic, type_name, &hash);
        let attachment = self.declare_publisher(&key, topic, type_name, &hash).await?;
        let put = self.session.put(key, bytes).attachment(ZBytes::from(attachment));
        put.await.map_err(|problem| RosError::of(format!("publish on {topic}"), problem))?;
        Ok(())
    }

    /// Calls a service, with the type that its server has on the graph.
    ///
    /// # Errors
    /// [`CallError`].
    pub async fn call(
        &self,
        name: &str,
        type_name: &str,
        request: &Value,
        limit: Duration,
    ) -> Result<Value, CallError> {
        let server = self.find(EndpointKind::Server, name).ok_or_else(|| CallError::NotServed(name.to_owned()))?;
        if server.type_name != type_name {
            let (name, expected) = (name.to_owned(), type_name.to_owned());
            return Err(CallError::OtherType { name, found: server.type_name, expected });
        }
        let types = self.types_of(type_name, &server.hash).await?;
        let target = Target { name, type_name, hash: &server.hash };
        self.call_with(&target, &types, request, limit).await
    }

    async fn call_with(
        &self,
        target: &Target<'_>,
        types: &TypeRegistry,
        request: &Value,
        limit: Duration,
    ) -> Result<Value, CallError> {
        let Target { name, type_name, hash } = target;
        let bytes = cdr::encode(types, &format!("{type_name}_Request"), request)?;
        let failed = |problem| RosError::of(format!("call {name}"), problem);
        let replies = self
            .session
            .get(self.key(name, type_name, hash))
            .target(QueryTarget::BestMatching)
            .consolidation(ConsolidationMode::None)
            .timeout(limit)
            .payload(bytes)
            .attachment(ZBytes::from(self.request_attachment()))
            .await
            .map_err(failed)?;
        while let Ok(reply) = replies.recv_async().await {
            if let Ok(sample) = reply.result() {
                return Ok(cdr::decode(types, &format!("{type_name}_Response"), &sample.payload().to_bytes())?);
            }
        }
        Err(CallError::NoReply((*name).to_owned()))
    }

    /// Subscribes to a topic of a type with any hash. Messages arrive with the given number, and so do
    /// the latest messages of publishers that keep them for late subscribers.
    ///
    /// # Errors
    /// [`RosError`] if the session is closed.
    pub async fn subscribe(
        self: &Arc<Self>,
        topic: &str,
        type_name: &str,
        subscription: usize,
        messages: UnboundedSender<Received>,
    ) -> Result<Subscription, RosError> {
        let key = self.key(topic, type_name, "*");
        let failed = |problem| RosError::of(format!("subscribe to {topic}"), problem);
        let (samples, received) = unbounded_channel();
        let sender = samples.clone();
        let subscriber = self
            .session
            .declare_subscriber(key.clone())
            .callback(move |sample: Sample| {
                // Without its receiver the subscription ends.
                let _ = sender.send(sample);
            })
            .await
            .map_err(failed)?;
        let hash = self.known.hash(type_name).unwrap_or_else(|_| "RIHS01_".to_owned() + &"0".repeat(64));
        let token = self.declare(EndpointKind::Subscription, topic, type_name, &hash).await?;
        let reader = tokio::spawn(Arc::clone(self).read(type_name.to_owned(), subscription, received, messages));
        let history = tokio::spawn(Arc::clone(self).request_history(topic.to_owned(), key, samples));
        let tasks = [reader.abort_handle(), history.abort_handle()];
        Ok(Subscription { _subscriber: subscriber, _token: token, tasks })
    }

    async fn read(
        self: Arc<Self>,
        type_name: String,
        subscription: usize,
        mut samples: UnboundedReceiver<Sample>,
        messages: UnboundedSender<Received>,
    ) {
        while let Some(sample) = samples.recv().await {
            let hash = sample.key_expr().as_str().rsplit('/').next().unwrap_or_default().to_owned();
            let message = match self.types_of(&type_name, &hash).await {
                Ok(types) => cdr::decode(&types, &type_name, &sample.payload().to_bytes()).map_err(|e| e.to_string()),
                Err(problem) => Err(problem.to_string()),
            };
            if messages.send(Received { subscription, message }).is_err() {
                return;
            }
        }
    }

    /// Requests the stored messages of publishers when the publishers of the topic change.
    async fn request_history(self: Arc<Self>, topic: String, key: String, samples: UnboundedSender<Sample>) {
        let mut changes = self.changes.clone();
        let mut asked: Vec<Endpoint> = vec![];
        loop {
            let mut publishers = self.endpoints();
            publishers.retain(|endpoint| endpoint.kind == EndpointKind::Publisher && endpoint.name == topic);
            if publishers.iter().any(|publisher| !asked.contains(publisher)) {
                let get = self.session.get(format!("{key}/@adv/**")).accept_replies(ReplyKeyExpr::Any);
                let get = get.target(QueryTarget::All).consolidation(ConsolidationMode::None);
                match get.timeout(DESCRIPTION_TIMEOUT).await {
                    Ok(replies) => {
                        while let Ok(reply) = replies.recv_async().await {
                            if let Ok(sample) = reply.result() {
                                let _ = samples.send(sample.clone());
                            }
                        }
                    }
                    Err(problem) => debug!(topic, %problem, "no stored messages"),
                }
            }
            asked = publishers;
            if changes.changed().await.is_err() {
                return;
            }
        }
    }

    /// Leaves the graph.
    pub async fn leave(&self) {
        drop(locked(&self.node).take());
        locked(&self.publishers).clear();
        if let Err(problem) = self.session.close().await {
            debug!(%problem, "the session was not closed");
        }
    }
}

fn attachment(source_gid: [u8; 16], sequence_number: i64) -> Attachment {
    let since_1970 = SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default();
    let source_timestamp = i64::try_from(since_1970.as_nanos()).unwrap_or(i64::MAX);
    Attachment { sequence_number, source_timestamp, source_gid }
}

/// A service with a type.
struct Target<'a> {
    name: &'a str,
    type_name: &'a str,
    hash: &'a str,
}

/// A subscription, which ends when it is dropped.
pub struct Subscription {
    _subscriber: Subscriber<()>,
    _token: LivelinessToken,
    tasks: [tokio::task::AbortHandle; 2],
}

impl Drop for Subscription {
    fn drop(&mut self) {
        for task in &self.tasks {
            task.abort();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_of_rmw_zenoh_are_read() {
        let token = "@ros2_lv/0/a0/0/11/SS/%/%ada/bt_navigator/%ada%navigate_to_pose%_action%send_goal/\
                     nav2_msgs::action::dds_::NavigateToPose_SendGoal_/RIHS01_ab/::,10:,:,:,,";
        let endpoint = Endpoint {
            name: "/ada/navigate_to_pose/_action/send_goal".to_owned(),
            kind: EndpointKind::Server,
            type_name: "nav2_msgs/action/NavigateToPose_SendGoal".to_owned(),
            hash: "RIHS01_ab".to_owned(),
            node: "/ada/bt_navigator".to_owned(),
        };
        assert_eq!(parse_token(token), Some(Entity::Endpoint(endpoint)));
        assert_eq!(parse_token("@ros2_lv/0/a0/0/0/NN/%/%/rviz"), Some(Entity::Node("/rviz".to_owned())));
        assert_eq!(parse_token("@ros2_lv/0/a0/0/0/XX/%/%/rviz"), None);
    }
}
