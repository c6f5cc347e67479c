//! Deliberate mistakes, one at a time, to see whether the checks find them. A check that finds none of them is no check.
//!
//! Each place where a mistake can be made asks [`is`]. Without the feature `mutants`, as in every release, that is a
//! constant `false` and costs nothing; with it, a mistake can be chosen for the current thread, so that tests in other
//! threads are spared.

use std::fmt::{self, Display};
use std::str::FromStr;

/// A deliberate mistake.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Mutant {
    /// Log entries and votes are acknowledged before they are on disk.
    SkipFsync,
    /// Votes are not written down at all: a voter that restarts may vote twice in one term.
    DoubleVote,
    /// A leader that hears no majority goes on believing that it leads.
    NoCheckQuorum,
    /// A coordinator renews whatever award a robot reports, the latest or not.
    IgnoreEpoch,
    /// A robot acts on without looking at the end of its lease.
    LeaseNotChecked,
    /// A coordinator takes a role from a silent robot well before lease and grace have passed.
    EarlyRelease,
    /// Neither the coordinator nor the ledger looks whether a report names the award in force. (If the ledger alone did not,
    /// next to nothing would follow: the coordinator has looked a round trip before.)
    RefusedApplied,
    /// A report is answered before what it says was committed.
    UncommittedReport,
    /// The ledger forgets which requests it has had.
    RequestForgotten,
    /// Gossip hands on the node's own record only.
    LostRelay,
    /// A role passes its waits without having heard anything.
    WaitSkipped,
    /// A robot takes over an item, or lets another do so, before the ledger is known to hold what came before.
    GuardSkipped,
    /// The autopilot takes a second voter out together with one that is gone.
    TwoRemoved,
}

impl Mutant {
    /// All of them.
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

    /// Its name, as commands take it.
    pub fn name(self) -> &'static str {
        match self {
            Mutant::SkipFsync => "skip-fsync",
            Mutant::DoubleVote => "double-vote",
            Mutant::NoCheckQuorum => "deaf-leader",
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
            let known: Vec<_> = Mutant::ALL.into_iter().map(Mutant::name).collect();
            format!("no mutant is called {name:?}; there are {}", known.join(", "))
        })
    }
}

/// This program was built without the feature `mutants`. Nothing was changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("this program has no mutants in it; build it with `--features mutants`")]
pub struct MutantsNotBuilt;

#[cfg(feature = "mutants")]
mod chosen {
    use super::Mutant;
    use std::cell::Cell;

    thread_local! {
        pub(super) static CHOSEN: Cell<Option<Mutant>> = const { Cell::new(None) };
    }
}

/// Has the current thread make a mistake from now on, or none.
///
/// # Errors
/// [`NotBuilt`], if a mistake was asked for.
pub fn activate(mutant: Option<Mutant>) -> Result<(), MutantsNotBuilt> {
    #[cfg(feature = "mutants")]
    {
        chosen::CHOSEN.set(mutant);
        Ok(())
    }
    #[cfg(not(feature = "mutants"))]
    if mutant.is_some() { Err(MutantsNotBuilt) } else { Ok(()) }
}

/// What `judge` says on this thread without any mistake: whoever checks makes none.
pub fn without_mutant<R>(judge: impl FnOnce() -> R) -> R {
    #[cfg(feature = "mutants")]
    {
        let chosen = chosen::CHOSEN.replace(None);
        let said = judge();
        chosen::CHOSEN.set(chosen);
        said
    }
    #[cfg(not(feature = "mutants"))]
    judge()
}

/// Whether the current thread makes this mistake.
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
