//! `consort recover`: makes the store of one voter the whole ledger, when a majority is gone for good.

use crate::exit::Failure;
use crate::output::{self, Progress};
use crate::wiring::random_u64;
use consort_actors::raft::LogStoreContents;
use consort_actors::store::{DurableStore, OpenError, inspect_ledger, recover};
use consort_protocol::count::count;
use consort_protocol::ids::{ClusterId, NodeId};
use consort_protocol::ledger::Ledger;
use std::collections::BTreeSet;
use std::io;
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

/// Make one node's store the whole ledger, when most voters are gone for good
///
/// A fleet of three voters survives the loss of one, a fleet of five that of two. If more are gone, and their disks with
/// them, nobody coordinates any more. This command makes a surviving store that of the only voter; the node is then started
/// as usual, and the others join it with empty stores. The node must not run meanwhile. It shows what the store holds and
/// what may be lost, and changes nothing before it is told to.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort recover --from /var/lib/consort
  consort recover --from /var/lib/consort --yes

Of several stores that are left, take the one whose last entry is the latest: term first, then index. What was there
before is kept beside it.")]
pub struct Args {
    /// The data directory of the node that is to go on
    #[arg(long, value_name = "DATA_DIR")]
    from: PathBuf,
    /// Do it without asking
    #[arg(long)]
    yes: bool,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] if there is no store; [`Failure::Unsuccessful`] if it is in use or not whole, holds nothing, or cannot
/// be written, and if nobody agreed.
pub fn run(args: Args) -> Result<(), Failure> {
    let mut waiting = Progress::on_terminal();
    waiting.show(format_args!("reading {}", args.from.display()));
    let store = DurableStore::open_existing(&args.from).map_err(|problem| match problem {
        OpenError::NotFound { .. } => Failure::Usage(problem.to_string()),
        _ => Failure::Unsuccessful(problem.to_string()),
    })?;
    let file = store.path().display().to_string();
    let failed = |problem: io::Error| Failure::Unsuccessful(format!("{file}: {problem}"));
    let holdings = inspect_ledger(&store).map_err(failed)?;
    waiting.clear();
    let node = store.owner().node.clone();
    output::line(format_args!("{file} is the store of {}.\n", store.owner()))?;
    output::line(contents(&holdings, &node))?;
    if holdings.last.is_none() {
        let what = "it holds no entry: there is nothing to recover; start the node with another data directory";
        return Err(Failure::Unsuccessful(format!("{file}: {what}")));
    }
    let others: BTreeSet<&str> = holdings.voters.values().filter(|voter| **voter != node).map(NodeId::as_str).collect();
    if others.is_empty() {
        return output::line(format_args!(
            "\n{node} is the only voter already: start it as usual. Nothing was changed."
        ));
    }
    output::line(warning(&holdings, &node, others))?;
    if !args.yes && !agreed(&node) {
        let what = "nothing was changed; answer y, or give --yes, to have it done";
        return Err(Failure::Unsuccessful(what.to_owned()));
    }
    let moment = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_millis();
    let cluster = ClusterId(random_u64());
    waiting.show(format_args!("writing {file}"));
    let copies = recover(&store, u64::try_from(moment).unwrap_or(u64::MAX), cluster).map_err(failed)?;
    waiting.clear();
    let copies: Vec<String> = copies.iter().map(|copy| copy.display().to_string()).collect();
    output::line(format_args!(
        "\nDone: {node} is the only voter. What was there before is kept in\n  {}\nStart {node} as usual, with --data-dir {}; \
         then the others, with empty data directories.",
        copies.join("\n  "),
        args.from.display(),
    ))
}

/// What the store holds, in words.
fn contents(holdings: &LogStoreContents<Ledger>, node: &NodeId) -> String {
    let place = |epoch: Option<_>| epoch.map_or("none".to_owned(), |epoch| format!("{epoch}"));
    let voters: BTreeSet<&str> = holdings.voters.values().map(NodeId::as_str).collect();
    let voters = match voters.is_empty() {
        true => "none".to_owned(),
        false => voters.into_iter().collect::<Vec<_>>().join(", "),
    };
    let missions: Vec<Vec<String>> = holdings
        .state
        .missions()
        .map(|entry| vec![format!("  {}", entry.id), entry.state.as_str().to_owned()])
        .collect();
    let live = holdings.state.active_missions().len();
    let mut lines = vec![
        format!("newest term heard of     {}", holdings.term),
        format!("last entry (term.index)  {}", place(holdings.last)),
        format!("known to be committed    {}", place(holdings.committed)),
        format!("voters                   {voters}"),
        format!(
            "missions                 {}, of which {}",
            missions.len(),
            count(live, "has not ended", "have not ended")
        ),
    ];
    if !missions.is_empty() {
        lines.push(output::table(&missions));
    }
    if !holdings.voters.is_empty() && !holdings.voters.values().any(|voter| voter == node) {
        lines.push(format!("{node} is no voter itself: a voter's store, if one is left, holds more."));
    }
    lines.join("\n")
}

/// What may be lost, and what must be done about the others.
fn warning(holdings: &LogStoreContents<Ledger>, node: &NodeId, others: BTreeSet<&str>) -> String {
    let last = holdings.last.map(|last| last.to_string()).unwrap_or_default();
    let committed = holdings.committed.map_or("the beginning".to_owned(), |committed| committed.to_string());
    let others = others.into_iter().collect::<Vec<_>>().join(", ");
    let doubtful = match holdings.last > holdings.committed {
        true => format!(
            "\n- Entries after {committed}, up to {last}, may never have been committed; they are taken as if they had been."
        ),
        false => String::new(),
    };
    format!(
        "\nWhat may be lost:\n\
         - Missions that were acknowledged to their clients and that only the disks of {others} held: they are not in the \
         list above.\n\
         - Every change after entry {last}: missions that have been awarded, carried out or canceled since stand in the \
         list as they stood then. A robot that was given a role since will be told that it has none.{doubtful}\n\
         What you must do:\n\
         - Before {node} is started: end {others}, and see that they do not come back with their old data directories. \
         Remove these, or move them away. As long as a majority of the old voters can come back, do not recover: start \
         them instead. Old and new ledger, which do not merge, would give out the same work.\n\
         - Afterwards: start them with empty data directories. They join {node} as new members."
    )
}

fn agreed(node: &NodeId) -> bool {
    output::note(format_args!("\nMake {node} the only voter? [y/N]"));
    let mut answer = String::new();
    // Nobody to answer, or nothing that can be read, is a no.
    let _ = io::stdin().read_line(&mut answer);
    matches!(answer.trim(), "y" | "Y" | "yes")
}
