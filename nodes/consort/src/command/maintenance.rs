//! `consort maintenance`: takes robots out of service, and returns them to service.

use super::change_flags::ChangeFlags;
use super::robot_selection::{RobotFlags, orders_text};
use crate::exit::Failure;
use consort_protocol::api::{MaintenanceAction, MaintenanceRequest};
use consort_protocol::keys::ApiCall;

/// Take robots out of service for maintenance, or return them to service
///
/// A robot in maintenance finishes the role that it holds and takes no other. Roles that were promised to it are
/// auctioned again. Once it holds no role it is out of service, with the reason. The fleet keeps the maintenance in its
/// ledger, also while the robot is switched off.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort maintenance amber --reason 'new tyres'
  consort maintenance amber --reason inspection --until 2026-12-31T18:00:00+01:00 --by Nia
  consort maintenance amber --end")]
pub(crate) struct Args {
    #[command(flatten)]
    robots: RobotFlags,
    /// Reason, for the record
    #[arg(long, value_name = "TEXT", required_unless_present = "end", conflicts_with = "end")]
    reason: Option<String>,
    /// The maintenance ends by itself at this date and time, as 2026-12-31T18:00:00+01:00. Default: no end
    #[arg(long, value_name = "TIME", conflicts_with = "end")]
    until: Option<String>,
    /// Return the robots to service
    #[arg(long)]
    end: bool,
    #[command(flatten)]
    change: ChangeFlags,
}

/// Runs the command.
///
/// # Errors
/// See [`Client::api`](crate::client::Client::api).
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let Args { robots, reason, until, end, change } = args;
    let action = if end { MaintenanceAction::End } else { MaintenanceAction::Begin };
    let (robots, reason) = (robots.selection()?, reason.unwrap_or_default());
    let request = |by, request| MaintenanceRequest { robots, action, until, reason, by, request };
    change.send(ApiCall::Maintenance, request, orders_text)
}
