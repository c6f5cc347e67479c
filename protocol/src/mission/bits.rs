//! Set of small numbers, for orders over a few hundred tasks.

/// Set of numbers below a bound that is fixed at creation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Bits {
    words: Vec<u64>,
}

impl Bits {
    /// Creates an empty set of numbers below `bound`.
    pub(crate) fn below(bound: usize) -> Self {
        Self { words: vec![0; bound.div_ceil(64)] }
    }

    pub(crate) fn insert(&mut self, number: usize) {
        self.words[number / 64] |= 1 << (number % 64);
    }

    pub(crate) fn contains(&self, number: usize) -> bool {
        self.words[number / 64] & (1 << (number % 64)) != 0
    }

    /// Adds all numbers of the other set, which has the same bound.
    pub(crate) fn extend(&mut self, other: &Bits) {
        self.words.iter_mut().zip(&other.words).for_each(|(word, other)| *word |= other);
    }

    /// Returns the numbers in the set, in descending order.
    pub(crate) fn descending(&self) -> impl Iterator<Item = usize> + '_ {
        self.words.iter().enumerate().rev().flat_map(|(at, &word)| {
            let mut rest = word;
            std::iter::from_fn(move || {
                let highest = 63_u32.checked_sub(rest.leading_zeros())?;
                rest &= !(1 << highest);
                Some(at * 64 + highest as usize)
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_returned_in_descending_order() {
        let mut bits = Bits::below(130);
        [0, 63, 64, 129].into_iter().for_each(|number| bits.insert(number));
        assert_eq!(bits.descending().collect::<Vec<_>>(), [129, 64, 63, 0]);
        assert!(bits.contains(64) && !bits.contains(65));
        let mut more = Bits::below(130);
        more.insert(65);
        more.extend(&bits);
        assert_eq!(more.descending().collect::<Vec<_>>(), [129, 65, 64, 63, 0]);
    }
}
