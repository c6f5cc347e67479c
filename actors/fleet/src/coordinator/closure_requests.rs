//! Requests of people that close places and lanes, and open them.

use super::api::{ApiError, ApiHandler};
use consort_protocol::api::{CLOSE_S_MAX, CloseRequest, ClosuresReply, OpenRequest, parse_request};
use consort_protocol::ids::{PlaceId, RequestId};
use consort_protocol::keys::ApiCall;
use consort_protocol::ledger::{ClosedPart, ClosureChange, Command};
use consort_protocol::mission::Domain;
use consort_text::AllowedNames;
use std::collections::BTreeSet;

impl ApiHandler {
    /// Closes places and lanes.
    pub(super) async fn close(&self, payload: &[u8]) -> Result<ClosuresReply, ApiError> {
        let CloseRequest { places, lanes, for_s, until, reason, by, request } = parse_request(ApiCall::Close, payload)?;
        let parts = parts(places, lanes)?;
        parts.iter().try_for_each(|part| check(part, &self.domain))?;
        let until_ms = match (for_s, until) {
            (Some(_), Some(_)) => return Err("give `for_s` or `until`, not both".to_owned().into()),
            (Some(seconds), None) if !(1..=CLOSE_S_MAX).contains(&seconds) => {
                return Err(format!("for_s is {seconds}; allowed are 1 to {CLOSE_S_MAX}").into());
            }
            (Some(seconds), None) => Some(self.time_ms()?.saturating_add(u64::from(seconds) * 1000)),
            (None, until) => self.end_ms(until)?,
        };
        self.change_closures(parts, ClosureChange::Close { until_ms, reason }, by, request).await
    }

    /// Opens closed places and lanes.
    pub(super) async fn open(&self, payload: &[u8]) -> Result<ClosuresReply, ApiError> {
        let OpenRequest { places, lanes, by, request } = parse_request(ApiCall::Open, payload)?;
        let parts = parts(places, lanes)?;
        // A closed place may be missing on the present map.
        let closed: BTreeSet<ClosedPart> =
            self.replica.read(|ledger| ledger.closures().map(|closure| closure.part).collect());
        parts.difference(&closed).try_for_each(|part| check(part, &self.domain))?;
        self.change_closures(parts, ClosureChange::Open, by, request).await
    }

    /// Commits a change of closures, and returns those in force.
    async fn change_closures(
        &self,
        parts: BTreeSet<ClosedPart>,
        change: ClosureChange,
        by: Option<String>,
        request: Option<RequestId>,
    ) -> Result<ClosuresReply, ApiError> {
        let order = self.order_request(change, by, request)?;
        self.commit_order(Command::ChangeClosures { parts, order }).await?;
        Ok(ClosuresReply { closures: self.replica.read(|ledger| ledger.closures().collect()) })
    }
}

/// Returns the places and lanes of a request.
fn parts(places: BTreeSet<PlaceId>, lanes: Vec<(PlaceId, PlaceId)>) -> Result<BTreeSet<ClosedPart>, String> {
    if let Some((place, _)) = lanes.iter().find(|(a, b)| a == b) {
        return Err(format!("a lane from {place} to {place} is given; a lane has two ends"));
    }
    let places = places.into_iter().map(ClosedPart::of_place);
    let lanes = lanes.into_iter().map(|(a, b)| ClosedPart::of_lane(a, b));
    let parts: BTreeSet<ClosedPart> = places.chain(lanes).collect();
    if parts.is_empty() { Err("name a place in `places`, or a lane in `lanes`".to_owned()) } else { Ok(parts) }
}

/// Checks that a place or lane is on the map of the fleet, if the map is known.
fn check(part: &ClosedPart, domain: &Domain) -> Result<(), String> {
    let mut ends = [Some(&part.place), part.to.as_ref()].into_iter().flatten();
    if let Some(places) = domain.places()
        && let Some(unknown) = ends.find(|end| !places.contains(*end))
    {
        return Err(format!("there is no place {unknown}; {}", AllowedNames::suggest_for(unknown.as_str(), places)));
    }
    match (&part.to, domain.lanes()) {
        (Some(_), Some(lanes)) if !lanes.contains(&part.ends()) => {
            let of_place = lanes.iter().filter(|(a, b)| [a, b].contains(&&part.place));
            let others = of_place.map(|(a, b)| if *a == part.place { b.as_str() } else { a.as_str() });
            let others = others.collect::<Vec<_>>().join(", ");
            Err(format!("there is no lane {part}; the lanes of {} lead to {others}", part.place))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(name: &str) -> PlaceId {
        name.parse().unwrap()
    }

    fn names(names: &[&str]) -> BTreeSet<PlaceId> {
        names.iter().map(|name| place(name)).collect()
    }

    /// Checks the parts of a request on a map W – M – E.
    fn checked(places: &[&str], lanes: &[(&str, &str)]) -> Result<Vec<String>, String> {
        let domain = Domain::default()
            .with_places(names(&["W", "Main", "E"]))
            .with_lanes([(place("W"), place("Main")), (place("Main"), place("E"))]);
        let parts = parts(names(places), lanes.iter().map(|(a, b)| (place(a), place(b))).collect())?;
        parts.iter().try_for_each(|part| check(part, &domain))?;
        Ok(parts.iter().map(ClosedPart::to_string).collect())
    }

    #[test]
    fn places_and_lanes_of_the_map_are_accepted() {
        let parts = checked(&["W"], &[("W", "Main"), ("Main", "W"), ("E", "Main")]);
        assert_eq!(parts, Ok(["E – Main", "Main – W", "W"].map(str::to_owned).into()));
        assert_eq!(check(&ClosedPart::of_place(place("X")), &Domain::default()), Ok(()), "the map is unknown");
    }

    #[test]
    fn unknown_names_are_rejected_with_suggestions() {
        let unknown = "there is no place Mainn; allowed: E, Main, W; did you mean `Main`?";
        assert_eq!(checked(&["Mainn"], &[]).unwrap_err(), unknown);
        assert_eq!(checked(&[], &[("W", "Mainn")]).unwrap_err(), unknown);
        assert_eq!(checked(&[], &[("W", "E")]).unwrap_err(), "there is no lane E – W; the lanes of E lead to Main");
        assert_eq!(checked(&[], &[("W", "W")]).unwrap_err(), "a lane from W to W is given; a lane has two ends");
        assert_eq!(checked(&[], &[]).unwrap_err(), "name a place in `places`, or a lane in `lanes`");
    }
}
