//! Where on the picture things are.

use super::{Point, Trail};
use crate::map::{DrawnItem, Map};

/// The picture is at most about this large, in pixels.
const WIDTH: f64 = 1600.0;
const HEIGHT: f64 = 1600.0;
/// No map is drawn larger than this, in pixels per metre.
const LARGEST: f64 = 100.0;
/// Around each panel, for names that stand out, in pixels.
const MARGIN: f64 = 60.0;
const HEAD: f64 = 36.0;
const FOOT: f64 = 36.0;
/// Room for the legend, in pixels.
const NARROWEST: f64 = 640.0;
/// Room for what is said of one trail, in pixels.
const COLUMN: f64 = 210.0;
const ROW: f64 = 20.0;

fn columns_in(width: f64) -> usize {
    ((width - MARGIN) / COLUMN).floor().max(1.0) as usize
}

/// The whole picture.
#[derive(Debug)]
pub(super) struct DrawingPage {
    pub(super) width: f64,
    pub(super) height: f64,
    /// One for each level.
    pub(super) panels: Vec<Panel>,
    /// Room for what is said of trails, above the legend.
    trails_at: f64,
}

/// Where one level is drawn.
#[derive(Debug)]
pub(super) struct Panel {
    /// Pixels per metre.
    pub(super) scale: f64,
    /// The upper left corner of the floor, in pixels.
    corner: Point,
    /// What is drawn there: least x and greatest y, in metres.
    north_west: Point,
}

impl Panel {
    /// Where a point of the floor is on the picture.
    pub(super) fn at(&self, (x, y): Point) -> Point {
        let (west, north) = self.north_west;
        (self.corner.0 + (x - west) * self.scale, self.corner.1 + (north - y) * self.scale)
    }

    pub(super) fn caption_at(&self) -> Point {
        (self.corner.0, self.corner.1 - MARGIN / 2.0)
    }
}

impl DrawingPage {
    pub(super) fn of(map: &Map, bodies: &[&DrawnItem], trails: &[Trail]) -> DrawingPage {
        let ((mut west, mut south), (mut east, mut north)) = map.bounds();
        let stand = bodies.iter().map(|body| (body.x_m, body.y_m));
        for (x, y) in stand.chain(trails.iter().flat_map(Trail::points)) {
            (west, south) = (west.min(x), south.min(y));
            (east, north) = (east.max(x), north.max(y));
        }
        // Half a metre at least: places may all be on one line.
        let (wide, high) = ((east - west).max(0.5), (north - south).max(0.5));
        let count = map.levels().len();
        // Side by side or on top of each other, whatever comes nearer to a square.
        let columns = (1..=count).min_by(|a, b| shape(*a, count, wide, high).total_cmp(&shape(*b, count, wide, high)));
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

    /// Where it is said whose trail this is, by its place among all.
    pub(super) fn trail_at(&self, place: usize) -> Point {
        let (row, column) = (place / columns_in(self.width), place % columns_in(self.width));
        (MARGIN / 2.0 + column as f64 * COLUMN, self.trails_at + (row as f64 + 0.5) * ROW)
    }

    pub(super) fn legend_at(&self) -> Point {
        (MARGIN / 2.0, self.height - FOOT / 2.0)
    }

    /// A bar of a round number of metres, and its length in pixels.
    pub(super) fn bar(&self) -> (f64, f64) {
        let scale = self.panels.first().map_or(1.0, |panel| panel.scale);
        let fits = 140.0 / scale;
        let power = 10.0_f64.powf(fits.log10().floor());
        let metres = [5.0, 2.0, 1.0].map(|digit| digit * power).into_iter().find(|metres| *metres <= fits);
        let metres = metres.unwrap_or(power);
        (metres, metres * scale)
    }
}

/// How far from a square so many columns make a picture.
fn shape(columns: usize, count: usize, wide: f64, high: f64) -> f64 {
    let rows = count.div_ceil(columns);
    (columns as f64 * wide / (rows as f64 * high)).ln().abs()
}
