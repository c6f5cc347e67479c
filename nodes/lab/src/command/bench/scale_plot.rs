//! Plot of fleets by size.

use consort_tests::scale::ScaleFigures;
use plotters::prelude::*;
use std::error::Error;
use std::path::Path;

type Pick = fn(&ScaleFigures) -> Option<f64>;

/// Draws traffic, computing time and latencies by number of robots, one above the other. All axes are logarithmic: sizes go
/// from a few robots to a thousand.
pub(super) fn draw(all: &[ScaleFigures], path: &Path) -> Result<(), Box<dyn Error>> {
    let root = SVGBackend::new(path, (760, 1100)).into_drawing_area();
    root.fill(&WHITE)?;
    let panels = root.split_evenly((3, 1));
    let [traffic, computing, latency] = &panels[..] else { unreachable!("three rows") };
    panel(
        all,
        traffic,
        "Traffic",
        "kB/s",
        &[
            ("mean robot, received", |f| Some(f.robot_received_bytes_per_s / 1000.0)),
            ("coordinator, received", |f| Some(f.coordinator_received_bytes_per_s / 1000.0)),
            ("coordinator, sent", |f| Some(f.coordinator_sent_bytes_per_s / 1000.0)),
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
    // Zero has no place on an axis of logarithms.
    let points = |pick: Pick| {
        let point = move |figures: &ScaleFigures| Some((figures.robots, pick(figures).filter(|value| *value > 0.0)?));
        all.iter().filter_map(point)
    };
    let drawn: Vec<(usize, f64)> = lines.iter().flat_map(|(_, pick)| points(*pick)).collect();
    let robots = drawn.iter().map(|(robots, _)| *robots);
    let (fewest, most) = (robots.clone().min().unwrap_or(1), robots.max().unwrap_or(1));
    let values = drawn.iter().map(|(_, value)| *value);
    let lowest = values.clone().reduce(f64::min).unwrap_or(1.0);
    let highest = values.reduce(f64::max).unwrap_or(1.0);
    // Space for the labels above the lines.
    let (columns, rows) = (fewest..most.max(fewest * 2), lowest * 0.8..highest * 4.0);
    let mut chart = ChartBuilder::on(area)
        .margin(16)
        .x_label_area_size(42)
        .y_label_area_size(56)
        .caption(caption, ("sans-serif", 18))
        .build_cartesian_2d(columns.log_scale(), rows.log_scale())?;
    let label = |value: &f64| ((value * 1000.0).round() / 1000.0).to_string();
    let mut mesh = chart.configure_mesh();
    mesh.x_desc("robots").y_desc(unit).y_label_formatter(&label).light_line_style(WHITE).draw()?;
    for ((name, pick), color) in lines.iter().zip(COLORS) {
        let series = chart.draw_series(LineSeries::new(points(*pick), color.stroke_width(2)))?;
        series.label(*name).legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
        chart.draw_series(points(*pick).map(|point| Circle::new(point, 3, color.filled())))?;
    }
    let mut labels = chart.configure_series_labels();
    labels.position(SeriesLabelPosition::UpperLeft).border_style(BLACK).background_style(WHITE).draw()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_tests::percentiles::Percentiles;

    #[test]
    fn a_plot_contains_bytes_computing_time_and_latencies() {
        let size = |robots: usize| {
            let measured = robots as f64;
            let latency = Percentiles::of(vec![measured]);
            ScaleFigures {
                robots,
                robot_received_bytes_per_s: measured * 10.0,
                coordinator_received_bytes_per_s: measured * 20.0,
                coordinator_sent_bytes_per_s: measured * 1000.0,
                robot_cpu_percent: 0.0, // too little to be measured
                coordinator_cpu_percent: measured / 100.0,
                auction_ms: latency,
                commit_ms: None, // no missions
                takeover_ms: latency,
                ..ScaleFigures::default()
            }
        };
        let file = std::env::temp_dir().join(format!("consort-scale-plot-{}.svg", std::process::id()));
        draw(&[7, 100, 1000].map(size), &file).unwrap();
        let drawn = std::fs::read_to_string(&file).unwrap();
        std::fs::remove_file(&file).unwrap();
        for text in ["Traffic", "Computing time", "Latency, median", "% of a core", "coordinator, sent", "1000"] {
            assert!(drawn.contains(text), "{text}");
        }
        draw(&[size(7)], &file).unwrap();
        std::fs::remove_file(&file).unwrap();
    }
}
