//! Presence tokens, as reported to a subscriber.

use crate::bus::Presence;
use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

/// Tokens that were reported as present. A token that vanishes is reported after a pause, unless it
/// returns: a client that changes its relay loses all tokens for a moment, and every other node loses
/// the tokens of the clients of a failed relay.
#[derive(Debug)]
pub(super) struct PresentTokens {
    /// Pause before a vanished token is reported; zero to report it at once.
    hold: Duration,
    present: BTreeSet<String>,
    /// Tokens of `present` that have vanished, with the time.
    vanished: BTreeMap<String, Instant>,
}

impl PresentTokens {
    pub(super) fn new(hold: Duration) -> PresentTokens {
        PresentTokens { hold, present: BTreeSet::new(), vanished: BTreeMap::new() }
    }

    /// Handles the announcement of a token, and returns the change to report. Zenoh repeats
    /// announcements when links open and close.
    pub(super) fn appeared(&mut self, key: String) -> Option<Presence> {
        self.vanished.remove(&key);
        self.present.insert(key.clone()).then_some(Presence { key, alive: true })
    }

    /// Handles the end of a token, and returns the change to report at once.
    pub(super) fn vanished(&mut self, key: String, now: Instant) -> Option<Presence> {
        if self.hold.is_zero() {
            return self.present.remove(&key).then_some(Presence { key, alive: false });
        }
        if self.present.contains(&key) {
            self.vanished.entry(key).or_insert(now);
        }
        None
    }

    /// Handles the end of all tokens: they are to be announced again.
    pub(super) fn all_vanished(&mut self, now: Instant) {
        for key in &self.present {
            self.vanished.entry(key.clone()).or_insert(now);
        }
    }

    /// Returns the tokens that have vanished for the whole pause.
    pub(super) fn due(&mut self, now: Instant) -> Vec<Presence> {
        let due = self.vanished.iter().filter(|(_, since)| now.saturating_duration_since(**since) >= self.hold);
        let due: Vec<String> = due.map(|(key, _)| key.clone()).collect();
        let remove = |key: String| {
            self.vanished.remove(&key);
            self.present.remove(&key);
            Presence { key, alive: false }
        };
        due.into_iter().map(remove).collect()
    }

    /// Removes all tokens, and returns them as vanished.
    pub(super) fn take_all(&mut self) -> Vec<Presence> {
        self.vanished.clear();
        std::mem::take(&mut self.present).into_iter().map(|key| Presence { key, alive: false }).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOLD: Duration = Duration::from_secs(1);

    fn change(key: &str, alive: bool) -> Presence {
        Presence { key: key.to_owned(), alive }
    }

    /// Returns tokens `ada` and `bob`, and the time of their announcement.
    fn present(hold: Duration) -> (PresentTokens, Instant) {
        let mut tokens = PresentTokens::new(hold);
        for key in ["ada", "bob"] {
            assert_eq!(tokens.appeared(key.to_owned()), Some(change(key, true)));
            assert_eq!(tokens.appeared(key.to_owned()), None, "repeated");
        }
        (tokens, Instant::now())
    }

    #[test]
    fn without_a_pause_each_change_is_reported_at_once() {
        let (mut tokens, now) = present(Duration::ZERO);
        assert_eq!(tokens.vanished("ada".to_owned(), now), Some(change("ada", false)));
        assert_eq!(tokens.vanished("ada".to_owned(), now), None);
        assert_eq!(tokens.take_all(), [change("bob", false)]);
        assert_eq!(tokens.take_all(), []);
    }

    #[test]
    fn a_token_that_returns_within_the_pause_is_not_reported() {
        let (mut tokens, start) = present(HOLD);
        tokens.all_vanished(start);
        assert_eq!(tokens.appeared("ada".to_owned()), None);
        assert_eq!(tokens.due(start + HOLD), [change("bob", false)]);
        assert_eq!(tokens.due(start + HOLD * 9), []);
        assert_eq!(tokens.appeared("bob".to_owned()), Some(change("bob", true)));
    }

    #[test]
    fn the_pause_begins_when_the_token_first_vanishes() {
        let (mut tokens, start) = present(HOLD);
        assert_eq!(tokens.vanished("ada".to_owned(), start), None);
        assert_eq!(tokens.vanished("eve".to_owned(), start), None, "never announced");
        tokens.all_vanished(start + HOLD / 2);
        assert_eq!(tokens.due(start + HOLD - Duration::from_millis(1)), []);
        assert_eq!(tokens.due(start + HOLD), [change("ada", false)]);
        assert_eq!(tokens.due(start + HOLD * 3 / 2), [change("bob", false)]);
    }
}
