//! The documentation: its links lead somewhere, its tutorials work as they are written, its references say what the code does.

#[path = "../command_line/binary.rs"]
mod binary;
mod links;
mod page;
mod reference;
mod schema_tables;
mod schemas;
mod shell;
mod tutorials;
