//! `consort hold` and `consort release`: hold robots, and release them.

use super::change_flags::{ChangeFlags, ReasonFlag};
use super::flag_values::parse_duration;
use super::robot_selection::{RobotFlags, orders_text};
use crate::exit::Failure;
use consort_protocol::api::{HOLD_S_MAX, HoldRequest, ReleaseRequest};
use consort_protocol::keys::ApiCall;
use std::time::Duration;

/// Hold robots: they stand still at once, and keep their roles
///
/// A held robot stops as it does at the end of a lease, starts no task and takes no role. It keeps the role that it
/// holds, and continues it with the interrupted task when it is released or when the hold ends. The fleet keeps the
/// hold in its ledger: the next coordinator repeats it, and a robot that was cut off gets it when it is back. Until
/// then a robot without contact stops at the end of its lease. Deadlines of missions do not wait for held robots.
/// This is not an emergency stop: it depends on the network.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort hold amber --reason 'wet floor'
  consort hold amber birch --for 30m --by Nia
  consort hold --where 'robot.attributes.section == \"icu\"' --reason evacuation
  consort hold --zone icu --reason alarm
  consort hold --all --for 2m
  consort release --all")]
pub(crate) struct HoldArgs {
    #[command(flatten)]
    robots: RobotFlags,
    /// The hold ends by itself after this time, at most 1d
    #[arg(long = "for", value_name = "TIME", default_value = "10m", value_parser = parse_duration)]
    length: Duration,
    #[command(flatten)]
    reason: ReasonFlag,
    #[command(flatten)]
    change: ChangeFlags,
}

/// Release held robots: they continue their roles
///
/// Robots that are not held stay as they are.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort release amber
  consort release --where 'robot.attributes.section == \"icu\"'
  consort release --all --by Nia")]
pub(crate) struct ReleaseArgs {
    #[command(flatten)]
    robots: RobotFlags,
    #[command(flatten)]
    change: ChangeFlags,
}

/// Runs `consort hold`.
///
/// # Errors
/// See [`Client::api`](crate::client::Client::api); [`Failure::Usage`] if the time is too long.
pub(crate) fn run(args: HoldArgs) -> Result<(), Failure> {
    let HoldArgs { robots, length, reason: ReasonFlag { reason }, change } = args;
    let (robots, for_s) = (robots.selection()?, Some(seconds(length, HOLD_S_MAX)?));
    change.send(ApiCall::Hold, |by, request| HoldRequest { robots, for_s, reason, by, request }, orders_text)
}

/// Runs `consort release`.
///
/// # Errors
/// See [`Client::api`](crate::client::Client::api).
pub(crate) fn release(args: ReleaseArgs) -> Result<(), Failure> {
    let ReleaseArgs { robots, change } = args;
    let robots = robots.selection()?;
    change.send(ApiCall::Release, |by, request| ReleaseRequest { robots, by, request }, orders_text)
}

/// Returns the whole seconds of `--for`, at most `max`; a part of a second counts as a second.
pub(super) fn seconds(length: Duration, max: u32) -> Result<u32, Failure> {
    let seconds = length.as_secs() + u64::from(length.subsec_nanos() > 0);
    let seconds = u32::try_from(seconds).ok().filter(|seconds| *seconds <= max);
    seconds.ok_or_else(|| Failure::Usage(format!("--for is longer than {} h", max / 3600)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hold_lasts_a_day_at_most() {
        let of = |ms| seconds(Duration::from_millis(ms), HOLD_S_MAX).ok();
        assert_eq!([of(1), of(1_000), of(1_500), of(86_400_000)], [Some(1), Some(1), Some(2), Some(86_400)]);
        assert_eq!([of(86_400_001), of(u64::MAX)], [None, None]);
    }
}
