//! Calibration of energy from the reports of robots: the discharge of tasks, and the charging of batteries.
//!
//! **Discharge.** The charge that the tasks of a type have used, over the charge that robots estimate for the same
//! durations. Batteries report steps of a hundredth, which is more than many tasks use, so a single task says little; the
//! ratio of the sums does (Cochran, *Sampling techniques*, 1977, chapter 6). A ratio counts if its standard error is small.
//!
//! **Charging.** The charge of a battery is divided into ranges. Whenever a robot charges through a whole range at a
//! place, the time for it is observed. Robots with small batteries and strong chargers charge faster, but at which share of
//! its full power a battery charges in a range is assumed to be the same for all. So the logarithm of a rate is the sum of
//! a number of the robot at its charger and a number of the range, which are fitted by least squares: a robot that only
//! tops up does not make the upper ranges look fast. Neighbouring ranges with about the same rate form a step of the curve.

use super::calibration::MIN_OBSERVATIONS;
use consort_protocol::charging_curve::{ChargingCurve, CurveStep};
use consort_protocol::ids::{PlaceId, RobotId, TaskType};
use consort_protocol::units::{BatteryShare, SharePerSecond};
use consort_skills::descriptor::MeasuredCharging;
use std::collections::BTreeMap;

/// Greatest standard error of a ratio that counts, as a share of the ratio.
const ERROR_MAX: f64 = 0.1;

/// A task that a robot has performed, with the charge that it has used.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskUse {
    /// The kind of task.
    pub skill: TaskType,
    /// Charge that the robot estimates for the actual duration, as a share of a full battery.
    pub estimated_share: f64,
    /// Charge used, as a share of a full battery.
    pub used_share: f64,
}

/// Discharge in the tasks of a type.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DischargeRatio {
    /// Number of tasks.
    pub tasks: usize,
    /// Charge used over the charge estimated for the same durations.
    pub ratio: f64,
    /// Standard error of the ratio.
    pub error: f64,
}

impl DischargeRatio {
    /// Returns the ratio; `None` if the tasks are too few for it.
    pub fn certain(&self) -> Option<f64> {
        let is_certain = self.tasks >= MIN_OBSERVATIONS && self.error <= ERROR_MAX * self.ratio;
        (is_certain && self.ratio > 0.0).then_some(self.ratio)
    }
}

/// Computes the discharge of each type of task. Tasks of robots that use no charge by their estimates are ignored.
pub fn discharge_ratios(tasks: &[TaskUse]) -> BTreeMap<TaskType, DischargeRatio> {
    let mut of_skills: BTreeMap<&TaskType, Vec<&TaskUse>> = BTreeMap::new();
    for task in tasks.iter().filter(|task| task.estimated_share > 0.0) {
        of_skills.entry(&task.skill).or_default().push(task);
    }
    of_skills.into_iter().map(|(skill, tasks)| (skill.clone(), discharge_ratio(&tasks))).collect()
}

fn discharge_ratio(tasks: &[&TaskUse]) -> DischargeRatio {
    let estimated: f64 = tasks.iter().map(|task| task.estimated_share).sum();
    let used: f64 = tasks.iter().map(|task| task.used_share).sum();
    let ratio = used / estimated;
    let squares: f64 = tasks.iter().map(|task| (task.used_share - ratio * task.estimated_share).powi(2)).sum();
    let count = tasks.len() as f64;
    let error = (squares * count / (count - 1.0).max(1.0)).sqrt() / estimated;
    DischargeRatio { tasks: tasks.len(), ratio, error }
}

/// Number of ranges of the charge.
const RANGES: usize = 20;

/// Width of a range.
const WIDTH: f64 = 1.0 / RANGES as f64;

/// Greatest fall of the charge of a robot that charges: a step of a battery that reports hundredths.
const DIP_MAX: f64 = 0.0101;

/// Least number of passages of a range. With three, a disturbed passage does not decide alone.
pub const MIN_PASSAGES: usize = 3;

/// Greatest relative difference between the rate of a range and the rate of the step to which it belongs. Raised: fewer
/// steps, and longer or shorter forecasts near their ends.
const STEP_TOLERANCE: f64 = 0.05;

/// Rounds of the fit. Each brings the numbers closer to the least squares; few are needed if robots charge in ranges that
/// overlap.
const ROUNDS: usize = 100;

/// Passages of a range by a robot at a place.
#[derive(Debug, Clone, Copy, Default)]
struct Passages {
    count: usize,
    time_s: f64,
}

impl Passages {
    /// Returns the logarithm of the rate, and its weight; `None` without passages.
    fn log_rate(&self) -> Option<(f64, f64)> {
        let count = self.count as f64;
        (self.count > 0).then(|| ((count * WIDTH / self.time_s).ln(), count))
    }
}

/// Robot that may be charging.
#[derive(Debug)]
struct Session {
    place: PlaceId,
    /// Time of the latest report.
    time_s: f64,
    /// Greatest charge so far.
    charge: f64,
    /// Latest limit of a range that the charge has passed, and the time.
    passed: Option<(usize, f64)>,
}

/// Observer of the charge of robots.
#[derive(Debug, Default)]
pub struct ChargingObserver {
    sessions: BTreeMap<RobotId, Session>,
    passages: BTreeMap<(RobotId, PlaceId), [Passages; RANGES]>,
}

/// Charging of the observed robots.
#[derive(Debug, Clone, PartialEq)]
pub struct ChargingFit {
    /// The result for a calibration.
    pub charging: MeasuredCharging,
    /// Lower limit of the first range with enough passages. Below it batteries are assumed to charge as in this range.
    pub from: f64,
    /// Upper limit of the last range with enough passages. Above it batteries are assumed to charge as in this range.
    pub to: f64,
    /// Passages of ranges.
    pub passages: usize,
}

/// Returns the lower limit of a range.
fn lower_limit(range: usize) -> f64 {
    range as f64 / RANGES as f64
}

/// Returns the number of ranges up to a charge.
fn ranges_up_to(charge: f64) -> usize {
    (charge * RANGES as f64 + 1e-9).floor() as usize
}

impl ChargingObserver {
    /// Applies a report of a robot: its charge as a share, and its place, at a time of the world in seconds. A session ends
    /// when the charge falls, or rises by more than a range at once, as when a battery is swapped.
    pub fn report(&mut self, robot: &RobotId, time_s: f64, charge: f64, place: &PlaceId) {
        let continued = self.sessions.get_mut(robot).filter(|session| {
            let charges = (session.charge - DIP_MAX)..=(session.charge + WIDTH);
            session.place == *place && time_s >= session.time_s && charges.contains(&charge)
        });
        let Some(session) = continued else {
            let session = Session { place: place.clone(), time_s, charge, passed: None };
            self.sessions.insert(robot.clone(), session);
            return;
        };
        for limit in ranges_up_to(session.charge) + 1..=ranges_up_to(charge).min(RANGES) {
            let part = (lower_limit(limit) - session.charge) / (charge - session.charge);
            let at_s = session.time_s + part * (time_s - session.time_s);
            if let Some((before, since_s)) = session.passed
                && before + 1 == limit
                && at_s > since_s
            {
                let pair = (robot.clone(), place.clone());
                let passages = &mut self.passages.entry(pair).or_default()[before];
                (passages.count, passages.time_s) = (passages.count + 1, passages.time_s + at_s - since_s);
            }
            session.passed = Some((limit, at_s));
        }
        (session.time_s, session.charge) = (time_s, charge.max(session.charge));
    }

    /// Ends all sessions: later reports are from another recording.
    pub fn end_sessions(&mut self) {
        self.sessions.clear();
    }

    /// Returns the charging; `None` if no range has enough passages.
    pub fn fit(&self) -> Option<ChargingFit> {
        let pairs: Vec<&[Passages; RANGES]> = self.passages.values().collect();
        let passages_of = |range: usize| pairs.iter().map(|pair| pair[range].count).sum::<usize>();
        let measured: Vec<usize> = (0..RANGES).filter(|range| passages_of(*range) >= MIN_PASSAGES).collect();
        let (first, last) = (*measured.first()?, *measured.last()?);
        let (mut of_pairs, mut of_ranges) = (vec![0.0_f64; pairs.len()], [0.0_f64; RANGES]);
        for _ in 0..ROUNDS {
            for range in measured.iter().copied() {
                let of_range = pairs.iter().zip(&of_pairs);
                of_ranges[range] = weighted_mean(of_range.filter_map(|(pair, of_pair)| {
                    let (log, weight) = pair[range].log_rate()?;
                    Some((log - of_pair, weight))
                }));
            }
            for (pair, of_pair) in pairs.iter().zip(&mut of_pairs) {
                *of_pair = weighted_mean(measured.iter().filter_map(|range| {
                    let (log, weight) = pair[*range].log_rate()?;
                    Some((log - of_ranges[*range], weight))
                }));
            }
        }
        let (full, curve) = curve_of(measured.iter().map(|range| (*range, of_ranges[*range].exp())));
        let weight = |pair: &&[Passages; RANGES]| measured.iter().map(|range| pair[*range].count).sum::<usize>() as f64;
        let of_pairs = pairs.iter().zip(&of_pairs).map(|(pair, of_pair)| (of_pair.exp(), weight(pair)));
        let charging =
            MeasuredCharging { share_per_s: SharePerSecond::new(full * weighted_mean(of_pairs)).ok()?, curve };
        let passages = measured.iter().map(|range| passages_of(*range)).sum();
        Some(ChargingFit { charging, from: lower_limit(first), to: lower_limit(last + 1), passages })
    }
}

/// Returns the mean of numbers with their weights; 0 without any.
fn weighted_mean(numbers: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (sum, weights) =
        numbers.fold((0.0, 0.0), |(sum, weights), (number, weight)| (sum + number * weight, weights + weight));
    if weights > 0.0 { sum / weights } else { 0.0 }
}

/// Neighbouring ranges with about the same rate.
struct Step {
    first: usize,
    ranges: f64,
    /// Time for all of them.
    time: f64,
}

impl Step {
    fn rate(&self) -> f64 {
        self.ranges / self.time
    }
}

/// Returns the greatest rate of a step, and the curve. The rates are in the order of their ranges.
fn curve_of(rates: impl Iterator<Item = (usize, f64)>) -> (f64, ChargingCurve) {
    let mut steps: Vec<Step> = vec![];
    for (range, rate) in rates {
        match steps.last_mut() {
            Some(step) if (rate / step.rate() - 1.0).abs() <= STEP_TOLERANCE => {
                (step.ranges, step.time) = (step.ranges + 1.0, step.time + 1.0 / rate);
            }
            _ => steps.push(Step { first: range, ranges: 1.0, time: 1.0 / rate }),
        }
    }
    let full = steps.iter().map(Step::rate).fold(0.0, f64::max);
    let curve = steps.iter().enumerate().filter_map(|(index, step)| {
        // Three decimals are more than the measurement contains.
        let power = ((step.rate() / full * 1000.0).round() / 1000.0).clamp(0.001, 1.0);
        let above = if index == 0 { 0.0 } else { lower_limit(step.first) };
        let above = BatteryShare::new(above).expect("a limit of a range is from 0 to 1");
        (index > 0 || power < 1.0).then_some(CurveStep { above, power })
    });
    let curve = ChargingCurve::try_from(curve.collect::<Vec<_>>());
    (full, curve.expect("the steps are in order, and their powers above 0 to 1"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn skill(name: &str) -> TaskType {
        name.parse().unwrap()
    }

    fn task(name: &str, estimated_share: f64, used_share: f64) -> TaskUse {
        TaskUse { skill: skill(name), estimated_share, used_share }
    }

    #[test]
    fn the_discharge_of_tasks_is_found_despite_coarse_batteries() {
        // Each task uses 0.4 % at 1.5 times the estimated rate; the battery reports hundredths.
        let reported = |tasks: f64| (1.0 - 0.004 * tasks) * 100.0;
        let used = |index: u8| (reported(f64::from(index)).floor() - reported(f64::from(index) + 1.0).floor()) / 100.0;
        let tasks: Vec<TaskUse> = (0..200).map(|index| task("dig", 0.004 / 1.5, used(index))).collect();
        let ratio = discharge_ratios(&tasks)[&skill("dig")];
        let found = ratio.certain().unwrap();
        assert!((found - 1.5).abs() < 0.05, "{ratio:?}");
        let few = discharge_ratios(&tasks[..12])[&skill("dig")];
        assert_eq!((few.tasks, few.certain()), (12, None), "{few:?}");
    }

    #[test]
    fn too_few_tasks_and_tasks_without_an_estimate_give_no_ratio() {
        let mut tasks = vec![task("dig", 0.01, 0.02); 4];
        tasks.extend(vec![task("open", 0.0, 0.0); 9]);
        tasks.extend(vec![task("wait", 0.01, 0.0); 9]);
        tasks.push(task("look", 0.01, 0.02));
        let ratios = discharge_ratios(&tasks);
        let certain: Vec<_> = ratios.iter().map(|(skill, ratio)| (skill.as_str(), ratio.certain())).collect();
        assert_eq!(certain, [("dig", None), ("look", None), ("wait", None)]);
        tasks.push(task("dig", 0.01, 0.02));
        assert_eq!(discharge_ratios(&tasks)[&skill("dig")].certain(), Some(2.0));
    }

    /// Charging of a robot in a simulated recording.
    struct Simulated<'a> {
        curve: &'a ChargingCurve,
        gain: f64,
        /// Step in which the battery reports; 0 for none.
        step: f64,
        interval_s: f64,
    }

    impl Simulated<'_> {
        /// Reports the charge from `from` to `to`, and then once at another place.
        fn charge(&self, observer: &mut ChargingObserver, robot: &str, from: f64, to: f64) {
            let (robot, dock, hall) = (robot.parse().unwrap(), "Dock".parse().unwrap(), "Hall".parse().unwrap());
            let (mut charge, mut time_s) = (from, 0.0);
            while charge < to {
                let reported = if self.step > 0.0 { (charge / self.step).floor() * self.step } else { charge };
                observer.report(&robot, time_s, reported, &dock);
                for _ in 0..10 {
                    charge += self.curve.power_at(charge) * self.gain * self.interval_s / 10.0;
                }
                time_s += self.interval_s;
            }
            observer.report(&robot, time_s, to, &hall);
        }
    }

    fn curve(steps: &[(f64, f64)]) -> ChargingCurve {
        let step = |(above, power): &(f64, f64)| CurveStep { above: BatteryShare::new(*above).unwrap(), power: *power };
        ChargingCurve::try_from(steps.iter().map(step).collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn a_known_curve_is_found() {
        let known = curve(&[(0.8, 0.5), (0.9, 0.25)]);
        let simulated = Simulated { curve: &known, gain: 0.0005, step: 0.0, interval_s: 1.0 };
        let mut observer = ChargingObserver::default();
        simulated.charge(&mut observer, "ada", 0.28, 0.96);
        simulated.charge(&mut observer, "ada", 0.28, 0.96);
        assert_eq!(observer.fit(), None, "two passages of each range are too few");
        simulated.charge(&mut observer, "ada", 0.28, 0.96);
        let ChargingFit { charging, from, to, passages } = observer.fit().unwrap();
        assert_eq!((from, to, passages), (0.3, 0.95, 3 * 13));
        assert!((charging.share_per_s.get() - 0.0005).abs() < 1e-6, "{charging:?}");
        let powers = [0.1, 0.79, 0.81, 0.91].map(|charge| charging.curve.power_at(charge));
        let close = powers.iter().zip([1.0, 1.0, 0.5, 0.25]).all(|(found, wanted)| (found - wanted).abs() < 0.01);
        assert!(close && charging.curve.next_step(0.0) == Some(0.8), "{charging:?}");
    }

    #[test]
    fn swaps_pauses_and_other_recordings_are_no_charging() {
        let mut observer = ChargingObserver::default();
        let (robot, dock) = ("ada".parse().unwrap(), "Dock".parse().unwrap());
        for day in 0..5 {
            let start_s = f64::from(day) * 1000.0;
            for (after_s, charge) in [(0.0, 0.12), (10.0, 0.16), (20.0, 0.9), (30.0, 0.8), (40.0, 0.84), (50.0, 0.2)] {
                observer.report(&robot, start_s + after_s, charge, &dock);
            }
            observer.end_sessions();
        }
        assert_eq!(observer.fit(), None);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// The robot `bob` has another gain and is observed only while it tops up.
        #[test]
        fn forecasts_with_the_found_curve_are_within_three_percent(
            gain in 0.0001..0.001,
            of_bob in 0.5..2.0,
            first in (0.5..0.75, 0.3..0.9),
            second in (0.05..0.15, 0.3..1.0),
            is_coarse in any::<bool>(),
            reports in 0.3..1.0,
        ) {
            let known = curve(&[first, (first.0 + second.0, first.1 * second.1)]);
            let step = if is_coarse { 0.01 } else { 0.0 };
            let mut observer = ChargingObserver::default();
            for (robot, gain, from) in [("ada", gain, 0.2), ("bob", gain * of_bob, 0.5)] {
                // Reports are at most 0.2 % of a full battery apart.
                let simulated = Simulated { curve: &known, gain, step, interval_s: reports * 0.002 / gain };
                for session in 0..4 {
                    simulated.charge(&mut observer, robot, from + f64::from(session) * 0.011, 0.97);
                }
            }
            let found = observer.fit().unwrap().charging;
            let time = |curve: &ChargingCurve| curve.time(0.3, 0.95, SharePerSecond::new(1.0).unwrap()).get();
            prop_assert!((time(&found.curve) / time(&known) - 1.0).abs() < 0.03, "{found:?}, not {known:?}");
            let found = found.share_per_s.get();
            let (least, greatest) = (gain.min(gain * of_bob), gain.max(gain * of_bob));
            prop_assert!((least * 0.97..=greatest * 1.03).contains(&found), "{found}, not {least} to {greatest}");
        }
    }
}
