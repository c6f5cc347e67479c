//! Converts the robots, people and objects of a drawing to a world file.

use crate::config::{FleetConfig, FleetRef, WorldConfig};
use consort_map_import::{Drawing, DrawnItem, DrawnObject, DrawnPerson, DrawnRobot};
use consort_protocol::ids::{PlaceId, RobotId, RoleId};
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond};
use consort_world::world::{ObjectSetup, PersonSetup, RobotSetup, SampleId};
use std::str::FromStr;

/// Values that drawings do not contain: robots drive at 0.5 m/s, and their battery lasts for 40
/// minutes of work.
const SPEED_MPS: f64 = 0.5;
const DISCHARGE_SHARE_PER_S: f64 = 0.0004;

/// Converts a drawing to a world on the map of this name, with a note for each difference to the
/// drawing.
pub(super) fn world_from_drawing(drawing: &Drawing, map: String) -> (WorldConfig, Vec<String>) {
    let mut notes = vec![];
    let mut note_if_skipped = |item: &DrawnItem, made: Option<()>| {
        if made.is_none() {
            notes.push(format!("{} {:?} has no name or place that a world could use", item.kind, item.name));
        }
    };
    let (mut robots, mut people, mut objects) = (vec![], vec![], vec![]);
    for drawn in &drawing.robots {
        note_if_skipped(&drawn.item, robot(drawn).map(|robot| robots.push(robot)));
    }
    for drawn in &drawing.people {
        note_if_skipped(&drawn.item, person(drawn).map(|person| people.push(person)));
    }
    for drawn in &drawing.objects {
        note_if_skipped(&drawn.item, object(drawing, drawn).map(|object| objects.push(object)));
    }
    if !robots.is_empty() {
        notes.push(format!(
            "speed, battery and discharge of robots are not drawn: {SPEED_MPS} m/s, full, {DISCHARGE_SHARE_PER_S} /s"
        ));
    }
    for item in &drawing.others {
        notes.push(format!("a world holds no {}: {:?} is left out", item.kind, item.name));
    }
    let fleet = FleetRef::from(FleetConfig { map: map.clone(), ..FleetConfig::default() });
    let world =
        WorldConfig { map: Some(map), fleet, robot: robots, person: people, object: objects, ..WorldConfig::default() };
    (world, notes)
}

fn robot(DrawnRobot { item, components, .. }: &DrawnRobot) -> Option<RobotSetup> {
    let (speed, discharge) = (MetresPerSecond::new(SPEED_MPS).ok()?, SharePerSecond::new(DISCHARGE_SHARE_PER_S).ok()?);
    let carrier = RobotSetup::carrier(slug::<RobotId>(&item.name)?, place(item)?, speed, BatteryShare::FULL, discharge);
    // In HMR Sim, the components list a robot's equipment; a robot with neither component gets a
    // drawer.
    let (has_arm, drawer) = (components.contains_key("Claw"), components.contains_key("Drawer"));
    Some(RobotSetup { has_arm, has_drawer: drawer || !has_arm, ..carrier })
}

fn person(DrawnPerson { item, role }: &DrawnPerson) -> Option<PersonSetup> {
    let (role, place) = (slug::<RoleId>(role)?, place(item)?);
    Some(PersonSetup::new(&item.name, role, place))
}

fn object(drawing: &Drawing, DrawnObject { item, weight_kg }: &DrawnObject) -> Option<ObjectSetup> {
    let place = place(item)?;
    let at = drawing.map.places.iter().find(|entry| entry.name == place.as_str())?;
    let distance_m = (at.x_m - item.x_m).hypot(at.y_m - item.y_m);
    Some(ObjectSetup { name: SampleId::from(item.name.as_str()), place, weight_kg: *weight_kg, distance_m })
}

/// Returns the place that an object is nearest to.
fn place(item: &DrawnItem) -> Option<PlaceId> {
    PlaceId::new(item.place.clone()?).ok()
}

/// Converts a name to an id: lower case, with a dash for each character that ids do not allow.
fn slug<T: FromStr>(name: &str) -> Option<T> {
    let letter = |letter: char| if letter.is_ascii_alphanumeric() || "_.-".contains(letter) { letter } else { '-' };
    name.to_lowercase().chars().map(letter).collect::<String>().trim_matches('-').parse().ok()
}
