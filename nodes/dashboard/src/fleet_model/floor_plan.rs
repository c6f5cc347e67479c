//! The floor plan of the model.

use crate::fleet_model::delta;
use crate::loaded_map::LoadedMap;
use consort_protocol::ids::PlaceId;
use consort_protocol::pose::Pose;
use consort_skills::environment::Routes;
use serde_json::Value;
use std::collections::BTreeMap;

/// A map to draw, with its routes.
#[derive(Debug, Clone, Default)]
pub struct FloorPlan {
    routes: Option<Routes>,
    places: BTreeMap<PlaceId, Pose>,
    shown: Value,
}

impl FloorPlan {
    /// Creates the plan of a map. A map with invalid lanes is drawn without routes.
    pub fn new(floor: &LoadedMap) -> FloorPlan {
        let mut shown = serde_json::to_value(floor.to_view()).expect("a view serializes to JSON");
        delta::strip_nulls(&mut shown);
        FloorPlan { routes: Routes::new(&floor.topology).ok(), places: floor.topology.places.clone(), shown }
    }

    /// Returns the map as JSON, as in `view/map`.
    pub(super) fn map_json(&self) -> &Value {
        &self.shown
    }

    /// Returns the position of a place.
    pub(super) fn pose_of(&self, name: &str) -> Option<Pose> {
        self.places.get(&PlaceId::new(name).ok()?).copied()
    }

    /// Returns the places of the route of a robot at `pose` that passed `passed` last; empty if
    /// there is none.
    pub(super) fn route(&self, passed: &str, pose: Pose, to: &str) -> Vec<PlaceId> {
        let (Some(routes), Ok(passed), Ok(to)) = (&self.routes, PlaceId::new(passed), PlaceId::new(to)) else {
            return vec![];
        };
        routes.legs(&passed, pose, &to).unwrap_or_default()
    }
}
