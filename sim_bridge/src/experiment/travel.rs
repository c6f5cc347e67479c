//! How long drives take: reckoned, or drawn from what was measured.
//!
//! A robot's own speed and the length of the route give an estimate. What a drive takes in a trial is that estimate times
//! a factor, which is drawn for each drive:
//!
//! - *kinematic*: 1, times what the places at either end cost (`slow`), times a spread (`spread`);
//! - *empirical*: one of the factors that were measured between these two places. Where none was, one of those measured
//!   on drives to the same place, else from the same place, else on any drive: scaled by the estimate in each case.

use consort_protocol::count::count;
use consort_protocol::ids::PlaceId;
use rand::RngExt;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::PathBuf;

/// What a factor is kept within: nobody flies, and what takes ten times as long is an accident and no drive.
const FACTORS: (f64, f64) = (0.2, 10.0);

/// The part of a design about drives.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TravelSettings {
    /// How far drives differ from one another: the standard deviation of the factor's logarithm. 0.1: two of three drives
    /// take between 0.9 and 1.1 times as long as in the middle. Default 0.
    pub spread: f64,
    /// Places where a drive that begins or ends there takes so many times as long: doors that are hard to pass, say. Of two
    /// such ends the slower counts.
    pub slow: BTreeMap<PlaceId, f64>,
    /// A file of measured drives, in place of the above.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub legs: Option<PathBuf>,
}

impl TravelSettings {
    /// What is wrong with it, each with its key.
    pub(super) fn validation_errors(&self) -> Vec<String> {
        let mut problems = vec![];
        if !(0.0..=1.0).contains(&self.spread) {
            problems.push(format!("travel.spread: is {}, allowed is 0 to 1", self.spread));
        }
        let (least, most) = FACTORS;
        for (place, factor) in self.slow.iter().filter(|(_, factor)| !(least..=most).contains(*factor)) {
            problems.push(format!("travel.slow: {place} has {factor}, allowed is {least} to {most}"));
        }
        problems
    }
}

/// What drives take.
#[derive(Debug, Clone, PartialEq)]
pub enum TravelModel {
    /// Reckoned.
    Kinematic(TravelSettings),
    /// Measured.
    Empirical(MeasuredLegs),
}

impl TravelModel {
    /// How many times as long as estimated a drive takes.
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

    /// In words, for reports.
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

/// A standard normal number (Box and Muller 1958).
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random(), rng.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (2.0 * PI * v).cos()
}

/// Measured drives: how many times as long as estimated each took.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MeasuredLegs {
    pairs: BTreeMap<(PlaceId, PlaceId), Vec<f64>>,
    to: BTreeMap<PlaceId, Vec<f64>>,
    from: BTreeMap<PlaceId, Vec<f64>>,
    any: Vec<f64>,
}

/// A measured drive as written; other columns are left aside.
#[derive(Debug, Deserialize)]
struct LegEntry {
    origin: PlaceId,
    dest: PlaceId,
    duration_s: f64,
    estimate_s: f64,
}

/// Why there are no legs.
#[derive(Debug, thiserror::Error)]
pub enum MeasuredLegsError {
    /// Not a table with the columns wanted: the message names line and column.
    #[error("{0}; a file of legs has the columns origin, dest, duration_s, estimate_s")]
    Form(#[from] csv::Error),
    /// A time that is none.
    #[error("line {line}: {field} is {value}, allowed is a number above 0")]
    Time {
        /// Which line, the header counted.
        line: usize,
        /// Its column.
        field: &'static str,
        /// The number.
        value: f64,
    },
    /// No drives.
    #[error("there are no legs in it")]
    Empty,
}

impl MeasuredLegs {
    /// Reads them from a table with at least the columns `origin`, `dest`, `duration_s` and `estimate_s`.
    ///
    /// # Errors
    /// [`LegsError`] names the first line that is wrong.
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

    fn draw(&self, from: &PlaceId, to: &PlaceId, rng: &mut ChaCha8Rng) -> f64 {
        let known = self.pairs.get(&(from.clone(), to.clone())).or_else(|| self.to.get(to));
        let known = known.or_else(|| self.from.get(from)).unwrap_or(&self.any);
        known.choose(rng).copied().unwrap_or(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::super::seeds::generator;
    use super::super::stats::quantile;
    use super::*;

    fn place(name: &str) -> PlaceId {
        PlaceId::new(name).unwrap()
    }

    fn factors(model: &TravelModel, from: &str, to: &str) -> Vec<f64> {
        let mut rng = generator(7, &["travel"]);
        (0..2001).map(|_| model.factor(&place(from), &place(to), &mut rng)).collect()
    }

    #[test]
    fn the_slower_end_and_the_spread_make_the_factor() {
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
    fn a_missing_leg_is_drawn_from_those_to_the_same_place_then_from_it_then_from_any() {
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
    fn what_is_no_leg_is_told_with_its_line() {
        let said = |text: &str| MeasuredLegs::read(text.as_bytes()).unwrap_err().to_string();
        let header = "origin,dest,duration_s,estimate_s\n";
        assert_eq!(said(header), "there are no legs in it");
        assert_eq!(
            said(&format!("{header}A,B,2,1\nA,B,0,1\n")),
            "line 3: duration_s is 0, allowed is a number above 0"
        );
        let form = said(&format!("{header}A,B,long,1\n"));
        assert!(
            form.contains("line: 2")
                && form.ends_with("a file of legs has the columns origin, dest, duration_s, estimate_s"),
            "{form}"
        );
    }
}
