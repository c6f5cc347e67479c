//! The command line of the laboratory.

mod allocate;
mod bench;
mod binary;
mod chaos;
mod experiment;
#[path = "../../../../tests/support/free_port.rs"]
mod free_port;
mod help;
#[path = "../../../../tests/support/skip.rs"]
mod skip;
mod soak;
#[path = "../../../consort/tests/command_line/support.rs"]
#[expect(dead_code, reason = "the tests of the other program use the rest")]
mod support;
mod test;
