//! Content of a map file that is not part of the map: robots, objects and people at the start of a
//! simulation.

use consort_world::map::MapFile;
use consort_world::map::render::DrawnItem;
use std::collections::BTreeMap;

/// A map and the items drawn on it. Not yet checked; [`MapFile::check`] checks the map.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Drawing {
    /// The map.
    pub map: MapFile,
    /// Robots.
    pub robots: Vec<DrawnRobot>,
    /// Objects that a robot can pick up.
    pub objects: Vec<DrawnObject>,
    /// People.
    pub people: Vec<DrawnPerson>,
    /// Items of any other type.
    pub others: Vec<DrawnItem>,
    /// Sentences about ignored content, each with the reason.
    pub notes: Vec<String>,
}

/// A robot.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DrawnRobot {
    /// Position and outline; the attribute `robot_type` is the model, if given.
    pub item: DrawnItem,
    /// Initial values of its components, by component name.
    pub components: BTreeMap<String, serde_json::Value>,
    /// A path drawn for this robot alone, as (x, y) in metres, without the start position. Empty if
    /// there is none.
    pub path: Vec<(f64, f64)>,
}

/// An object that a robot can pick up.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DrawnObject {
    /// Position and outline.
    pub item: DrawnItem,
    /// Weight; finite and not negative.
    pub weight_kg: f64,
}

/// A person.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DrawnPerson {
    /// Position and outline.
    pub item: DrawnItem,
    /// Role of the person, for example `nurse`; `person` if the file gives none.
    pub role: String,
}

impl From<MapFile> for Drawing {
    /// Returns the drawing of a map without items.
    fn from(map: MapFile) -> Drawing {
        Drawing { map, ..Drawing::default() }
    }
}

impl Drawing {
    /// Returns all drawn items.
    pub fn items(&self) -> impl Iterator<Item = &DrawnItem> {
        let robots = self.robots.iter().map(|robot| &robot.item);
        let objects = self.objects.iter().map(|object| &object.item);
        let people = self.people.iter().map(|person| &person.item);
        robots.chain(objects).chain(people).chain(&self.others)
    }

    /// Sets the nearest place of every item on its level; of equally near places the first.
    pub(crate) fn assign_nearest_places(&mut self) {
        let robots = self.robots.iter_mut().map(|robot| &mut robot.item);
        let objects = self.objects.iter_mut().map(|object| &mut object.item);
        let people = self.people.iter_mut().map(|person| &mut person.item);
        for item in robots.chain(objects).chain(people).chain(&mut self.others) {
            let near = self.map.places.iter().filter(|place| place.level == item.level);
            let apart = |x: f64, y: f64| (x - item.x_m).hypot(y - item.y_m);
            let nearest = near.min_by(|a, b| apart(a.x_m, a.y_m).total_cmp(&apart(b.x_m, b.y_m)));
            item.place = nearest.map(|place| place.name.clone());
        }
    }
}

/// Returns a text as a map name: characters that are not allowed become `-`.
pub(crate) fn to_map_name(text: &str) -> String {
    let allowed = |letter: char| letter.is_ascii_alphanumeric() || matches!(letter, '_' | '.' | '-');
    let name: String = text.trim().chars().map(|letter| if allowed(letter) { letter } else { '-' }).take(64).collect();
    if name.is_empty() { "map".to_owned() } else { name }
}

/// Returns a map name made from the name of the file.
pub(crate) fn map_name_from_path(file: &str) -> String {
    let last = file.rsplit(['/', '\\']).next().unwrap_or(file);
    to_map_name(last.split('.').next().unwrap_or(last))
}

/// Rounds to 0.1 mm: no drawing is finer, and files stay readable. Never returns a negative zero.
pub(crate) fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4 + 0.0
}
