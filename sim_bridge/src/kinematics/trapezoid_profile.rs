//! A straight run from standstill to standstill: faster, steady, slower. All of it in closed form.

/// How fast a body may go on a straight run, and how quickly it may change that.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProfileLimits {
    /// Top speed, in metres per second; above 0.
    pub speed_mps: f64,
    /// How quickly it gets faster, in metres per second squared; above 0, infinite for at once.
    pub acceleration_mps2: f64,
    /// How quickly it gets slower; above 0, infinite for at once.
    pub deceleration_mps2: f64,
}

/// A straight run of a length: its speed over time is a trapezoid, or a triangle if it is too short for top speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrapezoidProfile {
    ramp: ProfileLimits,
    length_m: f64,
    peak_mps: f64,
    /// When it has reached its peak, when it begins to brake, when it stands.
    faster_until_s: f64,
    steady_until_s: f64,
    duration_s: f64,
}

/// Where a run ends that is broken off.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StopPoint {
    /// Seconds from the start of the run until the body stands.
    pub stands_at_s: f64,
    /// Metres from the start of the run at which it stands.
    pub distance_m: f64,
}

impl TrapezoidProfile {
    /// A run over `length_m` metres.
    ///
    /// # Panics
    /// If the length is negative or a limit is not above 0.
    pub fn new(length_m: f64, ramp: ProfileLimits) -> TrapezoidProfile {
        let ProfileLimits { speed_mps, acceleration_mps2: up, deceleration_mps2: down } = ramp;
        assert!(length_m >= 0.0, "a length is not negative: {length_m}");
        assert!(speed_mps > 0.0 && up > 0.0 && down > 0.0, "limits are above 0: {ramp:?}");
        // The speed at which speeding up and braking take up the whole length between them.
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

    /// A run at the same speed all the way, above 0: as by a body that takes no time to speed up or to brake.
    ///
    /// # Panics
    /// As [`StraightRun::new`].
    pub fn constant_speed(length_m: f64, speed_mps: f64) -> TrapezoidProfile {
        let at_once = f64::INFINITY;
        TrapezoidProfile::new(
            length_m,
            ProfileLimits { speed_mps, acceleration_mps2: at_once, deceleration_mps2: at_once },
        )
    }

    /// How long it is, in metres.
    pub fn length_m(&self) -> f64 {
        self.length_m
    }

    /// How long it takes, in seconds.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// How fast it is `time_s` seconds after its start, in metres per second; 0 before the start and after the end.
    pub fn speed_at(&self, time_s: f64) -> f64 {
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

    /// How far it has come `time_s` seconds after its start, in metres; from 0 to its length.
    pub fn distance_at(&self, time_s: f64) -> f64 {
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

    /// When it has come so far, in seconds after its start: 0 for no distance, its duration for its length or more.
    pub fn time_at(&self, distance_m: f64) -> f64 {
        let (faster_m, slower_m) = (self.peak_mps * self.faster_until_s / 2.0, self.distance_at(self.steady_until_s));
        if distance_m <= 0.0 {
            0.0
        } else if distance_m >= self.length_m {
            self.duration_s
        } else if distance_m < faster_m {
            (2.0 * distance_m / self.ramp.acceleration_mps2).sqrt()
        } else if distance_m <= slower_m {
            self.faster_until_s + (distance_m - faster_m) / self.peak_mps
        } else {
            self.duration_s - (2.0 * (self.length_m - distance_m) / self.ramp.deceleration_mps2).sqrt()
        }
    }

    /// Where and when it stands if it begins to brake `time_s` seconds after its start.
    pub fn stop_from(&self, time_s: f64) -> StopPoint {
        let time_s = time_s.clamp(0.0, self.duration_s);
        let (speed, down) = (self.speed_at(time_s), self.ramp.deceleration_mps2);
        let distance_m = (self.distance_at(time_s) + speed * speed / (2.0 * down)).min(self.length_m);
        StopPoint { stands_at_s: time_s + speed / down, distance_m }
    }
}
