//! Requests that change something, carried out by the coordinator: see [`crate::calls`] for what they take.

use super::last_known_place::last_known_places;
use super::no_leader::{RETRY_AFTER_MS, busy_reply};
use crate::api_types::{
    MissionChangeReply, MissionChangeRequest, NodeVersions, SubmitReply, SubmitRequest, UpgradeRequest, UpgradeStatus,
    parse_request,
};
use crate::bus::MESSAGE_MAX;
use crate::gossip::SharedKnowledge;
use crate::raft::{ProposeError, Replica};
use crate::store::Backup;
use consort_protocol::codec;
use consort_protocol::ids::{FleetId, MissionId, NodeId, RequestId};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{
    Command, CommandOutcome, Ledger, Priority, RecoveryBranch, Submission, time_until_deadline,
};
use consort_protocol::mission::{Domain, Format, MissionTemplate, shipped};
use consort_protocol::plan::divide_and_check;
use consort_protocol::versions::{self, VersionRange};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

/// How long the ledger may take to accept a request.
const LIMIT: Duration = Duration::from_secs(2);

/// Largest mission, divided and encoded, in bytes: its award and its call for bids must fit a message each.
const MISSION_MAX: usize = codec::MESSAGE_BYTES_MAX / 2;

/// What requests are carried out with.
#[derive(Clone)]
pub(super) struct ApiHandler {
    pub(super) fleet: FleetId,
    pub(super) node: NodeId,
    pub(super) replica: Replica<Ledger>,
    pub(super) knowledge: SharedKnowledge,
    pub(super) domain: Arc<Domain>,
    /// For requests that bring no name of their own: unlike those of other coordinators.
    pub(super) request_prefix: String,
    pub(super) at_ms: u64,
    pub(super) request_number: u64,
    /// Missions under way that are taken on; 0 for no limit.
    pub(super) missions_max: usize,
}

/// Why there is no other answer.
struct Problem {
    text: String,
    /// Whether the same may be asked again.
    may_pass: bool,
}

impl From<String> for Problem {
    fn from(text: String) -> Problem {
        Problem { text, may_pass: false }
    }
}

impl ApiHandler {
    /// Carries a request out.
    pub(super) async fn handle(self, call: ApiCall, payload: &[u8]) -> Value {
        let answer = match call {
            ApiCall::Submit => self.submit(payload).await,
            ApiCall::Cancel => self.cancel(payload).await,
            ApiCall::Resolve => self.rescued(payload).await,
            ApiCall::Backup => self.backup().await,
            ApiCall::Upgrade => self.upgrade(payload).await,
            ApiCall::Get | ApiCall::List | ApiCall::Explain | ApiCall::Help => {
                Err(format!("{} is answered by any node", call.as_str()).into())
            }
        };
        answer.unwrap_or_else(|Problem { text, may_pass }| match may_pass {
            true => busy_reply(&text, Duration::from_millis(RETRY_AFTER_MS)),
            false => json!({ "error": text }),
        })
    }

    async fn submit(&self, payload: &[u8]) -> Result<Value, Problem> {
        let asked: SubmitRequest = parse_request(ApiCall::Submit, payload)?;
        let submission = self.prepare(asked)?;
        if let Some(full) = self.replica.read(|ledger| self.full(ledger, &submission.request)) {
            return Err(full);
        }
        match self.replica.propose(Command::Submit(Box::new(submission)), LIMIT).await {
            Ok(CommandOutcome::Submitted { mission, again }) => Ok(json!(SubmitReply { mission, again })),
            Ok(other) => Err(format!("the ledger answered {other:?}").into()),
            Err(problem) => Err(not_committed(&problem)),
        }
    }

    /// Why nothing new is taken on, if nothing is. What was taken on before is answered again.
    fn full(&self, ledger: &Ledger, request: &RequestId) -> Option<Problem> {
        let is_full = self.missions_max > 0 && ledger.has_active(self.missions_max);
        (is_full && ledger.mission_of_request(request).is_none()).then(|| Problem {
            text: format!("{} missions are under way, as many as this fleet takes on at once", self.missions_max),
            may_pass: true,
        })
    }

    fn prepare(&self, asked: SubmitRequest) -> Result<Submission, String> {
        let template = match &asked.mission {
            Value::String(name) => shipped().get(name).cloned().ok_or_else(|| {
                let known: Vec<_> = shipped().keys().map(String::as_str).collect();
                format!("no mission {name:?} is shipped; there are {}", known.join(", "))
            })?,
            file => MissionTemplate::parse(&file.to_string(), Format::Json).map_err(|e| e.to_string())?,
        };
        let instance = template.instantiate_with_recovery(&asked.parameters, &self.domain);
        let (mission, recovery) = instance.map_err(|e| e.to_string())?;
        let division = divide_and_check(&mission).map_err(|e| e.to_string())?;
        let recovery = recovery.map(|mission| match divide_and_check(&mission) {
            Ok(division) => Ok(RecoveryBranch { mission, division }),
            Err(problem) => Err(format!("recovery: {problem}")),
        });
        let recovery = recovery.transpose()?;
        let priority = Priority::new(asked.priority).map_err(|e| e.to_string())?;
        let deadline_ms = match asked.deadline_s {
            None => None,
            Some(seconds) => {
                let time = time_until_deadline(seconds).map_err(|e| format!("deadline_s is {seconds}; {e}"))?;
                Some(self.at_ms.saturating_add(u64::try_from(time.as_millis()).unwrap_or(u64::MAX)))
            }
        };
        let request = match asked.request {
            Some(request) => request,
            None => {
                RequestId::new(format!("{}-{}", self.request_prefix, self.request_number)).map_err(|e| e.to_string())?
            }
        };
        let (parameters, at_ms) = (asked.parameters, self.at_ms);
        let submission = Submission { request, mission, division, parameters, recovery, priority, deadline_ms, at_ms };
        match codec::encode(&submission) {
            Ok(bytes) if bytes.len() <= MISSION_MAX => Ok(submission),
            Ok(bytes) => Err(format!("the mission takes {} bytes, where {MISSION_MAX} are allowed", bytes.len())),
            Err(problem) => Err(format!("the mission is too large: {problem}")),
        }
    }

    async fn cancel(&self, payload: &[u8]) -> Result<Value, Problem> {
        let MissionChangeRequest { mission, by } = parse_request(ApiCall::Cancel, payload)?;
        let places = self.replica.read(|ledger| last_known_places(&self.knowledge, ledger.mission(&mission)));
        self.change(mission.clone(), Command::Cancel { mission, by, places }).await
    }

    async fn rescued(&self, payload: &[u8]) -> Result<Value, Problem> {
        let MissionChangeRequest { mission, by } = parse_request(ApiCall::Resolve, payload)?;
        self.change(mission.clone(), Command::Resolve { mission, by }).await
    }

    /// A copy of the ledger. A majority says first that nobody else has taken over: all that was acknowledged is in it.
    async fn backup(&self) -> Result<Value, Problem> {
        self.replica.ensure_leader(LIMIT).await.map_err(|problem| not_committed(&problem))?;
        let (last, ledger) = self.replica.copy();
        let last = last.ok_or_else(|| "there is nothing in the ledger yet".to_owned())?;
        let backup = Backup::new(&ledger, last, self.fleet.clone(), self.node.clone(), self.at_ms)?;
        let copy = json!(backup);
        match copy.to_string().len() {
            size if size > MESSAGE_MAX => Err(format!(
                "the copy takes {size} bytes, where {MESSAGE_MAX} go over the bus at once; stop one of the voters and copy its data directory"
            )
            .into()),
            _ => Ok(copy),
        }
    }

    /// Which versions of the wire everybody reads, and, if that is asked for, the step to the next.
    async fn upgrade(&self, payload: &[u8]) -> Result<Value, Problem> {
        let UpgradeRequest { finish } = parse_request(ApiCall::Upgrade, payload)?;
        let wire = self.replica.read(Ledger::wire).unwrap_or(VersionRange::OWN.oldest);
        let needed = self.needed();
        let step =
            self.knowledge.read(|base| versions::UpgradeStatus::of(wire, VersionRange::OWN, needed.clone(), base));
        match (finish, step) {
            (false, _) => Ok(json!(self.upgrading(wire, &needed))),
            (true, versions::UpgradeStatus::Newest) => Err(format!(
                "the fleet writes version {wire} of the wire, and {}, which coordinates, reads none later: upgrade the nodes first",
                self.node
            )
            .into()),
            (true, versions::UpgradeStatus::Blocked { next, behind }) => {
                let alive = |node: &NodeId| if self.knowledge.is_alive(node) { "" } else { ", is down" };
                let who = |(node, reads): (&NodeId, &Option<VersionRange>)| match reads {
                    Some(reads) => format!("{node} (reads {reads}{})", alive(node)),
                    None => format!("{node} (nothing is known of it)"),
                };
                Err(format!(
                    "not yet: version {next} of the wire is not read by {}; upgrade them first",
                    behind.iter().map(who).collect::<Vec<_>>().join(", ")
                )
                .into())
            }
            (true, versions::UpgradeStatus::Ready { next }) => {
                self.replica.propose(Command::RaiseWireVersion { wire: next }, LIMIT).await.map_err(|problem| not_committed(&problem))?;
                Ok(json!(self.upgrading(next, &needed)))
            }
        }
    }

    /// Who must read what the fleet writes even if this node has not heard of him: keepers of the ledger, and holders of roles.
    fn needed(&self) -> BTreeSet<NodeId> {
        let keepers: Vec<NodeId> = self.replica.leadership().borrow().voters.values().cloned().collect();
        let holders = self.replica.read(|ledger| {
            let holders = ledger.active_missions().into_iter().flat_map(|entry| entry.holders().into_values());
            holders.map(NodeId::from).collect::<Vec<_>>()
        });
        keepers.into_iter().chain(holders).collect()
    }

    fn upgrading(&self, wire: u8, needed: &BTreeSet<NodeId>) -> UpgradeStatus {
        let next = wire.checked_add(1).filter(|next| VersionRange::OWN.contains(*next));
        let reads: BTreeMap<NodeId, Option<VersionRange>> = self.knowledge.read(|base| {
            let known =
                base.iter().map(|(node, heard)| (node.clone(), Some(heard.record.knowledge.supported_versions)));
            needed.iter().map(|node| (node.clone(), None)).chain(known).collect()
        });
        let reader = |(node, reads): (NodeId, Option<VersionRange>)| NodeVersions {
            alive: node == self.node || self.knowledge.is_alive(&node),
            oldest: reads.map(|reads| reads.oldest),
            newest: reads.map(|reads| reads.newest),
            ready: next.map(|next| reads.is_some_and(|reads| reads.contains(next))),
            node: node.to_string(),
        };
        UpgradeStatus { wire, next, nodes: reads.into_iter().map(reader).collect() }
    }

    async fn change(&self, mission: MissionId, command: Command) -> Result<Value, Problem> {
        match self.replica.propose(command, LIMIT).await {
            Ok(CommandOutcome::Refused(refused)) => Err(refused.to_string().into()),
            Ok(_) => {
                let state = self.replica.read(|ledger| ledger.mission(&mission).map(|entry| entry.state.clone()));
                Ok(json!(MissionChangeReply { mission, state }))
            }
            Err(problem) => Err(not_committed(&problem)),
        }
    }
}

fn not_committed(problem: &ProposeError) -> Problem {
    match problem {
        ProposeError::TooLarge { .. } | ProposeError::Unencodable { .. } => problem.to_string().into(),
        _ => Problem { text: format!("{problem}; the same request may be sent again"), may_pass: true },
    }
}
