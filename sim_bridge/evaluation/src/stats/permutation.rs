//! Permutation tests: the probability of a result at least as extreme under random rearrangement
//! (Fisher 1935; Pitman 1937).

use super::{Alternative, StatsError, differences, mean, sample, variance};
use rand::seq::SliceRandom;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

/// Greatest number of differing pairs for an exact test: all 65,536 ways to swap them are tried.
const EXACT_PAIRS: usize = 16;

/// Result of a permutation test.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct PermutationTest {
    /// The share of rearrangements at least as extreme as the observed data. The observed
    /// arrangement counts as well, so it is never 0 (Phipson and Smyth 2010).
    pub p: f64,
    /// Number of rearrangements.
    pub permutations: u64,
    /// True if these were all possible rearrangements.
    pub exact: bool,
}

/// Tests pairs: each pair is randomly swapped. Exact for up to 16 pairs that differ, else with
/// `draws` rearrangements from `seed`.
///
/// # Errors
/// [`StatsError`] for fewer than two pairs.
pub(crate) fn permute_paired(
    first: &[f64],
    second: &[f64],
    alternative: Alternative,
    draws: u32,
    seed: u64,
) -> Result<PermutationTest, StatsError> {
    // A pair of equal values contributes nothing in either order.
    let differences: Vec<f64> = differences(first, second)?.into_iter().filter(|d| *d != 0.0).collect();
    let observed: f64 = differences.iter().sum();
    let extreme = AsExtreme::than(observed, alternative, differences.iter().map(|d| d.abs()).sum());
    if differences.len() <= EXACT_PAIRS {
        let all = 1_u64 << differences.len();
        let signed = |swaps: u64| {
            differences.iter().enumerate().map(|(i, d)| if swaps >> i & 1 == 1 { -d } else { *d }).sum::<f64>()
        };
        let hits = (0..all).filter(|swaps| extreme.is(signed(*swaps))).count();
        return Ok(PermutationTest { p: hits as f64 / all as f64, permutations: all, exact: true });
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut swapped = || differences.iter().map(|d| if rng.random::<bool>() { -d } else { *d }).sum::<f64>();
    Ok(sampled(draws, || extreme.is(swapped())))
}

/// Tests two samples: values are randomly assigned to the samples, by `draws` rearrangements from
/// `seed`. The statistic is Welch's t, so unequal variances alone do not count as a difference
/// (Janssen 1997).
///
/// # Errors
/// [`StatsError`] for samples of fewer than two values.
pub(crate) fn permute_two_samples(
    first: &[f64],
    second: &[f64],
    alternative: Alternative,
    draws: u32,
    seed: u64,
) -> Result<PermutationTest, StatsError> {
    sample(first, 2)?;
    sample(second, 2)?;
    let mut all: Vec<f64> = first.iter().chain(second).copied().collect();
    let extreme = AsExtreme::than(studentised(first, second), alternative, 1.0);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    Ok(sampled(draws, || {
        shuffle_front(&mut all, first.len(), &mut rng);
        let (first, second) = all.split_at(first.len());
        extreme.is(studentised(first, second))
    }))
}

/// Moves a random selection of values to the front, which is sufficient for a rearrangement.
fn shuffle_front(values: &mut [f64], front: usize, rng: &mut impl Rng) {
    let _ = values.partial_shuffle(rng, front);
    // `partial_shuffle` moves the selected values to the end.
    let end = values.len() - front;
    values.rotate_left(end);
}

fn studentised(first: &[f64], second: &[f64]) -> f64 {
    let part = |values: &[f64]| variance(values) / values.len() as f64;
    let difference = mean(first) - mean(second);
    if difference == 0.0 { 0.0 } else { difference / (part(first) + part(second)).sqrt() }
}

fn sampled(draws: u32, mut is_hit: impl FnMut() -> bool) -> PermutationTest {
    let hits = (0..draws).filter(|_| is_hit()).count();
    PermutationTest { p: (hits as f64 + 1.0) / (f64::from(draws) + 1.0), permutations: draws.into(), exact: false }
}

/// Checks whether a statistic is at least as extreme as the observed statistic.
struct AsExtreme {
    observed: f64,
    alternative: Alternative,
    /// Tolerance for rounding: sums of the same numbers in another order differ slightly.
    tolerance: f64,
}

impl AsExtreme {
    fn than(observed: f64, alternative: Alternative, scale: f64) -> AsExtreme {
        AsExtreme { observed, alternative, tolerance: 1e-12 * scale }
    }

    fn is(&self, statistic: f64) -> bool {
        match self.alternative {
            Alternative::TwoSided => statistic.abs() >= self.observed.abs() - self.tolerance,
            Alternative::Greater => statistic >= self.observed - self.tolerance,
            Alternative::Less => statistic <= self.observed + self.tolerance,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::samples::{SLEEP, UNEQUAL};
    use super::super::{paired, welch};
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_exact_test_agrees_with_scipy() {
        // scipy 1.17: permutation_test(.., permutation_type="samples", n_resamples=inf).
        let found = permute_paired(&SLEEP[0], &SLEEP[1], Alternative::TwoSided, 0, 0).unwrap();
        assert_eq!((found.p, found.exact), (0.003_906_25, true));
    }

    #[test]
    fn sampled_tests_approximate_t_tests_and_are_reproducible() {
        let (first, second) = (&UNEQUAL[0], &UNEQUAL[1]);
        let found = permute_two_samples(first, second, Alternative::TwoSided, 20_000, 7).unwrap();
        let expected = welch(first, second, Alternative::TwoSided).unwrap().p;
        assert!((found.p - expected).abs() < 0.005, "{found:?}, t-test {expected}");
        assert_eq!(found, permute_two_samples(first, second, Alternative::TwoSided, 20_000, 7).unwrap());

        let [a, b] = [0, 1].map(|side| SLEEP[side].repeat(2));
        let found = permute_paired(&a, &b, Alternative::Less, 20_000, 7).unwrap();
        assert!(!found.exact && found.p < 0.001, "{found:?}");
        assert!(paired(&a, &b, Alternative::Less).unwrap().p < 0.001);
    }

    #[test]
    fn equal_pairs_show_no_difference() {
        assert_eq!(permute_paired(&[1.0; 40], &[1.0; 40], Alternative::Greater, 9, 1).unwrap().p, 1.0);
    }

    proptest! {
        #[test]
        fn exchanged_samples_give_the_same_result(
            pairs in prop::collection::vec((0..9_i32, 0..9_i32), 2..12),
        ) {
            let (a, b): (Vec<f64>, Vec<f64>) = pairs.iter().map(|(a, b)| (f64::from(*a), f64::from(*b))).unzip();
            let p_value = |a: &[f64], b: &[f64], alternative| permute_paired(a, b, alternative, 0, 0).unwrap().p;
            let (greater, less) = (p_value(&a, &b, Alternative::Greater), p_value(&b, &a, Alternative::Less));
            prop_assert!((greater - less).abs() < 1e-12);
            let both = p_value(&a, &b, Alternative::TwoSided);
            prop_assert!((both - p_value(&b, &a, Alternative::TwoSided)).abs() < 1e-12);
            prop_assert!(both > 0.0 && both <= 1.0);
        }
    }
}
