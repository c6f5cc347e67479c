//! The program `consort-lab`: commands that run the harness of `consort-tests`, evaluations and
//! benchmarks. The program of a robot, `consort`, contains none of it.

pub mod cli;
pub mod command;
pub mod design_file;
mod evaluation;
mod png;
