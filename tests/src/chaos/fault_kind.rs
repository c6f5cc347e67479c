//! Kinds of faults, as drawn by the generator and named on the command line.

use crate::disk::DiskFault;
use serde::{Deserialize, Serialize};
use std::fmt::{self, Display};

/// Largest number of kinds with which a run has all kinds that are drawn separately.
pub(super) const FEW_KINDS: usize = 4;

/// Kinds of faults as listed on the scoreboard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[expect(missing_docs, reason = "each is described at the act that it is a kind of")]
pub enum FaultKind {
    None,
    Crash,
    CrashTorn,
    CrashEmpty,
    CoordinatorCrash,
    Blackout,
    Pause,
    Partition,
    OneWayCut,
    Loss,
    Duplication,
    Reordering,
    Delay,
    SlowDisk,
    Drift,
    Battery,
    Skill,
    Hostile,
    CrashDamaged,
    Disk(DiskFault),
    LeaseEnd,
    Suspend,
    WrongDate,
    Leave,
    Upgrade,
    CircularWait,
    StaleMajority,
    BlockedBus,
    Poison,
    Revoke,
}

impl FaultKind {
    /// All kinds except `None`.
    pub const FAULTS: [FaultKind; 32] = [
        FaultKind::Crash,
        FaultKind::CrashTorn,
        FaultKind::CrashEmpty,
        FaultKind::CoordinatorCrash,
        FaultKind::Blackout,
        FaultKind::Pause,
        FaultKind::Partition,
        FaultKind::OneWayCut,
        FaultKind::Loss,
        FaultKind::Duplication,
        FaultKind::Reordering,
        FaultKind::Delay,
        FaultKind::SlowDisk,
        FaultKind::Drift,
        FaultKind::Battery,
        FaultKind::Skill,
        FaultKind::Hostile,
        FaultKind::CrashDamaged,
        FaultKind::Disk(DiskFault::Fails),
        FaultKind::Disk(DiskFault::Full),
        FaultKind::Disk(DiskFault::Hangs),
        FaultKind::Disk(DiskFault::Lies),
        FaultKind::LeaseEnd,
        FaultKind::Suspend,
        FaultKind::WrongDate,
        FaultKind::Leave,
        FaultKind::Upgrade,
        FaultKind::CircularWait,
        FaultKind::StaleMajority,
        FaultKind::BlockedBus,
        FaultKind::Poison,
        FaultKind::Revoke,
    ];

    /// Checks whether faults of this kind are drawn by themselves, not in place of others.
    pub(crate) fn is_drawn_separately(self) -> bool {
        matches!(
            self,
            FaultKind::Hostile
                | FaultKind::LeaseEnd
                | FaultKind::Suspend
                | FaultKind::WrongDate
                | FaultKind::Leave
                | FaultKind::Upgrade
                | FaultKind::CircularWait
                | FaultKind::StaleMajority
                | FaultKind::BlockedBus
                | FaultKind::Poison
                | FaultKind::Revoke
        )
    }

    /// Returns its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            FaultKind::None => "none",
            FaultKind::Crash => "crash",
            FaultKind::CrashTorn => "crash-torn",
            FaultKind::CrashEmpty => "crash-empty",
            FaultKind::CoordinatorCrash => "coordinator-crash",
            FaultKind::Blackout => "blackout",
            FaultKind::Pause => "pause",
            FaultKind::Partition => "partition",
            FaultKind::OneWayCut => "one-way-cut",
            FaultKind::Loss => "loss",
            FaultKind::Duplication => "duplication",
            FaultKind::Reordering => "reordering",
            FaultKind::Delay => "delay",
            FaultKind::SlowDisk => "slow-disk",
            FaultKind::Drift => "drift",
            FaultKind::Battery => "battery",
            FaultKind::Skill => "skill",
            FaultKind::Hostile => "hostile",
            FaultKind::CrashDamaged => "crash-damaged",
            FaultKind::Disk(DiskFault::Fails) => "disk-fails",
            FaultKind::Disk(DiskFault::Full) => "disk-full",
            FaultKind::Disk(DiskFault::Hangs) => "disk-hangs",
            FaultKind::Disk(DiskFault::Lies) => "disk-lies",
            FaultKind::LeaseEnd => "lease-end",
            FaultKind::Suspend => "suspend",
            FaultKind::WrongDate => "wrong-date",
            FaultKind::Leave => "leave",
            FaultKind::Upgrade => "upgrade",
            FaultKind::CircularWait => "circular-wait",
            FaultKind::StaleMajority => "stale-majority",
            FaultKind::BlockedBus => "blocked-bus",
            FaultKind::Poison => "poison",
            FaultKind::Revoke => "revoke",
        }
    }
}

impl std::str::FromStr for FaultKind {
    type Err = UnknownFaultKind;

    fn from_str(name: &str) -> Result<FaultKind, UnknownFaultKind> {
        let mut known = [FaultKind::None].into_iter().chain(FaultKind::FAULTS);
        known.find(|kind| kind.name() == name).ok_or_else(|| UnknownFaultKind(name.to_owned()))
    }
}

/// Name that is no kind of fault.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnknownFaultKind(pub String);

impl Display for UnknownFaultKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<_> = [FaultKind::None].into_iter().chain(FaultKind::FAULTS).map(FaultKind::name).collect();
        write!(f, "no kind of fault is called {:?}; there are {}", self.0, names.join(", "))
    }
}

impl std::error::Error for UnknownFaultKind {}
