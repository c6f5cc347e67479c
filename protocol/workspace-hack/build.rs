//! Makes Cargo consider the build dependencies.

fn main() {}
