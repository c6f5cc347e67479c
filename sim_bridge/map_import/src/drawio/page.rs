//! Reads a page of a drawing: its places and lanes, doors and lifts, and the items on it.

use super::diagnostic::{CellError, DrawioDiagnostic};
use super::network::{NetworkEdge, PathNetwork, Via};
use super::shape::{self, Index, Outline, Point};
use super::xml::{Cell, Page};
use crate::drawing::{Drawing, DrawnObject, DrawnPerson, DrawnRobot, round};
use consort_world::map::render::DrawnItem;
use consort_world::map::{DoorEntry, LaneEntry, LevelEntry, LiftEntry, PlaceEntry, PlaceKind, intersection, limits};
use consort_world::suggest::did_you_mean;
use std::collections::BTreeMap;

/// The types with a meaning here.
const TYPES: [&str; 8] = ["POI", "map-path", "robot", "path", "pickable", "person", "door", "lift"];
/// Allowed values of a scale, a speed or a speed limit.
pub(super) const POSITIVE: &str = "a number above 0";

/// The content of the pages read before.
#[derive(Default)]
pub(super) struct DrawingContent {
    pub(super) drawing: Drawing,
    pub(super) diagnostics: Vec<DrawioDiagnostic>,
    /// Lifts by name.
    pub(super) lifts: BTreeMap<String, LiftEntry>,
}

/// The reader of a page.
pub(super) struct PageReader<'a> {
    page: &'a Page,
    cells: Index<'a>,
    level: Option<String>,
    scale: f64,
    content: &'a mut DrawingContent,
    /// The places of this page with their cells, in the order of the page.
    places: Vec<(&'a Cell, PlaceEntry, Point)>,
}

impl<'a> PageReader<'a> {
    pub(super) fn new(
        page: &'a Page,
        level: Option<String>,
        scale: f64,
        content: &'a mut DrawingContent,
    ) -> PageReader<'a> {
        PageReader { page, cells: shape::index(page), level, scale, content, places: Vec::new() }
    }

    pub(super) fn read(mut self) {
        let page = self.page;
        let of = |kinds: &'static [&str]| page.cells.iter().filter(move |cell| kinds.contains(&kind_of(cell)));
        let walls: Vec<Vec<Point>> = page
            .cells
            .iter()
            .filter(|cell| !cell.data.contains_key("type"))
            .filter_map(|cell| shape::wall(cell, &self.cells))
            .collect();
        for cell in of(&["POI", "lift"]) {
            self.place(cell);
        }
        let mut network = PathNetwork::of(self.places.iter().map(|(_, _, at)| *at));
        for cell in of(&["map-path"]) {
            self.path(cell, &mut network);
        }
        if network.nodes.len() <= limits::PLACES && network.edges.len() <= limits::LANES {
            network.split_edges();
            for place in network.connect_isolated(&walls) {
                let (cell, entry, _) = &self.places[place];
                // The only place of a level needs no path.
                if network.nodes.len() > 1 {
                    let (cell, place) = (*cell, entry.name.clone());
                    self.report(cell, CellError::TooFarFromPaths { place });
                }
            }
        }
        for cell in &page.cells {
            self.add_item(cell);
        }
        for cell in of(&["path"]) {
            self.robot_path(cell);
        }
        let lanes = self.lanes(&network);
        for cell in of(&["door"]) {
            self.door(cell, &network, &lanes);
        }
        let walls = walls.into_iter().map(|wall| wall.into_iter().map(|at| self.metres(at)).collect()).collect();
        let map = &mut self.content.drawing.map;
        match &self.level {
            None => map.walls = walls,
            Some(name) => map.levels.push(LevelEntry { name: name.clone(), walls, ..LevelEntry::default() }),
        }
        map.lanes.extend(lanes);
    }

    fn report(&mut self, cell: &Cell, error: CellError) {
        self.content.diagnostics.push(DrawioDiagnostic { page: self.page.name.clone(), cell: cell.id.clone(), error });
    }

    fn metres(&self, (x, y): Point) -> (f64, f64) {
        (round(x * self.scale), round((self.page.height - y) * self.scale))
    }

    /// Returns a number of a cell's data, if given.
    fn number(&mut self, cell: &Cell, field: &str, allowed: &'static str, allows: fn(f64) -> bool) -> Option<f64> {
        let text = cell.data.get(field)?;
        let number = text.trim().parse().ok().filter(|number: &f64| number.is_finite() && allows(*number));
        if number.is_none() {
            self.report(cell, CellError::Number { field: field.to_owned(), text: text.clone(), allowed });
        }
        number
    }

    /// Returns `name (page)` if there are several pages.
    fn on_level(&self, name: &str) -> String {
        self.level.as_ref().map_or_else(|| name.to_owned(), |level| format!("{name} ({level})"))
    }

    fn place(&mut self, cell: &'a Cell) {
        let kind = kind_of(cell);
        let Some(outline) = Outline::of(cell, &self.cells) else {
            return self.report(cell, CellError::NoPosition { kind: kind.to_owned() });
        };
        let name = match (cell.data.get("tag"), kind) {
            (Some(tag), "lift") => {
                let name = self.on_level(tag);
                self.lift(cell, tag, &name);
                name
            }
            (Some(tag), _) => tag.clone(),
            (None, "lift") => return self.report(cell, CellError::Missing { kind: kind.to_owned(), field: "tag" }),
            (None, _) => {
                let name = self.on_level(&format!("POI_{}", self.places.len()));
                let note =
                    format!("page {:?}, cell {:?}: this POI has no tag; its name is {name:?}", self.page.name, cell.id);
                self.content.drawing.notes.push(note);
                name
            }
        };
        let (x_m, y_m) = self.metres(outline.centre);
        let yaw_deg = self.number(cell, "yaw_deg", "a number of degrees", |_| true).unwrap_or(0.0);
        let kind = match cell.data.get("kind").map(|text| PlaceKind::named(text).ok_or(text)) {
            None => PlaceKind::Other,
            Some(Ok(kind)) => kind,
            Some(Err(text)) => return self.report(cell, CellError::unknown_place_kind(text)),
        };
        let yaw_rad = round(yaw_deg.to_radians());
        let entry = PlaceEntry { name, kind, x_m, y_m, yaw_rad, level: self.level.clone(), dock: None };
        self.places.push((cell, entry, outline.centre));
    }

    fn lift(&mut self, cell: &Cell, tag: &str, stop: &str) {
        let capacity = self.number(cell, "capacity", "a whole number from 1 to 1000", |n| {
            n.fract() == 0.0 && (1.0..=1000.0).contains(&n)
        });
        let opening_s = self.number(cell, "opening_s", "a number of seconds from 0", |n| n >= 0.0);
        let speed_mps = self.number(cell, "speed_mps", POSITIVE, |n| n > 0.0);
        let fresh = || LiftEntry { name: tag.to_owned(), ..LiftEntry::default() };
        let lift = self.content.lifts.entry(tag.to_owned()).or_insert_with(fresh);
        lift.stops.push(stop.to_owned());
        lift.capacity = capacity.map_or(lift.capacity, |capacity| capacity as u32);
        lift.opening_s = opening_s.unwrap_or(lift.opening_s);
        lift.speed_mps = speed_mps.unwrap_or(lift.speed_mps);
    }

    fn path(&mut self, cell: &Cell, network: &mut PathNetwork) {
        let Some(path_points) = self.path_points(cell) else { return };
        let one_way = cell.data.get("one_way").is_some_and(|text| text == "true" || text == "1");
        let limit = self.number(cell, "speed_limit_mps", POSITIVE, |n| n > 0.0);
        if !network.path(&path_points, one_way, limit) {
            self.report(cell, CellError::ZeroLength);
        }
    }

    /// Returns the points of a path, from end to end.
    fn path_points(&mut self, cell: &Cell) -> Option<Vec<Via>> {
        let Some(line) = shape::line(cell, &self.cells) else {
            self.report(cell, CellError::NotALine { kind: kind_of(cell).to_owned() });
            return None;
        };
        let source = self.end(cell, "source", cell.source.as_deref(), line.source);
        let target = self.end(cell, "target", cell.target.as_deref(), line.target);
        let between = line.between.into_iter().map(Via::Point);
        Some([source?].into_iter().chain(between).chain([target?]).collect())
    }

    /// Returns an end of a path: the attached cell, else the point.
    fn end(&mut self, cell: &Cell, end: &'static str, id: Option<&str>, point: Option<Point>) -> Option<Via> {
        let Some(id) = id else {
            if point.is_none() {
                self.report(cell, CellError::MissingEnd { end });
            }
            return point.map(Via::Point);
        };
        if let Some(place) = self.places.iter().position(|(cell, ..)| cell.id == id) {
            return Some(Via::Place(place));
        }
        let outline = self.cells.get(id).and_then(|at| Outline::of(at, &self.cells));
        if outline.is_none() {
            self.report(cell, CellError::UnknownEnd { end, id: id.to_owned() });
        }
        outline.map(|outline| Via::Point(outline.centre))
    }

    /// Adds places and points to the map, and returns the lanes between them.
    fn lanes(&mut self, network: &PathNetwork) -> Vec<LaneEntry> {
        let mut names = Vec::new();
        for node in &network.nodes {
            let entry = match node.place {
                Some(place) => self.places[place].1.clone(),
                None => {
                    let name = self.on_level(&format!("Point {:.0} {:.0}", node.at.0, node.at.1));
                    let (x_m, y_m) = self.metres(node.at);
                    let level = self.level.clone();
                    PlaceEntry { name, kind: PlaceKind::Corridor, x_m, y_m, level, ..PlaceEntry::default() }
                }
            };
            names.push(entry.name.clone());
            self.content.drawing.map.places.push(entry);
        }
        let lane = |edge: &NetworkEdge| {
            let (from, to) = if edge.directions.0 { (edge.from, edge.to) } else { (edge.to, edge.from) };
            LaneEntry {
                between: (names[from].clone(), names[to].clone()),
                one_way: edge.directions != (true, true),
                speed_limit_mps: edge.speed_limit_mps,
                ..LaneEntry::default()
            }
        };
        network.edges.iter().map(lane).collect()
    }

    fn door(&mut self, cell: &Cell, network: &PathNetwork, lanes: &[LaneEntry]) {
        let ends = match (Outline::of(cell, &self.cells), shape::line(cell, &self.cells)) {
            (Some(outline), _) => Some(outline.middle_line()),
            (None, Some(line)) => line.source.zip(line.target).map(|(a, b)| [a, b]),
            (None, None) => None,
        };
        let Some([a, b]) = ends else { return self.report(cell, CellError::NoPosition { kind: "door".into() }) };
        let across = network.edges.iter().zip(lanes).filter(|(edge, _)| {
            let [from, to] = [edge.from, edge.to].map(|node| network.nodes[node].at);
            intersection(from, to, a, b).is_some()
        });
        let on = across.map(|(_, lane)| lane.between.clone()).collect();
        let opening_s = self.number(cell, "opening_s", "a number of seconds from 0", |n| n >= 0.0);
        let span = Some((self.metres(a), self.metres(b)));
        let mut entry = DoorEntry { name: name_of(cell), on, span, ..DoorEntry::default() };
        entry.opening_s = opening_s.unwrap_or(entry.opening_s);
        self.content.drawing.map.doors.push(entry);
    }

    /// Adds a robot, an object, a person, or a cell of another type.
    fn add_item(&mut self, cell: &Cell) {
        let kind = kind_of(cell);
        if matches!(kind, "" | "POI" | "map-path" | "path" | "door" | "lift") {
            return;
        }
        let Some(outline) = Outline::of(cell, &self.cells) else {
            return self.report(cell, CellError::NoPosition { kind: kind.to_owned() });
        };
        let item = self.drawn_item(cell, &outline);
        match kind {
            "robot" => {
                let components = self.components(cell);
                self.content.drawing.robots.push(DrawnRobot { item, components, path: Vec::new() });
            }
            "pickable" => {
                let weight = self.number(cell, "weight", "a number of kilograms from 0", |n| n >= 0.0);
                for field in ["name", "weight"] {
                    if !cell.data.contains_key(field) {
                        self.report(cell, CellError::Missing { kind: kind.to_owned(), field });
                    }
                }
                self.content.drawing.objects.push(DrawnObject { item, weight_kg: weight.unwrap_or(0.0) });
            }
            "person" => {
                let role = cell.data.get("role").map_or("person", String::as_str).to_owned();
                self.content.drawing.people.push(DrawnPerson { item, role });
            }
            other => {
                let hint = did_you_mean(other, TYPES);
                if !hint.is_empty() {
                    let note =
                        format!("page {:?}, cell {:?}: type {other:?} is not known{hint}", self.page.name, cell.id);
                    self.content.drawing.notes.push(note);
                }
                self.content.drawing.others.push(item);
            }
        }
    }

    fn drawn_item(&self, cell: &Cell, outline: &Outline) -> DrawnItem {
        let (x_m, y_m) = self.metres(outline.centre);
        let is_attribute = |key: &str| !key.starts_with("component_") && !matches!(key, "type" | "name" | "tag");
        DrawnItem {
            id: cell.id.clone(),
            kind: kind_of(cell).to_owned(),
            name: name_of(cell),
            level: self.level.clone(),
            x_m,
            y_m,
            yaw_rad: round((-outline.heading()).to_radians()),
            size_m: (round(outline.size.0 * self.scale), round(outline.size.1 * self.scale)),
            place: None,
            attributes: cell
                .data
                .iter()
                .filter(|(key, _)| is_attribute(key))
                .map(|(k, v)| (k.clone(), v.clone()))
                .collect(),
        }
    }

    fn components(&mut self, cell: &Cell) -> BTreeMap<String, serde_json::Value> {
        let mut components = BTreeMap::new();
        for (key, text) in &cell.data {
            let Some(component) = key.strip_prefix("component_") else { continue };
            match serde_json::from_str(text) {
                Ok(value) => {
                    components.insert(component.to_owned(), value);
                }
                Err(error) => {
                    let (component, reason) = (component.to_owned(), error.to_string());
                    self.report(cell, CellError::Component { component, reason });
                }
            }
        }
        components
    }

    /// Adds a path to the robot at its start.
    fn robot_path(&mut self, cell: &Cell) {
        let Some(path_points) = self.path_points(cell) else { return };
        let robot = cell.source.as_deref().and_then(|id| self.robot(id));
        let Some(robot) = robot else {
            let id = cell.source.clone().unwrap_or_default();
            return self.report(cell, CellError::UnknownEnd { end: "source", id });
        };
        let points = path_points.iter().skip(1).map(|via| match via {
            Via::Place(place) => self.metres(self.places[*place].2),
            Via::Point(at) => self.metres(*at),
        });
        let points = points.collect();
        self.content.drawing.robots[robot].path = points;
    }

    fn robot(&self, id: &str) -> Option<usize> {
        self.content.drawing.robots.iter().position(|robot| robot.item.id == id && robot.item.level == self.level)
    }
}

/// Returns the name of a cell: its name, its tag, its label, else its id.
fn name_of(cell: &Cell) -> String {
    let written_scale = [cell.data.get("name"), cell.data.get("tag"), Some(&cell.label), Some(&cell.id)];
    written_scale.into_iter().flatten().find(|text| !text.is_empty()).cloned().unwrap_or_default()
}

/// Returns the type of a cell in canonical spelling; empty if it has none.
fn kind_of(cell: &Cell) -> &str {
    let written = cell.data.get("type").map_or("", String::as_str);
    TYPES.into_iter().find(|known| known.eq_ignore_ascii_case(written)).unwrap_or(written)
}
