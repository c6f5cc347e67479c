//! Layout of the drawing.

use super::content::{DrawnItem, Trail};
use super::elements::Point;
use crate::map::model::Map;

/// Approximate greatest size of the drawing, in pixels.
const WIDTH: f64 = 1600.0;
const HEIGHT: f64 = 1600.0;
/// Greatest scale, in pixels per metre.
const LARGEST: f64 = 100.0;
/// Margin around each panel for names that extend over the border, in pixels.
const MARGIN: f64 = 60.0;
const HEAD: f64 = 36.0;
const FOOT: f64 = 36.0;
/// Least width, for the legend, in pixels.
const NARROWEST: f64 = 640.0;
/// Column width of the list of trails, in pixels.
const COLUMN: f64 = 210.0;
const ROW: f64 = 20.0;

fn columns_in(width: f64) -> usize {
    ((width - MARGIN) / COLUMN).floor().max(1.0) as usize
}

/// Layout of the whole drawing.
#[derive(Debug)]
pub(super) struct DrawingPage {
    pub(super) width: f64,
    pub(super) height: f64,
    /// A panel for each level.
    pub(super) panels: Vec<Panel>,
    /// Vertical position of the list of trails, above the legend.
    trails_at: f64,
}

/// Position and scale of a level in the drawing.
#[derive(Debug)]
pub(super) struct Panel {
    /// Pixels per metre.
    pub(super) scale: f64,
    /// Upper left corner of the drawn area, in pixels.
    corner: Point,
    /// Upper left corner of the drawn area: least x and greatest y, in metres.
    north_west: Point,
}

impl Panel {
    /// Returns the position of a map point in the drawing.
    pub(super) fn at(&self, (x, y): Point) -> Point {
        let (west, north) = self.north_west;
        (self.corner.0 + (x - west) * self.scale, self.corner.1 + (north - y) * self.scale)
    }

    pub(super) fn caption_at(&self) -> Point {
        (self.corner.0, self.corner.1 - MARGIN / 2.0)
    }
}

impl DrawingPage {
    pub(super) fn of(map: &Map, items: &[&DrawnItem], trails: &[Trail]) -> DrawingPage {
        let ((mut west, mut south), (mut east, mut north)) = map.bounds();
        let item_positions = items.iter().map(|item| (item.x_m, item.y_m));
        for (x, y) in item_positions.chain(trails.iter().flat_map(Trail::points)) {
            (west, south) = (west.min(x), south.min(y));
            (east, north) = (east.max(x), north.max(y));
        }
        // At least half a metre: all places may be on the same line.
        let (wide, high) = ((east - west).max(0.5), (north - south).max(0.5));
        let count = map.levels().len();
        // Panels are arranged so that the drawing is close to a square.
        let columns =
            (1..=count).min_by(|a, b| squareness(*a, count, wide, high).total_cmp(&squareness(*b, count, wide, high)));
        let columns = columns.unwrap_or(1);
        let rows = count.div_ceil(columns);
        let (across, down) = (columns as f64, rows as f64);
        let room = ((WIDTH / across - 2.0 * MARGIN).max(80.0), (HEIGHT / down - 2.0 * MARGIN).max(80.0));
        let scale = (room.0 / wide).min(room.1 / high).min(LARGEST);
        let step = (wide * scale + 2.0 * MARGIN, high * scale + 2.0 * MARGIN);
        let panel = |index: usize| {
            let (column, row) = ((index % columns) as f64, (index / columns) as f64);
            let corner = (column * step.0 + MARGIN, HEAD + row * step.1 + MARGIN);
            Panel { scale, corner, north_west: (west, north) }
        };
        let width = (across * step.0).max(NARROWEST).ceil();
        let rows = trails.len().div_ceil(columns_in(width)) as f64;
        let trails_at = (HEAD + down * step.1).ceil();
        let height = (trails_at + rows * ROW + FOOT).ceil();
        DrawingPage { width, height, panels: (0..count).map(panel).collect(), trails_at }
    }

    pub(super) fn title_at(&self) -> Point {
        (MARGIN / 2.0, 30.0)
    }

    /// Returns the position of a trail in the list of trails.
    pub(super) fn trail_at(&self, place: usize) -> Point {
        let (row, column) = (place / columns_in(self.width), place % columns_in(self.width));
        (MARGIN / 2.0 + column as f64 * COLUMN, self.trails_at + (row as f64 + 0.5) * ROW)
    }

    pub(super) fn legend_at(&self) -> Point {
        (MARGIN / 2.0, self.height - FOOT / 2.0)
    }

    /// Returns a round number of metres for the scale bar, and its length in pixels.
    pub(super) fn bar(&self) -> (f64, f64) {
        let scale = self.panels.first().map_or(1.0, |panel| panel.scale);
        let fits = 140.0 / scale;
        let power = 10.0_f64.powf(fits.log10().floor());
        let metres = [5.0, 2.0, 1.0].map(|digit| digit * power).into_iter().find(|metres| *metres <= fits);
        let metres = metres.unwrap_or(power);
        (metres, metres * scale)
    }
}

/// Returns how far the drawing is from a square with this number of columns; 0 is a square.
fn squareness(columns: usize, count: usize, wide: f64, high: f64) -> f64 {
    let rows = count.div_ceil(columns);
    (columns as f64 * wide / (rows as f64 * high)).ln().abs()
}
