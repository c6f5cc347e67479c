//! The zones, places and lanes of a request.

use consort_protocol::ids::PlaceId;
use consort_protocol::ledger::MapPart;
use consort_protocol::mission::Domain;
use std::collections::BTreeSet;

/// Returns the zones, places and lanes of a request. `names` are those of places and zones. Those under an order already
/// (`known`) may be missing on the present map, and in the present fleet file.
///
/// # Errors
/// A description of what is missing or unknown.
pub(super) fn map_parts(
    names: BTreeSet<PlaceId>,
    lanes: Vec<(PlaceId, PlaceId)>,
    domain: &Domain,
    known: &BTreeSet<MapPart>,
) -> Result<BTreeSet<MapPart>, String> {
    if let Some((place, _)) = lanes.iter().find(|(a, b)| a == b) {
        return Err(format!("a lane from {place} to {place} is given; a lane has two ends"));
    }
    let named = names.into_iter().map(|name| part_named(&name, domain, known));
    let parts: BTreeSet<MapPart> = named.chain(lanes.into_iter().map(|(a, b)| MapPart::of_lane(a, b))).collect();
    if parts.is_empty() {
        return Err("name a place or a zone in `places`, or a lane in `lanes`".to_owned());
    }
    parts.difference(known).try_for_each(|part| part.check(domain))?;
    Ok(parts)
}

/// Returns the zone or place of this name. A zone that the fleet file does not declare is that of its order.
fn part_named(name: &PlaceId, domain: &Domain, known: &BTreeSet<MapPart>) -> MapPart {
    let part = MapPart::named(name, domain);
    let is_zone = |known: &&MapPart| matches!(known, MapPart::Zone(zone) if zone.name.as_str() == name.as_str());
    let of_order = known.iter().find(is_zone).filter(|_| matches!(part, MapPart::Place(_)));
    of_order.cloned().unwrap_or(part)
}

#[cfg(test)]
mod tests {
    use super::*;
    use consort_protocol::ledger::Zone;
    use std::collections::BTreeMap;

    fn place(name: &str) -> PlaceId {
        name.parse().unwrap()
    }

    fn names(names: &[&str]) -> BTreeSet<PlaceId> {
        names.iter().map(|name| place(name)).collect()
    }

    fn zone(name: &str, places: &[&str]) -> MapPart {
        MapPart::Zone(Zone { name: name.parse().unwrap(), places: names(places) })
    }

    /// Returns a map W – Main – E.
    fn domain() -> Domain {
        let lanes = [(place("W"), place("Main")), (place("Main"), place("E"))];
        Domain::default().with_places(names(&["W", "Main", "E"])).with_lanes(lanes)
    }

    fn domain_with_zone() -> Domain {
        domain().with_zones(BTreeMap::from([("ends".parse().unwrap(), names(&["W", "E"]))]))
    }

    /// Checks the parts of a request.
    fn checked(places: &[&str], lanes: &[(&str, &str)]) -> Result<Vec<String>, String> {
        let lanes = lanes.iter().map(|(a, b)| (place(a), place(b))).collect();
        let parts = map_parts(names(places), lanes, &domain(), &BTreeSet::new())?;
        Ok(parts.iter().map(MapPart::to_string).collect())
    }

    #[test]
    fn places_and_lanes_of_the_map_are_accepted() {
        let parts = checked(&["W"], &[("W", "Main"), ("Main", "W"), ("E", "Main")]);
        assert_eq!(parts, Ok(["W", "E – Main", "Main – W"].map(str::to_owned).into()));
        assert_eq!(MapPart::Place(place("X")).check(&Domain::default()), Ok(()), "the map is unknown");
    }

    #[test]
    fn a_zone_is_resolved_to_its_places() {
        let parts = map_parts(names(&["Main", "ends"]), vec![], &domain_with_zone(), &BTreeSet::new());
        assert_eq!(parts, Ok(BTreeSet::from([zone("ends", &["W", "E"]), MapPart::Place(place("Main"))])));
    }

    #[test]
    fn parts_under_an_order_may_be_unknown_now() {
        let known = BTreeSet::from([zone("icu", &["Main"]), MapPart::Place(place("X"))]);
        assert_eq!(map_parts(names(&["icu", "X"]), vec![], &domain(), &known), Ok(known.clone()));
        assert!(map_parts(names(&["icu"]), vec![], &domain(), &BTreeSet::new()).is_err());
    }

    #[test]
    fn unknown_names_are_rejected_with_suggestions() {
        let unknown = "there is no place Mainn; allowed: E, Main, W; did you mean `Main`?";
        assert_eq!(checked(&["Mainn"], &[]).unwrap_err(), unknown);
        assert_eq!(checked(&[], &[("W", "Mainn")]).unwrap_err(), unknown);
        assert_eq!(checked(&[], &[("W", "E")]).unwrap_err(), "there is no lane E – W; the lanes of E lead to Main");
        assert_eq!(checked(&[], &[("W", "W")]).unwrap_err(), "a lane from W to W is given; a lane has two ends");
        assert_eq!(checked(&[], &[]).unwrap_err(), "name a place or a zone in `places`, or a lane in `lanes`");
        let unknown = map_parts(names(&["endz"]), vec![], &domain_with_zone(), &BTreeSet::new());
        let expected = "there is no place or zone endz; allowed: ends, E, Main, W; did you mean `ends`?";
        assert_eq!(unknown.unwrap_err(), expected);
    }
}
