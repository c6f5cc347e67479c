//! A row of thesis Table 5.1.

use serde::Serialize;
use std::fmt;

/// Measurements of a swarm. Equal seeds give equal results, except for the three real times.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SwarmResult {
    /// Number of drones.
    pub drones: usize,
    /// Simulated time until all drones had reported, in seconds.
    pub simulated_s: f64,
    /// Least real time for a simulated second, in seconds.
    pub min_s: f64,
    /// Greatest real time for a simulated second, in seconds.
    pub max_s: f64,
    /// Mean real time for a simulated second, in seconds.
    pub average_s: f64,
    /// Number of drones that reached their targets.
    pub arrived: usize,
    /// Number of drones that collided.
    pub crashed: usize,
}

/// Heading of the table.
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
