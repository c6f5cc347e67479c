//! The drawing of a level: its walls, lanes, doors, lifts, places and items.

use super::colours::{self, DOOR, INK, ITEM, LANE, LIFT, ROBOT, WALL};
use super::content::{DrawnItem, Trail, trail_of};
use super::elements::{NAME_PX, NOTE_PX, Point, arrow_head, line, px, text};
use super::labels::{Labels, Weight};
use super::page::Panel;
use super::trails;
use crate::map::model::{Lane, LevelIndex, Map, MapPlace, PlaceKind};
use svg::node::element::{Circle, Group, Polyline, Rectangle, Title};

/// The drawing of a level on its panel.
pub(super) struct LevelDrawing<'a> {
    map: &'a Map,
    level: LevelIndex,
    panel: &'a Panel,
    labels: Labels,
    group: Group,
}

impl<'a> LevelDrawing<'a> {
    pub(super) fn new(map: &'a Map, level: LevelIndex, panel: &'a Panel) -> LevelDrawing<'a> {
        let group = Group::new().set("class", "level").set("data-name", map.level(level).name.as_str());
        LevelDrawing { map, level, panel, labels: Labels::default(), group }
    }

    pub(super) fn draw(mut self, items: &[&DrawnItem], trails: &[Trail]) -> Group {
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
        for trail in trails::draw(trails, self.level, self.panel, &mut self.labels) {
            self.add(trail);
        }
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
        if !lane.graphs.is_empty() {
            let graphs: Vec<&str> = lane.graphs.iter().map(String::as_str).collect();
            title.push_str(&format!(", graph {}", graphs.join(", ")));
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
            if door.level != self.level {
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

/// Returns colour and radius of a place.
pub(super) fn dot(kind: PlaceKind) -> (&'static str, f64) {
    let radius = match kind {
        PlaceKind::Corridor => 3.5,
        PlaceKind::Other => 5.0,
        PlaceKind::Room | PlaceKind::Lab | PlaceKind::Dock | PlaceKind::Charger => 6.0,
    };
    (colours::place_kind_colour(kind), radius)
}
