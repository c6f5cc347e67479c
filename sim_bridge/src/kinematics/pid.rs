//! A PID controller.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What a controller makes of an error: its answer per unit of the error, of the error's integral, and of its rate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PidGains {
    /// Per unit of the error; above 0.
    pub kp: f64,
    /// Per unit and second of the error: removes what would stay.
    #[serde(default)]
    pub ki: f64,
    /// Per unit and 1/second of the error's rate: damps.
    #[serde(default)]
    pub kd: f64,
}

/// A controller with what it remembers. While its answer is at its limit the integral stands still, so that it has nothing
/// to take back afterwards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pid {
    gains: PidGains,
    integral: f64,
    before: Option<f64>,
}

impl Pid {
    /// A controller that remembers nothing.
    pub fn new(gains: PidGains) -> Pid {
        Pid { gains, integral: 0.0, before: None }
    }

    /// The answer to an error `dt_s` seconds after the last one, from `-limit` to `limit`.
    pub fn output(&mut self, error: f64, dt_s: f64, limit: f64) -> f64 {
        let PidGains { kp, ki, kd } = self.gains;
        let rate = self.before.map_or(0.0, |before| (error - before) / dt_s);
        self.before = Some(error);
        let integral = self.integral + error * dt_s;
        let answer = kp * error + ki * integral + kd * rate;
        if answer.abs() <= limit || (answer > 0.0) != (error > 0.0) {
            self.integral = integral;
        }
        answer.clamp(-limit, limit)
    }

    /// Forgets what was.
    pub fn reset(&mut self) {
        (self.integral, self.before) = (0.0, None);
    }
}
