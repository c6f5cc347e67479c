//! Solomon's instances: allocations by auction against TeSSI and the best known distances.

use crate::skip::skip;
use consort_evaluation::allocation::{AllocationPolicy, check_routes, read_instance, usual_orders};
use consort_tests::allocation::{AllocationRun, allocate_on_bus};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Bounds of the distance by the number of jobs, as multiples of the best known distance. The longest routes have 1.000,
/// 1.005 and 1.027 times that distance.
const DISTANCE_MAX: [(usize, f64); 3] = [(25, 1.002), (50, 1.01), (100, 1.03)];

/// Bound of the mean distance of a class, as a multiple of that of TeSSI. The mean is at most 0.944 times that of TeSSI.
const OF_TESSI_MAX: f64 = 0.95;

/// Every job is done in time by as many robots as the best known routes have, and the distance is near the best known. In
/// the mean of each class it is less than that of TeSSI. A seed determines the routes on any machine.
#[test]
fn distances_are_near_the_best_known_and_below_tessi() {
    let folder = std::env::var_os("CONSORT_REFERENCE")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/reference"), PathBuf::from)
        .join("solomon");
    let Ok(best) = std::fs::read_to_string(folder.join("best.csv")) else {
        return skip("no instances of Solomon (CONSORT_REFERENCE names the folder that contains them)");
    };
    let mut classes: BTreeMap<(String, usize), [Vec<f64>; 2]> = BTreeMap::new();
    for line in best.lines().skip(1) {
        let [name, jobs, robots, capacity, known] = line.split(',').collect::<Vec<_>>()[..] else {
            panic!("best.csv: {line}")
        };
        let (jobs, known): (usize, f64) = (jobs.parse().unwrap(), known.parse().unwrap());
        let path = folder.join(format!("{name}.{jobs}.csv"));
        let text = std::fs::read_to_string(&path).unwrap();
        let of = |policy, robots: usize| {
            let capacity = Some(capacity.parse().unwrap());
            let instance = read_instance(&text, &path, Some(robots), capacity).unwrap();
            let AllocationRun { routes, .. } = allocate_on_bus(&instance, policy, usual_orders(jobs), 1);
            check_routes(&instance, &routes).unwrap()
        };
        let ours = of(AllocationPolicy::Consort, robots.parse().unwrap());
        assert_eq!((ours.late, ours.unassigned), (0, 0), "{name}.{jobs}");
        assert!(ours.distance >= known - 0.05, "{name}.{jobs}: {} is below {known}", ours.distance);
        let (_, most) = DISTANCE_MAX.into_iter().find(|(size, _)| *size == jobs).expect("there are three sizes");
        assert!(ours.distance <= known * most, "{name}.{jobs}: {}, best known {known}", ours.distance);
        // With so many robots TeSSI does all jobs, too.
        let [ours, tessi] = [AllocationPolicy::Consort, AllocationPolicy::Tessi].map(|policy| of(policy, 25));
        assert_eq!((tessi.unassigned, ours.unassigned), (0, 0), "{name}.{jobs}");
        let class =
            name.trim_end_matches(|digit: char| digit.is_ascii_digit()).to_owned() + &name[name.len() - 3..][..1];
        let [of_ours, of_tessi] = classes.entry((class, jobs)).or_default();
        of_ours.push(ours.distance);
        of_tessi.push(tessi.distance);
    }
    assert_eq!(classes.len(), 18);
    for (class, [ours, tessi]) in classes {
        let mean = |distances: &[f64]| distances.iter().sum::<f64>() / distances.len() as f64;
        assert!(mean(&ours) <= mean(&tessi) * OF_TESSI_MAX, "{class:?}: {ours:?}, TeSSI {tessi:?}");
    }
}
