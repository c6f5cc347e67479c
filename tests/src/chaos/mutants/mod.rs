//! Mutation checks: chaos must find each deliberate bug. Checks that find none of the bugs are
//! useless.
//!
//! The code of the nodes contains no bug for these checks. The harness injects each bug from
//! outside, into all nodes of a run:
//!
//! - by the log store (`log_store.rs`): `skip-fsync`, `double-vote`, `identity-kept`;
//! - by settings (`injection.rs`): `early-release`, `two-removed`, `grace-too-small`, `outcomes-forgotten`,
//!   `history-kept`;
//! - by the clock (`fault_injector.rs`): `suspension-not-counted`, `stopped-with-bus`;
//! - below the signatures of a node (`refusals.rs`): `refusals-unsigned`;
//! - by the signer of records (`gossip.rs`): `records-unverified`;
//! - by the list of revoked certificates (`fault_injector.rs`): `revocations-unread`;
//! - by the bus of the node (`bus.rs`, and `reports.rs` for the reports of robots): all others.

mod bus;
mod driver;
mod gossip;
mod injection;
mod known_ledger;
mod log_store;
mod message;
mod refusals;
mod reports;

pub(super) use injection::MutantInjection;

use std::fmt::{self, Display};
use std::str::FromStr;

/// Deliberate bug.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Mutant {
    /// The voter acknowledges log entries and votes before they are on disk.
    SkipFsync,
    /// Votes are not persisted: a voter that restarts may vote twice in the same term.
    DoubleVote,
    /// A leader without contact to a majority does not step down.
    NoCheckQuorum,
    /// The coordinator renews the award that a robot reports, even if it is outdated.
    IgnoreEpoch,
    /// A robot continues after the end of its lease.
    LeaseNotChecked,
    /// The coordinator releases the role of a silent robot well before lease and grace have passed.
    EarlyRelease,
    /// The coordinator records an outdated report under the award in force. (If the ledger alone
    /// accepted outdated awards, almost nothing would follow: the coordinator has checked a round
    /// trip before.)
    RefusedApplied,
    /// The coordinator answers a report before its content is committed.
    UncommittedReport,
    /// A repeated request is not recognised.
    RequestForgotten,
    /// Gossip passes on only the node's own record.
    LostRelay,
    /// A role passes its waits without having received the signals.
    WaitSkipped,
    /// A robot takes over an item, or lets another robot do so, before the ledger is known to
    /// contain the preceding steps.
    GuardSkipped,
    /// The autopilot removes a second voter together with a voter that is gone.
    TwoRemoved,
    /// Linearizable reads are answered from the copy of any node.
    StaleRead,
    /// Requests are executed without a check of their signatures.
    SignersUnchecked,
    /// The authors of messages between nodes are not checked.
    AuthorsUnchecked,
    /// Refusals without a signature are accepted.
    RefusalsUnsigned,
    /// Forwarded records are accepted without a check of their proofs.
    RecordsUnverified,
    /// A node follows the coordinator of the latest term, although it does not answer.
    BeaconsBelieved,
    /// The clock of a node stops while its machine is suspended, and the node continues afterwards.
    SuspensionNotCounted,
    /// The grace does not cover the time in which a robot stops.
    GraceTooSmall,
    /// The coordinator judges deadlines by its own clock.
    OwnClock,
    /// A canceled goal counts as ended at once, so a role may be released while the body moves.
    ReleasedInMotion,
    /// The ledger forgets missions as they end.
    OutcomesForgotten,
    /// The ledger keeps many more ended missions whole than its settings permit.
    HistoryKept,
    /// Robots ignore requests to give way to a better-ranked mission.
    CircularWaitKept,
    /// Driver servers ignore how long a command may be acted on, and stop a robot only by their own
    /// limit for silent nodes.
    KeptTooLong,
    /// An empty store that replaces a damaged store keeps its Raft id.
    IdentityKept,
    /// A node notices no end of a lease or command while it waits for its bus.
    StoppedWithBus,
    /// The coordinator submits an occurrence of a schedule again, under another request.
    OccurrenceRepeated,
    /// Robots ignore the holds of people, in notices and in renewals of leases.
    HoldIgnored,
    /// An order of a person is acknowledged and not executed.
    OrderForgotten,
    /// Robots do not receive at which chargers other robots are.
    ClaimsHidden,
    /// Robots ignore closures, in notices and in renewals of leases.
    ClosureIgnored,
    /// Robots ignore alarms, in notices and in renewals of leases.
    AlarmIgnored,
    /// Robots ignore speed limits, in notices and in renewals of leases.
    LimitIgnored,
    /// Nodes count robots that hold a role as out of service, so the coordinator releases their promises.
    HoldersUnfit,
    /// Nodes do not receive which robots use a charger by a lease.
    LeaseIgnored,
    /// Nodes do not read new lists of revoked certificates.
    RevocationsUnread,
}

impl Mutant {
    /// All mutants.
    pub const ALL: [Mutant; 39] = [
        Mutant::SkipFsync,
        Mutant::DoubleVote,
        Mutant::NoCheckQuorum,
        Mutant::IgnoreEpoch,
        Mutant::LeaseNotChecked,
        Mutant::EarlyRelease,
        Mutant::RefusedApplied,
        Mutant::UncommittedReport,
        Mutant::RequestForgotten,
        Mutant::LostRelay,
        Mutant::WaitSkipped,
        Mutant::GuardSkipped,
        Mutant::TwoRemoved,
        Mutant::StaleRead,
        Mutant::SignersUnchecked,
        Mutant::AuthorsUnchecked,
        Mutant::RefusalsUnsigned,
        Mutant::RecordsUnverified,
        Mutant::BeaconsBelieved,
        Mutant::SuspensionNotCounted,
        Mutant::GraceTooSmall,
        Mutant::OwnClock,
        Mutant::ReleasedInMotion,
        Mutant::OutcomesForgotten,
        Mutant::HistoryKept,
        Mutant::CircularWaitKept,
        Mutant::KeptTooLong,
        Mutant::IdentityKept,
        Mutant::StoppedWithBus,
        Mutant::OccurrenceRepeated,
        Mutant::HoldIgnored,
        Mutant::OrderForgotten,
        Mutant::ClaimsHidden,
        Mutant::ClosureIgnored,
        Mutant::AlarmIgnored,
        Mutant::LimitIgnored,
        Mutant::HoldersUnfit,
        Mutant::LeaseIgnored,
        Mutant::RevocationsUnread,
    ];

    /// Checks whether the bug has an effect only in a closed fleet.
    pub fn needs_closed_fleet(self) -> bool {
        matches!(
            self,
            Mutant::SignersUnchecked
                | Mutant::AuthorsUnchecked
                | Mutant::RefusalsUnsigned
                | Mutant::RecordsUnverified
                | Mutant::BeaconsBelieved
                | Mutant::RevocationsUnread
        )
    }

    /// Returns the name, as used on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Mutant::SkipFsync => "skip-fsync",
            Mutant::DoubleVote => "double-vote",
            Mutant::NoCheckQuorum => "no-check-quorum",
            Mutant::IgnoreEpoch => "ignore-epoch",
            Mutant::LeaseNotChecked => "lease-not-checked",
            Mutant::EarlyRelease => "early-release",
            Mutant::RefusedApplied => "refused-applied",
            Mutant::UncommittedReport => "uncommitted-report",
            Mutant::RequestForgotten => "request-forgotten",
            Mutant::LostRelay => "lost-relay",
            Mutant::WaitSkipped => "wait-skipped",
            Mutant::GuardSkipped => "guard-skipped",
            Mutant::TwoRemoved => "two-removed",
            Mutant::StaleRead => "stale-read",
            Mutant::SignersUnchecked => "signers-unchecked",
            Mutant::AuthorsUnchecked => "authors-unchecked",
            Mutant::RefusalsUnsigned => "refusals-unsigned",
            Mutant::RecordsUnverified => "records-unverified",
            Mutant::BeaconsBelieved => "beacons-believed",
            Mutant::SuspensionNotCounted => "suspension-not-counted",
            Mutant::GraceTooSmall => "grace-too-small",
            Mutant::OwnClock => "own-clock",
            Mutant::ReleasedInMotion => "released-in-motion",
            Mutant::OutcomesForgotten => "outcomes-forgotten",
            Mutant::HistoryKept => "history-kept",
            Mutant::CircularWaitKept => "circular-wait-kept",
            Mutant::KeptTooLong => "kept-too-long",
            Mutant::IdentityKept => "identity-kept",
            Mutant::StoppedWithBus => "stopped-with-bus",
            Mutant::OccurrenceRepeated => "occurrence-repeated",
            Mutant::HoldIgnored => "hold-ignored",
            Mutant::OrderForgotten => "order-forgotten",
            Mutant::ClaimsHidden => "claims-hidden",
            Mutant::ClosureIgnored => "closure-ignored",
            Mutant::AlarmIgnored => "alarm-ignored",
            Mutant::LimitIgnored => "limit-ignored",
            Mutant::HoldersUnfit => "holders-unfit",
            Mutant::LeaseIgnored => "lease-ignored",
            Mutant::RevocationsUnread => "revocations-unread",
        }
    }
}

impl Display for Mutant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Error: no mutant has this name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnknownMutant(String);

impl Display for UnknownMutant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<_> = Mutant::ALL.into_iter().map(Mutant::name).collect();
        write!(f, "no mutant is named {:?}; the mutants are {}", self.0, names.join(", "))
    }
}

impl std::error::Error for UnknownMutant {}

impl FromStr for Mutant {
    type Err = UnknownMutant;

    fn from_str(name: &str) -> Result<Mutant, UnknownMutant> {
        Mutant::ALL.into_iter().find(|mutant| mutant.name() == name).ok_or_else(|| UnknownMutant(name.to_owned()))
    }
}
