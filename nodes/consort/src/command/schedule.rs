//! `consort schedule`: missions that are submitted at certain times.

use super::change_flags::ChangeFlags;
use super::flags::MissionFlags;
use crate::client::{QueryFlags, ReadFlags};
use crate::exit::Failure;
use crate::output;
use consort_dashboard::fleet_model::schedule_state;
use consort_fleet::recurrence::Recurrence;
use consort_protocol::api::{ScheduleAction, ScheduleReply, ScheduleRequest};
use consort_protocol::ids::ScheduleId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{MissedOccurrences, ScheduleRule};
use consort_protocol::view::{ScheduleView, SchedulesView};

/// Submit missions at certain times
///
/// The fleet keeps the schedules in its ledger, and submits the mission of each occurrence once, whichever node
/// coordinates. The clocks of a majority of the voters decide about the time.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort schedule add rounds --cron '0 8 * * 1-5' --zone Europe/Berlin vital-signs --set room_a='IC Room 6'
  consort schedule add night --cron '*/30 22-23,0-5 * * *' --zone Europe/Berlin --missed last ward-disinfection
  consort schedule list
  consort schedule pause rounds --by Nia
  consort schedule resume rounds
  consort schedule remove rounds")]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Add a schedule
    ///
    /// The same schedule may be added again. To change one, remove it first.
    Add(AddArgs),
    /// List the schedules with their next occurrences
    List(ListArgs),
    /// Leave out the occurrences of a schedule until it is resumed
    Pause(ChangeArgs),
    /// Resume a schedule; what it missed in the pause is left out
    Resume(ChangeArgs),
    /// Remove a schedule; its missions go on
    Remove(ChangeArgs),
}

#[derive(Debug, clap::Args)]
struct AddArgs {
    /// Name of the schedule
    schedule: ScheduleId,
    /// The times: minute, hour, day of the month, month, day of the week
    ///
    /// '0 8 * * 1-5' is 8 o'clock from Monday to Friday, '*/20 * * * *' every 20 minutes, '0 9 1 * *' 9 o'clock on the
    /// first of each month. A time that summer time leaves out counts when the clocks change; a time that
    /// occurs twice counts once.
    #[arg(long, value_name = "PATTERN")]
    cron: String,
    /// The time zone of these times, as Europe/Berlin
    #[arg(long, value_name = "NAME", default_value = "UTC")]
    zone: String,
    /// No occurrences after this date and time, as 2026-12-31T18:00:00+01:00. Default: no end
    #[arg(long, value_name = "TIME")]
    until: Option<String>,
    /// What becomes of occurrences that are more than a minute late, because the fleet had no coordinator or no room:
    /// skip leaves them out, last submits the last one, all submits all
    #[arg(long, value_name = "WHICH", default_value = "skip", value_parser = ["skip", "last", "all"])]
    missed: String,
    #[command(flatten)]
    mission: MissionFlags,
    #[command(flatten)]
    change: ChangeFlags,
}

#[derive(Debug, clap::Args)]
struct ListArgs {
    #[command(flatten)]
    read: ReadFlags,
    #[command(flatten)]
    query: QueryFlags,
}

#[derive(Debug, clap::Args)]
struct ChangeArgs {
    /// The schedule, as named by `consort schedule list`
    schedule: ScheduleId,
    #[command(flatten)]
    change: ChangeFlags,
}

/// Runs the command.
///
/// # Errors
/// See [`Client::api`](crate::client::Client::api); [`Failure::Usage`] if the times or the mission are invalid.
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    match args.what {
        What::Add(args) => add(args),
        What::List(args) => list(args),
        What::Pause(args) => change(args, ScheduleAction::Pause),
        What::Resume(args) => change(args, ScheduleAction::Resume),
        What::Remove(args) => change(args, ScheduleAction::Remove),
    }
}

fn add(args: AddArgs) -> Result<(), Failure> {
    let AddArgs { schedule, cron, zone, until, missed, mission, change: ChangeFlags { by, query } } = args;
    let missed = match missed.as_str() {
        "last" => MissedOccurrences::Last,
        "all" => MissedOccurrences::All,
        _ => MissedOccurrences::Skip,
    };
    let rule = ScheduleRule { cron, zone, until_ms: None, missed };
    Recurrence::parse(&rule).map_err(|problem| Failure::Usage(problem.to_string()))?;
    let submit = Some(Box::new(mission.request()?));
    let (cron, zone, missed) = (Some(rule.cron), Some(rule.zone), Some(rule.missed));
    let action = ScheduleAction::Add;
    let request = ScheduleRequest { schedule, action, cron, zone, until, missed, submit, by };
    send(&query, &request)
}

fn change(args: ChangeArgs, action: ScheduleAction) -> Result<(), Failure> {
    let ChangeArgs { schedule, change: ChangeFlags { by, query } } = args;
    let (cron, zone, until, missed, submit) = (None, None, None, None, None);
    send(&query, &ScheduleRequest { schedule, action, cron, zone, until, missed, submit, by })
}

fn send(query: &QueryFlags, request: &ScheduleRequest) -> Result<(), Failure> {
    query.print(
        async |client| client.api(ApiCall::Schedule, request).await,
        |ScheduleReply { schedule }: &ScheduleReply| match schedule {
            Some(view) => format!("{}: {}", view.schedule, schedule_state(view)),
            None => format!("{} is removed", request.schedule),
        },
    )
}

fn list(args: ListArgs) -> Result<(), Failure> {
    let ListArgs { read, query } = args;
    query.print(
        async |client| client.api(ApiCall::Schedules, &read.options()).await,
        |SchedulesView { schedules }: &SchedulesView| {
            if schedules.is_empty() {
                return "no schedules".to_owned();
            }
            let heads = ["SCHEDULE", "MISSION", "TIMES", "ZONE", "SUBMITTED", "LATEST", "STATE"].map(str::to_owned);
            let rows: Vec<Vec<String>> = std::iter::once(heads.to_vec()).chain(schedules.iter().map(row)).collect();
            output::table(&rows)
        },
    )
}

fn row(view: &ScheduleView) -> Vec<String> {
    vec![
        view.schedule.to_string(),
        view.mission.to_string(),
        view.cron.clone(),
        view.zone.clone(),
        view.submitted.to_string(),
        view.last.as_ref().map_or("-".to_owned(), |last| last.mission.to_string()),
        schedule_state(view),
    ]
}
