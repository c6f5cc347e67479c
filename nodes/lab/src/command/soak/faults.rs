//! Random faults of processes and of their network.

use super::fleet::ProcessFleet;
use super::names::{ROBOTS, STATIONS, WORLD};
use consort_nodes::output;
use consort_tests::host_network::Way;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use std::time::Duration;
use tokio::time::{Instant, sleep_until};

/// Most faults at the same time.
const FAULTS_MAX: usize = 2;

/// Number of faults of each kind.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub(super) struct FaultCounts {
    /// Processes ended with SIGKILL, and started again.
    pub(super) kills: u32,
    /// Processes stopped with SIGSTOP for a while.
    pub(super) stops: u32,
    /// Cables unplugged for a while.
    pub(super) cuts: u32,
    /// Hosts that lost packets for a while.
    pub(super) losses: u32,
    /// Partitions of the switch.
    pub(super) partitions: u32,
}

impl FaultCounts {
    /// Returns the number of all faults.
    pub(super) fn total(&self) -> u32 {
        self.kills + self.stops + self.cuts + self.losses + self.partitions
    }
}

/// Fault of some nodes.
#[derive(Debug, Clone)]
enum Fault {
    Kill(&'static str),
    Stop(&'static str),
    Cut(&'static str),
    Loss(&'static str, u32),
    Partition(Vec<&'static str>),
}

/// Injects random faults for a time, or until a process has ended by itself; returns a description of
/// that process. All faults are over when it returns.
pub(super) async fn inject(fleet: &mut ProcessFleet, seed: u64, time: Duration) -> (FaultCounts, Option<String>) {
    let mut chance = ChaCha8Rng::seed_from_u64(seed ^ 0xfa17);
    let (start, mut counts) = (Instant::now(), FaultCounts::default());
    let end = start + time;
    // Each with its end.
    let mut active: Vec<(Instant, Fault)> = vec![];
    let (mut next, mut ended) = (start, None);
    while Instant::now() < end && ended.is_none() {
        let first_end = active.iter().map(|(end, _)| *end).min();
        sleep_until(first_end.map_or(next, |first| first.min(next)).min(end)).await;
        ended = fleet.restart_ended().err();
        let now = Instant::now();
        let (over, rest): (Vec<_>, Vec<_>) = active.into_iter().partition(|(until, _)| *until <= now);
        active = rest;
        for (_, fault) in over {
            fault.end(fleet);
        }
        if now < next || now >= end {
            continue;
        }
        next = now + Duration::from_millis(chance.random_range(1_000..8_000));
        if active.len() < FAULTS_MAX
            && let Some(fault) = Fault::draw(&mut chance, &active)
        {
            let lasts = Duration::from_millis(chance.random_range(1_000..10_000));
            let at = (now - start).as_secs_f64();
            output::note(format_args!("{at:7.1} s  {} for {:.1} s", fault.text(), lasts.as_secs_f64()));
            fault.begin(fleet, &mut counts);
            active.push((now + lasts, fault));
        }
    }
    for (_, fault) in active {
        fault.end(fleet);
    }
    (counts, ended)
}

impl Fault {
    /// Draws a fault of nodes that have none; `None` if the drawn nodes have one already.
    fn draw(chance: &mut ChaCha8Rng, active: &[(Instant, Fault)]) -> Option<Fault> {
        // Stations more often: they store the ledger, and one of them coordinates.
        let nodes: Vec<&'static str> = STATIONS.into_iter().chain(STATIONS).chain(ROBOTS).chain([WORLD]).collect();
        let node = *nodes.choose(chance)?;
        let fault = match chance.random_range(0..10) {
            0..3 if node != WORLD => Fault::Kill(node),
            0..5 => Fault::Stop(node),
            5..7 => Fault::Cut(node),
            7..9 => Fault::Loss(node, chance.random_range(5..40)),
            _ => {
                let mut away = vec![*STATIONS.choose(chance)?];
                away.extend(ROBOTS.into_iter().filter(|_| chance.random_bool(0.3)));
                Fault::Partition(away)
            }
        };
        let is_free = |node: &&str| !active.iter().any(|(_, other)| other.nodes().contains(node));
        fault.nodes().iter().all(is_free).then_some(fault)
    }

    fn nodes(&self) -> Vec<&'static str> {
        match self {
            Fault::Kill(node) | Fault::Stop(node) | Fault::Cut(node) | Fault::Loss(node, _) => vec![node],
            Fault::Partition(nodes) => nodes.clone(),
        }
    }

    fn text(&self) -> String {
        match self {
            Fault::Kill(node) => format!("{node} is killed"),
            Fault::Stop(node) => format!("{node} is stopped"),
            Fault::Cut(node) => format!("the cable of {node} is unplugged"),
            Fault::Loss(node, percent) => format!("{node} loses {percent} % of its packets"),
            Fault::Partition(nodes) => format!("{} are apart from the others", nodes.join(", ")),
        }
    }

    fn begin(&self, fleet: &mut ProcessFleet, counts: &mut FaultCounts) {
        match self {
            Fault::Kill(node) => {
                counts.kills += 1;
                fleet.kill(node);
            }
            Fault::Stop(node) => {
                counts.stops += 1;
                fleet.signal(node, "STOP");
            }
            Fault::Cut(node) => {
                counts.cuts += 1;
                fleet.network.unplug(node);
            }
            Fault::Loss(node, percent) => {
                counts.losses += 1;
                fleet.network.lose(node, Way::In, *percent);
                fleet.network.lose(node, Way::Out, *percent);
            }
            Fault::Partition(nodes) => {
                counts.partitions += 1;
                nodes.iter().for_each(|node| fleet.network.plug(node, "br1"));
            }
        }
    }

    fn end(&self, fleet: &mut ProcessFleet) {
        match self {
            Fault::Kill(node) => {
                if let Err(problem) = fleet.start_node(node) {
                    output::note(problem);
                }
            }
            Fault::Stop(node) => fleet.signal(node, "CONT"),
            Fault::Cut(node) => fleet.network.plug(node, "br0"),
            Fault::Loss(node, _) => fleet.network.lose_nothing(node),
            Fault::Partition(nodes) => nodes.iter().for_each(|node| fleet.network.plug(node, "br0")),
        }
    }
}
