//! Plot of fleets by size.

use consort_tests::scale::ScaleFigures;
use plotters::prelude::*;
use std::error::Error;
use std::path::Path;

type Pick = fn(&ScaleFigures) -> Option<f64>;

/// Draws traffic, computing time and latencies by number of robots, one above the other.
pub(super) fn draw(all: &[ScaleFigures], path: &Path) -> Result<(), Box<dyn Error>> {
    let root = SVGBackend::new(path, (760, 1100)).into_drawing_area();
    root.fill(&WHITE)?;
    let panels = root.split_evenly((3, 1));
    let [traffic, computing, latency] = &panels[..] else { unreachable!("three rows") };
    panel(
        all,
        traffic,
        "Received bytes",
        "kB/s",
        &[
            ("mean robot", |f| Some(f.robot_received_bytes_per_s / 1000.0)),
            ("coordinator", |f| Some(f.coordinator_received_bytes_per_s / 1000.0)),
        ],
    )?;
    panel(
        all,
        computing,
        "Computing time",
        "% of a core",
        &[("a robot's node", |f| Some(f.robot_cpu_percent)), ("coordinator", |f| Some(f.coordinator_cpu_percent))],
    )?;
    panel(
        all,
        latency,
        "Latency, median",
        "ms",
        &[
            ("auction", |f| f.auction_ms.map(|latency| latency.p50)),
            ("acknowledgement", |f| f.commit_ms.map(|latency| latency.p50)),
            ("takeover", |f| f.takeover_ms.map(|latency| latency.p50)),
        ],
    )?;
    root.present()?;
    Ok(())
}

fn panel(
    all: &[ScaleFigures],
    area: &DrawingArea<SVGBackend, plotters::coord::Shift>,
    caption: &str,
    unit: &str,
    lines: &[(&str, Pick)],
) -> Result<(), Box<dyn Error>> {
    const COLORS: [RGBColor; 3] = [RGBColor(31, 119, 180), RGBColor(214, 39, 40), RGBColor(44, 160, 44)];
    let robots = all.iter().map(|figures| figures.robots).max().unwrap_or(1);
    let values = all.iter().flat_map(|figures| lines.iter().filter_map(|(_, pick)| pick(figures)));
    let top = values.fold(f64::MIN_POSITIVE, f64::max) * 1.05;
    let mut chart = ChartBuilder::on(area)
        .margin(16)
        .x_label_area_size(42)
        .y_label_area_size(56)
        .caption(caption, ("sans-serif", 18))
        .build_cartesian_2d(0..robots, 0.0..top)?;
    chart.configure_mesh().x_desc("robots").y_desc(unit).light_line_style(WHITE).draw()?;
    for ((name, pick), color) in lines.iter().zip(COLORS) {
        let points = all.iter().filter_map(|figures| Some((figures.robots, pick(figures)?)));
        let series = chart.draw_series(LineSeries::new(points, color.stroke_width(2)))?;
        series.label(*name).legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
    }
    let mut labels = chart.configure_series_labels();
    labels.position(SeriesLabelPosition::UpperLeft).border_style(BLACK).background_style(WHITE).draw()?;
    Ok(())
}
