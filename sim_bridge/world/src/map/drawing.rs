//! Content of a map file that is not part of the map: robots, objects and people at the start of a
//! simulation.

use super::file::MapFile;
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

/// An item drawn on a level.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DrawnItem {
    /// Its identity in the file: the id of the cell, or the level and number of the vertex.
    pub id: String,
    /// Its type as written.
    pub kind: String,
    /// Its name; the id if it has no name.
    pub name: String,
    /// Name of its level; `None` on a map with a single level.
    pub level: Option<String>,
    /// Metres to the east, of its centre.
    pub x_m: f64,
    /// Metres to the north, of its centre.
    pub y_m: f64,
    /// Heading in radians counter-clockwise from east.
    pub yaw_rad: f64,
    /// Width and height of its outline before rotation, in metres.
    pub size_m: (f64, f64),
    /// Nearest place on its level; `None` if the level has no places.
    pub place: Option<String>,
    /// All other attributes as written.
    pub attributes: BTreeMap<String, String>,
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

impl Drawing {
    /// Returns all drawn items.
    pub fn items(&self) -> impl Iterator<Item = &DrawnItem> {
        let robots = self.robots.iter().map(|robot| &robot.item);
        let objects = self.objects.iter().map(|object| &object.item);
        let people = self.people.iter().map(|person| &person.item);
        robots.chain(objects).chain(people).chain(&self.others)
    }

    /// Sets the nearest place of every item on its level; of equally near places the first.
    pub(super) fn assign_nearest_places(&mut self) {
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
