//! Who and what is drawn on a map, as a world file.

use crate::config::{FleetConfig, FleetRef, WorldConfig};
use consort_protocol::ids::{PlaceId, RobotId, RoleId};
use consort_protocol::units::{BatteryShare, MetresPerSecond, SharePerSecond};
use consort_sim::map::{Drawing, DrawnItem, DrawnObject, DrawnPerson, DrawnRobot};
use consort_sim::world::{ObjectSetup, PersonName, PersonSetup, RobotSetup, SampleId};
use std::str::FromStr;

/// What drawings do not say of robots: half a metre a second, and a battery that lasts for 40 minutes of work.
const SPEED_MPS: f64 = 0.5;
const DISCHARGE_SHARE_PER_S: f64 = 0.0004;

/// The world of a drawing, on the map of this name, with a note for whatever is not as drawn.
pub(super) fn world_from_drawing(drawing: &Drawing, map: String) -> (WorldConfig, Vec<String>) {
    let mut notes = vec![];
    let mut taken = |body: &DrawnItem, made: Option<()>| {
        if made.is_none() {
            notes.push(format!(
                "{} {:?} has no name or place of which a world could make something",
                body.kind, body.name
            ));
        }
    };
    let (mut robots, mut people, mut objects) = (vec![], vec![], vec![]);
    for drawn in &drawing.robots {
        taken(&drawn.body, robot(drawn).map(|robot| robots.push(robot)));
    }
    for drawn in &drawing.people {
        taken(&drawn.body, person(drawn).map(|person| people.push(person)));
    }
    for drawn in &drawing.objects {
        taken(&drawn.body, object(drawing, drawn).map(|object| objects.push(object)));
    }
    if !robots.is_empty() {
        notes.push(format!(
            "speed, battery and discharge of robots are not drawn: {SPEED_MPS} m/s, full, {DISCHARGE_SHARE_PER_S} /s"
        ));
    }
    for body in &drawing.others {
        notes.push(format!("a world holds no {}: {:?} is left out", body.kind, body.name));
    }
    let fleet = FleetRef::from(FleetConfig { map: map.clone(), ..FleetConfig::default() });
    let world =
        WorldConfig { map: Some(map), fleet, robot: robots, person: people, object: objects, ..WorldConfig::default() };
    (world, notes)
}

fn robot(DrawnRobot { body, components, .. }: &DrawnRobot) -> Option<RobotSetup> {
    let (speed, discharge) = (MetresPerSecond::new(SPEED_MPS).ok()?, SharePerSecond::new(DISCHARGE_SHARE_PER_S).ok()?);
    let carrier = RobotSetup::carrier(slug::<RobotId>(&body.name)?, place(body)?, speed, BatteryShare::FULL, discharge);
    // HMR Sim's robots have what their components say; one that says nothing of either carries things in a drawer.
    let (has_arm, drawer) = (components.contains_key("Claw"), components.contains_key("Drawer"));
    Some(RobotSetup { has_arm, has_drawer: drawer || !has_arm, ..carrier })
}

fn person(DrawnPerson { body, role }: &DrawnPerson) -> Option<PersonSetup> {
    let (role, place) = (slug::<RoleId>(role)?, place(body)?);
    Some(PersonSetup { name: PersonName::from(body.name.as_str()), role, place, samples: vec![], mood: vec![] })
}

fn object(drawing: &Drawing, DrawnObject { body, weight_kg }: &DrawnObject) -> Option<ObjectSetup> {
    let place = place(body)?;
    let at = drawing.map.places.iter().find(|entry| entry.name == place.as_str())?;
    let distance_m = (at.x_m - body.x_m).hypot(at.y_m - body.y_m);
    Some(ObjectSetup { name: SampleId::from(body.name.as_str()), place, weight_kg: *weight_kg, distance_m })
}

/// The place that a thing is nearest to.
fn place(body: &DrawnItem) -> Option<PlaceId> {
    PlaceId::new(body.place.clone()?).ok()
}

/// A name as ids are written: small letters, and a dash for whatever else may not stand in one.
fn slug<T: FromStr>(name: &str) -> Option<T> {
    let letter = |letter: char| if letter.is_ascii_alphanumeric() || "_.-".contains(letter) { letter } else { '-' };
    name.to_lowercase().chars().map(letter).collect::<String>().trim_matches('-').parse().ok()
}
