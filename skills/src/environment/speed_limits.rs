//! Speed limits that people have set on parts of the map.

use consort_protocol::ids::PlaceId;
use consort_protocol::units::MetresPerSecond;

/// Speed limits on lanes, each with its two ends. A place twice stands for every lane from and to it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SpeedLimits(Vec<((PlaceId, PlaceId), MetresPerSecond)>);

impl SpeedLimits {
    /// Checks whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns the limited lanes by their ends, and each limited place twice.
    pub(super) fn lanes(&self) -> impl Iterator<Item = &(PlaceId, PlaceId)> {
        self.0.iter().map(|(lane, _)| lane)
    }

    /// Returns the lowest limit for a robot that has passed `from`, on its way to the neighbour `to`. The lane on which a
    /// robot returns to the place that it has passed is unknown: the limits of all lanes to it count.
    pub fn on(&self, from: &PlaceId, to: &PlaceId) -> Option<MetresPerSecond> {
        let is_end = |place: &PlaceId| place == from || place == to;
        let applies = |(a, b): &(PlaceId, PlaceId)| match from == to {
            true => is_end(a) || is_end(b),
            false => is_end(a) && is_end(b),
        };
        let limits = self.0.iter().filter(|(lane, _)| applies(lane)).map(|(_, limit)| *limit);
        limits.min_by(|one, other| one.get().total_cmp(&other.get()))
    }

    /// Returns the speed of a robot of this speed, on its way as for [`on`](SpeedLimits::on).
    pub fn slowed(&self, from: &PlaceId, to: &PlaceId, speed: MetresPerSecond) -> MetresPerSecond {
        self.on(from, to).filter(|limit| limit.get() < speed.get()).unwrap_or(speed)
    }
}

impl FromIterator<((PlaceId, PlaceId), MetresPerSecond)> for SpeedLimits {
    fn from_iter<I: IntoIterator<Item = ((PlaceId, PlaceId), MetresPerSecond)>>(limits: I) -> SpeedLimits {
        SpeedLimits(limits.into_iter().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_limit_on_a_lane_counts() {
        let place = |name: &str| -> PlaceId { name.parse().unwrap() };
        let speed = |speed| MetresPerSecond::new(speed).unwrap();
        let limits: SpeedLimits = [("A", "B", 0.3), ("B", "B", 0.5), ("D", "D", 0.2)]
            .map(|(a, b, limit)| ((place(a), place(b)), speed(limit)))
            .into_iter()
            .collect();
        let on = |from, to| limits.on(&place(from), &place(to)).map(MetresPerSecond::get);
        assert_eq!([on("A", "B"), on("B", "A")], [Some(0.3); 2], "in both directions");
        assert_eq!([on("B", "C"), on("C", "B")], [Some(0.5); 2], "from and to the place");
        assert_eq!([on("A", "E"), on("C", "D")], [None, Some(0.2)]);
        assert_eq!([on("A", "A"), on("C", "C")], [Some(0.3), None], "on its way back to the place");
        assert_eq!(limits.slowed(&place("A"), &place("B"), speed(0.1)), speed(0.1), "it is slower");
        assert_eq!(limits.slowed(&place("A"), &place("B"), speed(1.0)), speed(0.3));
        assert!(!limits.is_empty() && SpeedLimits::default().is_empty());
    }
}
