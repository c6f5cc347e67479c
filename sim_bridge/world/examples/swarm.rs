//! How long a simulated second of a drone swarm takes (thesis Table 5.1).
//!
//! `cargo run --release -p consort-world --example swarm -- 20 80 200 10000`

#![expect(clippy::print_stdout, reason = "an example answers on the terminal")]

use consort_world::swarm::{Swarm, TABLE_HEADER, run_swarm};
use std::num::NonZeroUsize;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let sizes: Result<Vec<usize>, _> = std::env::args().skip(1).map(|text| text.parse()).collect();
    let sizes = Some(sizes?).filter(|sizes| !sizes.is_empty()).unwrap_or_else(|| vec![20, 40, 60, 80, 100, 150, 200]);
    println!("{TABLE_HEADER}");
    for drones in sizes {
        let began = Instant::now();
        println!("{}", run_swarm(Swarm { drones, seed: 1, threads: NonZeroUsize::MIN }, || began.elapsed())?);
    }
    Ok(())
}
