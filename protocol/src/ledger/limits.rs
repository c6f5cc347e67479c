//! Size limits of the ledger, since wire version 3. A snapshot must stay below
//! [`RECORD_BYTES_MAX`](codec::RECORD_BYTES_MAX), or no replica can write or install it.
//!
//! | part | limit |
//! |---|---|
//! | a command | a message, checked when it is proposed; its texts and auction record are shortened |
//! | the request of a mission | [`Submission::BYTES_MAX`] |
//! | a mission | about 128 KiB: the request, an auction record, 16 releases, a cause, 16 KiB of outcomes, and the requests to people: an open one of 1 KiB and an open question of 1 KiB for each role, and 16 closed ones of 1 KiB; orders of people about roles, at most 0.5 KiB for each role |
//! | the ledger | [`UNENDED_MAX`] missions that have not ended, the history ([`HistoryLimits`]), [`Schedule::MAX`] schedules of [`Schedule::BYTES_MAX`], orders to robots, closures, speed limits and alarms ([`ORDERS_BYTES_MAX`], [`CLOSURES_BYTES_MAX`], [`SPEED_LIMITS_BYTES_MAX`], [`ALARMS_BYTES_MAX`], [`ORDER_REQUESTS_BYTES_MAX`]), the audit trail ([`AUDIT_BYTES_MAX`]), and leases of chargers and devices ([`RESOURCE_LEASES_BYTES_MAX`]) |

use super::alarm::{ALARMS_BYTES_MAX, AlarmChange};
use super::apply::Ledger;
use super::audit_trail::AUDIT_BYTES_MAX;
use super::closure::{CLOSURES_BYTES_MAX, ClosureChange};
use super::command::Command;
use super::command_error::CommandError;
use super::entry::{MissionEntry, MissionState};
use super::history_limits::HistoryLimits;
use super::order_book::ORDER_REQUESTS_BYTES_MAX;
use super::person_request::PERSON_BYTES_MAX;
use super::resource_lease::RESOURCE_LEASES_BYTES_MAX;
use super::robot_order::{ORDERS_BYTES_MAX, OrderChange};
use super::schedule::Schedule;
use super::speed_limit::{SPEED_LIMITS_BYTES_MAX, SpeedLimitChange};
use super::submission::Submission;
use crate::bounds::{TEXT_BYTES_MAX, limit_text};
use crate::codec;

/// Maximum size of a cause in the ledger, in bytes.
pub(super) const CAUSE_BYTES_MAX: usize = 1024;

/// Maximum number of missions that are active or wait for a person. Raised: a snapshot may be too
/// large for every replica.
pub(super) const UNENDED_MAX: usize = 1399;

const _: () = assert!(
    (UNENDED_MAX + HistoryLimits::LARGEST.missions_max as usize) * MissionEntry::BYTES_MAX
        + (HistoryLimits::LARGEST.outcome_bytes_max as usize)
        + Schedule::MAX * Schedule::BYTES_MAX
        + ORDERS_BYTES_MAX
        + CLOSURES_BYTES_MAX
        + SPEED_LIMITS_BYTES_MAX
        + ALARMS_BYTES_MAX
        + ORDER_REQUESTS_BYTES_MAX
        + AUDIT_BYTES_MAX
        + RESOURCE_LEASES_BYTES_MAX
        < codec::RECORD_BYTES_MAX,
    "a snapshot of a full ledger can be stored"
);

impl MissionEntry {
    /// Approximate maximum encoded size in bytes.
    pub const BYTES_MAX: usize = 128 * 1024;

    /// Returns the encoded size in bytes.
    pub fn encoded_bytes(&self) -> usize {
        codec::encoded_size(self)
    }
}

impl Submission {
    /// Maximum encoded size in bytes: the award of the mission and its call for bids must each fit
    /// in a message.
    pub const BYTES_MAX: usize = codec::MESSAGE_BYTES_MAX / 2;
}

impl Command {
    /// Returns the command with its texts and its auction record shortened to their limits.
    #[must_use]
    pub fn limited(mut self) -> Command {
        match &mut self {
            Command::Release { cause, .. } | Command::Fail { cause, .. } => limit_text(cause, CAUSE_BYTES_MAX),
            Command::Cancel { by, .. }
            | Command::Resolve { by, .. }
            | Command::RemoveSchedule { by, .. }
            | Command::ResumeSchedule { by, .. }
            | Command::RaiseWireVersion { by, .. } => limit_text(by, PERSON_BYTES_MAX),
            Command::Submit(submission) => limit_text(&mut submission.by, PERSON_BYTES_MAX),
            Command::PauseSchedule { pause, .. } => limit_text(&mut pause.by, PERSON_BYTES_MAX),
            Command::AddSchedule { schedule, .. } => limit_text(&mut schedule.submission.by, PERSON_BYTES_MAX),
            Command::OrderRobots { order, .. } => {
                limit_text(&mut order.by, PERSON_BYTES_MAX);
                match &mut order.change {
                    OrderChange::Hold { reason, .. } | OrderChange::Maintain { reason, .. } => {
                        limit_text(reason, PERSON_BYTES_MAX);
                    }
                    OrderChange::Release | OrderChange::EndMaintenance => {}
                }
            }
            Command::ChangeClosures { order, .. } => {
                limit_text(&mut order.by, PERSON_BYTES_MAX);
                if let ClosureChange::Close { reason, .. } = &mut order.change {
                    limit_text(reason, PERSON_BYTES_MAX);
                }
            }
            Command::ChangeSpeedLimits { order, .. } => {
                limit_text(&mut order.by, PERSON_BYTES_MAX);
                if let SpeedLimitChange::Set { reason, .. } = &mut order.change {
                    limit_text(reason, PERSON_BYTES_MAX);
                }
            }
            Command::ChangeAlarms { order } => {
                limit_text(&mut order.by, PERSON_BYTES_MAX);
                if let AlarmChange::Raise { reason, .. } = &mut order.change {
                    limit_text(reason, PERSON_BYTES_MAX);
                }
            }
            Command::ChangeMission { order, .. } => limit_text(&mut order.by, PERSON_BYTES_MAX),
            Command::CancelMissions { order } => limit_text(&mut order.by, PERSON_BYTES_MAX),
            Command::AnswerPerson { answer, .. } => answer.limit(),
            Command::SetQuestion { question: asked, .. } => limit_text(&mut asked.question.message, TEXT_BYTES_MAX),
            Command::Award { auction, .. } | Command::Defer { auction, .. } => auction.limit(),
            Command::MovePromise(change) => {
                limit_text(&mut change.cause, CAUSE_BYTES_MAX);
                change.auction.limit();
            }
            Command::Bootstrap { .. }
            | Command::Accept { .. }
            | Command::Progress { .. }
            | Command::AskPerson { .. }
            | Command::AwardPromised { .. }
            | Command::Postpone { .. }
            | Command::EscalatePersonRequest { .. }
            | Command::ExpirePersonRequest { .. }
            | Command::SubmitOccurrence { .. }
            | Command::SkipOccurrences { .. }
            | Command::ExpireOrders { .. }
            | Command::EndOrders { .. }
            | Command::LeaseResource { .. }
            | Command::FreeResource { .. }
            | Command::SetHistoryLimits(_) => {}
        }
        self
    }
}

impl MissionState {
    /// Shortens the cause.
    pub(super) fn limit_cause(&mut self) {
        if let MissionState::Failed { cause, .. } | MissionState::NeedsIntervention { cause, .. } = self {
            limit_text(cause, CAUSE_BYTES_MAX);
        }
    }
}

impl Ledger {
    /// Checks that there is room for another mission.
    pub(super) fn check_room(&self, submission: &Submission) -> Result<(), CommandError> {
        let bytes = codec::encoded_size(submission);
        if bytes > Submission::BYTES_MAX {
            return Err(CommandError::TooLarge { bytes: bytes as u64, max: Submission::BYTES_MAX as u64 });
        }
        match self.unended() {
            missions if missions >= UNENDED_MAX => Err(CommandError::Full { missions: missions as u64 }),
            _ => Ok(()),
        }
    }
}
