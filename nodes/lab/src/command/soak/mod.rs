//! `consort-lab soak`: a fleet of real processes under random faults, with clients at work.

mod certificates;
mod charging;
mod faults;
pub(super) mod fleet;
mod mission_log;
pub(super) mod names;
mod occurrences;
mod orders;
mod supervisors;
mod verdict;
mod workload;

use super::workload_flags::{WorkloadFlags, missions_in_hospital};
use clap::Args as ClapArgs;
use consort_nodes::command::flag_values::InvalidValue;
use consort_nodes::exit::Failure;
use consort_nodes::output;
use consort_protocol::ledger::HistoryLimits;
use consort_skills::extensions::Extensions;
use consort_skills::workload::Workload as UserWorkload;
use consort_tests::chaos::UserParticipants;
use consort_tests::history::{EndedMissions, History};
use consort_tests::host_network::{INSIDE, is_inside, run_inside};
use fleet::{FleetKind, ProcessFleet};
use std::path::PathBuf;
use std::time::Duration;
use workload::Workload;

/// Programs that the namespaces and the packet loss need.
const TOOLS: [&str; 3] = ["ip", "nft", "kill"];

/// Runs a fleet of real processes under random faults, and checks what its clients see.
///
/// Each node is a process of `consort` in a network namespace of its own: three stations that store
/// the ledger on disk, two carriers, an arm and the host of the simulated world. For the given time
/// nodes are killed, stopped and restarted, cables are cut, packets are lost and the network is
/// partitioned. Meanwhile clients submit, cancel and read missions over Zenoh, a schedule submits one
/// each minute, a person holds robots and closes places, and another has robots in maintenance, limits the
/// speed and raises alarms. The carriers share a charger, and charge and park by themselves. Then all faults
/// and orders end, and every mission must end.
///
/// The fleet is closed: each node has a certificate with the roles that it needs, and the clients sign their requests as
/// a person. With an even seed it has the settings of a large fleet (`--large`).
///
/// With `--mission` about half of the submitted missions are those of the user. The carriers have the skills
/// for them, and there is a person on call for each role of people.
///
/// The verdict depends only on what is visible from outside: all calls of the clients must be
/// linearizable, no acknowledged mission may be lost or executed as two missions, each occurrence of the
/// schedule must be one mission, robots must stand still when they are held or an alarm stops them, enter no
/// closed place, exceed no speed limit, and get no roles while they are held, in maintenance or under an alarm,
/// no two may be connected to the charger, no term may have two coordinators, and no process may end by
/// itself.
///
/// It needs Linux with unprivileged user namespaces, or root, and the programs ip (iproute2) and nft
/// (nftables). Nothing is sent outside of its own namespaces. The program `consort` must be beside
/// this program.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort-lab soak --minutes 30
  consort-lab soak --minutes 5 --seed 7        # the same order of faults again; their effects vary
  consort-lab soak --minutes 5 --large         # carriers are clients of the stations, and auctions ask candidates
  consort-lab soak --domain domain.yaml --mission mission.yaml

Exit codes: 0 everything held; 1 something did not, and the logs are kept; 2 the flags are wrong or there can be no
namespaces here.")]
pub(crate) struct Args {
    /// Minutes under faults
    #[arg(long, default_value_t = 30.0, value_parser = minutes)]
    minutes: f64,
    /// Source of the order of faults and requests [default: random]
    #[arg(long)]
    seed: Option<u64>,
    /// No node has a certificate, and clients sign nothing
    #[arg(long)]
    open: bool,
    /// Settings of a large fleet, also with an odd seed: 30 planned nodes, so carriers do not listen and are clients of
    /// the stations, and auctions ask two robots first
    #[arg(long)]
    large: bool,
    #[command(flatten)]
    workload: WorkloadFlags,
    /// Print the verdict as JSON
    #[arg(long)]
    json: bool,
}

fn minutes(text: &str) -> Result<f64, InvalidValue> {
    let minutes: f64 =
        text.parse().map_err(|_| InvalidValue::new(format_args!("{text:?} is not a number of minutes")))?;
    if (0.1..=1440.0).contains(&minutes) { Ok(minutes) } else { Err(InvalidValue::new("from 0.1 to 1440 minutes")) }
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] for wrong files, or if there can be no namespaces here; [`Failure::Unsuccessful`] if
/// something did not hold.
pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let seed = args.seed.unwrap_or_else(|| u64::from(std::process::id()));
    // The nodes are processes of `consort`, without the extensions of this program.
    let own = args.workload.workload(Extensions::default())?;
    let participants = UserParticipants::of(&missions_in_hospital(&own)?);
    if is_inside() {
        return soak(args, seed, own, &participants);
    }
    let hindrance = |reason: String| Failure::Usage(format!("there can be no namespaces here: {reason}"));
    let (minutes, seed_text) = (args.minutes.to_string(), seed.to_string());
    let mut arguments = vec!["soak", "--minutes", &minutes, "--seed", &seed_text];
    let flags = [(args.open, "--open"), (args.large, "--large"), (args.json, "--json")];
    arguments.extend(flags.into_iter().filter_map(|(is_set, flag)| is_set.then_some(flag)));
    let files = args.workload.as_given();
    arguments.extend(files.iter().map(String::as_str));
    let status = run_inside(&arguments, &TOOLS, &std::process::id().to_string()).map_err(hindrance)?;
    if status.success() {
        return Ok(());
    }
    Err(Failure::Unsuccessful(format!("the soak with seed {seed} did not hold")))
}

/// Runs the soak inside the namespaces.
fn soak(args: &Args, seed: u64, own: UserWorkload, participants: &UserParticipants) -> Result<(), Failure> {
    let folder = folder();
    std::fs::create_dir_all(&folder)
        .map_err(|problem| Failure::Usage(format!("{} cannot be created: {problem}", folder.display())))?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let runtime = runtime.map_err(|problem| Failure::Unsuccessful(format!("no runtime: {problem}")))?;
    let verdict = runtime.block_on(async {
        let kind = FleetKind { open: args.open, large: args.large || seed.is_multiple_of(2), charging: true };
        let mut fleet = ProcessFleet::start(&folder, kind, own.extensions.domains, participants).await?;
        let listed_max = HistoryLimits::default().missions_max as usize;
        let history = History::new(EndedMissions { listed_max, are_forgotten: false });
        let workload = Workload::start(&fleet, &history, own, seed).await?;
        let (access, size) = (if kind.open { "open" } else { "closed" }, if kind.large { "large" } else { "small" });
        let minutes = args.minutes;
        output::note(format_args!("seed {seed}: the {access}, {size} fleet works; faults for {minutes} minutes"));
        let faults = faults::inject(&mut fleet, seed, Duration::from_secs_f64(args.minutes * 60.0)).await;
        output::note("all faults are over; waiting for the end of all missions");
        let verdict = verdict::reach(&mut fleet, workload, &history, faults).await;
        fleet.stop();
        Ok::<_, Failure>(verdict)
    })?;
    if args.json {
        output::json(&verdict)?;
    } else {
        output::line(&verdict)?;
    }
    if verdict.violations.is_empty() {
        let _ = std::fs::remove_dir_all(&folder);
        return Ok(());
    }
    Err(Failure::Unsuccessful(format!("the logs and data of the nodes are in {}", folder.display())))
}

/// Returns the folder for the files of the nodes. In its own namespaces each run is process 1 or 2;
/// the variable distinguishes them.
fn folder() -> PathBuf {
    let id = std::env::var(INSIDE).unwrap_or_default();
    std::env::temp_dir().join(format!("consort-soak-{id}"))
}
