//! `consort alarm`: raises an alarm of the fleet file, and clears alarms.

use super::change_flags::{ChangeFlags, ReasonFlag};
use crate::exit::Failure;
use consort_protocol::api::{AlarmAction, AlarmRequest, AlarmsReply};
use consort_protocol::ids::AlarmId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::Alarm;

/// Raise an alarm for all robots, or clear alarms
///
/// The fleet file declares the alarms. While an alarm lasts, no robot takes a role, and a robot with a role suspends it
/// and keeps it, with its items. The robots stand still, or drive to the nearest assembly place that they can reach; of
/// two alarms, to stand still prevails. They do not enter the places, zones and lanes that the alarm closes. After
/// `--clear` they go on with their roles. The fleet keeps alarms in its ledger: the next coordinator repeats them, and a
/// robot that starts or joins gets them. A robot without contact obeys the alarms that it has received, and with a role
/// it stops at the end of its lease. This is not a safety function: it depends on the network.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort alarm fire --reason 'smoke in the laboratory' --by Nia
  consort alarm --clear fire
  consort alarm --clear")]
pub(crate) struct Args {
    /// The alarm, as named in the fleet file. With `--clear`, default: all alarms
    #[arg(value_name = "NAME", required_unless_present = "clear")]
    alarm: Option<AlarmId>,
    /// Clear the alarm, or all alarms
    #[arg(long, conflicts_with = "reason")]
    clear: bool,
    #[command(flatten)]
    reason: ReasonFlag,
    #[command(flatten)]
    change: ChangeFlags,
}

/// Runs the command.
///
/// # Errors
/// See [`Client::api`](crate::client::Client::api).
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let Args { alarm, clear, reason: ReasonFlag { reason }, change } = args;
    let action = if clear { AlarmAction::Clear } else { AlarmAction::Raise };
    change.send(ApiCall::Alarm, |by, request| AlarmRequest { action, alarm, reason, by, request }, reply_text)
}

fn reply_text(AlarmsReply { alarms }: &AlarmsReply) -> String {
    if alarms.is_empty() { "no alarm is in force".to_owned() } else { alarms_text(alarms) }
}

/// Formats alarms, a line for each: `the fleet is under alarm fire by Nia: smoke; robots stand still`.
pub(super) fn alarms_text(alarms: &[Alarm]) -> String {
    let line = |alarm: &Alarm| format!("the fleet is {}; {}", alarm.text(), alarm.plan.text());
    alarms.iter().map(line).collect::<Vec<_>>().join("\n")
}
