//! `consort cancel`: cancels missions.

use super::missions::detail;
use crate::client::{QueryFlags, new_request_id};
use crate::exit::Failure;
use consort_protocol::api::{CancelMissionsReply, CancelMissionsRequest, MissionSelection, SelectionCondition};
use consort_protocol::ids::MissionId;
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{MissionFilter, MissionState};

/// Cancel missions
///
/// Their robots stop safely and become free. A mission that has ended keeps its result. The coordinator selects the
/// missions of a condition once, and cancels all of them in one entry of the ledger: after a takeover either all or none
/// are canceled. A condition uses the fields id, name, state (pending or running), priority, by (who asked for it), age_s
/// (seconds since its submission), parameters and robots of `mission`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort cancel lab-samples-1
  consort cancel lab-samples-1 lab-samples-2 --by 'ward 3, Nia'
  consort cancel --where 'mission.name == \"lab-samples\" && mission.parameters.room == \"IC Room 6\"' --dry-run
  consort cancel --where 'mission.state == \"pending\" && mission.age_s > 3600 && mission.priority < 0'")]
pub struct Args {
    #[command(flatten)]
    missions: MissionFlags,
    /// Only list the missions that would be canceled
    #[arg(long)]
    dry_run: bool,
    /// Name of the responsible person, for the record. Default: in a closed fleet the name in your
    /// certificate, else "an operator"
    #[arg(long, env = "CONSORT_BY", value_name = "NAME")]
    by: Option<String>,
    #[command(flatten)]
    query: QueryFlags,
}

/// Flags for the missions.
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
struct MissionFlags {
    /// The missions, as named by `consort missions`
    #[arg(value_name = "MISSION")]
    missions: Vec<MissionId>,
    /// All active missions that meet a condition, in CEL: 'mission.name == "lab-samples"'
    #[arg(long = "where", value_name = "CONDITION")]
    condition: Option<String>,
}

impl MissionFlags {
    /// Returns the missions.
    ///
    /// # Errors
    /// [`Failure::Usage`] if the condition cannot be compiled.
    fn selection(self) -> Result<MissionSelection, Failure> {
        let MissionFlags { missions, condition } = self;
        match condition {
            Some(condition) => match MissionFilter::compile(&condition) {
                Ok(_) => Ok(MissionSelection::Where(SelectionCondition { condition })),
                Err(problem) => Err(Failure::Usage(format!("--where: {problem}"))),
            },
            None => Ok(MissionSelection::Named(missions.into_iter().collect())),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// See `Client::api`; [`Failure::Usage`] for a wrong condition; [`Failure::Unsuccessful`] with the reason of each selected
/// mission that was left out: it has ended otherwise, does not exist, or the person may not cancel it.
pub fn run(args: Args) -> Result<(), Failure> {
    let Args { missions, dry_run, by, query } = args;
    let missions = missions.selection()?;
    let reply: CancelMissionsReply = query.print_and_read(
        async |client| {
            let by = by.or_else(|| client.is_anonymous().then(|| "an operator".to_owned()));
            let request = CancelMissionsRequest { missions, dry_run, by, request: Some(new_request_id()) };
            client.api(ApiCall::CancelMissions, &request).await
        },
        |reply| reply_text(reply, dry_run),
    )?;
    let refused: Vec<String> = reply.refused.into_iter().map(|(mission, why)| format!("{mission}: {why}")).collect();
    if refused.is_empty() { Ok(()) } else { Err(Failure::Unsuccessful(refused.join("\n"))) }
}

/// Formats the canceled missions, a line for each: `lab-samples-1 canceled: by Nia`.
fn reply_text(CancelMissionsReply { missions, refused, again }: &CancelMissionsReply, dry_run: bool) -> String {
    if *again {
        return "this request was executed before; `consort audit` lists the missions".to_owned();
    }
    if missions.is_empty() && refused.is_empty() {
        return "no mission meets the condition".to_owned();
    }
    let line = |(mission, state): (&MissionId, &Option<MissionState>)| {
        let word = state.as_ref().map_or("canceled", MissionState::as_str);
        let would = if dry_run { "would be canceled; it is " } else { "" };
        format!("{mission} {would}{word}{}", state.as_ref().map(detail).unwrap_or_default())
    };
    missions.iter().map(line).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn the_reply_has_a_line_for_each_mission() {
        let of = |states: &[(&str, MissionState)]| {
            let state = |(name, state): &(&str, MissionState)| (name.parse().unwrap(), Some(state.clone()));
            let missions = states.iter().map(state).collect();
            CancelMissionsReply { missions, refused: BTreeMap::new(), again: false }
        };
        let canceled =
            of(&[("a-1", MissionState::Canceled { by: "Nia".to_owned() }), ("b-2", MissionState::Completed)]);
        assert_eq!(reply_text(&canceled, false), "a-1 canceled: by Nia\nb-2 completed");
        let running = of(&[("a-1", MissionState::Running)]);
        assert_eq!(reply_text(&running, true), "a-1 would be canceled; it is running");
        assert_eq!(reply_text(&of(&[]), true), "no mission meets the condition");
        let again = CancelMissionsReply { again: true, ..of(&[]) };
        assert!(reply_text(&again, false).contains("executed before"));
        let refused =
            CancelMissionsReply { refused: BTreeMap::from([("a-1".parse().unwrap(), String::new())]), ..of(&[]) };
        assert_eq!(reply_text(&refused, false), "", "the reasons follow as an error");
    }
}
