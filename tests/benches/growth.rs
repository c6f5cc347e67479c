//! Growth of the traffic of an idle fleet: bytes that each node sends and receives, by fleet size,
//! on the virtual bus.
//!
//! ```text
//! cargo bench -p consort-tests --bench growth [-- ROBOTS ...]
//! ```
//!
//! A hospital with three stations and a number of robots, including the world, without requests.
//! After the nodes have met, one minute of virtual time is measured. Bytes are those of keys and
//! payloads, once for each receiver. Over Zenoh a publication crosses each link once, so a node
//! sends about as much as it receives, times its links. Prints a line of JSON for each size, with
//! the traffic that the mean node received by kind of message (the envelope is most of the cost of
//! a small message, so messages count as well as bytes), and draws `tests/figures/growth.svg`.

use consort_protocol::ids::NodeId;
use consort_tests::{Fleet, RobotSpec, slug};
use plotters::prelude::*;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::Path;
use std::time::Duration;
use tokio::time::sleep;

/// Default numbers of robots.
const SIZES: [usize; 6] = [7, 25, 50, 100, 150, 200];

/// Settling time of a fleet.
const SETTLE: Duration = Duration::from_secs(45);

/// Duration of the measurement.
const MEASURED: Duration = Duration::from_secs(60);

const PLACES: [&str; 4] = ["Dock", "PC Room 4", "IC Room 5", "IC Room 6"];

/// Traffic per second of the mean node and of the coordinator.
struct Figures {
    robots: usize,
    /// Messages received by the mean node per second.
    messages: f64,
    /// Bytes and messages received by the mean node per second, by kind.
    by_kind: BTreeMap<&'static str, (f64, f64)>,
    sent: f64,
    received: f64,
    coordinator_sent: f64,
    coordinator_received: f64,
}

async fn measure(robots: usize) -> Figures {
    let name = |number: usize| -> &'static str { format!("robot-{number:03}").leak() };
    let members = (0..robots).map(|n| RobotSpec::carrier(name(n), PLACES[n % PLACES.len()])).collect();
    let mut fleet = Fleet::hospital(1, members, &["s1", "s2", "s3"], &[]).await;
    sleep(SETTLE).await;
    let coordinator = fleet.wait_for_coordinator().await;
    let nodes: Vec<NodeId> = fleet.running().iter().map(|name| slug(name)).collect();
    let traffic = |fleet: &Fleet| nodes.iter().map(|node| fleet.network.traffic(node)).collect::<Vec<_>>();
    let before = traffic(&fleet);
    sleep(MEASURED).await;
    let after = traffic(&fleet);
    let rate = |from: u64, to: u64| (to - from) as f64 / MEASURED.as_secs_f64();
    let rates: Vec<(f64, f64)> = before
        .iter()
        .zip(&after)
        .map(|(before, after)| {
            let (before, after) = (before.total(), after.total());
            (rate(before.sent, after.sent), rate(before.received, after.received))
        })
        .collect();
    let mut by_kind: BTreeMap<&'static str, (f64, f64)> = BTreeMap::new();
    for (traffic, sign) in after.iter().map(|after| (after, 1.0)).chain(before.iter().map(|before| (before, -1.0))) {
        for (kind, part) in traffic.iter() {
            let (bytes, messages) = by_kind.entry(kind.as_str()).or_default();
            *bytes += sign * rate(0, part.received) / nodes.len() as f64;
            *messages += sign * rate(0, part.messages_received) / nodes.len() as f64;
        }
    }
    by_kind.retain(|_, (_, messages)| *messages > 0.0);
    let mean = |pick: fn(&(f64, f64)) -> f64| rates.iter().map(pick).sum::<f64>() / rates.len() as f64;
    let at = nodes.iter().position(|node| *node == coordinator).expect("the coordinator is a node");
    Figures {
        robots,
        messages: by_kind.values().map(|(_, messages)| messages).sum(),
        by_kind,
        sent: mean(|rate| rate.0),
        received: mean(|rate| rate.1),
        coordinator_sent: rates[at].0,
        coordinator_received: rates[at].1,
    }
}

fn line(figures: &Figures) -> Value {
    let (round, tenth) = (|bytes: f64| bytes.round(), |number: f64| (number * 10.0).round() / 10.0);
    let by_kind = figures.by_kind.iter().map(|(kind, (bytes, messages))| {
        ((*kind).to_owned(), json!({ "bytes_per_s": round(*bytes), "messages_per_s": tenth(*messages) }))
    });
    json!({
        "bench": "growth",
        "robots": figures.robots,
        "bytes_per_s": {
            "sent": round(figures.sent),
            "received": round(figures.received),
            "coordinator_sent": round(figures.coordinator_sent),
            "coordinator_received": round(figures.coordinator_received),
        },
        "messages_per_s": tenth(figures.messages),
        "received_by_kind": by_kind.collect::<serde_json::Map<_, _>>(),
    })
}

fn draw(all: &[Figures], path: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let max_robots = all.iter().map(|figures| figures.robots).max().unwrap_or(1);
    let top = all.iter().flat_map(|f| [f.received, f.coordinator_received, f.sent, f.coordinator_sent]);
    let top = top.fold(1.0, f64::max) / 1000.0 * 1.05;
    let root = SVGBackend::new(path, (760, 420)).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .margin(16)
        .x_label_area_size(42)
        .y_label_area_size(56)
        .caption("An idle fleet: kilobytes per second and node", ("sans-serif", 18))
        .build_cartesian_2d(0..max_robots, 0.0..top)?;
    chart.configure_mesh().x_desc("robots").y_desc("kB/s").light_line_style(WHITE).draw()?;
    type Pick = fn(&Figures) -> f64;
    let lines: [(&str, RGBColor, Pick); 4] = [
        ("mean node, received", RGBColor(31, 119, 180), |f| f.received),
        ("mean node, sent", RGBColor(140, 190, 230), |f| f.sent),
        ("coordinator, received", RGBColor(214, 39, 40), |f| f.coordinator_received),
        ("coordinator, sent", RGBColor(240, 150, 150), |f| f.coordinator_sent),
    ];
    for (name, color, pick) in lines {
        let points = all.iter().map(|figures| (figures.robots, pick(figures) / 1000.0));
        let series = chart.draw_series(LineSeries::new(points, color.stroke_width(2)))?;
        series.label(name).legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
    }
    let mut labels = chart.configure_series_labels();
    labels.position(SeriesLabelPosition::UpperLeft).border_style(BLACK).background_style(WHITE).draw()?;
    root.present()?;
    Ok(())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut sizes: Vec<usize> = std::env::args().filter_map(|argument| argument.parse().ok()).collect();
    let whole = sizes.is_empty();
    if whole {
        sizes = SIZES.to_vec();
    }
    let mut all = vec![];
    for robots in sizes {
        let mut builder = tokio::runtime::Builder::new_current_thread();
        let figures = builder.enable_time().start_paused(true).build()?.block_on(measure(robots));
        writeln!(std::io::stdout(), "{}", line(&figures))?;
        all.push(figures);
    }
    if whole {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("figures");
        std::fs::create_dir_all(&folder)?;
        draw(&all, &folder.join("growth.svg"))?;
    }
    Ok(())
}
