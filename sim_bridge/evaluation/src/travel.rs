//! Duration of drives: computed, or drawn from measured drives.
//!
//! The speed of a robot and the length of the route give an estimate. A drive in a trial takes the
//! estimate times a factor, which is drawn for each drive:
//!
//! - *kinematic*: 1, times the factor of the places at either end (`slow`), times a random spread
//!   (`spread`);
//! - *empirical*: a factor measured between these two places. Without such a measurement it is
//!   drawn from the drives to the same place, else from the same place, else from all drives. The
//!   estimate scales it in each case.

use super::stats::quantile;
use consort_protocol::ids::PlaceId;
use consort_text::count;
use rand::RngExt;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::PathBuf;

/// Range of a factor: a robot cannot drive much faster than estimated, and a drive that takes ten
/// times as long is an accident.
const FACTORS: (f64, f64) = (0.2, 10.0);

/// The settings of drives in a design.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TravelSettings {
    /// Variation of drives: the standard deviation of the factor's logarithm. With 0.1, two of
    /// three drives take between 0.9 and 1.1 times the median duration. Default 0.
    pub spread: f64,
    /// Factors of slow places, for example with doors that are hard to pass: a drive that begins or
    /// ends there takes this many times as long. If both ends are slow, the greater factor applies.
    pub slow: BTreeMap<PlaceId, f64>,
    /// A file of measured drives. It replaces the settings above.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub legs: Option<PathBuf>,
}

impl TravelSettings {
    /// Returns all errors, each with its key.
    pub(super) fn validation_errors(&self) -> Vec<String> {
        let mut violations = vec![];
        if !(0.0..=1.0).contains(&self.spread) {
            violations.push(format!("travel.spread: is {}, allowed: 0 to 1", self.spread));
        }
        let (least, most) = FACTORS;
        for (place, factor) in self.slow.iter().filter(|(_, factor)| !(least..=most).contains(*factor)) {
            violations.push(format!("travel.slow: {place} has {factor}, allowed: {least} to {most}"));
        }
        violations
    }
}

/// Model of the duration of drives.
#[derive(Debug, Clone, PartialEq)]
pub enum TravelModel {
    /// Computed.
    Kinematic(TravelSettings),
    /// Drawn from measured drives.
    Empirical(MeasuredLegs),
}

impl TravelModel {
    /// Returns how many times as long as estimated a drive takes.
    pub fn factor(&self, from: &PlaceId, to: &PlaceId, rng: &mut ChaCha8Rng) -> f64 {
        let factor = match self {
            TravelModel::Kinematic(travel) => {
                let slow = |place| travel.slow.get(place).copied().unwrap_or(1.0);
                let slowest = if slow(from) > slow(to) { slow(from) } else { slow(to) };
                slowest * (travel.spread * normal(rng)).exp()
            }
            TravelModel::Empirical(legs) => legs.draw(from, to, rng),
        };
        factor.clamp(FACTORS.0, FACTORS.1)
    }

    /// Returns a description for reports.
    pub fn describe(&self) -> String {
        match self {
            TravelModel::Kinematic(travel) => {
                let slow = count(travel.slow.len(), "slow place", "slow places");
                format!("kinematic, spread {}, {slow}", travel.spread)
            }
            TravelModel::Empirical(legs) => {
                let pairs = count(legs.pairs.len(), "pair of places", "pairs of places");
                format!("empirical, {} on {pairs}", count(legs.any.len(), "drive", "drives"))
            }
        }
    }
}

/// Returns a standard normal random number (Box and Muller 1958).
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (2.0 * PI * v).cos()
}

/// Measured drives: the factors of actual to estimated duration.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MeasuredLegs {
    pairs: BTreeMap<(PlaceId, PlaceId), Vec<f64>>,
    to: BTreeMap<PlaceId, Vec<f64>>,
    from: BTreeMap<PlaceId, Vec<f64>>,
    any: Vec<f64>,
}

/// Distribution of the factors of drives: how many times as long as estimated they took.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FactorQuantiles {
    /// Number of drives.
    pub count: usize,
    /// 5 % quantile.
    pub q05: f64,
    /// Median.
    pub median: f64,
    /// 95 % quantile.
    pub q95: f64,
}

impl FactorQuantiles {
    /// Returns `None` for no drives.
    fn of(factors: &[f64]) -> Option<FactorQuantiles> {
        let at = |share| quantile(factors, share);
        Some(FactorQuantiles { count: factors.len(), q05: at(0.05)?, median: at(0.5)?, q95: at(0.95)? })
    }
}

/// The factors of the drives between two places.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PairFactors {
    /// Start of the drives.
    pub from: PlaceId,
    /// End of the drives.
    pub to: PlaceId,
    /// Their factors.
    #[serde(flatten)]
    pub factors: FactorQuantiles,
}

/// The factors of the drives to a place, and from there to a destination.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ViaFactors {
    /// The place.
    pub via: PlaceId,
    /// The factors of the drives.
    #[serde(flatten)]
    pub factors: FactorQuantiles,
}

/// A measured drive as written; other columns are ignored.
#[derive(Debug, Deserialize)]
struct LegEntry {
    origin: PlaceId,
    dest: PlaceId,
    duration_s: f64,
    estimate_s: f64,
}

/// A file of measured drives could not be read.
#[derive(Debug, thiserror::Error)]
pub enum MeasuredLegsError {
    /// The file is not a table with the required columns; the message contains line and column.
    #[error("{0}; a file of measured drives needs the columns origin, dest, duration_s, estimate_s")]
    Form(#[from] csv::Error),
    /// A time is not a positive number.
    #[error("line {line}: {field} is {value}, allowed: a number above 0")]
    Time {
        /// Number of the line, including the header.
        line: usize,
        /// Name of the column.
        field: &'static str,
        /// The number.
        value: f64,
    },
    /// The file contains no drives.
    #[error("the file contains no drives")]
    Empty,
}

impl MeasuredLegs {
    /// Reads the drives from a CSV table with at least the columns `origin`, `dest`, `duration_s`
    /// and `estimate_s`.
    ///
    /// # Errors
    /// [`MeasuredLegsError`] of the first invalid line.
    pub fn read(from: impl std::io::Read) -> Result<MeasuredLegs, MeasuredLegsError> {
        let mut legs = MeasuredLegs::default();
        for (index, entry) in csv::Reader::from_reader(from).into_deserialize::<LegEntry>().enumerate() {
            let LegEntry { origin, dest, duration_s, estimate_s } = entry?;
            for (field, value) in [("duration_s", duration_s), ("estimate_s", estimate_s)] {
                if !(value.is_finite() && value > 0.0) {
                    return Err(MeasuredLegsError::Time { line: index + 2, field, value });
                }
            }
            let factor = duration_s / estimate_s;
            legs.pairs.entry((origin.clone(), dest.clone())).or_default().push(factor);
            legs.from.entry(origin).or_default().push(factor);
            legs.to.entry(dest).or_default().push(factor);
            legs.any.push(factor);
        }
        if legs.any.is_empty() { Err(MeasuredLegsError::Empty) } else { Ok(legs) }
    }

    /// Returns the factors of each pair of places, in the order of their names.
    pub fn pair_factors(&self) -> Vec<PairFactors> {
        let of_pair = |((from, to), factors): (&(PlaceId, PlaceId), &Vec<f64>)| {
            let (from, to) = (from.clone(), to.clone());
            Some(PairFactors { from, to, factors: FactorQuantiles::of(factors)? })
        };
        self.pairs.iter().filter_map(of_pair).collect()
    }

    /// Returns the factors of all drives. `None` for no drives.
    pub fn all_factors(&self) -> Option<FactorQuantiles> {
        FactorQuantiles::of(&self.any)
    }

    /// Returns, for each place from which drives lead to `destination`, the factors of the drives
    /// to that place and from there to `destination`: the drives of missions that visit the place
    /// and end at `destination`.
    pub fn via_factors(&self, destination: &PlaceId) -> Vec<ViaFactors> {
        let of_pair = |((via, _), factors): (&(PlaceId, PlaceId), &Vec<f64>)| {
            let there = self.to.get(via).into_iter().flatten();
            let factors: Vec<f64> = there.chain(factors).copied().collect();
            Some(ViaFactors { via: via.clone(), factors: FactorQuantiles::of(&factors)? })
        };
        self.pairs.iter().filter(|((_, to), _)| to == destination).filter_map(of_pair).collect()
    }

    /// Returns the places at which drives end.
    pub fn destinations(&self) -> impl Iterator<Item = &PlaceId> {
        self.to.keys()
    }

    fn draw(&self, from: &PlaceId, to: &PlaceId, rng: &mut ChaCha8Rng) -> f64 {
        let candidates = self.pairs.get(&(from.clone(), to.clone())).or_else(|| self.to.get(to));
        let candidates = candidates.or_else(|| self.from.get(from)).unwrap_or(&self.any);
        candidates.choose(rng).copied().unwrap_or(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::super::seeds::generator;
    use super::*;

    fn place(name: &str) -> PlaceId {
        PlaceId::new(name).unwrap()
    }

    fn factors(model: &TravelModel, from: &str, to: &str) -> Vec<f64> {
        let mut rng = generator(7, &["travel"]);
        (0..2001).map(|_| model.factor(&place(from), &place(to), &mut rng)).collect()
    }

    #[test]
    fn the_slower_end_and_the_spread_determine_the_factor() {
        let travel = TravelSettings { spread: 0.1, slow: [(place("B"), 1.5), (place("C"), 1.2)].into(), legs: None };
        let model = TravelModel::Kinematic(travel);
        for (from, to, middle) in [("A", "D", 1.0), ("B", "C", 1.5), ("C", "B", 1.5), ("A", "C", 1.2)] {
            let drawn = factors(&model, from, to);
            assert!((quantile(&drawn, 0.5).unwrap() / middle - 1.0).abs() < 0.01, "{from} {to}");
            let spread = (quantile(&drawn, 0.8413).unwrap() / middle).ln();
            assert!((spread - 0.1).abs() < 0.01, "{spread}");
        }
        assert!(
            factors(&TravelModel::Kinematic(TravelSettings::default()), "A", "B").iter().all(|factor| *factor == 1.0)
        );
    }

    #[test]
    fn a_missing_leg_is_drawn_from_legs_to_or_from_the_place() {
        let text = "origin,dest,length_m,duration_s,estimate_s\nA,B,1,20,10\nC,B,1,30,10\nC,D,1,40,10\n";
        let model = TravelModel::Empirical(MeasuredLegs::read(text.as_bytes()).unwrap());
        let drawn = |from, to| {
            let mut drawn = factors(&model, from, to);
            drawn.sort_by(f64::total_cmp);
            drawn.dedup();
            drawn
        };
        assert_eq!(drawn("A", "B"), [2.0]);
        assert_eq!(drawn("X", "B"), [2.0, 3.0]);
        assert_eq!(drawn("C", "X"), [3.0, 4.0]);
        assert_eq!(drawn("X", "Y"), [2.0, 3.0, 4.0]);
    }

    #[test]
    fn factors_are_summarized_by_pair_and_by_place_on_the_way() {
        let text = "origin,dest,duration_s,estimate_s\nA,B,10,10\nA,B,20,10\nA,B,30,10\nC,B,60,10\nB,L,50,10\n";
        let legs = MeasuredLegs::read(text.as_bytes()).unwrap();
        let quantiles = |count, q05, median, q95| FactorQuantiles { count, q05, median, q95 };
        let pair = |from, to, factors| PairFactors { from: place(from), to: place(to), factors };
        assert_eq!(
            legs.pair_factors(),
            [
                pair("A", "B", quantiles(3, 1.1, 2.0, 2.9)),
                pair("B", "L", quantiles(1, 5.0, 5.0, 5.0)),
                pair("C", "B", quantiles(1, 6.0, 6.0, 6.0)),
            ]
        );
        let all = quantiles(5, 1.2, 3.0, 5.8);
        assert_eq!(legs.all_factors(), Some(all));
        assert_eq!(legs.via_factors(&place("L")), [ViaFactors { via: place("B"), factors: all }]);
        assert_eq!(legs.via_factors(&place("A")), []);
    }

    #[test]
    fn an_invalid_leg_is_reported_with_its_line() {
        let error_of = |text: &str| MeasuredLegs::read(text.as_bytes()).unwrap_err().to_string();
        let header = "origin,dest,duration_s,estimate_s\n";
        assert_eq!(error_of(header), "the file contains no drives");
        assert_eq!(
            error_of(&format!("{header}A,B,2,1\nA,B,0,1\n")),
            "line 3: duration_s is 0, allowed: a number above 0"
        );
        let form = error_of(&format!("{header}A,B,long,1\n"));
        assert!(
            form.contains("line: 2")
                && form.ends_with("a file of measured drives needs the columns origin, dest, duration_s, estimate_s"),
            "{form}"
        );
    }
}
