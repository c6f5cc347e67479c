//! The documentation: its links have targets, its tutorials work as written, its reference matches
//! the code, and the tests that it names exist.

#[path = "../command_line/binary.rs"]
mod binary;
#[path = "../../../../tests/support/free_port.rs"]
mod free_port;
mod links;
mod named_tests;
mod page;
mod reference;
mod schema_tables;
mod schemas;
mod shell;
#[path = "../../../../tests/support/skip.rs"]
mod skip;
mod tutorials;
