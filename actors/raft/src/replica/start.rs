//! Start of a replica: its storage, openraft, and the tasks around it.

use super::{Inner, LeadershipState, Replica, ReplicaTasks, Task};
use crate::acknowledgements::{LastContacts, LeaderAcks};
use crate::election;
use crate::errors::StartError;
use crate::group_commit::GroupCommitter;
use crate::leader_contact::LeaderContact;
use crate::leader_loss;
use crate::leadership_view::{LeadershipMonitor, LeadershipView, MetricsFeed, ResignedTerm};
use crate::log_store::{LogStore, with_repair_advice};
use crate::network::RaftClient;
use crate::runtime::seed_elections;
use crate::server::RaftServer;
use crate::settings::RaftSettings;
use crate::staleness::AnnouncedCommits;
use crate::storage::{self, ApplyObserver, StateMachineStore};
use crate::types::{Raft, RaftId, StateMachine};
use consort_bus::SharedBus;
use consort_protocol::keys::Keys;
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::sync::{Arc, Mutex, OnceLock};
use tokio::sync::{mpsc, watch};
use tracing::info;

/// Growth of the log after which a snapshot is taken, in bytes, whatever the number of entries. After a larger snapshot the log
/// may grow by its size, so that snapshots of a large state do not take most of the time. Raised: fewer snapshots, and more
/// memory, since each replica keeps its log in memory.
const LOG_GROWTH_MAX: u64 = 8 << 20;

/// Size limit, in bytes, up to which commands share an entry. A slow link carries such an entry
/// within half a second, and a follower writes it quickly. With 64 clients that request missions,
/// about six commands share an entry.
const SHARED_ENTRY_MAX: usize = 16 * 1024;

impl<S: StateMachine> Replica<S> {
    /// Starts a replica from the state in `log_store`. `seed` determines the randomized election
    /// timeouts; every node needs a different seed.
    ///
    /// # Errors
    /// [`StartError`]: nothing runs.
    pub async fn start(
        settings: RaftSettings,
        bus: SharedBus,
        log_store: Arc<dyn LogStore>,
        seed: u64,
    ) -> Result<Self, StartError> {
        Replica::start_observed(settings, bus, log_store, seed, None).await
    }

    /// Starts a replica like [`Replica::start`], and calls `applied` for every entry that this
    /// replica applies.
    ///
    /// # Errors
    /// As [`Replica::start`].
    pub async fn start_observed(
        settings: RaftSettings,
        bus: SharedBus,
        log_store: Arc<dyn LogStore>,
        seed: u64,
        applied: Option<ApplyObserver<S>>,
    ) -> Result<Self, StartError> {
        let config = settings.to_config()?;
        let id = RaftId::of(&settings.node, log_store.identity());
        let (location, advice) = (log_store.location(), log_store.repair_advice());
        let opened = storage::open::<S>(log_store, applied).await;
        let start_error = |problem| StartError::LogStore { location, problem: with_repair_advice(problem, advice) };
        let (log, machine) = opened.map_err(start_error)?;
        let (appended, appended_bytes, last_at_start) = (log.appended(), log.appended_bytes(), log.last());
        let keys = Keys::new(&settings.fleet);
        let queries = bus.serve(&keys.any_raft(id.0)).await?;
        let last_contacts = Arc::<LastContacts>::default();
        let acks = Arc::new(watch::Sender::new(LeaderAcks::default()));
        let leadership = watch::Sender::new(LeadershipView::default());
        let (appends_suspended, quorum_confirmed) = (Arc::<AtomicBool>::default(), Arc::<AtomicBool>::default());
        let client = RaftClient {
            bus,
            keys: keys.clone(),
            me: id,
            cluster: machine.cluster(),
            last_contacts,
            acks: Arc::clone(&acks),
            retry_interval: settings.heartbeat,
            appends_suspended: Arc::clone(&appends_suspended),
            quorum_confirmed: Arc::clone(&quorum_confirmed),
            leadership: leadership.subscribe(),
        };

        // No await between these two lines: openraft draws its timeout before the first await of
        // `new`.
        seed_elections(seed);
        let raft = Raft::<S>::new(id, config, client.clone(), log, machine.clone()).await?;

        let resigned_term = Arc::<ResignedTerm>::default();
        let (quorum_ack_sender, quorum_ack) = watch::channel(None);
        let monitor = LeadershipMonitor {
            check_quorum_timeout: settings.check_quorum_timeout,
            election_max: settings.election_max,
            leadership: leadership.clone(),
            resigned_term: Arc::clone(&resigned_term),
            quorum_ack: quorum_ack_sender,
            appends_suspended,
            quorum_confirmed,
            last_at_start,
            election: None,
            me: id,
            acks: acks.subscribe(),
            published_inputs: None,
        };
        let monitor_task =
            Task::spawn(monitor.run(MetricsFeed { metrics: raft.metrics(), server_metrics: raft.server_metrics() }));
        let leader_contact = Arc::new(LeaderContact::new());
        let elections =
            election::run_elections(raft.clone(), client.clone(), Arc::clone(&leader_contact), settings.clone(), seed);
        let election_task = Task::spawn(elections);
        let heartbeat_task = Task::spawn(election::send_heartbeats(raft.clone(), client.clone(), settings.heartbeat));
        let leader_watch =
            Task::spawn(leader_loss::watch_leader(client.clone(), Arc::clone(&leader_contact), settings.heartbeat));
        let rejected = Arc::<AtomicU64>::default();
        let announced_commits = Arc::<AnnouncedCommits>::default();
        let server = RaftServer {
            me: id,
            raft: raft.clone(),
            leader_contact: Arc::clone(&leader_contact),
            leadership: leadership.subscribe(),
            election_min: settings.election_min,
            heartbeat: settings.heartbeat,
            announced_commits: Arc::clone(&announced_commits),
            rejected: Arc::clone(&rejected),
            keys,
            cluster: machine.cluster(),
            followed: OnceLock::new(),
            machine: machine.clone(),
            received_snapshot: Mutex::default(),
            cutting: tokio::sync::Mutex::default(),
        };
        let server_task = Task::spawn(server.run(queries));
        let (proposals, proposal_queue) = mpsc::unbounded_channel();
        let committer =
            GroupCommitter { raft: raft.clone(), proposals: proposal_queue, appended, size_max: SHARED_ENTRY_MAX };
        let group_commit = Task::spawn(committer.run());
        let log_limit = Task::spawn(limit_log(raft.clone(), machine.clone(), appended_bytes));
        info!(node = %settings.node, raft = %id, "replica started");
        let tasks = ReplicaTasks {
            group_commit,
            server: server_task,
            monitor: monitor_task,
            elections: election_task,
            leader_watch,
            heartbeats: heartbeat_task,
            log_limit,
        };
        let leadership = LeadershipState { view: leadership, quorum_ack, resigned_term, leader_contact };
        let inner =
            Inner { id, settings, raft, machine, leadership, announced_commits, client, rejected, proposals, tasks };
        Ok(Replica { inner: Arc::new(inner) })
    }
}

/// Takes a snapshot whenever the log has grown by [`LOG_GROWTH_MAX`], or by the size of the latest snapshot.
async fn limit_log<S: StateMachine>(
    raft: Raft<S>,
    machine: StateMachineStore<S>,
    mut appended_bytes: watch::Receiver<u64>,
) {
    let mut covered = 0;
    loop {
        let is_due = |bytes: &u64| {
            let grown = bytes.saturating_sub(covered);
            grown >= LOG_GROWTH_MAX && grown >= machine.snapshot_bytes()
        };
        let Ok(bytes) = appended_bytes.wait_for(is_due).await.map(|bytes| *bytes) else { return };
        covered = bytes;
        if raft.trigger().snapshot().await.is_err() {
            return;
        }
    }
}
