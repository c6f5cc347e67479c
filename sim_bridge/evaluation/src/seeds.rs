//! Seeds from names: the random numbers of an item depend on the names of the item only, not on the
//! number of earlier draws.
//!
//! A level, a scenario or a trial added to a design leaves the draws of all others unchanged.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Derives the seed for `path` from another seed. The result is the same on every machine and in
/// every version of the program.
pub fn derive(seed: u64, path: &[&str]) -> u64 {
    // FNV-1a over the names. Each name ends with a byte that no text contains, so ["ab", "c"]
    // differs from ["a", "bc"].
    let bytes = path.iter().flat_map(|name| name.bytes().chain([0xff]));
    let named =
        bytes.fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
    mix(mix(seed).wrapping_add(named))
}

/// Returns a random number generator for `path`, derived from a seed.
pub fn generator(seed: u64, path: &[&str]) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(derive(seed, path))
}

/// The finalizer of SplitMix64 (Steele, Lea, Flood 2014): close numbers give unrelated results.
fn mix(number: u64) -> u64 {
    let mut z = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn a_seed_never_changes() {
        // The first number of SplitMix64 from 0, as published with the algorithm.
        assert_eq!(mix(0), 0xe220_a839_7b1d_cdaf);
        assert_eq!(derive(7, &["world", "aaaa", "3"]), derive(7, &["world", "aaaa", "3"]));
    }

    #[test]
    fn every_order_and_split_of_names_gives_a_different_seed() {
        let paths: [&[&str]; 7] = [&[], &["a"], &["ab", "c"], &["a", "bc"], &["c", "ab"], &["abc"], &["", "abc"]];
        let seeds: BTreeSet<u64> = (0..50).flat_map(|seed| paths.map(|path| derive(seed, path))).collect();
        assert_eq!(seeds.len(), 50 * paths.len());
    }
}
