//! Playback position and speed of a recording: a state machine; the caller passes in the elapsed
//! time.

use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use std::time::Duration;

/// Allowed playback speeds, in seconds of the recording per second.
pub(crate) const SPEED_RANGE: RangeInclusive<f64> = 0.1..=100.0;

/// The speed is outside of `SPEED_RANGE`. Nothing was changed.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("a speed of {0} is not allowed: from {min} to {max}", min = SPEED_RANGE.start(), max = SPEED_RANGE.end())]
pub struct SpeedError(f64);

/// A command to the player. Several fields may be set at once.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlayerCommand {
    /// Seek to this instant, in milliseconds since 1970; an instant outside the recording is its
    /// beginning or end.
    pub at_ms: Option<u64>,
    /// Play or pause. At the end, playing restarts from the beginning.
    pub playing: Option<bool>,
    /// Playback speed: see `SPEED_RANGE`.
    pub speed: Option<f64>,
}

/// State of a player.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Player {
    from_ms: u64,
    to_ms: u64,
    #[serde(serialize_with = "as_integer")]
    at_ms: f64,
    playing: bool,
    speed: f64,
    /// Number of seeks.
    seeks: u64,
}

fn as_integer<S: serde::Serializer>(ms: &f64, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_u64(*ms as u64)
}

impl Player {
    /// Creates a player at the beginning of a recording, playing.
    ///
    /// # Errors
    /// [`SpeedError`] if the speed is outside of `SPEED_RANGE`.
    pub fn new(from_ms: u64, to_ms: u64, speed: f64) -> Result<Player, SpeedError> {
        let speed = checked(speed)?;
        Ok(Player { from_ms, to_ms, at_ms: from_ms as f64, playing: true, speed, seeks: 0 })
    }

    /// Applies a command completely, or not at all.
    ///
    /// # Errors
    /// [`SpeedError`] if the speed is outside of `SPEED_RANGE`.
    pub fn apply(&mut self, command: PlayerCommand) -> Result<(), SpeedError> {
        self.speed = command.speed.map(checked).transpose()?.unwrap_or(self.speed);
        if let Some(at_ms) = command.at_ms {
            self.seek(at_ms);
        }
        if let Some(playing) = command.playing {
            if playing && self.at_ms() >= self.to_ms {
                self.seek(self.from_ms);
            }
            self.playing = playing;
        }
        Ok(())
    }

    fn seek(&mut self, at_ms: u64) {
        self.at_ms = at_ms.clamp(self.from_ms, self.to_ms) as f64;
        self.seeks += 1;
    }

    /// Advances the time. The player stops at the end.
    pub fn advance(&mut self, time: Duration) {
        if self.playing {
            self.at_ms = (self.at_ms + time.as_secs_f64() * 1000.0 * self.speed).min(self.to_ms as f64);
            self.playing = self.at_ms() < self.to_ms;
        }
    }

    /// Returns the shown instant, in milliseconds since 1970.
    pub(crate) fn at_ms(&self) -> u64 {
        self.at_ms as u64
    }

    /// Returns the playback speed.
    pub fn speed(&self) -> f64 {
        self.speed
    }
}

fn checked(speed: f64) -> Result<f64, SpeedError> {
    if SPEED_RANGE.contains(&speed) { Ok(speed) } else { Err(SpeedError(speed)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn playback_stops_at_the_end_and_restarts_from_the_beginning() {
        let mut player = Player::new(10_000, 20_000, 2.0).unwrap();
        player.advance(Duration::from_millis(1500));
        assert_eq!((player.at_ms(), player.playing), (13_000, true));
        player.apply(PlayerCommand { playing: Some(false), ..PlayerCommand::default() }).unwrap();
        player.advance(Duration::from_secs(60));
        assert_eq!(player.at_ms(), 13_000);
        player.apply(PlayerCommand { playing: Some(true), speed: Some(100.0), ..PlayerCommand::default() }).unwrap();
        player.advance(Duration::from_secs(60));
        assert_eq!((player.at_ms(), player.playing, player.seeks), (20_000, false, 0));
        player.apply(PlayerCommand { playing: Some(true), ..PlayerCommand::default() }).unwrap();
        assert_eq!((player.at_ms(), player.playing, player.seeks), (10_000, true, 1));
    }

    #[test]
    fn seeks_are_clamped_and_invalid_speeds_are_rejected() {
        let mut player = Player::new(10_000, 20_000, 1.0).unwrap();
        for (asked, at) in [(15_000, 15_000), (3, 10_000), (u64::MAX, 20_000)] {
            player.apply(PlayerCommand { at_ms: Some(asked), ..PlayerCommand::default() }).unwrap();
            assert_eq!(player.at_ms(), at);
        }
        let before = player.clone();
        for speed in [0.0, -1.0, 101.0, f64::NAN] {
            let command = PlayerCommand { at_ms: Some(12_000), speed: Some(speed), playing: Some(false) };
            let problem = player.apply(command).unwrap_err();
            assert_eq!(problem.to_string(), format!("a speed of {speed} is not allowed: from 0.1 to 100"));
            assert_eq!(player, before, "the command has no effect");
        }
    }
}
