//! `consort audit`: lists requested changes with their times and persons.

use super::flag_values::parse_duration;
use crate::client::{ClientFlags, ReadFlags, read_answer};
use crate::exit::Failure;
use crate::output;
use consort_bus::clock::Clock;
use consort_fleet::recurrence::time_in_zone;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::AuditEntry;
use consort_protocol::view::AuditView;
use std::time::Duration;

/// List who requested which change, and when
///
/// The entries come from the ledger: each is made together with its change, and in a closed fleet it names the signer.
/// The fleet keeps the latest 2000 entries; export them regularly to keep them longer. Times are those of the
/// coordinator. The leave of a node is not part of the trail: it is in the logs of the nodes.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort audit
  consort audit --since 12h --person Nia
  consort audit --linearizable --json >> audit.jsonl")]
pub(crate) struct Args {
    /// Only changes within this time before now, as 12h or 7d
    #[arg(long, value_name = "TIME", value_parser = parse_duration)]
    since: Option<Duration>,
    /// Only changes by persons whose name contains this text
    #[arg(long, value_name = "TEXT")]
    person: Option<String>,
    #[command(flatten)]
    read: ReadFlags,
    /// Print a JSON object per line, with the fields of `view/audit`
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    client: ClientFlags,
}

/// Runs the command.
///
/// # Errors
/// See [`Client::api`](crate::client::Client::api).
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let Args { since, person, read, json, client } = args;
    let answer = client.with_client(async |client| client.api(ApiCall::Audit, &read.options()).await)?;
    let AuditView { mut entries } = read_answer(&answer)?;
    let from_ms = since.map_or(0, |since| {
        let since_ms = u64::try_from(since.as_millis()).unwrap_or(u64::MAX);
        Clock::real().wall_ms().saturating_sub(since_ms)
    });
    entries.retain(|entry| is_wanted(entry, from_ms, person.as_deref()));
    if json {
        return entries.iter().try_for_each(output::json);
    }
    if entries.is_empty() {
        return output::line("no changes by people");
    }
    let heads = ["TIME", "PERSON", "ACTION", "SUBJECT", "DETAILS"].map(str::to_owned).to_vec();
    let rows: Vec<Vec<String>> = std::iter::once(heads).chain(entries.iter().map(row)).collect();
    output::line(output::table(&rows))
}

fn is_wanted(entry: &AuditEntry, from_ms: u64, person: Option<&str>) -> bool {
    let is_person = |person: &str| entry.by.to_lowercase().contains(&person.to_lowercase());
    entry.at_ms >= from_ms && person.is_none_or(is_person)
}

fn row(entry: &AuditEntry) -> Vec<String> {
    let or_dash = |text: &str| if text.is_empty() { "-".to_owned() } else { text.to_owned() };
    vec![
        time_in_zone(entry.at_ms, "UTC"),
        or_dash(&entry.by),
        entry.action.to_string().replace('_', " "),
        entry.subject.clone(),
        or_dash(&entry.details),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::ledger::AuditAction;

    #[test]
    fn entries_are_selected_by_time_and_by_a_part_of_the_name() {
        let entry = AuditEntry {
            number: 1,
            at_ms: 1_000,
            by: "Nia, according to client".to_owned(),
            action: AuditAction::AddSchedule,
            subject: "rounds".to_owned(),
            details: String::new(),
        };
        assert!(
            is_wanted(&entry, 0, None) && is_wanted(&entry, 1_000, Some("nia")) && is_wanted(&entry, 0, Some("client"))
        );
        assert!(!is_wanted(&entry, 1_001, None) && !is_wanted(&entry, 0, Some("Abe")));
        assert_eq!(row(&entry)[1..], ["Nia, according to client", "add schedule", "rounds", "-"]);
    }
}
