//! Drawings of maps: SVG, and PNG made of it.
//!
//! Each level has a panel. All panels have the same scale and the same origin. North is up.

pub(crate) mod colours;
mod labels;
mod page;
mod png;
#[cfg(test)]
mod tests;
mod trails;

pub use png::{PngError, png};
pub use trails::{Trail, svg_with_trails};

use super::{DrawnItem, Lane, LevelIndex, Map, MapPlace, PlaceKind};
use colours::{DOOR, INK, ITEM, LANE, LIFT, ROBOT, WALL};
use labels::{Labels, Weight};
use page::{DrawingPage, Panel};
use std::collections::BTreeSet;
use svg::node::element::{Circle, Group, Line, Polygon, Polyline, Rectangle, Text, Title};

/// Font sizes, in pixels.
const NAME_PX: f64 = 13.0;
const NOTE_PX: f64 = 10.0;

type Point = (f64, f64);

/// Draws a map, and the items on it, as SVG.
pub fn svg(map: &Map, items: &[&DrawnItem]) -> String {
    document(map, items, &[], &DrawingPage::of(map, items, &[])).to_string()
}

fn document(map: &Map, items: &[&DrawnItem], trails: &[Trail], page: &DrawingPage) -> svg::Document {
    let mut document = svg::Document::new()
        .set("viewBox", (0, 0, page.width, page.height))
        .set("width", page.width)
        .set("height", page.height)
        .set("font-family", "Hack, DejaVu Sans Mono, monospace")
        .add(Title::new(map.name()))
        .add(Rectangle::new().set("width", page.width).set("height", page.height).set("fill", "#ffffff"))
        .add(text(map.name(), page.title_at(), 18.0, INK).set("font-weight", "bold"));
    for (level, panel) in map.level_indices().zip(&page.panels) {
        document = document.add(LevelDrawing::new(map, level, panel).draw(items, trails));
    }
    document.add(legend(map, items, trails, page))
}

/// The drawing of a level on its panel.
struct LevelDrawing<'a> {
    map: &'a Map,
    level: LevelIndex,
    panel: &'a Panel,
    labels: Labels,
    group: Group,
}

impl<'a> LevelDrawing<'a> {
    fn new(map: &'a Map, level: LevelIndex, panel: &'a Panel) -> LevelDrawing<'a> {
        let group = Group::new().set("class", "level").set("data-name", map.level(level).name.as_str());
        LevelDrawing { map, level, panel, labels: Labels::default(), group }
    }

    fn draw(mut self, items: &[&DrawnItem], trails: &[Trail]) -> Group {
        let has_several_levels = self.map.levels().len() > 1;
        if has_several_levels {
            let level = self.map.level(self.level);
            let name = format!("{} ({} m)", level.name, level.elevation_m);
            self.add(text(&name, self.panel.caption_at(), NAME_PX, INK).set("font-style", "italic"));
        }
        self.walls();
        let lanes: Vec<&Lane> = self.map.lanes_on(self.level).collect();
        for lane in &lanes {
            self.lane(lane);
        }
        for lift in self.map.lifts() {
            let stops = lift.stops.iter().filter_map(|stop| self.map.place(stop));
            let stops: Vec<&MapPlace> = stops.filter(|stop| stop.level == self.level).collect();
            for stop in stops {
                self.lift(&lift.name, stop);
            }
        }
        self.doors();
        self.trails(trails);
        let name = &self.map.level(self.level).name;
        for item in items.iter().filter(|item| item.level.as_ref().is_none_or(|level| level == name)) {
            let default_colour = if item.kind == "robot" { ROBOT } else { ITEM };
            self.item(item, trail_of(item, trails).map_or(default_colour, colours::robot_colour));
        }
        let places: Vec<&MapPlace> = self.map.places().iter().filter(|place| place.level == self.level).collect();
        for place in &places {
            self.place(place);
        }
        // Important names are placed first and get the better positions; names of crossings get the
        // remaining space.
        for place in places.iter().filter(|place| place.kind != PlaceKind::Corridor) {
            self.label(place.id.as_str(), self.at(place), NAME_PX, INK, true);
        }
        for lane in lanes {
            self.limit(lane);
        }
        for place in places.iter().filter(|place| place.kind == PlaceKind::Corridor) {
            self.label(place.id.as_str(), self.at(place), NOTE_PX, "#78909c", false);
        }
        self.group
    }

    fn add(&mut self, node: impl Into<Box<dyn svg::Node>>) {
        let group = std::mem::take(&mut self.group);
        self.group = group.add(node);
    }

    fn at(&self, place: &MapPlace) -> Point {
        self.panel.at((place.pose.x, place.pose.y))
    }

    fn walls(&mut self) {
        for wall in self.map.walls_on(self.level) {
            let corners: Vec<Point> = wall.iter().map(|corner| self.panel.at(*corner)).collect();
            for side in corners.windows(2) {
                self.labels.line(side[0], side[1], Weight::Wall);
            }
            let points = corners.iter().map(|(x, y)| format!("{},{}", px(*x), px(*y))).collect::<Vec<_>>().join(" ");
            let line = Polyline::new().set("class", "wall").set("points", points).set("fill", "none");
            let width = px((0.15 * self.panel.scale).clamp(1.5, 6.0));
            self.add(line.set("stroke", WALL).set("stroke-width", width).set("stroke-linejoin", "round"));
        }
    }

    fn ends(&self, lane: &Lane) -> Option<(Point, Point)> {
        let [from, to] = [&lane.from, &lane.to].map(|end| self.map.place(end).map(|place| self.at(place)));
        from.zip(to)
    }

    fn lane(&mut self, lane: &Lane) {
        let Some((a, b)) = self.ends(lane) else { return };
        self.labels.line(a, b, Weight::Lane);
        let mut title = format!("{} – {}, {:.2} m", lane.from, lane.to, lane.length.get());
        if !lane.two_way {
            title.push_str(", one way");
        }
        if let Some(limit) = lane.speed_limit {
            title.push_str(&format!(", at most {} m/s", limit.get()));
        }
        if let Some(facing) = lane.facing {
            title.push_str(&format!(", facing {facing:?}").to_lowercase());
        }
        let stroke = line(a, b).set("class", "lane").set("stroke", LANE).set("stroke-width", 3);
        self.add(Group::new().add(Title::new(title)).add(stroke));
        if !lane.two_way {
            self.add(arrow_head(a, b).set("class", "one-way").set("fill", "#1e88e5"));
        }
    }

    fn limit(&mut self, lane: &Lane) {
        let (Some(limit), Some((a, b))) = (lane.speed_limit, self.ends(lane)) else { return };
        let middle = (f64::midpoint(a.0, b.0), f64::midpoint(a.1, b.1));
        self.label(&format!("{} m/s", limit.get()), middle, NOTE_PX, "#1e88e5", false);
    }

    fn lift(&mut self, name: &str, stop: &MapPlace) {
        let (x, y) = self.at(stop);
        let side = (1.2 * self.panel.scale).clamp(16.0, 40.0);
        let square = Rectangle::new()
            .set("class", "lift")
            .set("x", px(x - side / 2.0))
            .set("y", px(y - side / 2.0))
            .set("width", px(side))
            .set("height", px(side))
            .set("fill", LIFT)
            .set("fill-opacity", 0.25)
            .set("stroke", LIFT);
        self.add(Group::new().add(Title::new(name)).add(square));
        self.labels.dot((x, y), side / 2.0);
        self.label(name, (x, y + side / 2.0), NOTE_PX, LIFT, true);
    }

    fn doors(&mut self) {
        let map = self.map;
        for door in map.doors() {
            let here = |place| map.level_of(place) == Some(self.level);
            if !door.lanes.first().is_some_and(|(from, _)| here(from)) {
                continue;
            }
            for (a, b) in map.door_posts(door) {
                let (a, b) = (self.panel.at(a), self.panel.at(b));
                let leaf = line(a, b).set("class", "door").set("stroke", DOOR).set("stroke-width", 5);
                self.add(Group::new().add(Title::new(door.name.as_str())).add(leaf));
                self.labels.line(a, b, Weight::Wall);
                let middle = (f64::midpoint(a.0, b.0), f64::midpoint(a.1, b.1));
                self.label(&door.name, middle, NOTE_PX, DOOR, true);
            }
        }
    }

    fn place(&mut self, place: &MapPlace) {
        let (x, y) = self.at(place);
        let (colour, radius) = dot(place.kind);
        let dot = Circle::new().set("class", "place").set("cx", px(x)).set("cy", px(y)).set("r", radius);
        let dot = dot.set("fill", colour).set("stroke", "#ffffff");
        self.add(Group::new().add(Title::new(place.id.as_str())).add(dot));
        self.labels.dot((x, y), radius);
    }

    fn item(&mut self, item: &DrawnItem, colour: &str) {
        let (x, y) = self.panel.at((item.x_m, item.y_m));
        let radius = (item.size_m.0.max(item.size_m.1) / 2.0 * self.panel.scale).clamp(5.0, 14.0);
        let disc = Circle::new().set("class", "item").set("cx", px(x)).set("cy", px(y)).set("r", px(radius));
        let disc = disc.set("fill", colour).set("fill-opacity", 0.35).set("stroke", colour);
        let title = format!("{} {}", item.kind, item.name);
        let mut group = Group::new().add(Title::new(title)).add(disc);
        if item.kind == "robot" {
            // y points down on the screen, so north is a smaller y.
            let nose = (x + radius * item.yaw_rad.cos(), y - radius * item.yaw_rad.sin());
            group = group.add(line((x, y), nose).set("stroke", colour).set("stroke-width", 2));
        }
        self.add(group);
        self.labels.dot((x, y), radius);
        self.label(&item.name, (x, y), NOTE_PX, colour, true);
    }

    /// Writes a name at the position where it covers least. An optional name is left out if it
    /// would cover another name.
    fn label(&mut self, name: &str, at: Point, size: f64, colour: &str, needed: bool) {
        let Some(corner) = self.labels.find(name, at, size, needed) else { return };
        let halo = text(name, corner, size, colour).set("stroke", "#ffffff").set("stroke-width", 3);
        self.add(halo.set("paint-order", "stroke").set("stroke-linejoin", "round"));
    }
}

/// Returns the index of the trail of a robot.
fn trail_of(item: &DrawnItem, trails: &[Trail]) -> Option<usize> {
    trails.iter().position(|trail| trail.name == item.name).filter(|_| item.kind == "robot")
}

/// Returns colour and radius of a place.
fn dot(kind: PlaceKind) -> (&'static str, f64) {
    let radius = match kind {
        PlaceKind::Corridor => 3.5,
        PlaceKind::Other => 5.0,
        PlaceKind::Room | PlaceKind::Lab | PlaceKind::Dock | PlaceKind::Charger => 6.0,
    };
    (colours::place_kind_colour(kind), radius)
}

/// Draws the legend of the colours in use, and a scale bar.
fn legend(map: &Map, items: &[&DrawnItem], trails: &[Trail], page: &DrawingPage) -> Group {
    let mut group = Group::new().set("class", "legend");
    let (mut x, y) = page.legend_at();
    let (metres, bar) = page.bar();
    group = group
        .add(line((x, y), (x + bar, y)).set("class", "scale").set("stroke", INK).set("stroke-width", 3))
        .add(text(&format!("{metres} m"), (x + bar + 6.0, y + 4.0), NOTE_PX, INK));
    x += bar + 70.0;
    let kinds: BTreeSet<PlaceKind> = map.places().iter().map(|place| place.kind).collect();
    let mut entries: Vec<(&str, &str)> = kinds.into_iter().map(|kind| (kind.as_str(), dot(kind).0)).collect();
    let is_present = |kind: fn(&DrawnItem) -> bool| items.iter().any(|item| kind(item));
    let others = [
        ("door", DOOR, !map.doors().is_empty()),
        ("lift", LIFT, !map.lifts().is_empty()),
        ("robot", ROBOT, items.iter().any(|item| item.kind == "robot" && trail_of(item, trails).is_none())),
        ("thing", ITEM, is_present(|item| item.kind != "robot")),
    ];
    entries.extend(others.into_iter().filter(|(.., is_present)| *is_present).map(|(name, colour, _)| (name, colour)));
    for (name, colour) in entries {
        let swatch = Circle::new().set("cx", px(x)).set("cy", px(y)).set("r", 5).set("fill", colour);
        group = group.add(swatch).add(text(name, (x + 9.0, y + 4.0), NOTE_PX, INK));
        x += 30.0 + labels::width(name, NOTE_PX);
    }
    group
}

/// Returns a small triangle in the middle of a line, pointing to its end.
fn arrow_head(a: Point, b: Point) -> Polygon {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let length = dx.hypot(dy).max(1e-9);
    let (dx, dy) = (dx / length, dy / length);
    let middle = (f64::midpoint(a.0, b.0), f64::midpoint(a.1, b.1));
    let corner = |along: f64, across: f64| {
        format!("{},{}", px(middle.0 + along * dx - across * dy), px(middle.1 + along * dy + across * dx))
    };
    Polygon::new().set("points", [corner(8.0, 0.0), corner(-5.0, 5.5), corner(-5.0, -5.5)].join(" "))
}

fn line(a: Point, b: Point) -> Line {
    let line = Line::new().set("x1", px(a.0)).set("y1", px(a.1)).set("x2", px(b.0)).set("y2", px(b.1));
    line.set("stroke-linecap", "round")
}

fn text(content: &str, (x, y): Point, size: f64, colour: &str) -> Text {
    Text::new(content).set("x", px(x)).set("y", px(y)).set("font-size", size).set("fill", colour)
}

/// Rounds to 0.1 pixels.
fn px(value: f64) -> f64 {
    (value * 10.0).round() / 10.0 + 0.0
}
