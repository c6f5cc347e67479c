//! Deliberate bugs at the edges of the model, each of which the checker must find.

/// A bug that is injected around the state machines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Flaw {
    /// The driver server ignores the time in a command, and only applies the client timeout.
    DriverIgnoresPermission,
    /// The driver server counts the permission from the arrival of the command.
    PermissionCountsFromArrival,
    /// The coordinator waits for the lease without the grace.
    NoGrace,
    /// A new coordinator counts an award from its commit, and not from the takeover.
    TakeoverKeepsContacts,
    /// The robot counts its lease from the reply, and not from the report.
    LeaseCountsFromReply,
    /// A deposed coordinator replies however old its contact with a majority is.
    DeposedReplies,
    /// A coordinator renews a lease after it has decided to release the role.
    RenewsDuringRelease,
    /// A robot's clock stands still while its machine is suspended.
    ClockStopsInSuspension,
    /// A body needs a tick longer than the grace covers.
    SlowBody,
    /// The permission of a goal that stops slowly ends with the lease, and not earlier.
    NoStopLead,
    /// The role of a robot that restarted without a checkpoint is released at once.
    RestartReleases,
}
