//! Figures as SVG: stacked bars, violins, boxes.

use super::super::outcome::EndState;
use super::super::stats::{Summary, density};
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use std::error::Error;

/// A figure, or the reason of its failure.
pub(super) type Figure = Result<String, Box<dyn Error>>;

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

const WIDTH: u32 = 900;
const HEIGHT: u32 = 380;

/// A colour for each end state, distinguishable with red-green colour blindness (Okabe and Ito
/// 2008).
const STATES: [RGBColor; 5] = [
    RGBColor(0, 158, 115),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(213, 94, 0),
    RGBColor(120, 120, 120),
];

/// A colour for each of up to six series.
const SERIES: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(230, 159, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(120, 120, 120),
];

fn draw(height: u32, draw: impl FnOnce(&Area<'_>) -> Result<(), Box<dyn Error>>) -> Figure {
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
        root.fill(&WHITE).map_err(to_boxed_text)?;
        draw(&root)?;
        root.present().map_err(to_boxed_text)?;
    }
    Ok(svg)
}

/// Converts an error to text: drawing errors borrow the drawing area.
fn to_boxed_text(error: impl std::fmt::Display) -> Box<dyn Error> {
    error.to_string().into()
}

/// Creates a panel with the given ranges; the labels of the x axis are at 0, 1, 2, ….
fn panel<'a, 'b>(
    area: &'a Area<'b>,
    title: &str,
    labels: &[String],
    x: std::ops::Range<f64>,
    y: std::ops::Range<f64>,
    y_title: &str,
) -> Result<Chart<'a, 'b>, Box<dyn Error>> {
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 16))
        .margin(8)
        .x_label_area_size(if labels.is_empty() { 8 } else { 24 })
        .y_label_area_size(60)
        .build_cartesian_2d(x, y)
        .map_err(to_boxed_text)?;
    let label = |at: &f64| {
        let whole = at.round();
        let index = whole as usize;
        if (at - whole).abs() < 1e-6 && whole >= 0.0 {
            labels.get(index).cloned().unwrap_or_default()
        } else {
            String::new()
        }
    };
    chart
        .configure_mesh()
        .disable_x_mesh()
        .max_light_lines(1)
        .x_labels(if labels.is_empty() { 0 } else { 2 * labels.len() + 1 })
        .x_label_formatter(&label)
        .y_desc(y_title)
        .draw()
        .map_err(to_boxed_text)?;
    Ok(chart)
}

/// Draws, for each panel, stacked bars: the trials of each scenario by end state.
pub(super) fn stacked(panels: &[(String, Vec<[usize; 5]>)]) -> Figure {
    let height = 190 * u32::try_from(panels.len()).unwrap_or(1) + 30;
    draw(height.max(220), |root| {
        let (legend, rest) = root.split_vertically(26);
        for (index, (state, color)) in EndState::ALL.iter().zip(STATES).enumerate() {
            let x = 60 + 160 * i32::try_from(index).unwrap_or(0);
            legend.draw(&Rectangle::new([(x, 8), (x + 12, 20)], color.filled())).map_err(to_boxed_text)?;
            legend.draw(&Text::new(state.as_str(), (x + 18, 8), ("sans-serif", 13))).map_err(to_boxed_text)?;
        }
        for (area, (title, scenarios)) in rest.split_evenly((panels.len().max(1), 1)).iter().zip(panels) {
            let max_trials = scenarios.iter().map(|counts| counts.iter().sum::<usize>()).max().unwrap_or(1) as f64;
            let mut chart = panel(area, title, &[], 0.0..scenarios.len().max(1) as f64, 0.0..max_trials, "trials")?;
            for (scenario, counts) in scenarios.iter().enumerate() {
                let mut below = 0.0;
                let bars = counts.iter().zip(STATES).filter(|(count, _)| **count > 0).map(|(count, color)| {
                    let above = below + *count as f64;
                    let corners = [(scenario as f64 + 0.08, below), (scenario as f64 + 0.92, above)];
                    below = above;
                    Rectangle::new(corners, color.filled())
                });
                chart.draw_series(bars).map_err(to_boxed_text)?;
            }
        }
        Ok(())
    })
}

fn range(series: &[(String, Vec<f64>)]) -> std::ops::Range<f64> {
    let values = || series.iter().flat_map(|(_, values)| values).copied();
    let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
    if low > high {
        return 0.0..1.0;
    }
    let margin = ((high - low) * 0.08).max(0.5);
    (low - margin).max(0.0)..high + margin
}

/// Draws a violin for each sample. Kernels are at least `width_min` wide.
pub(super) fn violins(title: &str, y_title: &str, series: &[(String, Vec<f64>)], width_min: f64) -> Figure {
    draw(HEIGHT, |root| {
        let labels: Vec<String> =
            series.iter().map(|(name, values)| format!("{name} (n = {})", values.len())).collect();
        let (x, y) = (-0.5..series.len().max(1) as f64 - 0.5, range(series));
        let points: Vec<f64> = (0..=120).map(|step| y.start + (y.end - y.start) * f64::from(step) / 120.0).collect();
        let mut chart = panel(root, title, &labels, x, y, y_title)?;
        for (index, (_, values)) in series.iter().enumerate().filter(|(_, (_, values))| !values.is_empty()) {
            let (at, color) = (index as f64, SERIES[index % SERIES.len()]);
            let shape = density(values, &points, width_min);
            let widest = shape.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
            let side = |sign: f64| {
                points.iter().zip(&shape).map(move |(y, d)| (at + sign * 0.4 * d / widest, *y)).collect::<Vec<_>>()
            };
            let (left, mut right) = (side(-1.0), side(1.0));
            right.reverse();
            let outline: Vec<(f64, f64)> = left.into_iter().chain(right).collect();
            chart.draw_series([Polygon::new(outline, color.mix(0.5))]).map_err(to_boxed_text)?;
            boxed(&mut chart, at, 0.03, values, BLACK)?;
        }
        Ok(())
    })
}

/// Draws a box for each series of each group.
pub(super) fn boxes(title: &str, y_title: &str, series: &[String], groups: &[(String, Vec<Vec<f64>>)]) -> Figure {
    draw(HEIGHT, |root| {
        let (legend, rest) = root.split_vertically(26);
        for (index, name) in series.iter().enumerate() {
            let (x, color) = (60 + 170 * i32::try_from(index).unwrap_or(0), SERIES[index % SERIES.len()]);
            legend.draw(&Rectangle::new([(x, 8), (x + 12, 20)], color.filled())).map_err(to_boxed_text)?;
            legend.draw(&Text::new(name.as_str(), (x + 18, 8), ("sans-serif", 13))).map_err(to_boxed_text)?;
        }
        let labels: Vec<String> = groups.iter().map(|(label, _)| label.clone()).collect();
        let flat: Vec<(String, Vec<f64>)> = groups.iter().map(|(label, of)| (label.clone(), of.concat())).collect();
        let mut chart = panel(&rest, title, &labels, -0.5..groups.len().max(1) as f64 - 0.5, range(&flat), y_title)?;
        let step = 0.8 / series.len().max(1) as f64;
        for (group, (_, samples)) in groups.iter().enumerate() {
            for (index, values) in samples.iter().enumerate().filter(|(_, values)| !values.is_empty()) {
                let at = group as f64 - 0.4 + step * (index as f64 + 0.5);
                boxed(&mut chart, at, step * 0.4, values, SERIES[index % SERIES.len()])?;
            }
        }
        Ok(())
    })
}

fn boxed(chart: &mut Chart<'_, '_>, at: f64, half: f64, values: &[f64], color: RGBColor) -> Result<(), Box<dyn Error>> {
    let Some(summary) = Summary::of(values) else { return Ok(()) };
    let (low, high) = summary.whiskers(values);
    let (left, right) = (at - half, at + half);
    chart
        .draw_series([Rectangle::new([(left, summary.q1), (right, summary.q3)], color.mix(0.4).filled())])
        .map_err(to_boxed_text)?;
    let lines = [
        vec![(left, summary.median), (right, summary.median)],
        vec![(left, summary.q1), (right, summary.q1), (right, summary.q3), (left, summary.q3), (left, summary.q1)],
        vec![(at, low), (at, summary.q1)],
        vec![(at, summary.q3), (at, high)],
    ];
    chart
        .draw_series(lines.into_iter().map(|line| PathElement::new(line, color.stroke_width(1))))
        .map_err(to_boxed_text)?;
    let outliers = values.iter().filter(|value| **value < low || **value > high);
    chart.draw_series(outliers.map(|value| Circle::new((at, *value), 2, color))).map_err(to_boxed_text)?;
    Ok(())
}
