//! Seeds from names: what chance comes from depends on what it is for, and not on how much was drawn before.
//!
//! A level, a scenario or a trial that is added to a design leaves the draws of all others as they were.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// The seed for what `path` names, under another seed. The same on every machine and in every version of the program.
pub fn derive(seed: u64, path: &[&str]) -> u64 {
    // FNV-1a over the names, each closed by a byte that no text holds, so that ["ab", "c"] is not ["a", "bc"].
    let bytes = path.iter().flat_map(|name| name.bytes().chain([0xff]));
    let named =
        bytes.fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
    mix(mix(seed).wrapping_add(named))
}

/// A generator for what `path` names, under a seed.
pub fn generator(seed: u64, path: &[&str]) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(derive(seed, path))
}

/// The finalizer of SplitMix64 (Steele, Lea, Flood 2014): neighbouring numbers come out unalike.
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
    fn a_seed_is_the_same_for_ever() {
        // The first number of SplitMix64 from 0, as published with the algorithm.
        assert_eq!(mix(0), 0xe220_a839_7b1d_cdaf);
        assert_eq!(derive(7, &["world", "aaaa", "3"]), derive(7, &["world", "aaaa", "3"]));
    }

    #[test]
    fn every_name_order_and_split_gives_a_seed_of_its_own() {
        let paths: [&[&str]; 7] = [&[], &["a"], &["ab", "c"], &["a", "bc"], &["c", "ab"], &["abc"], &["", "abc"]];
        let seeds: BTreeSet<u64> = (0..50).flat_map(|seed| paths.map(|path| derive(seed, path))).collect();
        assert_eq!(seeds.len(), 50 * paths.len());
    }
}
