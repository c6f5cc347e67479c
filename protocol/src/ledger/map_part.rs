//! Parts of the map that orders of people are about: places, lanes and zones.

use crate::bounds::{self, ELEMENTS_MAX};
use crate::ids::{PlaceId, ZoneId};
use crate::mission::Domain;
use consort_text::AllowedNames;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fmt;

/// A zone, a place or a lane. Zones come first in the order of parts.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MapPart {
    /// Several places under a name.
    Zone(Zone),
    /// A place.
    Place(PlaceId),
    /// The lane between two places, in both directions. The end whose name comes first is the first.
    Lane(PlaceId, PlaceId),
}

/// A zone in an order. The order contains its places, so a node with another fleet file follows it alike.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
pub struct Zone {
    /// Its name.
    pub name: ZoneId,
    /// Its places at the time of the order.
    #[serde(deserialize_with = "bounds::collection::<_, _, ELEMENTS_MAX>")]
    pub places: BTreeSet<PlaceId>,
}

impl Zone {
    /// Maximum number of places of a zone in a fleet file. Raised: fewer closed zones fit into a notice to a robot.
    pub const PLACES_MAX: usize = 200;
}

impl MapPart {
    /// Returns the zone of this name that the domain has, otherwise the place.
    pub fn named(name: &PlaceId, domain: &Domain) -> MapPart {
        match domain.zones().get_key_value(&ZoneId::from(name.clone())) {
            Some((zone, places)) => MapPart::Zone(Zone { name: zone.clone(), places: places.clone() }),
            None => MapPart::Place(name.clone()),
        }
    }

    /// Returns the lane between two places.
    pub fn of_lane(a: PlaceId, b: PlaceId) -> MapPart {
        if a <= b { MapPart::Lane(a, b) } else { MapPart::Lane(b, a) }
    }

    /// Checks that a place or lane is on the map of the domain, if the map is known. The places of a zone are checked when
    /// the fleet file is read.
    ///
    /// # Errors
    /// The unknown name, with those that are allowed.
    pub fn check(&self, domain: &Domain) -> Result<(), String> {
        let ends = match self {
            MapPart::Zone(_) => return Ok(()),
            MapPart::Place(place) => vec![place],
            MapPart::Lane(a, b) => vec![a, b],
        };
        if let Some(places) = domain.places()
            && let Some(unknown) = ends.into_iter().find(|end| !places.contains(*end))
        {
            let mut zones =
                domain.zones().keys().map(ZoneId::as_str).filter(|_| matches!(self, MapPart::Place(_))).peekable();
            let kind = if zones.peek().is_none() { "place" } else { "place or zone" };
            let names = zones.chain(places.iter().map(PlaceId::as_str));
            return Err(format!(
                "there is no {kind} {unknown}; {}",
                AllowedNames::suggest_for(unknown.as_str(), names)
            ));
        }
        match (self, domain.lanes()) {
            (MapPart::Lane(a, b), Some(lanes)) if !lanes.contains(&(a.clone(), b.clone())) => {
                let of_place = lanes.iter().filter(|(from, to)| [from, to].contains(&a));
                let others = of_place.map(|(from, to)| if from == a { to.as_str() } else { from.as_str() });
                let others = others.collect::<Vec<_>>().join(", ");
                Err(format!("there is no lane {self}; the lanes of {a} lead to {others}"))
            }
            _ => Ok(()),
        }
    }

    /// Returns the lane by its two ends, or each of the places twice.
    pub fn pairs(&self) -> Vec<(PlaceId, PlaceId)> {
        let twice = |place: &PlaceId| (place.clone(), place.clone());
        match self {
            MapPart::Zone(zone) => zone.places.iter().map(twice).collect(),
            MapPart::Place(place) => vec![twice(place)],
            MapPart::Lane(a, b) => vec![(a.clone(), b.clone())],
        }
    }

    /// Checks whether both are the same zone, place or lane. A zone stays the same if its places change.
    pub(super) fn is_same(&self, other: &MapPart) -> bool {
        match (self, other) {
            (MapPart::Zone(zone), MapPart::Zone(other)) => zone.name == other.name,
            _ => self == other,
        }
    }
}

impl fmt::Display for MapPart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            MapPart::Zone(zone) => write!(f, "zone {}", zone.name),
            MapPart::Place(place) => write!(f, "{place}"),
            MapPart::Lane(a, b) => write!(f, "{a} – {b}"),
        }
    }
}
