//! The documentation: its links have targets, its tutorials work as written, and its reference
//! matches the code.

#[path = "../command_line/binary.rs"]
mod binary;
mod links;
mod page;
mod reference;
mod schema_tables;
mod schemas;
mod shell;
mod tutorials;
