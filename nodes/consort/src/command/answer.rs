//! `consort answer`: answers a request to a person.

use super::flag_values::{key_value, parse_duration};
use super::requests::form_text;
use crate::client::{Client, QueryFlags, read_answer};
use crate::exit::Failure;
use consort_protocol::api::{AnswerReply, AnswerRequest, AnswerWord, ReadOptions};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::PersonRequestId;
use consort_protocol::mission::ValueKind;
use consort_protocol::scalar::Scalar;
use consort_protocol::view::RequestsView;
use std::collections::BTreeMap;
use std::time::Duration;

/// Answer a request to a person
///
/// `consort requests` lists the requests, each with the results that the answer --done must state. The
/// first answer counts; a later one is refused. With --declined or --cannot the mission fails. With
/// --later the request stays open.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort answer lab-samples-1.1 --done --by Nia
  consort answer rounds-7.2 --done --set pulse_bpm=72 --set temperature_c=36.6
  consort answer rounds-7.2 --later 15m
  consort answer rounds-7.2 --cannot --note 'the patient is in surgery'")]
pub(crate) struct Args {
    /// The request, as named by `consort requests`
    request: PersonRequestId,
    #[command(flatten)]
    answer: AnswerFlags,
    /// A result of the task, for --done; may be repeated
    #[arg(long = "set", value_name = "NAME=VALUE", value_parser = key_value, requires = "done")]
    results: Vec<(String, String)>,
    /// Remark, for the record
    #[arg(long, value_name = "TEXT", default_value = "", hide_default_value = true)]
    note: String,
    /// Name of the person, for the record. Default: in a closed fleet the name in your certificate,
    /// else "an operator"
    #[arg(long, env = "CONSORT_BY", value_name = "NAME")]
    by: Option<String>,
    #[command(flatten)]
    ask: QueryFlags,
}

/// Flags of the answer, of which a single flag is given.
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = false)]
struct AnswerFlags {
    /// The task is done
    #[arg(long)]
    done: bool,
    /// You do not want to do it; the mission fails
    #[arg(long)]
    declined: bool,
    /// You are not able to do it; the mission fails
    #[arg(long)]
    cannot: bool,
    /// You will do it later, after this time: minutes with `m`, hours with `h`, at most 24 h
    #[arg(long, value_name = "TIME", num_args = 0..=1, default_missing_value = "10m", value_parser = parse_duration)]
    later: Option<Duration>,
}

impl AnswerFlags {
    fn word(&self) -> AnswerWord {
        match self {
            AnswerFlags { done: true, .. } => AnswerWord::Done,
            AnswerFlags { declined: true, .. } => AnswerWord::Declined,
            AnswerFlags { cannot: true, .. } => AnswerWord::Cannot,
            AnswerFlags { .. } => AnswerWord::Later,
        }
    }
}

/// Runs the command.
///
/// # Errors
/// See [`Client::api`]; an answer that does not fit, or that comes second, is
/// [`Failure::Unsuccessful`].
pub(crate) fn run(args: Args) -> Result<(), Failure> {
    let Args { request, answer, results, note, by, ask } = args;
    let minutes = answer.later.map(|time| u32::try_from(time.as_secs().div_ceil(60)).unwrap_or(u32::MAX));
    ask.print(
        async |client| {
            let results = if results.is_empty() { BTreeMap::new() } else { typed(client, &request, results).await? };
            let by = by.or_else(|| client.is_anonymous().then(|| "an operator".to_owned()));
            let answer = AnswerRequest { request, answer: answer.word(), results, note, minutes, by };
            client.api(ApiCall::Answer, &answer).await
        },
        |AnswerReply { request, phase }: &AnswerReply| match phase {
            Some(phase) => format!("{request} {phase}"),
            None => format!("{request} answered"),
        },
    )
}

/// Reads the values as the form of the request demands.
async fn typed(
    client: &mut Client,
    request: &PersonRequestId,
    values: Vec<(String, String)>,
) -> Result<BTreeMap<String, Scalar>, Failure> {
    let listed = client.api(ApiCall::Requests, &ReadOptions { linearizable: false }).await?;
    let RequestsView { requests } = read_answer(&listed)?;
    let form = requests.into_iter().find(|known| known.request == *request).map(|known| known.form);
    let form = form.unwrap_or_default();
    let value = |(name, text): (String, String)| {
        let value = match form.get(&name) {
            // The coordinator names what is allowed.
            None => Scalar::Text(text),
            Some(kind) => kind.parse(&text).ok_or_else(|| wrong_value(&name, &text, kind, &form))?,
        };
        Ok((name, value))
    };
    values.into_iter().map(value).collect()
}

fn wrong_value(name: &str, text: &str, kind: &ValueKind, form: &BTreeMap<String, ValueKind>) -> Failure {
    Failure::Usage(format!("--set {name}={text}: {name} must be {kind}; the results are {}", form_text(form)))
}
