//! Trapezoidal speed profile of a straight run from standstill to standstill: accelerate, keep the
//! speed, brake. All in closed form.

/// Limits of a straight run: top speed, acceleration, deceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ProfileLimits {
    /// Top speed, in metres per second; above 0.
    pub speed_mps: f64,
    /// Acceleration, in metres per second squared; above 0, infinite for an instant change.
    pub acceleration_mps2: f64,
    /// Deceleration, in metres per second squared; above 0, infinite for an instant change.
    pub deceleration_mps2: f64,
}

/// A straight run of a given length. Its speed over time is a trapezoid, or a triangle if the run
/// is too short to reach the top speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TrapezoidProfile {
    ramp: ProfileLimits,
    length_m: f64,
    peak_mps: f64,
    /// Ends of the accelerating, steady and braking phases.
    faster_until_s: f64,
    steady_until_s: f64,
    duration_s: f64,
}

impl TrapezoidProfile {
    /// Creates a run over `length_m` metres.
    ///
    /// # Panics
    /// Panics if the length is negative or a limit is not above 0.
    pub(crate) fn new(length_m: f64, ramp: ProfileLimits) -> TrapezoidProfile {
        let ProfileLimits { speed_mps, acceleration_mps2: up, deceleration_mps2: down } = ramp;
        assert!(length_m >= 0.0, "a length is not negative: {length_m}");
        assert!(speed_mps > 0.0 && up > 0.0 && down > 0.0, "limits are above 0: {ramp:?}");
        // The peak speed at which acceleration and braking together cover the whole length.
        let triangle_mps = (2.0 * length_m / (up.recip() + down.recip())).sqrt();
        let peak_mps = speed_mps.min(triangle_mps);
        let ramps_m = peak_mps * peak_mps / 2.0 * (up.recip() + down.recip());
        let steady_s = if length_m > 0.0 { (length_m - ramps_m).max(0.0) / peak_mps } else { 0.0 };
        let faster_until_s = peak_mps / up;
        let steady_until_s = faster_until_s + steady_s;
        TrapezoidProfile {
            ramp,
            length_m,
            peak_mps,
            faster_until_s,
            steady_until_s,
            duration_s: steady_until_s + peak_mps / down,
        }
    }

    /// Creates a run at constant speed, above 0: without time to accelerate or to brake.
    ///
    /// # Panics
    /// Panics as [`TrapezoidProfile::new`] does.
    pub(crate) fn constant_speed(length_m: f64, speed_mps: f64) -> TrapezoidProfile {
        let at_once = f64::INFINITY;
        TrapezoidProfile::new(
            length_m,
            ProfileLimits { speed_mps, acceleration_mps2: at_once, deceleration_mps2: at_once },
        )
    }

    /// Length in metres.
    pub(crate) fn length_m(&self) -> f64 {
        self.length_m
    }

    /// Duration in seconds.
    pub(crate) fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Returns the speed `time_s` seconds after the start, in metres per second; 0 before the start
    /// and after the end.
    #[cfg(test)]
    pub(crate) fn speed_at(&self, time_s: f64) -> f64 {
        if time_s <= 0.0 || time_s >= self.duration_s {
            0.0
        } else if time_s < self.faster_until_s {
            self.ramp.acceleration_mps2 * time_s
        } else if time_s <= self.steady_until_s {
            self.peak_mps
        } else {
            self.ramp.deceleration_mps2 * (self.duration_s - time_s)
        }
    }

    /// Returns the distance covered `time_s` seconds after the start, in metres; from 0 to the
    /// length.
    pub(crate) fn distance_at(&self, time_s: f64) -> f64 {
        let distance = if time_s <= 0.0 {
            0.0
        } else if time_s >= self.duration_s {
            self.length_m
        } else if time_s < self.faster_until_s {
            self.ramp.acceleration_mps2 * time_s * time_s / 2.0
        } else if time_s <= self.steady_until_s {
            self.peak_mps * (time_s - self.faster_until_s / 2.0)
        } else {
            let left_s = self.duration_s - time_s;
            self.length_m - self.ramp.deceleration_mps2 * left_s * left_s / 2.0
        };
        distance.clamp(0.0, self.length_m)
    }
}
