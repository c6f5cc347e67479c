//! A PID controller.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Gains of a PID controller: output per unit of the error, of its integral, and of its rate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PidGains {
    /// Per unit of the error; above 0.
    pub kp: f64,
    /// Per unit and second of the error: removes a steady-state error.
    #[serde(default)]
    pub ki: f64,
    /// Per unit and 1/second of the error's rate: damps.
    #[serde(default)]
    pub kd: f64,
}

/// A PID controller and its state. While the output is at its limit, the integral does not grow
/// (anti-windup).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pid {
    gains: PidGains,
    integral: f64,
    before: Option<f64>,
}

impl Pid {
    /// Creates a controller without history.
    pub(crate) fn new(gains: PidGains) -> Pid {
        Pid { gains, integral: 0.0, before: None }
    }

    /// Returns the output for an error `dt_s` seconds after the previous error, from `-limit` to
    /// `limit`.
    pub(crate) fn output(&mut self, error: f64, dt_s: f64, limit: f64) -> f64 {
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

    /// Clears the history.
    pub(crate) fn reset(&mut self) {
        (self.integral, self.before) = (0.0, None);
    }
}
