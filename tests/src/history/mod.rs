//! History of the clients: all their calls with the replies, as seen from outside.
//!
//! ```text
//!  clients ──▶ History ──▶ by mission ──▶ linearizability tester (`stateright`)
//!                 │
//!                 ├──────▶ revisions of linearizable reads never decrease
//!                 └──────▶ other reads are at most as old as they say
//! ```

mod check;
mod clients;
mod mission_spec;

pub use clients::{Acknowledged, Reader, RecordingClient};

use consort_protocol::api::{ErrorReply, MissionChangeReply, SubmitReply};
use consort_protocol::ids::{MissionId, NodeId};
use consort_protocol::ledger::MissionState;
use consort_protocol::view::{LedgerCopy, MissionView, MissionsView, WithProvenance};
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// Name under which the clients cancel and resolve missions.
const CLIENT: &str = "recording client";

/// Text of the refusal of a request that may be a repetition, because the ledger has forgotten outcomes since it was created.
const MAYBE_REPEATED: &str = "the fleet remembers only requests after";

/// What the ledger keeps of missions that have ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EndedMissions {
    /// Maximum number that the ledger keeps whole, for lists.
    pub listed_max: usize,
    /// The ledger forgets outcomes during the history.
    pub are_forgotten: bool,
}

/// Call of a client.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ClientCall {
    /// Submits a mission.
    Submit {
        /// Name of the request. A request without a name is another one each time it is sent.
        request: Option<String>,
    },
    /// Cancels a mission.
    Cancel {
        /// The mission.
        mission: MissionId,
    },
    /// Closes a mission that needs intervention.
    Resolve {
        /// The mission.
        mission: MissionId,
    },
    /// A linearizable read of a mission.
    Get {
        /// The mission.
        mission: MissionId,
    },
    /// Reads all missions.
    List {
        /// The read is linearizable.
        linearizable: bool,
    },
}

/// Definite reply to a call.
#[derive(Debug, Clone, PartialEq)]
pub enum ClientReply {
    /// The mission is acknowledged.
    Submitted(SubmitReply),
    /// State of the mission after a change.
    Changed(Option<MissionState>),
    /// Missions as read from the copy of a node.
    Read {
        /// The node.
        node: NodeId,
        /// Its copy of the ledger.
        copy: LedgerCopy,
        /// States of the missions.
        states: BTreeMap<MissionId, MissionState>,
    },
    /// Nothing was executed, or the mission does not exist.
    Refused(String),
}

impl ClientCall {
    /// Parses a reply. Returns `None` if the outcome is unknown: the call may or may not have been
    /// executed, and the client may repeat it.
    pub fn parse(&self, reply: &Value) -> Option<ClientReply> {
        fn of<T: DeserializeOwned>(reply: &Value) -> Option<T> {
            T::deserialize(reply).ok()
        }
        let parsed = match self {
            ClientCall::Submit { .. } => of(reply).map(ClientReply::Submitted),
            ClientCall::Cancel { .. } | ClientCall::Resolve { .. } => {
                of(reply).map(|MissionChangeReply { state, .. }| ClientReply::Changed(state))
            }
            ClientCall::Get { .. } => of(reply).and_then(|view: WithProvenance<MissionView>| {
                let brief = view.content.brief;
                let states = BTreeMap::from([(brief.mission, brief.status.detail)]);
                Some(ClientReply::Read { node: view.provenance.seen_by, copy: view.provenance.ledger?, states })
            }),
            ClientCall::List { .. } => of(reply).and_then(|view: WithProvenance<MissionsView>| {
                let states = view.content.missions.into_iter();
                let states = states.map(|mission| (mission.brief.mission, mission.brief.status.detail)).collect();
                Some(ClientReply::Read { node: view.provenance.seen_by, copy: view.provenance.ledger?, states })
            }),
        };
        parsed.or_else(|| match of(reply)? {
            ErrorReply { error, retry_after_ms: None } => Some(ClientReply::Refused(error)),
            ErrorReply { retry_after_ms: Some(_), .. } => None,
        })
    }
}

/// Moment in the history.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Moment {
    /// Position among all moments: several may have the same time.
    order: u64,
    /// Time since the start of the history.
    at: Duration,
}

/// A call with its reply.
#[derive(Debug, Clone)]
struct Operation {
    call: ClientCall,
    invoked: Moment,
    /// `None` if the outcome is unknown.
    returned: Option<(Moment, ClientReply)>,
}

/// A pause of a node.
#[derive(Debug, Clone)]
struct Pause {
    node: NodeId,
    began: Duration,
    ended: Option<Duration>,
}

#[derive(Debug)]
struct Records {
    start: Instant,
    order: u64,
    operations: Vec<Operation>,
    pauses: Vec<Pause>,
    ended: EndedMissions,
    /// Number of refusals of new missions, because as many as allowed were active.
    refusals: usize,
}

impl Records {
    fn now(&mut self) -> Moment {
        self.order += 1;
        Moment { order: self.order, at: self.start.elapsed() }
    }
}

/// History of all clients of a run. Clones share the history.
#[derive(Debug, Clone)]
pub struct History(Arc<Mutex<Records>>);

impl History {
    /// Creates an empty history that begins now.
    pub fn new(ended: EndedMissions) -> History {
        let records =
            Records { start: Instant::now(), order: 0, operations: vec![], pauses: vec![], ended, refusals: 0 };
        History(Arc::new(Mutex::new(records)))
    }

    fn lock(&self) -> MutexGuard<'_, Records> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the moment at which a call begins.
    pub fn invoke(&self) -> Moment {
        self.lock().now()
    }

    /// Records a reply that arrives now.
    pub fn record(&self, call: ClientCall, invoked: Moment, reply: ClientReply) {
        let mut records = self.lock();
        let returned = Some((records.now(), reply));
        records.operations.push(Operation { call, invoked, returned });
    }

    /// Records a call without a definite reply.
    pub fn record_unknown(&self, call: ClientCall, invoked: Moment) {
        self.lock().operations.push(Operation { call, invoked, returned: None });
    }

    /// Counts a refusal of a new mission, because as many as allowed were active.
    fn count_refusal(&self) {
        self.lock().refusals += 1;
    }

    /// Returns the number of refusals of new missions, because as many as allowed were active.
    pub fn refusals(&self) -> usize {
        self.lock().refusals
    }

    /// Records that messages from and to a node are withheld from now on.
    pub fn begin_pause(&self, node: NodeId) {
        let mut records = self.lock();
        let began = records.start.elapsed();
        records.pauses.push(Pause { node, began, ended: None });
    }

    /// Records the end of a pause.
    pub fn end_pause(&self, node: &NodeId) {
        let mut records = self.lock();
        let now = records.start.elapsed();
        for pause in records.pauses.iter_mut().filter(|pause| pause.node == *node && pause.ended.is_none()) {
            pause.ended = Some(now);
        }
    }

    /// Returns the number of calls with a definite reply.
    pub fn replies(&self) -> usize {
        self.lock().operations.iter().filter(|operation| operation.returned.is_some()).count()
    }

    /// Checks that the calls about each mission are linearizable, and that the revisions of
    /// linearizable reads never decrease.
    ///
    /// # Errors
    /// Description of the first contradiction.
    pub fn check_linearizable(&self) -> Result<(), String> {
        let records = self.lock();
        check::check_linearizable(&records.operations, records.ended)
    }

    /// Checks that other reads are at most as old as they say.
    ///
    /// # Errors
    /// Description of the first contradiction.
    pub fn check_ages(&self) -> Result<(), String> {
        let records = self.lock();
        check::check_ages(&records.operations, &records.pauses, records.ended.listed_max)
    }
}
