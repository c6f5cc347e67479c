//! `consort-lab bench regions`: tries gateways between the regions of several sites, as Zenoh has them since version 1.9.
//!
//! ```text
//!   member ── member                                member ── member
//!        \    /                                          \    /
//!       gateway 1 ──────── link that counts ──────── gateway 2        all are Zenoh routers, as nodes that relay are
//! ```

use bytes::Bytes;
use clap::{Args as ClapArgs, ValueEnum};
use consort_bus::{Bus as _, Delivery, Encoding, Query, Sample, Stream, ZenohBus, ZenohSettings};
use consort_nodes::exit::Failure;
use consort_nodes::output::{self, Progress};
use serde::Serialize;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, timeout, timeout_at};

/// Region of the gateways. Sessions without this name are in the region of a site.
const GATEWAYS: &str = "sites";

/// Limit for something to pass between the sites.
const LIMIT: Duration = Duration::from_secs(30);

/// Interval of attempts.
const RETRY: Duration = Duration::from_millis(50);

/// Duration of the phase in which nothing happens.
const IDLE: Duration = Duration::from_secs(5);

/// Time without messages between the gateways after which declarations and changes of the routes have passed. Longer than the
/// 100 ms after which Zenoh computes routes again.
const QUIET: Duration = Duration::from_millis(500);

/// Bytes on a link in this time that are keep-alive messages: fewer than a declaration has.
const QUIET_BYTES: u64 = 32;

/// Limit for the reply to a query. A service that is not known yet does not reply.
const QUERY_LIMIT: Duration = Duration::from_secs(1);

/// Number and size of the publications, and number of the declared subscribers.
const COUNT: usize = 100;
const BYTES: usize = 300;

/// Tries gateways between the regions of several sites.
///
/// Each site has a gateway and other routers, with two neighbours each; the gateways of the other sites are linked with
/// that of the first. All are sessions with the settings of a node, in this process, on the loopback interface. The bytes
/// on the links between the gateways are counted: while nothing happens; while routers of the last site declare
/// subscribers, which nothing in other sites concerns; while they publish to each other; while they publish to the first
/// site; and while one of them restarts.
///
/// With the layout `flat` all routers are in one graph, as in a fleet. With `regions` the gateways have the `region_name`
/// and the `gateway` settings of Zenoh, and each site is a region of its own.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  consort-lab bench regions                                # two sites with two routers each besides the gateway, about 30 s
  consort-lab bench regions --sites 4 --members 25
  consort-lab bench regions --layout regions --json | jq .restart_bytes

received counts the publications, of 100, that reach the first site; a dash, or null, means that a token or a reply did
not pass. Bytes are those in both directions on all links between gateways, with Zenoh's keep-alive messages.")]
pub(super) struct Args {
    /// Number of sites, from 2 to 10
    #[arg(long, value_name = "N", default_value_t = 2,
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(2..=10))]
    sites: usize,
    /// Number of routers of each site besides its gateway, from 1 to 100
    #[arg(long, value_name = "N", default_value_t = 2,
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=100))]
    members: usize,
    /// Layouts to try
    #[arg(long, value_enum, value_delimiter = ',', default_values = ["flat", "regions"])]
    layout: Vec<Layout>,
    /// Print a JSON object for each layout
    #[arg(long)]
    json: bool,
}

/// Division of the routers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum Layout {
    /// A single graph of all routers.
    Flat,
    /// A region for each site, and one for the gateways.
    Regions,
}

impl Layout {
    fn name(self) -> &'static str {
        match self {
            Layout::Flat => "flat",
            Layout::Regions => "regions",
        }
    }

    /// Returns the settings of a gateway with these neighbours.
    fn gateway(self, connect: Vec<String>) -> ZenohSettings {
        let overrides = match self {
            Layout::Flat => vec![],
            Layout::Regions => vec![
                ("region_name".to_owned(), format!("{GATEWAYS:?}")),
                (
                    "gateway".to_owned(),
                    format!("{{ south: [{{ filters: [{{ negated: true, region_names: [{GATEWAYS:?}] }}] }}] }}"),
                ),
            ],
        };
        ZenohSettings { connect, overrides, ..ZenohSettings::default() }
    }
}

/// Figures of a layout.
#[derive(Debug, Serialize)]
struct RegionFigures {
    layout: Layout,
    sites: usize,
    members: usize,
    /// Seconds until a router of the first site has received a publication of each session.
    start_s: f64,
    /// Milliseconds until a presence token of the last site appears in the first.
    token_ms: Option<f64>,
    /// Milliseconds until the token vanishes there.
    vanish_ms: Option<f64>,
    /// Milliseconds of a query from the first site to the last.
    query_ms: Option<f64>,
    /// Publications of the last site that are received in the first.
    received: usize,
    /// Bytes between the gateways per second while nothing happens.
    idle_bytes_per_s: f64,
    /// Bytes between the gateways while subscribers are declared that concern the last site alone.
    declare_bytes: u64,
    /// Bytes between the gateways while routers of the last site publish to these subscribers.
    local_bytes: u64,
    /// Bytes between the gateways while routers of the last site publish to the first.
    shared_bytes: u64,
    /// Bytes between the gateways while a router of the last site restarts.
    restart_bytes: u64,
}

/// Runs the command.
///
/// # Errors
/// [`Failure::Unsuccessful`] if a session cannot be opened, or the sites do not receive each other's publications.
pub(super) fn run(args: &Args) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(unsuccessful)?;
    if !args.json {
        output::line(HEADER)?;
    }
    for layout in &args.layout {
        let figures = runtime.block_on(measure(*layout, args.sites, args.members))?;
        if args.json {
            output::json(&figures)?;
        } else {
            output::line(row(&figures))?;
        }
    }
    runtime.shutdown_background();
    Ok(())
}

fn unsuccessful(problem: impl std::fmt::Display) -> Failure {
    Failure::Unsuccessful(problem.to_string())
}

async fn measure(layout: Layout, sites: usize, members: usize) -> Result<RegionFigures, Failure> {
    let mut progress = Progress::on_terminal();
    progress.show(format_args!("{}: the sessions open", layout.name()));
    let began = Instant::now();
    let mut network = SiteNetwork::open(layout, sites, members).await?;
    network.await_publications().await?;
    let start_s = began.elapsed().as_secs_f64();
    network.settle().await;

    progress.show(format_args!("{}: nothing happens", layout.name()));
    let before = network.bytes();
    sleep(IDLE).await;
    let idle_bytes_per_s = (network.bytes() - before) as f64 / IDLE.as_secs_f64();

    progress.show(format_args!("{}: what concerns one site", layout.name()));
    let last = network.last_site().clone();
    let before = network.bytes();
    let mut local = vec![];
    for number in 0..COUNT {
        local.push(last.gateway.subscribe(&local_key(number)).await.map_err(unsuccessful)?);
    }
    // The last of them is known, so all are.
    if let Some(samples) = local.last_mut() {
        publish_until_received(&last.members[0], &local_key(COUNT - 1), samples).await?;
    }
    network.settle().await;
    let declare_bytes = network.bytes() - before;
    let before = network.bytes();
    publish(&last.members[0], "consort/bench/local").await?;
    let deadline = Instant::now() + LIMIT;
    for samples in &mut local {
        let received = timeout_at(deadline, samples.recv()).await;
        received.map_err(|_| unsuccessful("the last site does not receive its own publications"))?;
    }
    network.settle().await;
    let local_bytes = network.bytes() - before;
    drop(local);

    progress.show(format_args!("{}: what passes between sites", layout.name()));
    let first = network.first_member().clone();
    let mut samples = first.subscribe("consort/bench/shared/*").await.map_err(unsuccessful)?;
    publish_until_received(&last.members[0], "consort/bench/shared/first", &mut samples).await?;
    network.settle().await;
    while samples.try_recv().is_some() {}
    let before = network.bytes();
    publish(&last.members[0], "consort/bench/shared").await?;
    let (deadline, mut received) = (Instant::now() + LIMIT, 0);
    while received < COUNT && timeout_at(deadline, samples.recv()).await.is_ok_and(|sample| sample.is_some()) {
        received += 1;
    }
    network.settle().await;
    let shared_bytes = network.bytes() - before;
    let (token_ms, vanish_ms) = try_token(&network, &first, &last.members[0]).await?;
    let query_ms = try_query(&first, &last.members[0]).await?;

    progress.show(format_args!("{}: a router restarts", layout.name()));
    drop(last);
    let before = network.bytes();
    network.restart_last_member().await?;
    network.settle().await;
    let restart_bytes = network.bytes() - before;
    network.close().await;
    Ok(RegionFigures {
        layout,
        sites,
        members,
        start_s,
        token_ms,
        vanish_ms,
        query_ms,
        received,
        idle_bytes_per_s,
        declare_bytes,
        local_bytes,
        shared_bytes,
        restart_bytes,
    })
}

fn local_key(number: usize) -> String {
    format!("consort/bench/local/{number}")
}

/// Publishes on a key until it is received or [`LIMIT`] has passed: before, the publisher does not know the subscriber.
async fn publish_until_received(bus: &ZenohBus, key: &str, samples: &mut Stream<Sample>) -> Result<(), Failure> {
    let began = Instant::now();
    while samples.try_recv().is_none() && began.elapsed() < LIMIT {
        bus.publish(key, Bytes::new(), Encoding::Wire, Delivery::Drop).await.map_err(unsuccessful)?;
        sleep(RETRY).await;
    }
    Ok(())
}

/// Publishes on keys below `prefix`.
async fn publish(bus: &ZenohBus, prefix: &str) -> Result<(), Failure> {
    for number in 0..COUNT {
        let (key, payload) = (format!("{prefix}/{number}"), Bytes::from(vec![0; BYTES]));
        bus.publish(&key, payload, Encoding::Wire, Delivery::Block).await.map_err(unsuccessful)?;
    }
    Ok(())
}

fn millis(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1000.0
}

/// Returns the times until a token of `far` appears at `near`, and until it vanishes there.
async fn try_token(
    network: &SiteNetwork,
    near: &ZenohBus,
    far: &ZenohBus,
) -> Result<(Option<f64>, Option<f64>), Failure> {
    let mut tokens = near.watch("consort/bench/alive/*").await.map_err(unsuccessful)?;
    network.settle().await;
    let announced = Instant::now();
    let token = far.announce("consort/bench/alive/far").await.map_err(unsuccessful)?;
    let appeared = timeout(LIMIT, tokens.recv()).await.ok().flatten().filter(|presence| presence.alive);
    let token_ms = appeared.map(|_| millis(announced));
    let dropped = Instant::now();
    drop(token);
    let vanished = timeout(LIMIT, tokens.recv()).await.ok().flatten().filter(|presence| !presence.alive);
    Ok((token_ms, vanished.map(|_| millis(dropped))))
}

/// Returns the time of a query of `near` that a service of `far` answers. Attempts repeat until the service is known.
async fn try_query(near: &ZenohBus, far: &ZenohBus) -> Result<Option<f64>, Failure> {
    let key = "consort/bench/service";
    let service = far.serve(key).await.map_err(unsuccessful)?;
    let mut serving = JoinSet::new();
    serving.spawn(reply_to_all(service));
    let began = Instant::now();
    while began.elapsed() < LIMIT {
        let asked = Instant::now();
        let mut replies = near.query(key, Bytes::new(), QUERY_LIMIT).await.map_err(unsuccessful)?;
        if replies.recv().await.is_some_and(|reply| reply.payload.is_ok()) {
            return Ok(Some(millis(asked)));
        }
        sleep(RETRY).await;
    }
    Ok(None)
}

async fn reply_to_all(mut service: Stream<Query>) {
    while let Some(query) = service.recv().await {
        // The query may have timed out.
        let _ = query.replier.reply(&query.key, Bytes::from_static(b"yes"), Encoding::Wire).await;
    }
}

/// Routers of a site.
#[derive(Clone)]
struct Site {
    gateway: ZenohBus,
    /// Sessions of the other nodes of the site; never empty.
    members: Vec<ZenohBus>,
}

impl Site {
    fn sessions(&self) -> impl Iterator<Item = &ZenohBus> {
        [&self.gateway].into_iter().chain(&self.members)
    }

    /// Opens a router that is linked with the gateway and with the last member.
    async fn open_member(&self) -> Result<ZenohBus, Failure> {
        let mut connect = vec![];
        for neighbour in [Some(&self.gateway), self.members.last()].into_iter().flatten() {
            connect.push(address(neighbour).await?);
        }
        ZenohBus::open(ZenohSettings { connect, ..ZenohSettings::default() }).await.map_err(unsuccessful)
    }
}

/// All sites, and the links between their gateways.
struct SiteNetwork {
    /// At least two.
    sites: Vec<Site>,
    links: Vec<CountedLink>,
}

impl SiteNetwork {
    async fn open(layout: Layout, sites: usize, members: usize) -> Result<SiteNetwork, Failure> {
        let mut network = SiteNetwork { sites: vec![], links: vec![] };
        for _ in 0..sites {
            let mut others = vec![];
            if let Some(first) = network.sites.first() {
                let link = CountedLink::open(&address(&first.gateway).await?).await.map_err(unsuccessful)?;
                others.push(link.address.clone());
                network.links.push(link);
            }
            let gateway = ZenohBus::open(layout.gateway(others)).await.map_err(unsuccessful)?;
            let mut site = Site { gateway, members: vec![] };
            for _ in 0..members {
                let member = site.open_member().await?;
                site.members.push(member);
            }
            network.sites.push(site);
        }
        Ok(network)
    }

    fn first_member(&self) -> &ZenohBus {
        &self.sites[0].members[0]
    }

    fn last_site(&self) -> &Site {
        &self.sites[self.sites.len() - 1]
    }

    /// Returns the bytes between the gateways so far.
    fn bytes(&self) -> u64 {
        self.links.iter().map(|link| link.bytes.load(Ordering::Relaxed)).sum()
    }

    /// Waits until the links between the gateways carry keep-alive messages only, or [`LIMIT`] has passed.
    async fn settle(&self) {
        let (began, bytes_max) = (Instant::now(), QUIET_BYTES * self.links.len() as u64);
        while began.elapsed() < LIMIT {
            let before = self.bytes();
            sleep(QUIET).await;
            if self.bytes() - before <= bytes_max {
                return;
            }
        }
    }

    /// Waits until a router of the first site has received a publication of each session.
    async fn await_publications(&self) -> Result<(), Failure> {
        let mut samples = self.first_member().subscribe("consort/bench/start/*").await.map_err(unsuccessful)?;
        let sessions: Vec<&ZenohBus> = self.sites.iter().flat_map(Site::sessions).collect();
        let (began, mut received) = (Instant::now(), BTreeSet::new());
        while received.len() < sessions.len() {
            if began.elapsed() > LIMIT {
                return Err(unsuccessful(format_args!(
                    "the first site has received publications of {} of {} sessions after {LIMIT:?}",
                    received.len(),
                    sessions.len()
                )));
            }
            for (number, session) in sessions.iter().enumerate() {
                let key = format!("consort/bench/start/{number}");
                session.publish(&key, Bytes::new(), Encoding::Wire, Delivery::Drop).await.map_err(unsuccessful)?;
            }
            sleep(RETRY).await;
            received.extend(std::iter::from_fn(|| samples.try_recv()).map(|sample| sample.key));
        }
        Ok(())
    }

    /// Closes the last router of the last site and opens it again.
    async fn restart_last_member(&mut self) -> Result<(), Failure> {
        if let Some(member) = self.sites.last_mut().and_then(|site| site.members.pop()) {
            member.close().await.map_err(unsuccessful)?;
        }
        self.settle().await;
        let Some(site) = self.sites.last_mut() else { return Ok(()) };
        let member = site.open_member().await?;
        site.members.push(member);
        Ok(())
    }

    async fn close(self) {
        for session in self.sites.iter().flat_map(Site::sessions) {
            // It is of no use in either case.
            let _ = session.close().await;
        }
    }
}

/// Returns the address at which a session listens.
async fn address(bus: &ZenohBus) -> Result<String, Failure> {
    let addresses = bus.listen_addresses().await;
    addresses.into_iter().next().ok_or_else(|| unsuccessful("a session listens on no address"))
}

/// A link between two gateways whose bytes are counted.
struct CountedLink {
    /// Address that forwards to the other gateway.
    address: String,
    bytes: Arc<AtomicU64>,
    _accepting: JoinSet<()>,
}

impl CountedLink {
    /// Opens a link to a gateway.
    async fn open(to: &str) -> std::io::Result<CountedLink> {
        let to = to.trim_start_matches("tcp/").to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").await?;
        let address = format!("tcp/{}", listener.local_addr()?);
        let bytes = Arc::new(AtomicU64::new(0));
        let (counted, mut accepting) = (Arc::clone(&bytes), JoinSet::new());
        accepting.spawn(async move {
            while let Ok((near, _)) = listener.accept().await {
                let Ok(far) = TcpStream::connect(&to).await else { continue };
                // Latencies are measured.
                let _ = near.set_nodelay(true).and_then(|()| far.set_nodelay(true));
                let ((from_near, to_near), (from_far, to_far)) = (near.into_split(), far.into_split());
                tokio::spawn(forward(from_near, to_far, Arc::clone(&counted)));
                tokio::spawn(forward(from_far, to_near, Arc::clone(&counted)));
            }
        });
        Ok(CountedLink { address, bytes, _accepting: accepting })
    }
}

/// Forwards and counts bytes until a side is closed.
async fn forward(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, counted: Arc<AtomicU64>) {
    let mut buffer = vec![0; 16 * 1024];
    while let Ok(read @ 1..) = from.read(&mut buffer).await {
        counted.fetch_add(read as u64, Ordering::Relaxed);
        if to.write_all(&buffer[..read]).await.is_err() {
            return;
        }
    }
}

const HEADER: &str = "\
layout   sites  routers  start  passes between sites                        bytes between the gateways
                of each  s      of 100  token ms  vanishes ms  query ms     idle/s  declared  local    shared   restart";

fn row(figures: &RegionFigures) -> String {
    let ms = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |ms| format!("{ms:.1}"));
    format!(
        "{:<8} {:<6} {:<8} {:<6.1} {:<7} {:<9} {:<12} {:<12} {:<7.0} {:<9} {:<8} {:<8} {}",
        figures.layout.name(),
        figures.sites,
        figures.members + 1,
        figures.start_s,
        figures.received,
        ms(figures.token_ms),
        ms(figures.vanish_ms),
        ms(figures.query_ms),
        figures.idle_bytes_per_s,
        figures.declare_bytes,
        figures.local_bytes,
        figures.shared_bytes,
        figures.restart_bytes,
    )
}
