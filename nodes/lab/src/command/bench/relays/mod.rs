//! `consort-lab bench relays`: measures Zenoh with many sessions.
//!
//! ```text
//!   relay-1 (beacons) ── relay-2 ── relay-3       a process and a host each, all linked with each other
//!        └──────────┬────────┴──────────┘
//!     robots-1   robots-2   robots-3              a process and a host each, with a third of the sessions
//! ```

mod host;
mod process;

pub(super) use host::{HostArgs, run as run_host};

use super::run_in_namespaces;
use clap::{Args as ClapArgs, ValueEnum};
use consort_bus::zenoh_bus::Mode;
use consort_nodes::exit::Failure;
use consort_nodes::output::{self, Progress};
use consort_tests::host_network::{HostNetwork, Way, is_inside};
use consort_tests::percentiles::Percentiles;
use host::Report;
use process::HostProcess;
use serde::Serialize;
use std::time::{Duration, Instant};

/// Programs that the namespaces need, the last one only to lose packets.
const TOOLS: [&str; 2] = ["ip", "nft"];

const RELAYS: [&str; 3] = ["relay-1", "relay-2", "relay-3"];

const ROBOT_HOSTS: [&str; 3] = ["robots-1", "robots-2", "robots-3"];

/// Limit for all sessions to receive beacons.
const START_LIMIT: Duration = Duration::from_secs(180);

/// Duration of each phase.
const PHASE: Duration = Duration::from_secs(20);

/// Time in which a relay with a plugged cable is linked again.
const RELINK: Duration = Duration::from_secs(10);

/// Time for which the cable of robots is unplugged.
const FLAP: Duration = Duration::from_secs(1);

/// Measures Zenoh with three relays and many robots, in network namespaces.
///
/// Three relays are processes on hosts of their own, and three more processes contain the sessions of the robots. The
/// first relay publishes a beacon every 100 ms, which all others receive, and each robot publishes 300 bytes a second,
/// which the relays receive. After a calm phase the cable of a host with a third of the robots is unplugged for a second.
/// Then the cable of the third relay is unplugged for as long as a phase takes, and at last the second relay is killed.
///
/// With `--mode client` robots are clients of the relays, as in a fleet with `planned_nodes`; with `router` they are
/// routers with two neighbours, as in a fleet without.
///
/// With `--loss` packets to and from the robots are lost, as on wireless links.
///
/// It needs Linux with unprivileged user namespaces, or root, and the program ip (iproute2), for losses also nft. Nothing is
/// sent outside of its own namespaces.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort-lab bench relays                                   # 50, 100 and 300 robots, clients
  consort-lab bench relays --robots 100,300 --mode router    # as routers
  consort-lab bench relays --robots 50 --loss 0,2            # without and with a loss of 2 %
  consort-lab bench relays --robots 300 --json | jq .kill.longest_gap_ms

longest_gap_ms is the longest time that a robot received no beacon; of the robots behind the unplugged cable it is
affected_gap_ms. moved has the number of robots that moved to another relay in a phase, and the time for which these
received no beacon: to notice the failure, and to move. vanish is the phase of the unplugged relay. false_takeovers
counts the times that a relay missed the beacons for 300 ms, after which a voter of a fleet with the timing `lan`
campaigns.")]
pub(super) struct Args {
    /// Number of robots: a run for each number, from 3 to 1000
    #[arg(long, value_name = "N,…", value_delimiter = ',', default_values_t = [50, 100, 300],
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(3..=1000))]
    robots: Vec<usize>,
    /// Role of the robots' sessions
    #[arg(long, value_enum, default_value = "client")]
    mode: RobotMode,
    /// Packets to and from robots that are lost, in percent: a run for each value, from 0 to 20
    #[arg(long, value_name = "PERCENT,…", value_delimiter = ',', default_values_t = [0],
        value_parser = clap::value_parser!(u32).range(0..=20))]
    loss: Vec<u32>,
    /// Print a JSON object for each number
    #[arg(long)]
    json: bool,
}

/// Role of a session towards its neighbours.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum RobotMode {
    /// Sends and receives everything through a relay, and moves to another when it fails.
    Client,
    /// Relays messages of its neighbours.
    Router,
}

impl RobotMode {
    fn name(self) -> &'static str {
        match self {
            RobotMode::Client => "client",
            RobotMode::Router => "router",
        }
    }

    fn mode(self) -> Mode {
        match self {
            RobotMode::Client => Mode::NodeClient,
            RobotMode::Router => Mode::Router,
        }
    }
}

/// Figures of a run.
#[derive(Debug, Serialize)]
struct RelayFigures {
    robots: usize,
    mode: RobotMode,
    /// Lost packets to and from robots, in percent.
    loss_percent: u32,
    /// Seconds until all sessions received beacons.
    start_s: f64,
    calm: PhaseFigures,
    /// A cable is unplugged for a second.
    flap: PhaseFigures,
    /// The cable of a relay is unplugged.
    vanish: PhaseFigures,
    /// A relay is killed.
    kill: PhaseFigures,
    /// Computing time of the mean relay in the calm phase, in percent of a core.
    relay_cpu_percent: f64,
    /// Computing time of the mean robot in the calm phase, in percent of a core.
    robot_cpu_percent: f64,
    /// Memory of the largest relay, in MB.
    relay_memory_mb: f64,
}

/// Figures of a phase.
#[derive(Debug, Serialize)]
struct PhaseFigures {
    /// Longest time without a beacon at a robot, in milliseconds.
    longest_gap_ms: f64,
    /// The same for the robots behind the unplugged cable.
    #[serde(skip_serializing_if = "Option::is_none")]
    affected_gap_ms: Option<f64>,
    /// The robots that moved to another relay.
    moved: MovedFigures,
    /// Number of times that a relay missed beacons for as long as a voter waits before it campaigns.
    false_takeovers: u64,
    /// Robots without a beacon in the last second of the phase.
    silent_robots: usize,
}

/// Robots that moved to another relay in a phase.
#[derive(Debug, Serialize)]
struct MovedFigures {
    robots: usize,
    /// Time without a beacon of the median robot, in milliseconds.
    p50_ms: Option<f64>,
    /// The same of the slowest robot.
    max_ms: Option<f64>,
}

impl MovedFigures {
    fn of(gaps_ms: Vec<f64>) -> MovedFigures {
        let (robots, max_ms) = (gaps_ms.len(), gaps_ms.iter().copied().reduce(f64::max));
        MovedFigures { robots, p50_ms: Percentiles::of(gaps_ms).map(|gaps| gaps.p50), max_ms }
    }
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Usage`] if there can be no namespaces here; [`Failure::Unsuccessful`] if a run fails.
pub(super) fn run(args: &Args) -> Result<(), Failure> {
    if !is_inside() {
        let robots = args.robots.iter().map(usize::to_string).collect::<Vec<_>>().join(",");
        let loss = args.loss.iter().map(u32::to_string).collect::<Vec<_>>().join(",");
        let mut arguments = vec!["bench", "relays", "--robots", &robots, "--mode", args.mode.name(), "--loss", &loss];
        arguments.extend(args.json.then_some("--json"));
        let loses = args.loss.iter().any(|percent| *percent > 0);
        return run_in_namespaces(&arguments, if loses { &TOOLS[..] } else { &TOOLS[..1] });
    }
    if !args.json {
        output::line(HEADER)?;
    }
    let mut network = HostNetwork::new();
    for host in RELAYS.into_iter().chain(ROBOT_HOSTS) {
        network.add(host);
    }
    for loss_percent in args.loss.iter().copied() {
        set_loss(&network, loss_percent);
        for robots in &args.robots {
            let figures = measure(&network, *robots, args.mode, loss_percent)?;
            if args.json {
                output::json(&figures)?;
            } else {
                output::line(row(&figures))?;
            }
        }
        end_loss(&network, loss_percent);
    }
    Ok(())
}

/// Loses packets to and from robots.
fn set_loss(network: &HostNetwork, percent: u32) {
    for host in ROBOT_HOSTS.into_iter().filter(|_| percent > 0) {
        network.lose(host, Way::In, percent);
        network.lose(host, Way::Out, percent);
    }
}

/// Ends the loss of packets, if there is any.
fn end_loss(network: &HostNetwork, percent: u32) {
    for host in ROBOT_HOSTS.into_iter().filter(|_| percent > 0) {
        network.lose_nothing(host);
    }
}

fn measure(network: &HostNetwork, robots: usize, mode: RobotMode, loss_percent: u32) -> Result<RelayFigures, Failure> {
    let mut progress = Progress::on_terminal();
    progress.show(format_args!("{robots} robots: the sessions open"));
    let began = Instant::now();
    let mut relays = vec![];
    for (number, host) in RELAYS.iter().enumerate() {
        relays.push(HostProcess::relay(network, host, &RELAYS[..number])?);
    }
    let mut hosts = vec![];
    for (number, host) in ROBOT_HOSTS.iter().enumerate() {
        let first = robots * number / ROBOT_HOSTS.len();
        let sessions = robots * (number + 1) / ROBOT_HOSTS.len() - first;
        hosts.push(HostProcess::robots(network, host, first, sessions, mode)?);
    }
    loop {
        let receiving = hosts.iter_mut().map(HostProcess::report).collect::<Result<Vec<Report>, _>>()?;
        if receiving.iter().map(|report| report.receiving).sum::<usize>() == robots {
            break;
        }
        if began.elapsed() > START_LIMIT {
            let receiving: usize = receiving.iter().map(|report| report.receiving).sum();
            return Err(Failure::Unsuccessful(format!(
                "only {receiving} of {robots} robots receive beacons after {START_LIMIT:?}"
            )));
        }
        std::thread::sleep(Duration::from_millis(200));
    }
    let start_s = began.elapsed().as_secs_f64();

    progress.show(format_args!("{robots} robots: calm"));
    reset(&mut relays, &mut hosts)?;
    let cpu = |processes: &[HostProcess]| processes.iter().map(HostProcess::cpu_s).sum::<f64>();
    let before = (cpu(&relays), cpu(&hosts));
    std::thread::sleep(PHASE);
    let after = (cpu(&relays), cpu(&hosts));
    let percent = |seconds: f64, parts: usize| seconds / PHASE.as_secs_f64() / parts as f64 * 100.0;
    let relay_cpu_percent = percent(after.0 - before.0, relays.len());
    let robot_cpu_percent = percent(after.1 - before.1, robots);
    let calm = phase(&mut relays, &mut hosts, None)?;

    progress.show(format_args!("{robots} robots: a cable is unplugged"));
    network.unplug(ROBOT_HOSTS[0]);
    std::thread::sleep(FLAP);
    network.plug(ROBOT_HOSTS[0], "br0");
    std::thread::sleep(PHASE - FLAP);
    let flap = phase(&mut relays, &mut hosts, Some(0))?;

    progress.show(format_args!("{robots} robots: the cable of a relay is unplugged"));
    network.unplug(RELAYS[2]);
    std::thread::sleep(PHASE);
    // The unplugged relay misses the beacons, which is no false takeover.
    let vanish = phase(&mut relays[..2], &mut hosts, None);
    network.plug(RELAYS[2], "br0");
    let vanish = vanish?;
    std::thread::sleep(RELINK);
    reset(&mut relays, &mut hosts)?;

    progress.show(format_args!("{robots} robots: a relay is killed"));
    let relay_memory_mb = relays.iter().map(HostProcess::memory_mb).fold(0.0, f64::max);
    drop(relays.remove(1));
    std::thread::sleep(PHASE);
    let kill = phase(&mut relays, &mut hosts, None)?;
    Ok(RelayFigures {
        robots,
        mode,
        loss_percent,
        start_s,
        calm,
        flap,
        vanish,
        kill,
        relay_cpu_percent,
        robot_cpu_percent,
        relay_memory_mb,
    })
}

fn reset(relays: &mut [HostProcess], hosts: &mut [HostProcess]) -> Result<(), Failure> {
    relays.iter_mut().chain(hosts).try_for_each(|process| process.report().map(|_| ()))
}

/// Returns the figures since the reports before. `affected` is the number of the unplugged host.
fn phase(
    relays: &mut [HostProcess],
    hosts: &mut [HostProcess],
    affected: Option<usize>,
) -> Result<PhaseFigures, Failure> {
    let of_relays = relays.iter_mut().map(HostProcess::report).collect::<Result<Vec<_>, _>>()?;
    let of_hosts = hosts.iter_mut().map(HostProcess::report).collect::<Result<Vec<_>, _>>()?;
    let others = of_hosts.iter().enumerate().filter(|(number, _)| Some(*number) != affected);
    Ok(PhaseFigures {
        longest_gap_ms: others.map(|(_, report)| report.longest_gap_ms).fold(0.0, f64::max),
        affected_gap_ms: affected.map(|number| of_hosts[number].longest_gap_ms),
        moved: MovedFigures::of(of_hosts.iter().flat_map(|report| report.moved_gaps_ms.iter().copied()).collect()),
        false_takeovers: of_relays.iter().map(|report| report.alarms).sum(),
        silent_robots: of_hosts.iter().map(|report| report.sessions - report.receiving).sum(),
    })
}

const HEADER: &str = "\
robots  mode    loss  start  longest gap without beacon, ms                          moved: p50, ms            false      silent  CPU of relay  CPU of robot  relay
                %     s      calm    cable   behind cable  relay silent  relay dead  relay silent  relay dead  takeovers  robots  % of a core   % of a core   MB";

fn row(figures: &RelayFigures) -> String {
    let phases = [&figures.calm, &figures.flap, &figures.vanish, &figures.kill];
    let p50 = |phase: &PhaseFigures| phase.moved.p50_ms.map_or("-".to_owned(), |gap_ms| format!("{gap_ms:.0}"));
    format!(
        "{:<7} {:<7} {:<5} {:<6.1} {:<7.0} {:<7.0} {:<13.0} {:<13.0} {:<11.0} {:<13} {:<11} {:<10} {:<7} {:<13.1} {:<13.2} {:.0}",
        figures.robots,
        figures.mode.name(),
        figures.loss_percent,
        figures.start_s,
        figures.calm.longest_gap_ms,
        figures.flap.longest_gap_ms,
        figures.flap.affected_gap_ms.unwrap_or_default(),
        figures.vanish.longest_gap_ms,
        figures.kill.longest_gap_ms,
        p50(&figures.vanish),
        p50(&figures.kill),
        phases.iter().map(|phase| phase.false_takeovers).sum::<u64>(),
        figures.kill.silent_robots,
        figures.relay_cpu_percent,
        figures.robot_cpu_percent,
        figures.relay_memory_mb,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_times_of_moved_robots_have_a_median_and_a_maximum() {
        let figures = |gaps_ms: &[f64]| {
            let MovedFigures { robots, p50_ms, max_ms } = MovedFigures::of(gaps_ms.to_vec());
            (robots, p50_ms, max_ms)
        };
        assert_eq!(figures(&[]), (0, None, None));
        assert_eq!(figures(&[900.0, 600.0, 700.0]), (3, Some(700.0), Some(900.0)));
    }
}
