//! Whether a message is heard for the first time.

/// How far behind the newest a message may be and still be heard: messages of one author may overtake each other on their
/// ways, and not by a thousand.
const WIDTH: u64 = 1024;

/// What has been heard of one author's numbered messages at one place (RFC 4303, 3.4.3: a bitmap that slides).
#[derive(Debug, Clone)]
pub struct ReplayWindow {
    newest: u64,
    /// Bit `n % WIDTH`: number `n` has been heard.
    heard: [u64; (WIDTH / 64) as usize],
}

/// What a number is to whoever hears it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Freshness {
    /// It is heard for the first time.
    New,
    /// It was heard before.
    Repeated,
    /// It is so far behind that nobody knows.
    Old,
}

impl Default for ReplayWindow {
    fn default() -> Self {
        ReplayWindow { newest: 0, heard: [0; (WIDTH / 64) as usize] }
    }
}

impl ReplayWindow {
    /// Takes in a number; numbers begin at 1.
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

    fn mark(&mut self, number: u64, heard: bool) {
        let place = number % WIDTH;
        let (word, bit) = ((place / 64) as usize, 1 << (place % 64));
        if heard {
            self.heard[word] |= bit;
        } else {
            self.heard[word] &= !bit;
        }
    }

    fn is_marked(&self, number: u64) -> bool {
        let place = number % WIDTH;
        self.heard[(place / 64) as usize] & (1 << (place % 64)) != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    #[test]
    fn what_overtook_others_does_not_shut_them_out() {
        let mut window = ReplayWindow::default();
        assert_eq!([5, 3, 4, 3, 5].map(|number| window.accept(number)), {
            use Freshness::{New, Repeated};
            [New, New, New, Repeated, Repeated]
        });
        assert_eq!(window.accept(5 + 10 * WIDTH), Freshness::New);
        assert_eq!(window.accept(6), Freshness::Old);
        assert_eq!(window.accept(0), Freshness::Old);
        assert_eq!(ReplayWindow::default().accept(0), Freshness::Old, "nobody begins there");
        assert_eq!(window.accept(u64::MAX), Freshness::New, "a number beyond all is one too");
    }

    proptest! {
        #[test]
        fn nothing_is_heard_twice(numbers in prop::collection::vec(1u64..5000, 0..400)) {
            let (mut window, mut heard) = (ReplayWindow::default(), BTreeSet::new());
            for number in numbers {
                let newest = heard.last().copied().unwrap_or(0);
                let expected = if heard.contains(&number) && newest - number < WIDTH {
                    Freshness::Repeated
                } else if number + WIDTH <= newest {
                    Freshness::Old
                } else {
                    Freshness::New
                };
                prop_assert_eq!(window.accept(number), expected);
                heard.insert(number);
            }
        }
    }
}
