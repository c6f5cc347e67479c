//! `consort recover`: recovers the ledger from the store of a single voter, when a majority is lost
//! for good.

use crate::exit::Failure;
use crate::output::{self, Progress};
use crate::wiring::random_u64;
use consort_protocol::ids::{ClusterId, NodeId};
use consort_protocol::ledger::Ledger;
use consort_raft::LogStoreContents;
use consort_raft::store::{DurableStore, OpenError, inspect_ledger, recover};
use consort_text::count;
use std::collections::BTreeSet;
use std::io;
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

/// Recover the ledger from a single node's store, when most voters are lost for good
///
/// A fleet of three voters survives the loss of a voter, a fleet of five the loss of two. If more
/// voters and their disks are lost, no coordinator can be elected. This command makes a surviving
/// node the only voter. The node is then started as usual, and the others join it with empty
/// stores. The node must not run meanwhile. The command shows the content of the store and the
/// possible losses, and changes nothing before you confirm.
#[derive(Debug, clap::Args)]
#[command(after_long_help = "\
Examples:
  consort recover --from /var/lib/consort
  consort recover --from /var/lib/consort --yes

If several stores are left, take the store with the latest last entry: compare the term first, then the index. The
former store is kept next to the new store.")]
pub(crate) struct Args {
    /// The data directory of the surviving node
    #[arg(long, value_name = "DATA_DIR")]
    from: PathBuf,
    /// Do not ask for confirmation
    #[arg(long)]
    yes: bool,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] if there is no store; [`Failure::Unsuccessful`] if it is in use, damaged or
/// empty, or cannot be written, and if the recovery is not confirmed.
pub(crate) fn run(args: Args) -> Result<(), Failure> {
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
        let what = "it has no entries: there is nothing to recover; start the node with another data directory";
        return Err(Failure::Unsuccessful(format!("{file}: {what}")));
    }
    let others: BTreeSet<&str> = holdings.voters.values().filter(|voter| **voter != node).map(NodeId::as_str).collect();
    if others.is_empty() {
        return output::line(format_args!(
            "\n{node} is the only voter already: start it as usual. Nothing was changed."
        ));
    }
    output::line(warning(&holdings, &node, others))?;
    if !args.yes && !confirmed(&node) {
        let what = "nothing was changed; confirm with y, or use --yes";
        return Err(Failure::Unsuccessful(what.to_owned()));
    }
    let moment = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_millis();
    let cluster = ClusterId(random_u64());
    waiting.show(format_args!("writing {file}"));
    let copies = recover(&store, u64::try_from(moment).unwrap_or(u64::MAX), cluster).map_err(failed)?;
    waiting.clear();
    let copies: Vec<String> = copies.iter().map(|copy| copy.display().to_string()).collect();
    output::line(format_args!(
        "\nDone: {node} is the only voter. The former store is kept in\n  {}\nStart {node} as usual, with --data-dir {}; \
         then the others, with empty data directories.",
        copies.join("\n  "),
        args.from.display(),
    ))
}

/// Describes the content of the store.
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
        format!("newest term received     {}", holdings.term),
        format!("last entry (term.index)  {}", place(holdings.last)),
        format!("committed up to          {}", place(holdings.committed)),
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
        lines.push(format!("{node} is not a voter: the store of a voter, if any is left, holds more."));
    }
    lines.join("\n")
}

/// Describes the possible losses, and the steps for the other nodes.
fn warning(holdings: &LogStoreContents<Ledger>, node: &NodeId, others: BTreeSet<&str>) -> String {
    let last = holdings.last.map(|last| last.to_string()).unwrap_or_default();
    let committed = holdings.committed.map_or("the beginning".to_owned(), |committed| committed.to_string());
    let others = others.into_iter().collect::<Vec<_>>().join(", ");
    let uncommitted = match holdings.last > holdings.committed {
        true => format!(
            "\n- Entries after {committed}, up to {last}, may not have been committed; they count as committed from now on."
        ),
        false => String::new(),
    };
    format!(
        "\nPossible losses:\n\
         - Acknowledged missions that only the disks of {others} hold: they are not in the list above.\n\
         - Every change after entry {last}: missions that have been awarded, carried out or canceled since are listed \
         with their former state. A robot that was awarded a role since will lose it.{uncommitted}\n\
         Required steps:\n\
         - Before {node} is started: end {others}, and make sure that they do not restart with their old data directories. \
         Remove these, or move them away. As long as a majority of the old voters can restart, do not recover: start \
         them instead. The old and the new ledger do not merge, and would award the same work twice.\n\
         - Afterwards: start them with empty data directories. They join {node} as new members."
    )
}

fn confirmed(node: &NodeId) -> bool {
    output::note(format_args!("\nMake {node} the only voter? [y/N]"));
    let mut answer = String::new();
    // No input, or unreadable input, is a no.
    let _ = io::stdin().read_line(&mut answer);
    matches!(answer.trim(), "y" | "Y" | "yes")
}
