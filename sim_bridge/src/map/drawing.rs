//! What a file holds beside the map: who and what is on the floor when a simulation begins.

use super::file::MapFile;
use std::collections::BTreeMap;

/// A map and what is drawn beside it. Nothing of it has been checked yet: [`MapFile::check`] does.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Drawing {
    /// The map.
    pub map: MapFile,
    /// Robots.
    pub robots: Vec<DrawnRobot>,
    /// Objects that can be picked up.
    pub objects: Vec<DrawnObject>,
    /// People.
    pub people: Vec<DrawnPerson>,
    /// Things of any other type.
    pub others: Vec<DrawnItem>,
    /// What was left out, and why: a sentence each.
    pub notes: Vec<String>,
}

/// Something on the floor.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DrawnItem {
    /// Its identity in the file: the id of the cell, or the level and number of the vertex.
    pub id: String,
    /// Its type as written.
    pub kind: String,
    /// Its name; the identity if it has none.
    pub name: String,
    /// The name of its level; none on a map of one level.
    pub level: Option<String>,
    /// Metres to the east, of its middle.
    pub x_m: f64,
    /// Metres to the north, of its middle.
    pub y_m: f64,
    /// Where it faces, in radians counter-clockwise from east.
    pub yaw_rad: f64,
    /// Width and height of its outline, before it was turned, in metres.
    pub size_m: (f64, f64),
    /// The nearest place on its level; none if there is no place.
    pub place: Option<String>,
    /// Everything else that was written about it.
    pub attributes: BTreeMap<String, String>,
}

/// A robot.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DrawnRobot {
    /// Where and how it is drawn; the attribute `robot_type` is its model, if one is given.
    pub body: DrawnItem,
    /// What it has: by the name of a component the values it starts with.
    pub components: BTreeMap<String, serde_json::Value>,
    /// A path drawn for it alone, as (x, y) in metres after where it stands; empty if there is none.
    pub path: Vec<(f64, f64)>,
}

/// An object that can be picked up.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DrawnObject {
    /// Where and how it is drawn.
    pub body: DrawnItem,
    /// Its weight; finite, not negative.
    pub weight_kg: f64,
}

/// Somebody.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DrawnPerson {
    /// Where and how they are drawn.
    pub body: DrawnItem,
    /// What they are here for: `nurse` or what the file says; `person` if it says nothing.
    pub role: String,
}

impl Drawing {
    /// Everything drawn beside the map.
    pub fn items(&self) -> impl Iterator<Item = &DrawnItem> {
        let robots = self.robots.iter().map(|robot| &robot.body);
        let objects = self.objects.iter().map(|object| &object.body);
        let people = self.people.iter().map(|person| &person.body);
        robots.chain(objects).chain(people).chain(&self.others)
    }

    /// Tells everything which place of its level is nearest; of equals the first.
    pub(super) fn assign_nearest_places(&mut self) {
        let robots = self.robots.iter_mut().map(|robot| &mut robot.body);
        let objects = self.objects.iter_mut().map(|object| &mut object.body);
        let people = self.people.iter_mut().map(|person| &mut person.body);
        for body in robots.chain(objects).chain(people).chain(&mut self.others) {
            let near = self.map.places.iter().filter(|place| place.level == body.level);
            let apart = |x: f64, y: f64| (x - body.x_m).hypot(y - body.y_m);
            let nearest = near.min_by(|a, b| apart(a.x_m, a.y_m).total_cmp(&apart(b.x_m, b.y_m)));
            body.place = nearest.map(|place| place.name.clone());
        }
    }
}
