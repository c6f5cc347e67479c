//! Where a recording is being looked at, and how fast that goes on: values, told how much time passes.

use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use std::time::Duration;

/// How many seconds of a recording may pass in one second.
pub const SPEED_RANGE: RangeInclusive<f64> = 0.1..=100.0;

/// What is asked of a player. Several things may be asked at once.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlayerCommand {
    /// Go to this instant, in milliseconds since 1970; one before or after the recording is its beginning or end.
    pub at_ms: Option<u64>,
    /// Go on, or stand still. At the end it goes on from the beginning.
    pub playing: Option<bool>,
    /// How many seconds of the recording pass in one second: see [`SPEEDS`].
    pub speed: Option<f64>,
}

/// What a player is at.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Player {
    from_ms: u64,
    to_ms: u64,
    #[serde(serialize_with = "whole")]
    at_ms: f64,
    playing: bool,
    speed: f64,
    /// Counts how often it was told to go elsewhere.
    jumps: u64,
}

fn whole<S: serde::Serializer>(ms: &f64, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_u64(*ms as u64)
}

impl Player {
    /// Stands at the beginning of a recording, and plays.
    ///
    /// # Errors
    /// In words, if the speed is none of [`SPEEDS`].
    pub fn new(from_ms: u64, to_ms: u64, speed: f64) -> Result<Player, String> {
        let speed = checked(speed)?;
        Ok(Player { from_ms, to_ms, at_ms: from_ms as f64, playing: true, speed, jumps: 0 })
    }

    /// Does as it is told, or nothing of it.
    ///
    /// # Errors
    /// In words, if the speed is none of [`SPEEDS`].
    pub fn apply(&mut self, command: PlayerCommand) -> Result<(), String> {
        self.speed = command.speed.map(checked).transpose()?.unwrap_or(self.speed);
        if let Some(at_ms) = command.at_ms {
            self.jump(at_ms);
        }
        if let Some(playing) = command.playing {
            if playing && self.at_ms() >= self.to_ms {
                self.jump(self.from_ms);
            }
            self.playing = playing;
        }
        Ok(())
    }

    fn jump(&mut self, at_ms: u64) {
        self.at_ms = at_ms.clamp(self.from_ms, self.to_ms) as f64;
        self.jumps += 1;
    }

    /// Time has passed. At its end the recording stands still.
    pub fn advance(&mut self, time: Duration) {
        if self.playing {
            self.at_ms = (self.at_ms + time.as_secs_f64() * 1000.0 * self.speed).min(self.to_ms as f64);
            self.playing = self.at_ms() < self.to_ms;
        }
    }

    /// Which instant is shown, in milliseconds since 1970.
    pub fn at_ms(&self) -> u64 {
        self.at_ms as u64
    }

    /// Whether it goes on.
    pub fn is_playing(&self) -> bool {
        self.playing
    }

    /// How many seconds of the recording pass in one second.
    pub fn speed(&self) -> f64 {
        self.speed
    }

    /// How often it was told to go elsewhere.
    pub fn seeks(&self) -> u64 {
        self.jumps
    }
}

fn checked(speed: f64) -> Result<f64, String> {
    match SPEED_RANGE.contains(&speed) {
        true => Ok(speed),
        false => {
            Err(format!("a speed of {speed} is not allowed: from {} to {}", SPEED_RANGE.start(), SPEED_RANGE.end()))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_plays_at_its_speed_to_the_end_and_from_there_from_the_beginning() {
        let mut player = Player::new(10_000, 20_000, 2.0).unwrap();
        player.advance(Duration::from_millis(1500));
        assert_eq!((player.at_ms(), player.is_playing()), (13_000, true));
        player.apply(PlayerCommand { playing: Some(false), ..PlayerCommand::default() }).unwrap();
        player.advance(Duration::from_secs(60));
        assert_eq!(player.at_ms(), 13_000);
        player.apply(PlayerCommand { playing: Some(true), speed: Some(100.0), ..PlayerCommand::default() }).unwrap();
        player.advance(Duration::from_secs(60));
        assert_eq!((player.at_ms(), player.is_playing(), player.seeks()), (20_000, false, 0));
        player.apply(PlayerCommand { playing: Some(true), ..PlayerCommand::default() }).unwrap();
        assert_eq!((player.at_ms(), player.is_playing(), player.seeks()), (10_000, true, 1));
    }

    #[test]
    fn it_goes_where_it_is_told_within_the_recording_and_refuses_other_speeds() {
        let mut player = Player::new(10_000, 20_000, 1.0).unwrap();
        for (asked, at) in [(15_000, 15_000), (3, 10_000), (u64::MAX, 20_000)] {
            player.apply(PlayerCommand { at_ms: Some(asked), ..PlayerCommand::default() }).unwrap();
            assert_eq!(player.at_ms(), at);
        }
        let before = player.clone();
        for speed in [0.0, -1.0, 101.0, f64::NAN] {
            let command = PlayerCommand { at_ms: Some(12_000), speed: Some(speed), playing: Some(false) };
            let problem = player.apply(command).unwrap_err();
            assert_eq!(problem, format!("a speed of {speed} is not allowed: from 0.1 to 100"));
            assert_eq!(player, before, "nothing of it is done");
        }
    }
}
