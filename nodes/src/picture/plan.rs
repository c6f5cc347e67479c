//! The floor that a picture is drawn on.

use crate::floor::Floor;
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_sim::map::Map;
use consort_skills::environment::Routes;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// A map to draw, with the ways on it.
#[derive(Debug, Clone, Default)]
pub struct FloorPlan {
    routes: Option<Routes>,
    places: BTreeMap<PlaceId, Pose>,
    drawn: Value,
}

impl FloorPlan {
    /// The plan of a map. One whose ways make no sense is drawn without routes.
    pub fn new(floor: &Floor) -> FloorPlan {
        let (topology, map) = (&floor.topology, floor.map.as_ref());
        let level = |place: &PlaceId| map.and_then(|map| map.level_of(place)).map_or(0, |level| position(map, level));
        let kind = |place: &PlaceId| map.and_then(|map| map.place(place)).map_or("other", |place| place.kind.as_str());
        let places: BTreeMap<String, Value> = topology
            .places
            .iter()
            .map(|(id, pose)| {
                (id.to_string(), json!({ "x": pose.x, "y": pose.y, "kind": kind(id), "level": level(id) }))
            })
            .collect();
        let end = |place: &PlaceId| topology.places.get(place).map(|pose| (pose.x, pose.y));
        let lanes =
            topology.edges.iter().filter_map(|edge| Some(json!([end(&edge.a)?, end(&edge.b)?, level(&edge.a)])));
        let mut drawn = json!({ "places": places, "lanes": lanes.collect::<Vec<_>>(), "levels": ["ground"], "walls": [], "doors": {} });
        if let Some(map) = map {
            let walls = map.level_indices().map(|level| map.walls_on(level).collect::<Vec<_>>());
            drawn["walls"] = json!(walls.collect::<Vec<_>>());
            drawn["levels"] = json!(map.levels().iter().map(|level| &level.name).collect::<Vec<_>>());
            drawn["doors"] = json!(doors(map, &end, &level));
            drawn["name"] = json!(map.name());
            drawn["bounds"] = json!(map.bounds());
        } else {
            let all = || topology.places.values();
            let (xs, ys) = (|pose: &Pose| pose.x, |pose: &Pose| pose.y);
            let least = |of: fn(&Pose) -> f64| all().map(of).fold(f64::INFINITY, f64::min);
            let most = |of: fn(&Pose) -> f64| all().map(of).fold(f64::NEG_INFINITY, f64::max);
            drawn["bounds"] = json!(((least(xs), least(ys)), (most(xs), most(ys))));
        }
        FloorPlan { routes: Routes::new(topology).ok(), places: topology.places.clone(), drawn }
    }

    /// What is drawn: places, lanes, levels, walls by level, doors.
    pub(super) fn value(&self) -> &Value {
        &self.drawn
    }

    /// Where a place is.
    pub(super) fn place(&self, name: &str) -> Option<Pose> {
        self.places.get(&PlaceId::new(name).ok()?).copied()
    }

    /// The way of a body that stands at `pose` and passed `passed` last, as points; empty if there is none.
    pub(super) fn route(&self, passed: &str, pose: Pose, to: &str) -> Vec<(f64, f64)> {
        let (Some(routes), Ok(passed), Ok(to)) = (&self.routes, PlaceId::new(passed), PlaceId::new(to)) else {
            return vec![];
        };
        let legs = routes.legs(&passed, pose, &to).unwrap_or_default();
        legs.iter().filter_map(|place| self.places.get(place)).map(|pose| (pose.x, pose.y)).collect()
    }
}

fn position(map: Option<&Map>, level: consort_sim::map::LevelIndex) -> usize {
    map.and_then(|map| map.level_indices().position(|index| index == level)).unwrap_or(0)
}

/// Each door with its two posts: those of the map, or a metre across the middle of its lane.
fn doors(
    map: &Map,
    end: &impl Fn(&PlaceId) -> Option<(f64, f64)>,
    level: &impl Fn(&PlaceId) -> usize,
) -> BTreeMap<String, Value> {
    let drawn = map.doors().iter().filter_map(|door| {
        let (from, to) = door.lanes.first()?;
        let posts = match door.span {
            Some(span) => span,
            None => {
                let ((x0, y0), (x1, y1)) = (end(from)?, end(to)?);
                let (middle, length) = (((x0 + x1) / 2.0, (y0 + y1) / 2.0), (x1 - x0).hypot(y1 - y0).max(0.001));
                let across = ((y0 - y1) / length * 0.5, (x1 - x0) / length * 0.5);
                ((middle.0 - across.0, middle.1 - across.1), (middle.0 + across.0, middle.1 + across.1))
            }
        };
        Some((door.name.clone(), json!({ "posts": posts, "level": level(from) })))
    });
    drawn.collect()
}
