//! Replay detection for numbered messages.

/// Maximum distance of a message behind the newest message. Messages of the same author may
/// overtake each other, but not by a thousand.
const WIDTH: u64 = 1024;

/// Sliding window over the numbered messages of a single author (RFC 4303, 3.4.3: a sliding
/// bitmap).
#[derive(Debug, Clone)]
pub struct ReplayWindow {
    newest: u64,
    /// Bit `n % WIDTH` is set if number `n` was received.
    received: [u64; (WIDTH / 64) as usize],
}

/// Freshness of a message number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Freshness {
    /// The number is received for the first time.
    New,
    /// The number was received before.
    Repeated,
    /// The number is too far behind to decide.
    Old,
}

impl Default for ReplayWindow {
    fn default() -> Self {
        ReplayWindow { newest: 0, received: [0; (WIDTH / 64) as usize] }
    }
}

impl ReplayWindow {
    /// Records a number and returns its freshness; numbers begin at 1.
    pub fn accept(&mut self, number: u64) -> Freshness {
        if number > self.newest {
            let skipped = (number - self.newest).min(WIDTH);
            for passed in 1..=skipped {
                self.mark(self.newest.wrapping_add(passed), false);
            }
            self.newest = number;
            self.mark(number, true);
            return Freshness::New;
        }
        if self.newest - number >= WIDTH || number == 0 {
            return Freshness::Old;
        }
        if self.is_marked(number) {
            return Freshness::Repeated;
        }
        self.mark(number, true);
        Freshness::New
    }

    fn mark(&mut self, number: u64, received: bool) {
        let place = number % WIDTH;
        let (word, bit) = ((place / 64) as usize, 1 << (place % 64));
        if received {
            self.received[word] |= bit;
        } else {
            self.received[word] &= !bit;
        }
    }

    fn is_marked(&self, number: u64) -> bool {
        let place = number % WIDTH;
        self.received[(place / 64) as usize] & (1 << (place % 64)) != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    #[test]
    fn a_number_that_overtakes_others_does_not_exclude_them() {
        let mut window = ReplayWindow::default();
        assert_eq!([5, 3, 4, 3, 5].map(|number| window.accept(number)), {
            use Freshness::{New, Repeated};
            [New, New, New, Repeated, Repeated]
        });
        assert_eq!(window.accept(5 + 10 * WIDTH), Freshness::New);
        assert_eq!(window.accept(6), Freshness::Old);
        assert_eq!(window.accept(0), Freshness::Old);
        assert_eq!(ReplayWindow::default().accept(0), Freshness::Old, "numbers begin at 1");
        assert_eq!(window.accept(u64::MAX), Freshness::New, "the largest number is accepted");
    }

    proptest! {
        #[test]
        fn no_number_is_accepted_twice(numbers in prop::collection::vec(1u64..5000, 0..400)) {
            let (mut window, mut received) = (ReplayWindow::default(), BTreeSet::new());
            for number in numbers {
                let newest = received.last().copied().unwrap_or(0);
                let expected = if received.contains(&number) && newest - number < WIDTH {
                    Freshness::Repeated
                } else if number + WIDTH <= newest {
                    Freshness::Old
                } else {
                    Freshness::New
                };
                prop_assert_eq!(window.accept(number), expected);
                received.insert(number);
            }
        }
    }
}
