//! Mutation checks: injects a single deliberate bug to verify that the checks find it. A check that
//! finds none of the bugs is useless.
//!
//! Each place where a bug can be injected calls [`is_active`]. Without the feature `mutants`, as in
//! every release, that is a constant `false` and costs nothing. With the feature, a bug can be
//! activated for the current thread, so that tests in other threads are not affected.

use std::fmt::{self, Display};
use std::str::FromStr;

/// Injected bug.
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
    /// Neither the coordinator nor the ledger checks whether a report names the award in force. (If
    /// the ledger alone did not check, almost nothing would follow: the coordinator has checked a
    /// round trip before.)
    RefusedApplied,
    /// The coordinator answers a report before its content is committed.
    UncommittedReport,
    /// The ledger does not recognise repeated requests.
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
}

impl Mutant {
    /// All mutants.
    pub const ALL: [Mutant; 13] = [
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
    ];

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
        }
    }
}

impl Display for Mutant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Mutant {
    type Err = String;

    fn from_str(name: &str) -> Result<Mutant, String> {
        Mutant::ALL.into_iter().find(|mutant| mutant.name() == name).ok_or_else(|| {
            let names: Vec<_> = Mutant::ALL.into_iter().map(Mutant::name).collect();
            format!("no mutant is named {name:?}; the mutants are {}", names.join(", "))
        })
    }
}

/// Error: the program was built without the feature `mutants`. Nothing was changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("this program was built without mutants; build it with `--features mutants`")]
pub struct MutantsNotBuilt;

#[cfg(feature = "mutants")]
mod chosen {
    use super::Mutant;
    use std::cell::Cell;

    thread_local! {
        pub(super) static CHOSEN: Cell<Option<Mutant>> = const { Cell::new(None) };
    }
}

/// Activates a mutant for the current thread, or deactivates it.
///
/// # Errors
/// [`MutantsNotBuilt`], if a mutant was given and the feature is off.
pub fn activate(mutant: Option<Mutant>) -> Result<(), MutantsNotBuilt> {
    #[cfg(feature = "mutants")]
    {
        chosen::CHOSEN.set(mutant);
        Ok(())
    }
    #[cfg(not(feature = "mutants"))]
    if mutant.is_some() { Err(MutantsNotBuilt) } else { Ok(()) }
}

/// Returns the result of `check`, evaluated on this thread without a mutant: the checks themselves
/// must not be affected.
pub fn without_mutant<R>(check: impl FnOnce() -> R) -> R {
    #[cfg(feature = "mutants")]
    {
        let chosen = chosen::CHOSEN.replace(None);
        let result = check();
        chosen::CHOSEN.set(chosen);
        result
    }
    #[cfg(not(feature = "mutants"))]
    check()
}

/// Checks whether the mutant is active on the current thread.
#[inline]
pub fn is_active(mutant: Mutant) -> bool {
    #[cfg(feature = "mutants")]
    return chosen::CHOSEN.get() == Some(mutant);
    #[cfg(not(feature = "mutants"))]
    {
        let _ = mutant;
        false
    }
}
