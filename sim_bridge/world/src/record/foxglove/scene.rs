//! The map and the robots and people on it, as entities in three dimensions. The colours are those
//! of pictures of maps.

use super::message::{
    Arrow, Colour, Cube, Cylinder, Line, Pose, SceneEntity, SceneEntityDeletion, SceneUpdate, Text, Time, Vector3,
    elevation_m,
};
use super::poses::{WORLD_FRAME, frame_of};
use crate::map::render::colours::{self, DOOR, INK, LANE, LIFT, WALL};
use crate::map::{Door, LevelIndex, Map, PlaceKind};
use consort_protocol::ids::{PlaceId, RobotId};

/// Thickness and height of drawn objects that have no size on the map, in metres.
const WALL_M: f64 = 0.12;
const LANE_M: f64 = 0.06;
const DOOR_M: f64 = 0.1;
const CABIN_M: f64 = 1.2;
const PERSON_M: (f64, f64) = (0.4, 1.7);
const ROBOT_HIGH_M: f64 = 0.6;
const NAME_M: f64 = 0.3;
/// Colour of an open door.
const OPEN: &str = "#43a047";
const BLOCKED: &str = "#d50000";

/// Walls, lanes, places and lifts: an entity for each kind and level.
pub(super) fn map(map: &Map, at: Time) -> SceneUpdate {
    let mut entities = vec![];
    for level in map.level_indices() {
        let (name, z) = (&map.level(level).name, elevation_m(map, level));
        let point = |(x, y): (f64, f64)| Vector3::new(x, y, z);
        let mut walls = entity(&format!("walls of {name}"), at);
        walls.lines = map.walls_on(level).map(|wall| line(0, WALL_M, wall.iter().copied().map(point), WALL)).collect();
        let mut lanes = entity(&format!("lanes of {name}"), at);
        let point_of = |place: &PlaceId| map.place(place).map(|place| point((place.pose.x, place.pose.y)));
        let ends = map.lanes_on(level).filter_map(|lane| Some([point_of(&lane.from)?, point_of(&lane.to)?])).flatten();
        lanes.lines = vec![line(2, LANE_M, ends, LANE)];
        entities.extend([walls, lanes, places(map, level, at), lifts(map, level, at)]);
    }
    let drawn = |entity: &SceneEntity| {
        entity.lines.iter().any(|line| !line.points.is_empty())
            || !entity.cubes.is_empty()
            || !entity.cylinders.is_empty()
    };
    entities.retain(drawn);
    SceneUpdate { entities, ..SceneUpdate::default() }
}

fn places(map: &Map, level: LevelIndex, at: Time) -> SceneEntity {
    let mut places = entity(&format!("places of {}", map.level(level).name), at);
    let z = elevation_m(map, level);
    for place in map.places().iter().filter(|place| place.level == level) {
        let (x, y) = (place.pose.x, place.pose.y);
        let wide = if place.kind == PlaceKind::Corridor { 0.2 } else { 0.4 };
        places.cylinders.push(cylinder(Vector3::new(x, y, z), wide, 0.02, colours::place_kind_colour(place.kind), 1.0));
        if place.kind != PlaceKind::Corridor {
            places.texts.push(text(Vector3::new(x, y, z + 0.1), place.id.as_str(), INK));
        }
    }
    places
}

fn lifts(map: &Map, level: LevelIndex, at: Time) -> SceneEntity {
    let mut lifts = entity(&format!("lifts of {}", map.level(level).name), at);
    let z = elevation_m(map, level);
    for lift in map.lifts() {
        let here = lift.stops.iter().filter_map(|stop| map.place(stop)).filter(|stop| stop.level == level);
        for stop in here {
            let (x, y) = (stop.pose.x, stop.pose.y);
            lifts.cubes.push(Cube {
                pose: Pose::upright(Vector3::new(x, y, z + 1.0)),
                size: Vector3::new(CABIN_M, CABIN_M, 2.0),
                color: Colour::of(LIFT, 0.25),
            });
            lifts.texts.push(text(Vector3::new(x, y, z + 2.2), &lift.name, LIFT));
        }
    }
    lifts
}

/// All doors.
pub(super) fn doors(map: &Map, is_open: impl Fn(&str) -> bool, at: Time) -> SceneUpdate {
    let entities = map.doors().iter().map(|door| leaf(map, door, is_open(&door.name), at)).collect();
    SceneUpdate { entities, ..SceneUpdate::default() }
}

/// A door in its current state.
pub(super) fn door(map: &Map, name: &str, open: bool, at: Time) -> SceneUpdate {
    let entities = map.door(name).map(|door| leaf(map, door, open, at)).into_iter().collect();
    SceneUpdate { entities, ..SceneUpdate::default() }
}

fn leaf(map: &Map, door: &Door, open: bool, at: Time) -> SceneEntity {
    let mut drawn = entity(&door.name, at);
    let z = elevation_m(map, door.level) + 0.05;
    let colour = if open { OPEN } else { DOOR };
    let posts = map.door_posts(door).into_iter().flat_map(|(a, b)| [a, b]).map(|(x, y)| Vector3::new(x, y, z));
    drawn.lines = vec![line(2, DOOR_M, posts, colour)];
    drawn
}

/// An obstacle, in the middle of its lane, since its exact position is not reported.
pub(super) fn obstacle(map: &Map, name: &str, (a, b): &(PlaceId, PlaceId), at: Time) -> SceneUpdate {
    let mut drawn = entity(name, at);
    if let (Some(a), Some(b)) = (map.place(a), map.place(b)) {
        let (x, y) = (f64::midpoint(a.pose.x, b.pose.x), f64::midpoint(a.pose.y, b.pose.y));
        let z = elevation_m(map, a.level);
        drawn.cubes.push(Cube {
            pose: Pose::upright(Vector3::new(x, y, z + 0.4)),
            size: Vector3::new(0.6, 0.6, 0.8),
            color: Colour::of(BLOCKED, 0.8),
        });
        drawn.texts.push(text(Vector3::new(x, y, z + 1.0), name, BLOCKED));
    }
    SceneUpdate { entities: vec![drawn], ..SceneUpdate::default() }
}

/// People at their places.
pub(super) fn people(map: &Map, people: impl Iterator<Item = (String, PlaceId)>, at: Time) -> SceneUpdate {
    let drawn = people.filter_map(|(name, place)| {
        let place = map.place(&place)?;
        let (wide, high) = PERSON_M;
        let foot = Vector3::new(place.pose.x, place.pose.y, elevation_m(map, place.level));
        let mut drawn = entity(&name, at);
        drawn.cylinders.push(cylinder(foot, wide, high, colours::ITEM, 0.6));
        drawn.texts.push(text(Vector3 { z: foot.z + high + 0.2, ..foot }, &name, colours::ITEM));
        Some(drawn)
    });
    SceneUpdate { entities: drawn.collect(), ..SceneUpdate::default() }
}

/// Robots with their radius in metres, each in its own frame, with which it moves.
pub(super) fn robots(bodies: impl Iterator<Item = (RobotId, f64)>, at: Time) -> SceneUpdate {
    let drawn = bodies.enumerate().map(|(place, (id, radius_m))| {
        let (wide, colour) = (2.0 * radius_m, colours::robot_colour(place));
        let mut drawn = SceneEntity { frame_id: frame_of(&id), frame_locked: true, ..entity(id.as_str(), at) };
        drawn.cylinders.push(cylinder(Vector3::default(), wide, ROBOT_HIGH_M, colour, 0.8));
        drawn.arrows.push(Arrow {
            pose: Pose::upright(Vector3::new(0.0, 0.0, ROBOT_HIGH_M)),
            shaft_length: 0.7 * wide,
            shaft_diameter: 0.06,
            head_length: 0.3 * wide,
            head_diameter: 0.16,
            color: Colour::of(colour, 1.0),
        });
        drawn.texts.push(text(Vector3::new(0.0, 0.0, ROBOT_HIGH_M + 0.4), id.as_str(), colour));
        drawn
    });
    SceneUpdate { entities: drawn.collect(), ..SceneUpdate::default() }
}

/// Removes entities.
pub(super) fn deletions(ids: &[&str], at: Time) -> SceneUpdate {
    // Foxglove removes only entities that are older than the deletion, so it is stamped a
    // nanosecond later.
    let timestamp = at.next();
    let deletion = |id: &&str| SceneEntityDeletion { timestamp, kind: 0, id: (*id).to_owned() };
    SceneUpdate { deletions: ids.iter().map(deletion).collect(), ..SceneUpdate::default() }
}

fn entity(id: &str, at: Time) -> SceneEntity {
    SceneEntity { timestamp: at, frame_id: WORLD_FRAME.to_owned(), id: id.to_owned(), ..SceneEntity::default() }
}

fn line(kind: u8, thickness: f64, points: impl Iterator<Item = Vector3>, colour: &str) -> Line {
    Line {
        kind,
        pose: Pose::upright(Vector3::default()),
        thickness,
        scale_invariant: false,
        points: points.collect(),
        color: Colour::of(colour, 1.0),
        colors: vec![],
        indices: vec![],
    }
}

/// A cylinder that stands at `foot`.
fn cylinder(foot: Vector3, wide: f64, high: f64, colour: &str, opaque: f64) -> Cylinder {
    Cylinder {
        pose: Pose::upright(Vector3 { z: foot.z + high / 2.0, ..foot }),
        size: Vector3::new(wide, wide, high),
        bottom_scale: 1.0,
        top_scale: 1.0,
        color: Colour::of(colour, opaque),
    }
}

fn text(at: Vector3, text: &str, colour: &str) -> Text {
    Text {
        pose: Pose::upright(at),
        billboard: true,
        font_size: NAME_M,
        scale_invariant: false,
        color: Colour::of(colour, 1.0),
        text: text.to_owned(),
    }
}
