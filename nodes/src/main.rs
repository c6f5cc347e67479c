//! The one binary of Consort.
fn main() {}
