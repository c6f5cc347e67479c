//! From a pose anywhere on the floor to a drive that the simulated world knows: lanes first, then a straight line.
//!
//! The world's own `navigate_to_pose` drives one leg of a route. ROS 2 knows nothing of legs, and expects of a navigator that
//! it finds the way. So a pose is reached by the lanes to the place it stands for or, if it stands for none, to the nearest
//! place from which no wall hides it, and from there in a straight line.

use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_protocol::units::Metres;
use consort_sim::map::Map;
use consort_sim::space::Walls;
use consort_skills::actions::{ActionError, ErrorCode, Goal, Telemetry, Waypoint};
use consort_skills::environment::{MapError, RouteError, Routes};
use nalgebra::Vector2;

/// A pose this close to a place is that place: Nav2's default goal tolerance.
const AT_PLACE_M: f64 = 0.25;

/// A map with the routes over it and the walls on each of its levels.
#[derive(Debug)]
pub struct Atlas {
    map: Map,
    routes: Routes,
    /// By level.
    walls: Vec<Walls>,
}

/// A way to a pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Itinerary {
    /// What the body is asked.
    pub goal: Goal,
    /// The last place on the way.
    stop: PlaceId,
    /// The pose to reach from there, if it is not the place itself.
    beyond: Option<Pose>,
}

impl Atlas {
    /// Prepares a map.
    ///
    /// # Errors
    /// [`MapError`] of its routes.
    pub fn new(map: Map) -> Result<Atlas, MapError> {
        let routes = Routes::new(&map.topology())?;
        let walls = map.level_indices().map(|level| Walls::new(map.walls_on(level))).collect();
        Ok(Atlas { map, routes, walls })
    }

    /// The way from where a body says it is to a pose, round what it knows to be closed.
    ///
    /// # Errors
    /// [`ErrorCode::NoRoute`] if nothing leads there, [`ErrorCode::Blocked`] if all that does is closed,
    /// [`ErrorCode::Unknown`] if the body is on another map.
    pub fn plan(&self, from: &Telemetry, to: Pose) -> Result<Itinerary, ActionError> {
        let (stop, beyond) = self.stop_for(&from.place, to)?;
        let routes = self.routes.without(&from.closed);
        let mut legs = routes.legs(&from.place, from.pose, &stop).map_err(no_way)?;
        if legs.is_empty() {
            legs.push(stop.clone()); // it may stand beside it, or face elsewhere
        }
        let pose = |place: &PlaceId| self.routes.pose(place).expect("a leg ends on the map");
        let mut waypoints: Vec<Waypoint> =
            legs.into_iter().map(|place| Waypoint { pose: pose(&place), place: Some(place) }).collect();
        match beyond {
            Some(beyond) => waypoints.push(Waypoint { pose: beyond, place: None }),
            None => waypoints.last_mut().expect("there is a leg").pose.yaw = to.yaw,
        }
        let goal = match waypoints.as_slice() {
            [Waypoint { pose, place }] => Goal::NavigateToPose { pose: *pose, place: place.clone() },
            _ => Goal::FollowWaypoints { waypoints },
        };
        Ok(Itinerary { goal, stop, beyond })
    }

    /// How far it still is for a body on that way.
    pub fn distance_remaining(&self, itinerary: &Itinerary, at: &Telemetry) -> Metres {
        let beyond = itinerary.beyond.zip(self.routes.pose(&itinerary.stop));
        let last = beyond.map_or(Metres::ZERO, |(beyond, stop)| stop.distance(beyond));
        match beyond {
            Some((beyond, stop)) if at.place == itinerary.stop && stop.distance(at.pose).get() > AT_PLACE_M => {
                // On the last stretch, or on its way back from another: either way it is a straight line.
                at.pose.distance(beyond)
            }
            _ => match self.routes.distance_left(&at.place, at.pose, &itinerary.stop) {
                Ok(left) => left + last,
                Err(_) => at.pose.distance(beyond.map_or(at.pose, |(beyond, _)| beyond)),
            },
        }
    }

    /// The place to drive to for a pose, and the pose if it is not that place.
    fn stop_for(&self, near: &PlaceId, to: Pose) -> Result<(PlaceId, Option<Pose>), ActionError> {
        let Some(level) = self.map.level_of(near) else {
            let message = format!("the robot is at {near}, which is not on the map {:?}", self.map.name());
            return Err(ActionError { code: ErrorCode::Unknown, message });
        };
        let here = self.map.level_indices().position(|index| index == level).expect("it is one of the levels");
        let on_level = self.map.places().iter().filter(|place| place.level == level);
        let mut places: Vec<_> = on_level.map(|place| (place.pose.distance(to).get(), place)).collect();
        places.sort_by(|(a, first), (b, second)| a.total_cmp(b).then_with(|| first.id.cmp(&second.id)));
        if let Some((_, place)) = places.first().filter(|(distance, _)| *distance <= AT_PLACE_M) {
            return Ok((place.id.clone(), None));
        }
        let ((west, south), (east, north)) = self.map.bounds();
        let within = (west..=east).contains(&to.x) && (south..=north).contains(&to.y);
        let sees = |place: Pose| self.walls[here].is_clear(Vector2::new(place.x, place.y), Vector2::new(to.x, to.y));
        match places.iter().find(|(_, place)| within && sees(place.pose)) {
            Some((_, place)) => Ok((place.id.clone(), Some(to))),
            None => {
                let why = if within { "walls hide it from every place" } else { "it lies outside" };
                let message = format!("no way to ({:.2}, {:.2}) on the map {:?}: {why}", to.x, to.y, self.map.name());
                Err(ActionError { code: ErrorCode::NoRoute, message })
            }
        }
    }
}

fn no_way(error: RouteError) -> ActionError {
    let code = match error {
        RouteError::Closed { .. } => ErrorCode::Blocked,
        RouteError::Unknown { .. } => ErrorCode::Unknown,
        RouteError::Unreachable { .. } => ErrorCode::NoRoute,
    };
    ActionError { code, message: error.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::units::{BatteryShare, WorldTime};

    /// A and B 10 m apart in a corridor, C behind a wall north of B, with a gap in it beside B; a closet without a door.
    fn atlas() -> Atlas {
        let text = "{name: flat, walls: [[[-1, 2], [9, 2]], [[11, 2], [12, 2]], [[-1, 3], [1, 3], [1, 5], [-1, 5], [-1, 3]]], \
            places: [{name: A, kind: other, x_m: 0, y_m: 0}, {name: B, kind: other, x_m: 10, y_m: 0}, \
            {name: C, kind: other, x_m: 10, y_m: 5}], lanes: [{between: [A, B]}, {between: [B, C]}]}";
        Atlas::new(consort_sim::map::read(text, "flat.yaml").unwrap()).unwrap()
    }

    fn at(place: &str, x: f64, y: f64) -> Telemetry {
        Telemetry {
            time: WorldTime::ZERO,
            pose: Pose::new(x, y, 0.0),
            place: PlaceId::new(place).unwrap(),
            battery: BatteryShare::FULL,
            able: true,
            closed: vec![],
        }
    }

    fn ways(goal: &Goal) -> Vec<String> {
        let way = |pose: &Pose, place: &Option<PlaceId>| {
            let name = place.as_ref().map_or("floor".to_owned(), PlaceId::to_string);
            format!("{name} {} {} {}", pose.x, pose.y, pose.yaw)
        };
        match goal {
            Goal::NavigateToPose { pose, place } => vec![way(pose, place)],
            Goal::FollowWaypoints { waypoints } => waypoints.iter().map(|to| way(&to.pose, &to.place)).collect(),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_place_is_reached_by_its_lanes_and_faced_as_asked() {
        let planned = atlas().plan(&at("A", 0.0, 0.0), Pose::new(10.1, 5.1, 1.5)).unwrap();
        assert_eq!(ways(&planned.goal), ["B 10 0 0", "C 10 5 1.5"]);
        assert_eq!(atlas().distance_remaining(&planned, &at("A", 4.0, 0.0)).get(), 11.0);
    }

    #[test]
    fn one_leg_is_one_goal_and_so_is_a_turn_on_the_spot() {
        let planned = atlas().plan(&at("A", 0.0, 0.0), Pose::new(10.0, 0.0, 0.5)).unwrap();
        assert_eq!(
            planned.goal,
            Goal::NavigateToPose { pose: Pose::new(10.0, 0.0, 0.5), place: Some("B".parse().unwrap()) }
        );
        let turned = atlas().plan(&at("B", 10.0, 0.0), Pose::new(10.0, 0.0, 3.0)).unwrap();
        assert_eq!(ways(&turned.goal), ["B 10 0 3"]);
    }

    #[test]
    fn elsewhere_on_the_floor_is_reached_from_the_nearest_place_that_sees_it() {
        let atlas = atlas();
        // B is nearer to (8, 2.3), and the wall is between.
        let planned = atlas.plan(&at("A", 0.0, 0.0), Pose::new(8.0, 2.3, 1.0)).unwrap();
        assert_eq!(ways(&planned.goal), ["B 10 0 0", "C 10 5 0", "floor 8 2.3 1"]);
        let straight = 2.0_f64.hypot(2.7);
        assert!((atlas.distance_remaining(&planned, &at("A", 0.0, 0.0)).get() - 15.0 - straight).abs() < 1e-9);
        assert!((atlas.distance_remaining(&planned, &at("C", 9.0, 3.65)).get() - straight / 2.0).abs() < 1e-9);
        assert!(atlas.distance_remaining(&planned, &at("C", 8.0, 2.3)).get() < 1e-9);
    }

    #[test]
    fn where_nothing_leads_is_refused_with_the_reason() {
        let refused = |x, y| atlas().plan(&at("A", 0.0, 0.0), Pose::new(x, y, 0.0)).unwrap_err();
        let outside = refused(50.0, 0.0);
        let expected = "no route: no way to (50.00, 0.00) on the map \"flat\": it lies outside";
        assert_eq!((outside.code, outside.to_string().as_str()), (ErrorCode::NoRoute, expected));
        let closet = refused(0.0, 4.0);
        let expected = "no route: no way to (0.00, 4.00) on the map \"flat\": walls hide it from every place";
        assert_eq!((closet.code, closet.to_string().as_str()), (ErrorCode::NoRoute, expected));
        let closed = Telemetry { closed: vec![("A".parse().unwrap(), "B".parse().unwrap())], ..at("A", 0.0, 0.0) };
        assert_eq!(atlas().plan(&closed, Pose::new(10.0, 0.0, 0.0)).unwrap_err().code, ErrorCode::Blocked);
        let lost = atlas().plan(&at("Z", 0.0, 0.0), Pose::new(10.0, 0.0, 0.0)).unwrap_err();
        assert_eq!(lost.to_string(), "unknown: the robot is at Z, which is not on the map \"flat\"");
    }
}
