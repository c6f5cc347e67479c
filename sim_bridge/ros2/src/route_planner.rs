//! Plans a drive from a place to any pose on the map: first by lanes, then in a straight line.
//!
//! The `navigate_to_pose` of the simulated world drives a single leg of a route. ROS 2 has no legs,
//! and a navigator is expected to find the route. So a pose is reached by the lanes to its place
//! or, if it is not at a place, to the nearest place without a wall in between, and from there in a
//! straight line.

use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_protocol::units::Metres;
use consort_skills::actions::{ActionError, ErrorCode, FollowWaypoints, Goal, NavigateToPose, Telemetry, Waypoint};
use consort_skills::environment::{MapError, RouteError, Routes};
use consort_world::map::Map;
use consort_world::space::WallGrid;
use nalgebra::Vector2;

/// Greatest distance of a pose from a place at which it counts as that place: Nav2's default goal
/// tolerance.
const AT_PLACE_M: f64 = 0.25;

/// A map with its routes and the walls of each level.
#[derive(Debug)]
pub struct RoutePlanner {
    map: Map,
    routes: Routes,
    /// Walls by level.
    walls: Vec<WallGrid>,
}

/// A planned route to a pose.
#[derive(Debug, Clone, PartialEq)]
pub struct PlannedRoute {
    /// The goal for the driver.
    pub goal: Goal,
    /// The last place of the route.
    last_place: PlaceId,
    /// The pose to reach from there, if it differs from the place.
    final_pose: Option<Pose>,
}

impl RoutePlanner {
    /// Prepares a map.
    ///
    /// # Errors
    /// [`MapError`] of its routes.
    pub fn new(map: Map) -> Result<RoutePlanner, MapError> {
        let routes = Routes::new(&map.topology())?;
        let walls = map.level_indices().map(|level| WallGrid::new(map.walls_on(level))).collect();
        Ok(RoutePlanner { map, routes, walls })
    }

    /// Plans a route from the reported position of a robot to a pose, without the connections that
    /// the robot reports as closed.
    ///
    /// # Errors
    /// [`ErrorCode::NoRoute`] if no route leads there, [`ErrorCode::Blocked`] if all routes are
    /// closed, [`ErrorCode::Unknown`] if the robot is not on this map.
    pub fn plan(&self, from: &Telemetry, to: Pose) -> Result<PlannedRoute, ActionError> {
        let (last_place, final_pose) = self.last_place_for(&from.place, to)?;
        let routes = self.routes.without_closed(&from.closed);
        let mut legs = routes.legs(&from.place, from.pose, &last_place).map_err(route_error)?;
        if legs.is_empty() {
            legs.push(last_place.clone()); // the robot may be next to the place, or have another heading
        }
        let pose = |place: &PlaceId| self.routes.pose(place).expect("a leg ends at a place of the map");
        let mut waypoints: Vec<Waypoint> =
            legs.into_iter().map(|place| Waypoint { pose: pose(&place), place: Some(place) }).collect();
        match final_pose {
            Some(final_pose) => waypoints.push(Waypoint { pose: final_pose, place: None }),
            None => waypoints.last_mut().expect("there is a leg").pose.yaw = to.yaw,
        }
        let goal = match waypoints.as_slice() {
            [Waypoint { pose, place }] => Goal::from(NavigateToPose::to(*pose, place.clone())),
            _ => Goal::from(FollowWaypoints { waypoints }),
        };
        Ok(PlannedRoute { goal, last_place, final_pose })
    }

    /// Returns the remaining distance of a robot on that route.
    pub fn distance_remaining(&self, route: &PlannedRoute, at: &Telemetry) -> Metres {
        let final_pose = route.final_pose.zip(self.routes.pose(&route.last_place));
        let last = final_pose.map_or(Metres::ZERO, |(final_pose, last_place)| last_place.distance(final_pose));
        match final_pose {
            Some((final_pose, last_place))
                if at.place == route.last_place && last_place.distance(at.pose).get() > AT_PLACE_M =>
            {
                // On the last segment, or on its way back from another: either way it is a straight
                // line.
                at.pose.distance(final_pose)
            }
            _ => match self.routes.distance_left(&at.place, at.pose, &route.last_place) {
                Ok(left) => left + last,
                Err(_) => at.pose.distance(final_pose.map_or(at.pose, |(final_pose, _)| final_pose)),
            },
        }
    }

    /// Returns the place to drive to for a pose, and the pose if it differs from that place.
    fn last_place_for(&self, near: &PlaceId, to: Pose) -> Result<(PlaceId, Option<Pose>), ActionError> {
        let Some(level) = self.map.level_of(near) else {
            let message = format!("the robot is at {near}, which is not on the map {:?}", self.map.name());
            return Err(ActionError::new(ErrorCode::Unknown, message));
        };
        let here = self.map.level_indices().position(|index| index == level).expect("the level is on the map");
        let on_level = self.map.places().iter().filter(|place| place.level == level);
        let mut places: Vec<_> = on_level.map(|place| (place.pose.distance(to).get(), place)).collect();
        places.sort_by(|(a, first), (b, second)| a.total_cmp(b).then_with(|| first.id.cmp(&second.id)));
        if let Some((_, place)) = places.first().filter(|(distance, _)| *distance <= AT_PLACE_M) {
            return Ok((place.id.clone(), None));
        }
        let ((west, south), (east, north)) = self.map.bounds();
        let within = (west..=east).contains(&to.x) && (south..=north).contains(&to.y);
        let is_clear_from =
            |place: Pose| self.walls[here].is_clear(Vector2::new(place.x, place.y), Vector2::new(to.x, to.y));
        match places.iter().find(|(_, place)| within && is_clear_from(place.pose)) {
            Some((_, place)) => Ok((place.id.clone(), Some(to))),
            None => {
                let reason = if within { "walls separate it from every place" } else { "it is outside the map" };
                let message =
                    format!("no route to ({:.2}, {:.2}) on the map {:?}: {reason}", to.x, to.y, self.map.name());
                Err(ActionError::new(ErrorCode::NoRoute, message))
            }
        }
    }
}

fn route_error(error: RouteError) -> ActionError {
    let code = match error {
        RouteError::Closed { .. } => ErrorCode::Blocked,
        RouteError::UnknownPlace { .. } => ErrorCode::Unknown,
        RouteError::Unreachable { .. } => ErrorCode::NoRoute,
    };
    ActionError::new(code, error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::units::{BatteryShare, WorldTime};
    use std::collections::BTreeMap;

    /// Returns a planner for this map: A and B 10 m apart in a corridor, C behind a wall north of
    /// B, with a gap in it next to B; a closet without a door.
    fn planner() -> RoutePlanner {
        let text = "{name: flat, walls: [[[-1, 2], [9, 2]], [[11, 2], [12, 2]], [[-1, 3], [1, 3], [1, 5], [-1, 5], [-1, 3]]], \
            places: [{name: A, kind: other, x_m: 0, y_m: 0}, {name: B, kind: other, x_m: 10, y_m: 0}, \
            {name: C, kind: other, x_m: 10, y_m: 5}], lanes: [{between: [A, B]}, {between: [B, C]}]}";
        RoutePlanner::new(consort_world::map::read(text, "flat.yaml").unwrap()).unwrap()
    }

    fn at(place: &str, x: f64, y: f64) -> Telemetry {
        Telemetry {
            time: WorldTime::ZERO,
            pose: Pose::new(x, y, 0.0),
            place: PlaceId::new(place).unwrap(),
            battery: BatteryShare::FULL,
            able: true,
            closed: vec![],
            readings: BTreeMap::new(),
        }
    }

    fn describe_waypoints(goal: &Goal) -> Vec<String> {
        let way = |pose: &Pose, place: &Option<PlaceId>| {
            let name = place.as_ref().map_or("floor".to_owned(), PlaceId::to_string);
            format!("{name} {} {} {}", pose.x, pose.y, pose.yaw)
        };
        if let Some(Ok(NavigateToPose { pose, place, .. })) = goal.read() {
            return vec![way(&pose, &place)];
        }
        let FollowWaypoints { waypoints } = goal.read().unwrap().unwrap();
        waypoints.iter().map(|to| way(&to.pose, &to.place)).collect()
    }

    #[test]
    fn a_place_is_reached_by_lanes_with_the_requested_heading() {
        let planned = planner().plan(&at("A", 0.0, 0.0), Pose::new(10.1, 5.1, 1.5)).unwrap();
        assert_eq!(describe_waypoints(&planned.goal), ["B 10 0 0", "C 10 5 1.5"]);
        assert_eq!(planner().distance_remaining(&planned, &at("A", 4.0, 0.0)).get(), 11.0);
    }

    #[test]
    fn a_single_leg_or_a_turn_on_the_spot_is_a_single_goal() {
        let planned = planner().plan(&at("A", 0.0, 0.0), Pose::new(10.0, 0.0, 0.5)).unwrap();
        assert_eq!(planned.goal, Goal::from(NavigateToPose::to(Pose::new(10.0, 0.0, 0.5), Some("B".parse().unwrap()))));
        let turned = planner().plan(&at("B", 10.0, 0.0), Pose::new(10.0, 0.0, 3.0)).unwrap();
        assert_eq!(describe_waypoints(&turned.goal), ["B 10 0 3"]);
    }

    #[test]
    fn other_poses_are_reached_from_the_nearest_visible_place() {
        let planner = planner();
        // B is nearer to (8, 2.3), but the wall is in between.
        let planned = planner.plan(&at("A", 0.0, 0.0), Pose::new(8.0, 2.3, 1.0)).unwrap();
        assert_eq!(describe_waypoints(&planned.goal), ["B 10 0 0", "C 10 5 0", "floor 8 2.3 1"]);
        let straight = 2.0_f64.hypot(2.7);
        assert!((planner.distance_remaining(&planned, &at("A", 0.0, 0.0)).get() - 15.0 - straight).abs() < 1e-9);
        assert!((planner.distance_remaining(&planned, &at("C", 9.0, 3.65)).get() - straight / 2.0).abs() < 1e-9);
        assert!(planner.distance_remaining(&planned, &at("C", 8.0, 2.3)).get() < 1e-9);
    }

    #[test]
    fn an_unreachable_pose_is_rejected_with_the_reason() {
        let refused = |x, y| planner().plan(&at("A", 0.0, 0.0), Pose::new(x, y, 0.0)).unwrap_err();
        let outside = refused(50.0, 0.0);
        let expected = "no route: no route to (50.00, 0.00) on the map \"flat\": it is outside the map";
        assert_eq!((outside.code, outside.to_string().as_str()), (ErrorCode::NoRoute, expected));
        let closet = refused(0.0, 4.0);
        let expected = "no route: no route to (0.00, 4.00) on the map \"flat\": walls separate it from every place";
        assert_eq!((closet.code, closet.to_string().as_str()), (ErrorCode::NoRoute, expected));
        let closed = Telemetry { closed: vec![("A".parse().unwrap(), "B".parse().unwrap())], ..at("A", 0.0, 0.0) };
        assert_eq!(planner().plan(&closed, Pose::new(10.0, 0.0, 0.0)).unwrap_err().code, ErrorCode::Blocked);
        let lost = planner().plan(&at("Z", 0.0, 0.0), Pose::new(10.0, 0.0, 0.0)).unwrap_err();
        assert_eq!(lost.to_string(), "unknown: the robot is at Z, which is not on the map \"flat\"");
    }
}
