//! Vehicles of VDA 5050 as robots of a fleet. The node of a robot starts `consort-vda5050 driver FILE`
//! as its driver (`docs/reference/driver.md`).
//!
//! ```text
//!  robot's node ── goal, keep, cancel ──▶ driver ──▶ OrderMachine ──▶ broker ── order, instantActions ──▶ vehicle
//!               ◀── result, pose, charge ──       ◀── (core)      ◀──        ◀── state, connection ──────
//! ```
//!
//! The driver knows the driver protocol and the broker, and nothing else of Consort: it decides nothing.
//! [`vehicles`] is the other side: simulated robots as vehicles.

pub mod catalog;
pub mod check;
pub mod driver;
pub mod file;
mod lines;
mod mqtt;
pub mod vehicles;
