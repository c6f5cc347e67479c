//! `consort limit`: sets and clears speed limits.

use super::change_flags::{ChangeFlags, ReasonFlag};
use super::close::{PartFlags, Places};
use super::flag_values::parse_duration;
use super::hold::seconds;
use crate::exit::Failure;
use consort_fleet::recurrence::until_text;
use consort_protocol::api::{CLOSE_S_MAX, LimitAction, LimitRequest, LimitsReply};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::SpeedLimit;
use consort_protocol::units::MetresPerSecond;
use std::time::Duration;

/// Limit the speed of robots at places, on lanes or in zones
///
/// The limit of a place holds on every lane from and to it. A robot that drives there stops and goes on at the allowed
/// speed, and estimates of drives count with it at once. The fleet keeps limits in its ledger, so the next coordinator
/// repeats them; `consort fleet` lists them. A robot without contact heeds the limits that it has received. This is not
/// a safety function: it depends on the network, and on the driver of the robot.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort limit 'IC Corridor 5' --speed 0.3 --reason 'wet floor'
  consort limit icu --speed 0.5 --for 2h --by Nia
  consort limit --lane 'IC Corridor 5' 'IC Room 5' --speed 0.2 --until 2026-12-31T18:00:00+01:00
  consort limit icu --clear")]
pub(crate) struct Args {
    #[command(flatten)]
    parts: PartFlags,
    /// The highest allowed speed in metres per second, 0.05 or more
    #[arg(long, value_name = "M_PER_S", value_parser = parse_speed)]
    #[arg(required_unless_present = "clear", conflicts_with = "clear")]
    speed: Option<MetresPerSecond>,
    /// Clear the limits
    #[arg(long, conflicts_with = "reason")]
    clear: bool,
    /// The limit ends by itself after this time, as 30m or 2d. Default: no end
    #[arg(long = "for", value_name = "TIME", value_parser = parse_duration, conflicts_with_all = ["until", "clear"])]
    length: Option<Duration>,
    /// The limit ends by itself at this date and time, as 2026-12-31T18:00:00+01:00
    #[arg(long, value_name = "TIME", conflicts_with = "clear")]
    until: Option<String>,
    #[command(flatten)]
    reason: ReasonFlag,
    #[command(flatten)]
    change: ChangeFlags,
}

fn parse_speed(text: &str) -> Result<MetresPerSecond, String> {
    let speed: f64 = text.parse().map_err(|_| "allowed is a number, such as 0.3".to_owned())?;
    MetresPerSecond::new(speed).map_err(|problem| problem.to_string())
}

/// Runs `consort limit`.
///
/// # Errors
/// See [`Client::api`](crate::client::Client::api); [`Failure::Usage`] if the time is too long.
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let Args { parts, speed: speed_mps, clear, length, until, reason: ReasonFlag { reason }, change } = args;
    let Places { places, lanes } = parts.places();
    let for_s = length.map(|length| seconds(length, CLOSE_S_MAX)).transpose()?;
    let action = if clear { LimitAction::Clear } else { LimitAction::Set };
    let request = |by, request| LimitRequest { places, lanes, action, speed_mps, for_s, until, reason, by, request };
    change.send(ApiCall::Limit, request, reply_text)
}

fn reply_text(LimitsReply { speed_limits }: &LimitsReply) -> String {
    if speed_limits.is_empty() { "no speed is limited".to_owned() } else { limits_text(speed_limits) }
}

/// Formats speed limits, a line for each: `IC Room 6 is limited to 0.3 m/s by Nia: wet floor, until 2026-12-31 17:00 UTC`.
pub(super) fn limits_text(limits: &[SpeedLimit]) -> String {
    let line = |limit: &SpeedLimit| format!("{}{}", limit.text(), until_text(limit.order.until_ms));
    limits.iter().map(line).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::ledger::{MapPart, RobotOrder};

    #[test]
    fn limits_are_shown_with_their_ends_and_reasons() {
        let (by, reason) = ("Nia".to_owned(), "wet floor".to_owned());
        let order = RobotOrder { by, reason, since_ms: 1, until_ms: Some(1_767_225_600_000) };
        let part = MapPart::of_lane("B".parse().unwrap(), "A".parse().unwrap());
        let limit = SpeedLimit { part, speed_mps: parse_speed("0.3").unwrap(), order };
        let expected = "A – B is limited to 0.3 m/s by Nia: wet floor, until 2026-01-01 00:00 UTC";
        assert_eq!(limits_text(&[limit]), expected);
        assert!(parse_speed("0").is_err() && parse_speed("fast").is_err());
    }
}
