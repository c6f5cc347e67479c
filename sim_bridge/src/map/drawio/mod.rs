//! Maps drawn with diagrams.net (draw.io, mxGraph), by the conventions of HMR Sim.
//!
//! The file is `<mxfile>` with pages, plain or compressed, or a bare `<mxGraphModel>`. Each page is a level; a page with
//! neither walls nor anything of a type is left out. A unit of the drawing is [`METRES_PER_UNIT`] unless told otherwise:
//! by the attribute `metres_per_unit` of a page (*Edit Data* with nothing selected), or by who reads it
//! ([`Options::scale_m`]). The page's lower left corner is (0, 0), y points north.
//!
//! What a cell means is told by its data (*Edit Data*), first of all by `type`:
//!
//! | `type`     | is                    | attributes |
//! |------------|-----------------------|------------|
//! | `POI`      | a place, its middle   | `tag`: its name; ours: `kind` (room, lab, corridor, dock, charger, other), `yaw_deg` (counter-clockwise from east) |
//! | `map-path` | lanes, a line         | ours: `one_way` (`true`), `speed_limit_mps` |
//! | `robot`    | a robot               | `name`, `robot_type`, `component_X`: JSON, what the robot has |
//! | `path`     | a robot's own path    | from the robot: its `source` |
//! | `pickable` | an object             | `name`, `weight` in kg |
//! | `person`   | somebody (ours)       | `name`, `role` |
//! | `door`     | a door (ours), its longer middle line | `tag`, `opening_s` |
//! | `lift`     | a lift's stop (ours)  | `tag`: the lift, one cell on each of its pages; `capacity`, `opening_s`, `speed_mps` |
//!
//! Anything else is kept as it is ([`Drawing::others`]). Walls are shapes without a type: `mxgraph.floorplan.wall`,
//! `room`, `wallU` (left, top, right) and `wallCorner` (left, top), and plain unlabelled bars up to 15 units thick; the line
//! through their middle is the wall. `direction` turns a shape by quarters, `flipH` and `flipV` flip it, and `rotation`
//! turns it clockwise, about its middle.
//!
//! Points of paths are one where they lie in one cell of a grid of [`GRID`] units, and lie in its middle; where a place
//! lies in that cell, it is the point. A `source` or `target` stands for the middle of that cell of the drawing. A path
//! that leads past a point leads through it. A place that no path leads to is joined to the nearest point of a path within
//! [`REACH`] units, if no wall is between.

mod net;
mod problem;
mod shape;
#[cfg(test)]
mod tests;
mod xml;

pub use problem::{CellError, DrawioDiagnostic};

use super::drawing::{Drawing, DrawnItem, DrawnObject, DrawnPerson, DrawnRobot};
use super::file::{DoorEntry, ImportOptions, LaneEntry, LevelEntry, LiftEntry, PlaceEntry, limits};
use super::import::{ImportError, round};
use super::{MapDiagnostic, PlaceKind};
use crate::suggest::did_you_mean;
use net::{Net, Via};
use shape::{Index, Outline, Point};
use std::collections::BTreeMap;
use xml::{Cell, Page};

/// Metres that a unit of a drawing stands for unless told otherwise: then a robot of 30 units is 0.6 m wide, and a wall of
/// 10 units 0.2 m thick.
pub const METRES_PER_UNIT: f64 = 0.02;
/// The grid on which points of paths lie, in units.
pub const GRID: f64 = 20.0;
/// How far from a path a place may be that no path leads to, in units.
pub const REACH: f64 = 100.0;

/// The types that mean something here.
const TYPES: [&str; 8] = ["POI", "map-path", "robot", "path", "pickable", "person", "door", "lift"];
const POSITIVE: &str = "a number above 0";

/// Reads a drawing; `name` is the map's.
pub(super) fn read(text: &str, name: &str, options: &ImportOptions) -> Result<Drawing, ImportError> {
    let mut problems = Vec::new();
    let pages = xml::pages(text, &mut problems).map_err(ImportError::Syntax)?;
    let mut reader = Reader { problems, ..Reader::default() };
    reader.drawing.map.name = name.to_owned();
    let (used, empty): (Vec<&Page>, Vec<&Page>) = pages.iter().partition(|page| is_level(page));
    for page in empty {
        reader.drawing.notes.push(format!("page {:?} has neither walls nor anything of a type: left out", page.name));
    }
    let scale = scale(&used, options, &mut reader);
    for page in &used {
        let level = (used.len() > 1).then(|| page.name.clone());
        PageReader::new(page, level, scale, &mut reader).read();
    }
    let Reader { mut drawing, problems, lifts } = reader;
    if !problems.is_empty() {
        return Err(ImportError::Problems(problems.into_iter().map(MapDiagnostic::from).collect()));
    }
    drawing.map.lifts = lifts.into_values().collect();
    drawing.assign_nearest_places();
    Ok(drawing)
}

fn is_level(page: &Page) -> bool {
    let cells = shape::index(page);
    page.cells.iter().any(|cell| cell.data.contains_key("type") || shape::wall(cell, &cells).is_some())
}

/// Metres per unit: as told, else as the first page says that does, else the default.
fn scale(pages: &[&Page], options: &ImportOptions, reader: &mut Reader) -> f64 {
    let said = pages.iter().find_map(|page| {
        let cell = page.cells.iter().find(|cell| cell.data.contains_key("metres_per_unit"))?;
        Some((page, cell, &cell.data["metres_per_unit"]))
    });
    if let Some(scale) = options.scale_m {
        return scale;
    }
    let Some((page, cell, text)) = said else {
        let note = format!("the drawing gives no scale: a unit is taken for {METRES_PER_UNIT} m");
        reader.drawing.notes.push(note);
        return METRES_PER_UNIT;
    };
    let scale = text.parse().ok().filter(|scale: &f64| *scale > 0.0 && scale.is_finite());
    scale.unwrap_or_else(|| {
        let wrong = CellError::Number { field: "metres_per_unit".into(), text: text.clone(), allowed: POSITIVE };
        reader.problems.push(DrawioDiagnostic { page: page.name.clone(), cell: cell.id.clone(), wrong });
        METRES_PER_UNIT
    })
}

#[derive(Default)]
struct Reader {
    drawing: Drawing,
    problems: Vec<DrawioDiagnostic>,
    /// By their names.
    lifts: BTreeMap<String, LiftEntry>,
}

struct PageReader<'a> {
    page: &'a Page,
    cells: Index<'a>,
    level: Option<String>,
    scale: f64,
    all: &'a mut Reader,
    /// The places of this page with the cells they were drawn as, in the order of the page.
    places: Vec<(&'a Cell, PlaceEntry, Point)>,
}

impl<'a> PageReader<'a> {
    fn new(page: &'a Page, level: Option<String>, scale: f64, all: &'a mut Reader) -> PageReader<'a> {
        PageReader { page, cells: shape::index(page), level, scale, all, places: Vec::new() }
    }

    fn read(mut self) {
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
        let mut net = Net::of(self.places.iter().map(|(_, _, at)| *at));
        for cell in of(&["map-path"]) {
            self.path(cell, &mut net);
        }
        if net.spots.len() <= limits::PLACES && net.ways.len() <= limits::LANES {
            net.tie();
            for place in net.join(&walls) {
                let (cell, entry, _) = &self.places[place];
                // The only place of a level needs no way on it.
                if net.spots.len() > 1 {
                    let (cell, place) = (*cell, entry.name.clone());
                    self.say(cell, CellError::OffPaths { place });
                }
            }
        }
        for cell in &page.cells {
            self.thing(cell);
        }
        for cell in of(&["path"]) {
            self.own_path(cell);
        }
        let lanes = self.lanes(&net);
        for cell in of(&["door"]) {
            self.door(cell, &net, &lanes);
        }
        let walls = walls.into_iter().map(|wall| wall.into_iter().map(|at| self.metres(at)).collect()).collect();
        let map = &mut self.all.drawing.map;
        match &self.level {
            None => map.walls = walls,
            Some(name) => map.levels.push(LevelEntry { name: name.clone(), walls, ..LevelEntry::default() }),
        }
        map.lanes.extend(lanes);
    }

    fn say(&mut self, cell: &Cell, wrong: CellError) {
        self.all.problems.push(DrawioDiagnostic { page: self.page.name.clone(), cell: cell.id.clone(), wrong });
    }

    fn metres(&self, (x, y): Point) -> (f64, f64) {
        (round(x * self.scale), round((self.page.height - y) * self.scale))
    }

    /// A number of a cell's data, if it is given.
    fn number(&mut self, cell: &Cell, field: &str, allowed: &'static str, is: fn(f64) -> bool) -> Option<f64> {
        let text = cell.data.get(field)?;
        let number = text.trim().parse().ok().filter(|number: &f64| number.is_finite() && is(*number));
        if number.is_none() {
            self.say(cell, CellError::Number { field: field.to_owned(), text: text.clone(), allowed });
        }
        number
    }

    /// `name (page)` where there are several pages.
    fn on_level(&self, name: &str) -> String {
        self.level.as_ref().map_or_else(|| name.to_owned(), |level| format!("{name} ({level})"))
    }

    fn place(&mut self, cell: &'a Cell) {
        let kind = kind_of(cell);
        let Some(outline) = Outline::of(cell, &self.cells) else {
            return self.say(cell, CellError::Nowhere { kind: kind.to_owned() });
        };
        let name = match (cell.data.get("tag"), kind) {
            (Some(tag), "lift") => {
                let name = self.on_level(tag);
                self.lift(cell, tag, &name);
                name
            }
            (Some(tag), _) => tag.clone(),
            (None, "lift") => return self.say(cell, CellError::Missing { kind: kind.to_owned(), field: "tag" }),
            (None, _) => {
                let name = self.on_level(&format!("POI_{}", self.places.len()));
                let note =
                    format!("page {:?}, cell {:?}: this POI has no tag and is named {name:?}", self.page.name, cell.id);
                self.all.drawing.notes.push(note);
                name
            }
        };
        let (x_m, y_m) = self.metres(outline.centre);
        let yaw_deg = self.number(cell, "yaw_deg", "a number of degrees", |_| true).unwrap_or(0.0);
        let kind = match cell.data.get("kind").map(|text| PlaceKind::named(text).ok_or(text)) {
            None => PlaceKind::Other,
            Some(Ok(kind)) => kind,
            Some(Err(text)) => return self.say(cell, CellError::kind(text)),
        };
        let yaw_rad = round(yaw_deg.to_radians());
        let entry = PlaceEntry { name, kind, x_m, y_m, yaw_rad, level: self.level.clone() };
        self.places.push((cell, entry, outline.centre));
    }

    fn lift(&mut self, cell: &Cell, tag: &str, stop: &str) {
        let capacity = self.number(cell, "capacity", "a whole number from 1 to 1000", |n| {
            n.fract() == 0.0 && (1.0..=1000.0).contains(&n)
        });
        let opening_s = self.number(cell, "opening_s", "a number of seconds from 0", |n| n >= 0.0);
        let speed_mps = self.number(cell, "speed_mps", POSITIVE, |n| n > 0.0);
        let fresh = || LiftEntry { name: tag.to_owned(), ..LiftEntry::default() };
        let lift = self.all.lifts.entry(tag.to_owned()).or_insert_with(fresh);
        lift.stops.push(stop.to_owned());
        lift.capacity = capacity.map_or(lift.capacity, |capacity| capacity as u32);
        lift.opening_s = opening_s.unwrap_or(lift.opening_s);
        lift.speed_mps = speed_mps.unwrap_or(lift.speed_mps);
    }

    fn path(&mut self, cell: &Cell, net: &mut Net) {
        let Some(through) = self.through(cell) else { return };
        let one_way = cell.data.get("one_way").is_some_and(|text| text == "true" || text == "1");
        let limit = self.number(cell, "speed_limit_mps", POSITIVE, |n| n > 0.0);
        if !net.path(&through, one_way, limit) {
            self.say(cell, CellError::NoLength);
        }
    }

    /// The points of a path, from end to end.
    fn through(&mut self, cell: &Cell) -> Option<Vec<Via>> {
        let Some(line) = shape::line(cell, &self.cells) else {
            self.say(cell, CellError::NoLine { kind: kind_of(cell).to_owned() });
            return None;
        };
        let source = self.end(cell, "source", cell.source.as_deref(), line.source);
        let target = self.end(cell, "target", cell.target.as_deref(), line.target);
        let between = line.between.into_iter().map(Via::Point);
        Some([source?].into_iter().chain(between).chain([target?]).collect())
    }

    /// An end of a path: the cell it hangs on, and else the point.
    fn end(&mut self, cell: &Cell, end: &'static str, id: Option<&str>, point: Option<Point>) -> Option<Via> {
        let Some(id) = id else {
            if point.is_none() {
                self.say(cell, CellError::OpenEnd { end });
            }
            return point.map(Via::Point);
        };
        if let Some(place) = self.places.iter().position(|(cell, ..)| cell.id == id) {
            return Some(Via::Place(place));
        }
        let outline = self.cells.get(id).and_then(|at| Outline::of(at, &self.cells));
        if outline.is_none() {
            self.say(cell, CellError::UnknownEnd { end, id: id.to_owned() });
        }
        outline.map(|outline| Via::Point(outline.centre))
    }

    /// Puts places and points on the map, and returns the lanes between them.
    fn lanes(&mut self, net: &Net) -> Vec<LaneEntry> {
        let mut names = Vec::new();
        for spot in &net.spots {
            let entry = match spot.place {
                Some(place) => self.places[place].1.clone(),
                None => {
                    let name = self.on_level(&format!("Point {:.0} {:.0}", spot.at.0, spot.at.1));
                    let (x_m, y_m) = self.metres(spot.at);
                    let level = self.level.clone();
                    PlaceEntry { name, kind: PlaceKind::Corridor, x_m, y_m, level, ..PlaceEntry::default() }
                }
            };
            names.push(entry.name.clone());
            self.all.drawing.map.places.push(entry);
        }
        let lane = |way: &net::Way| {
            let (from, to) = if way.open.0 { (way.from, way.to) } else { (way.to, way.from) };
            LaneEntry {
                between: (names[from].clone(), names[to].clone()),
                one_way: way.open != (true, true),
                speed_limit_mps: way.speed_limit_mps,
                ..LaneEntry::default()
            }
        };
        net.ways.iter().map(lane).collect()
    }

    fn door(&mut self, cell: &Cell, net: &Net, lanes: &[LaneEntry]) {
        let ends = match (Outline::of(cell, &self.cells), shape::line(cell, &self.cells)) {
            (Some(outline), _) => Some(outline.middle_line()),
            (None, Some(line)) => line.source.zip(line.target).map(|(a, b)| [a, b]),
            (None, None) => None,
        };
        let Some([a, b]) = ends else { return self.say(cell, CellError::Nowhere { kind: "door".into() }) };
        let across = net.ways.iter().zip(lanes).filter(|(way, _)| {
            let [from, to] = [way.from, way.to].map(|spot| net.spots[spot].at);
            super::building::intersection(from, to, a, b).is_some()
        });
        let on = across.map(|(_, lane)| lane.between.clone()).collect();
        let opening_s = self.number(cell, "opening_s", "a number of seconds from 0", |n| n >= 0.0);
        let span = Some((self.metres(a), self.metres(b)));
        let mut entry = DoorEntry { name: name_of(cell), on, span, ..DoorEntry::default() };
        entry.opening_s = opening_s.unwrap_or(entry.opening_s);
        self.all.drawing.map.doors.push(entry);
    }

    /// Robots, objects, people, and whatever else has a type.
    fn thing(&mut self, cell: &Cell) {
        let kind = kind_of(cell);
        if matches!(kind, "" | "POI" | "map-path" | "path" | "door" | "lift") {
            return;
        }
        let Some(outline) = Outline::of(cell, &self.cells) else {
            return self.say(cell, CellError::Nowhere { kind: kind.to_owned() });
        };
        let body = self.body(cell, &outline);
        match kind {
            "robot" => {
                let components = self.components(cell);
                self.all.drawing.robots.push(DrawnRobot { body, components, path: Vec::new() });
            }
            "pickable" => {
                let weight = self.number(cell, "weight", "a number of kilograms from 0", |n| n >= 0.0);
                for field in ["name", "weight"] {
                    if !cell.data.contains_key(field) {
                        self.say(cell, CellError::Missing { kind: kind.to_owned(), field });
                    }
                }
                self.all.drawing.objects.push(DrawnObject { body, weight_kg: weight.unwrap_or(0.0) });
            }
            "person" => {
                let role = cell.data.get("role").map_or("person", String::as_str).to_owned();
                self.all.drawing.people.push(DrawnPerson { body, role });
            }
            other => {
                let hint = did_you_mean(other, TYPES);
                if !hint.is_empty() {
                    let note = format!(
                        "page {:?}, cell {:?}: type {other:?} means nothing here{hint}",
                        self.page.name, cell.id
                    );
                    self.all.drawing.notes.push(note);
                }
                self.all.drawing.others.push(body);
            }
        }
    }

    fn body(&self, cell: &Cell, outline: &Outline) -> DrawnItem {
        let (x_m, y_m) = self.metres(outline.centre);
        let own = |key: &str| !key.starts_with("component_") && !matches!(key, "type" | "name" | "tag");
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
            attributes: cell.data.iter().filter(|(key, _)| own(key)).map(|(k, v)| (k.clone(), v.clone())).collect(),
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
                    self.say(cell, CellError::Component { component, reason });
                }
            }
        }
        components
    }

    /// A path for one robot: the one it begins at.
    fn own_path(&mut self, cell: &Cell) {
        let Some(through) = self.through(cell) else { return };
        let robot = cell.source.as_deref().and_then(|id| self.robot(id));
        let Some(robot) = robot else {
            let id = cell.source.clone().unwrap_or_default();
            return self.say(cell, CellError::UnknownEnd { end: "source", id });
        };
        let points = through.iter().skip(1).map(|via| match via {
            Via::Place(place) => self.metres(self.places[*place].2),
            Via::Point(at) => self.metres(*at),
        });
        let points = points.collect();
        self.all.drawing.robots[robot].path = points;
    }

    fn robot(&self, id: &str) -> Option<usize> {
        self.all.drawing.robots.iter().position(|robot| robot.body.id == id && robot.body.level == self.level)
    }
}

/// The type of a cell, as it is known here; empty if it has none.
fn kind_of(cell: &Cell) -> &str {
    let written = cell.data.get("type").map_or("", String::as_str);
    TYPES.into_iter().find(|known| known.eq_ignore_ascii_case(written)).unwrap_or(written)
}

/// What a cell is called: by its name, its tag, its label, and else its id.
fn name_of(cell: &Cell) -> String {
    let said = [cell.data.get("name"), cell.data.get("tag"), Some(&cell.label), Some(&cell.id)];
    said.into_iter().flatten().find(|text| !text.is_empty()).cloned().unwrap_or_default()
}
