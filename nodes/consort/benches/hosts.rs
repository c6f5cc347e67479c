//! Figures of fleets on separate hosts: network namespaces with a cable each, and a release process
//! in each.
//!
//! ```text
//! cargo bench -p consort --bench hosts -- idle [SECONDS]         cost of an idle fleet of seven nodes for each node
//! cargo bench -p consort --bench hosts -- idle-closed [SECONDS]  the same with certificates
//! cargo bench -p consort --bench hosts -- signing [SECONDS]      both at the same time: a ratio independent of other load
//! cargo bench -p consort --bench hosts -- cuts [COUNT]           from the cut of the coordinator's cable to the next coordinator
//! cargo bench -p consort --bench hosts -- wifi [MINUTES]         takeovers without cause while a tenth of all packets is lost
//! ```
//!
//! They need unprivileged user namespaces, and `wifi` needs `nft`; without them they print an
//! error. Each prints a line of JSON.

#[path = "../tests/hosts/lab.rs"]
#[expect(dead_code, reason = "the tests use the rest")]
mod lab;
#[path = "../tests/hosts/scenario.rs"]
#[expect(dead_code, reason = "the tests use the rest")]
mod scenario;
#[path = "../../../tests/support/slots.rs"]
mod slots;
#[path = "../tests/processes/support/mod.rs"]
#[expect(dead_code, unused_imports, reason = "the tests use the rest")]
mod support;

use consort_tests::host_network::Way;
use lab::{Lab, inside_again};
use scenario::{FLEET, coordinator, fleet, hospital, wait_for_successor, with};
use serde_json::{Value, json};
use std::io::Write as _;
use std::time::{Duration, Instant};
use support::{Client, LONG, example, until};

const STATIONS: [&str; 5] = ["s1", "s2", "s3", "s4", "s5"];

/// Settling time of a fleet before the measurement.
const SETTLE: Duration = Duration::from_secs(10);

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect();
    let number = |default| arguments.get(1).and_then(|word| word.parse().ok()).unwrap_or(default);
    let own_arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments.first().map(String::as_str) {
        Some("idle") => inside_again(&own_arguments, &[], || print(&idle(Duration::from_secs(number(60)), false))),
        Some("idle-closed") => {
            inside_again(&own_arguments, &[], || print(&idle(Duration::from_secs(number(60)), true)));
        }
        Some("signing") => std::thread::scope(|both| {
            for which in ["idle", "idle-closed"] {
                let seconds = number(60).to_string();
                both.spawn(move || inside_again(&[which, &seconds], &[], || ()));
            }
        }),
        Some("cuts") => inside_again(&own_arguments, &[], || print(&cuts(number(20)))),
        Some("wifi") => inside_again(&own_arguments, &["nft"], || print(&wifi(Duration::from_secs(60 * number(10))))),
        _ => {
            print(
                &json!({ "bench": "hosts", "error": "choose a measurement: idle, idle-closed or signing [SECONDS], cuts [COUNT] or wifi [MINUTES]" }),
            );
        }
    }
}

fn print(line: &Value) {
    // A closed standard output is not an error.
    let _ = writeln!(std::io::stdout(), "{line}");
}

/// Returns the processor time of a process in seconds, and its memory in megabytes.
fn usage(process: u32) -> (f64, f64) {
    let read = |file: &str| std::fs::read_to_string(format!("/proc/{process}/{file}")).expect("a process that runs");
    let stat = read("stat");
    let (_, fields) = stat.rsplit_once(") ").expect("the name is in brackets");
    let ticks: u64 = fields.split(' ').skip(11).take(2).map(|field| field.parse::<u64>().expect("ticks")).sum();
    let status = read("status");
    let rss = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("the status contains the memory");
    let kilobytes: f64 = rss.trim().trim_end_matches(" kB").parse().expect("kilobytes");
    // 100 ticks per second on every known Linux.
    (ticks as f64 / 100.0, kilobytes / 1000.0)
}

/// Measures seven nodes: five stations, a carrier and an arm. The world has a host of its own and
/// is not counted.
fn idle(span: Duration, closed: bool) -> Value {
    let (lab, client) = hospital(1.0, closed);
    std::thread::sleep(SETTLE);
    let leader = coordinator(&client).0;
    drop(client);
    let nodes: Vec<&str> = STATIONS.into_iter().chain(["ada", "lab-arm"]).collect();
    let look = |name: &str| (usage(lab.process(name)), lab.bytes(name));
    let before: Vec<_> = nodes.iter().map(|name| look(name)).collect();
    std::thread::sleep(span);
    let seconds = span.as_secs_f64();
    let rows = nodes.iter().zip(before).map(|(name, ((busy, _), (sent, received)))| {
        let ((busy_now, memory), (sent_now, received_now)) = look(name);
        let tenth = |figure: f64| (figure * 10.0).round() / 10.0;
        json!({
            "node": name,
            "leads": **name == leader,
            "core_percent": (100.0 * (busy_now - busy) / seconds * 100.0).round() / 100.0,
            "sent_kB_per_s": tenth((sent_now - sent) as f64 / seconds / 1000.0),
            "received_kB_per_s": tenth((received_now - received) as f64 / seconds / 1000.0),
            "memory_MB": tenth(memory),
        })
    });
    json!({ "bench": "idle", "closed": closed, "seconds": span.as_secs(), "nodes": rows.collect::<Vec<_>>() })
}

/// Starts five stations that store the ledger and a sixth as observer; `adjust` changes the fleet's
/// file before the start.
fn stations(adjust: impl Fn(toml::Table) -> toml::Table) -> (Lab, Client) {
    let mut lab = Lab::new(&adjust(fleet(5)));
    for host in STATIONS.into_iter().chain(["onlooker"]) {
        lab.add(host);
    }
    for (number, station) in STATIONS.into_iter().enumerate() {
        lab.start("station", with(example("station"), "name", station), &STATIONS[..number]);
    }
    let onlooker = with(with(example("station"), "name", "onlooker"), "may_vote", false);
    lab.start("station", onlooker, &STATIONS);
    lab.await_open();
    let client = Client::open(&lab.address("onlooker", ""), FLEET);
    until("five voters", LONG, || {
        let (_, view) = client.all("view/coordinator", "").into_iter().next()?;
        (view["voters"].as_array()?.len() == 5).then_some(())
    });
    (lab, client)
}

/// Measures the time from the cut of the coordinator's cable until another node reports that it
/// coordinates, which is after its first commit.
fn cuts(count: u64) -> Value {
    let (mut lab, mut client) = stations(|fleet| fleet);
    let mut all: Vec<f64> = vec![];
    for _ in 0..count {
        std::thread::sleep(SETTLE / 2);
        let (first, term) = coordinator(&client);
        let cut = Instant::now();
        lab.unplug(&first);
        wait_for_successor(&mut client, &first, term);
        all.push(cut.elapsed().as_secs_f64() * 1000.0);
        lab.plug(&first, "br0");
        let reconnected = lab.run(&["fleet", "--json"], &first, LONG);
        assert_eq!(reconnected.status.code(), Some(0), "{first} is linked again: {}", reconnected.stderr);
    }
    all.sort_by(f64::total_cmp);
    let rank = |share: f64| all.get((all.len() as f64 * share).ceil().max(1.0) as usize - 1).map(|ms| ms.round());
    json!({
        "bench": "cuts", "n": all.len(),
        "ms": { "min": rank(0.0), "p50": rank(0.5), "p95": rank(0.95), "p99": rank(0.99), "max": rank(1.0) },
    })
}

/// Counts the changes of the coordinator without any fault except ten per cent packet loss.
fn wifi(span: Duration) -> Value {
    let (lab, mut client) = stations(|fleet| with(fleet, "timing", "wifi"));
    for host in STATIONS.into_iter().chain(["onlooker"]) {
        lab.lose(host, Way::In, 10);
    }
    std::thread::sleep(SETTLE);
    let (first, term) = coordinator(&client);
    let before = client.events().len();
    std::thread::sleep(span);
    let count = |client: &mut Client, what: &str| {
        client.events()[before..].iter().filter(|event| event["event"] == what).count()
    };
    let (elected, stepped_down) = (count(&mut client, "elected"), count(&mut client, "stepped_down"));
    let (last, last_term) = coordinator(&client);
    json!({
        "bench": "wifi", "minutes": span.as_secs() / 60, "loss_percent": 10,
        "takeovers": elected, "stepped_down": stepped_down,
        "coordinator": { "before": first, "after": last }, "term": { "before": term, "after": last_term },
    })
}
