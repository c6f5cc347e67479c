//! A process with sessions: a relay, or robots. It reports when a line arrives on its standard input,
//! and ends with it.

use super::RobotMode;
use bytes::Bytes;
use clap::Args as ClapArgs;
use consort_bus::{Bus as _, Delivery, Encoding, ZenohBus, ZenohSettings};
use consort_nodes::exit::Failure;
use consort_nodes::output;
use consort_protocol::timing::Timing;
use serde::{Deserialize, Serialize};
use std::io::BufRead as _;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Port of the relays, and of the first session of a host of robots.
pub(super) const PORT: u16 = 7447;

const BEACON: &str = "consort/bench/wire/beacon";

const KNOWLEDGE: &str = "consort/bench/wire/knowledge";

/// Size of a record of knowledge.
const RECORD_BYTES: usize = 300;

/// A session that received a beacon within this time counts as receiving.
const RECEIVING: Duration = Duration::from_secs(1);

/// Interval of attempts to open a client.
const RETRY: Duration = Duration::from_millis(100);

/// Runs the sessions of a host of `bench relays`.
#[derive(Debug, ClapArgs)]
pub(in super::super) struct HostArgs {
    /// Number of sessions of robots; without it the process is a relay
    #[arg(long)]
    robots: Option<usize>,
    /// Number of the first robot
    #[arg(long, default_value_t = 0)]
    first: usize,
    /// Role of robots
    #[arg(long, value_enum, default_value = "client")]
    mode: RobotMode,
    /// Publish beacons
    #[arg(long)]
    beacon: bool,
    /// Relays to connect to
    #[arg(long)]
    connect: Vec<String>,
}

/// Report of a process on the time since its report before.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Report {
    /// Number of sessions.
    pub(super) sessions: usize,
    /// Sessions that received a beacon within the last second.
    pub(super) receiving: usize,
    /// Longest time without a beacon at a session, in milliseconds.
    pub(super) longest_gap_ms: f64,
    /// Times without a beacon after which a voter campaigns.
    pub(super) alarms: u64,
    /// Longest time without a beacon at each session that has moved to another relay, in milliseconds.
    pub(super) moved_gaps_ms: Vec<f64>,
}

/// Gaps between the beacons of a session.
#[derive(Debug, Default)]
struct Gaps {
    last: Option<Instant>,
    longest: Duration,
    alarms: u64,
    /// Id of the session on the bus at the last beacon. A client that moves to another relay gets another.
    id: String,
    has_moved: bool,
}

impl Gaps {
    fn beacon(&mut self, now: Instant, id: String) {
        self.has_moved |= self.last.is_some() && self.id != id;
        self.id = id;
        if let Some(last) = self.last {
            let gap = now - last;
            self.longest = self.longest.max(gap);
            self.alarms += u64::from(gap > Timing::Lan.parameters().election_min);
        }
        self.last = Some(now);
    }

    /// Returns the gaps since the call before, with the one that has not ended.
    fn take(&mut self, now: Instant) -> Gaps {
        let open = self.last.map_or(Duration::ZERO, |last| now - last);
        Gaps {
            last: self.last,
            longest: std::mem::take(&mut self.longest).max(open),
            alarms: std::mem::take(&mut self.alarms),
            id: self.id.clone(),
            has_moved: std::mem::take(&mut self.has_moved),
        }
    }
}

type SharedGaps = Arc<Mutex<Gaps>>;

fn lock(gaps: &SharedGaps) -> std::sync::MutexGuard<'_, Gaps> {
    gaps.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Runs the process.
///
/// # Errors
/// [`Failure::Unsuccessful`] if a session cannot be opened.
pub(in super::super) fn run(args: HostArgs) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    let runtime = runtime.map_err(|problem| Failure::Unsuccessful(format!("no runtime: {problem}")))?;
    let sessions: Vec<SharedGaps> = (0..args.robots.unwrap_or(1)).map(|_| SharedGaps::default()).collect();
    for (number, gaps) in sessions.iter().enumerate() {
        let settings = settings(&args, number);
        runtime.spawn(session(settings, args.first + number, args.robots.is_some(), args.beacon, Arc::clone(gaps)));
    }
    for line in std::io::stdin().lock().lines() {
        if line.is_err() {
            break;
        }
        let now = Instant::now();
        let mut report = Report { sessions: sessions.len(), ..Report::default() };
        for gaps in &sessions {
            let gaps = lock(gaps).take(now);
            report.receiving += usize::from(gaps.last.is_some_and(|last| now - last < RECEIVING));
            let longest_ms = gaps.longest.as_secs_f64() * 1000.0;
            report.longest_gap_ms = report.longest_gap_ms.max(longest_ms);
            report.alarms += gaps.alarms;
            report.moved_gaps_ms.extend(gaps.has_moved.then_some(longest_ms));
        }
        output::json(&report)?;
    }
    runtime.shutdown_background();
    Ok(())
}

fn settings(args: &HostArgs, number: usize) -> ZenohSettings {
    let Some(_) = args.robots else {
        let listen = vec![format!("tcp/0.0.0.0:{PORT}")];
        return ZenohSettings { listen, connect: args.connect.clone(), ..ZenohSettings::default() };
    };
    // The first relay differs between successive robots. A client has all relays to choose from, a router two neighbours.
    let relays = args.connect.len();
    let chosen = match args.mode {
        RobotMode::Client => relays,
        RobotMode::Router => relays.min(2),
    };
    let connect = (0..chosen).map(|next| args.connect[(args.first + number + next) % relays].clone()).collect();
    let listen = vec![format!("tcp/0.0.0.0:{}", usize::from(PORT) + 1 + number)];
    ZenohSettings { mode: args.mode.mode(), listen, connect, ..ZenohSettings::default() }
}

/// Opens a session, and receives beacons and publishes for as long as the process runs.
async fn session(settings: ZenohSettings, number: usize, is_robot: bool, sends_beacons: bool, gaps: SharedGaps) {
    let bus = loop {
        match ZenohBus::open(settings.clone()).await {
            Ok(bus) => break bus,
            Err(_) => tokio::time::sleep(RETRY).await, // its relay does not listen yet
        }
    };
    let mut beacons = bus.subscribe(BEACON).await.expect("a valid key");
    let receiver = bus.clone();
    tokio::spawn(async move {
        while beacons.recv().await.is_some() {
            lock(&gaps).beacon(Instant::now(), receiver.id());
        }
    });
    if !is_robot {
        let mut records = bus.subscribe(&format!("{KNOWLEDGE}/*")).await.expect("a valid key");
        tokio::spawn(async move { while records.recv().await.is_some() {} });
    }
    let (key, payload, period) = match is_robot {
        true => (format!("{KNOWLEDGE}/{number}"), RECORD_BYTES, Duration::from_secs(1)),
        false => (BEACON.to_owned(), 32, Timing::Lan.parameters().heartbeat),
    };
    if !is_robot && !sends_beacons {
        return std::future::pending().await;
    }
    let mut ticks = tokio::time::interval(period);
    loop {
        ticks.tick().await;
        let payload = Bytes::from(vec![0; payload]);
        // A session without a link drops the message.
        let _ = bus.publish(&key, payload, Encoding::Wire, Delivery::Drop).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(start: Instant, ms: u64) -> Instant {
        start + Duration::from_millis(ms)
    }

    #[test]
    fn a_gap_that_has_not_ended_counts() {
        let start = Instant::now();
        let mut gaps = Gaps::default();
        assert_eq!(gaps.take(start).longest, Duration::ZERO);
        for ms in [100, 200, 700] {
            gaps.beacon(at(start, ms), "a".to_owned());
        }
        let first = gaps.take(at(start, 800));
        assert_eq!((first.longest, first.alarms), (Duration::from_millis(500), 1));
        let second = gaps.take(at(start, 1700));
        assert_eq!((second.longest, second.alarms), (Duration::from_secs(1), 0));
    }

    #[test]
    fn a_session_with_another_id_has_moved() {
        let start = Instant::now();
        let mut gaps = Gaps::default();
        let moved = ["a", "a", "b", "b"].map(|id| {
            gaps.beacon(start, id.to_owned());
            gaps.take(start).has_moved
        });
        assert_eq!(moved, [false, false, true, false]);
    }
}
