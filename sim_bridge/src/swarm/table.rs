//! A line of thesis Table 5.1.

use serde::Serialize;
use std::fmt;

/// What is told of one swarm. Equal for equal seeds but for the three times outside.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SwarmResult {
    /// How many drones.
    pub drones: usize,
    /// How long it took within the simulation until all had answered, in seconds.
    pub simulated_s: f64,
    /// The least time outside that a second within took, in seconds.
    pub min_s: f64,
    /// The most.
    pub max_s: f64,
    /// The mean.
    pub average_s: f64,
    /// How many drones are where they were sent.
    pub arrived: usize,
    /// How many drones ran into another.
    pub crashed: usize,
}

/// What stands above the rows.
pub const TABLE_HEADER: &str = "Swarm size  Simulation time  Min. time 1s  Max. time 1s  Average    Arrived  Crashed";

impl fmt::Display for SwarmResult {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let SwarmResult { drones, simulated_s, min_s, max_s, average_s, arrived, crashed } = self;
        write!(
            f,
            "{drones:<10}  {simulated_s:>13.2} s  {min_s:>10.6} s  {max_s:>10.6} s  {average_s:.6} s  {arrived:>6}  {crashed:>7}"
        )
    }
}
